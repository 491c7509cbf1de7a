// Cameras: rays, resizing, checks and poses.
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/ball.h"
#include "common/math/camera.h"
#include "common/math/rng.h"
#include "common/math/rotation.h"
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
        ck_assert_double_eq_tol(rn_camera_fov_from_focal(other.fy, other.height),
                                rn_camera_fov_from_focal(full.fy, full.height), 1e-12);
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
        ck_assert_double_eq_tol(rn_camera_fov_from_focal(camera.fy, camera.height), radians, 4e-15);
    }
    ck_assert_double_eq_tol(rn_camera_focal_from_fov(pi / 2, 800), 400, 1e-12);
}
END_TEST

static void assert_refused(struct rn_camera *camera, const char *field) {
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
    REFUSE(bad.fx = 1e308, "fx"); // finite, and the sum of two is not
    REFUSE(bad.fy = 1e-308, "fy");
    REFUSE(bad.cx = -1e300, "cx");
    REFUSE(bad.fy = INFINITY, "fy");
    REFUSE(bad.cx = NAN, "cx");
    REFUSE(bad.cy = -INFINITY, "cy");
    REFUSE(bad.world_from_camera[1][3] = NAN, "world_from_camera");
    REFUSE(bad.world_from_camera[2][3] = 1.01e12, "world_from_camera");
    REFUSE(bad.world_from_camera[0][3] = -1e308, "world_from_camera"); // finite; its square is not
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
    bad.world_from_camera[1][3] = -1e12;
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

// Turns of all sizes, about half a turn too, where a quaternion's first number vanishes: there and
// back, and the inverse's inverse.
START_TEST(rotations_there_and_back) {
    for (int i = 0; i < 200; i++) {
        double half = pi * i / 200, side = 3 * sin(half) / sqrt(5 + i % 3);
        double q[4] = {3 * cos(half), side, -2 * side, sqrt(i % 3) * side}; // of length 3
        double pose[3][4], again[4], inverse[3][4], back[3][4];
        for (int r = 0; r < 3; r++)
            pose[r][3] = 10 * r - i;
        ck_assert(rn_rotation_from_quaternion(q, pose));
        ck_assert_double_lt(rn_rotation_skew((const double(*)[4])pose), 4e-15);
        ck_assert_double_eq_tol(rn_rotation_determinant((const double(*)[4])pose), 1, 8e-15);
        rn_rotation_to_quaternion((const double(*)[4])pose, again);
        double sign = 0;
        for (int c = 0; c < 4; c++)
            sign += again[c] * q[c] / 3;
        ck_assert_double_eq_tol(fabs(sign), 1, 1e-14);
        rn_pose_invert((const double(*)[4])pose, inverse);
        rn_pose_invert((const double(*)[4])inverse, back);
        for (int r = 0; r < 3; r++)
            for (int c = 0; c < 4; c++)
                ck_assert_double_eq_tol(back[r][c], pose[r][c], 1e-12);
    }
    const double none[4] = {0}, endless[4] = {INFINITY};
    double untouched[3][4] = {{7}};
    ck_assert(!rn_rotation_from_quaternion(none, untouched));
    ck_assert(!rn_rotation_from_quaternion(endless, untouched));
    ck_assert(untouched[0][0] == 7);
}
END_TEST

// The same turn as a vector and as a quaternion, from none to a whole one.
START_TEST(turns_by_vectors) {
    for (int i = 0; i < 60; i++) {
        double angle = i < 20 ? 2 * pi * pow(10, -i) : 2 * pi * (i - 20) / 40;
        double axis[3] = {2.0 / 3, -1.0 / 3, 2.0 / 3}, by[3], q[4] = {cos(angle / 2)};
        double turned[3][4] = {{0, 0, 0, 7}}, expected[3][4] = {{0, 0, 0, 7}};
        for (int c = 0; c < 3; c++) {
            by[c] = angle * axis[c];
            q[1 + c] = sin(angle / 2) * axis[c];
        }
        rn_rotation_from_vector(by, turned);
        ck_assert(rn_rotation_from_quaternion(q, expected));
        for (int r = 0; r < 3; r++)
            for (int c = 0; c < 4; c++)
                ck_assert_double_eq_tol(turned[r][c], expected[r][c], 2e-15);
    }
    const double endless[3] = {1, INFINITY, 0}, beyond[3] = {1e200, 0, 1e200};
    double pose[3][4];
    rn_rotation_from_vector(endless, pose);
    ck_assert(isnan(pose[0][0]));
    rn_rotation_from_vector(beyond, pose);
    ck_assert(isnan(pose[0][0]));
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

// In [low, high): number `i` of a stream.
static double drawn(uint64_t stream, uint64_t i, double low, double high) {
    struct rn_rng4 draw = rn_rng_draw(7, stream, i);
    return low + (high - low) * (double)rn_rng_unit(draw.v[0]);
}

static struct rn_camera with_lens(int lens, uint64_t stream) {
    struct rn_camera camera = example();
    camera.lens = (enum rn_lens)lens;
    camera.cx += drawn(stream, 90, -80, 80);
    if (lens == RN_LENS_FISHEYE || lens == RN_LENS_THIN_PRISM_FISHEYE) camera.fx = camera.fy = 200;
    if (lens == RN_LENS_EQUIRECTANGULAR) {
        camera.fx = camera.width / (2 * pi), camera.cx = 0.5 * camera.width;
        camera.fy = camera.height / pi;
    }
    double most = stream % 2 ? 0.05 : 0.4;
    for (int i = 0; i < rn_lens_models[lens].count; i++) {
        char kind = rn_lens_models[lens].parameters[i][0];
        double size = kind == 'k' ? most : 0.02 * most;
        camera.lens_k[i] = drawn(stream, 100 + (uint64_t)i, -size, size);
    }
    if (lens == RN_LENS_FOV) camera.lens_k[0] = drawn(stream, 99, 0.1, 1.6);
    ck_assert_int_eq(rn_camera_check(&camera, "", NULL), RN_OK);
    return camera;
}

// A pixel's ray, followed anywhere, is seen at the pixel.
START_TEST(rays_lead_back_to_their_pixels) {
    int seen = 0;
    for (uint64_t stream = 0; stream < 400; stream++) {
        struct rn_camera camera = with_lens(_i, stream);
        double px = drawn(stream, 0, 0, camera.width), py = drawn(stream, 1, 0, camera.height);
        struct rn_ray ray = rn_camera_ray(&camera, px, py);
        double point[3], own[3], at[2] = {0, 0};
        if (!(ray.radius > 0)) continue;
        for (int i = 0; i < 3; i++)
            point[i] = ray.origin[i] + drawn(stream, 2, 0.1, 10) * ray.direction[i];
        rn_camera_axes(&camera, point, own);
        ck_assert(rn_camera_project(&camera, own, at));
        ck_assert_double_eq_tol(at[0], px, 1e-8);
        ck_assert_double_eq_tol(at[1], py, 1e-8);
        seen++;
    }
    ck_assert_int_ge(seen, 200);
}
END_TEST

// Where a point of a ball's surface is on the picture, the ball's box has it.
START_TEST(boxes_hold_their_balls) {
    int boxes = 0, inside = 0;
    for (uint64_t stream = 0; stream < 600; stream++) {
        struct rn_camera camera = with_lens(_i, stream);
        struct rn_ball_viewer viewer = rn_ball_viewer_init(&camera);
        struct rn_ball_box box = {0};
        double centre[3], radius = pow(2, drawn(stream, 0, -7, 0));
        for (int i = 0; i < 3; i++)
            centre[i] = camera.world_from_camera[i][3] + drawn(stream, 1 + (uint64_t)i, -4, 4);
        enum rn_ball_image image = rn_ball_image(&viewer, centre, radius, &box);
        boxes += image == RN_BALL_BOX;
        for (uint64_t k = 0; k < 100; k++) {
            double point[3], own[3], at[2], norm = 0;
            for (int i = 0; i < 3; i++) {
                point[i] = drawn(stream, 1000 + 3 * k + (uint64_t)i, -1, 1);
                norm += point[i] * point[i];
            }
            for (int i = 0; i < 3; i++)
                point[i] = centre[i] + radius * point[i] / sqrt(norm);
            rn_camera_axes(&camera, point, own);
            if (!rn_camera_project(&camera, own, at) || at[0] < 0 || at[1] < 0 ||
                at[0] > camera.width || at[1] > camera.height)
                continue;
            ck_assert_int_ne(image, RN_BALL_UNSEEN);
            if (image == RN_BALL_AROUND) continue;
            ck_assert(at[0] >= box.x0 && at[0] <= box.x1 && at[1] >= box.y0 && at[1] <= box.y1);
            inside++;
        }
    }
    ck_assert_int_ge(boxes, 50);
    ck_assert_int_ge(inside, 200);
}
END_TEST

// Without parameters, and as the angle goes to 0, a lens is the pinhole.
START_TEST(no_lens_is_the_pinhole) {
    static const enum rn_lens lenses[] = {RN_LENS_OPENCV, RN_LENS_POLYNOMIAL, RN_LENS_FOV};
    for (int i = 0; i < 3; i++) {
        struct rn_camera plain = example(), lens = plain;
        lens.lens = lenses[i];
        ck_assert_int_eq(rn_camera_check(&lens, "", NULL), RN_OK);
        struct rn_ray a = rn_camera_ray(&plain, 700.5, 20.5);
        struct rn_ray b = rn_camera_ray(&lens, 700.5, 20.5);
        ck_assert_mem_eq(a.direction, b.direction, sizeof a.direction);
        ck_assert_double_eq(a.radius, b.radius);
        lens.lens_k[0] = 0.3;
        struct rn_camera bare = rn_camera_without_lens(&lens);
        ck_assert_int_eq(rn_camera_check(&bare, "", NULL), RN_OK);
        ck_assert_int_eq(bare.lens, RN_LENS_PINHOLE);
    }
}
END_TEST

// Barrel: r (1 - 0.3 r^2) is at most 0.7027, so that the corners of a wide picture see nothing.
START_TEST(corners_beyond_the_fold) {
    struct rn_camera camera = {.width = 800,
                               .height = 800,
                               .fx = 500,
                               .fy = 500,
                               .cx = 400,
                               .cy = 400,
                               .lens = RN_LENS_OPENCV,
                               .lens_k = {-0.3}};
    for (int i = 0; i < 3; i++)
        camera.world_from_camera[i][i] = 1;
    ck_assert_int_eq(rn_camera_check(&camera, "", NULL), RN_OK);
    ck_assert_double_eq_tol(camera.lens_fold, sqrt(1 / 0.9), 1e-9);
    ck_assert_double_eq(rn_camera_ray(&camera, 0.5, 0.5).radius, 0);
    ck_assert_double_eq(rn_camera_ray(&camera, 751.6, 400).radius, 0);
    ck_assert_double_gt(rn_camera_ray(&camera, 751.2, 400).radius, 0);
    double far[3] = {1.2, 0, 1}, at[2] = {0, 0}; // would be seen twice
    ck_assert(!rn_camera_project(&camera, far, at));
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
    tcase_add_test(cases, rotations_there_and_back);
    tcase_add_test(cases, turns_by_vectors);
    tcase_add_test(cases, look_at_degenerate);
    tcase_add_loop_test(cases, rays_lead_back_to_their_pixels, 0, RN_LENS_COUNT);
    tcase_add_loop_test(cases, boxes_hold_their_balls, 0, RN_LENS_COUNT);
    tcase_add_test(cases, no_lens_is_the_pinhole);
    tcase_add_test(cases, corners_beyond_the_fold);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
