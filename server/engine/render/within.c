#include "server/engine/render/within.h"

#include <math.h>

#include "common/base/clock.h"

#define SKETCH_SHARE 0.12 // of the time, for the first picture
#define PLANNED 0.9       // of the time left, what the next one may be expected to take
#define AMPLE 2.0         // times what the full picture takes: it is rendered as if without end
#define FIRST_SHARE 0.6   // of the time left, until which a first picture must be there
#define SLOWER 2.0        // times as slow as thought, when it was not
#define MOST_PICTURES 5   // one after another
#define MOST_SLOWNESS 50.0
#define LEAST_TIMED_MS 0.5 // a picture's time, for it to say how slow the next one will be
#define TRACES_ALL 1e-6    // a tolerance below this leaves no pixel out

struct attempt {
    struct rn_engine *engine;
    struct rn_field *field;
    struct rn_render_options options;
    struct rn_render_budget *budget;
    bool (*keep_going)(void *context);
    void *context;
    struct rn_render_result *result; // the best so far
    struct rn_render_spent spent;
};

static double left_ms(const struct attempt *a) {
    return (double)(a->budget->deadline_ns - rn_clock_ns()) * 1e-6;
}

// The best choice that is expected to be done in `ms`; the quickest where none is.
static size_t best_within(const struct rn_render_budget *budget, double ms) {
    size_t best = 0;
    for (size_t i = 1; i < budget->count; i++)
        if (budget->choices[i].ms * budget->slowness <= ms) best = i;
    return best;
}

static bool is_full(const struct attempt *a, size_t choice) {
    return choice + 1 == a->budget->count;
}

// One picture, in place of the one before. `timed`: by the deadline, else however long it takes.
static enum rn_status try_choice(struct attempt *a, size_t choice, bool timed,
                                 struct rn_error *err) {
    const struct rn_render_choice *wanted = &a->budget->choices[choice];
    struct rn_render_result result;
    int64_t began_ns = rn_clock_ns();
    a->options.settings = wanted->settings;
    a->options.deadline_ns = timed ? a->budget->deadline_ns : 0;
    a->options.first_ns = began_ns + (int64_t)(FIRST_SHARE * left_ms(a) * 1e6);
    enum rn_status status =
        rn_render(a->engine, a->field, &a->options, a->keep_going, a->context, &result, err);
    double ms = (double)(rn_clock_ns() - began_ns) * 1e-6;
    a->spent.ms += ms;
    if (status != RN_OK) return status;
    if (!timed && ms >= LEAST_TIMED_MS)
        a->budget->slowness = fmin(fmax(ms / wanted->ms, 1 / MOST_SLOWNESS), MOST_SLOWNESS);
    rn_render_result_finish(a->result);
    *a->result = result;
    a->spent.choice = choice;
    a->spent.settings = wanted->settings;
    a->spent.settings.tolerance = result.stats.tolerance;
    return RN_OK;
}

// What there was no time for leaves the picture before, and the next attempt expects less.
static enum rn_status improve(struct attempt *a, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (int i = 0; i < MOST_PICTURES && status == RN_OK; i++) {
        double left = left_ms(a);
        size_t next = best_within(a->budget, PLANNED * left);
        bool ample =
            is_full(a, next) && AMPLE * a->budget->choices[next].ms * a->budget->slowness <= left;
        if (next <= a->spent.choice) break;
        status = try_choice(a, next, !ample, err);
        if (status == RN_OK && a->spent.settings.tolerance > TRACES_ALL) break;
        if (status != RN_ERROR_LIMIT) continue;
        a->budget->slowness = fmin(SLOWER * a->budget->slowness, MOST_SLOWNESS);
        status = RN_OK;
    }
    return status;
}

enum rn_status rn_render_within(struct rn_engine *engine, struct rn_field *field,
                                const struct rn_render_options *options,
                                struct rn_render_budget *budget, bool (*keep_going)(void *context),
                                void *context, struct rn_render_result *ret_result,
                                struct rn_render_spent *ret_spent, struct rn_error *err) {
    struct rn_render_result result = {0};
    struct attempt a = {engine, field, *options, budget, keep_going, context, &result, {0}};
    size_t sketch = best_within(budget, SKETCH_SHARE * left_ms(&a));
    enum rn_status status = try_choice(&a, sketch, false, err);
    if (status == RN_OK) status = improve(&a, err);
    if (status != RN_OK) {
        rn_render_result_finish(&result);
        return status;
    }
    *ret_result = result;
    *ret_spent = a.spent;
    return RN_OK;
}
