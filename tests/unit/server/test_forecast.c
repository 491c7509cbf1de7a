// What the beginning of a training says of the whole.
#include <math.h>

#include "server/jobs/forecast.h"
#include "tests/support/suite.h"

static const struct rn_calibration calibration = {.seconds = {9.375, 18.75, 28.125},
                                                  .psnr = {28, 30, 31},
                                                  .whole_seconds = 60,
                                                  .step_seconds = 0.01,
                                                  .max_seconds = 60,
                                                  .max_steps = 0};

START_TEST(limits) {
    struct rn_calibration c = calibration;
    ck_assert_double_eq(rn_forecast_seconds(&c), 60);
    c.max_steps = 1000;
    ck_assert_double_eq_tol(rn_forecast_seconds(&c), 12.2, 1e-9);
    c.max_seconds = 0;
    ck_assert_double_eq_tol(rn_forecast_seconds(&c), 12.2, 1e-9);
    c.max_steps = 0;
    ck_assert(isnan(rn_forecast_seconds(&c)));
}
END_TEST

// What gains more is told more; twice the time gains ever less.
START_TEST(ends) {
    double last = rn_forecast_psnr(&calibration, 60), gain = INFINITY;
    ck_assert_double_eq_tol(last, 31 + 0.45 * 3, 1e-9);
    for (double seconds = 120; seconds < 1e5; seconds *= 2) {
        double now = rn_forecast_psnr(&calibration, seconds);
        ck_assert(now > last && now - last < gain);
        gain = now - last;
        last = now;
    }
    ck_assert_double_lt(rn_forecast_psnr(&calibration, 30), rn_forecast_psnr(&calibration, 60));
    struct rn_calibration slow = calibration;
    slow.psnr[0] = 29.5;
    ck_assert_double_lt(rn_forecast_psnr(&slow, 60), rn_forecast_psnr(&calibration, 60));
    slow.psnr[0] = 32; // noise: it does not fall
    ck_assert_double_eq_tol(rn_forecast_psnr(&slow, 60), 31, 1e-9);
}
END_TEST

// Sixteen trainings of eleven datasets, as they were measured (tests/bench/figures.md): their ends
// in dB and their steps in time.
START_TEST(as_it_was) {
    static const struct {
        double limit, looks[RN_CALIBRATION_LOOKS], psnr;
        int begun, steps;
    } seen[] = {{119, {24.51, 26.34, 28.57}, 29.52, 2471, 4118}, // place
                {119, {26.89, 27.57, 28.24}, 28.76, 2243, 3508}, // cup
                {119, {39.41, 41.35, 42.71}, 43.76, 3157, 5802}, // fence
                {119, {25.03, 26.34, 28.46}, 29.93, 2996, 5541}, // horns
                {119, {35.39, 37.20, 39.91}, 41.96, 2913, 5342}, // lego, four scales
                {32, {22.14, 24.64, 26.35}, 27.89, 678, 1180},   // place
                {32, {32.86, 35.89, 37.26}, 39.64, 832, 1543},   // lego, four scales
                {32, {36.76, 39.65, 41.10}, 42.52, 968, 1695},   // fence
                {32, {23.78, 25.57, 26.90}, 28.63, 875, 1627},   // horns
                {40, {25.30, 26.18, 26.72}, 27.63, 845, 1309},   // cup
                {40, {27.76, 29.62, 31.68}, 34.81, 1451, 2754},  // lego, one scale
                {40, {27.45, 29.96, 31.04}, 32.52, 1525, 2586},  // sphere
                {40, {25.43, 26.98, 27.83}, 28.96, 1069, 1951},  // fern
                {32, {27.99, 30.61, 31.46}, 33.30, 1264, 2208},  // still-life
                {32, {14.75, 14.91, 14.56}, 14.68, 1084, 2160},  // statue
                {32, {25.47, 26.76, 27.47}, 28.09, 738, 1312}};  // tractor
    int count = sizeof seen / sizeof *seen, near = 0;
    double squares = 0;
    for (int i = 0; i < count; i++) {
        double begun = RN_CALIBRATION_LOOKED * seen[i].limit;
        const double *psnr = seen[i].looks;
        struct rn_calibration c = {.seconds = {begun / 3, begun * 2 / 3, begun},
                                   .psnr = {psnr[0], psnr[1], psnr[2]},
                                   .whole_seconds = seen[i].limit,
                                   .step_seconds = begun / seen[i].begun,
                                   .max_steps = seen[i].steps};
        double off = rn_forecast_psnr(&c, seen[i].limit) - seen[i].psnr;
        double time = rn_forecast_seconds(&c) / seen[i].limit;
        printf("%g s: %.2f dB off, %.0f %% of the time\n", seen[i].limit, off, 100 * time);
        squares += off * off / count;
        near += fabs(off) <= 0.7;
        ck_assert_double_eq_tol(time, 1, 0.15);
        ck_assert_double_le(fabs(off), 1.4);
    }
    ck_assert_double_lt(sqrt(squares), 0.5);
    ck_assert_int_ge(near, count - 2);
}
END_TEST

START_TEST(passings) {
    double end = rn_forecast_psnr(&calibration, 60);
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, 28), 9.375, 0.01);
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, 30), 18.75, 0.01);
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, 31), 28.125, 0.01);
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, end), 60, 0.01);
    ck_assert(isnan(rn_forecast_passing(&calibration, 60, end + 0.01)));
    double at = rn_forecast_passing(&calibration, 60, 31.5);
    ck_assert(at > 28.125 && at < rn_forecast_passing(&calibration, 60, 32));
    // A longer one is slower on its way.
    ck_assert_double_gt(rn_forecast_passing(&calibration, 240, 31.5), at);
}
END_TEST

// A last look that waited: what it saw is told as it was seen, and less is left to rise.
START_TEST(a_late_look) {
    struct rn_calibration late = calibration;
    late.seconds[2] = 45;
    double end = rn_forecast_psnr(&late, 60);
    ck_assert(end > 31 && end < rn_forecast_psnr(&calibration, 60));
    ck_assert_double_eq_tol(rn_forecast_passing(&late, 60, 30), 18.75, 0.01);
    ck_assert_double_eq_tol(rn_forecast_passing(&late, 60, 31), 45, 0.01);
    ck_assert_double_eq_tol(rn_forecast_passing(&late, 60, end), 60, 0.01);
    late.seconds[2] = 61; // by a step as long as what was left
    ck_assert_double_eq_tol(rn_forecast_psnr(&late, 60), 31, 1e-9);
}
END_TEST

// What comes between steps is told once, and counts for no step.
START_TEST(between_steps) {
    struct rn_calibration c = calibration;
    c.turn_seconds = 5;
    c.max_steps = 1000;
    ck_assert_double_eq_tol(rn_forecast_seconds(&c), 5 + 12.2, 1e-9);
    c.step_seconds = 0.35; // 66 steps in 23.1 s
    ck_assert(isnan(rn_forecast_psnr(&c, 60)));
    c.turn_seconds = 0;
    ck_assert(!isnan(rn_forecast_psnr(&c, 60)));
}
END_TEST

START_TEST(nothing_is_told_of_nothing) {
    struct rn_calibration c = calibration;
    c.psnr[0] = c.psnr[1] = c.psnr[2] = NAN; // nothing was held out
    ck_assert(isnan(rn_forecast_psnr(&c, 60)) && isnan(rn_forecast_passing(&c, 60, 30)));
    c = calibration;
    c.step_seconds = 1; // 28 steps
    ck_assert(isnan(rn_forecast_psnr(&c, 60)) && isnan(rn_forecast_passing(&c, 60, 30)));
    ck_assert(isnan(rn_forecast_passing(&calibration, NAN, 30)));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("forecast");
    TCase *all = tcase_create("all");
    tcase_add_test(all, limits);
    tcase_add_test(all, ends);
    tcase_add_test(all, as_it_was);
    tcase_add_test(all, passings);
    tcase_add_test(all, a_late_look);
    tcase_add_test(all, between_steps);
    tcase_add_test(all, nothing_is_told_of_nothing);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}
