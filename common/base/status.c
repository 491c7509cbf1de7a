#include "common/base/status.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

static const char *const names[RN_STATUS_COUNT] = {
    [RN_OK] = "ok",
    [RN_ERROR_INVALID] = "invalid",
    [RN_ERROR_NOT_FOUND] = "not-found",
    [RN_ERROR_CONFLICT] = "conflict",
    [RN_ERROR_LIMIT] = "limit",
    [RN_ERROR_NO_MEMORY] = "no-memory",
    [RN_ERROR_NO_SPACE] = "no-space",
    [RN_ERROR_IO] = "io",
    [RN_ERROR_UNSUPPORTED] = "unsupported",
    [RN_ERROR_CORRUPT] = "corrupt",
    [RN_ERROR_CANCELLED] = "cancelled",
    [RN_ERROR_NUMERIC] = "numeric",
    [RN_ERROR_BUSY] = "busy",
    [RN_ERROR_UNAVAILABLE] = "unavailable",
    [RN_ERROR_UNAUTHORISED] = "unauthorised",
};

enum rn_status rn_error_set(struct rn_error *err, enum rn_status status, const char *where,
                            const char *fmt, ...) {
    if (!err) return status;
    err->status = status;
    snprintf(err->where, sizeof err->where, "%s", where ? where : "");
    va_list args;
    va_start(args, fmt);
    vsnprintf(err->text, sizeof err->text, fmt, args);
    va_end(args);
    return status;
}

enum rn_status rn_error_from_errno(struct rn_error *err, int errnum, const char *where,
                                   const char *verb) {
    enum rn_status status = RN_ERROR_IO;
    if (errnum == ENOENT) status = RN_ERROR_NOT_FOUND;
    if (errnum == ENOSPC || errnum == EDQUOT || errnum == EFBIG) status = RN_ERROR_NO_SPACE;
    if (errnum == ENOMEM) status = RN_ERROR_NO_MEMORY;
    char text[128];
    return rn_error_set(err, status, where, "cannot %s: %s", verb,
                        strerror_r(errnum, text, sizeof text));
}

const char *rn_status_name(enum rn_status status) {
    return (unsigned)status < RN_STATUS_COUNT ? names[status] : "io";
}

enum rn_status rn_status_from_name(const char *name) {
    for (int i = 0; i < RN_STATUS_COUNT; i++)
        if (strcmp(names[i], name) == 0) return (enum rn_status)i;
    return RN_ERROR_IO;
}
