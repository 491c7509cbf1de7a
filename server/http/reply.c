#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/http/message.h"
#include "server/http/ring.h"

void rn_reply_header(struct rn_reply *reply, const char *name, const char *fmt, ...) {
    if (reply->header_count == RN_REPLY_MAX_HEADERS) return;
    char *value = reply->headers[reply->header_count].value;
    size_t capacity = sizeof reply->headers[0].value;
    va_list args;
    va_start(args, fmt);
    vsnprintf(value, capacity, fmt, args);
    va_end(args);
    value[strcspn(value, "\r\n")] = '\0';
    reply->headers[reply->header_count++].name = name;
}

void rn_reply_bytes(struct rn_reply *reply, int status, const char *content_type, uint8_t *bytes,
                    size_t size) {
    reply->status = status;
    reply->content_type = content_type;
    reply->body = RN_BODY_BYTES;
    reply->bytes = bytes;
    reply->size = size;
}

void rn_reply_text(struct rn_reply *reply, int status, const char *content_type, const char *text) {
    char *copy = strdup(text);
    if (copy == NULL) {
        rn_reply_no_memory(reply);
        return;
    }
    rn_reply_bytes(reply, status, content_type, (uint8_t *)copy, strlen(copy));
}

void rn_reply_empty(struct rn_reply *reply, int status) {
    reply->status = status;
    reply->body = RN_BODY_NONE;
}

void rn_reply_file(struct rn_reply *reply, const char *content_type, const char *path) {
    struct stat info;
    struct rn_error err = {0};
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0 || fstat(fd, &info) != 0) {
        (void)rn_error_from_errno(&err, errno, path, "open");
    } else if (!S_ISREG(info.st_mode)) {
        (void)rn_error_set(&err, RN_ERROR_NOT_FOUND, path, "not a file");
    } else {
        reply->status = 200;
        reply->content_type = content_type;
        reply->body = RN_BODY_FILE;
        reply->size = (size_t)info.st_size;
        reply->fd = fd;
        return;
    }
    if (fd >= 0) close(fd);
    rn_reply_error(reply, &err);
}

void rn_reply_stream(struct rn_reply *reply, const char *content_type, struct rn_stream stream) {
    reply->status = 200;
    reply->content_type = content_type;
    reply->body = RN_BODY_STREAM;
    reply->stream = stream;
}

void rn_reply_events(struct rn_reply *reply, struct rn_ring *ring, uint64_t after_id) {
    reply->status = 200;
    reply->content_type = "text/event-stream";
    reply->body = RN_BODY_EVENTS;
    reply->ring = ring;
    reply->after_id = after_id;
}

void rn_reply_finish(struct rn_reply *reply) {
    if (reply->body == RN_BODY_BYTES) free(reply->bytes);
    if (reply->body == RN_BODY_FILE && reply->fd >= 0) close(reply->fd);
    if (reply->body == RN_BODY_STREAM && reply->stream.close != NULL)
        reply->stream.close(reply->stream.context);
    if (reply->body == RN_BODY_EVENTS) rn_ring_unref(&reply->ring);
    *reply = (struct rn_reply){0};
}
