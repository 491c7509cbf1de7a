// Pictures that a device renders: the dial, deadlines, cells of a field at rest, in the midst of a
// training.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"
#include "tests/ops/device_run.h"
#include "tests/support/naive_spline.h"

// How far a pixel of `p` is from what lies between its four neighbours: the mean of those on the
// diagonals; of those on the axes a spline, and at the border their mean.
static double off_between(const struct rn_picture *p, int x, int y) {
    double worst = 0;
    int d = x % 2 == 1 && y % 2 == 1;
    bool inside = x >= 3 && y >= 3 && x + 3 < p->width && y + 3 < p->height;
    ptrdiff_t right = 3, down = 3 * (ptrdiff_t)p->width, along = right + d * down,
              across = down - d * right;
    for (int c = 0; c < 3; c++) {
        const float *at = p->values + 3 * (y * p->width + x) + c;
        double mean = 0.25 * ((double)at[-along] + (double)at[along] + (double)at[-across] +
                              (double)at[across]);
        double between = !d && inside ? naive_spline(at, right, down) : mean;
        worst = fmax(worst, fabs((double)*at - between));
    }
    return worst;
}

// With a tolerance every pixel is as it was traced or lies between four neighbours, and those that
// were traced are as many as the rays.
static void check_tolerance(const struct rn_render_result *full,
                            const struct rn_render_result *quick) {
    const struct rn_picture *p = &quick->rgb;
    uint64_t traced = 0;
    for (int i = 0; i < p->width * p->height; i++) {
        int x = i % p->width, y = i / p->width;
        bool same = memcmp(p->values + 3 * i, full->rgb.values + 3 * i, 3 * sizeof(float)) == 0;
        bool inside = x > 0 && y > 0 && x + 1 < p->width && y + 1 < p->height;
        traced += same;
        if (same) continue;
        ck_assert(inside && (x % 2 == 1 || y % 2 == 1));
        ck_assert_double_lt(off_between(p, x, y), 1e-6);
    }
    ck_assert_uint_ge(traced, quick->stats.rays); // means of what is alike are the same too
    ck_assert_uint_lt(quick->stats.rays, full->stats.rays * 3 / 4);
    ck_assert_uint_gt(quick->stats.rays, full->stats.rays / 4);
}

// By a deadline that is far away as by none; by one that is over there is no picture.
static void check_deadline(struct rn_render_options options, const struct rn_render_result *full) {
    struct rn_render_result timed;
    struct rn_error said;
    options.deadline_ns = rn_clock_ns() + (int64_t)60e9;
    OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &timed, &err));
    ck_assert(timed.stats.on_device && timed.stats.tolerance > 0);
    ck_assert_double_lt(difference(&full->rgb, &timed.rgb), 1e-3);
    rn_render_result_finish(&timed);
    options.first_ns = options.deadline_ns = 1;
    ck_assert(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &timed,
                        &said) == RN_ERROR_LIMIT);
}

// The dial: a tolerance, and rays that end earlier, which are opaque there too.
static void check_dial(struct rn_render_options options, const struct rn_render_result *full) {
    struct rn_render_result quick;
    check_deadline(options, full);
    options.settings.tolerance = 0.1;
    options.settings.stop = rn_trainer_field(run.trainer)->config.stop;
    OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &quick, &err));
    printf("of %llu rays a tolerance leaves %llu\n", (unsigned long long)full->stats.rays,
           (unsigned long long)quick.stats.rays);
    ck_assert(quick.stats.on_device);
    check_tolerance(full, &quick);
    rn_render_result_finish(&quick);
    int opaque = 0;
    options.settings.stop = 0.5;
    options.outputs = RN_OUTPUT_ALPHA;
    OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &quick, &err));
    for (int i = 0; i < quick.alpha.width * quick.alpha.height; i++) {
        opaque += quick.alpha.values[i] == 1;
        ck_assert(quick.alpha.values[i] == 1 || quick.alpha.values[i] <= 0.5f); // rounded to fp16
    }
    ck_assert_int_gt(opaque, 0);
    rn_render_result_finish(&quick);
}

// A field at rest has finer cells, and of these firm ones; pictures read them there as on the CPU.
START_TEST(reads_the_cells_of_a_field_at_rest) {
    struct rn_train_config config = small_config("draft", 20);
    struct rn_render_options options = {.camera = run.dataset->frames[0].camera,
                                        .outputs = RN_OUTPUT_RGB,
                                        .settings.supersample = 1};
    run_begin("cuda:0", &config);
    run_to(20);
    struct rn_field *field = rn_trainer_finish(&run.trainer);
    int cells = field->config.field.occupancy;
    for (int i = 0; i < cells * cells * cells; i++) // few enough cells to be refined: a slab
        if ((i / cells / cells + 1) / 2 != cells / 4) field->occupancy[i] = 0;
    rn_field_refresh_occupancy(field);
    rn_field_refine_occupancy(field, run.engine);
    ck_assert_ptr_nonnull(field->fine.words);
    size_t bricks = (size_t)field->fine.cells / RN_BRICK, words = bricks * bricks * bricks * 16;
    memset(field->fine.words, 0, words / 2 * sizeof(uint32_t)); // far fewer than are occupied
    OK(rn_field_put_to_render(run.engine, field, &err));
    struct rn_render_result there[2], here[2], coarse;
    for (int i = 0; i < 2; i++) { // of rays that end early the firm ones
        options.settings.stop = i ? 0.1 : 0;
        OK(rn_render(run.engine, field, &options, NULL, NULL, &there[i], &err));
    }
    rn_field_withdraw(field);
    for (int i = 0; i < 2; i++) {
        options.settings.stop = i ? 0.1 : 0;
        OK(rn_render(run.engine, field, &options, NULL, NULL, &here[i], &err));
    }
    options.settings.stop = 0;
    rn_field_refresh_occupancy(field);
    OK(rn_render(run.engine, field, &options, NULL, NULL, &coarse, &err));
    printf("at rest: %llu samples for %llu, firm ones %llu\n",
           (unsigned long long)there[0].stats.samples, (unsigned long long)coarse.stats.samples,
           (unsigned long long)there[1].stats.samples);
    ck_assert_uint_lt(there[0].stats.samples, coarse.stats.samples * 3 / 4);
    ck_assert_uint_lt(there[1].stats.samples, there[0].stats.samples);
    for (int i = 0; i < 2; i++) {
        // A ray is looked at after 8 samples here and after 16 there.
        ck_assert_uint_ge(there[i].stats.samples, here[i].stats.samples);
        ck_assert_uint_le(there[i].stats.samples, here[i].stats.samples + 8 * here[i].stats.rays);
        ck_assert_double_lt(difference(&there[i].rgb, &here[i].rgb), 5e-3);
        rn_render_result_finish(&there[i]);
        rn_render_result_finish(&here[i]);
    }
    rn_render_result_finish(&coarse);
    rn_field_destroy(&field);
    rn_engine_destroy(&run.engine);
}
END_TEST

// What is rendered in the middle of a training is the field as it is there, also where a camera
// wants levels that the device lacks; and a finished training's field renders on.
START_TEST(renders_while_it_trains) {
    struct rn_train_config config = small_config("draft", 30);
    config.field.levels = 4;
    struct rn_render_options options = {.camera = run.dataset->frames[0].camera,
                                        .outputs = RN_OUTPUT_RGB,
                                        .settings.supersample = 1};
    run_begin("cuda:0", &config);
    for (int i = 0; i < 2; i++) {
        struct rn_render_result near, cones, far, after;
        run_to(16 * (i + 1));
        OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &near, &err));
        check_dial(options, &near);
        struct rn_render_options away = options, split = options;
        split.settings.supersample = 2;
        OK(rn_render(run.engine, rn_trainer_field(run.trainer), &split, NULL, NULL, &cones, &err));
        for (int k = 0; k < 3; k++)
            away.camera.world_from_camera[k][3] *= 6;
        OK(rn_render(run.engine, rn_trainer_field(run.trainer), &away, NULL, NULL, &far, &err));
        OK(rn_trainer_save(run.trainer, run.path, &err));
        picture("cpu", 1, 1, &after);
        ck_assert_double_lt(difference(&near.rgb, &after.rgb), 5e-3);
        rn_render_result_finish(&after);
        picture("cpu", 1, 2, &after);
        ck_assert_double_lt(difference(&cones.rgb, &after.rgb), 5e-3);
        ck_assert_double_gt(difference(&cones.rgb, &near.rgb), 5e-3);
        rn_render_result_finish(&after);
        picture("cpu", 6, 1, &after);
        ck_assert(difference(&far.rgb, &after.rgb) == 0); // the CPU's, both
        rn_render_result_finish(&after);
        rn_render_result_finish(&near);
        rn_render_result_finish(&cones);
        rn_render_result_finish(&far);
    }
    struct rn_field *field = rn_trainer_finish(&run.trainer);
    ck_assert_ptr_nonnull(field->on_device);
    struct rn_render_result last;
    OK(rn_render(run.engine, field, &options, NULL, NULL, &last, &err));
    rn_render_result_finish(&last);
    rn_field_destroy(&field);
    rn_engine_destroy(&run.engine);
}
END_TEST

// The backend's rendering, counted: calls, and cameras of the last.
static struct {
    struct rn_backend table;
    const struct rn_backend *counted;
    int calls, cameras;
} counter;
static enum rn_status
count_and_render(struct rn_device_field *field, const struct rn_device_view *view,
                 const struct rn_march_options *options, const struct rn_device_places *places,
                 struct rn_pixel *ret_pixels, uint64_t *ret_samples, struct rn_error *e) {
    counter.calls++;
    counter.cameras = view->camera_count;
    return counter.counted->render(field, view, options, places, ret_pixels, ret_samples, e);
}
static void count_calls(struct rn_field *field) {
    counter.counted = field->backend;
    counter.table = *field->backend;
    counter.table.render = count_and_render;
    field->backend = &counter.table;
}

static bool same_bytes(const struct rn_picture *a, const struct rn_picture *b) {
    size_t count = (size_t)a->width * (size_t)a->height * (size_t)a->channels;
    return a->width == b->width && a->height == b->height && a->channels == b->channels &&
           (count == 0 || memcmp(a->values, b->values, count * sizeof *a->values) == 0);
}

#define MANY 5

// Renders `count` together; the first `fit` of them are, in `calls` calls, and each is what it is
// by itself.
static void check_together(struct rn_render_options *options, int count, int fit, int calls) {
    struct rn_field *field = rn_trainer_field(run.trainer);
    struct rn_render_result together[MANY], alone;
    uint64_t samples = 0, samples_alone = 0;
    int made = 0;
    counter.calls = 0;
    OK(rn_render_together(run.engine, field, options, count, NULL, NULL, together, &made, &err));
    ck_assert_int_eq(made, fit);
    ck_assert(counter.calls == calls && counter.cameras == fit);
    ck_assert(!same_bytes(&together[0].rgb, &together[1].rgb));
    for (int i = 0; i < made; i++) {
        const struct rn_render_result *t = &together[i];
        OK(rn_render(run.engine, field, &options[i], NULL, NULL, &alone, &err));
        ck_assert(t->stats.on_device && alone.stats.on_device);
        ck_assert(same_bytes(&t->rgb, &alone.rgb) && same_bytes(&t->alpha, &alone.alpha));
        ck_assert(same_bytes(&t->depth, &alone.depth));
        ck_assert(t->stats.rays == alone.stats.rays && t->stats.cones == alone.stats.cones);
        ck_assert(t->stats.interpolation == alone.stats.interpolation);
        ck_assert(t->stats.render_ms == together[0].stats.render_ms);
        samples += t->stats.samples;
        samples_alone += alone.stats.samples;
        rn_render_result_finish(&together[i]);
        rn_render_result_finish(&alone);
    }
    ck_assert_uint_le(samples_alone - samples, (uint64_t)made); // but for what shares leave over
}

static bool refuses(void *context) {
    return --*(int *)context >= 0;
}

// Cancelled like a picture by itself: before the device is asked; nothing is left.
static void check_cancelled(struct rn_render_options *options) {
    struct rn_render_result none[MANY];
    int looks = 0, made = 7;
    struct rn_error said;
    counter.calls = 0;
    ck_assert(rn_render_together(run.engine, rn_trainer_field(run.trainer), options, MANY, refuses,
                                 &looks, none, &made, &said) == RN_ERROR_CANCELLED);
    ck_assert(made == 7 && counter.calls == 0 && looks == -1);
}

// Several pictures in one call, of a device: the same bytes as one by one, plainly, with depth,
// several cones, developed each as it is, with a tolerance, up to the first that does not go with
// them.
START_TEST(pictures_are_made_together) {
    struct rn_train_config config = small_config("draft", 4);
    const struct rn_box crop = {{-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5}};
    struct rn_render_options many[MANY], o;
    struct rn_camera instants[2];
    config.field.levels = 4;
    run_begin("cuda:0", &config);
    run_to(4);
    count_calls(rn_trainer_field(run.trainer));
    for (int i = 0; i < MANY; i++)
        many[i] = (struct rn_render_options){.camera = run.dataset->frames[i].camera,
                                             .outputs = RN_OUTPUT_RGB,
                                             .settings.supersample = 1};
    ck_assert_int_eq(rn_render_fit(run.engine, rn_trainer_field(run.trainer), many), 32);
    check_together(many, MANY, MANY, 1);
    check_together(many, 2, 2, 1);
    check_cancelled(many);
    for (int i = 0; i < MANY; i++) {
        many[i].outputs = RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA;
        many[i].settings.supersample = 2;
        many[i].shot.optics.exposure = 0.5 * i;
    }
    check_together(many, MANY, MANY, 1);
    for (int i = 0; i < MANY; i++)
        many[i].settings =
            (struct rn_render_settings){.supersample = 1, .stop = 0.1, .tolerance = 0.05};
    check_together(many, MANY, MANY, 3);
    // What does not go with the others.
    instants[0] = many[3].camera, instants[1] = many[4].camera;
    for (int k = 0; k < 10; k++) {
        o = many[3];
        if (k == 0) o.background[1] = 0.5f;
        if (k == 1) o.outputs = RN_OUTPUT_RGB;
        if (k == 2) o.settings.tolerance = 0.06;
        if (k == 3) o.settings.stop = 0.5;
        if (k == 4) o.crop = &crop;
        if (k == 5)
            o.shot.optics.shutter = 0.5, o.shot.instants = instants, o.shot.instant_count = 2;
        if (k == 6) o.camera = rn_camera_resized(&o.camera, 8, 8);
        if (k == 7) o.straight = true;
        if (k == 9) o.settings.step = 0.5;
        for (int i = 0; i < 3 && k == 8; i++)
            o.camera.world_from_camera[i][3] *= 6; // more levels than the device has
        struct rn_render_options mixed[MANY] = {many[0], many[1], o, many[2], many[4]};
        check_together(mixed, MANY, 2, 3);
    }
    o.crop = &crop;
    ck_assert_int_eq(rn_render_fit(run.engine, rn_trainer_field(run.trainer), &o), 1);
    o = many[0], o.camera = rn_camera_resized(&o.camera, 1024, 100);
    ck_assert_int_eq(rn_render_fit(run.engine, rn_trainer_field(run.trainer), &o), 2);
    rn_trainer_field(run.trainer)->backend = counter.counted;
    run_end();
}
END_TEST

// Whether the device renders a picture of so many times the training's distance; it is a picture
// either way.
static bool renders_there(struct rn_render_options options, double away) {
    struct rn_render_result result;
    for (int k = 0; k < 3; k++)
        options.camera.world_from_camera[k][3] *= away;
    OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &result, &err));
    bool there = result.stats.on_device;
    rn_render_result_finish(&result);
    return there;
}

// What the client's `info` and `show` call the CPU's alone is rendered there, and nothing else is.
START_TEST(leaves_to_the_cpu_what_is_listed) {
    struct rn_train_config config = small_config("draft", 4);
    const struct rn_box crop = {{-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5}};
    struct rn_camera instants[2] = {run.dataset->frames[0].camera, run.dataset->frames[1].camera};
    const struct rn_render_options plain = {
        .camera = instants[0], .outputs = RN_OUTPUT_RGB, .settings.supersample = 1};
    struct rn_render_options o;
    config.field.levels = 4;
    run_begin("cuda:0", &config);
    run_to(4);
    o = plain, o.outputs |= RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA;
    ck_assert(renders_there(o, 1));
    o = plain, o.settings = (struct rn_render_settings){.supersample = 2, .tolerance = 0.2};
    ck_assert(renders_there(o, 1));
    o = plain, o.settings.subsample = 2;
    ck_assert(!renders_there(o, 1)); // as a camera twice as far away
    o = plain, o.shot.optics.exposure = 1, o.shot.optics.white_balance = 5000;
    ck_assert(renders_there(o, 1));
    ck_assert(!renders_there(plain, 6)); // more levels than training took
    static const unsigned inside[] = {RN_OUTPUT_COST, RN_OUTPUT_NORMAL, RN_OUTPUT_LEVEL,
                                      RN_OUTPUT_FOOTPRINT};
    for (int i = 0; i < 4; i++) {
        o = plain, o.outputs |= inside[i];
        ck_assert(!renders_there(o, 1));
    }
    o = plain, o.crop = &crop;
    ck_assert(!renders_there(o, 1));
    o = plain, o.appearance.own = true;
    ck_assert(!renders_there(o, 1));
    o = plain, o.shot.optics.aperture = 0.1, o.shot.optics.focus = 3;
    ck_assert(!renders_there(o, 1));
    o = plain, o.shot.optics.ortho_height = 2;
    ck_assert(!renders_there(o, 1));
    o = plain, o.shot.optics.shutter = 0.5, o.shot.instants = instants, o.shot.instant_count = 2;
    ck_assert(!renders_there(o, 1));
    ck_assert(renders_there(plain, 1)); // as before
    run_end();
}
END_TEST

// A validation's photographs are rendered in one call as far as they are alike and not too many
// pixels: the figure is, to the last bit, that of one after the other and of rows of them.
START_TEST(photographs_are_validated_together) {
    struct rn_train_config config = small_config("standard", 4);
    run_begin("cuda:0", &config);
    struct rn_trainer *t = run.trainer;
    struct rn_pixel_frame *frames = t->held.frames;
    int count = t->held.frame_count, rows = frames->camera.height;
    double sum = 0;
    ck_assert_int_ge(count, 4);
    run_to(4);
    count_calls(rn_trainer_field(t));
    counter.calls = 0;
    run_validate();
    ck_assert(counter.calls == 1 && counter.cameras == count);
    for (int i = 0; i < count; i++) {
        double alone = 0, parts = 0, used = (double)rn_pixels_used(&t->held, &frames[i]);
        OK(rn_trainer_validate_rows(t, i, 1, 0, rows, &alone, &err));
        OK(rn_trainer_validate_rows(t, i, 1, 0, rows - 3, &parts, &err));
        OK(rn_trainer_validate_rows(t, i, 1, rows - 3, 3, &parts, &err));
        ck_assert(alone > 0 && alone == parts);
        sum += -10 * log10(alone / (3 * used));
    }
    ck_assert(run.progress.psnr == sum / count);
    // What does not go with the others, and what does not go at all.
    const struct rn_camera camera = frames[2].camera;
    ck_assert_int_eq(rn_trainer_validate_together(t, 1), count - 1);
    frames[2].camera.width /= 2;
    ck_assert_int_eq(rn_trainer_validate_together(t, 0), 2);
    ck_assert_int_eq(rn_trainer_validate_together(t, 2), 1);
    frames[2].camera.width = frames[2].camera.height = 300;
    ck_assert_int_eq(rn_trainer_validate_together(t, 2), 0);
    frames[2].camera = camera;
    rn_trainer_field(t)->backend = counter.counted;
    run_end();
}
END_TEST

// Photographs of more pixels than a call takes: rows of them, nothing left out.
START_TEST(large_photographs_are_validated_by_rows) {
    struct rn_train_config config = small_config("draft", 2);
    double sum = 0;
    run_begin("cuda:0", &config);
    struct rn_trainer *t = run.trainer;
    int rows = t->held.frames->camera.height;
    run_to(2);
    ck_assert_int_eq(rn_trainer_validate_together(t, 0), 0);
    count_calls(rn_trainer_field(t));
    counter.calls = 0;
    t->held.frame_count = 1; // the emulator's time
    run_validate();
    ck_assert_int_eq(counter.calls, (rows + 63) / 64);
    OK(rn_trainer_validate_rows(t, 0, 1, 0, rows, &sum, &err));
    sum = -10 * log10(sum / (3 * (double)rn_pixels_used(&t->held, t->held.frames)));
    ck_assert_double_eq(run.progress.psnr, sum);
    rn_trainer_field(t)->backend = counter.counted;
    run_end();
}
END_TEST

static void make_large(void) {
    make_dataset_sized("sphere", 260);
}

void device_add_pictures(Suite *suite) {
    device_add(suite, "leaves", leaves_to_the_cpu_what_is_listed);
    device_add(suite, "together", pictures_are_made_together);
    device_add(suite, "validates", photographs_are_validated_together);
    device_add_with(suite, "validates", large_photographs_are_validated_by_rows, make_large);
    device_add(suite, "renders", renders_while_it_trains);
    device_add(suite, "rest", reads_the_cells_of_a_field_at_rest);
}
