// What the beginning of a training says of the whole.
#include <math.h>

#include "server/jobs/forecast.h"
#include "tests/support/suite.h"

static const struct rn_calibration calibration = {.seconds = {9.375, 18.75},
                                                  .psnr = {28, 30},
                                                  .step_seconds = 0.01,
                                                  .max_seconds = 60,
                                                  .max_steps = 0};

START_TEST(limits) {
    struct rn_calibration c = calibration;
    ck_assert_double_eq(rn_forecast_seconds(&c), 60);
    c.max_steps = 1000;
    ck_assert_double_eq_tol(rn_forecast_seconds(&c), 14.3, 1e-9);
    c.max_seconds = 0;
    ck_assert_double_eq_tol(rn_forecast_seconds(&c), 14.3, 1e-9);
    c.max_steps = 0;
    ck_assert(isnan(rn_forecast_seconds(&c)));
}
END_TEST

// What gains more is told more; twice the time gains ever less.
START_TEST(ends) {
    double last = rn_forecast_psnr(&calibration, 60), gain = INFINITY;
    ck_assert_double_eq_tol(last, 30 + 2.08 * sqrt(2), 1e-9);
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
    slow.psnr[0] = 31; // noise: it does not fall
    ck_assert_double_eq_tol(rn_forecast_psnr(&slow, 60), 30, 1e-9);
}
END_TEST

// Seventeen trainings of twelve datasets, as they were measured (tests/bench/figures.md): their
// ends in dB and their steps in time.
START_TEST(as_it_was) {
    static const struct {
        double limit, looks[2], psnr;
        int begun, steps;
    } seen[] = {{119, {24.51, 26.34}, 29.52, 1953, 4118}, {119, {26.89, 27.57}, 28.76, 1839, 3508},
                {119, {39.41, 41.35}, 43.76, 2336, 5802}, {119, {25.03, 26.34}, 29.93, 2269, 5541},
                {119, {35.39, 37.20}, 41.96, 2156, 5342}, {32, {22.14, 24.64}, 27.89, 523, 1180},
                {32, {32.86, 35.89}, 39.64, 645, 1543},   {32, {36.76, 39.65}, 42.52, 747, 1695},
                {32, {23.78, 25.57}, 28.63, 672, 1627},   {40, {25.30, 26.18}, 27.63, 656, 1309},
                {40, {27.50, 29.57}, 34.20, 1057, 2338},  {40, {27.61, 30.05}, 32.52, 1201, 2586},
                {40, {25.59, 26.91}, 28.96, 866, 1951},   {40, {26.67, 28.73}, 31.41, 739, 1485},
                {32, {27.99, 30.61}, 33.30, 1011, 2208},  {32, {14.75, 14.91}, 14.68, 792, 2160},
                {32, {25.47, 26.76}, 28.09, 548, 1312}};
    int count = sizeof seen / sizeof *seen, near = 0;
    double squares = 0;
    for (int i = 0; i < count; i++) {
        double begun = RN_CALIBRATION_LOOKED * seen[i].limit;
        struct rn_calibration c = {.seconds = {begun / 2, begun},
                                   .psnr = {seen[i].looks[0], seen[i].looks[1]},
                                   .step_seconds = begun / seen[i].begun,
                                   .max_steps = seen[i].steps};
        double off = rn_forecast_psnr(&c, seen[i].limit) - seen[i].psnr;
        double time = rn_forecast_seconds(&c) / seen[i].limit;
        printf("%g s: %.2f dB off, %.0f %% of the time\n", seen[i].limit, off, 100 * time);
        squares += off * off / count;
        near += fabs(off) <= 0.9;
        ck_assert_double_eq_tol(time, 1, 0.25);
    }
    ck_assert_double_lt(sqrt(squares), 0.9);
    ck_assert_int_ge(3 * near, 2 * count);
}
END_TEST

START_TEST(passings) {
    double end = rn_forecast_psnr(&calibration, 60);
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, 28), 9.375, 0.01);
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, 30), 18.75, 0.01);
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, end), 60, 0.01);
    ck_assert(isnan(rn_forecast_passing(&calibration, 60, end + 0.01)));
    double at = rn_forecast_passing(&calibration, 60, 31);
    ck_assert(at > 18.75 && at < rn_forecast_passing(&calibration, 60, 32));
    // A longer one is slower on its way.
    ck_assert_double_gt(rn_forecast_passing(&calibration, 240, 31), at);
}
END_TEST

START_TEST(nothing_is_told_of_nothing) {
    struct rn_calibration c = calibration;
    c.psnr[0] = c.psnr[1] = NAN; // nothing was held out
    ck_assert(isnan(rn_forecast_psnr(&c, 60)) && isnan(rn_forecast_passing(&c, 60, 30)));
    c = calibration;
    c.step_seconds = 1; // 27 steps
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
    tcase_add_test(all, nothing_is_told_of_nothing);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}
