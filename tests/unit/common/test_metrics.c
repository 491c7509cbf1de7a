// PSNR and SSIM: known values, refusals, and agreement with their definitions.
#include <math.h>
#include <stdlib.h>

#include "common/image/metrics.h"
#include "tests/support/naive_metrics.h"
#include "common/math/rng.h"
#include "tests/support/suite.h"

static struct rn_picture constant(int width, int height, int channels, float value) {
    struct rn_picture picture;
    ck_assert_int_eq(rn_picture_init(width, height, channels, &picture, NULL), RN_OK);
    for (int i = 0; i < width * height * channels; i++)
        picture.values[i] = value;
    return picture;
}

static struct rn_picture noise(int width, int height, int channels, uint64_t seed) {
    struct rn_picture picture = constant(width, height, channels, 0);
    for (int i = 0; i < width * height * channels; i++)
        picture.values[i] = rn_rng_unit(rn_rng_draw(seed, 0, (uint64_t)i).v[0]);
    return picture;
}

static double psnr(const struct rn_picture *a, const struct rn_picture *b) {
    double value = NAN;
    ck_assert_int_eq(rn_psnr(a, b, &value), RN_OK);
    return value;
}

static double ssim(const struct rn_picture *a, const struct rn_picture *b) {
    double value = NAN;
    ck_assert_int_eq(rn_ssim(a, b, &value), RN_OK);
    return value;
}

START_TEST(identical) {
    static const int sizes[][2] = {{1, 1}, {2, 2}, {11, 11}, {10, 30}, {40, 25}};
    for (int i = 0; i < 5; i++) {
        struct rn_picture a = noise(sizes[i][0], sizes[i][1], 3, 7);
        ck_assert_double_infinite(psnr(&a, &a));
        ck_assert_double_gt(psnr(&a, &a), 0);
        ck_assert_double_eq(ssim(&a, &a), 1);
        rn_picture_finish(&a);
    }
}
END_TEST

// Constant pictures have no variance: PSNR is that of one difference, SSIM the luminance term.
START_TEST(constants) {
    for (int size = 1; size < 30; size += 4) {
        struct rn_picture a = constant(size, size, 1, 0.5f), b = constant(size, size, 1, 0.25f);
        struct rn_picture black = constant(size, size, 1, 0), white = constant(size, size, 1, 1);
        ck_assert_double_eq_tol(psnr(&a, &b), 20 * log10(4), 1e-12);
        ck_assert_double_eq_tol(psnr(&black, &white), 0, 1e-12);
        ck_assert_double_eq_tol(ssim(&a, &b), (0.25 + 1e-4) / (0.3125 + 1e-4), 1e-11);
        ck_assert_double_eq_tol(ssim(&black, &white), 1e-4 / (1 + 1e-4), 1e-11);
        rn_picture_finish(&a);
        rn_picture_finish(&b);
        rn_picture_finish(&black);
        rn_picture_finish(&white);
    }
}
END_TEST

START_TEST(agrees_with_definition) {
    static const int sizes[][3] = {{1, 1, 3},   {2, 9, 1},   {10, 10, 3}, {11, 11, 1},
                                   {12, 11, 4}, {11, 40, 3}, {33, 27, 3}, {3, 64, 4}};
    for (int i = 0; i < 8; i++) {
        struct rn_picture a = noise(sizes[i][0], sizes[i][1], sizes[i][2], 1);
        struct rn_picture b = noise(sizes[i][0], sizes[i][1], sizes[i][2], 2);
        for (float mix = 1; mix > 5e-3f; mix *= 0.1f) {
            int count = a.width * a.height * a.channels;
            for (int k = 0; k < count; k++)
                b.values[k] = a.values[k] + mix * (b.values[k] - a.values[k]);
            ck_assert_double_eq_tol(psnr(&a, &b), naive_psnr(&a, &b), 1e-12);
            ck_assert_double_eq_tol(ssim(&a, &b), naive_ssim(&a, &b), 5e-11);
            ck_assert_double_eq(ssim(&a, &b), ssim(&b, &a));
        }
        rn_picture_finish(&a);
        rn_picture_finish(&b);
    }
}
END_TEST

START_TEST(refusals) {
    struct rn_picture a = constant(8, 6, 3, 0.5f), wide = constant(9, 6, 3, 0.5f);
    struct rn_picture high = constant(8, 7, 3, 0.5f), rgba = constant(8, 6, 4, 0.5f);
    const struct rn_picture *others[] = {&wide, &high, &rgba};
    double value = 77;
    for (int i = 0; i < 3; i++) {
        ck_assert_int_eq(rn_psnr(&a, others[i], &value), RN_ERROR_INVALID);
        ck_assert_int_eq(rn_ssim(others[i], &a, &value), RN_ERROR_INVALID);
    }
    static const float bad[] = {-0.001f, 1.001f, NAN, INFINITY};
    struct rn_picture b = constant(8, 6, 3, 0.5f);
    for (int i = 0; i < 4; i++) {
        b.values[8 * 6 * 3 - 1] = bad[i];
        ck_assert_int_eq(rn_psnr(&a, &b, &value), RN_ERROR_INVALID);
        ck_assert_int_eq(rn_ssim(&b, &a, &value), RN_ERROR_INVALID);
    }
    ck_assert_double_eq(value, 77);
    rn_picture_finish(&a);
    rn_picture_finish(&b);
    rn_picture_finish(&wide);
    rn_picture_finish(&high);
    rn_picture_finish(&rgba);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("metrics");
    TCase *cases = tcase_create("metrics");
    tcase_add_test(cases, identical);
    tcase_add_test(cases, constants);
    tcase_add_test(cases, agrees_with_definition);
    tcase_add_test(cases, refusals);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
