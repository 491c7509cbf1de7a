// What a step of the CUDA backend chooses: the cells that are measured, the blocks of texels that
// are updated (cuda_test.c).
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/cuda/layout.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/voxels.h"
#include "tests/ops/cuda_emulator/knobs.h"
#include "tests/ops/cuda_scene.h"

#define CELLS 16 // of the occupancy grid a side

// ---- cells ----------------------------------------------------------------------------------

// What is measured in a cell at step 0.
static float measured(struct test_scene *s, uint32_t cell, const struct rn_rng4 *draw) {
    uint32_t at[3] = {cell / CELLS / CELLS, cell / CELLS % CELLS, cell % CELLS};
    float point[1][3], density;
    for (int k = 0; k < 3; k++)
        point[0][k] = ((float)at[k] + rn_rng_unit(draw->v[k])) * 2 / CELLS - 1;
    s->engine.kernels->density(&s->field->cpu, point, 1, 1, rn_engine_workspace(&s->engine, 0),
                               &density);
    return density * (float)(s->config.step * 1.5);
}

// Where cells are drawn, every fourth was empty: more are occupied than are drawn of all. A step
// that measures as it is told; the grid then.
static float *measure(struct test_scene *s, const struct rn_device_step *step) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_RIP, 4, 16, 32, 3);
    struct rn_device_progress progress;
    float *occupancy = malloc(CELLS * CELLS * CELLS * sizeof(float));
    config.field.occupancy = CELLS;
    config.sample_cells = step->measure_drawn;
    test_scene_init(s, &config);
    for (int i = 0; i < CELLS * CELLS * CELLS; i++)
        s->field->occupancy[i] *= step->measure_drawn && i % 4 == 0 ? 0 : 1e-3f;
    OK(test_scene_upload(s, 0, &err));
    OK(test_scene_train(s, false, &err));
    OK(test_backend()->train_step(s->on_device, step, &err));
    OK(test_backend()->train_finish(s->on_device, &progress, &err));
    const struct rn_device_numbers cells = {.occupancy = occupancy};
    OK(test_backend()->download(s->on_device, &cells, &err));
    return occupancy;
}

// Cells are measured at the points and the level that the CPU takes. _i: in turn, or by lot, by the
// same coins.
START_TEST(occupancy_is_measured_as_on_the_cpu) {
    struct rn_device_step step = test_step;
    struct test_scene s;
    step.measure = true;
    step.measure_drawn = _i;
    step.measure_first = 1;
    step.measure_stride = 3;
    step.measure_decay = 0.5f;
    float *occupancy = measure(&s, &step), chance[2];
    int listed = 0, raised = 0, occupied = 0, left = 0;
    for (int i = 0; i < CELLS * CELLS * CELLS; i++)
        occupied += s.field->occupancy[i] > 0;
    rn_chances_of_cells(CELLS * CELLS * CELLS, occupied, chance);
    for (uint32_t cell = 0; cell < CELLS * CELLS * CELLS; cell++) {
        float old = s.field->occupancy[cell];
        struct rn_rng4 draw = rn_rng_draw(s.config.seed, 0x6f63637570000000u + cell, 0);
        bool takes = _i ? rn_rng_unit(draw.v[3]) < chance[old > 0] : listed % 3 == 1;
        listed += s.field->hull[cell];
        left += s.field->hull[cell] && !takes;
        if (!s.field->hull[cell] || !takes) {
            ck_assert(occupancy[cell] == old);
            continue;
        }
        float value = measured(&s, cell, &draw), expected = fmaxf(value, old * 0.5f);
        raised += value > old * 0.5f;
        ck_assert_double_eq_tol(occupancy[cell], expected, 3e-3 * (double)expected + 1e-30);
    }
    ck_assert_int_gt(raised, 100);
    ck_assert_int_gt(left, 500);
    free(occupancy);
    test_scene_finish(&s);
}
END_TEST

// ---- blocks of texels -----------------------------------------------------------------------

// Matter in one corner of the ball: some blocks have no gradient.
static void init_corner(struct test_scene *s, const struct rn_train_config *config) {
    test_scene_init(s, config);
    s->rays = 24;
    for (int i = 0; i < CELLS * CELLS * CELLS; i++)
        if (i / CELLS / CELLS < CELLS - 4 || i / CELLS % CELLS < CELLS / 2)
            s->field->occupancy[i] = 0;
    rn_field_refresh_occupancy(s->field);
}

// Which blocks of texels have a gradient, of a step that begins with no moments.
static void find_touched(const struct test_scene *s, const float *m, bool *touched) {
    int base = s->config.field.base, channels = s->config.field.channels, side = base / RN_UPDATE;
    for (size_t i = 0; i < s->field->parameters.plane_count; i++) {
        int texel = (int)(i / (size_t)channels), x = texel % base, y = texel / base % base;
        int block = (texel / base / base * side + y / RN_UPDATE) * side + x / RN_UPDATE;
        touched[block] |= m[i] != 0;
    }
}

// The scene anew, and a step of it by the sparse optimiser, from moments of 1e-3 and 1e-4
// everywhere; returned, first and second, for the caller to free.
static float *step_sparsely(struct rn_train_config *config, struct test_scene *s,
                            struct test_numbers *after) {
    size_t n = s->field->parameters.count;
    float *moments = malloc(2 * n * sizeof *moments);
    for (size_t i = 0; i < n; i++) {
        moments[i] = 1e-3f;
        moments[n + i] = 1e-4f;
    }
    test_scene_finish(s);
    config->sparse = true;
    init_corner(s, config);
    s->m = moments;
    s->v = moments + n;
    test_train(s, 1, false, after);
    return moments;
}

// The sparse optimiser leaves blocks that no sample met as they are, moments and all, and visits
// every other, with levels too. _i: how many.
START_TEST(untouched_blocks_stay) {
    struct rn_train_config config =
        test_config(_i % 2 ? RN_FOOTPRINT_MIP : RN_FOOTPRINT_RIP, 3, 16, 16, 1 + _i);
    struct test_scene s;
    struct test_numbers first, after;
    bool touched[3 * 8 * 8] = {false};
    int kept = 0, visited = 0;
    config.field.base = 64;
    config.weight_decay = 0.1;
    init_corner(&s, &config);
    test_train(&s, 1, false, &first);
    find_touched(&s, first.m, touched);
    float *moments = step_sparsely(&config, &s, &after);
    for (size_t i = 0; i < s.field->parameters.plane_count; i++) {
        int texel = (int)i / 16, x = texel % 64, y = texel / 64 % 64;
        bool is = touched[(texel / 4096 * 8 + y / RN_UPDATE) * 8 + x / RN_UPDATE];
        bool same = after.parameters[i] == s.field->parameters.values[i] && after.m[i] == s.m[i] &&
                    after.v[i] == s.v[i];
        ck_assert(is ? !same : same || first.m[i] == 0);
        kept += same;
        visited += !same;
        if (is) ck_assert_double_eq_tol(after.m[i], 0.9 * 1e-3 + (double)first.m[i], 1e-5);
    }
    ck_assert_int_gt(kept, 10000);
    ck_assert_int_gt(visited, 10000);
    free(moments);
    test_numbers_finish(&first);
    test_numbers_finish(&after);
    test_scene_finish(&s);
}
END_TEST

// Planes whose levels do not halve evenly, and voxels beside them, are visited whole, as on the
// CPU.
START_TEST(uneven_planes_are_visited_whole) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_MIP, 3, 16, 16, 3);
    struct test_scene s;
    struct test_numbers first, after;
    int unmet = 0;
    config.field.base = 27;
    config.field.voxels = true;
    init_corner(&s, &config);
    test_train(&s, 1, false, &first);
    size_t side = (size_t)rn_voxel_side(&config.field);
    size_t held = 3 * 27 * 27 * 16 + side * side * side * RN_VOXEL_CHANNELS;
    float *moments = step_sparsely(&config, &s, &after);
    for (size_t i = 0; i < held; i++) {
        unmet += first.m[i] == 0;
        ck_assert_double_eq_tol(after.m[i], 0.9 * 1e-3 + (double)first.m[i], 1e-5);
    }
    ck_assert_int_gt(unmet, 10000);
    free(moments);
    test_numbers_finish(&first);
    test_numbers_finish(&after);
    test_scene_finish(&s);
}
END_TEST

// Gradients of the density network's last layer summed beside its backward, or behind it: planes
// and the colour network are the same bytes after a step, the density network's gradients are other
// sums of the same numbers, in any order of the threads the same; two tiles a warp are not taken
// then. With less shared memory there is one way. _i: the paper's networks; that.
START_TEST(last_layers_are_summed_on_chip) {
    struct rn_train_config config = _i == 1 ? test_config(RN_FOOTPRINT_MIP, 10, 16, 128, 2)
                                            : test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct test_numbers plain, chip, other;
    struct test_scene s[3];
    config.step = _i == 1 ? 0.2 : 0.05;
    if (_i == 1) config.field.base = 16;
    if (_i == 2) rn_emulator_shared(20 << 10);
    for (int k = 0; k < 3; k++) {
        test_scene_init(&s[k], &config);
        s[k].last_on_chip = k > 0;
        s[k].two_tiles = k == 2;
        rn_emulator_order(k == 2 ? 3 : 0, 3);
        test_train(&s[k], 1, true, k == 0 ? &plain : k == 1 ? &chip : &other);
    }
    rn_emulator_order(0, 0);
    rn_emulator_shared(227 << 10);
    const struct rn_mlp_shape *base = &s[0].field->cpu.base_shape;
    size_t planes = s[0].field->parameters.plane_count, n = s[0].field->parameters.count;
    size_t last = planes + base->offset[base->layers - 1], apart = 0;
    float most = 0;
    ck_assert_uint_gt(chip.progress.samples_returned, 600);
    ck_assert_mem_eq(chip.m, other.m, n * sizeof(float));
    for (size_t i = 0; i < n; i++) {
        bool is = i >= last && i < planes + base->count;
        if (i < planes || i >= planes + base->count) ck_assert(plain.m[i] == chip.m[i]);
        apart += plain.m[i] != chip.m[i];
        most = is ? fmaxf(most, fabsf(plain.m[i])) : most;
    }
    for (size_t i = planes; i < planes + base->count; i++)
        ck_assert_double_eq_tol(plain.m[i], chip.m[i], 1e-5 * (double)most);
    ck_assert(most > 0 && (apart > 0) == (_i != 2));
    for (int k = 0; k < 3; k++)
        test_scene_finish(&s[k]);
    test_numbers_finish(&plain);
    test_numbers_finish(&chip);
    test_numbers_finish(&other);
}
END_TEST

// One step whose warps take a tile at a time or two: the same bytes, in any order of the threads.
static void check_tiles(const struct rn_train_config *config, int rays, uint64_t *ret_returned) {
    struct test_numbers n[3];
    struct test_scene s[3];
    for (int k = 0; k < 3; k++) {
        test_scene_init(&s[k], config);
        s[k].rays = rays;
        s[k].two_tiles = k > 0;
        rn_emulator_order(k == 2 ? 3 : 0, 3);
        test_train(&s[k], 1, true, &n[k]);
    }
    rn_emulator_order(0, 0);
    size_t bytes = s[0].field->parameters.count * sizeof(float);
    for (int k = 1; k < 3; k++) {
        ck_assert_mem_eq(n[0].m, n[k].m, bytes);
        ck_assert_mem_eq(n[0].v, n[k].v, bytes);
        ck_assert_mem_eq(n[0].parameters, n[k].parameters, bytes);
        ck_assert_uint_eq(n[0].progress.samples, n[k].progress.samples);
        ck_assert_uint_eq(n[0].progress.samples_returned, n[k].progress.samples_returned);
        ck_assert(n[0].progress.loss == n[k].progress.loss);
    }
    *ret_returned = n[0].progress.samples_returned;
    for (int k = 0; k < 3; k++) {
        test_scene_finish(&s[k]);
        test_numbers_finish(&n[k]);
    }
}

// With a last tile that stands alone and has rows left over, and with one that does not: the
// paper's networks, deeper ones, in a ball and in all of space, shaded by samples and by rays;
// where there is no room for all weights. _i: which.
START_TEST(two_tiles_give_the_bytes_of_one) {
    struct rn_train_config config = _i < 2    ? test_config(RN_FOOTPRINT_RIP, 10, 16, 128, 2)
                                    : _i == 2 ? test_config(RN_FOOTPRINT_POINT, 3, 8, 32, 1)
                                              : test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    uint64_t returned;
    bool alone = false, paired = false;
    config.step = _i < 2 ? 0.2 : 0.05;
    if (_i < 2) config.field.base = 16;
    if (_i == 1) config.field.shading = RN_SHADING_RAY;
    if (_i == 2) config.field.base_layers = 3;
    if (_i == 3) config.field.space = RN_SPACE_UNBOUNDED;
    if (_i == 4) rn_emulator_shared(8 << 10);
    for (int rays = _i < 2 ? 6 : 24; rays < RAYS && !(alone && paired); rays++) {
        check_tiles(&config, rays, &returned);
        ck_assert_uint_gt(returned, 20);
        uint64_t tiles = (returned + 15) / 16;
        alone |= tiles % 2 == 1 && returned % 16 > 0;
        paired |= tiles % 2 == 0;
    }
    ck_assert(alone && paired);
    rn_emulator_shared(227 << 10);
}
END_TEST

void test_add_choices(Suite *suite) {
    int less = test_is_emulated(); // shared memory
    test_add(suite, "tiles", two_tiles_give_the_bytes_of_one, 4 + less);
    test_add(suite, "chip", last_layers_are_summed_on_chip, 2 + less);
    test_add(suite, "occupancy", occupancy_is_measured_as_on_the_cpu, 2);
    test_add(suite, "sparse", untouched_blocks_stay, 5);
    test_add(suite, "whole", uneven_planes_are_visited_whole, 1);
}
