// Real photographs: read, and a few of them imported in both ways. Skipped (77) without the data.
#include <limits.h>
#include <unistd.h>

#include "tests/unit/common/dataset_fixture.h"

static char lego[PATH_MAX];

START_TEST(read_lego) {
    read_ok(lego);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 100);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_VAL], 100);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TEST], 50);
    struct rn_dataset_report report;
    rn_dataset_describe(dataset, &report);
    ck_assert_int_eq(report.with_alpha, 250);
    ck_assert_double_eq(report.looking_at_bounds, 1);
    ck_assert_double_eq_tol(report.camera_distance_max, 4.0311, 1e-3);
    ck_assert_double_eq_tol(report.footprint_min / report.camera_distance_min, 5.0777e-4, 1e-8);
    const struct rn_frame *frame;
    ck_assert_int_eq(rn_dataset_find_view(dataset, "test:r_12", 0, &frame, &err), RN_OK);
    ck_assert_int_eq(frame->index, 3); // every fourth view is there
    ck_assert_int_eq(frame->camera.width, 800);
    ck_assert_double_eq_tol(frame->camera.fx, 1111.1111, 1e-3);
}
END_TEST

// The published converter, written out: 2x2 means in float32 of the unrounded level before,
// added row by row as NumPy's mean does.
static void assert_legacy(const struct rn_frame *full, const struct rn_frame *frame) {
    struct rn_image image, stored;
    ck_assert_int_eq(rn_image_read(full->path, &rn_image_default_limits, &image, &err), RN_OK);
    ck_assert_int_eq(rn_image_read(frame->path, &rn_image_default_limits, &stored, &err), RN_OK);
    int size = image.width;
    float *values = malloc((size_t)size * (size_t)size * 4 * sizeof *values);
    for (int i = 0; i < size * size * 4; i++)
        values[i] = (float)image.pixels[i] / 255.0f;
    for (int level = 0; level < frame->scale; level++) {
        int half = size / 2;
        for (int i = 0; i < half * half * 4; i++) {
            int c = i % 4, x = i / 4 % half, y = i / 4 / half;
            const float *at = values + 4 * (2 * y * size + 2 * x) + c;
            values[i] = (at[0] + at[4] + at[4 * size] + at[4 * size + 4]) / 4;
        }
        size = half;
    }
    ck_assert_int_eq(stored.width, size);
    int wrong = 0;
    for (int i = 0; i < size * size * 4; i++)
        wrong += stored.pixels[i] != (uint8_t)(values[i] * 255);
    ck_assert_int_eq(wrong, 0);
    free(values);
    rn_image_finish(&image);
    rn_image_finish(&stored);
}

START_TEST(import_lego) {
    read_ok(lego);
    struct rn_dataset part = *dataset; // two views are enough
    part.frame_count = 2;
    memset(part.view_count, 0, sizeof part.view_count);
    part.view_count[RN_SPLIT_TRAIN] = 2;
    struct rn_import_options options = {
        .scales = 4, .threads = 2, .downscale = (enum rn_downscale)_i};
    ck_assert_msg(rn_dataset_import(&part, "lego", &options, in_folder("out"), &problems, NULL,
                                    NULL, &err) == RN_OK,
                  "%s: %s", err.where, err.text);
    struct rn_dataset *made = NULL;
    ck_assert_int_eq(rn_dataset_read(in_folder("out"), &problems, &made, &err), RN_OK);
    ck_assert_uint_eq(made->frame_count, 8);
    ck_assert_int_eq(made->scale_count, 4);
    ck_assert_int_eq(made->premultiplied_scales, _i == RN_DOWNSCALE_PREMULTIPLIED);
    for (size_t i = 0; i < made->frame_count; i++) {
        const struct rn_frame *frame = &made->frames[i];
        ck_assert_int_eq(frame->camera.width, 800 >> frame->scale);
        ck_assert_double_eq_tol(frame->camera.fx * (1 << frame->scale), 1111.1111, 1e-3);
        if (_i == RN_DOWNSCALE_STRAIGHT)
            assert_legacy(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, frame->index, 0), frame);
    }
    rn_dataset_destroy(&made);
}
END_TEST

int main(void) {
    const char *data = getenv("RIPNERF_TEST_DATA");
    snprintf(lego, sizeof lego, "%s/nerf_synthetic/lego", data ? data : "../shared/data");
    if (access(lego, F_OK) != 0) {
        printf("skipped: no lego at %s (set RIPNERF_TEST_DATA)\n", lego);
        return 77;
    }
    Suite *suite = suite_create("lego");
    TCase *tests = tcase_create("lego");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_set_timeout(tests, 60);
    tcase_add_test(tests, read_lego);
    tcase_add_loop_test(tests, import_lego, RN_DOWNSCALE_PREMULTIPLIED, RN_DOWNSCALE_STRAIGHT + 1);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
