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
                           const struct rn_tensor *list, int count) {
    json_t *state = rn_checkpoint_state(field, counters);
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

static bool write_all(int fd, const void *data, size_t bytes) {
    const char *at = data;
    while (bytes > 0) {
        ssize_t n = write(fd, at, bytes);
        if (n < 0 && errno == EINTR) continue;
        if (n == 0) errno = EIO;
        if (n <= 0) return false;
        at += n;
        bytes -= (size_t)n;
    }
    return true;
}

static bool write_file(int fd, const struct rn_checkpoint_writer *w) {
    uint64_t length = strlen(w->header), padded = (length + 7) / 8 * 8;
    bool ok = write_all(fd, &padded, sizeof padded) && write_all(fd, w->header, length) &&
              write_all(fd, "       ", padded - length);
    for (int i = 0; ok && i < w->tensor_count; i++)
        ok = write_all(fd, w->tensors[i].data, w->tensors[i].bytes);
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

// 0 or errno.
static int write_checkpoint(struct rn_checkpoint_writer *w) {
    char temporary[sizeof w->path + 16];
    snprintf(temporary, sizeof temporary, "%s.partial", w->path);
    int fd = open(temporary, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (fd < 0) return errno;
    int error = write_file(fd, w) ? 0 : errno;
    digest(w);
    atomic_store(&w->stage, RN_SAVE_SYNCS);
    char sealed[65];
    if (!error && rn_seal_close(fd, temporary, sealed, NULL) != RN_OK) error = errno ? errno : EIO;
    if (!error && fsync(fd) != 0) error = errno;
    if (close(fd) != 0 && !error) error = errno;
    if (!error && (rename(temporary, w->path) != 0 || !sync_folder(w->path))) error = errno;
    if (error) unlink(temporary);
    return error;
}

static void *run(void *context) {
    struct rn_checkpoint_writer *w = context;
    w->error = write_checkpoint(w);
    atomic_store(&w->stage, RN_SAVE_OVER);
    return NULL;
}

static char *header_text(const struct rn_field *field, const struct rn_counters *counters,
                         const struct rn_checkpoint_writer *w) {
    json_t *header = make_header(field, counters, w->tensors, w->tensor_count);
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
    w->header = header_text(arrays->field, counters, w);
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
