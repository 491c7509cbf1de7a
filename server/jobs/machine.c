#include "server/jobs/machine.h"

static const char *const event_names[RN_JOB_EVENT_COUNT] = {
    "start", "pause",   "resume", "finish",  "cancel",  "done",
    "fail",  "stopped", "lost",   "requeue", "give up",
};

const char *rn_job_event_name(enum rn_job_event event) {
    return event_names[event];
}

bool rn_job_is_over(enum rn_job_state state) {
    return state == RN_JOB_SUCCEEDED || state == RN_JOB_FAILED || state == RN_JOB_CANCELLED;
}

// What the user asks for, or -1.
static int command(enum rn_job_type type, enum rn_job_state state, enum rn_job_event event,
                   bool attached) {
    bool waits = state == RN_JOB_QUEUED, runs = state == RN_JOB_RUNNING;
    bool paused = state == RN_JOB_PAUSED, train = type == RN_JOB_TRAIN;
    switch (event) {
    case RN_JOB_PAUSE:
        return train && (waits || runs) ? RN_JOB_PAUSED : -1;
    case RN_JOB_RESUME:
        return paused ? RN_JOB_QUEUED : -1;
    case RN_JOB_FINISH:
        if (train && runs) return RN_JOB_RUNNING;
        if (train && paused) return attached ? RN_JOB_RUNNING : RN_JOB_QUEUED;
        return -1;
    case RN_JOB_CANCEL:
        if (state == RN_JOB_CANCELLED || state == RN_JOB_CANCELLING) return (int)state;
        if (waits || paused || runs) return attached ? RN_JOB_CANCELLING : RN_JOB_CANCELLED;
        return state == RN_JOB_INTERRUPTED ? RN_JOB_CANCELLED : -1;
    default:
        return -1;
    }
}

// What happens to the job's runner, or -1.
static int report(enum rn_job_state state, enum rn_job_event event) {
    bool active = state == RN_JOB_RUNNING || state == RN_JOB_PAUSED || state == RN_JOB_CANCELLING;
    switch (event) {
    case RN_JOB_START:
        return state == RN_JOB_QUEUED ? RN_JOB_RUNNING : -1;
    case RN_JOB_DONE:
        return active ? RN_JOB_SUCCEEDED : -1;
    case RN_JOB_FAIL:
        return active || state == RN_JOB_QUEUED ? RN_JOB_FAILED : -1;
    case RN_JOB_STOPPED:
        return active ? RN_JOB_CANCELLED : -1;
    case RN_JOB_LOST:
        if (state == RN_JOB_CANCELLING) return RN_JOB_CANCELLED;
        if (state == RN_JOB_PAUSED || state == RN_JOB_QUEUED) return (int)state;
        return state == RN_JOB_RUNNING ? RN_JOB_INTERRUPTED : -1;
    case RN_JOB_REQUEUE:
        return state == RN_JOB_INTERRUPTED ? RN_JOB_QUEUED : -1;
    case RN_JOB_GIVE_UP:
        return state == RN_JOB_INTERRUPTED ? RN_JOB_FAILED : -1;
    default:
        return -1;
    }
}

enum rn_status rn_job_next(enum rn_job_type type, enum rn_job_state state, enum rn_job_event event,
                           bool attached, enum rn_job_state *ret_state, struct rn_error *err) {
    int next = command(type, state, event, attached);
    if (next < 0) next = report(state, event);
    if (next < 0)
        return rn_error_set(err, RN_ERROR_CONFLICT, "", "cannot %s this %s job: its state is %s",
                            rn_job_event_name(event), rn_job_type_names[type],
                            rn_job_state_names[state]);
    *ret_state = (enum rn_job_state)next;
    return RN_OK;
}
