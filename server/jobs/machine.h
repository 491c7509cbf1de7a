// The life of a job, as a pure function.
//
//   queued -> running -> succeeded | failed | cancelled
// with paused (nothing runs), cancelling (asked, not yet confirmed) and interrupted (its runner
// was lost; it is queued again).
#ifndef RN_SERVER_JOBS_MACHINE_H
#define RN_SERVER_JOBS_MACHINE_H

#include "common/base/status.h"
#include "proto/names.h"

enum rn_job_event {
    RN_JOB_START, // the scheduler gives it a runner
    RN_JOB_PAUSE, // asked by the user, as the next three
    RN_JOB_RESUME,
    RN_JOB_FINISH,
    RN_JOB_CANCEL,
    RN_JOB_DONE, // said by the runner, as the next two
    RN_JOB_FAIL,
    RN_JOB_STOPPED, // cancellation is confirmed
    RN_JOB_LOST,    // the runner is gone
    RN_JOB_REQUEUE, // another attempt
    RN_JOB_GIVE_UP, // too many attempts
    RN_JOB_EVENT_COUNT
};
const char *rn_job_event_name(enum rn_job_event event); // "start", "pause", ...

// The state that follows. `attached`: a runner has the job. Only training jobs pause and finish.
// RN_ERROR_CONFLICT, with the current state in the text, when the transition is illegal.
// An event that changes nothing (cancel while cancelling) gives the same state.
enum rn_status rn_job_next(enum rn_job_type type, enum rn_job_state state, enum rn_job_event event,
                           bool attached, enum rn_job_state *ret_state,
                           struct rn_error *err) RN_MUST_CHECK;

bool rn_job_is_over(enum rn_job_state state); // succeeded, failed, cancelled

#endif
