// Server-sent events, parsed as they arrive.
#ifndef RN_CLIENT_SSE_H
#define RN_CLIENT_SSE_H

#include <stdbool.h>
#include <stddef.h>

#include "common/base/buf.h"

#define RN_SSE_MAX_EVENT (4u << 20) // bytes of one event's data
#define RN_SSE_MAX_LINE (RN_SSE_MAX_EVENT + 16)

// Lives for the callback.
struct rn_sse_event {
    const char *type; // "message" where the stream names none
    const char *data;
    size_t size_bytes; // of data
};

// Thread-safety: one thread at a time. Owner: the caller; rn_sse_finish.
struct rn_sse {
    bool (*receive)(void *context, const struct rn_sse_event *event);
    void *context;
    char last_id[64]; // of the last event that was delivered, "" at first
    // private
    struct rn_buf line, data;
    char type[32], id[64];
};

// `receive` gets every event that has data; false from it stops the parsing.
void rn_sse_init(struct rn_sse *sse, bool (*receive)(void *, const struct rn_sse_event *),
                 void *context);
void rn_sse_finish(struct rn_sse *sse);
// Drops a half-received event, for the next stream; last_id stays.
void rn_sse_restart(struct rn_sse *sse);
// Takes the next bytes of the stream (lines end in LF or CRLF). False when `receive` said so or an
// event is larger than RN_SSE_MAX_EVENT.
bool rn_sse_feed(struct rn_sse *sse, const char *bytes, size_t size_bytes);

#endif
