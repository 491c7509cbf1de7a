#include "server/engine/render/within.h"

#include <math.h>

#include "common/base/clock.h"

#define SKETCH_SHARE 0.15 // of the time, for a first picture that tells how slow it is here
#define TIGHT 0.35        // of the time, for the quickest picture: there is none for a second one
#define PLANNED 0.95      // of the time left, what a picture may be expected to take
#define RESERVE 1.3       // times the quickest picture's time, kept until there is a first one
#define AMPLE 1.5         // times what the full picture takes: it is rendered as if without end
#define SLOWER 2.0        // times as slow as thought, when there was no time for a first picture
#define MOST_PICTURES 5   // one after another
#define MOST_SLOWNESS 50.0
#define FIRST_PASS 0.25    // of the rays
#define HEAVY 4.0          // times the samples that a full picture's ray is said to take
#define PATIENCE 3.0       // times what a picture is expected to take, or
#define PATIENCE_LEFT 0.5  // of the time left, until one that should be there long ago is given up
#define SAMPLING 0.65      // of a picture's time, that goes by its samples
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
    bool has_picture;
    bool surprised;     // a picture took much longer than was expected: nothing is ample any more
    int64_t give_up_ns; // of the picture that is rendered; 0: never
    struct rn_render_spent spent;
};

static double left_ms(const struct attempt *a) {
    return (double)(a->budget->deadline_ns - rn_clock_ns()) * 1e-6;
}

// Rays of a choice, at least: of one with a tolerance its first pass.
static double rays_of(const struct attempt *a, const struct rn_render_settings *settings) {
    const struct rn_camera *camera = &a->options.camera;
    double apart = fmax(settings->subsample, 1), side = fmax(settings->supersample, 1);
    return camera->width * (double)camera->height * side * side / (apart * apart) *
           (settings->tolerance > 0 ? FIRST_PASS : 1);
}

static double expected_ms(const struct attempt *a, size_t choice) {
    const struct rn_render_choice *c = &a->budget->choices[choice];
    return fmax(c->ms * a->budget->slowness, a->budget->ray_ms * rays_of(a, &c->settings));
}

// The best choice that is expected to be done in `ms`; the quickest where none is.
static size_t best_within(const struct attempt *a, double ms) {
    size_t best = 0;
    for (size_t i = 1; i < a->budget->count; i++)
        if (expected_ms(a, i) <= ms) best = i;
    return best;
}

// By what the picture that was made took for its samples, of which one by a deadline may have more
// or fewer than the choice had. (Rays would not do: many of them see nothing, and cost nothing.)
static void learn(struct attempt *a, const struct rn_render_choice *choice, double ms,
                  double samples) {
    double *slowness = &a->budget->slowness;
    if (ms < LEAST_TIMED_MS || !(choice->samples > 0)) return;
    double now = ms / (choice->ms * (1 - SAMPLING + SAMPLING * samples / choice->samples));
    now = fmin(fmax(now, 1 / MOST_SLOWNESS), MOST_SLOWNESS);
    *slowness = *slowness > 0 ? 0.5 * (*slowness + now) : now;
}

// By the samples of its rays, beside those of the full picture's pixels.
static void weigh(struct attempt *a, const struct rn_render_stats *stats, double ms) {
    const struct rn_camera *camera = &a->options.camera;
    const struct rn_render_choice *full = &a->budget->choices[a->budget->count - 1];
    double said = full->samples / ((double)camera->width * camera->height);
    bool heavy =
        stats->rays > 0 && said > 0 && (double)stats->samples > HEAVY * said * (double)stats->rays;
    a->budget->ray_ms = heavy ? ms / (double)stats->rays : 0;
}

// What rendering polls: a picture that should be there long ago leaves time for a quicker one.
static bool has_patience(void *context) {
    struct attempt *a = context;
    if (a->give_up_ns && rn_clock_ns() >= a->give_up_ns) a->surprised = true;
    return !(a->give_up_ns && a->surprised) && (!a->keep_going || a->keep_going(a->context));
}

// By when a picture is to be there.
enum when {
    WHENEVER, // it is done
    AMPLY,    // it is done, which should be well before the deadline
    IN_TIME,  // by the deadline, or not at all
    AT_LEAST, // by the deadline; its first pass, which is a picture, in any case
};

// One picture, in place of the one before.
static enum rn_status try_choice(struct attempt *a, size_t choice, enum when when,
                                 struct rn_error *err) {
    const struct rn_render_choice *wanted = &a->budget->choices[choice];
    struct rn_render_result result;
    int64_t began_ns = rn_clock_ns();
    double kept_ms = a->has_picture ? 0 : RESERVE * expected_ms(a, 0);
    a->options.settings = wanted->settings;
    a->options.deadline_ns = when <= AMPLY ? 0 : a->budget->deadline_ns;
    a->options.first_ns =
        when == AT_LEAST ? INT64_MAX : a->budget->deadline_ns - (int64_t)(kept_ms * 1e6);
    double patience_ms = fmax(PATIENCE * expected_ms(a, choice), PATIENCE_LEFT * left_ms(a));
    patience_ms = fmin(patience_ms, left_ms(a) - kept_ms);
    a->give_up_ns = when == AMPLY ? began_ns + (int64_t)(patience_ms * 1e6) : 0;
    enum rn_status status =
        rn_render(a->engine, a->field, &a->options, has_patience, a, &result, err);
    double ms = (double)(rn_clock_ns() - began_ns) * 1e-6;
    a->spent.ms += ms;
    if (status == RN_ERROR_CANCELLED && a->give_up_ns && a->surprised) {
        a->budget->ray_ms = SLOWER * ms / rays_of(a, &wanted->settings);
        return RN_ERROR_LIMIT;
    }
    if (status != RN_OK) return status;
    learn(a, wanted, ms, (double)result.stats.samples);
    weigh(a, &result.stats, ms);
    rn_render_result_finish(a->result);
    *a->result = result;
    a->has_picture = true;
    a->spent.choice = choice;
    a->spent.settings = wanted->settings;
    a->spent.settings.tolerance = result.stats.tolerance;
    return RN_OK;
}

// A picture to begin with, where one must be made before it is known what else there is time for.
static enum rn_status begin(struct attempt *a, struct rn_error *err) {
    double left = left_ms(a);
    if (a->budget->slowness <= 0) {
        a->budget->slowness = 1;
        size_t sketch = best_within(a, SKETCH_SHARE * left);
        a->budget->slowness = 0;
        return try_choice(a, sketch, WHENEVER, err);
    }
    if (expected_ms(a, 0) <= TIGHT * left) return RN_OK;
    // A device renders no passes: what there is no time for in all is not there.
    enum rn_status status = try_choice(a, best_within(a, PLANNED * left), AT_LEAST, err);
    return status == RN_ERROR_LIMIT ? RN_OK : status;
}

// What there was no time for leaves the picture before, and the next attempt expects less.
static enum rn_status improve(struct attempt *a, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (int i = 0; i < MOST_PICTURES && status == RN_OK; i++) {
        double left = left_ms(a);
        size_t next = best_within(a, PLANNED * left);
        if (a->has_picture ? next <= a->spent.choice : next == 0) break;
        bool ample =
            next + 1 == a->budget->count && !a->surprised && AMPLE * expected_ms(a, next) <= left;
        status = try_choice(a, next, ample ? AMPLY : IN_TIME, err);
        if (status == RN_ERROR_LIMIT && ample && !a->has_picture)
            status = try_choice(a, 0, WHENEVER, err);
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
    struct attempt a = {.engine = engine,
                        .field = field,
                        .options = *options,
                        .budget = budget,
                        .keep_going = keep_going,
                        .context = context,
                        .result = &result};
    enum rn_status status = begin(&a, err);
    if (status == RN_OK) status = improve(&a, err);
    if (status == RN_OK && !a.has_picture) status = try_choice(&a, 0, WHENEVER, err);
    if (status != RN_OK) {
        rn_render_result_finish(&result);
        return status;
    }
    *ret_result = result;
    *ret_spent = a.spent;
    return RN_OK;
}
