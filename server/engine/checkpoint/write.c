// Writing checkpoints: what has to be said of the tensors at once, the rest on a thread, so that
// whoever trains can serve others meanwhile.
#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/seal.h"
#include "common/base/sha256.h"
#include "server/engine/checkpoint/state.h"
#include "server/engine/scene/scene.h"

struct rn_checkpoint_writer {
    pthread_t thread;
    atomic_int stage; // enum rn_save_stage
    char path[4096];
    char *header;
    struct rn_tensor tensors[RN_CHECKPOINT_TENSORS];
    int tensor_count;
    const float *parameters;
    size_t parameter_bytes;
    char sha256[65];
    int error; // errno, 0 when it went well
};

static json_t *make_header(const struct rn_field *field, const struct rn_counters *counters,
                           const struct rn_viewing *viewing, const struct rn_tensor *list,
                           int count) {
    json_t *state = rn_checkpoint_state(field, counters, viewing);
    char *text = state ? json_dumps(state, JSON_COMPACT | JSON_REAL_PRECISION(17)) : NULL;
    json_decref(state);
    if (!text) return NULL;
    json_t *header = json_pack("{s:{s:s,s:s,s:s}}", "__metadata__", "format", "ripnerf", "sha256",
                               RN_SEAL_ZEROS, "ripnerf", text);
    free(text);
    size_t at = 0;
    for (int i = 0; header && i < count; i++) {
        json_t *shape = json_array();
        for (int k = 0; k < list[i].rank; k++)
            json_array_append_new(shape, json_integer((json_int_t)list[i].shape[k]));
        json_t *entry = json_pack("{s:s,s:o,s:[I,I]}", "dtype", list[i].dtype, "shape", shape,
                                  "data_offsets", (json_int_t)at, (json_int_t)(at + list[i].bytes));
        at += list[i].bytes;
        json_object_set_new(header, list[i].name, entry);
    }
    return header;
}

bool rn_checkpoint_put(int fd, const char *header, size_t multiple, const struct rn_tensor *list,
                       int count) {
    static const char blanks[] = "                                                               ";
    uint64_t length = strlen(header), padded = (length + multiple - 1) / multiple * multiple;
    bool ok = rn_write_all(fd, &padded, sizeof padded) && rn_write_all(fd, header, length);
    for (uint64_t at = length, part; ok && at < padded; at += part) {
        part = padded - at < sizeof blanks - 1 ? padded - at : sizeof blanks - 1;
        ok = rn_write_all(fd, blanks, part);
    }
    for (int i = 0; ok && i < count; i++)
        ok = rn_write_all(fd, list[i].data, list[i].bytes);
    return ok;
}

static bool sync_folder(const char *path) {
    char copy[4096];
    snprintf(copy, sizeof copy, "%s", path);
    int fd = open(dirname(copy), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    bool ok = fd >= 0 && fsync(fd) == 0;
    if (fd >= 0) close(fd);
    return ok;
}

static void digest(struct rn_checkpoint_writer *w) {
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    rn_sha256_update(&hash, w->parameters, w->parameter_bytes);
    rn_sha256_final_hex(&hash, w->sha256);
}

int rn_checkpoint_settle(int fd, int error, const char *temporary, const char *path,
                         char ret_sha256[65]) {
    if (!error && rn_seal_close(fd, temporary, ret_sha256, NULL) != RN_OK)
        error = errno ? errno : EIO;
    if (!error && fsync(fd) != 0) error = errno;
    if (close(fd) != 0 && !error) error = errno;
    if (!error && (rename(temporary, path) != 0 || !sync_folder(path))) error = errno;
    if (error) unlink(temporary);
    return error;
}

// 0 or errno.
static int write_checkpoint(struct rn_checkpoint_writer *w) {
    char temporary[sizeof w->path + 16], sealed[65];
    snprintf(temporary, sizeof temporary, "%s.partial", w->path);
    int fd = open(temporary, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (fd < 0) return errno;
    int error = rn_checkpoint_put(fd, w->header, 8, w->tensors, w->tensor_count) ? 0 : errno;
    digest(w);
    atomic_store(&w->stage, RN_SAVE_SYNCS);
    return rn_checkpoint_settle(fd, error, temporary, w->path, sealed);
}

static void *run(void *context) {
    struct rn_checkpoint_writer *w = context;
    w->error = write_checkpoint(w);
    atomic_store(&w->stage, RN_SAVE_OVER);
    return NULL;
}

char *rn_checkpoint_header(const struct rn_field *field, const struct rn_counters *counters,
                           const struct rn_viewing *viewing, const struct rn_tensor *list,
                           int count) {
    json_t *header = make_header(field, counters, viewing, list, count);
    char *text = header ? json_dumps(header, JSON_COMPACT) : NULL;
    json_decref(header);
    return text;
}

static void destroy(struct rn_checkpoint_writer *w) {
    free(w->header);
    free(w);
}

enum rn_status rn_checkpoint_begin(const struct rn_arrays *arrays,
                                   const struct rn_counters *counters, const char *path,
                                   struct rn_checkpoint_writer **ret_writer, struct rn_error *err) {
    struct rn_checkpoint_writer *w = calloc(1, sizeof *w);
    if (!w) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    snprintf(w->path, sizeof w->path, "%s", path);
    w->tensor_count = rn_checkpoint_tensors(arrays, w->tensors);
    w->tensor_count = rn_checkpoint_add_blocks(arrays, w->tensors, w->tensor_count);
    w->parameters = arrays->field->parameters.values;
    w->parameter_bytes = arrays->field->parameters.count * sizeof(float);
    w->header = rn_checkpoint_header(arrays->field, counters, NULL, w->tensors, w->tensor_count);
    if (!w->header) {
        destroy(w);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    }
    int error = pthread_create(&w->thread, NULL, run, w);
    if (error) {
        destroy(w);
        return rn_error_from_errno(err, error, path, "start a thread for the checkpoint");
    }
    *ret_writer = w;
    return RN_OK;
}

enum rn_save_stage rn_checkpoint_stage(const struct rn_checkpoint_writer *w) {
    return (enum rn_save_stage)atomic_load(&w->stage);
}

enum rn_status rn_checkpoint_end(struct rn_checkpoint_writer **writer, char ret_sha256[65],
                                 struct rn_error *err) {
    struct rn_checkpoint_writer *w = *writer;
    *writer = NULL;
    pthread_join(w->thread, NULL);
    enum rn_status status = RN_OK;
    if (w->error)
        status = rn_error_from_errno(err, w->error, w->path, "write the checkpoint");
    else
        memcpy(ret_sha256, w->sha256, sizeof w->sha256);
    destroy(w);
    return status;
}
