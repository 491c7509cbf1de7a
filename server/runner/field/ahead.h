// Pictures of a job's units that a device made in one call with an earlier one's, as small ones do
// not fill it: kept until their unit's turn comes.
#ifndef RN_SERVER_RUNNER_FIELD_AHEAD_H
#define RN_SERVER_RUNNER_FIELD_AHEAD_H

#include "server/runner/field/work.h"

#define RN_AHEAD_MOST 64 // pictures

struct rn_ahead_picture {
    size_t unit, pixels;
    struct rn_render_result result;
};
// Zero at first. Thread-safety: one thread. Owner: the kind of job, which drops it.
struct rn_ahead {
    bool told; // in the log, that there were any
    size_t count;
    struct rn_ahead_picture pictures[RN_AHEAD_MOST];
};

// How a later unit of the job is rendered; what the options borrow need not outlive the next one's.
// False: it is not to be rendered.
typedef bool rn_ahead_describe(void *context, size_t unit, struct rn_render_options *ret_options);

// The picture of unit work->done: one that was made ahead, or rendered now by these options, as
// rn_work_render does, and with it those of units to come that are of its size. Its time is an
// equal share of theirs. The caller owns it.
enum rn_status rn_ahead_render(struct rn_ahead *ahead, struct rn_work *work, struct rn_field *field,
                               const struct rn_render_options *options, rn_ahead_describe *describe,
                               void *context, struct rn_render_result *ret_result,
                               struct rn_error *err) RN_MUST_CHECK;
void rn_ahead_drop(struct rn_ahead *ahead);

#endif
