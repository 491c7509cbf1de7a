// Pictures by a deadline of a scene that has hardly been trained: rays go through its fog, and take
// many times what a curve says.
#include <math.h>

#include "common/base/clock.h"
#include "tests/ops/train_scene.h"

#define TIMES 100 // as much as the choices say
#define CHOICES 3

static const struct rn_render_settings ways[CHOICES] = {
    {.subsample = 8}, {.subsample = 2}, {.subsample = 1}};

struct looked {
    struct rn_engine *engine;
    struct rn_field *field;
    struct rn_render_options options;
    struct rn_render_choice choices[CHOICES];
    double full_ms;
};

// One `times`-th of what the full picture takes is what is said of it, and less of the others.
static void say(struct looked *l, double times) {
    struct rn_error err;
    struct rn_render_result full;
    ck_assert_msg(rn_render(l->engine, l->field, &l->options, NULL, NULL, &full, &err) == RN_OK,
                  "%s", err.text);
    l->full_ms = full.stats.render_ms;
    for (int i = 0; i < CHOICES; i++) {
        double share = 1 / (fmax(ways[i].subsample, 1) * fmax(ways[i].subsample, 1));
        l->choices[i] = (struct rn_render_choice){ways[i], share * l->full_ms / times,
                                                  share * (double)full.stats.samples / times};
    }
    rn_render_result_finish(&full);
}

static enum rn_status look(struct looked *l, double within_ms, bool (*keep_going)(void *),
                           double *ray_ms, size_t *ret_choice) {
    struct rn_error err;
    struct rn_render_result result;
    struct rn_render_spent spent;
    struct rn_render_budget budget = {.choices = l->choices,
                                      .count = CHOICES,
                                      .deadline_ns = rn_clock_ns() + (int64_t)(within_ms * 1e6),
                                      .slowness = 1,
                                      .ray_ms = *ray_ms};
    enum rn_status status = rn_render_within(l->engine, l->field, &l->options, &budget, keep_going,
                                             NULL, &result, &spent, &err);
    if (status != RN_OK) return status;
    *ret_choice = spent.choice;
    *ray_ms = budget.ray_ms;
    rn_render_result_finish(&result);
    return RN_OK;
}

static bool never(void *context) {
    (void)context;
    return false;
}

// What should be there in no time and is not is given up for what there is time for; what is learnt
// of the fog is known to the next picture, and forgotten where there is none.
START_TEST(fog) {
    struct rn_error err;
    struct rn_train_config config = config_for(dataset);
    struct looked l = {.engine = engine_with(2), .options = {.outputs = RN_OUTPUT_RGB}};
    struct rn_trainer *trainer = trainer_for(l.engine, dataset, &config);
    struct rn_progress progress = {.step = 0};
    size_t choice;
    double ray_ms = 0;
    while (progress.step < 1) {
        ck_assert(rn_trainer_advance(trainer, 10, &err) == RN_OK);
        rn_trainer_progress(trainer, &progress);
    }
    l.field = rn_trainer_field(trainer);
    l.options.camera = rn_camera_resized(&dataset->frames[0].camera, 256, 256);
    say(&l, TIMES);
    ck_assert(look(&l, l.full_ms / 3, NULL, &ray_ms, &choice) == RN_OK);
    ck_assert_uint_lt(choice, CHOICES - 1);
    ck_assert_double_gt(ray_ms, 0);
    ck_assert(look(&l, l.full_ms / 3, NULL, &ray_ms, &choice) == RN_OK);
    ck_assert_uint_lt(choice, CHOICES - 1);
    ck_assert(look(&l, 50 * l.full_ms, NULL, &ray_ms, &choice) == RN_OK);
    ck_assert_uint_eq(choice, CHOICES - 1);
    ck_assert_double_gt(ray_ms, 0);
    ck_assert(look(&l, 50 * l.full_ms, never, &ray_ms, &choice) == RN_ERROR_CANCELLED);
    say(&l, 1); // as a curve of this fog itself would
    ck_assert(look(&l, 50 * l.full_ms, NULL, &ray_ms, &choice) == RN_OK);
    ck_assert_uint_eq(choice, CHOICES - 1);
    ck_assert_double_eq(ray_ms, 0);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&l.engine);
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, fog);
}

int main(void) {
    return run_on_scene("fog", add);
}
