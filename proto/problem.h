// application/problem+json (RFC 9457); problems.md is the list for users.
#ifndef RN_PROTO_PROBLEM_H
#define RN_PROTO_PROBLEM_H

#include "proto/codec.h"

enum rn_problem_type {
    RN_PROBLEM_MALFORMED,
    RN_PROBLEM_UNAUTHORISED,
    RN_PROBLEM_FORBIDDEN,
    RN_PROBLEM_NOT_FOUND,
    RN_PROBLEM_METHOD_NOT_ALLOWED,
    RN_PROBLEM_NOT_ACCEPTABLE,
    RN_PROBLEM_CONFLICT,
    RN_PROBLEM_CANCELLED,
    RN_PROBLEM_TOO_LARGE,
    RN_PROBLEM_MEDIA_TYPE,
    RN_PROBLEM_INVALID,
    RN_PROBLEM_UNSUPPORTED,
    RN_PROBLEM_QUEUE_FULL,
    RN_PROBLEM_TOO_MANY_REQUESTS,
    RN_PROBLEM_INTERNAL,
    RN_PROBLEM_CORRUPT,
    RN_PROBLEM_NUMERIC,
    RN_PROBLEM_RUNNER_LOST,
    RN_PROBLEM_BUSY,
    RN_PROBLEM_UNAVAILABLE,
    RN_PROBLEM_NO_SPACE,
    RN_PROBLEM_TYPE_COUNT
};

// A plain value. Thread-safety: owned by one thread.
struct rn_api_problem {
    char type[64]; // "/problems/<slug>"
    char title[128];
    int64_t status; // HTTP
    char detail[1024];
    char instance[256];            // "" = absent
    struct rn_field_error *errors; // owned; NULL = absent
    size_t error_count;
};
extern const struct rn_table rn_api_problem_table;

int rn_problem_http_status(enum rn_problem_type type);
// Which type reports a status: RN_ERROR_NOT_FOUND -> RN_PROBLEM_NOT_FOUND, ...
enum rn_problem_type rn_problem_type_of(enum rn_status status);

// A problem as JSON text (as rn_encode: malloc'd). `errors` may be NULL.
enum rn_status rn_problem_json(enum rn_problem_type type, const char *detail,
                               const struct rn_field_errors *errors, char **ret_json,
                               size_t *ret_size) RN_MUST_CHECK;
// The same from a function's error: the place is put before the text; a place that is a JSON
// pointer ("#/...") also becomes an item of `errors`.
enum rn_status rn_problem_json_from_error(const struct rn_error *err, char **ret_json,
                                          size_t *ret_size) RN_MUST_CHECK;

#endif
