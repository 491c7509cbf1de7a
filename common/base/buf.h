// A growing byte buffer with a hard maximum.
#ifndef RN_COMMON_BASE_BUF_H
#define RN_COMMON_BASE_BUF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

// Failure is sticky: once an append would pass `max` or an allocation fails, `failed` is set, the
// data stay as they were and later appends do nothing; so a caller checks once, at the end.
// Thread-safety: one thread at a time. Owner of `data`: the buffer; rn_buf_finish or rn_buf_take.
struct rn_buf {
    uint8_t *data;   // `size` bytes and a NUL; NULL before the first append
    size_t size;     // bytes
    size_t capacity; // bytes, the NUL's included
    size_t max;      // bytes of data at most
    bool failed;
};

// An empty buffer that never holds more than max_bytes.
void rn_buf_init(struct rn_buf *buf, size_t max_bytes);
// Frees the data and zeroes all but `max`, so that the buffer can be used again. Idempotent.
void rn_buf_finish(struct rn_buf *buf);

void rn_buf_append(struct rn_buf *buf, const void *bytes, size_t size_bytes);
void rn_buf_printf(struct rn_buf *buf, const char *fmt, ...) RN_PRINTF(2, 3);

// RN_OK, or when it has failed RN_ERROR_LIMIT with `what` named: "what is larger than N bytes, or
// memory ran out".
enum rn_status rn_buf_status(const struct rn_buf *buf, const char *what,
                             struct rn_error *err) RN_MUST_CHECK;

// Hands the data over to the caller, who frees them; the buffer is empty again. NULL when the
// buffer has failed (it is finished then) or when nothing was ever appended.
uint8_t *rn_buf_take(struct rn_buf *buf, size_t *ret_size);

#endif
