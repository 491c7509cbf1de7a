// Synthetic scenes: exact intersections, truth at every scale, files that the reader takes.
#include <math.h>

#include "common/dataset/synth_scenes.h"
#include "tests/unit/common/dataset_fixture.h"

static const char *const scenes[] = {"sphere", "fence", "nested", "still-life", "place", "window"};
enum { OBJECTS = 4, SCENES = 6 };

static double uniform(uint64_t counter, double low, double high) {
    return low + (high - low) * (double)rn_rng_unit(rn_rng_draw(7, 0, counter).v[0]);
}

// A ray from the sphere of radius 3 to a point of the unit ball's bounding cube.
static struct ray random_ray(uint64_t i) {
    struct vec from = {uniform(6 * i, -1, 1), uniform(6 * i + 1, -1, 1), uniform(6 * i + 2, -1, 1)};
    struct vec to = {uniform(6 * i + 3, -1, 1), uniform(6 * i + 4, -1, 1),
                     uniform(6 * i + 5, -1, 1)};
    from = vec_scale(3, vec_unit(from));
    return (struct ray){from, vec_unit(vec_add(to, -1, from)), {0}, NULL};
}

// ---- shapes against their definitions, by marching

#define STEP 5e-4

static bool one_hole(const void *holes, struct vec direction, struct vec *axis, double *cosine) {
    *axis = (struct vec){0.6, 0, 0.8};
    *cosine = 0.7;
    return vec_dot(*axis, direction) > *cosine;
}

static const struct shell shell = {
    .centre = {0.1, 0, -0.1}, .inner = 0.6, .outer = 0.8, .hole_at = one_hole};

static bool in_shell(struct vec p) {
    p = vec_add(p, -1, shell.centre);
    double r = sqrt(vec_dot(p, p));
    return r > 0.6 && r < 0.8 && (0.6 * p.x + 0.8 * p.z) / r <= 0.7;
}

static bool in_cylinder(struct vec p) {
    return hypot(p.x, p.y) < 0.5 && p.z > -0.7 && p.z < 0.2;
}

static bool in_box(struct vec p) {
    return fabs(p.x) < 0.3 && fabs(p.y) < 0.6 && p.z > -0.2 && p.z < 0.5;
}

static bool in_ball(struct vec p) {
    return vec_dot(p, p) < 0.49;
}

static void cast(int shape, const struct ray *ray, struct hit *hit) {
    switch (shape) {
    case 0:
        hit_shell(ray, &shell, hit);
        break;
    case 1:
        hit_cylinder(ray, 0.5, -0.7, 0.2, 0, hit);
        break;
    case 2:
        hit_box(ray, (struct vec){-0.3, -0.6, -0.2}, (struct vec){0.3, 0.6, 0.5}, 0, hit);
        break;
    default:
        hit_ball(ray, (struct vec){0, 0, 0}, 0.7, 0, hit);
    }
}

// The hit is the first point inside, but for solids thinner than a step; its normal faces the ray.
START_TEST(shapes) {
    static bool (*const inside[])(struct vec) = {in_shell, in_cylinder, in_box, in_ball};
    int hits = 0, rays = 400;
    for (int i = 0; i < rays; i++) {
        struct ray ray = random_ray((uint64_t)i);
        struct hit hit = {.t = INFINITY};
        cast(_i, &ray, &hit);
        double marched = INFINITY;
        for (double t = 0; t < 6 && marched == INFINITY; t += STEP)
            if (inside[_i](ray_at(&ray, t))) marched = t;
        if (hit.t == INFINITY) {
            ck_assert_msg(marched == INFINITY, "ray %d enters at %g unseen", i, marched);
            continue;
        }
        hits++;
        ck_assert_double_le(hit.t, marched + 1e-9);
        if (hit.t < marched - STEP) { // a corner was cut: inside just behind the surface
            ck_assert(inside[_i](ray_at(&ray, hit.t + 1e-6)));
            ck_assert(!inside[_i](ray_at(&ray, hit.t - 1e-6)));
        }
        ck_assert_double_lt(vec_dot(hit.normal, ray.direction), 1e-9);
        ck_assert_double_eq_tol(vec_dot(hit.normal, hit.normal), 1, 1e-9);
    }
    ck_assert_int_gt(hits, rays / 8);
    ck_assert_int_lt(hits, rays);
}
END_TEST

START_TEST(scene_lies_within_its_radius) {
    const struct rn_synth_scene *scene = rn_synth_find(scenes[_i]);
    ck_assert_double_le(scene->radius, 1.5);
    double farthest = 0;
    for (uint64_t i = 0; i < 5000; i++) {
        struct ray ray = random_ray(i);
        double rgb[3], t;
        if (!rn_synth_trace(scene, &ray, rgb, &t)) continue;
        struct vec p = ray_at(&ray, t);
        farthest = fmax(farthest, sqrt(vec_dot(p, p)));
        for (int c = 0; c < 3; c++)
            ck_assert(rgb[c] >= 0 && rgb[c] <= 1);
    }
    ck_assert_double_le(farthest, scene->radius);
    ck_assert_double_gt(farthest, 0.9 * scene->radius); // and the radius is no looser
}
END_TEST

// One point seen from two sides: its colour moves where there is gloss or sky.
START_TEST(view_dependence) {
    const struct rn_synth_scene *scene = rn_synth_find(scenes[_i]);
    double largest = 0;
    int points = 0;
    for (uint64_t i = 0; i < 3000; i++) {
        struct ray ray = random_ray(i), other = ray;
        double rgb[3], again[3], t, t_other;
        if (!rn_synth_trace(scene, &ray, rgb, &t)) continue;
        struct vec p = ray_at(&ray, t), shift = {0.2, 0.3, -0.2};
        other.direction = vec_unit(vec_add(ray.direction, 1, shift));
        other.origin = vec_add(p, -1e-3, other.direction);
        if (!rn_synth_trace(scene, &other, again, &t_other)) continue;
        if (fabs(t_other - 1e-3) > 1e-9) continue; // something else in front
        points++;
        for (int c = 0; c < 3; c++)
            largest = fmax(largest, fabs(rgb[c] - again[c]));
    }
    ck_assert_int_gt(points, 500);
    if (_i == 0 || _i >= OBJECTS - 1)
        ck_assert_double_gt(largest, 0.1);
    else
        ck_assert_double_lt(largest, 1e-9);
}
END_TEST

static bool count(void *context, size_t done, size_t total) {
    *(size_t *)context = total;
    return true;
}

// What is written is read back: splits, cameras, and pictures equal to the truth at those cameras.
START_TEST(written_dataset) {
    struct rn_synth_options options = {.size = 20, .views = 5, .threads = 2, .samples = 4};
    size_t total = 0;
    enum rn_status status =
        rn_synthesise(scenes[_i], &options, in_folder("out"), count, &total, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
    ck_assert_uint_eq(total, 5 + 8 + 8);
    read_ok(in_folder("out"));
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
    ck_assert_uint_eq(dataset->frame_count, total);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], 5);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TEST], 8);
    struct rn_dataset_report report;
    rn_dataset_describe(dataset, &report);
    ck_assert_double_eq(report.looking_at_bounds, 1);
    ck_assert_int_eq(report.with_alpha, (int)total);
    ck_assert_double_eq_tol(report.camera_distance_min, 4.0311289, 1e-6);
    for (size_t i = 0; i < total; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        struct rn_picture truth;
        struct rn_image expected, stored;
        ck_assert_int_eq(rn_synth_render(scenes[_i], &frame->camera, 4, &truth, &err), RN_OK);
        ck_assert_int_eq(rn_picture_to_image(&truth, &expected, &err), RN_OK);
        ck_assert_int_eq(rn_image_read(frame->path, &rn_image_default_limits, &stored, &err),
                         RN_OK);
        int differing = 0; // the cameras' last bits may move a sample over an edge
        for (int b = 0; b < 20 * 20 * 4; b++)
            differing += abs(stored.pixels[b] - expected.pixels[b]) > 1;
        ck_assert_int_le(differing, 4);
        ck_assert_int_eq(stored.pixels[3], 0); // the corner is empty
        int covered = 0;
        for (int p = 0; p < 20 * 20; p++)
            covered += stored.pixels[4 * p + 3] > 0;
        ck_assert_int_gt(covered, 60);
        rn_picture_finish(&truth);
        rn_image_finish(&expected);
        rn_image_finish(&stored);
    }
}
END_TEST

// Floats that follow a NumPy header of 128 bytes.
static void read_npy(const char *path, int rows, int columns, float *values) {
    char header[129] = {0}, shape[32];
    FILE *file = fopen(path, "rb");
    ck_assert_ptr_nonnull(file);
    ck_assert_uint_eq(fread(header, 1, 128, file), 128);
    ck_assert_int_eq(memcmp(header, "\x93NUMPY\1\0\x76\0{'descr': '<f4'", 24), 0);
    snprintf(shape, sizeof shape, "(%d, %d)", rows, columns);
    ck_assert_ptr_nonnull(strstr(header + 10, shape));
    ck_assert_int_eq(header[127], '\n');
    ck_assert_uint_eq(fread(values, sizeof *values, (size_t)(rows * columns), file),
                      (size_t)(rows * columns));
    ck_assert_int_eq(fgetc(file), EOF);
    fclose(file);
}

// A place: photographs without alpha, things at every distance, sky, and no camera inside a thing.
START_TEST(written_place) {
    enum { SIZE = 24 };
    struct rn_synth_options options = {.size = SIZE, .views = 12, .threads = 2, .samples = 4};
    enum rn_status status = rn_synthesise(scenes[_i], &options, in_folder("out"), NULL, NULL, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
    read_ok(in_folder("out"));
    ck_assert_uint_eq(problems.errors, 0);
    double nearest = INFINITY, farthest = 0;
    int sky = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        struct rn_picture depth;
        ck_assert(!frame->has_alpha);
        ck_assert_int_eq(rn_synth_depth(scenes[_i], &frame->camera, &depth, &err), RN_OK);
        for (int p = 0; p < SIZE * SIZE; p++) {
            double t = (double)depth.values[p];
            ck_assert_double_gt(t, 0.2);
            sky += isinf(t);
            nearest = fmin(nearest, t);
            if (!isinf(t)) farthest = fmax(farthest, t);
        }
        if (frame->split == RN_SPLIT_TEST) {
            float stored[SIZE * SIZE];
            char path[64];
            snprintf(path, sizeof path, "out/test/r_%d_depth.npy", frame->index);
            read_npy(in_folder(path), SIZE, SIZE, stored);
            int differing = 0; // the cameras' last bits may move a ray over an edge
            for (int p = 0; p < SIZE * SIZE; p++)
                differing += stored[p] != depth.values[p] &&
                             !(fabsf(stored[p] - depth.values[p]) < 1e-3f * stored[p]);
            ck_assert_int_le(differing, 4);
        }
        rn_picture_finish(&depth);
    }
    ck_assert_int_gt(sky, 50);
    ck_assert_double_lt(nearest, 3);
    ck_assert_double_gt(farthest, 100);
}
END_TEST

// Truth at every scale: a picture of half the size is the area mean of the larger one.
START_TEST(scales_agree) {
    struct rn_camera large = {.width = 48, .height = 48, .fx = 66, .fy = 66, .cx = 24, .cy = 24};
    static const double eye[3] = {2.5, -2.2, 2}, target[3] = {0, 0, 0}, up[3] = {0, 0, 1};
    ck_assert_int_eq(rn_camera_look_at(eye, target, up, large.world_from_camera), RN_OK);
    struct rn_camera small = rn_camera_resized(&large, 24, 24);
    struct rn_picture fine, coarse;
    ck_assert_int_eq(rn_synth_render(scenes[_i], &large, 64, &fine, &err), RN_OK);
    ck_assert_int_eq(rn_synth_render(scenes[_i], &small, 256, &coarse, &err), RN_OK);
    double squared = 0;
    for (int y = 0; y < 24; y++)
        for (int x = 0; x < 24; x++)
            for (int c = 0; c < 4; c++) {
                double mean = 0;
                for (int k = 0; k < 4; k++) {
                    const float *p = fine.values + 4 * ((2 * y + k / 2) * 48 + 2 * x + k % 2);
                    mean += (double)(c < 3 ? p[c] * p[3] : p[3]) / 4;
                }
                const float *q = coarse.values + 4 * (y * 24 + x);
                squared += pow((double)(c < 3 ? q[c] * q[3] : q[3]) - mean, 2);
            }
    ck_assert_double_lt(sqrt(squared / (24 * 24 * 4)), 0.01);
    rn_picture_finish(&fine);
    rn_picture_finish(&coarse);
}
END_TEST

START_TEST(bad_options) {
    struct rn_synth_options options = {.size = 8, .views = 1, .threads = 1, .samples = 1};
    ck_assert_int_eq(rn_synthesise("teapot", &options, in_folder("out"), NULL, NULL, &err),
                     RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "scene");
    options.samples = 3;
    ck_assert_int_eq(rn_synthesise("fence", &options, in_folder("out"), NULL, NULL, &err),
                     RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "samples");
    options.samples = -4;
    ck_assert_int_eq(rn_synthesise("fence", &options, in_folder("out"), NULL, NULL, &err),
                     RN_ERROR_INVALID);
    options.samples = 1;
    options.size = 0;
    ck_assert_int_eq(rn_synthesise("fence", &options, in_folder("out"), NULL, NULL, &err),
                     RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "size");
    options.size = 8;
    options.views = 0;
    ck_assert_int_eq(rn_synthesise("fence", &options, in_folder("out"), NULL, NULL, &err),
                     RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "views");
    options.views = 1;
    put_text("out/file", "x");
    ck_assert_int_eq(rn_synthesise("fence", &options, in_folder("out"), NULL, NULL, &err),
                     RN_ERROR_CONFLICT);
    struct rn_camera camera = {.width = 8, .height = 8};
    struct rn_picture picture;
    ck_assert_int_eq(rn_synth_render("fence", &camera, 1, &picture, &err), RN_ERROR_INVALID);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("synth");
    TCase *tests = tcase_create("synth");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_set_timeout(tests, 60);
    tcase_add_loop_test(tests, shapes, 0, 4);
    tcase_add_loop_test(tests, scene_lies_within_its_radius, 0, OBJECTS);
    tcase_add_loop_test(tests, view_dependence, 0, SCENES);
    tcase_add_loop_test(tests, written_dataset, 0, OBJECTS);
    tcase_add_loop_test(tests, written_place, OBJECTS, SCENES);
    tcase_add_loop_test(tests, scales_agree, 0, SCENES);
    tcase_add_test(tests, bad_options);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
