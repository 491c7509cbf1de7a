// Where rays come from, on a device beside the CPU: pixels that masks or photographs alone leave
// out, cameras that are moved, blocks that are drawn by their errors.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/image.h"
#include "common/math/rng.h"
#include "tests/ops/device_run.h"

// Every training photograph's left third, and a row at its lower edge.
static void make_masked(void) {
    make_dataset();
    for (size_t f = 0; f < run.dataset->frame_count; f++) {
        struct rn_frame *frame = &run.dataset->frames[f];
        int width = frame->camera.width, height = frame->camera.height;
        struct rn_image mask = {.width = width, .height = height};
        mask.pixels = malloc((size_t)(4 * width * height));
        for (int i = 0; i < width * height; i++) {
            bool out = i % width < width / 3 || i / width == height - 1;
            memset(mask.pixels + 4 * i, out ? 0 : 255, 3);
            mask.pixels[4 * i + 3] = 255;
        }
        ck_assert_int_gt(asprintf(&frame->mask_path, "%s.mask.png", frame->path), 0);
        OK(rn_image_write_png(&mask, frame->mask_path, 3, &err));
        rn_image_finish(&mask);
    }
}

static void make_larger(void) {
    make_dataset_sized("sphere", 32);
}

// Each camera turned and moved by up to three pixels, as if a program had found it.
static void make_moved(void) {
    make_larger();
    run.dataset->bounds.source = RN_BOUNDS_GIVEN;
    for (size_t f = 0; f < run.dataset->frame_count; f++) {
        struct rn_camera *camera = &run.dataset->frames[f].camera;
        double by[RN_POSE_UNKNOWNS] = {0};
        for (int k = 0; k < RN_POSE_FOCAL; k++)
            by[k] =
                3 / camera->fx * (2 * (double)rn_rng_unit(rn_rng_draw(7, f, (uint64_t)k).v[0]) - 1);
        *camera = rn_pose_move(camera, by, 1);
    }
}

static struct rn_train_config capture_config(const char *preset, int64_t steps) {
    struct rn_train_config config = small_config(preset, steps);
    config.roulette = 0; // each draws its own lots
    config.split_pixels = 0;
    return config;
}

// ---- pixels that are left out ---------------------------------------------------------------

// The same rays of the same field: a ray more or fewer moves the loss by a hundredth.
static void check_step(const char *preset, const char *what) {
    struct rn_train_config config = capture_config(preset, 1);
    config.initial_rays = 200;
    config.effect[RN_EFFECT_ROBUST_LOSS] = RN_EFFECT_WANTED;
    config.effect[RN_EFFECT_POSE_REFINEMENT] = RN_EFFECT_WANTED;
    char both[96];
    snprintf(both, sizeof both, "%s, %s", what, preset);
    compare_one_step(&config, both, 2e-3);
}

static void expect_masks(struct rn_trainer *t) {
    ck_assert_ptr_nonnull(t->train.used);
    ck_assert(!t->field->config.cut_out);
}

START_TEST(a_step_through_masks) {
    run.prepare = expect_masks;
    check_step("standard", "masks");
    check_step("paper", "masks");
}
END_TEST

// Every third block, and all of one photograph.
static void leave_blocks_out(struct rn_trainer *t) {
    ck_assert_ptr_nonnull(t->outliers.out);
    for (size_t i = 0; i < t->outliers.count; i++)
        t->outliers.out[i] = i % 3 == 0 || i < t->outliers.first[1];
}

START_TEST(a_step_past_outliers) {
    run.prepare = leave_blocks_out;
    check_step("standard", "outliers");
    check_step("paper", "outliers");
}
END_TEST

// Held-out views are scored where their masks let them be.
START_TEST(masked_views_are_scored) {
    struct rn_train_config config = capture_config("standard", 24);
    double held[2];
    for (int device = 0; device < 2; device++) {
        run_begin(device ? "cuda:0" : "cpu", &config);
        run_to(INT64_MAX);
        run_validate();
        held[device] = run.progress.psnr;
        run_end();
    }
    printf("through masks, held out %.2f and %.2f dB\n", held[1], held[0]);
    ck_assert_double_eq_tol(held[1], held[0], 0.25);
}
END_TEST

// ---- drawing by error -----------------------------------------------------------------------

static struct rn_train_config sharing_config(int64_t steps) {
    struct rn_train_config config = capture_config("standard", steps);
    config.draw_by_error = true;
    ck_assert(config.favour_finest);
    return config;
}

// Errors that differ by more than a hundred times, and the shares that follow.
static void share_out(struct rn_trainer *t) {
    struct rn_importance *im = &t->sampler.importance;
    ck_assert_uint_gt(im->count, 20);
    for (size_t i = 0; i < im->count; i++)
        im->error[i] = i % 5 ? 1e-4f * (float)(1 + i * i % 150) : -1;
    rn_trainer_share_out(t, true);
}

// The same rays, several of a block, weighed alike; their losses, noted in their order, leave the
// same errors. Also where pixels are split, of which each is noted once.
START_TEST(a_step_by_errors) {
    struct rn_train_config config = sharing_config(1);
    config.initial_rays = 600;
    run.prepare = share_out;
    emulate((struct emulation){.order = 2}); // they come in any other
    for (int split = 0; split < 2; split++) {
        config.split_pixels = split;
        struct one_step here = take_step("cpu", &config), there = take_step("cuda:0", &config);
        double apart = 0, size = 0;
        for (size_t i = 0; i < here.blocks; i++) {
            apart += pow((double)(there.errors[i] - here.errors[i]), 2);
            size += pow((double)here.errors[i], 2);
        }
        printf("by errors%s: loss %.1e apart, errors %.1e", split ? ", pixels split" : "",
               fabs(there.loss - here.loss) / here.loss, sqrt(apart / size));
        ck_assert(here.blocks == there.blocks && here.blocks > 20);
        ck_assert_double_eq_tol(there.loss, here.loss, 1e-3 * here.loss);
        ck_assert_double_eq_tol((double)there.samples, (double)here.samples,
                                2e-3 * (double)here.samples);
        ck_assert_double_lt(sqrt(apart / size), 1e-3);
        compare_steps(&here, &there, 4e-2);
        step_finish(&here);
        step_finish(&there);
    }
}
END_TEST

// Past a look at the errors, here and there.
START_TEST(trains_by_errors) {
    struct rn_train_config config = sharing_config(100);
    double losses[2], held[2];
    for (int device = 0; device < 2; device++) {
        run_begin(device ? "cuda:0" : "cpu", &config);
        run_to(INT64_MAX);
        run_validate();
        const struct rn_importance *im = &run.trainer->sampler.importance;
        float most = 0;
        for (size_t i = 0; i < im->count; i++)
            most = fmaxf(most, im->share[i]);
        ck_assert_float_gt(most, 1.5f);
        losses[device] = run.progress.loss;
        held[device] = run.progress.psnr;
        run_end();
    }
    printf("by errors after 100 steps: loss %.5f and %.5f, held out %.2f and %.2f dB\n", losses[1],
           losses[0], held[1], held[0]);
    ck_assert_double_eq_tol(held[1], held[0], 0.3);
}
END_TEST

START_TEST(errors_go_on_to_the_same_bytes) {
    struct rn_train_config config = sharing_config(90);
    compare_interrupted(&config, 90);
}
END_TEST

// ---- turns ----------------------------------------------------------------------------------

static struct rn_train_config turning_config(int64_t steps) {
    struct rn_train_config config = capture_config("standard", steps);
    config.effect[RN_EFFECT_ROBUST_LOSS] = RN_EFFECT_WANTED;
    config.effect[RN_EFFECT_POSE_REFINEMENT] = RN_EFFECT_WANTED;
    return config;
}

// Cameras that have been moved are moved there too.
static void move_cameras(struct rn_trainer *t) {
    ck_assert_ptr_nonnull(t->poses.moves);
    for (int f = 0; f < t->train.frame_count; f++)
        for (int k = 0; k < RN_POSE_UNKNOWNS; k++)
            t->poses.moves[f][k] = 0.05f * (float)((f + k) % 3 - 1);
    rn_trainer_place_cameras(t);
}

START_TEST(a_step_of_moved_cameras) {
    run.prepare = move_cameras;
    check_step("standard", "moved cameras");
}
END_TEST

// Restores the checkpoint there, and trains until cameras have moved so often.
static void take_turns(const char *device, int turns, float (*ret_moves)[RN_POSE_UNKNOWNS]) {
    run_begin(device, NULL);
    const struct rn_trainer *t = run.trainer;
    while (t->poses.turns < turns)
        run_to(0);
    memcpy(ret_moves, t->poses.moves, (size_t)t->train.frame_count * sizeof *ret_moves);
    run_end();
}

// The host moves cameras, on its copy of the field: of one checkpoint the first time by the same
// bytes, after four more steps there and here by nearly the same. Further on that grows: a
// millionth on every parameter of the CPU's is a third of the moves after four turns.
START_TEST(cameras_move_as_on_the_cpu) {
    enum { VIEWS = 16 };
    struct rn_train_config config = turning_config(120);
    config.effect[RN_EFFECT_ROBUST_LOSS] = RN_EFFECT_UNWANTED;
    run.kernels = "generic";
    run.deterministic = true;
    run_begin("cpu", &config);
    run_to(18);
    ck_assert(rn_trainer_poses_due(run.trainer));
    int count = run.trainer->train.frame_count;
    ck_assert_int_le(count, VIEWS);
    OK(rn_trainer_save(run.trainer, run.path, &err));
    run_end();
    for (int turns = 1; turns <= 2; turns++) {
        float here[VIEWS][RN_POSE_UNKNOWNS], there[VIEWS][RN_POSE_UNKNOWNS];
        double apart = 0, size = 0;
        take_turns("cpu", turns, here);
        take_turns("cuda:0", turns, there);
        for (int f = 0; f < count; f++)
            for (int k = 0; k < RN_POSE_UNKNOWNS; k++) {
                apart += pow((double)(there[f][k] - here[f][k]), 2);
                size += pow((double)here[f][k], 2);
            }
        printf("cameras that moved %d times: %.1e apart\n", turns, sqrt(apart / size));
        ck_assert(size > 0 && (turns > 1 || apart == 0));
        ck_assert_double_lt(sqrt(apart / size), 0.01);
    }
}
END_TEST

// Photographs are looked at in turns, between the device's steps, and training goes on from there.
START_TEST(turns_go_on_to_the_same_bytes) {
    struct rn_train_config config = turning_config(30);
    run_begin("cuda:0", &config);
    run_to(INT64_MAX);
    const struct rn_trainer *t = run.trainer;
    ck_assert_ptr_nonnull(t->field->on_device);
    ck_assert_int_eq(t->poses.turns, 24);
    ck_assert_int_eq(t->outliers.turns, 7);
    for (int f = 0; f < t->train.frame_count; f++)
        ck_assert_float_ne(t->poses.moves[f][0], 0);
    run_end();
    compare_interrupted(&config, 30);
}
END_TEST

// ---- photographs in different light ---------------------------------------------------------

// The CPU alone trains it; of what it trained, pictures are the same there.
START_TEST(own_light_is_trained_here_and_shown_there) {
    struct rn_train_config config = capture_config("standard", 24);
    struct rn_error why;
    config.effect[RN_EFFECT_APPEARANCE] = RN_EFFECT_WANTED;
    run_begin("cpu", &config);
    run_to(INT64_MAX);
    ck_assert(run.trainer->field->effects[RN_EFFECT_APPEARANCE].on);
    OK(rn_trainer_save(run.trainer, run.path, &err));
    run_end();
    double apart = compare_pictures("cpu", "cuda:0", 1);
    printf("in the mean light, pictures %.1e apart\n", apart);
    ck_assert_double_lt(apart, 5e-3);
    config.field.appearances = 12; // as the scene's
    run_begin("cuda:0", &config);
    const struct rn_effect_record *r = &run.trainer->field->effects[RN_EFFECT_APPEARANCE];
    ck_assert_msg(!r->on && strstr(r->reason, "--device cpu"), "%s", r->reason);
    ck_assert_int_eq(run.trainer->field->config.field.appearances, 0);
    run_end();
    run.engine = engine_on("cuda:0");
    ck_assert_int_eq(rn_trainer_restore(run.engine, run.dataset, run.path, 0, &run.trainer, &why),
                     RN_ERROR_UNSUPPORTED);
    ck_assert_str_eq(why.where, "appearance");
    rn_engine_destroy(&run.engine);
}
END_TEST

void device_add_captures(Suite *suite) {
    device_add(suite, "light", own_light_is_trained_here_and_shown_there);
    device_add_with(suite, "masks", a_step_through_masks, make_masked);
    device_add_with(suite, "masked views", masked_views_are_scored, make_masked);
    device_add_with(suite, "outliers", a_step_past_outliers, make_larger);
    device_add(suite, "error step", a_step_by_errors);
    device_add(suite, "errors", trains_by_errors);
    device_add(suite, "error bytes", errors_go_on_to_the_same_bytes);
    device_add_with(suite, "moved", a_step_of_moved_cameras, make_moved);
    device_add_with(suite, "turn", cameras_move_as_on_the_cpu, make_moved);
    device_add_with(suite, "turns", turns_go_on_to_the_same_bytes, make_moved);
}
