// Pictures by a deadline go before everything else: a runner of another scene that trains, or works
// at a job, stands still on this machine until they are answered, and between two that follow one
// another (common/base/turns.h).
#include "common/base/clock.h"
#include "common/settings/curve.h"
#include "server/jobs/inside.h"

#define LONGEST_MS 1000.0  // deadlines beyond it leave time to share the cores
#define MOST_NS 50000000   // of the others' turn at once
#define SENDING_NS 1000000 // from here to the last byte in the socket, about

// Whether it was sent to be made by a deadline that others stand still for, and until when.
static bool is_timed(const struct rn_render *render, int64_t *ret_until_ns) {
    double asked_ms;
    bool timed = rn_budget_of(render->request.settings, &asked_ms) == RN_BUDGET_TIME;
    if (!timed || !render->sent || !(asked_ms <= LONGEST_MS)) return false;
    *ret_until_ns = render->begin_ns + (int64_t)(asked_ms * 1e6);
    return true;
}

static bool has_urgent(const struct rn_control *control, int64_t now_ns) {
    int64_t until_ns;
    for (const struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next)
        for (const struct rn_render *render = runner->renders; render != NULL;
             render = render->next)
            if (!runner->process.remote && is_timed(render, &until_ns) && now_ns < until_ns)
                return true;
    return false;
}

// One that works, but at no picture, and is not asked to make room for one. One that has made a
// picture just now knows the turns by itself.
static bool can_wait(const struct rn_runner *runner, int64_t now_ns) {
    return now_ns - runner->last_used_ns > RN_TURNS_NEAR_NS && !runner->process.remote &&
           runner->state == RN_RUNNER_READY && !runner->broken && runner->renders == NULL &&
           !runner->rests && !rn_runner_imports(runner) && !rn_runner_is_idle(runner);
}

void rn_hold_others(struct rn_control *control) {
    int64_t now_ns = rn_clock_ns();
    enum rn_turn turn = rn_turns_at(&control->turns, now_ns);
    bool held = turn == RN_TURN_WAITS || (turn == RN_TURN_FREE && has_urgent(control, now_ns));
    if (control->executor->hold == NULL) return;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        bool hold = held && can_wait(runner, now_ns);
        if (hold == runner->held) continue;
        runner->held = hold;
        control->executor->hold(control->executor, &runner->process, hold);
    }
}

int rn_hold_timeout_ms(const struct rn_control *control, int most_ms) {
    int64_t now_ns = rn_clock_ns();
    int64_t left_ms = (rn_turns_next_ns(&control->turns, now_ns) - now_ns) / 1000000 + 1;
    return left_ms < most_ms ? (int)left_ms : most_ms;
}

void rn_hold_after(struct rn_control *control, const struct rn_render *render) {
    int64_t until_ns;
    if (is_timed(render, &until_ns))
        rn_turns_end(&control->turns, render->begin_ns, rn_clock_ns() + SENDING_NS, MOST_NS);
}
