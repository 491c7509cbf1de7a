// Cameras: rays, resizing, checks and poses.
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/camera.h"
#include "tests/support/suite.h"

static const double pi = 3.14159265358979323846;

static struct rn_camera example(void) {
    struct rn_camera camera = {
        .width = 800, .height = 600, .fx = 1000, .fy = 900, .cx = 400, .cy = 300};
    const double eye[3] = {1, 2, 3}, target[3] = {-1, 0.5, 0}, up[3] = {0, 0, 1};
    ck_assert_int_eq(rn_camera_look_at(eye, target, up, camera.world_from_camera), RN_OK);
    return camera;
}

START_TEST(principal_ray) {
    struct rn_camera camera = example();
    struct rn_ray ray = rn_camera_ray(&camera, 400, 300);
    double norm = sqrt(4 + 2.25 + 9);
    const double expected[3] = {-2 / norm, -1.5 / norm, -3 / norm};
    for (int i = 0; i < 3; i++) {
        ck_assert_double_eq_tol(ray.direction[i], expected[i], 1e-15);
        ck_assert_double_eq(ray.origin[i], i + 1.0);
    }
    ck_assert_double_eq_tol(ray.radius, sqrt(1 / (pi * 900000)), 1e-18);
}
END_TEST

// A pixel right of the centre looks to the right, one below it looks down.
START_TEST(axes) {
    struct rn_camera camera = {.width = 2, .height = 2, .fx = 1, .fy = 1, .cx = 1, .cy = 1};
    const double eye[3] = {0, -4, 0}, target[3] = {0, 0, 0}, up[3] = {0, 0, 1};
    ck_assert_int_eq(rn_camera_look_at(eye, target, up, camera.world_from_camera), RN_OK);
    struct rn_ray right = rn_camera_ray(&camera, 2, 1), down = rn_camera_ray(&camera, 1, 2);
    ck_assert_double_eq_tol(right.direction[0], sqrt(0.5), 1e-15);
    ck_assert_double_eq_tol(right.direction[1], sqrt(0.5), 1e-15);
    ck_assert_double_eq_tol(down.direction[2], -sqrt(0.5), 1e-15);
}
END_TEST

START_TEST(resized_keeps_directions) {
    struct rn_camera full = example(), half = rn_camera_resized(&full, 400, 300);
    ck_assert_int_eq(half.width, 400);
    ck_assert_int_eq(half.height, 300);
    for (int i = 0; i < 20; i++) {
        double x = 40.0 * i, y = 30.0 * i;
        struct rn_ray a = rn_camera_ray(&full, x, y), b = rn_camera_ray(&half, x / 2, y / 2);
        for (int k = 0; k < 3; k++)
            ck_assert_double_eq_tol(a.direction[k], b.direction[k], 1e-15);
        ck_assert_double_eq_tol(b.radius, 2 * a.radius, 1e-16);
    }
    struct rn_camera odd = rn_camera_resized(&full, 267, 300);
    ck_assert_double_eq_tol(odd.fx, 1000 * 267.0 / 800, 1e-12);
    ck_assert_double_eq_tol(odd.fy, 450, 1e-12);
}
END_TEST

// What both pictures show looks the same in both, whatever the new shape.
START_TEST(reframed_keeps_shapes) {
    static const int sizes[][2] = {{800, 600}, {1600, 600}, {400, 300}, {300, 300}, {1000, 150}};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        struct rn_camera full = example();
        struct rn_camera other = rn_camera_reframed(&full, sizes[i][0], sizes[i][1]);
        double scale = sizes[i][1] / 600.0;
        ck_assert_int_eq(other.width, sizes[i][0]);
        ck_assert_int_eq(other.height, sizes[i][1]);
        ck_assert_double_eq_tol(other.fx / other.fy, full.fx / full.fy, 1e-12);
        ck_assert_double_eq_tol(rn_camera_fov_y(&other), rn_camera_fov_y(&full), 1e-12);
        for (int k = -3; k <= 3; k++) {
            double x = 400 + 30 * k, y = 300 + 70 * k; // of the old picture
            struct rn_ray a = rn_camera_ray(&full, x, y);
            struct rn_ray b =
                rn_camera_ray(&other, 0.5 * sizes[i][0] + scale * (x - 400), scale * y);
            for (int c = 0; c < 3; c++)
                ck_assert_double_eq_tol(a.direction[c], b.direction[c], 1e-14);
        }
    }
}
END_TEST

START_TEST(fields_of_view) {
    for (double degrees = 0.01; degrees < 179.5; degrees *= 1.3) {
        double radians = degrees * pi / 180;
        struct rn_camera camera = {.height = 480};
        camera.fy = rn_camera_focal_from_fov(radians, 480);
        ck_assert_double_gt(camera.fy, 0);
        ck_assert_double_eq_tol(rn_camera_fov_y(&camera), radians, 4e-15);
    }
    ck_assert_double_eq_tol(rn_camera_focal_from_fov(pi / 2, 800), 400, 1e-12);
}
END_TEST

static void assert_refused(const struct rn_camera *camera, const char *field) {
    struct rn_error err = {0};
    ck_assert_int_eq(rn_camera_check(camera, "f.json#/frames/3", &err), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where + 17, field);
    ck_assert_int_eq(strncmp(err.where, "f.json#/frames/3/", 17), 0);
    ck_assert_int_eq(rn_camera_check(camera, NULL, &err), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, field);
}

START_TEST(checks) {
    struct rn_camera good = example(), bad;
    ck_assert_int_eq(rn_camera_check(&good, "", NULL), RN_OK);
#define REFUSE(change, field)                                                                      \
    do {                                                                                           \
        bad = good;                                                                                \
        change;                                                                                    \
        assert_refused(&bad, field);                                                               \
    } while (0)
    REFUSE(bad.lens = RN_LENS_COUNT, "lens");
    REFUSE(bad.lens = (enum rn_lens) - 1, "lens");
    REFUSE(bad.lens_k[0] = 0.1, "lens"); // a pinhole has none
    REFUSE((bad.lens = RN_LENS_OPENCV, bad.lens_k[2] = NAN), "lens/p1");
    REFUSE((bad.lens = RN_LENS_OPENCV, bad.lens_k[7] = -1e7), "lens/k6");
    REFUSE((bad.lens = RN_LENS_OPENCV, bad.lens_k[8] = 1), "lens");
    REFUSE((bad.lens = RN_LENS_FOV, bad.lens_k[0] = 3.2), "lens/omega");
    REFUSE(bad.width = 0, "width");
    REFUSE(bad.width = RN_CAMERA_MAX_SIZE + 1, "width");
    REFUSE(bad.height = -1, "height");
    REFUSE(bad.fx = 0, "fx");
    REFUSE(bad.fx = NAN, "fx");
    REFUSE(bad.fy = INFINITY, "fy");
    REFUSE(bad.cx = NAN, "cx");
    REFUSE(bad.cy = -INFINITY, "cy");
    REFUSE(bad.world_from_camera[1][3] = NAN, "world_from_camera");
    REFUSE(bad.world_from_camera[0][0] += 2e-3, "world_from_camera");
    REFUSE(for (int i = 0; i < 3; i++) bad.world_from_camera[i][0] *= -1, "world_from_camera");
    REFUSE(for (int i = 0; i < 3; i++) for (int j = 0; j < 3; j++) bad.world_from_camera[i][j] *= 2,
           "world_from_camera");
    REFUSE(for (int i = 0; i < 3; i++) for (int j = 0; j < 3; j++) bad.world_from_camera[i][j] = 0,
           "world_from_camera");
    bad = good;
    bad.lens = RN_LENS_FISHEYE;
    bad.lens_k[3] = -0.25;
    ck_assert_int_eq(rn_camera_check(&bad, "", NULL), RN_OK);
    bad = good;
    bad.world_from_camera[0][0] += 1e-5; // files carry rounded poses
    ck_assert_int_eq(rn_camera_check(&bad, "", NULL), RN_OK);
}
END_TEST

static void assert_orthonormal(double pose[3][4]) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double dot = 0;
            for (int k = 0; k < 3; k++)
                dot += pose[k][i] * pose[k][j];
            ck_assert_double_eq_tol(dot, i == j, 4 * DBL_EPSILON);
        }
}

START_TEST(look_at) {
    static const double targets[][3] = {{1, 0, 0},         {0, 1, 1e-8}, {1e-200, 2e-200, 0},
                                        {1e200, 0, 1e200}, {1e-5, 0, 1}, {-3, 4, -5}};
    const double eye[3] = {0, 0, 0}, up[3] = {0, 0, 3e-160};
    for (size_t i = 0; i < sizeof targets / sizeof *targets; i++) {
        double pose[3][4];
        ck_assert_int_eq(rn_camera_look_at(eye, targets[i], up, pose), RN_OK);
        assert_orthonormal(pose);
        ck_assert_double_le(pose[2][1], 0); // the image's y axis points down
    }
}
END_TEST

START_TEST(look_at_degenerate) {
    const double eye[3] = {1, 2, 3}, above[3] = {1, 2, 9}, up[3] = {0, 0, 1}, zero[3] = {0, 0, 0};
    const double nan[3] = {NAN, 0, 0}, infinite[3] = {0, INFINITY, 0}, side[3] = {5, 5, 5};
    double pose[3][4];
    ck_assert_int_eq(rn_camera_look_at(eye, eye, up, pose), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_camera_look_at(eye, above, up, pose), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_camera_look_at(eye, side, zero, pose), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_camera_look_at(eye, nan, up, pose), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_camera_look_at(eye, infinite, up, pose), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_camera_look_at(eye, side, nan, pose), RN_ERROR_INVALID);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("camera");
    TCase *cases = tcase_create("camera");
    tcase_add_test(cases, principal_ray);
    tcase_add_test(cases, axes);
    tcase_add_test(cases, resized_keeps_directions);
    tcase_add_test(cases, reframed_keeps_shapes);
    tcase_add_test(cases, fields_of_view);
    tcase_add_test(cases, checks);
    tcase_add_test(cases, look_at);
    tcase_add_test(cases, look_at_degenerate);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
