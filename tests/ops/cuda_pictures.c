// The CUDA backend's pictures: against the float64 reference and the CPU's kernels (cuda_test.c).
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/math/rng.h"
#include "server/engine/cuda/layout.h"
#include "server/engine/kernels/pixel.h"
#include "tests/ops/cuda_scene.h"

#define PIXEL_BOUND 2e-3

START_TEST(pixels_match_reference) {
    for (int which = 0; which < 7; which++) {
        int i = which % 3;
        struct rn_train_config config = test_config((enum rn_footprint)i, i == 0 ? 10 : 3,
                                                    i == 0 ? 16 : 8, i == 0 ? 32 : 64, 3);
        config.field.shading = which < 3 ? RN_SHADING_SAMPLE : RN_SHADING_RAY;
        config.field.view_dependence = which < 6;
        struct test_scene s;
        struct rn_pixel pixels[SIDE * SIDE];
        struct rn_march_options options = {
            .step = (float)config.step, .stop_depth = 1e9f, .colour.background = {1, 0.5f, 0.25f}};
        uint64_t samples;
        double worst_pixel = 0, largest = 1;
        test_scene_init(&s, &config);
        OK(test_scene_upload(&s, 0, &err));
        OK(test_render(&s, &s.frames[0].camera, &options, RN_CELLS_OF_TRAINING, 2, 6, pixels,
                       &samples, &err));
        for (int k = 0; k < 6 * SIDE; k++) {
            struct rn_reference_ray ray =
                test_reference_ray(&s, &s.frames[0].camera, k % SIDE, 2 + k / SIDE, 0);
            double rgb[3], opacity, depth;
            ray.colour = options.colour;
            OK(rn_reference_render(s.reference, &ray, rgb, &opacity, &depth));
            for (int c = 0; c < 3; c++) {
                worst_pixel = fmax(worst_pixel, fabs((double)pixels[k].rgb[c] - rgb[c]));
                largest = fmax(largest, fabs(rgb[c]));
            }
            worst_pixel = fmax(worst_pixel, fabs((double)pixels[k].alpha - opacity));
            if (opacity > 0.01)
                ck_assert_double_eq_tol(pixels[k].depth, depth / opacity, PIXEL_BOUND);
            test_rays_finish(&ray, 1);
        }
        printf("%s, %s shading: pixels %.1e of at most %.1f, %llu samples\n", rn_footprint_names[i],
               which < 3 ? "sample" : "ray", worst_pixel, largest, (unsigned long long)samples);
        ck_assert_double_lt(worst_pixel,
                            PIXEL_BOUND * largest); // a ray's colour may lie outside [0, 1]
        test_scene_finish(&s);
    }
}
END_TEST

static float unit(int i) {
    return rn_rng_unit(rn_rng_draw(3, 4, (uint64_t)i).v[0]);
}

// Every fourth of the bricks of a grid of 32 cells a side.
static bool brick_kept(int cell) {
    return unit(cell / 1024 / 8 * 16 + cell / 32 % 32 / 8 * 4 + cell % 32 / 8 + 100000) < 0.25f;
}

// Scattered cells of scattered bricks, those above the mean or a limit: the same samples are
// evaluated as on the CPU, and give the same picture, also where whole rays are shaded as seen from
// elsewhere.
START_TEST(march_finds_the_cells_that_the_cpu_finds) {
    for (int stride = 0; stride < 2; stride++) {
        struct rn_train_config config = test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3);
        struct test_scene s;
        struct rn_pixel pixels[SIDE * SIDE], expected[SIDE * SIDE];
        struct rn_march_ray rays[SIDE * SIDE];
        config.field.occupancy = 32;
        config.step = 0.011;
        config.cone_step = stride;
        if (stride) config.field.shading = RN_SHADING_RAY;
        if (stride) config.occupancy_limit = 2e-4;
        test_scene_init(&s, &config);
        for (int i = 0; i < 32 * 32 * 32; i++)
            s.field->occupancy[i] = brick_kept(i) ? 0.004f * unit(i) : 0;
        rn_field_refresh_occupancy(s.field);
        OK(test_scene_upload(&s, 0, &err));
        const float look[3] = {0.6f, 0, 0.8f};
        struct rn_march_options options = {.step = (float)config.step,
                                           .stop_depth = 1e9f,
                                           .colour.background = {0.25f, 0.5f, 1},
                                           .look = stride ? look : NULL};
        for (int f = 0; f < FRAMES; f++) {
            const struct rn_camera *camera = &s.frames[f].camera;
            uint64_t samples, cpu;
            OK(test_render(&s, camera, &options, RN_CELLS_OF_TRAINING, 0, SIDE, pixels, &samples,
                           &err));
            for (int i = 0; i < SIDE * SIDE; i++) {
                struct rn_ray ray = rn_camera_ray(camera, i % SIDE + 0.5, i / SIDE + 0.5);
                rays[i] = rn_march_ray_from(s.field, &ray, config.step, 0);
            }
            cpu = s.engine.kernels->render(&s.field->cpu, &options, rays, SIDE * SIDE,
                                           rn_engine_workspace(&s.engine, 0), expected);
            ck_assert_uint_gt(cpu, 300);
            ck_assert_uint_eq(samples, cpu);
            for (int i = 0; i < SIDE * SIDE; i++)
                ck_assert_double_eq_tol(pixels[i].rgb[0], expected[i].rgb[0], PIXEL_BOUND);
        }
        test_scene_finish(&s);
    }
}
END_TEST

// A field at rest has finer cells: the samples are those of the CPU's march through the cells that
// are asked for, or through the training's where there are none. _i: with finer ones or without.
START_TEST(march_reads_the_cells_that_are_chosen) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3), finer = config;
    struct rn_march_options options = {.step = (float)config.step, .stop_depth = 1e9f};
    struct rn_pixel pixels[SIDE * SIDE], expected[SIDE * SIDE];
    struct rn_march_ray rays[SIDE * SIDE];
    struct test_scene s, fine, firm;
    uint64_t samples, cpu, before = UINT64_MAX;
    finer.field.occupancy = 32;
    test_scene_init(&s, &config);
    test_scene_init(&fine, &finer);
    test_scene_init(&firm, &finer);
    for (int i = 0; i < 32 * 32 * 32; i++) {
        fine.field->occupancy[i] = brick_kept(i);
        firm.field->occupancy[i] = brick_kept(i) && unit(i) < 0.25f;
    }
    rn_field_refresh_occupancy(fine.field);
    rn_field_refresh_occupancy(firm.field);
    const struct rn_occupancy_bits cells[] = {
        [RN_CELLS_FINE] = fine.field->coarse,
        [RN_CELLS_FIRM] = firm.field->coarse,
        [RN_CELLS_OF_TRAINING] = s.field->coarse,
    };
    for (int i = 0; i < RN_DEVICE_FINER && _i; i++)
        s.finer[i] = &cells[i];
    OK(test_scene_upload(&s, 0, &err));
    const struct rn_camera *camera = &s.frames[1].camera;
    for (int i = 0; i < SIDE * SIDE; i++) {
        struct rn_ray ray = rn_camera_ray(camera, i % SIDE + 0.5, i / SIDE + 0.5);
        rays[i] = rn_march_ray_from(s.field, &ray, config.step, 0);
    }
    for (int i = 0; i < 3; i++) {
        static const enum rn_device_cells fewer[] = {RN_CELLS_OF_TRAINING, RN_CELLS_FINE,
                                                     RN_CELLS_FIRM};
        s.field->cpu.occupancy = cells[_i ? fewer[i] : RN_CELLS_OF_TRAINING];
        OK(test_render(&s, camera, &options, fewer[i], 0, SIDE, pixels, &samples, &err));
        cpu = s.engine.kernels->render(&s.field->cpu, &options, rays, SIDE * SIDE,
                                       rn_engine_workspace(&s.engine, 0), expected);
        ck_assert_uint_gt(cpu, 100);
        ck_assert_uint_eq(samples, cpu);
        ck_assert(_i ? cpu < before : cpu == before || before == UINT64_MAX);
        before = cpu;
        for (int k = 0; k < SIDE * SIDE; k++)
            ck_assert_double_eq_tol(pixels[k].rgb[0], expected[k].rgb[0], PIXEL_BOUND);
    }
    s.field->cpu.occupancy = s.field->coarse;
    test_scene_finish(&firm);
    test_scene_finish(&fine);
    test_scene_finish(&s);
}
END_TEST

// A picture of more pixels than the device takes at once, of a far ball that lies across both
// parts. _i: from the last to the first, by their numbers.
START_TEST(pictures_come_in_parts) {
    enum { WIDE = 400, PIXELS = WIDE * WIDE, PART = 1 << 17 };
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct rn_march_options options = {.step = (float)config.step, .stop_depth = 1e9f};
    struct rn_pixel *pixels = malloc(PIXELS * sizeof *pixels), *expected;
    struct rn_march_ray *rays = malloc(PIXELS * sizeof *rays);
    struct test_scene s;
    uint64_t samples;
    int seen = 0;
    test_scene_init(&s, &config);
    struct rn_camera camera = rn_camera_resized(&s.frames[0].camera, WIDE, WIDE);
    for (int i = 0; i < 3; i++)
        camera.world_from_camera[i][3] *= 12;
    camera.cy += 0.32 * WIDE; // to where one part ends and the next begins
    OK(test_scene_upload(&s, 0, &err));
    uint32_t *numbers = malloc(PIXELS * sizeof *numbers);
    for (uint32_t i = 0; i < PIXELS; i++)
        numbers[i] = PIXELS - 1 - i;
    const struct rn_device_view view = {
        .cameras = &camera, .camera_count = 1, .cones = 1, .cells = RN_CELLS_OF_TRAINING};
    const struct rn_device_places places = {.numbers = _i ? numbers : NULL, .count = PIXELS};
    OK(test_backend()->render(s.on_device, &view, &options, &places, pixels, &samples, &err));
    for (int i = 0; i < PIXELS; i++) {
        struct rn_ray ray = rn_camera_ray(&camera, i % WIDE + 0.5, i / WIDE + 0.5);
        rays[i] = rn_march_ray_from(s.field, &ray, config.step, 0);
    }
    expected = calloc(PIXELS, sizeof *expected);
    uint64_t cpu = s.engine.kernels->render(&s.field->cpu, &options, rays, PIXELS,
                                            rn_engine_workspace(&s.engine, 0), expected);
    ck_assert_uint_eq(samples, cpu);
    for (int i = 0; i < PIXELS; i++) {
        const struct rn_pixel *there = &pixels[_i ? PIXELS - 1 - i : i];
        seen |= expected[i].alpha > 0 ? 1 << (i / PART) : 0;
        ck_assert_double_eq_tol(there->alpha, expected[i].alpha, PIXEL_BOUND);
        ck_assert_double_eq_tol(there->rgb[0], expected[i].rgb[0], PIXEL_BOUND);
    }
    ck_assert_int_eq(seen, 3);
    free(numbers);
    free(pixels);
    free(expected);
    free(rays);
    test_scene_finish(&s);
}
END_TEST

// An early stop ends rays, and what lies behind it weighs nothing.
START_TEST(rays_stop_where_nothing_can_be_seen) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct test_scene s;
    struct rn_pixel pixels[SIDE], expected[SIDE];
    uint64_t all, samples;
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    struct rn_march_options options = {.step = 0.05f, .stop_depth = 1e9f};
    const struct rn_camera *camera = &s.frames[1].camera;
    OK(test_render(&s, camera, &options, RN_CELLS_OF_TRAINING, SIDE / 2, 1, pixels, &all, &err));
    options.stop_depth = 0.3f;
    OK(test_render(&s, camera, &options, RN_CELLS_OF_TRAINING, SIDE / 2, 1, pixels, &samples,
                   &err));
    struct rn_march_ray rays[SIDE];
    for (int i = 0; i < SIDE; i++) {
        struct rn_ray ray = rn_camera_ray(camera, i + 0.5, SIDE / 2 + 0.5);
        rays[i] = rn_march_ray_from(s.field, &ray, config.step, 0);
    }
    uint64_t cpu = s.engine.kernels->render(&s.field->cpu, &options, rays, SIDE,
                                            rn_engine_workspace(&s.engine, 0), expected);
    // A ray is looked at after every RN_TILE samples there, after every RN_ROUND here.
    ck_assert_uint_lt(samples, all);
    ck_assert_uint_ge(samples, cpu);
    ck_assert_uint_le(samples, cpu + SIDE * (RN_TILE - RN_ROUND));
    for (int i = 0; i < SIDE; i++) {
        rn_close_ended(rn_ended_opacity(0.3f, config.stop), options.colour.background,
                       &expected[i]);
        ck_assert_double_eq_tol(pixels[i].alpha, expected[i].alpha, 0.02);
        for (int k = 0; k < 3; k++) // nothing behind the stop shows
            ck_assert_double_eq_tol(pixels[i].rgb[k], expected[i].rgb[k], PIXEL_BOUND);
    }
    test_scene_finish(&s);
}
END_TEST

// How far the device's pixels of some places may be from those of single cones, `fine`, averaged
// here: places, cameras and cones in the order that they are asked for, closed where they ended
// early, with straight colours, as fp16 has them.
static void check_places(const struct test_scene *s, const struct rn_march_options *options,
                         bool halves, const uint32_t *numbers, size_t count) {
    enum { N = 2, FINE = N * SIDE };
    static struct rn_pixel fine[2][FINE * FINE];
    struct rn_camera cameras[2] = {s->frames[0].camera, s->frames[3].camera};
    struct rn_march_options single = *options;
    struct rn_pixel pixels[64];
    uint64_t samples, all = 0;
    single.straight = false;
    for (int c = 0; c < 2; c++) {
        struct rn_camera camera = rn_camera_resized(&cameras[c], FINE, FINE);
        OK(test_render(s, &camera, &single, RN_CELLS_OF_TRAINING, 0, FINE, fine[c], &samples,
                       &err));
        all += samples;
    }
    const struct rn_device_view view = {
        .cameras = cameras, .camera_count = 2, .cones = N, .cells = RN_CELLS_OF_TRAINING, halves};
    const struct rn_device_places places = {numbers, 100, count};
    OK(test_backend()->render(s->on_device, &view, options, &places, pixels, &samples, &err));
    ck_assert_uint_lt(samples, all);
    for (size_t i = 0; i < count; i++) {
        int place = numbers ? (int)numbers[i] : 100 + (int)i, x = place % SIDE * N;
        int y = place / SIDE % SIDE * N, c = place / SIDE / SIDE;
        const struct rn_pixel *at = &fine[c][y * FINE + x];
        struct rn_pixel mean =
            rn_cones_mean((struct rn_pixel[]){at[0], at[1], at[FINE], at[FINE + 1]}, N,
                          options->straight ? options->colour.background : NULL);
        double near = halves ? 0x1p-11 : 1e-6; // of numbers below 1
        for (int k = 0; k < 3; k++)
            ck_assert_double_eq_tol(pixels[i].rgb[k], mean.rgb[k],
                                    near * fmax(1, fabs((double)mean.rgb[k])));
        ck_assert_double_eq_tol(pixels[i].alpha, mean.alpha, mean.alpha > 0 ? near : 1e-30);
        ck_assert_double_eq_tol(pixels[i].depth, halves ? 0 : mean.depth, 1e-5);
    }
}

// _i: plainly; as fp16 has them, with straight colours and an early end.
START_TEST(places_of_cameras_are_averaged) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    static const uint32_t numbers[] = {17, 3, 287, 144 + 66, 66, 67, 78, 144 + 79, 0};
    struct test_scene s;
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    struct rn_march_options options = {.step = 0.2f,
                                       .stop_depth = _i ? 0.2f : 1e9f,
                                       .colour.background = {0.25f, 0.5f, 1},
                                       .straight = _i};
    check_places(&s, &options, _i, numbers, sizeof numbers / sizeof *numbers);
    if (_i) check_places(&s, &options, _i, NULL, 60);
    test_scene_finish(&s);
}
END_TEST

void test_add_pictures(Suite *suite) {
    test_add(suite, "pixels", pixels_match_reference, 1);
    test_add(suite, "march", march_finds_the_cells_that_the_cpu_finds, 1);
    test_add(suite, "march", march_reads_the_cells_that_are_chosen, 2);
    test_add(suite, "march", rays_stop_where_nothing_can_be_seen, 1);
    test_add(suite, "places", places_of_cameras_are_averaged, 2);
    test_add(suite, "parts", pictures_come_in_parts, 2);
}
