// Where runners come from: a table of functions. executor.c starts processes on this machine,
// server/slurm asks a cluster.
#ifndef RN_SERVER_JOBS_EXECUTOR_H
#define RN_SERVER_JOBS_EXECUTOR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

#include "common/base/status.h"

// What is asked for.
struct rn_order {
    const char *mode;     // "field", "ingest", "poses" or "probe"
    const char *scene;    // of mode field, its id; "" otherwise
    const char *folder;   // of that scene
    const char *dataset;  // the folder of its photographs
    const char *train;    // the options of a training that it is for, JSON; NULL: pictures alone
    int ranks;            // nodes that train it together; 0 or 1: one
    const char *log_path; // its stderr is appended there; NULL: the daemon's own
    bool here;            // on this machine, whatever the executor
    bool helps;           // renders beside the runner that holds the scene
};

// One runner that was asked for. Plain value; the fd is the daemon's end of the connection and its
// owner's.
struct rn_process {
    pid_t pid;   // the executor's own number where it is remote
    int fd;      // stream socket, non-blocking, close-on-exec; -1: not there yet, `look` tells
    bool remote; // not a process of this machine's
};

enum rn_where { RN_WHERE_WAITS, RN_WHERE_THERE, RN_WHERE_GONE };

// How things stand with a runner that was asked for. Plain value.
struct rn_whereabouts {
    enum rn_where where;
    char machine[64];        // "" before it is known
    char job[24];            // the cluster's number for it; "" before there is one
    char reason[160];        // why it waits
    struct rn_error refusal; // GONE because it can never be had: why; status RN_OK otherwise
};

struct rn_ending {
    char how[160]; // "exit code 3", "killed by signal 9 (Killed)", "Slurm job 7 on n1: TIMEOUT"
    bool taken;    // the machine was taken from it: no fault of what it did
};

// Thread-safety: used under the control's lock. Owner: whoever created it.
struct rn_executor {
    bool spreads; // runners of mode field do not share this machine: as many as are asked for
    bool keeps;   // remote runners outlive the daemon, for the next one to find
    // Starts a runner, or asks for it: it never blocks for long.
    enum rn_status (*start)(struct rn_executor *executor, const struct rn_order *order,
                            struct rn_process *ret_process, struct rn_error *err);
    // Tells of a runner that is remote; once it is THERE its fd is set. NULL: there are none.
    void (*look)(struct rn_executor *executor, struct rn_process *process,
                 struct rn_whereabouts *ret_whereabouts);
    // The connection has ended unasked: how the runner ended is wanted, and `look` will tell it
    // GONE.
    void (*hung_up)(struct rn_executor *executor, const struct rn_process *process);
    // Whoever calls `look` wants to be called when it would tell something new, from any thread.
    void (*watch)(struct rn_executor *executor, void (*news)(void *context), void *context);
    // The name by which a runner finds the folder of its scene; malloc'd. NULL: the folder's own.
    char *(*folder_of)(struct rn_executor *executor, const struct rn_process *process);
    // Waits for its end, which must be near (its connection is closed); with `now`, or when it
    // takes longer than a moment, it is killed. What it writes to its scene's folder from here on
    // is lost.
    void (*end)(struct rn_executor *executor, const struct rn_process *process, bool now,
                struct rn_ending *ret_ending);
    // Stops it where it is, or lets it go on: it notices nothing. NULL: it is not done.
    void (*hold)(struct rn_executor *executor, const struct rn_process *process, bool held);
    // Bytes of memory that it holds now on this machine, 0 when not known.
    int64_t (*memory)(struct rn_executor *executor, const struct rn_process *process);
    // Nanoseconds of processors that it has had here, -1 when not known; *ret_ready, unless NULL:
    // whether one of its threads could use one now. NULL: it is not known of any.
    int64_t (*used)(struct rn_executor *executor, const struct rn_process *process,
                    bool *ret_ready);
    // Where it keeps them, remote runners stay where they are.
    void (*destroy)(struct rn_executor *executor);
};

// Runs `program` on this machine, with few variables of the environment; `sandbox`: it may do only
// what its mode needs.
enum rn_status rn_local_executor_create(const char *program, bool sandbox,
                                        struct rn_executor **ret_executor,
                                        struct rn_error *err) RN_MUST_CHECK;

#endif
