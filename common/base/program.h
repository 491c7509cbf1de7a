// Programs that are started and watched while they run: COLMAP and FFmpeg by an import, the
// commands of Slurm by the daemon.
#ifndef RN_COMMON_BASE_PROGRAM_H
#define RN_COMMON_BASE_PROGRAM_H

#include <stdbool.h>
#include <stddef.h>

#include "common/base/status.h"

#define RN_PROGRAM_LAST_WORDS 240

// Thread-safety: one thread at a time. Owner: the caller.
struct rn_program {
    const char *name; // "colmap"; RIPNERF_COLMAP in the environment names another file; or a path
    const char *package; // Debian's, for the message where it is not installed
    // Called with each line that the program writes to its output and errors, without its end;
    // NULL: none wanted.
    void (*line)(void *context, const char *line);
    // Takes the program's output as bytes instead, its errors still going to `line`; NULL: none.
    bool (*bytes)(void *context, const void *bytes, size_t size);
    bool (*keep_going)(void *context); // polled ten times a second at least; false ends the program
    void *context;
};

// The file that is started, which RIPNERF_NAME in the environment may say; NULL: not installed. A
// name with a slash is the file itself.
// Valid until the next call.
const char *rn_program_find(const char *name);

// Runs it to its end. argv: what follows the program's own name, NULL-terminated.
// RN_ERROR_UNSUPPORTED when it is not installed, with the command that installs it;
// RN_ERROR_CANCELLED; RN_ERROR_INVALID with its last words when it fails; RN_ERROR_IO when it is
// killed by a signal.
enum rn_status rn_program_run(const struct rn_program *program, const char *const *argv,
                              struct rn_error *err) RN_MUST_CHECK;

#endif
