// Errors as application/problem+json.
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "common/base/buf.h"
#include "server/http/message.h"

static void append_string(struct rn_buf *buf, const char *text) {
    rn_buf_append(buf, "\"", 1);
    for (; *text != '\0'; text++) {
        unsigned char c = (unsigned char)*text;
        if (c == '"' || c == '\\')
            rn_buf_printf(buf, "\\%c", c);
        else if (c < 32)
            rn_buf_printf(buf, "\\u%04x", c);
        else
            rn_buf_append(buf, text, 1);
    }
    rn_buf_append(buf, "\"", 1);
}

static void reply_with(struct rn_reply *reply, int status, const char *slug, const char *detail,
                       const char *where) {
    struct rn_buf buf;
    rn_buf_init(&buf, 16384);
    rn_buf_printf(&buf, "{\"type\":\"/problems/%s\",\"title\":\"%s\",\"status\":%d,\"detail\":", slug,
                  slug, status);
    append_string(&buf, detail);
    if (where != NULL && where[0] == '#') {
        rn_buf_printf(&buf, ",\"errors\":[{\"pointer\":");
        append_string(&buf, where);
        rn_buf_printf(&buf, ",\"detail\":");
        append_string(&buf, detail);
        rn_buf_printf(&buf, "}]");
    }
    rn_buf_append(&buf, "}", 1);
    size_t size;
    uint8_t *bytes = rn_buf_take(&buf, &size);
    if (bytes == NULL)
        rn_reply_empty(reply, status);
    else
        rn_reply_bytes(reply, status, "application/problem+json", bytes, size);
    if (status == 429 || status == 503) rn_reply_header(reply, "Retry-After", "2");
}

void rn_reply_problem(struct rn_reply *reply, int status, const char *slug, const char *fmt, ...) {
    char detail[1024];
    va_list args;
    va_start(args, fmt);
    vsnprintf(detail, sizeof detail, fmt, args);
    va_end(args);
    reply_with(reply, status, slug, detail, NULL);
}

void rn_reply_error(struct rn_reply *reply, const struct rn_error *err) {
    static const struct {
        int status;
        const char *slug;
    } table[RN_STATUS_COUNT] = {
        [RN_OK] = {500, "internal"},
        [RN_ERROR_INVALID] = {422, "invalid"},
        [RN_ERROR_NOT_FOUND] = {404, "not-found"},
        [RN_ERROR_CONFLICT] = {409, "conflict"},
        [RN_ERROR_LIMIT] = {413, "too-large"},
        [RN_ERROR_NO_MEMORY] = {500, "internal"},
        [RN_ERROR_NO_SPACE] = {507, "no-space"},
        [RN_ERROR_IO] = {500, "internal"},
        [RN_ERROR_UNSUPPORTED] = {422, "unsupported"},
        [RN_ERROR_CORRUPT] = {500, "corrupt"},
        [RN_ERROR_CANCELLED] = {409, "cancelled"},
        [RN_ERROR_NUMERIC] = {500, "numeric"},
        [RN_ERROR_BUSY] = {503, "busy"},
        [RN_ERROR_UNAVAILABLE] = {503, "unavailable"},
        [RN_ERROR_UNAUTHORISED] = {401, "unauthorised"},
    };
    char detail[800];
    bool named = err->where[0] != '\0' && err->where[0] != '#';
    snprintf(detail, sizeof detail, "%s%s%s", named ? err->where : "", named ? ": " : "",
             err->text);
    reply_with(reply, table[err->status].status, table[err->status].slug, detail, err->where);
}
