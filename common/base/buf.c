#include "common/base/buf.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void rn_buf_init(struct rn_buf *buf, size_t max_bytes) {
    *buf = (struct rn_buf){.max = max_bytes < SIZE_MAX / 2 ? max_bytes : SIZE_MAX / 2};
}

void rn_buf_finish(struct rn_buf *buf) {
    free(buf->data);
    *buf = (struct rn_buf){.max = buf->max};
}

// Room for `extra` more bytes and the NUL.
static bool reserve(struct rn_buf *buf, size_t extra) {
    if (buf->failed) return false;
    if (extra > buf->max - buf->size) return !(buf->failed = true);
    size_t needed = buf->size + extra + 1;
    if (needed <= buf->capacity) return true;
    size_t capacity = needed < 64 ? 64 : needed + needed / 2;
    if (capacity > buf->max + 1) capacity = buf->max + 1;
    uint8_t *data = realloc(buf->data, capacity);
    if (!data) return !(buf->failed = true);
    buf->data = data;
    buf->capacity = capacity;
    return true;
}

void rn_buf_append(struct rn_buf *buf, const void *bytes, size_t size_bytes) {
    if (!reserve(buf, size_bytes)) return;
    if (size_bytes > 0) memcpy(buf->data + buf->size, bytes, size_bytes);
    buf->size += size_bytes;
    buf->data[buf->size] = 0;
}

void rn_buf_printf(struct rn_buf *buf, const char *fmt, ...) {
    va_list args, again;
    va_start(args, fmt);
    va_copy(again, args);
    int length = vsnprintf(NULL, 0, fmt, args);
    va_end(args);
    if (length < 0)
        buf->failed = true;
    else if (reserve(buf, (size_t)length)) {
        vsnprintf((char *)buf->data + buf->size, (size_t)length + 1, fmt, again);
        buf->size += (size_t)length;
    }
    va_end(again);
}

enum rn_status rn_buf_status(const struct rn_buf *buf, const char *what, struct rn_error *err) {
    if (!buf->failed) return RN_OK;
    return rn_error_set(err, RN_ERROR_LIMIT, what, "larger than %zu bytes, or memory ran out",
                        buf->max);
}

uint8_t *rn_buf_take(struct rn_buf *buf, size_t *ret_size) {
    if (buf->failed) rn_buf_finish(buf);
    uint8_t *data = buf->data;
    *ret_size = buf->size;
    buf->data = NULL;
    rn_buf_finish(buf);
    return data;
}
