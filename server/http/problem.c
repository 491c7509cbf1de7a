// Errors as application/problem+json.
#include <stdarg.h>
#include <stdio.h>

#include "proto/problem.h"
#include "server/http/message.h"

void rn_reply_no_memory(struct rn_reply *reply) {
    static char text[] =
        "{\"type\":\"/problems/internal\",\"title\":\"Something went wrong inside\",\"status\":500,"
        "\"detail\":\"the daemon is short of memory; try again later\"}";
    reply->status = 500;
    reply->content_type = "application/problem+json";
    reply->body = RN_BODY_CONSTANT;
    reply->bytes = (uint8_t *)text;
    reply->size = sizeof text - 1;
}

static void reply_json(struct rn_reply *reply, int status, char *json, size_t size) {
    if (json == NULL)
        rn_reply_no_memory(reply);
    else
        rn_reply_bytes(reply, status, "application/problem+json", (uint8_t *)json, size);
    if (reply->status == 429 || reply->status == 503) rn_reply_header(reply, "Retry-After", "2");
}

void rn_reply_problem(struct rn_reply *reply, enum rn_problem_type type, const char *fmt, ...) {
    char detail[1000], *json = NULL;
    size_t size = 0;
    va_list args;
    va_start(args, fmt);
    vsnprintf(detail, sizeof detail, fmt, args);
    va_end(args);
    if (rn_problem_json(type, detail, NULL, &json, &size) != RN_OK) json = NULL;
    reply_json(reply, rn_problem_http_status(type), json, size);
}

void rn_reply_error(struct rn_reply *reply, const struct rn_error *err) {
    char *json = NULL;
    size_t size = 0;
    if (rn_problem_json_from_error(err, &json, &size) != RN_OK) json = NULL;
    reply_json(reply, rn_problem_http_status(rn_problem_type_of(err->status)), json, size);
}

void rn_reply_invalid(struct rn_reply *reply, const struct rn_field_errors *errors,
                      const struct rn_error *err) {
    enum rn_problem_type type = rn_problem_type_of(err->status);
    if (errors->malformed) type = RN_PROBLEM_MALFORMED;
    char *json = NULL;
    size_t size = 0;
    if (rn_problem_json(type, err->text, errors->count > 0 ? errors : NULL, &json, &size) != RN_OK)
        json = NULL;
    reply_json(reply, rn_problem_http_status(type), json, size);
}
