// Runners of mode field on the nodes of a Slurm cluster; all others stay on this machine.
//
// A runner is a batch job of one task. It finds the daemon by a file in the shared folder, or by
// its script, which also has the secret that it must say (proto/join.h), and connects back over
// TCP. Queues, limits, priorities and the health of nodes are Slurm's: what it takes away or loses
// is asked for again.
#ifndef RN_SERVER_SLURM_SLURM_H
#define RN_SERVER_SLURM_SLURM_H

#include "server/jobs/executor.h"

// Texts are copied; NULL: not given.
struct rn_slurm_options {
    const char *data;   // the daemon's folder
    const char *shared; // a folder that all nodes see at the same path; `data` lies in it; NULL:
                        // what a runner reads and writes travels over its connection, and
    const char *cache;  // is kept below this folder of its node, up to
    int64_t cache_bytes;
    const char *runner; // the runner's program, by its path on the nodes
    const char *listen; // HOST:PORT where nodes reach this daemon; NULL: its own name, any port
    const char *partition, *account, *flags; // of sbatch; flags: several, by spaces
    int64_t time_s, gpus, memory_bytes;      // a job; 0: as Slurm has it
    int threads;                             // cores a job; 0: as Slurm has it
    bool sandbox;
};

// `local` starts what is wanted on this machine and is taken over on success. Jobs of an earlier
// daemon on the same folder are found again. RN_ERROR_UNSUPPORTED where Slurm is not installed,
// RN_ERROR_INVALID where `data` is not in `shared`.
enum rn_status rn_slurm_executor_create(const struct rn_slurm_options *options,
                                        struct rn_executor *local,
                                        struct rn_executor **ret_executor,
                                        struct rn_error *err) RN_MUST_CHECK;

#endif
