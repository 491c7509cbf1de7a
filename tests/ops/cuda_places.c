// Places on the CUDA backend, unbounded space and forward-facing, and the voxels beside the planes:
// pictures, which cells are kept, smoothing (cuda_test.c has the gradients).
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/voxels.h"
#include "server/engine/kernels/pixel.h"
#include "tests/ops/cuda_scene.h"

#define PIXEL_BOUND 2e-3
#define CELLS 16 // of the occupancy grid a side
#define ALL (CELLS * CELLS * CELLS)

static float unit(uint64_t stream, int i) {
    return rn_rng_unit(rn_rng_draw(3, stream, (uint64_t)i).v[0]);
}

// Pixels beside the CPU's kernels in fp32, of the largest colour, and the same samples; of `unsure`
// rays, where not NULL, neither. With `*ret_off`, where rays end early: how many pixels are off,
// for a sample at the end of what a ray sees may be seen there or here.
static double compare_with_cpu(struct test_scene *s, const struct rn_march_options *options,
                               const bool *unsure, int *ret_off) {
    struct rn_pixel pixels[SIDE * SIDE], expected[SIDE * SIDE];
    struct rn_march_ray rays[SIDE * SIDE];
    double worst = 0, largest = 1;
    for (int f = 0; f < FRAMES; f++) {
        const struct rn_camera *camera = &s->frames[f].camera;
        uint64_t samples, cpu;
        OK(test_render(s, camera, options, RN_CELLS_OF_TRAINING, 0, SIDE, pixels, &samples, &err));
        for (int i = 0; i < SIDE * SIDE; i++) {
            struct rn_ray ray = rn_camera_ray(camera, i % SIDE + 0.5, i / SIDE + 0.5);
            rays[i] = rn_march_ray_from(s->field, &ray, s->config.step, 0);
        }
        cpu = s->engine.kernels->render(&s->field->cpu, options, rays, SIDE * SIDE,
                                        rn_engine_workspace(&s->engine, 0), expected);
        ck_assert_uint_gt(cpu, 300);
        if (!ret_off && !unsure)
            ck_assert_double_eq_tol((double)samples, (double)cpu, 2e-3 * (double)cpu);
        for (int i = 0; i < SIDE * SIDE; i++) {
            double depth = (double)expected[i].depth, off;
            if (unsure && unsure[f * SIDE * SIDE + i]) continue;
            rn_close_ended(rn_ended_opacity(options->stop_depth, s->config.stop),
                           options->colour.background, &expected[i]);
            off = fabs((double)(pixels[i].alpha - expected[i].alpha));
            off = fmax(off, fabs((double)pixels[i].depth - depth) / (1 + depth));
            for (int c = 0; c < 3; c++) {
                off = fmax(off, fabs((double)(pixels[i].rgb[c] - expected[i].rgb[c])));
                largest = fmax(largest, fabs((double)expected[i].rgb[c]));
            }
            worst = fmax(worst, off);
            if (ret_off) *ret_off += off > PIXEL_BOUND * largest;
        }
    }
    return worst / largest;
}

// Whether a weight is one that a cell may have shown.
static bool looked_at(uint32_t bits) {
    float shown;
    memcpy(&shown, &bits, sizeof shown);
    return shown > 0 && shown <= 1;
}

static bool is_place(const struct test_scene *s) {
    return rn_is_place(&s->field->cpu);
}

// _i: all of space, a disparity box, voxels in a ball; by footprint; by shading, where a place ends
// opaque.
START_TEST(pictures_match_the_cpus) {
    int space = _i % 3, footprint = _i / 3 % 3;
    struct rn_train_config config = test_config((enum rn_footprint)footprint, 3, 8, 32,
                                                footprint == RN_FOOTPRINT_POINT ? 1 : 3);
    struct test_scene s;
    config.field.shading = (enum rn_shading)(_i / 9);
    config.field.space = space == 0 ? RN_SPACE_UNBOUNDED : RN_SPACE_BALL;
    config.field.voxels = space == 2 || footprint == RN_FOOTPRINT_MIP;
    config.field.mean_level = _i >= 9;
    config.field.footprint_base = 256; // footprints of many levels
    if (space < 2) config.step = 0.03;
    test_scene_init(&s, &config);
    if (space == 1) test_scene_face(&s);
    ck_assert(is_place(&s) == (space < 2));
    for (int i = 0; i < ALL; i++)
        s.field->occupancy[i] = unit(7, i) < 0.5f && s.field->hull[i];
    rn_field_refresh_occupancy(s.field);
    OK(test_scene_upload(&s, 0, &err));
    struct rn_march_options options = {
        .step = (float)config.step, .stop_depth = 1e9f, .colour.background = {1, 0.5f, 0.25f}};
    double worst = compare_with_cpu(&s, &options, NULL, NULL);
    int off = 0;
    options.stop_depth = 0.5f;
    (void)compare_with_cpu(&s, &options, NULL, &off);
    printf("%s, %s, %s shading: pixels %.1e off; where rays stop %d of them\n",
           space == 0   ? "unbounded"
           : space == 1 ? "forward-facing"
                        : "voxels",
           rn_footprint_names[footprint], _i < 9 ? "sample" : "ray", worst, off);
    ck_assert_double_lt(worst, PIXEL_BOUND);
    ck_assert_int_le(off, FRAMES * SIDE * SIDE / 50);
    test_scene_finish(&s);
}
END_TEST

// Whether a point of the cube lies in an occupied cell.
static bool is_occupied(const struct rn_occupancy_bits *o, const double at[3]) {
    int c[3];
    for (int i = 0; i < 3; i++)
        c[i] = rn_cell_of(at[i], o->cells);
    return o->words[rn_brick_word(c[0], c[1], c[2], o->cells)] & rn_brick_bit(c[0], c[1]);
}

// Samples of a frame's bent rays that lie in occupied cells, in float64. Returns of how many
// rounding decides, as they are nearer than 1e-4 cells to where that changes; ret_rays[i]: one of
// ray i's.
static int count_samples(const struct test_scene *s, int frame, int *ret_count, bool *ret_rays) {
    const struct rn_occupancy_bits *o = &s->field->cpu.occupancy;
    double by = 1e-4 * 2 / o->cells;
    int unsure = 0;
    *ret_count = 0;
    for (int i = 0; i < SIDE * SIDE; i++) {
        struct rn_reference_ray ray =
            test_reference_ray(s, &s->frames[frame].camera, i % SIDE, i / SIDE, 0);
        int before = unsure;
        for (int k = 0; k < ray.count; k++) {
            double x[3], at[3];
            int found = 0;
            for (int j = 0; j < 3; j++)
                x[j] = ray.origin[j] + ray.direction[j] * ray.mid[k];
            double scale = rn_contraction_at(sqrt(rn_dot3(x, x))).scale;
            for (int corner = 0; corner < 8; corner++) {
                for (int j = 0; j < 3; j++)
                    at[j] = x[j] * scale + (corner >> j & 1 ? by : -by);
                found += is_occupied(o, at);
            }
            for (int j = 0; j < 3; j++)
                at[j] = x[j] * scale;
            *ret_count += is_occupied(o, at);
            unsure += found % 8 > 0;
        }
        ret_rays[i] = unsure > before;
        test_rays_finish(&ray, 1);
    }
    return unsure;
}

// Rays that pass the centre at up to three radii, through cells of which few bricks hold an
// occupied one: those between are skipped, and no sample with them. A sample that float32 takes for
// the next cell's is one more or fewer, far away as much as 3e-2 of a pixel. _i: cells, steps.
START_TEST(bent_rays_skip_what_is_empty) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    const int n = _i ? 128 : 64;
    bool unsure[FRAMES * SIDE * SIDE];
    int unsure_rays = 0;
    struct test_scene s;
    config.field.space = RN_SPACE_UNBOUNDED;
    config.field.occupancy = n;
    config.step = _i ? 0.003 : 0.0008;
    test_scene_init(&s, &config);
    for (int f = 0; f < FRAMES; f++) {
        double eye[3] = {3 - f, 1 + f, 0.5 * f}, target[3] = {2.5 - f, -1.5, 0.5 * f - 1};
        ck_assert(rn_camera_look_at(eye, target, (double[3]){0, 0, 1},
                                    s.frames[f].camera.world_from_camera) == RN_OK);
    }
    for (int i = 0; i < n * n * n; i++) {
        int brick = (i / n / n / 8 * (n / 8) + i / n % n / 8) * (n / 8) + i % n / 8;
        if (unit(9, brick) > 0.02f) s.field->occupancy[i] = 0;
    }
    rn_field_refresh_occupancy(s.field);
    OK(test_scene_upload(&s, 0, &err));
    struct rn_march_options options = {.step = (float)config.step, .stop_depth = 1e9f};
    for (int f = 0; f < FRAMES; f++) {
        struct rn_pixel pixels[SIDE * SIDE];
        uint64_t samples;
        bool *rays = unsure + f * SIDE * SIDE;
        int expected, near = count_samples(&s, f, &expected, rays);
        OK(test_render(&s, &s.frames[f].camera, &options, RN_CELLS_OF_TRAINING, 0, SIDE, pixels,
                       &samples, &err));
        ck_assert_int_le(abs((int)samples - expected), near);
        for (int i = 0; i < SIDE * SIDE; i++)
            unsure_rays += rays[i];
    }
    double worst = compare_with_cpu(&s, &options, unsure, NULL);
    printf(
        "bent rays past empty bricks of %d cells: pixels %.1e off; of %d rays rounding decides\n",
        n, worst, unsure_rays);
    ck_assert_double_lt(worst, PIXEL_BOUND);
    ck_assert_int_lt(unsure_rays, FRAMES * SIDE * SIDE / 20);
    test_scene_finish(&s);
}
END_TEST

// A round over what the cells of a place showed keeps what the CPU keeps, marches through the same
// cells, and begins anew. _i: unbounded or forward-facing; whether every camera has looked.
START_TEST(cells_are_kept_as_on_the_cpu) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct rn_device_step round = {.measure = true, .seen_counts = true, .all_looked = _i / 2};
    struct rn_device_progress progress;
    static float occupancy[ALL];
    static uint32_t seen[ALL], after[ALL];
    struct test_scene s;
    int kept = 0, begun = 0;
    config.step = 0.03;
    config.field.space = _i % 2 ? RN_SPACE_BALL : RN_SPACE_UNBOUNDED;
    test_scene_init(&s, &config);
    if (_i % 2) test_scene_face(&s);
    for (int i = 0; i < ALL; i++) {
        float shown = 0.1f * unit(1, i) * unit(1, i);
        bool looked = unit(2, i) < 0.6f;
        memcpy(&seen[i], &shown, sizeof shown);
        if (!looked) seen[i] = 0;
        s.field->occupancy[i] = unit(3, i) < 0.3f ? RN_NEVER_SEEN : 0.06f * unit(4, i);
    }
    s.seen = seen;
    OK(test_scene_upload(&s, 0, &err));
    OK(test_scene_train(&s, false, &err));
    OK(test_backend()->train_step(s.on_device, &round, &err));
    OK(test_backend()->train_finish(s.on_device, &progress, &err));
    const struct rn_device_numbers cells = {.occupancy = occupancy, .seen = after};
    OK(test_backend()->download(s.on_device, &cells, &err));
    for (int i = 0; i < ALL; i++) {
        float shown;
        memcpy(&shown, &seen[i], sizeof shown);
        float expected = rn_cell_kept(s.field->occupancy[i], seen[i] ? shown : NAN, _i / 2);
        ck_assert(occupancy[i] == expected);
        kept += expected > RN_SEEN_LIMIT;
        begun += after[i] != 0;
        s.field->occupancy[i] = expected;
    }
    ck_assert(kept > ALL / 4 && kept < 3 * ALL / 4);
    ck_assert(begun > 20 && begun < ALL / 2); // by the step's rays
    rn_field_refresh_occupancy(s.field);
    struct rn_march_options options = {.step = (float)config.step, .stop_depth = 1e9f};
    ck_assert_double_lt(compare_with_cpu(&s, &options, NULL, NULL), PIXEL_BOUND);
    round.seen_counts = false; // too early: all is forgotten, and the step's rays begin anew
    OK(test_backend()->train_step(s.on_device, &round, &err));
    OK(test_backend()->train_finish(s.on_device, &progress, &err));
    OK(test_backend()->download(s.on_device, &cells, &err));
    for (int i = 0; i < ALL; i++)
        ck_assert(occupancy[i] == s.field->occupancy[i] && (after[i] == 0 || looked_at(after[i])));
    test_scene_finish(&s);
}
END_TEST

// As planes_are_smoothed_as_on_the_cpu (cuda_test.c).
START_TEST(voxels_are_smoothed_as_on_the_cpu) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct rn_device_step smooth = test_step;
    struct test_numbers rough, after;
    struct test_scene s;
    double moved = 0;
    smooth.smoothing = 0.2f;
    config.field.voxels = true;
    test_scene_init(&s, &config);
    test_train(&s, 1, true, &rough);
    test_scene_finish(&s);
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    OK(test_scene_train(&s, true, &err));
    OK(test_backend()->train_step(s.on_device, &smooth, &err));
    test_read_back(&s, &after);
    int side = rn_voxel_side(&config.field);
    size_t first = 3 * rn_grid_numbers(&config.field), n = (size_t)(side * side * side) * 4;
    for (int odd = 0; odd < 2; odd++)
        for (int z = 0; z < side; z++)
            s.engine.kernels->smooth_voxels(rough.parameters + first, side, z, odd,
                                            0.2f * (4.0f / 6));
    for (size_t i = first; i < first + n; i++) {
        ck_assert_double_eq_tol(after.parameters[i], rough.parameters[i], 16 * 0x1p-23);
        moved = fmax(moved, fabs((double)(after.parameters[i] - s.field->parameters.values[i])));
    }
    ck_assert_double_gt(moved, 0.1);
    test_numbers_finish(&rough);
    test_numbers_finish(&after);
    test_scene_finish(&s);
}
END_TEST

void test_add_places(Suite *suite) {
    test_add(suite, "worlds", pictures_match_the_cpus, 18);
    test_add(suite, "bent", bent_rays_skip_what_is_empty, 2);
    test_add(suite, "cells", cells_are_kept_as_on_the_cpu, 4);
    test_add(suite, "smoothing", voxels_are_smoothed_as_on_the_cpu, 1);
}
