// Where runners come from. The local executor forks; another one could ask a cluster.
#ifndef RN_SERVER_JOBS_EXECUTOR_H
#define RN_SERVER_JOBS_EXECUTOR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "common/base/status.h"

// One started runner. Plain value; the fd is the daemon's end of the connection and its owner's.
struct rn_process {
    pid_t pid;
    int fd; // stream socket, non-blocking, close-on-exec
};

// Thread-safety: used under the control's lock. Owner: whoever created it.
struct rn_executor {
    // Starts a runner: mode "field", "ingest", "poses" or "probe". Its stderr is appended to
    // log_path (NULL: the daemon's own).
    enum rn_status (*start)(struct rn_executor *executor, const char *mode, const char *log_path,
                            struct rn_process *ret_process, struct rn_error *err);
    // Waits for its end, which must be near (its connection is closed); with `now`, or when it
    // takes longer than a moment, it is killed. Says in `ret_how` how it ended: "exit code 3",
    // "killed by signal 9 (Killed)".
    void (*end)(struct rn_executor *executor, const struct rn_process *process, bool now,
                char *ret_how, size_t how_size);
    // Bytes of memory that it holds now, 0 when not known.
    int64_t (*memory)(struct rn_executor *executor, const struct rn_process *process);
    void (*destroy)(struct rn_executor *executor);
};

// Runs `program` on this machine, with few variables of the environment; `sandbox`: it may do only
// what its mode needs.
enum rn_status rn_local_executor_create(const char *program, bool sandbox,
                                        struct rn_executor **ret_executor,
                                        struct rn_error *err) RN_MUST_CHECK;

#endif
