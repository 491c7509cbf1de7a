// How synthetic photographs are taken: lens, exposure, blur, people who move, and captures.
#include <math.h>

#include "common/dataset/exposure.h"
#include "common/math/srgb.h"
#include "tests/unit/common/dataset_fixture.h"

enum { SIZE = 24, VIEWS = 8, SAMPLES = 16 };

static void synthesise(struct rn_synth_options options) {
    options.size = SIZE;
    options.views = VIEWS;
    options.threads = 2;
    options.samples = SAMPLES;
    enum rn_status status = rn_synthesise("place", &options, in_folder("out"), NULL, NULL, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
    read_ok(in_folder("out"));
    ck_assert_uint_eq(problems.errors, 0);
}

// Mean over a photograph of its light beside the truth's, in stops, and the share of its pixels
// that differ from the truth.
struct beside {
    double stops, share;
};

static struct beside compare(const struct rn_frame *frame) {
    struct rn_picture truth;
    struct rn_image expected, stored;
    struct beside beside = {0, 0};
    int lit = 0;
    ck_assert_int_eq(rn_synth_render("place", &frame->camera, SAMPLES, &truth, &err), RN_OK);
    ck_assert_int_eq(rn_picture_to_image(&truth, &expected, &err), RN_OK);
    ck_assert_int_eq(rn_image_read(frame->path, &rn_image_default_limits, &stored, &err), RN_OK);
    for (int p = 0; p < SIZE * SIZE; p++) {
        int a = stored.pixels[4 * p + 1], b = expected.pixels[4 * p + 1];
        beside.share += (abs(a - b) > 2) / (double)(SIZE * SIZE);
        if (a < 40 || b < 40 || a > 250 || b > 250) continue;
        beside.stops += log2((double)rn_srgb_to_linear((float)a / 255) /
                             (double)rn_srgb_to_linear((float)b / 255));
        lit++;
    }
    ck_assert_int_gt(lit, SIZE * SIZE / 4);
    beside.stops /= lit;
    rn_picture_finish(&truth);
    rn_image_finish(&expected);
    rn_image_finish(&stored);
    return beside;
}

// The test views are the truth, whatever the others are; of those, how far they are from it.
static struct beside largest(void) {
    struct beside most = {0, 0};
    for (size_t i = 0; i < dataset->frame_count; i++) {
        struct beside beside = compare(&dataset->frames[i]);
        if (dataset->frames[i].split == RN_SPLIT_TEST) {
            ck_assert_double_lt(beside.share, 0.01);
        } else {
            most.stops = fmax(most.stops, fabs(beside.stops));
            most.share = fmax(most.share, beside.share);
        }
    }
    return most;
}

// The lens that is written is the one through which the pictures were taken, the test views' too.
START_TEST(lens) {
    synthesise((struct rn_synth_options){.lens = {-0.2, 0.03, 0.002, -0.001}});
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_camera *camera = &dataset->frames[i].camera;
        ck_assert_int_ne(camera->lens, RN_LENS_PINHOLE);
        struct rn_camera straight = rn_camera_without_lens(camera);
        double apart = 0;
        for (int c = 0; c < 3; c++)
            apart += fabs(rn_camera_ray(camera, 0.5, 0.5).direction[c] -
                          rn_camera_ray(&straight, 0.5, 0.5).direction[c]);
        ck_assert_double_gt(apart, 0.02);
    }
    ck_assert_double_lt(largest().share, 0.01);
}
END_TEST

START_TEST(exposure) {
    synthesise((struct rn_synth_options){.exposure = 0.6});
    double most = largest().stops;
    ck_assert_double_gt(most, 0.3);
    ck_assert_double_lt(most, 0.63);
}
END_TEST

START_TEST(blur) {
    struct rn_synth_options options = {.aperture = _i == 0 ? 0.1 : 0, .shutter = _i ? 0.3 : 0};
    synthesise(options);
    struct beside most = largest();
    ck_assert_double_gt(most.share, 0.15);
    ck_assert_double_lt(most.stops, 0.3);
}
END_TEST

START_TEST(people) {
    synthesise((struct rn_synth_options){.movers = 3});
    double share = largest().share;
    ck_assert_double_gt(share, 0.02);
    ck_assert_double_lt(share, 0.6);
}
END_TEST

// COLMAP's layout: cameras that are right, and points that photographs see where they say.
START_TEST(capture) {
    synthesise((struct rn_synth_options){.exposure = 0.6, .capture = true, .lens = {-0.1}});
    ck_assert_str_eq(dataset->format->name, "colmap");
    ck_assert_uint_eq(dataset->frame_count, VIEWS + 2);
    ck_assert_uint_gt(dataset->points.count, 1000);
    ck_assert_uint_gt(dataset->points.sighting_count, 4 * dataset->points.count);
    for (size_t i = 0; i < dataset->points.sighting_count; i++) {
        const struct rn_sighting *sighting = &dataset->points.sightings[i];
        const struct rn_camera *camera = &dataset->frames[sighting->photo].camera;
        double axes[3], at[2];
        rn_camera_axes(camera, dataset->points.items[sighting->point].position, axes);
        ck_assert(rn_camera_project(camera, axes, at));
        ck_assert_double_eq_tol(at[0], (double)sighting->x * SIZE, 1e-3);
        ck_assert_double_eq_tol(at[1], (double)sighting->y * SIZE, 1e-3);
    }
    for (size_t i = 0; i < dataset->frame_count; i++) {
        struct beside beside = compare(&dataset->frames[i]);
        if (i % 8 == 0)
            ck_assert_double_lt(beside.share, 0.01);
        else
            ck_assert_double_gt(beside.share, 0.1);
    }
}
END_TEST

static void refused(const char *scene, struct rn_synth_options options, const char *where) {
    options.size = SIZE;
    options.views = options.threads = options.samples = 1;
    ck_assert_int_eq(rn_synthesise(scene, &options, in_folder("out"), NULL, NULL, &err),
                     RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, where);
}

START_TEST(bad_options) {
    refused("place", (struct rn_synth_options){.lens = {-3}}, "lens");
    refused("place", (struct rn_synth_options){.lens = {NAN}}, "lens");
    refused("place", (struct rn_synth_options){.exposure = -1}, "exposure");
    refused("place", (struct rn_synth_options){.exposure = NAN}, "exposure");
    refused("place", (struct rn_synth_options){.aperture = 2}, "aperture");
    refused("place", (struct rn_synth_options){.shutter = INFINITY}, "shutter");
    refused("place", (struct rn_synth_options){.movers = RN_SYNTH_MOVERS + 1}, "movers");
    refused("fence", (struct rn_synth_options){.movers = 1}, "movers");
}
END_TEST

int main(void) {
    Suite *suite = suite_create("synth_shots");
    TCase *tests = tcase_create("synth_shots");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_set_timeout(tests, 60);
    tcase_add_test(tests, lens);
    tcase_add_test(tests, exposure);
    tcase_add_loop_test(tests, blur, 0, 2);
    tcase_add_test(tests, people);
    tcase_add_test(tests, capture);
    tcase_add_test(tests, bad_options);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
