#include "server/engine/checkpoint/checkpoint.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/dataset/json_memory.h"
#include "server/engine/checkpoint/state.h"
#include "server/engine/checkpoint/viewing.h"
#include "server/engine/field/voxels.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/scene/pose.h"
#include "server/engine/scene/scene.h"

#define MAX_HEADER (100u << 20)

// ---- the list of tensors, the same for writing and reading -----------------------------------

void rn_checkpoint_add(struct rn_tensor *list, int *count, const char *name, const char *dtype,
                       int rank, const size_t *shape, void *data) {
    struct rn_tensor *t = &list[(*count)++];
    snprintf(t->name, sizeof t->name, "%s", name);
    t->dtype = dtype;
    t->rank = rank;
    t->data = data;
    t->bytes = strcmp(dtype, "U8") == 0 ? 1 : strcmp(dtype, "F16") == 0 ? 2 : 4;
    for (int i = 0; i < rank; i++) {
        t->shape[i] = shape[i];
        t->bytes *= shape[i];
    }
}

void rn_checkpoint_add_network(struct rn_tensor *list, int *count, const char *prefix,
                               const struct rn_mlp_shape *shape, float *weights) {
    for (int l = 0; l < shape->layers; l++) {
        char name[24];
        snprintf(name, sizeof name, "%s.%d", prefix, l);
        rn_checkpoint_add(list, count, name, "F32", 2,
                          (size_t[]){(size_t)shape->in[l], (size_t)shape->out[l]},
                          weights + shape->offset[l]);
    }
}

void rn_checkpoint_add_appearances(struct rn_tensor *list, int *count,
                                   const struct rn_field *field) {
    const struct rn_parameters *p = &field->parameters;
    if (!p->appearance_count) return;
    rn_checkpoint_add(list, count, "appearances", "F32", 2,
                      (size_t[]){p->appearance_count / RN_APPEARANCE, RN_APPEARANCE},
                      p->values + p->count - p->appearance_count);
}

int rn_checkpoint_tensors(const struct rn_arrays *arrays,
                          struct rn_tensor list[RN_CHECKPOINT_TENSORS]) {
    const struct rn_field *field = arrays->field;
    const struct rn_field_config *c = &field->config.field;
    const struct rn_parameters *p = &field->parameters;
    size_t base = (size_t)c->base, cells = (size_t)c->occupancy;
    int count = 0;
    rn_checkpoint_add(list, &count, "planes", "F32", 4,
                      (size_t[]){(size_t)rn_grid_count(c), base, base, (size_t)c->channels},
                      p->values);
    rn_checkpoint_add_network(list, &count, "base", &field->cpu.base_shape,
                              p->values + p->plane_count);
    rn_checkpoint_add_network(list, &count, "head", &field->cpu.head_shape,
                              p->values + p->plane_count + p->base_count);
    rn_checkpoint_add_appearances(list, &count, field);
    rn_checkpoint_add(list, &count, "occupancy", "F32", 3, (size_t[]){cells, cells, cells},
                      field->occupancy);
    rn_checkpoint_add(list, &count, "hull", "U8", 3, (size_t[]){cells, cells, cells}, field->hull);
    if (arrays->m) {
        rn_checkpoint_add(list, &count, "adam.m", "F32", 1, &p->count, arrays->m);
        if (arrays->seen)
            rn_checkpoint_add(list, &count, "seen", "F32", 3, (size_t[]){cells, cells, cells},
                              arrays->seen);
        rn_checkpoint_add(list, &count, "adam.v", "F32", 1, &p->count, arrays->v);
        if (arrays->pose_count)
            rn_checkpoint_add(list, &count, "poses", "F32", 2,
                              (size_t[]){arrays->pose_count, RN_POSE_UNKNOWNS}, arrays->poses);
        if (arrays->outlier_count)
            rn_checkpoint_add(list, &count, "outliers", "U8", 1, &arrays->outlier_count,
                              arrays->outliers);
    }
    return count;
}

int rn_checkpoint_add_blocks(const struct rn_arrays *arrays, struct rn_tensor *list, int count) {
    if (arrays->block_count == 0) return count;
    rn_checkpoint_add(list, &count, "draw.error", "F32", 1, &arrays->block_count,
                      arrays->block_error);
    rn_checkpoint_add(list, &count, "draw.share", "F32", 1, &arrays->block_count,
                      arrays->block_share);
    return count;
}

// ---- reading --------------------------------------------------------------------------------

// false: errno, 0 where the file ends before.
static bool read_all(int fd, void *data, size_t bytes, uint64_t at) {
    char *to = data;
    while (bytes > 0) {
        ssize_t n = pread(fd, to, bytes, (off_t)at);
        if (n < 0 && errno == EINTR) continue;
        if (n == 0) errno = 0;
        if (n <= 0) return false;
        to += n;
        at += (uint64_t)n;
        bytes -= (size_t)n;
    }
    return true;
}

// What keeps from reading says nothing about the file: only bytes that are there and wrong do.
static enum rn_status cannot_read(const char *path, struct rn_error *err) {
    return errno != 0 ? rn_error_from_errno(err, errno, path, "read the checkpoint")
                      : rn_error_set(err, RN_ERROR_CORRUPT, path,
                                     "is no checkpoint of this program, or is damaged");
}

static enum rn_status parse(const char *path, const char *text, size_t size, json_t **ret_root,
                            struct rn_error *err) {
    json_error_t why;
    *ret_root = rn_json_load(text, size, &why);
    errno = *ret_root == NULL && json_error_code(&why) == json_error_out_of_memory ? ENOMEM : 0;
    return *ret_root != NULL ? RN_OK : cannot_read(path, err);
}

static enum rn_status read_header(struct rn_checkpoint *c, struct rn_error *err) {
    uint64_t length;
    if (!read_all(c->fd, &length, sizeof length, 0)) return cannot_read(c->path, err);
    errno = 0;
    if (length > MAX_HEADER) return cannot_read(c->path, err);
    char *text = malloc(length + 1);
    if (text == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, c->path, "out of memory");
    enum rn_status status = RN_OK;
    if (!read_all(c->fd, text, length, sizeof length)) status = cannot_read(c->path, err);
    if (status == RN_OK) status = parse(c->path, text, length, &c->header, err);
    free(text);
    c->data_start = sizeof length + length;
    return status;
}

// Whether the file is as long as its header says: the tensors' end is the file's.
static enum rn_status check_length(const struct rn_checkpoint *c, struct rn_error *err) {
    int64_t last = 0;
    const char *name;
    json_t *entry;
    json_object_foreach(c->header, name, entry) {
        int64_t end = json_integer_value(json_array_get(json_object_get(entry, "data_offsets"), 1));
        if (end > last) last = end;
    }
    const off_t size = lseek(c->fd, 0, SEEK_END);
    if (size < 0) return cannot_read(c->path, err);
    return last == size - (off_t)c->data_start
               ? RN_OK
               : rn_error_set(err, RN_ERROR_CORRUPT, c->path,
                              "is cut off or has bytes too many; use an older checkpoint");
}

enum rn_status rn_checkpoint_open(const char *path, struct rn_checkpoint *ret,
                                  struct rn_error *err) {
    memset(ret, 0, sizeof *ret);
    snprintf(ret->path, sizeof ret->path, "%s", path);
    ret->fd = open(path, O_RDONLY | O_CLOEXEC);
    if (ret->fd < 0) return rn_error_from_errno(err, errno, path, "open the checkpoint");
    json_t *state = NULL;
    enum rn_status status = read_header(ret, err);
    const char *text =
        json_string_value(json_object_get(json_object_get(ret->header, "__metadata__"), "ripnerf"));
    if (status == RN_OK)
        status = parse(path, text ? text : "", text ? strlen(text) : 0, &state, err);
    if (status == RN_OK) status = check_length(ret, err);
    if (status == RN_OK) status = rn_checkpoint_parse_state(state, path, ret, err);
    json_decref(state);
    ret->has_trainer = json_object_get(ret->header, "adam.m") != NULL;
    if (status != RN_OK) rn_checkpoint_close(ret);
    return status;
}

void rn_checkpoint_close(struct rn_checkpoint *c) {
    if (c->fd > 0) close(c->fd);
    json_decref(c->header);
    c->header = NULL;
    c->fd = -1;
}

static bool all_finite(const float *values, size_t count) {
    for (size_t i = 0; i < count; i++)
        if (!isfinite(values[i])) return false;
    return true;
}

static enum rn_status read_tensor(const struct rn_checkpoint *c, const struct rn_tensor *t,
                                  struct rn_error *err) {
    const json_t *entry = json_object_get(c->header, t->name);
    const json_t *shape = json_object_get(entry, "shape"),
                 *at = json_object_get(entry, "data_offsets");
    const char *dtype = json_string_value(json_object_get(entry, "dtype"));
    bool same = dtype && strcmp(dtype, t->dtype) == 0 && (int)json_array_size(shape) == t->rank;
    for (int i = 0; same && i < t->rank; i++)
        same = (size_t)json_integer_value(json_array_get(shape, (size_t)i)) == t->shape[i];
    int64_t begin = json_integer_value(json_array_get(at, 0));
    int64_t end = json_integer_value(json_array_get(at, 1));
    if (!same || begin < 0 || end < begin || end - begin != (int64_t)t->bytes)
        return rn_error_set(err, RN_ERROR_CORRUPT, c->path, "tensor '%s' is missing or misshapen",
                            t->name);
    bool whole = read_all(c->fd, t->data, t->bytes, c->data_start + (uint64_t)begin);
    if (!whole && errno != 0) return cannot_read(c->path, err);
    if (!whole)
        return rn_error_set(err, RN_ERROR_CORRUPT, c->path, "ends before tensor '%s' does",
                            t->name);
    if (strcmp(t->dtype, "F32") == 0 && !all_finite(t->data, t->bytes / 4))
        return rn_error_set(err, RN_ERROR_CORRUPT, c->path, "tensor '%s' holds non-finite numbers",
                            t->name);
    return RN_OK;
}

enum rn_status rn_checkpoint_read_list(const struct rn_checkpoint *c, const struct rn_tensor *list,
                                       int count, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (int i = 0; i < count && status == RN_OK; i++)
        status = read_tensor(c, &list[i], err);
    return status;
}

enum rn_status rn_checkpoint_read_arrays(const struct rn_checkpoint *c,
                                         const struct rn_arrays *arrays, struct rn_error *err) {
    struct rn_tensor list[RN_CHECKPOINT_TENSORS];
    struct rn_field *field = arrays->field;
    enum rn_status status =
        c->viewing.bits
            ? rn_viewing_read(c, field, err)
            : rn_checkpoint_read_list(c, list, rn_checkpoint_tensors(arrays, list), err);
    if (status != RN_OK) return status;
    field->viewing = c->viewing;
    memcpy(field->effects, c->effects, sizeof field->effects);
    snprintf(field->kernels, sizeof field->kernels, "%s", c->kernels);
    field->finest_cone = c->finest_cone;
    field->cpu.disparity = c->disparity;
    field->steps = c->counters.progress.step;
    field->train_seconds = c->counters.progress.train_seconds;
    field->psnr = c->counters.progress.psnr;
    return RN_OK;
}

enum rn_status rn_checkpoint_read_field(const struct rn_checkpoint *c, struct rn_field *field,
                                        struct rn_error *err) {
    return rn_checkpoint_read_arrays(c, &(struct rn_arrays){.field = field}, err);
}

enum rn_status rn_checkpoint_read_blocks(const struct rn_checkpoint *c,
                                         const struct rn_arrays *arrays, struct rn_error *err) {
    struct rn_tensor list[2];
    enum rn_status status =
        rn_checkpoint_read_list(c, list, rn_checkpoint_add_blocks(arrays, list, 0), err);
    for (size_t i = 0; i < arrays->block_count && status == RN_OK; i++)
        if (!(arrays->block_share[i] > 0))
            status = rn_error_set(err, RN_ERROR_CORRUPT, c->path,
                                  "tensor 'draw.share' holds numbers that are not positive");
    return status;
}

enum rn_status rn_field_need(const char *checkpoint_path, size_t *ret_bytes, struct rn_error *err) {
    struct rn_checkpoint checkpoint;
    enum rn_status status = rn_checkpoint_open(checkpoint_path, &checkpoint, err);
    if (status != RN_OK) return status;
    *ret_bytes = rn_field_bytes(&checkpoint.config, checkpoint.config.field.levels);
    rn_checkpoint_close(&checkpoint);
    return RN_OK;
}

enum rn_status rn_field_load(struct rn_engine *engine, const char *checkpoint_path,
                             struct rn_field **ret_field, struct rn_error *err) {
    struct rn_checkpoint checkpoint;
    struct rn_field *field = NULL;
    enum rn_status status = rn_checkpoint_open(checkpoint_path, &checkpoint, err);
    if (status != RN_OK) return status;
    status = rn_field_create(&checkpoint.config, &checkpoint.bounds, &field, err);
    if (status == RN_OK) status = rn_checkpoint_read_field(&checkpoint, field, err);
    rn_checkpoint_close(&checkpoint);
    if (status != RN_OK) {
        rn_field_destroy(&field);
        return status;
    }
    rn_field_refresh(field, engine);
    rn_field_refresh_occupancy(field);
    rn_field_refine_occupancy(field, engine);
    status = rn_field_put_to_render(engine, field, err);
    if (status != RN_OK) {
        rn_field_destroy(&field);
        return status;
    }
    *ret_field = field;
    return RN_OK;
}
