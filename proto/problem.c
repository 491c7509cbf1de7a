#include "proto/problem.h"

#include <stdio.h>
#include <string.h>

#include "common/base/utf8.h"

static const struct {
    const char *slug, *title;
    int status;
} kinds[RN_PROBLEM_TYPE_COUNT] = {
    [RN_PROBLEM_MALFORMED] = {"malformed", "The body is not valid JSON", 400},
    [RN_PROBLEM_UNAUTHORISED] = {"unauthorised", "A token is needed", 401},
    [RN_PROBLEM_FORBIDDEN] = {"forbidden", "Not allowed from here", 403},
    [RN_PROBLEM_NOT_FOUND] = {"not-found", "No such thing", 404},
    [RN_PROBLEM_METHOD_NOT_ALLOWED] = {"method-not-allowed", "The method is not allowed here", 405},
    [RN_PROBLEM_NOT_ACCEPTABLE] = {"not-acceptable", "No acceptable picture format", 406},
    [RN_PROBLEM_CONFLICT] = {"conflict", "In conflict with what is there", 409},
    [RN_PROBLEM_CANCELLED] = {"cancelled", "It was cancelled", 409},
    [RN_PROBLEM_TOO_LARGE] = {"too-large", "A limit would be exceeded", 413},
    [RN_PROBLEM_MEDIA_TYPE] = {"media-type", "Unknown Content-Type", 415},
    [RN_PROBLEM_INVALID] = {"invalid", "A value is not valid", 422},
    [RN_PROBLEM_UNSUPPORTED] = {"unsupported", "Not possible here", 422},
    [RN_PROBLEM_QUEUE_FULL] = {"queue-full", "Too many jobs wait", 429},
    [RN_PROBLEM_TOO_MANY_REQUESTS] = {"too-many-requests", "Too many requests", 429},
    [RN_PROBLEM_INTERNAL] = {"internal", "Something went wrong inside", 500},
    [RN_PROBLEM_CORRUPT] = {"corrupt", "A stored file is damaged", 500},
    [RN_PROBLEM_NUMERIC] = {"numeric", "The numbers diverged", 500},
    [RN_PROBLEM_RUNNER_LOST] = {"runner-lost", "A runner ended", 500},
    [RN_PROBLEM_BUSY] = {"busy", "Busy", 503},
    [RN_PROBLEM_UNAVAILABLE] = {"unavailable", "Not available", 503},
    [RN_PROBLEM_NO_SPACE] = {"no-space", "The disk is full", 507},
};

static const enum rn_problem_type of_status[RN_STATUS_COUNT] = {
    [RN_OK] = RN_PROBLEM_INTERNAL,
    [RN_ERROR_INVALID] = RN_PROBLEM_INVALID,
    [RN_ERROR_NOT_FOUND] = RN_PROBLEM_NOT_FOUND,
    [RN_ERROR_CONFLICT] = RN_PROBLEM_CONFLICT,
    [RN_ERROR_LIMIT] = RN_PROBLEM_TOO_LARGE,
    [RN_ERROR_NO_MEMORY] = RN_PROBLEM_INTERNAL,
    [RN_ERROR_NO_SPACE] = RN_PROBLEM_NO_SPACE,
    [RN_ERROR_IO] = RN_PROBLEM_INTERNAL,
    [RN_ERROR_UNSUPPORTED] = RN_PROBLEM_UNSUPPORTED,
    [RN_ERROR_CORRUPT] = RN_PROBLEM_CORRUPT,
    [RN_ERROR_CANCELLED] = RN_PROBLEM_CANCELLED,
    [RN_ERROR_NUMERIC] = RN_PROBLEM_NUMERIC,
    [RN_ERROR_BUSY] = RN_PROBLEM_BUSY,
    [RN_ERROR_UNAVAILABLE] = RN_PROBLEM_UNAVAILABLE,
    [RN_ERROR_UNAUTHORISED] = RN_PROBLEM_UNAUTHORISED,
};

#define S struct rn_field_error
static const struct rn_field_spec field_error[] = {
    RN_F_TEXT(S, pointer, RN_REQUIRED, NULL),
    RN_F_TEXT(S, detail, RN_REQUIRED, NULL),
};
static const struct rn_table field_error_table = RN_TABLE(S, "a field's error", field_error);
#undef S

#define S struct rn_api_problem
static const struct rn_field_spec api_problem[] = {
    RN_F_TEXT(S, type, RN_REQUIRED, NULL),
    RN_F_TEXT(S, title, RN_REQUIRED, NULL),
    RN_F_INT(S, status, RN_REQUIRED, 400, 599),
    RN_F_TEXT(S, detail, RN_REQUIRED, NULL),
    RN_F_TEXT(S, instance, 0, NULL),
    RN_F_OBJECTS(S, errors, error_count, 0, &field_error_table, RN_FIELD_ERRORS_MAX),
};
const struct rn_table rn_api_problem_table = RN_TABLE(S, "a problem", api_problem);
#undef S

int rn_problem_http_status(enum rn_problem_type type) {
    return kinds[type].status;
}

enum rn_problem_type rn_problem_type_of(enum rn_status status) {
    return (unsigned)status < RN_STATUS_COUNT ? of_status[status] : RN_PROBLEM_INTERNAL;
}

enum rn_status rn_problem_json(enum rn_problem_type type, const char *detail,
                               const struct rn_field_errors *errors, char **ret_json,
                               size_t *ret_size) {
    struct rn_api_problem problem = {.status = kinds[type].status};
    snprintf(problem.type, sizeof problem.type, "/problems/%s", kinds[type].slug);
    snprintf(problem.title, sizeof problem.title, "%s", kinds[type].title);
    snprintf(problem.detail, sizeof problem.detail, "%s", detail);
    rn_utf8_clean(problem.detail); // it may quote what a client sent, or be cut in a character
    struct rn_field_errors clean = {.count = 0};
    if (errors) {
        clean = *errors;
        problem.errors = clean.items;
        problem.error_count = clean.count;
    }
    for (size_t i = 0; i < problem.error_count; i++) {
        rn_utf8_clean(clean.items[i].pointer);
        rn_utf8_clean(clean.items[i].detail);
    }
    return rn_encode(&rn_api_problem_table, &problem, ret_json, ret_size, NULL);
}

enum rn_status rn_problem_json_from_error(const struct rn_error *err, char **ret_json,
                                          size_t *ret_size) {
    char detail[1024];
    snprintf(detail, sizeof detail, "%s%s%s", err->where, *err->where ? ": " : "", err->text);
    struct rn_field_errors errors = {.count = 0};
    if (*err->where == '#') rn_field_errors_add(&errors, err->where, "%.255s", err->text);
    return rn_problem_json(rn_problem_type_of(err->status), detail, &errors, ret_json, ret_size);
}
