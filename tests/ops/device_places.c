// Places on a device, unbounded space and forward-facing captures, with the voxels beside the
// planes: a step, a training, its pictures and its checkpoints beside the CPU's.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/scene/device.h"
#include "tests/ops/device_run.h"

static double step;

static void make_place(void) {
    step = 0.04;
    make_dataset_of("place");
}
static void make_window(void) {
    step = 2.0 / 96;
    make_dataset_of("window");
    for (size_t f = 0; f < run.dataset->frame_count; f++) { // as a capture of LLFF's tells them
        run.dataset->frames[f].near = 2;
        run.dataset->frames[f].far = 40;
    }
}

static struct rn_train_config place_config(const char *preset, int64_t steps) {
    struct rn_train_config config = small_config(preset, steps);
    config.field.voxels = strcmp(preset, "standard") == 0;
    config.split_pixels = 0;
    config.roulette = 0; // each draws its own lots
    config.smoothing = 0.1;
    config.step = step;
    config.target_samples = 1024;
    config.initial_rays = 24;
    return config;
}

// Which space the cameras called for.
static void check_space(bool forward) {
    const struct rn_field *field = rn_trainer_field(run.trainer);
    ck_assert_msg(field->cpu.disparity.on == forward, "%s",
                  field->effects[RN_EFFECT_FORWARD_FACING].reason);
    ck_assert(field->config.field.space == (forward ? RN_SPACE_BALL : RN_SPACE_UNBOUNDED));
}

// The same rays of the same field; the device rounds maps, features and activations to fp16.
static void check_step(const char *preset, const char *what) {
    struct rn_train_config config = place_config(preset, 1);
    config.field.width = 64;
    config.field.base = 32;
    config.grow_to = 0;
    config.target_samples = 4096;
    config.initial_rays = 200;
    char both[96];
    snprintf(both, sizeof both, "%s, %s", what, preset);
    compare_one_step(&config, both, 2e-3);
}

// The checkpoint's picture there and here: colour and opacity, and the depth as far as it is.
static double compare_views(void) {
    struct rn_render_result here, there;
    picture("cpu", 1, 1, &here);
    picture("cuda:0", 1, 1, &there);
    double worst = fmax(difference(&here.rgb, &there.rgb), difference(&here.alpha, &there.alpha));
    for (int i = 0; i < here.depth.width * here.depth.height; i++) {
        double depth = (double)here.depth.values[i];
        ck_assert_double_eq_tol(there.depth.values[i], depth, 1e-2 * depth);
    }
    rn_render_result_finish(&here);
    rn_render_result_finish(&there);
    return worst;
}

// The whole of a training there and here: losses within 3 hundredths, held-out views within a
// quarter of a decibel, pictures of the device's checkpoint.
static void check_training(bool forward, const char *what) {
    struct rn_train_config config = place_config("standard", 24);
    double losses[2], held[2];
    int occupied[2] = {0, 0};
    for (int device = 0; device < 2; device++) {
        run_begin(device ? "auto" : "cpu", &config);
        check_space(forward);
        const struct rn_field *field = rn_trainer_field(run.trainer);
        ck_assert(rn_trainer_config(run.trainer)->field.voxels);
        ck_assert(rn_trainer_config(run.trainer)->distortion_loss > 0);
        run_to(INT64_MAX);
        ck_assert(!field->on_device == !device);
        run_validate();
        OK(rn_trainer_save(run.trainer, run.path, &err));
        losses[device] = run.progress.loss;
        held[device] = run.progress.psnr;
        for (int i = 0; i < 16 * 16 * 16; i++)
            occupied[device] += field->occupancy[i] > RN_SEEN_LIMIT;
        ck_assert_uint_eq(run.progress.steps_rejected + run.progress.nonfinite_rays, 0);
        run_end();
    }
    double apart = compare_views();
    printf("%s after 24 steps: loss %.5f and %.5f, held out %.2f and %.2f dB, %d and %d cells, "
           "pictures %.1e apart\n",
           what, losses[1], losses[0], held[1], held[0], occupied[1], occupied[0], apart);
    ck_assert_double_eq_tol(losses[1], losses[0], 0.03 * losses[0]);
    ck_assert_double_eq_tol(held[1], held[0], 0.25);
    ck_assert_double_lt(apart, 5e-3);
    ck_assert_double_eq_tol(occupied[1], occupied[0], 0.05 * occupied[0]);
}

// Most of it opaque, so that what lies behind is hidden: its cells are not looked at.
static void thicken(struct rn_trainer *t) {
    const struct rn_mlp_shape *shape = &t->field->cpu.base_shape;
    const struct rn_parameters *p = &t->field->parameters;
    int last = shape->layers - 1;
    float *weights = p->values + p->plane_count + shape->offset[last];
    for (size_t i = 0; i < p->plane_count; i++)
        p->values[i] *= 6; // they begin near zero
    for (int row = 0; row < shape->in[last]; row++)
        weights[row * shape->out[last]] = 40 * fabsf(weights[row * shape->out[last]]);
    rn_field_refresh(t->field, t->engine);
}

START_TEST(what_is_hidden_shows_nothing) {
    run.prepare = thicken;
    check_step("standard", "opaque");
}
END_TEST

// The last of a training's steps, by when the loss of distortion has grown, here fifty times
// larger.
static void distort(struct rn_trainer *t) {
    t->field->config.max_steps = 100;
    t->progress.step = 99;
    t->field->config.distortion_loss = 1;
}

static void check_steps(const char *what, const char *last) {
    check_step("standard", what);
    check_step("paper", what);
    run.prepare = distort;
    check_step("standard", last);
}

START_TEST(a_step_in_all_of_space) {
    check_steps("unbounded", "unbounded, distortion");
}
END_TEST
START_TEST(a_step_before_a_window) {
    check_steps("forward-facing", "forward-facing, distortion");
}
END_TEST
START_TEST(a_place_trains) {
    check_training(false, "place");
}
END_TEST
START_TEST(a_window_trains) {
    check_training(true, "window");
}
END_TEST

// Between two rounds over the cells a training is saved and goes on: what they showed only grows.
START_TEST(what_cells_showed_follows) {
    struct rn_train_config config = place_config("standard", 20);
    size_t side = (size_t)config.field.occupancy, cells = side * side * side, shown = 0;
    uint32_t *before = malloc(cells * sizeof *before);
    run_begin("cuda:0", &config);
    run_to(5);
    OK(rn_trainer_save(run.trainer, run.path, &err));
    memcpy(before, run.trainer->hull.seen, cells * sizeof *before);
    run_end();
    run_begin("cuda:0", NULL);
    rn_trainer_progress(run.trainer, &run.progress);
    int64_t begin = run.progress.step;
    run_to(begin + 1);
    ck_assert_int_gt(run.progress.step, begin);
    ck_assert_int_lt(run.progress.step, 16); // the next round
    OK(rn_trainer_fetch(run.trainer, &err));
    for (size_t i = 0; i < cells; i++) { // bits of floats that are not negative
        shown += before[i] != 0;
        ck_assert_uint_ge(run.trainer->hull.seen[i], before[i]);
    }
    ck_assert_uint_gt(shown, 100);
    run_end();
    free(before);
}
END_TEST

// With rounds over the cells between.
START_TEST(goes_on_to_the_same_bytes) {
    struct rn_train_config config = place_config("standard", 20);
    compare_interrupted(&config, 20);
}
END_TEST

void device_add_places(Suite *suite) {
    device_add_with(suite, "place step", a_step_in_all_of_space, make_place);
    device_add_with(suite, "window step", a_step_before_a_window, make_window);
    device_add_with(suite, "hidden", what_is_hidden_shows_nothing, make_place);
    device_add_with(suite, "place", a_place_trains, make_place);
    device_add_with(suite, "window", a_window_trains, make_window);
    device_add_with(suite, "place shown", what_cells_showed_follows, make_place);
    device_add_with(suite, "place bytes", goes_on_to_the_same_bytes, make_place);
}
