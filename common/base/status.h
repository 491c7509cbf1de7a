// Status codes and error texts: how every fallible function reports.
//
// A function that can fail returns enum rn_status, writes its outputs (named ret_*) only on
// RN_OK, and takes an optional `struct rn_error *` that it fills with the place (a file, a JSON
// pointer, a field) and one sentence that says what is wrong and what would mend it.
#ifndef RN_COMMON_BASE_STATUS_H
#define RN_COMMON_BASE_STATUS_H

#include <stdarg.h>
#include <stdbool.h>

#define RN_MUST_CHECK __attribute__((warn_unused_result))
#define RN_PRINTF(fmt, args) __attribute__((format(printf, fmt, args)))

enum rn_status {
    RN_OK = 0,
    RN_ERROR_INVALID,      // the input is wrong: a bad value, field, file
    RN_ERROR_NOT_FOUND,    // a named thing does not exist
    RN_ERROR_CONFLICT,     // the thing is in a state that forbids this
    RN_ERROR_LIMIT,        // a stated limit would be exceeded
    RN_ERROR_NO_MEMORY,    // an allocation failed
    RN_ERROR_NO_SPACE,     // the disk is full, or a limit of it (EDQUOT, EFBIG)
    RN_ERROR_IO,           // any other failing system call
    RN_ERROR_UNSUPPORTED,  // understood, but not something this build or machine can do
    RN_ERROR_CORRUPT,      // a file of ours is damaged
    RN_ERROR_CANCELLED,    // stopped on request
    RN_ERROR_NUMERIC,      // non-finite numbers that could not be recovered from
    RN_ERROR_BUSY,         // try again later
    RN_ERROR_UNAVAILABLE,  // the peer is gone or cannot be reached
    RN_ERROR_UNAUTHORISED, // a token is missing or wrong
    RN_STATUS_COUNT
};

// Thread-safety: owned by one thread at a time.
struct rn_error {
    enum rn_status status;
    char where[256]; // file, "file:line", "file#/json/pointer" or a field's name; may be empty
    char text[512];  // one sentence: what is wrong, and the remedy
};

// Fills *err (which may be NULL) and returns `status`, so that callers can write
// `return rn_error_set(err, RN_ERROR_INVALID, path, "...")`. Long texts are cut.
enum rn_status rn_error_set(struct rn_error *err, enum rn_status status, const char *where,
                            const char *fmt, ...) RN_PRINTF(4, 5);

// As rn_error_set, with the text ("cannot VERB: ...") and the status of an errno value; ENOENT
// becomes RN_ERROR_NOT_FOUND, ENOSPC, EDQUOT and EFBIG RN_ERROR_NO_SPACE, ENOMEM
// RN_ERROR_NO_MEMORY.
enum rn_status rn_error_from_errno(struct rn_error *err, int errnum, const char *where,
                                   const char *verb);

// A stable lower-case name: "invalid", "not-found", ... Never NULL.
const char *rn_status_name(enum rn_status status);
// The inverse of rn_status_name; RN_ERROR_IO for an unknown name.
enum rn_status rn_status_from_name(const char *name);

#endif
