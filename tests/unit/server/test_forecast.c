// What two short trainings say of a long one.
#include <math.h>

#include "server/jobs/forecast.h"
#include "tests/support/suite.h"

static const struct rn_calibration calibration = {.seconds = {3.75, 7.5},
                                                  .psnr = {28, 30},
                                                  .step_seconds = 0.01,
                                                  .max_seconds = 60,
                                                  .max_steps = 0};

START_TEST(limits) {
    struct rn_calibration c = calibration;
    ck_assert_double_eq(rn_forecast_seconds(&c), 60);
    c.max_steps = 1000;
    ck_assert_double_eq_tol(rn_forecast_seconds(&c), 10, 1e-9);
    c.max_seconds = 0;
    ck_assert_double_eq_tol(rn_forecast_seconds(&c), 10, 1e-9);
    c.max_steps = 0;
    ck_assert(isnan(rn_forecast_seconds(&c)));
}
END_TEST

// It passes through the second run's end, grows ever less, and a scene that gains less is told
// less.
START_TEST(ends) {
    ck_assert_double_eq_tol(rn_forecast_psnr(&calibration, 7.5), 30, 1e-9);
    double last = 30, gain = INFINITY;
    for (double seconds = 15; seconds < 1e4; seconds *= 2) {
        double now = rn_forecast_psnr(&calibration, seconds);
        ck_assert(now > last && now - last < gain);
        gain = now - last;
        last = now;
    }
    struct rn_calibration slow = calibration;
    slow.psnr[0] = 29.5;
    ck_assert_double_lt(rn_forecast_psnr(&slow, 60), rn_forecast_psnr(&calibration, 60));
    slow.psnr[0] = 31; // noise: it does not fall
    ck_assert_double_gt(rn_forecast_psnr(&slow, 60), 30);
}
END_TEST

// The first few hundred steps: lego and fern after 40 s of a busy core, as they were
// measured.
START_TEST(early_steps) {
    static const struct {
        struct rn_calibration c;
        double psnr;
    } seen[] = {{{{2.527, 5.041}, {12.07, 20.73}, .step_seconds = 0.0394}, 31.24},
                {{{2.567, 5.027}, {16.81, 19.26}, .step_seconds = 0.0294}, 24.23}};
    for (size_t i = 0; i < 2; i++)
        ck_assert_double_eq_tol(rn_forecast_psnr(&seen[i].c, 40), seen[i].psnr, 0.75);
}
END_TEST

START_TEST(passings) {
    double end = rn_forecast_psnr(&calibration, 60);
    double at = rn_forecast_passing(&calibration, 60, 30);
    ck_assert(at > 7.5 && at < 60); // the short run had its rate decay by then
    ck_assert_double_eq_tol(rn_forecast_passing(&calibration, 60, end), 60, 0.01);
    ck_assert(isnan(rn_forecast_passing(&calibration, 60, end + 0.01)));
    ck_assert_double_gt(rn_forecast_passing(&calibration, 60, 31), at);
}
END_TEST

START_TEST(nothing_is_told_of_nothing) {
    struct rn_calibration c = calibration;
    c.psnr[0] = c.psnr[1] = NAN; // nothing was held out
    ck_assert(isnan(rn_forecast_psnr(&c, 60)) && isnan(rn_forecast_passing(&c, 60, 30)));
    c = calibration;
    c.step_seconds = 1; // a run of seven steps
    ck_assert(isnan(rn_forecast_psnr(&c, 60)) && isnan(rn_forecast_passing(&c, 60, 30)));
    ck_assert(isnan(rn_forecast_passing(&calibration, NAN, 30)));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("forecast");
    TCase *all = tcase_create("all");
    tcase_add_test(all, limits);
    tcase_add_test(all, ends);
    tcase_add_test(all, early_steps);
    tcase_add_test(all, passings);
    tcase_add_test(all, nothing_is_told_of_nothing);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}
