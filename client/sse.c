#include "client/sse.h"

#include <stdio.h>
#include <string.h>

void rn_sse_init(struct rn_sse *sse, bool (*receive)(void *, const struct rn_sse_event *),
                 void *context) {
    memset(sse, 0, sizeof *sse);
    sse->receive = receive;
    sse->context = context;
    rn_buf_init(&sse->line, RN_SSE_MAX_LINE);
    rn_buf_init(&sse->data, RN_SSE_MAX_EVENT);
}

void rn_sse_finish(struct rn_sse *sse) {
    rn_buf_finish(&sse->line);
    rn_buf_finish(&sse->data);
}

void rn_sse_restart(struct rn_sse *sse) {
    rn_sse_finish(sse);
    sse->type[0] = '\0';
    snprintf(sse->id, sizeof sse->id, "%s", sse->last_id);
}

// An empty line: the event is complete.
static bool dispatch(struct rn_sse *sse) {
    bool go_on = true;
    memcpy(sse->last_id, sse->id, sizeof sse->id);
    if (sse->data.size) {
        struct rn_sse_event event = {.type = *sse->type ? sse->type : "message",
                                     .data = (const char *)sse->data.data,
                                     .size_bytes = sse->data.size};
        go_on = sse->receive(sse->context, &event);
    }
    sse->type[0] = '\0';
    rn_buf_finish(&sse->data);
    return go_on;
}

static bool take_line(struct rn_sse *sse, const char *line, size_t size) {
    if (size && line[size - 1] == '\r') size--;
    if (!size) return dispatch(sse);
    const char *colon = memchr(line, ':', size);
    size_t name_size = colon ? (size_t)(colon - line) : size;
    const char *value = colon ? colon + 1 : line + size;
    if (value < line + size && *value == ' ') value++;
    size_t value_size = (size_t)(line + size - value);
    if (name_size == 4 && memcmp(line, "data", 4) == 0) {
        if (sse->data.size) rn_buf_append(&sse->data, "\n", 1);
        rn_buf_append(&sse->data, value, value_size);
    } else if (name_size == 5 && memcmp(line, "event", 5) == 0) {
        snprintf(sse->type, sizeof sse->type, "%.*s", (int)value_size, value);
    } else if (name_size == 2 && memcmp(line, "id", 2) == 0 && value_size < sizeof sse->id) {
        snprintf(sse->id, sizeof sse->id, "%.*s", (int)value_size, value);
    }
    return !sse->data.failed;
}

bool rn_sse_feed(struct rn_sse *sse, const char *bytes, size_t size_bytes) {
    while (size_bytes) {
        const char *end = memchr(bytes, '\n', size_bytes);
        size_t part = end ? (size_t)(end - bytes) : size_bytes;
        rn_buf_append(&sse->line, bytes, part);
        if (sse->line.failed) return false;
        if (!end) return true;
        const char *line = sse->line.data ? (const char *)sse->line.data : "";
        bool go_on = take_line(sse, line, sse->line.size);
        rn_buf_finish(&sse->line);
        if (!go_on) return false;
        bytes += part + 1;
        size_bytes -= part + 1;
    }
    return true;
}
