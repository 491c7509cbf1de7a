// What every verb of the client gets, and what it says when it is done.
#ifndef RN_CLIENT_CLIENT_H
#define RN_CLIENT_CLIENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>

#include "client/http.h"
#include "client/options.h"
#include "common/base/status.h"

// Scripts depend on these numbers.
enum rn_exit {
    RN_EXIT_OK = 0,
    RN_EXIT_FAILED = 1,
    RN_EXIT_USAGE = 2,
    RN_EXIT_NOT_FOUND = 3,
    RN_EXIT_INVALID = 4, // validation failed, here or in the daemon
    RN_EXIT_CANCELLED = 5,
    RN_EXIT_UNREACHABLE = 6,
    RN_EXIT_UNAUTHORISED = 7,
};

// Thread-safety: one thread at a time.
struct rn_client {
    struct rn_http *http; // NULL for a verb that needs no daemon
    bool json;            // results as JSON
};

// A verb of the command line.
struct rn_verb {
    const char *name, *arguments, *summary;
    const char *details; // more lines of help, or NULL
    size_t args_min, args_max;
    const struct rn_option *table; // into the struct of options_size bytes
    size_t options_size;
    bool local; // needs no daemon
    // `args` are args_min..args_max words and a NULL.
    enum rn_exit (*run)(struct rn_client *client, const void *options, const char **args);
};
#define RN_VERB_MAX_ARGS 24

// Each ends with a NULL name.
extern const struct rn_verb rn_verbs_dataset[]; // validate import synth datasets
extern const struct rn_verb rn_verbs_job[];     // train jobs watch pause resume finish cancel
extern const struct rn_verb rn_verbs_scene[];   // scenes show rm info
extern const struct rn_verb rn_verbs_render[];  // render eval
extern const struct rn_verb rn_verbs_path[];    // path turntable paths
extern const struct rn_verb rn_verbs_curve[];   // curve
extern const struct rn_verb rn_verbs_effects[]; // effects
extern const struct rn_verb rn_verbs_ladder[];  // ladder
extern const struct rn_verb rn_verbs_export[];  // export
extern const struct rn_verb rn_verbs_token[];   // token
extern const struct rn_verb rn_verbs_backup[];  // backup restore
extern const struct rn_verb rn_verbs_bench[];   // bench
extern const struct rn_verb rn_verbs_doctor[];  // doctor

// Prints text from outside with '?' for control characters, which a terminal might obey.
void rn_client_print(FILE *out, const char *text);

// From here on what a problem says of a member of a request is said of the verb's option.
void rn_client_errors_of(const struct rn_verb *verb);
// From here on errors are JSON on stderr: {"error": {where, detail, exit_code}}, or where the
// daemon said what is wrong, its problem document in the same place.
void rn_client_errors_as_json(void);
// Prints "ripnerf: where: text" on stderr and returns the exit code that the status stands for.
enum rn_exit rn_client_fail(const struct rn_error *err);
// As rn_client_fail, of what could not be written: a failure, whatever the status.
enum rn_exit rn_client_not_written(const struct rn_error *err);
// As rn_client_fail, of any text; returns `code`.
enum rn_exit rn_client_error(enum rn_exit code, const char *where, const char *fmt, ...)
    RN_PRINTF(3, 4);
// {"error": JSON} on stderr.
void rn_client_error_json(const char *json);
// As rn_client_error, for a wrong command line.
#define rn_client_usage(where, ...) rn_client_error(RN_EXIT_USAGE, where, __VA_ARGS__)
// Before a file is made: fails where something has its name already, unless that is a file which
// `overwrite` lets go, or where the folder that it is to lie in is missing or may not be written.
enum rn_exit rn_client_check_target(const char *file, bool overwrite);
// RN_EXIT_NOT_FOUND where a file or folder that is to be read is missing.
enum rn_exit rn_client_check_source(const char *path);
// {"file", "bytes"} on stdout, of a verb whose result is a file or folder.
enum rn_exit rn_client_print_file(const char *file, int64_t bytes);
// A line on stderr beside an error or a result; none where errors are JSON.
void rn_client_note(const char *fmt, ...) RN_PRINTF(1, 2);

#endif
