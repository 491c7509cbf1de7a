// Which runners are ended because they do not answer: they hang. Of one that could work and is
// given no processor, because others have them, the time that it has had counts, and not the
// clock's.
#include "server/jobs/inside.h"

#define LOOK_NS 500000000 // between two looks; also how long a silence is before more is asked

static int64_t at_most(int64_t a, int64_t b) {
    return a < b ? a : b;
}

// The clock of its silence, or of its start, stands still for what was kept from it.
static void forgive(struct rn_control *control, struct rn_runner *runner, int64_t now_ns) {
    struct rn_executor *executor = control->executor;
    if (executor->used == NULL || runner->process.remote) return;
    bool starts = runner->state == RN_RUNNER_STARTING, ready = false;
    bool asked = starts || now_ns - runner->heard_ns > LOOK_NS;
    int64_t used_ns = executor->used(executor, &runner->process, asked ? &ready : NULL);
    if (used_ns < 0) return;
    int64_t lost_ns = now_ns - runner->looked_ns - (used_ns - runner->used_ns);
    runner->looked_ns = now_ns;
    runner->used_ns = used_ns;
    if (!ready || lost_ns <= 0) return;
    runner->heard_ns += at_most(lost_ns, now_ns - runner->heard_ns);
    if (starts) runner->deadline_ns += lost_ns;
}

bool rn_runner_is_late(struct rn_control *control, struct rn_runner *runner, int64_t now_ns) {
    if (now_ns - runner->looked_ns >= LOOK_NS) forgive(control, runner, now_ns);
    if (runner->state != RN_RUNNER_READY || rn_runner_is_idle(runner)) runner->heard_ns = now_ns;
    return (runner->state != RN_RUNNER_READY && now_ns > runner->deadline_ns) ||
           now_ns - runner->heard_ns > control->options.runner_timeout_s * 1000000000ll;
}
