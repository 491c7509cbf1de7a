#include <string.h>
#include <strings.h>

#include "common/base/names.h"
#include "server/http/exchange.h"

const struct rn_caller *rn_request_caller(const struct rn_request *request) {
    return &request->caller;
}

unsigned rn_request_flags(const struct rn_request *request) {
    return request->match.route->flags;
}

const char *rn_request_traceparent(const struct rn_request *request) {
    return request->traceparent;
}

int64_t rn_request_begin_ns(const struct rn_request *request) {
    return request->begin_ns;
}

const char *rn_request_param(const struct rn_request *request, int i) {
    return i < request->match.param_count ? request->match.params[i] : "";
}

const char *rn_request_query(const struct rn_request *request, const char *name) {
    return MHD_lookup_connection_value(request->connection, MHD_GET_ARGUMENT_KIND, name);
}

const char *rn_request_header(const struct rn_request *request, const char *name) {
    return MHD_lookup_connection_value(request->connection, MHD_HEADER_KIND, name);
}

bool rn_request_has_type(const struct rn_request *request, const char *type) {
    const char *value = rn_request_header(request, "Content-Type");
    size_t size = strlen(type);
    return value != NULL && strncasecmp(value, type, size) == 0 &&
           (value[size] == '\0' || value[size] == ';' || value[size] == ' ');
}

struct query_check {
    const char *const *known;
    unsigned seen; // bit per known name
    struct rn_error *err;
    enum rn_status status;
};

static enum MHD_Result check_argument(void *context, enum MHD_ValueKind kind, const char *key,
                                      const char *value) {
    struct query_check *check = context;
    int i = rn_name_index(check->known, key);
    if (i < 0)
        check->status = rn_error_set(check->err, RN_ERROR_INVALID, key,
                                     "unknown query parameter; leave it out");
    else if (check->seen & 1u << i)
        check->status =
            rn_error_set(check->err, RN_ERROR_INVALID, key, "the query parameter is given twice");
    else
        check->seen |= 1u << i;
    return check->status == RN_OK ? MHD_YES : MHD_NO;
}

enum rn_status rn_request_check_query(const struct rn_request *request, const char *const *known,
                                      struct rn_error *err) {
    struct query_check check = {.known = known, .err = err, .status = RN_OK};
    MHD_get_connection_values(request->connection, MHD_GET_ARGUMENT_KIND, check_argument, &check);
    return check.status;
}
