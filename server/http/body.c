#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/http/exchange.h"

#define MAX_UPLOADS 16 // at once

void rn_sink_init(struct rn_sink *sink, uint64_t max_bytes) {
    *sink = (struct rn_sink){.fd = -1, .max = max_bytes};
    rn_buf_init(&sink->memory, (size_t)max_bytes);
}

static void fail(struct rn_sink *sink, enum rn_status status, const char *text) {
    if (sink->error.status == RN_OK) (void)rn_error_set(&sink->error, status, "body", "%s", text);
}

bool rn_sink_write(struct rn_sink *sink, const char *bytes, size_t size) {
    if (sink->error.status == RN_OK && size > sink->max - sink->size) {
        char text[128];
        snprintf(text, sizeof text, "the body is larger than the limit of %llu bytes",
                 (unsigned long long)sink->max);
        fail(sink, RN_ERROR_LIMIT, text);
    }
    if (sink->error.status != RN_OK) return false;
    sink->size += size;
    if (sink->fd >= 0) {
        if (!rn_write_all(sink->fd, bytes, size))
            (void)rn_error_from_errno(&sink->error, errno, "upload", "write what was sent");
    } else {
        rn_buf_append(&sink->memory, bytes, size);
        if (sink->memory.failed) fail(sink, RN_ERROR_NO_MEMORY, "no memory for the body");
    }
    return sink->error.status == RN_OK;
}

enum rn_status rn_sink_close(struct rn_sink *sink, struct rn_error *err) {
    if (sink->fd >= 0) {
        if (sink->error.status == RN_OK && fsync(sink->fd) != 0)
            (void)rn_error_from_errno(&sink->error, errno, "upload", "write what was sent");
        close(sink->fd);
        sink->fd = -1;
    }
    if (sink->error.status != RN_OK && err != NULL) *err = sink->error;
    return sink->error.status;
}

void rn_sink_finish(struct rn_sink *sink) {
    if (sink->fd >= 0) close(sink->fd);
    if (sink->path != NULL && !sink->stays) unlink(sink->path);
    free(sink->path);
    rn_buf_finish(&sink->memory);
    sink->fd = -1;
    sink->path = NULL;
}

// What all uploads together may take: so many at once, and no more than the disk has.
static enum rn_status check_room(struct rn_request *request, const char *folder,
                                 struct rn_error *err) {
    struct rn_http *http = request->http;
    unsigned uploads = 0;
    uint64_t coming = rn_body_size(request);
    struct statvfs disk;
    pthread_mutex_lock(&http->lock);
    for (const struct rn_request *at = http->requests; at != NULL; at = at->next) {
        if (at->sink.path == NULL || at->handled) continue;
        uint64_t announced = rn_body_size(at);
        uploads++;
        coming += announced > at->sink.size ? announced - at->sink.size : 0;
    }
    pthread_mutex_unlock(&http->lock);
    if (uploads >= MAX_UPLOADS)
        return rn_error_set(err, RN_ERROR_BUSY, "", "%u uploads are under way, the limit", uploads);
    if (statvfs(folder, &disk) == 0 && coming > (uint64_t)disk.f_bavail * disk.f_frsize)
        return rn_error_set(err, RN_ERROR_NO_SPACE, "upload",
                            "the uploads under way and this one are %llu bytes; the disk has %llu",
                            (unsigned long long)coming,
                            (unsigned long long)disk.f_bavail * disk.f_frsize);
    return RN_OK;
}

enum rn_status rn_request_spool(struct rn_request *request, const char *folder, uint64_t max_bytes,
                                struct rn_error *err) {
    struct rn_sink *sink = &request->sink;
    char *path = NULL;
    enum rn_status room = check_room(request, folder, err);
    if (room != RN_OK) return room;
    if (asprintf(&path, "%s/upload-XXXXXX", folder) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "upload", "no memory for an upload");
    int fd = mkostemp(path, O_CLOEXEC);
    if (fd < 0) {
        enum rn_status status = rn_error_from_errno(err, errno, "upload", "begin it");
        free(path);
        return status;
    }
    sink->fd = fd;
    sink->path = path;
    sink->max = max_bytes;
    return RN_OK;
}

enum rn_status rn_request_append(struct rn_request *request, const char *path, uint64_t offset,
                                 uint64_t max_bytes, struct rn_error *err) {
    struct rn_sink *sink = &request->sink;
    enum rn_status room = check_room(request, path, err);
    if (room != RN_OK) return room;
    char *copy = strdup(path);
    int fd = copy != NULL ? open(path, O_WRONLY | O_CLOEXEC | O_NOFOLLOW) : -1;
    if (fd < 0 || lseek(fd, (off_t)offset, SEEK_SET) < 0) {
        enum rn_status status =
            rn_error_from_errno(err, copy != NULL ? errno : ENOMEM, "upload", "go on with it");
        if (fd >= 0) close(fd);
        free(copy);
        return status;
    }
    sink->fd = fd;
    sink->path = copy;
    sink->stays = true;
    sink->max = max_bytes;
    return RN_OK;
}

const char *rn_request_spooled(const struct rn_request *request, uint64_t *ret_size) {
    *ret_size = request->sink.size;
    return request->sink.path;
}

void rn_request_take_spooled(struct rn_request *request) {
    free(request->sink.path);
    request->sink.path = NULL;
}

const uint8_t *rn_request_body(const struct rn_request *request, size_t *ret_size) {
    const struct rn_buf *memory = &request->sink.memory;
    *ret_size = memory->size;
    return memory->data != NULL ? memory->data : (const uint8_t *)"";
}
