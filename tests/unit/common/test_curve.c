#include <math.h>
#include <string.h>

#include "common/settings/curve.h"
#include "tests/support/suite.h"

static struct rn_curve_point point(double ms, double psnr, double psnr_full, double tolerance,
                                   int subsample) {
    struct rn_curve_point p = {.ms_median = ms, .ms_p95 = ms, .psnr = psnr, .psnr_full = psnr_full};
    for (size_t i = 0; i < RN_RENDER_SETTINGS; i++)
        p.setting.values[i] = rn_setting_absent(&rn_render_settings.rows[i]);
    if (tolerance > 0)
        rn_settings_value(&rn_render_settings, p.setting.values, "tolerance")->number = tolerance;
    if (subsample > 1)
        rn_settings_value(&rn_render_settings, p.setting.values, "subsample")->whole = subsample;
    return p;
}

// 100 x 100 pixels in 1, 4, 10 and 100 ms.
static struct rn_curve_point points[4];
static struct rn_curve curve = {.points = points, .count = 4, .width = 100, .height = 100};

static void make_curve(void) {
    points[0] = point(1, 20, 22, 0, 4);
    points[1] = point(4, 25, 28, 0.2, 1);
    points[2] = point(10, 30, 40, 0.1, 1);
    points[3] = point(100, 31, NAN, 0, 1);
}

static size_t chosen(enum rn_budget_kind kind, double number, double pixels, bool *missed) {
    return rn_curve_choose(&curve, kind, number, pixels, NAN, missed);
}

START_TEST(what_another_beats_is_no_point) {
    struct rn_curve_point all[] = {point(50, 33, NAN, 0, 1),    point(10, 25, 30, 0.1, 1),
                                   point(12, 24, 30, 0.2, 1),   point(5, 20, 30, 0, 4),
                                   point(60, 32, 30, 0.01, 1),  point(20, 31, 30, 0.05, 1),
                                   point(20.1, 31, 30, 0.04, 1)};
    size_t count = sizeof all / sizeof *all;
    rn_curve_reduce(all, &count);
    const double left[] = {5, 10, 20, 50};
    ck_assert_uint_eq(count, 4);
    for (size_t i = 0; i < count; i++)
        ck_assert_double_eq(all[i].ms_median, left[i]);
    count = 1;
    rn_curve_reduce(all, &count);
    ck_assert_uint_eq(count, 1);
}
END_TEST

// A curve full of quick ways keeps the slow ones: 100 that take 0.1 % longer each, then a few.
START_TEST(finalists_are_of_all_times) {
    struct rn_curve_trial trials[120] = {{100, 36}};
    size_t chosen[10], count = 1;
    for (; count < 101; count++)
        trials[count] =
            (struct rn_curve_trial){1 + 0.001 * (double)count, 10 + 0.01 * (double)count};
    for (double ms = 2; ms < 90; ms *= 2)
        trials[count++] = (struct rn_curve_trial){ms, 20 + ms / 8};
    size_t left = rn_curve_finalists(trials, count, 10, chosen);
    ck_assert_uint_le(left, 10);
    ck_assert_uint_ge(left, 8); // the full one, the six slow ones, and of the quick ones
    ck_assert_uint_eq(chosen[0], 0);
    for (size_t i = 0; i < 6; i++)
        ck_assert_uint_eq(chosen[left - 6 + i], 101 + i);
    for (size_t i = 2; i < left; i++)
        ck_assert_double_gt(trials[chosen[i]].ms, trials[chosen[i - 1]].ms);
}
END_TEST

// Each group is one that takes up to 4 % longer than its first, and has its best one.
START_TEST(a_group_of_finalists_keeps_its_best) {
    const struct rn_curve_trial trials[] = {{50, 33},     {10.3, 26}, {10, 25},
                                            {10.2, 25.9}, {20, 31},   {10.5, 27}};
    const size_t expected[] = {0, 1, 5, 4}; // 10.5 begins the next group, and ends it
    size_t chosen[6];
    ck_assert_uint_eq(rn_curve_finalists(trials, 6, 6, chosen), 4);
    for (size_t i = 0; i < 4; i++)
        ck_assert_uint_eq(chosen[i], expected[i]);
    // With room for three the groups are wider: one of all that take about 10.
    ck_assert_uint_eq(rn_curve_finalists(trials, 6, 3, chosen), 3);
    ck_assert(chosen[0] == 0 && chosen[1] == 5 && chosen[2] == 4);
}
END_TEST

START_TEST(finalists_lie_near_the_front) {
    const struct rn_curve_trial trials[] = {{50, 33},     {10, 25},   {10.9, 24.9}, {12, 24.9},
                                            {12.5, 25.1}, {14, 25.3}, {60, 32}};
    const size_t expected[] = {0, 1, 2, 4, 5};
    size_t chosen[7];
    // 10.9 ms may be as quick as 10 on another view; 12 is beaten; 12.5 is better than all before
    ck_assert_uint_eq(rn_curve_finalists(trials, 7, 7, chosen), 5);
    for (size_t i = 0; i < 5; i++)
        ck_assert_uint_eq(chosen[i], expected[i]);
    ck_assert_uint_eq(rn_curve_finalists(trials, 1, 7, chosen), 1);
    ck_assert_uint_eq(chosen[0], 0);
    ck_assert_uint_eq(rn_curve_finalists(trials, 7, 2, chosen), 2);
    ck_assert_uint_eq(chosen[1], 5); // all but the full one are one group
}
END_TEST

START_TEST(a_time_takes_the_best_that_fits) {
    bool missed;
    make_curve();
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 9.9, 1e4, &missed), 1);
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 10, 1e4, &missed), 2);
    ck_assert(!missed);
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 10, 4e4, &missed), 0); // four times as large
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 0.5, 1e4, &missed), 0);
    ck_assert(missed);
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 1e6, 1e4, &missed), 3);
}
END_TEST

// Half of the pictures in time are no promise; nineteen of twenty are.
START_TEST(a_time_is_kept_by_nearly_all_pictures) {
    bool missed;
    make_curve();
    points[2].ms_p95 = 20;
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 15, 1e4, &missed), 1);
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 20, 1e4, &missed), 2);
    ck_assert(!missed);
    points[0].ms_p95 = 2;
    ck_assert_uint_eq(chosen(RN_BUDGET_TIME, 1.5, 1e4, &missed), 0);
    ck_assert(missed);
}
END_TEST

START_TEST(a_psnr_takes_the_quickest_that_reaches_it) {
    bool missed;
    make_curve();
    ck_assert_uint_eq(chosen(RN_BUDGET_PSNR, 1, 1e4, &missed), 0);
    ck_assert_uint_eq(chosen(RN_BUDGET_PSNR, 25.1, 1e4, &missed), 2);
    ck_assert(!missed);
    ck_assert_uint_eq(chosen(RN_BUDGET_PSNR, 31.1, 1e4, &missed), 3);
    ck_assert(missed);
}
END_TEST

START_TEST(quality_is_linear_in_the_logarithm_of_time) {
    bool missed;
    make_curve();
    ck_assert_uint_eq(chosen(RN_BUDGET_QUALITY, 0, 1e6, &missed), 0);
    ck_assert_uint_eq(chosen(RN_BUDGET_QUALITY, 30, 1e6, &missed), 0);
    ck_assert_uint_eq(chosen(RN_BUDGET_QUALITY, 31, 1e6, &missed), 1); // 100^0.301 = 4
    ck_assert_uint_eq(chosen(RN_BUDGET_QUALITY, 50, 1e6, &missed), 2);
    ck_assert_uint_eq(chosen(RN_BUDGET_QUALITY, 99.9, 1e6, &missed), 2);
    ck_assert_uint_eq(chosen(RN_BUDGET_QUALITY, 100, 1e6, &missed), 3);
    ck_assert(!missed);
}
END_TEST

START_TEST(what_is_expected_of_a_point) {
    make_curve();
    ck_assert_double_eq(rn_curve_expected(&curve, 1, 99), 25);
    // Without photographs: the errors add up, and of the full picture there are no more.
    for (size_t i = 0; i < curve.count; i++)
        points[i].psnr = NAN;
    double both = -10 * log10(pow(10, -3.0) + pow(10, -4.0));
    ck_assert_double_eq_tol(rn_curve_expected(&curve, 2, 30), both, 1e-9);
    ck_assert_double_eq(rn_curve_expected(&curve, 3, 30), 30);
    ck_assert(isnan(rn_curve_expected(&curve, 2, NAN)));
}
END_TEST

// At a view's own place its PSNR; between two of four the mean; further ones do not count. What is
// expected is as sure as views from near there are alike.
START_TEST(the_place_says_how_good_a_picture_will_be) {
    struct rn_curve_view around[] = {{{0, 0, 0}, 33},   {{2, 0, 0}, 29},   {{1, 1e3, 0}, 50},
                                     {{1, 0, 1e3}, 50}, {{1, 9e2, 0}, 31}, {{0, 4, 0}, 33}};
    make_curve();
    struct rn_curve c = curve;
    points[3].psnr_spread = 1.2;
    struct rn_curve_here here = rn_curve_here(&c, (double[]){0, 0, 0});
    ck_assert(here.better == 0 && here.spread == 1.2);
    c.around = around;
    c.around_count = sizeof around / sizeof *around;
    here = rn_curve_here(&c, (double[]){0, 0, 0});
    ck_assert_double_eq_tol(here.better, 33 - 31, 1e-6);
    ck_assert_double_lt(here.spread, 1e-4);
    here = rn_curve_here(&c, (double[]){2, 0, 0});
    ck_assert_double_eq_tol(here.better, 29 - 31, 1e-6);
    ck_assert_double_lt(here.spread, 1e-4);
    here = rn_curve_here(&c, (double[]){1, 0, 0}); // beside (0, 4, 0), of a weight of 1 / 17
    double mean = (33 + 29 + 33 / 17.0) / (2 + 1 / 17.0);
    double squares = (33 * 33 + 29 * 29 + 33 * 33 / 17.0) / (2 + 1 / 17.0);
    ck_assert_double_eq_tol(here.better, mean - 31, 1e-3);
    ck_assert_double_eq_tol(here.spread, sqrt(1.5 * (squares - mean * mean)), 1e-3);
    // Of the full picture that is all; of a poor one, what it lost to it counts.
    ck_assert_double_eq_tol(rn_curve_spread_here(&c, 31 + here.better, NAN, &here),
                            hypot(here.spread, 0.1), 1e-9);
    double poor = rn_curve_spread_here(&c, 10, NAN, &here);
    ck_assert(poor > 0.5 && poor < 0.6);
    here.spread = 0;
    ck_assert_double_eq_tol(rn_curve_spread_here(&c, 31 + here.better, NAN, &here), 0.1, 1e-9);
}
END_TEST

static double error_of(double psnr) {
    return pow(10, -psnr / 10);
}

static double here(size_t point, struct rn_curve_made made, double better) {
    return rn_curve_expected_here(&curve, point, &made, 31, better);
}

// The full picture is as much better as they say; a coarse one, whose own error stays, is not.
START_TEST(a_place_is_better_for_what_is_good) {
    make_curve();
    const struct rn_curve_made plain = {0, 0};
    double coarse = -10 * log10(error_of(20) - error_of(31) + error_of(33));
    ck_assert_double_eq_tol(here(3, plain, 2), 33, 1e-9);
    ck_assert_double_eq_tol(here(0, plain, 2), coarse, 1e-9);
    ck_assert_double_eq_tol(rn_curve_from_here(&curve, coarse, 2), 20, 1e-9);
    points[2].psnr = 32; // smoother than the full picture
    ck_assert_double_eq_tol(here(2, plain, 2), 34, 1e-9);
    ck_assert_double_eq_tol(rn_curve_from_here(&curve, 34, 2), 32, 1e-9);
}
END_TEST

// Twice as rough, or twice as much lost between others: twice the loss.
START_TEST(a_picture_says_itself_what_it_lost) {
    make_curve();
    points[0].roughness = 0.02;
    points[1].interpolation = 0.003;
    double rough = error_of(20) - error_of(31), apart = error_of(25) - error_of(31);
    ck_assert_double_eq_tol(here(0, (struct rn_curve_made){0, 0.02}, 0), 20, 1e-9);
    ck_assert_double_eq_tol(error_of(here(0, (struct rn_curve_made){0, 0.04}, 0)),
                            error_of(31) + 2 * rough, 1e-9);
    ck_assert_double_eq_tol(error_of(here(1, (struct rn_curve_made){0.006, 0}, 0)),
                            error_of(31) + 2 * apart, 1e-9);
    points[1].interpolation = 0.001; // of a loss that is larger the rest stays as it is
    ck_assert_double_eq_tol(error_of(here(1, (struct rn_curve_made){0.002, 0}, 0)),
                            error_of(31) + apart + 0.001, 1e-9);
    points[2].interpolation = 0.001; // of one that has as much to lose more than half is lost
    double share = (error_of(28) - error_of(31)) / 0.001;
    points[2].psnr = 28;
    ck_assert(share > 0.5 && share < 1);
    ck_assert_double_eq_tol(error_of(here(1, (struct rn_curve_made){0.002, 0}, 0)),
                            error_of(31) + apart + share * 0.001, 1e-9);
    points[2].psnr = 30;
    share = (error_of(30) - error_of(31)) / 0.001;
    ck_assert(share < 0.5);
    ck_assert_double_eq_tol(error_of(here(1, (struct rn_curve_made){0.002, 0}, 0)),
                            error_of(31) + apart + share * 0.001, 1e-9);
    points[2].interpolation = 0.0004; // of one with less to lose nothing is learnt
    ck_assert_double_eq_tol(error_of(here(1, (struct rn_curve_made){0.002, 0}, 0)),
                            error_of(31) + apart + 0.001, 1e-9);
    // With less time than the point's own tolerance asks for there is more to lose, and with more
    // of what the point does not interpolate at all.
    ck_assert_double_lt(here(0, (struct rn_curve_made){0.001, 0.02}, 0), 20);
    ck_assert_double_lt(here(3, (struct rn_curve_made){0.001, 0}, 0), 31);
    // A curve of an older version does not know: the picture's own estimate.
    points[0].roughness = points[0].interpolation = NAN;
    double own = here(0, (struct rn_curve_made){0, 0.02}, 0);
    ck_assert_double_eq_tol(error_of(own), error_of(31) + 0.18 * 4 * 0.02, 1e-9);
    ck_assert_double_eq_tol(here(0, (struct rn_curve_made){0, 0}, 0), 20, 1e-9);
    points[3].psnr = points[0].psnr = NAN;
    ck_assert_double_eq_tol(here(3, (struct rn_curve_made){0, 0}, 0), 31, 1e-9);
}
END_TEST

START_TEST(a_budget_stands_alone) {
    union rn_setting_value values[RN_RENDER_SETTINGS];
    enum rn_budget_kind kind = RN_BUDGET_NONE;
    double number;
    char text[64];
    rn_settings_get(&rn_render_settings, &(struct rn_render_settings){0}, values);
    for (size_t i = 0; i < RN_RENDER_SETTINGS; i++)
        values[i] = rn_setting_absent(&rn_render_settings.rows[i]);
    ck_assert_int_eq(rn_budget_of(values, &number), RN_BUDGET_NONE);
    ck_assert_ptr_null(rn_budget_check(values, &kind));
    rn_settings_value(&rn_render_settings, values, "quality")->number = 0;
    ck_assert_int_eq(rn_budget_of(values, &number), RN_BUDGET_QUALITY);
    ck_assert(number == 0 && !rn_budget_check(values, &kind));
    rn_settings_value(&rn_render_settings, values, "within")->number = 50;
    ck_assert_ptr_nonnull(rn_budget_check(values, &kind));
    ck_assert_int_eq(kind, RN_BUDGET_QUALITY);
    values[RN_RENDER_BUDGET] = rn_setting_absent(&rn_render_settings.rows[RN_RENDER_BUDGET]);
    rn_settings_value(&rn_render_settings, values, "tolerance")->number = 0.1;
    ck_assert_ptr_nonnull(rn_budget_check(values, &kind));
    struct rn_curve_setting setting;
    memcpy(setting.values, values, sizeof values);
    rn_curve_setting_text(&setting, text, sizeof text);
    ck_assert_str_eq(text, "tolerance=0.1");
    make_curve();
    rn_curve_setting_text(&points[3].setting, text, sizeof text);
    ck_assert_str_eq(text, "full");
}
END_TEST

START_TEST(the_presets_curve_is_a_curve) {
    struct rn_curve_point of_presets[RN_CURVE_POINTS];
    struct rn_curve c;
    rn_curve_of_presets(of_presets, &c);
    size_t count = c.count;
    for (size_t i = 1; i < count; i++) {
        ck_assert_double_gt(c.points[i].ms_median, c.points[i - 1].ms_median);
        ck_assert_double_gt(rn_curve_worth(&c.points[i]), rn_curve_worth(&c.points[i - 1]));
    }
    ck_assert(isnan(c.points[count - 1].psnr_full));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("curve");
    TCase *all = tcase_create("all");
    tcase_add_test(all, what_another_beats_is_no_point);
    tcase_add_test(all, finalists_are_of_all_times);
    tcase_add_test(all, a_group_of_finalists_keeps_its_best);
    tcase_add_test(all, finalists_lie_near_the_front);
    tcase_add_test(all, a_time_takes_the_best_that_fits);
    tcase_add_test(all, a_time_is_kept_by_nearly_all_pictures);
    tcase_add_test(all, a_psnr_takes_the_quickest_that_reaches_it);
    tcase_add_test(all, quality_is_linear_in_the_logarithm_of_time);
    tcase_add_test(all, what_is_expected_of_a_point);
    tcase_add_test(all, the_place_says_how_good_a_picture_will_be);
    tcase_add_test(all, a_place_is_better_for_what_is_good);
    tcase_add_test(all, a_picture_says_itself_what_it_lost);
    tcase_add_test(all, a_budget_stands_alone);
    tcase_add_test(all, the_presets_curve_is_a_curve);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}
