// Waiting for a job: its events from the daemon, over lost connections, until it ends.
#ifndef RN_CLIENT_FOLLOW_H
#define RN_CLIENT_FOLLOW_H

#include "client/api.h"
#include "client/progress.h"
#include "client/sse.h"
#include "proto/job.h"

#define RN_FOLLOW_PATIENCE_S 60 // how long a daemon that was there may be away

// Lives for the call of rn_follow_job; zero-initialise, then set what is wanted.
struct rn_follow {
    struct rn_client *client;
    // Called with every event, also those that are shown here; false gives up with `code`.
    bool (*event)(struct rn_follow *follow, const struct rn_sse_event *event);
    void *context; // of `event`
    enum rn_exit code;
    bool quiet;       // no progress line
    const char *back; // "ripnerf BACK JOB" comes back to the job; NULL: watch
    const char *tail; // what else that command needs, after the job; NULL: nothing
    const char *also; // a sentence on what the job makes, said with it; NULL: nothing
    struct rn_progress progress;
    // out: the job as last seen; rn_follow_finish frees it
    bool known;
    bool detached; // Ctrl-C: the job goes on
    struct rn_job job;
};

// Waits until the job has ended and returns what its end means: RN_EXIT_OK, RN_EXIT_CANCELLED,
// or RN_EXIT_FAILED or RN_EXIT_INVALID after printing its problem. Ctrl-C detaches, says how to
// come back, and returns RN_EXIT_FAILED. Complains when the daemon is lost (RN_EXIT_UNREACHABLE) or
// answers no more, and says the same.
enum rn_exit rn_follow_job(struct rn_follow *follow, const char *job_id);
void rn_follow_finish(struct rn_follow *follow);

bool rn_job_has_ended(const struct rn_job *job);
// One line about a job's progress (its JSON, NULL: none yet): "step 412  12.4 s ...", "12 of 200
// ETA 3.2 s"; "" when there is none. The fraction is NAN where it is not known.
void rn_format_progress(const struct rn_job *job, const char *json, double *ret_fraction,
                        char *ret_text, size_t capacity);

#endif
