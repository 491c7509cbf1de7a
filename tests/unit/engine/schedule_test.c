// A training that ends where no more is gained.
#include <math.h>

#include "server/engine/train/schedule.h"
#include "tests/support/suite.h"

struct run {
    struct rn_train_config config;
    struct rn_progress progress;
};

static struct run run_of(double max_seconds, int64_t max_steps) {
    struct run run = {.progress = {.psnr = NAN}};
    OK(rn_preset("standard", false, &run.config, &err));
    run.config.max_seconds = max_seconds;
    run.config.max_steps = max_steps;
    run.config.until_plateau = true;
    return run;
}

// A figure every `every` seconds until the schedule is done: psnr(t); 100 steps a second. When it
// ended.
static double train(struct run *run, double every, double (*psnr)(double seconds)) {
    struct rn_progress *p = &run->progress;
    while (rn_schedule_done(&run->config, p) < 1) {
        p->train_seconds += every;
        p->step = (int64_t)(100 * p->train_seconds);
        p->psnr = psnr(p->train_seconds);
        rn_schedule_note_figure(&run->config, p);
    }
    return p->train_seconds;
}

static double grows(double seconds) {
    return 20 + 2 * log(seconds);
}

// Nothing after 100 seconds.
static double levels_off(double seconds) {
    return grows(fmin(seconds, 100));
}

static double flat(double seconds) {
    (void)seconds;
    return 30;
}

// But for a figure that is worse by chance, at 210 seconds.
static double dips(double seconds) {
    return fabs(seconds - 210) < 1 ? 29.8 : 30;
}

// 0.05 dB in half as much time again: more than nothing, less than what is waited for.
static double creeps(double seconds) {
    return 20 + 0.05 * log(seconds) / log(1.5);
}

START_TEST(what_gains_goes_on_to_its_limit) {
    struct run run = run_of(600, 0);
    ck_assert_double_eq_tol(train(&run, 5, grows), 600, 5);
    ck_assert(!run.progress.plateau && run.config.max_seconds == 600);
}
END_TEST

// The plateau is seen after 210 seconds at the earliest, when the planes have their last size;
// half as long again is waited, and a third of that is left for the rate to decay in.
START_TEST(what_gains_no_more_decays_and_ends) {
    double (*const curves[])(double) = {levels_off, flat, creeps};
    for (size_t i = 0; i < 3; i++) {
        struct run run = run_of(600, 0);
        ck_assert_double_eq_tol(train(&run, 5, curves[i]), 210 * 1.5 / 0.75, 15);
        ck_assert(run.progress.plateau);
        ck_assert_double_lt(rn_schedule_rate(&run.config, &run.progress),
                            0.06 * run.config.learning_rate);
        ck_assert_int_eq(rn_schedule_base(&run.config, &run.progress), run.config.grow_to);
    }
}
END_TEST

START_TEST(a_bad_figure_is_no_beginning) {
    struct run run = run_of(600, 0);
    ck_assert_double_eq_tol(train(&run, 30, dips), 330 / 0.75, 30);
}
END_TEST

START_TEST(the_end_is_no_plateau) {
    struct run run = run_of(600, 0);
    train(&run, 200, flat); // at 400 seconds it would be too early, at 600 it is over
    ck_assert(!run.progress.plateau);
}
END_TEST

START_TEST(steps_are_limits_as_well) {
    struct run run = run_of(0, 60000);
    train(&run, 5, flat);
    ck_assert(run.progress.plateau && run.config.max_steps < 45000);
    ck_assert_int_eq(run.progress.step >= run.config.max_steps, 1);
}
END_TEST

// Late in the schedule the rate has decayed already: it ends at once.
START_TEST(a_late_plateau_is_the_end) {
    struct run run = run_of(60, 0);
    double end = train(&run, 2, flat);
    ck_assert_double_ge(end, 1.5 * 0.35 * 60);
    run = run_of(60, 0);
    run.progress.gained_psnr = 30, run.progress.gained_seconds = 30;
    run.progress.train_seconds = 44;
    ck_assert_double_eq_tol(train(&run, 2, flat), 46, 0.1);
}
END_TEST

START_TEST(nobody_else_is_stopped) {
    struct run run = run_of(600, 0);
    run.config.until_plateau = false;
    ck_assert_double_eq_tol(train(&run, 5, flat), 600, 5);
    ck_assert(!run.progress.plateau);
}
END_TEST

// Without a limit of its own it may take ten times as long as the preset's.
START_TEST(its_limit) {
    union rn_setting_value values[RN_TRAIN_SETTINGS];
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++)
        values[i] = rn_setting_absent(&rn_train_settings.rows[i]);
    struct rn_train_config config;
    OK(rn_preset("standard", false, &config, &err));
    rn_settings_value(&rn_train_settings, values, "until_plateau")->choice = 1;
    rn_train_config_choose(&config, values);
    ck_assert(config.until_plateau && config.max_seconds == 600);
    ck_assert_int_eq(config.field.width, 128); // as for any run of that length
    OK(rn_preset("standard", false, &config, &err));
    rn_settings_value(&rn_train_settings, values, "max_seconds")->number = 90;
    rn_train_config_choose(&config, values);
    ck_assert(config.max_seconds == 90);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("schedule");
    TCase *all = tcase_create("all");
    tcase_add_test(all, what_gains_goes_on_to_its_limit);
    tcase_add_test(all, what_gains_no_more_decays_and_ends);
    tcase_add_test(all, a_bad_figure_is_no_beginning);
    tcase_add_test(all, the_end_is_no_plateau);
    tcase_add_test(all, steps_are_limits_as_well);
    tcase_add_test(all, a_late_plateau_is_the_end);
    tcase_add_test(all, nobody_else_is_stopped);
    tcase_add_test(all, its_limit);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}
