// Real captures in the layouts that people have, where the data is. Skipped (77) without it.
#include <limits.h>
#include <math.h>
#include <unistd.h>

#include "tests/unit/common/dataset_fixture.h"

static char data[PATH_MAX];

static const char *capture(const char *name) {
    static char path[PATH_MAX + 64];
    snprintf(path, sizeof path, "%s/%s", data, name);
    return path;
}

static bool tells(const char *text) {
    for (size_t i = 0; i < problems.count; i++)
        if (strstr(problems.items[i].text, text)) return true;
    return false;
}

// Every point is seen where COLMAP says, to 0.01 px; LLFF's file has the same poses, and the first
// photograph's focal length for all.
START_TEST(cup) {
    read_ok(capture("real/cup_colmap"));
    ck_assert_str_eq(dataset->format->name, "colmap");
    ck_assert_uint_eq(dataset->frame_count, 77);
    struct rn_reprojection found;
    ck_assert_int_eq(rn_dataset_reproject(dataset, &found, &err), RN_OK);
    ck_assert_uint_eq(found.points, 9262);
    ck_assert_uint_eq(found.sightings, 57847);
    ck_assert_double_eq_tol(found.mean_px, found.said_px, 1e-3);
    ck_assert_double_eq_tol(found.median_px, 0.4641, 1e-3);
    ck_assert(tells("focal lengths by up to 59.6588 px"));
    struct rn_read_options options = {.format = "llff"};
    struct rn_dataset *other;
    ck_assert_int_eq(rn_dataset_read_as(capture("real/cup_colmap"), &options, NULL, &other, &err),
                     RN_OK);
    for (size_t i = 0; i < 77; i++) {
        const struct rn_camera *a = &dataset->frames[i].camera, *b = &other->frames[i].camera;
        ck_assert_str_eq(dataset->frames[i].path, other->frames[i].path);
        for (int j = 0; j < 12; j++)
            ck_assert_double_eq_tol((&a->world_from_camera[0][0])[j],
                                    (&b->world_from_camera[0][0])[j], 1e-12);
    }
    rn_dataset_destroy(&other);
}
END_TEST

START_TEST(fox) {
    read_ok(capture("real/fox"));
    ck_assert_str_eq(dataset->format->name, "instant-ngp");
    ck_assert_uint_eq(dataset->frame_count, 50);
    ck_assert_int_eq(dataset->unusable[RN_SPLIT_TRAIN], 17);
    ck_assert_uint_eq(problems.errors, 0);
    ck_assert_int_eq(dataset->frames[0].camera.lens, RN_LENS_OPENCV);
    ck_assert_double_eq(dataset->frames[0].camera.fy, 1374.49);
}
END_TEST

START_TEST(statue) {
    read_ok(capture("real/statue_wild"));
    ck_assert_str_eq(dataset->format->name, "llff");
    ck_assert(tells("neither sparse/0/images.bin nor sparse/0/images.txt is there"));
    ck_assert_uint_eq(dataset->frame_count, 135);
    for (size_t i = 0; i < 135; i++)
        ck_assert_ptr_nonnull(dataset->frames[i].mask_path);
}
END_TEST

START_TEST(forward_facing) {
    read_ok(capture(_i ? "real/llff_horns" : "nerf_llff/fern"));
    ck_assert_uint_eq(dataset->frame_count, _i ? 62 : 20);
    ck_assert_int_eq(dataset->lie.kind, RN_CAPTURE_FORWARD);
    ck_assert_double_gt(dataset->frames[0].near, 0);
}
END_TEST

START_TEST(tractor) {
    read_ok(capture("real/tractor"));
    ck_assert_uint_eq(dataset->frame_count, 74);
    ck_assert_double_gt(dataset->frames[0].camera.fy / dataset->frames[0].camera.fx, 1.19);
    ck_assert_int_eq(dataset->lie.kind, RN_CAPTURE_OUTDOOR);
}
END_TEST

int main(void) {
    const char *given = getenv("RIPNERF_TEST_DATA");
    snprintf(data, sizeof data, "%s", given ? given : "../shared/data");
    if (access(capture("real/cup_colmap"), R_OK) != 0) {
        printf("skipped: no captures in %s\n", data);
        return 77;
    }
    Suite *suite = suite_create("captures");
    TCase *tests = tcase_create("captures");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_set_timeout(tests, 60);
    tcase_add_test(tests, cup);
    tcase_add_test(tests, fox);
    tcase_add_test(tests, statue);
    tcase_add_loop_test(tests, forward_facing, 0, 2);
    tcase_add_test(tests, tractor);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
