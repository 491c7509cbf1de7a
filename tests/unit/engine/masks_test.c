// What training makes of masks that leave out a few pixels, of those that cut an object out, of
// exposures that were measured, and of a backdrop: of a procedural sphere, small, whose alpha
// channel becomes masks.
#include <math.h>
#include <stdlib.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/engine/engine.h"
#include "server/engine/train/trainer.h"
#include "tests/support/suite.h"

#define VIEWS 12
#define SIZE 32
#define STEPS 512

static char folder[] = "/tmp/ripnerf-masks-XXXXXX";
static struct rn_engine *engine;
static struct rn_dataset *dataset;

static void must(enum rn_status status, const struct rn_error *err) {
    ck_assert_msg(status == RN_OK, "%s: %s", err->where, err->text);
}

static void setup(void) {
    struct rn_error err = {0};
    struct rn_engine_options options = {.device = "cpu", .threads = 1};
    struct rn_synth_options synth = {.size = SIZE, .views = VIEWS, .threads = 1, .samples = 4};
    strcpy(folder + sizeof folder - 7, "XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    must(rn_synthesise("sphere", &synth, folder, NULL, NULL, &err), &err);
    must(rn_dataset_read(folder, NULL, &dataset, &err), &err);
    must(rn_engine_create(&options, &engine, &err), &err);
}

static void teardown(void) {
    rn_dataset_destroy(&dataset);
    rn_engine_destroy(&engine);
    (void)!rn_remove_tree(folder, NULL);
}

static struct rn_trainer *make_trainer_as(enum rn_effect_choice masks) {
    struct rn_error err = {0};
    struct rn_train_config config;
    struct rn_trainer *trainer;
    must(rn_preset("draft", false, &config, &err), &err);
    config.field.base = 32;
    config.grow_to = 0;
    config.field.occupancy = 32;
    config.target_samples = 4096;
    config.initial_rays = 256;
    config.max_seconds = 0;
    config.max_steps = STEPS;
    config.effect[RN_EFFECT_MASKS] = masks;
    must(rn_trainer_create(engine, dataset, &config, 0, &trainer, &err), &err);
    return trainer;
}

static struct rn_trainer *make_trainer(void) {
    return make_trainer_as(RN_EFFECT_AUTO);
}

static void train(struct rn_trainer *trainer) {
    struct rn_error err = {0};
    struct rn_progress progress;
    do {
        must(rn_trainer_advance(trainer, 50, &err), &err);
        rn_trainer_progress(trainer, &progress);
    } while (!progress.done);
}

// The alpha channel becomes a mask, and what it left out noise.
static void put_masks(bool object) {
    struct rn_error err = {0};
    for (size_t f = 0; f < dataset->frame_count; f++) {
        struct rn_frame *frame = &dataset->frames[f];
        struct rn_image image, mask;
        must(rn_image_read(frame->path, &rn_image_default_limits, &image, &err), &err);
        must(rn_image_read(frame->path, &rn_image_default_limits, &mask, &err), &err);
        for (int i = 0; i < SIZE * SIZE; i++) {
            uint8_t *colour = image.pixels + 4 * i, inside = colour[3] == 255 ? 255 : 0;
            if (!object) inside = i < SIZE ? 0 : 255; // the first row alone is left out
            for (int c = 0; c < 3 && colour[3] < 255; c++)
                colour[c] = (uint8_t)(i * 37 + c * 101 + (int)f * 59);
            memset(mask.pixels + 4 * i, inside, 3);
            mask.pixels[4 * i + 3] = colour[3] = 255;
        }
        image.has_alpha = mask.has_alpha = false;
        free(frame->mask_path);
        ck_assert_int_gt(
            asprintf(&frame->mask_path, "%.*s_mask.png", (int)strlen(frame->path) - 4, frame->path),
            0);
        must(rn_image_write_png(&image, frame->path, 3, &err), &err);
        must(rn_image_write_png(&mask, frame->mask_path, 3, &err), &err);
        frame->has_alpha = false;
        rn_image_finish(&image);
        rn_image_finish(&mask);
    }
}

// Mean opacity of a view where its mask has `inside`.
static double mean_opacity(struct rn_trainer *trainer, const struct rn_frame *frame, int inside) {
    struct rn_error err = {0};
    struct rn_render_options options = {.camera = frame->camera, .outputs = RN_OUTPUT_ALPHA};
    struct rn_render_result result;
    uint8_t used[SIZE * SIZE];
    double sum = 0, count = 0;
    must(rn_mask_read(frame, used, &err), &err);
    must(rn_render(engine, rn_trainer_field(trainer), &options, NULL, NULL, &result, &err), &err);
    for (int i = 0; i < SIZE * SIZE; i++) {
        count += used[i] == inside;
        sum += used[i] == inside ? (double)result.alpha.values[i] : 0;
    }
    rn_render_result_finish(&result);
    return sum / count;
}

START_TEST(masks_that_cut_out) {
    put_masks(true);
    struct rn_trainer *trainer = make_trainer();
    const struct rn_field *field = rn_trainer_field(trainer);
    ck_assert(field->config.cut_out && field->effects[RN_EFFECT_MASKS].on);
    ck_assert_double_gt(field->effects[RN_EFFECT_MASKS].number, 50);
    ck_assert(!field->effects[RN_EFFECT_UNBOUNDED].on);
    ck_assert(field->effects[RN_EFFECT_BACKGROUND].on);
    uint64_t cells = (uint64_t)field->config.field.occupancy;
    ck_assert_uint_lt(field->hull_cells, cells * cells * cells / 4);
    train(trainer);
    const struct rn_frame *unseen = rn_dataset_frame(dataset, RN_SPLIT_TEST, 0, 0);
    ck_assert_double_gt(mean_opacity(trainer, unseen, 1), 0.8);
    ck_assert_double_lt(mean_opacity(trainer, unseen, 0), 0.1);
    rn_trainer_destroy(&trainer);
}
END_TEST

START_TEST(masks_that_leave_out_little) {
    put_masks(false);
    struct rn_trainer *trainer = make_trainer();
    const struct rn_field *field = rn_trainer_field(trainer);
    ck_assert(!field->config.cut_out && field->effects[RN_EFFECT_MASKS].on);
    ck_assert_double_eq_tol(field->effects[RN_EFFECT_MASKS].number, 100.0 / SIZE, 1e-9);
    ck_assert(!field->effects[RN_EFFECT_BACKGROUND].on);
    ck_assert_ptr_nonnull(trainer->train.used);
    rn_trainer_destroy(&trainer);
}
END_TEST

// However little they leave out, where that is asked for; and none do where they are not wanted.
START_TEST(masks_that_cut_out_on_request) {
    put_masks(false);
    struct rn_trainer *trainer = make_trainer_as(RN_EFFECT_WANTED);
    const struct rn_field *field = rn_trainer_field(trainer);
    ck_assert(field->config.cut_out && field->effects[RN_EFFECT_BACKGROUND].on);
    rn_trainer_destroy(&trainer);
    put_masks(true);
    trainer = make_trainer_as(RN_EFFECT_UNWANTED);
    ck_assert(!rn_trainer_field(trainer)->config.cut_out);
    rn_trainer_destroy(&trainer);
}
END_TEST

// A photograph as if it had been darker than those beside it.
static void expose(struct rn_frame *frame) {
    struct rn_error err = {0};
    struct rn_image image;
    must(rn_image_read(frame->path, &rn_image_default_limits, &image, &err), &err);
    for (int c = 0; c < 3; c++) {
        frame->gain[c] = frame->index % 2 ? 0.6 + 0.05 * c : 0.95;
        for (int i = 0; i < SIZE * SIZE; i++)
            image.pixels[4 * i + c] = (uint8_t)(image.pixels[4 * i + c] * frame->gain[c] + 0.5);
    }
    must(rn_image_write_png(&image, frame->path, 3, &err), &err);
    rn_image_finish(&image);
}

// The mean distance of what is trained on from the photographs as they were, of 255.
static double off_by(const struct rn_trainer *trainer, struct rn_image *const were) {
    double sum = 0, count = 0;
    for (int f = 0; f < trainer->train.frame_count; f++) {
        const struct rn_pixel_frame *frame = &trainer->train.frames[f];
        const uint8_t *is = trainer->train.rgba + 4 * frame->offset;
        const uint8_t *was = were[frame->frame - dataset->frames].pixels;
        for (int i = 0; i < 4 * SIZE * SIZE; i++) {
            if (was[i | 3] == 0) continue;
            sum += abs(is[i] - was[i]);
            count++;
        }
    }
    return sum / count;
}

START_TEST(exposures_are_made_even) {
    struct rn_error err = {0};
    struct rn_image were[64];
    size_t count = dataset->frame_count;
    ck_assert_uint_le(count, 64);
    for (size_t f = 0; f < count; f++) {
        must(rn_image_read(dataset->frames[f].path, &rn_image_default_limits, &were[f], &err),
             &err);
        expose(&dataset->frames[f]);
    }
    for (int even = 1; even >= 0; even--) {
        for (size_t f = 0; f < count && !even; f++) // not measured: as they are
            memset(dataset->frames[f].gain, 0, sizeof dataset->frames[f].gain);
        struct rn_trainer *trainer = make_trainer();
        const struct rn_field *field = rn_trainer_field(trainer);
        ck_assert_int_eq(field->effects[RN_EFFECT_EXPOSURE].on, even);
        if (even) {
            ck_assert_double_gt(field->effects[RN_EFFECT_EXPOSURE].number, 20);
            ck_assert_double_lt(off_by(trainer, were), 1);
        } else {
            ck_assert_double_gt(off_by(trainer, were), 5);
        }
        rn_trainer_destroy(&trainer);
    }
    for (size_t f = 0; f < count; f++)
        rn_image_finish(&were[f]);
}
END_TEST

// Photographs that were cut from what they stood on are composited over its colour from the first
// step on, others over random ones at first.
START_TEST(cut_from_a_backdrop) {
    static const uint8_t colour[3] = {0, 51, 255};
    for (size_t f = 0; f < dataset->frame_count; f++) {
        dataset->frames[f].backdrop.known = _i == 1;
        memcpy(dataset->frames[f].backdrop.colour, colour, sizeof colour);
    }
    struct rn_trainer *trainer = make_trainer();
    const struct rn_field *field = rn_trainer_field(trainer);
    const struct rn_effect_record *record = &field->effects[RN_EFFECT_BACKGROUND];
    ck_assert(record->on && field->config.carve);
    ck_assert_int_eq(field->config.random_background > 0, _i == 0);
    ck_assert_int_eq(strstr(record->reason, "from the colour 0,51,255") != NULL, _i == 1);
    for (int c = 0; c < 3; c++)
        ck_assert_float_eq(field->config.background[c], _i == 0 ? 1 : (float)colour[c] / 255);
    rn_trainer_destroy(&trainer);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("masks");
    TCase *tests = tcase_create("masks");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_set_timeout(tests, 120);
    tcase_add_test(tests, masks_that_cut_out);
    tcase_add_test(tests, masks_that_leave_out_little);
    tcase_add_test(tests, masks_that_cut_out_on_request);
    tcase_add_test(tests, exposures_are_made_even);
    tcase_add_loop_test(tests, cut_from_a_backdrop, 0, 2);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
