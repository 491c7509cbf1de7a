// The field's small parts: spherical harmonics, networks, taps and levels where values are known.
#include <stdlib.h>

#include "server/engine/field/footprint.h"
#include "server/engine/field/mlp.h"
#include "server/engine/field/ripmap.h"
#include "server/engine/field/sh.h"
#include "server/engine/field/volume.h"
#include "tests/support/suite.h"

// The product of any two harmonics over the sphere is 1 or 0. Gauss-Legendre with 4 points in z and
// 8 equal angles are exact for the degree 6 that products of degree 3 have.
START_TEST(harmonics_are_orthonormal) {
    static const double z[4] = {-0.86113631159405258, -0.33998104358485626, 0.33998104358485626,
                                0.86113631159405258};
    static const double weight[4] = {0.34785484513745386, 0.65214515486254614, 0.65214515486254614,
                                     0.34785484513745386};
    double sums[RN_SH_COUNT][RN_SH_COUNT] = {{0}}, value[RN_SH_COUNT];
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 8; j++) {
            double ring = sqrt(1 - z[i] * z[i]), angle = acos(-1) * j / 4;
            rn_sh_encode((double[3]){ring * cos(angle), ring * sin(angle), z[i]}, value);
            for (int a = 0; a < RN_SH_COUNT; a++)
                for (int b = 0; b < RN_SH_COUNT; b++)
                    sums[a][b] += weight[i] * acos(-1) / 4 * value[a] * value[b];
        }
    for (int a = 0; a < RN_SH_COUNT; a++)
        for (int b = 0; b < RN_SH_COUNT; b++)
            ck_assert_double_eq_tol(sums[a][b], a == b, 1e-14);
}
END_TEST

// Orthonormality leaves the signs and the order open: the released code's, at one direction.
START_TEST(harmonics_have_the_released_signs) {
    double value[RN_SH_COUNT];
    rn_sh_encode((double[3]){0.48, 0.6, 0.64}, value);
    static const int sign[RN_SH_COUNT] = {1, -1, 1, -1, 1, -1, 1, -1, -1, -1, 1, -1, -1, -1, -1, 1};
    for (int i = 0; i < RN_SH_COUNT; i++)
        ck_assert_msg(value[i] * sign[i] > 0, "coefficient %d: %g", i, value[i]);
    ck_assert_double_eq_tol(value[3], -0.48 * 0.48860251190291992, 1e-15);
    ck_assert_double_eq_tol(value[10], 0.48 * 0.6 * 0.64 * 2.890611442640554, 1e-15);
}
END_TEST

// 2 inputs, 2 hidden, 1 output by hand: one hidden value is negative and counts as zero, the
// output may be negative.
START_TEST(networks_clip_hidden_values_only) {
    struct rn_mlp_shape shape = rn_mlp_shape(2, 2, 1, 1);
    ck_assert_int_eq((int)shape.count, 6);
    double weights[6] = {1, -1, 2, -3, -0.5, 4}, in[2] = {3, 1}, hidden[2], out[2];
    double *activation[3] = {in, hidden, out};
    rn_mlp_forward(&shape, weights, activation);
    ck_assert(hidden[0] == 5 && hidden[1] == 0 && out[0] == -2.5);
}
END_TEST

START_TEST(odd_lines_pool_with_registered_taps) {
    double weight[3];
    int first;
    ck_assert_int_eq(rn_rip_taps(5, 1, &first, weight), 3);
    ck_assert_int_eq(first, 2);
    ck_assert(weight[0] == 1 / 5. && weight[1] == 2 / 5. && weight[2] == 2 / 5.);
    ck_assert_int_eq(rn_rip_taps(6, 2, &first, weight), 2);
    ck_assert_int_eq(first, 4);
    ck_assert_int_eq(rn_rip_taps(1, 0, &first, weight), 1);
}
END_TEST

// 4 sigma = 2^level texels of the plane's 2: sigma = 2^level / (2 size).
START_TEST(levels_are_those_of_the_released_code) {
    for (int level = 0; level < 8; level++) {
        double sigma = ldexp(1, level) / 1024;
        ck_assert_double_eq_tol(rn_level_from_variance(sigma * sigma, 512, 8), level, 1e-15);
        ck_assert_double_eq_tol(rn_level_from_ball(ldexp(1, level), 8), level, 1e-15);
    }
    ck_assert(rn_level_from_variance(0, 512, 8) == 0 && rn_level_from_variance(9, 512, 8) == 7);
    ck_assert(rn_level_from_variance(NAN, 512, 8) == 0);
}
END_TEST

START_TEST(density_is_the_shifted_clamped_exponential) {
    ck_assert(rn_density(1) == 1);
    ck_assert_double_eq_tol(rn_density(3), exp(2), 1e-14);
    ck_assert(rn_density(1e4) == exp(15) && rn_density(-1e4) == exp(-15));
    ck_assert(rn_density(INFINITY) == exp(15) && rn_density(NAN) == exp(-15));
    ck_assert(rn_density_slope(40) == exp(15) && rn_density_slope(2) == rn_density(2));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("field");
    TCase *tcase = tcase_create("field");
    tcase_add_test(tcase, harmonics_are_orthonormal);
    tcase_add_test(tcase, harmonics_have_the_released_signs);
    tcase_add_test(tcase, networks_clip_hidden_values_only);
    tcase_add_test(tcase, odd_lines_pool_with_registered_taps);
    tcase_add_test(tcase, levels_are_those_of_the_released_code);
    tcase_add_test(tcase, density_is_the_shifted_clamped_exponential);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
