// Pictures by a deadline go before everything else: a runner of another scene that trains, or works
// at a job, stands still on this machine until they are answered.
#include "common/base/clock.h"
#include "common/settings/curve.h"
#include "server/jobs/inside.h"

#define LONGEST_MS 1000.0 // deadlines beyond it leave time to share the cores
// However many pictures follow one another, of every second as much is the others'.
#define CYCLE_NS 1000000000ll
#define REST_NS 50000000ll

static bool is_urgent(const struct rn_render *render, int64_t now_ns) {
    double asked_ms;
    return render->sent && rn_budget_of(render->request.settings, &asked_ms) == RN_BUDGET_TIME &&
           asked_ms <= LONGEST_MS && now_ns < render->begin_ns + (int64_t)(asked_ms * 1e6);
}

static bool has_urgent(const struct rn_control *control, int64_t now_ns) {
    for (const struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next)
        for (const struct rn_render *render = runner->renders; render != NULL;
             render = render->next)
            if (!runner->process.remote && is_urgent(render, now_ns)) return true;
    return false;
}

// One that works, but at no picture, and is not asked to make room for one.
static bool can_wait(const struct rn_runner *runner) {
    return !runner->process.remote && runner->state == RN_RUNNER_READY && !runner->broken &&
           runner->renders == NULL && !runner->rests && !rn_runner_imports(runner) &&
           !rn_runner_is_idle(runner);
}

void rn_hold_others(struct rn_control *control) {
    int64_t now_ns = rn_clock_ns();
    bool urgent = has_urgent(control, now_ns);
    if (control->executor->hold == NULL) return;
    if (!urgent || control->urgent_ns == 0) control->urgent_ns = urgent ? now_ns : 0;
    if ((now_ns - control->urgent_ns) % CYCLE_NS >= CYCLE_NS - REST_NS) urgent = false;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        bool hold = urgent && can_wait(runner);
        if (hold == runner->held) continue;
        runner->held = hold;
        control->executor->hold(control->executor, &runner->process, hold);
    }
}
