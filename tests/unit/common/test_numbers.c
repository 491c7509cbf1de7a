// Order statistics, and directions about an axis.
#include <math.h>

#include "common/math/around.h"
#include "common/math/nearest.h"
#include "common/math/numbers.h"
#include "common/math/vector.h"
#include "tests/support/suite.h"

START_TEST(quantiles) {
    double numbers[] = {5, -1, 3, 2, 4};
    ck_assert_double_eq(rn_numbers_quantile(numbers, 5, 0), -1);
    ck_assert_double_eq(rn_numbers_quantile(numbers, 5, 0.5), 3);
    ck_assert_double_eq(rn_numbers_quantile(numbers, 5, 1), 5);
    ck_assert_double_eq(rn_numbers_median(numbers, 5), 3);
    ck_assert_double_eq(rn_numbers_median(numbers, 4), 2.5);
    ck_assert_double_nan(rn_numbers_median(numbers, 0));
    ck_assert_double_nan(rn_numbers_quantile(NULL, 0, 0.5));
}
END_TEST

START_TEST(numbers_that_are_told) {
    ck_assert(!signbit(rn_unless_zero(-2e-17, 1)) && rn_unless_zero(-2e-17, 1) <= 0);
    ck_assert_double_eq(rn_unless_zero(-2e-5, 2), -2e-5);
}
END_TEST

START_TEST(axes_complete_up) {
    const double ups[][3] = {{0, 0, 1}, {1, 0, 0}, {0, -1, 0}, {0.9, 0, -0.43588989435406735}};
    for (size_t u = 0; u < sizeof ups / sizeof *ups; u++) {
        double a[3], b[3], up[3];
        rn_around_axes(ups[u], a, b);
        rn_cross(a, b, up);
        ck_assert_double_eq_tol(rn_dot(a, a), 1, 1e-15);
        ck_assert_double_eq_tol(rn_dot(a, ups[u]), 0, 1e-15);
        for (int i = 0; i < 3; i++)
            ck_assert_double_eq_tol(up[i], ups[u][i], 1e-15);
    }
}
END_TEST

// Of three about the angle pi, of one, and of none.
START_TEST(arcs) {
    double first, across[] = {3, -3, 2.5}, one[] = {1};
    ck_assert_double_eq_tol(rn_around_arc(across, 3, &first), 2 * M_PI - 5.5, 1e-15);
    ck_assert_double_eq_tol(first, 2.5, 1e-15);
    ck_assert_double_eq_tol(rn_around_arc(one, 1, &first), 0, 1e-15);
    ck_assert_double_eq_tol(first, 1 + 2 * M_PI, 1e-15);
    ck_assert_double_eq(rn_around_arc(one, 0, &first), 2 * M_PI);
    ck_assert_double_eq(first, 0);
}
END_TEST

// Three of seven, of which two are equally near and one is NaN; and of fewer than three.
START_TEST(nearest) {
    const double apart[] = {4, NAN, 2, 7, 2, 1, 3};
    struct rn_nearest kept = {.most = 3};
    for (size_t i = 0; i < 7; i++) {
        rn_nearest_offer(&kept, apart[i], i);
        if (i == 2) ck_assert(kept.count == 2 && kept.which[0] == 2 && kept.which[1] == 0);
    }
    ck_assert_int_eq(kept.count, 3);
    ck_assert(kept.which[0] == 5 && kept.which[1] == 2 && kept.which[2] == 4);
    ck_assert(kept.apart[0] == 1 && kept.apart[1] == 2 && kept.apart[2] == 2);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("numbers");
    TCase *all = tcase_create("all");
    tcase_add_test(all, quantiles);
    tcase_add_test(all, numbers_that_are_told);
    tcase_add_test(all, axes_complete_up);
    tcase_add_test(all, arcs);
    tcase_add_test(all, nearest);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}
