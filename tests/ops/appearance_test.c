// Photographs in different light (effect appearance): the codes' gradients, what a training makes
// of photographs half of which have red and blue exchanged, and what comes back from a checkpoint
// and a scene's file.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/scene/appearance.h"
#include "tests/ops/train_scene.h"

#define APPEARANCE RN_EFFECT_APPEARANCE

// The sphere's photographs as if an import had compared their light.
struct capture {
    struct rn_dataset dataset;
    struct rn_frame *frames;
};

static struct capture in_light(double apart) {
    struct capture c = {.dataset = *dataset};
    c.dataset.frames = c.frames = malloc(dataset->frame_count * sizeof *c.frames);
    for (size_t f = 0; f < dataset->frame_count; f++) {
        c.frames[f] = dataset->frames[f];
        c.frames[f].light = apart;
    }
    return c;
}

static struct rn_train_config config_of(const struct capture *c, int steps) {
    struct rn_train_config config = config_for(&c->dataset);
    config.max_steps = steps;
    config.split_pixels = 0;
    return config;
}

static bool is_exchanged(const struct rn_trainer *t, const struct rn_pixel_frame *frame) {
    return (frame->frame - t->dataset->frames) % 2;
}

// Red and blue of every other photograph.
static void exchange(const struct rn_trainer *t, const struct rn_pixels *pixels) {
    for (int f = 0; f < pixels->frame_count; f++) {
        const struct rn_pixel_frame *frame = &pixels->frames[f];
        size_t count = (size_t)frame->camera.width * (size_t)frame->camera.height;
        uint8_t *rgba = (uint8_t *)pixels->rgba + 4 * frame->offset;
        for (size_t i = 0; i < count && is_exchanged(t, frame); i++) {
            uint8_t red = rgba[4 * i];
            rgba[4 * i] = rgba[4 * i + 2];
            rgba[4 * i + 2] = red;
        }
    }
}

static float *codes_of(struct rn_trainer *t) {
    return (float *)rn_field_appearances(t->field);
}

// ---- gradients ----

// The loss of the rays of the last step, and the sum of what they ask of the codes.
static double loss_of(struct rn_trainer *t, float *ret_grad) {
    double loss = 0;
    size_t count = t->field->parameters.appearance_count;
    rn_trainer_redraw(t);
    memset(ret_grad, 0, count * sizeof *ret_grad);
    for (int g = 0; g < RN_GROUPS; g++) {
        struct rn_group *group = &t->step.groups[g];
        while (group->cursor < group->end) {
            group->slab.count = 0;
            t->engine->kernels->train(&t->field->cpu, &t->step.march, t->step.rays,
                                      rn_engine_workspace(t->engine, 0), group);
        }
        loss += group->loss;
        for (size_t i = 0; i < count; i++)
            ret_grad[i] += group->appearance_grad[i];
    }
    return loss;
}

// Central differences of every third number of the codes, in the kernels' own arithmetic, as a
// share of the gradients; ReLUs turn within them.
static double from_differences(const struct rn_kernels *kernels, enum rn_shading shading) {
    struct capture c = in_light(0.2);
    struct rn_train_config config = config_of(&c, 30);
    config.field.shading = shading;
    config.roulette = 0;
    struct rn_engine *engine = engine_with(1);
    engine->kernels = kernels;
    struct rn_trainer *t = trainer_for(engine, &c.dataset, &config);
    exchange(t, &t->train);
    run_to_end(t);
    size_t count = t->field->parameters.appearance_count;
    float *grad = malloc(count * sizeof *grad), *unused = malloc(count * sizeof *unused);
    float h = rn_kernels_bf16(kernels) ? 0.05f : 0.005f;
    double apart = 0, size = 0;
    loss_of(t, grad);
    for (size_t i = 0; i < count; i += 3) {
        float kept = codes_of(t)[i];
        codes_of(t)[i] = kept + h;
        double above = loss_of(t, unused);
        codes_of(t)[i] = kept - h;
        double slope = (above - loss_of(t, unused)) / (2 * (double)h);
        codes_of(t)[i] = kept;
        apart += pow(slope - (double)grad[i], 2);
        size += slope * slope;
    }
    ck_assert_double_gt(size, 0);
    free(grad);
    free(unused);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    free(c.frames);
    return sqrt(apart / size);
}

// _i: a colour a sample, a colour a ray.
START_TEST(gradients_are_those_of_differences) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++) {
        double apart = from_differences(kernels, (enum rn_shading)_i);
        printf("%s, %s shading: gradients off by %.2g from differences\n", kernels->name,
               rn_shading_names[_i], apart);
        ck_assert_double_lt(apart, rn_kernels_bf16(kernels) ? 0.3 : 0.06);
    }
}
END_TEST

// ---- trainings ----

enum light { MEAN, OWN, SOUGHT };

// A photograph's own appearance, or the one found by its left half.
static struct rn_appearance appearance_of(struct rn_trainer *t, const struct rn_pixels *pixels,
                                          const struct rn_pixel_frame *frame, enum light light) {
    struct rn_pose_looker looker = {t->engine, t->field, 0, rn_effects_march_trained(t->field)};
    struct rn_pose_photo photo = {.rgba = pixels->rgba + 4 * frame->offset,
                                  .camera = frame->camera};
    struct rn_appearance found = {.own = true};
    if (light == MEAN) return (struct rn_appearance){.own = false};
    if (light == OWN)
        return rn_field_appearance(t->field, (size_t)(frame->frame - t->dataset->frames));
    ck_assert(rn_field_make_ready(t->field, t->engine, t->optimiser.levels, NULL) == RN_OK);
    rn_appearance_seek(&looker, &photo, RN_POSE_LEFT, 1, found.code);
    return found;
}

// PSNR over the object's pixels.
static double psnr_of(struct rn_trainer *t, const struct rn_pixels *pixels, enum light light) {
    double sum = 0, count = 0;
    struct rn_error err;
    for (int f = 0; f < pixels->frame_count; f++) {
        const struct rn_pixel_frame *frame = &pixels->frames[f];
        struct rn_render_options options = {.camera = frame->camera, .outputs = RN_OUTPUT_RGB};
        struct rn_render_result result = {0};
        memcpy(options.background, t->field->config.background, sizeof options.background);
        options.appearance = appearance_of(t, pixels, frame, light);
        ck_assert_int_eq(rn_render(t->engine, t->field, &options, NULL, NULL, &result, &err),
                         RN_OK);
        for (int i = 0; i < frame->camera.width * frame->camera.height; i++) {
            const uint8_t *is = pixels->rgba + 4 * (frame->offset + (size_t)i);
            for (int k = 0; k < 3 && is[3] == 255; k++, count++)
                sum += pow((double)result.rgb.values[3 * i + k] - is[k] / 255.0, 2);
        }
        rn_render_result_finish(&result);
    }
    return -10 * log10(sum / count);
}

static struct rn_trainer *train_with(struct rn_engine *engine, const struct capture *c,
                                     enum rn_effect_choice choice) {
    struct rn_train_config config = config_of(c, 300);
    config.effect[APPEARANCE] = choice;
    struct rn_trainer *t = trainer_for(engine, &c->dataset, &config);
    exchange(t, &t->train);
    exchange(t, &t->held);
    run_to_end(t);
    return t;
}

// Photographs that were not trained on, which view dependence cannot make up for: one half of each
// tells the light of it.
START_TEST(each_photograph_has_its_own_light) {
    struct capture c = in_light(0.2);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *with = train_with(engine, &c, RN_EFFECT_AUTO);
    struct rn_trainer *without = train_with(engine, &c, RN_EFFECT_UNWANTED);
    const struct rn_effect_record *r = &with->field->effects[APPEARANCE];
    double own = psnr_of(with, &with->train, OWN), mean = psnr_of(with, &with->train, MEAN);
    double sought = psnr_of(with, &with->held, SOUGHT),
           not_sought = psnr_of(with, &with->held, MEAN);
    double off = psnr_of(without, &without->held, MEAN);
    printf("%s; trained on %.2f dB, in the mean light %.2f; not trained on %.2f, %.2f; off %.2f\n",
           r->reason, own, mean, sought, not_sought, off);
    ck_assert_msg(r->on && r->decided && r->number > r->threshold, "%s", r->reason);
    ck_assert(with->field->effects[RN_EFFECT_VIEW_DEPENDENCE].on);
    ck_assert_double_gt(own, mean + 3);
    ck_assert_double_gt(sought, not_sought + 0.7);
    ck_assert_double_gt(sought, off + 1.5);
    ck_assert(!without->field->effects[APPEARANCE].on);
    ck_assert_uint_eq(without->field->parameters.appearance_count, 0);
    rn_trainer_destroy(&with);
    rn_trainer_destroy(&without);
    rn_engine_destroy(&engine);
    free(c.frames);
}
END_TEST

START_TEST(like_light_is_left_alone) {
    struct capture c = in_light(0.04);
    struct rn_engine *engine = engine_with(1);
    struct rn_train_config config = config_of(&c, 10);
    struct rn_trainer *t = trainer_for(engine, &c.dataset, &config);
    const struct rn_effect_record *r = &t->field->effects[APPEARANCE];
    ck_assert_msg(!r->on && r->number < r->threshold, "%s", r->reason);
    ck_assert_int_eq(t->field->config.field.appearances, 0);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    free(c.frames);
}
END_TEST

// ---- what is kept ----

static void look_at_codes(const struct rn_trainer *t, bool restored) {
    const float *codes = rn_field_appearances(t->field);
    size_t count = (size_t)t->field->config.field.appearances, trained = 0;
    double sum[RN_APPEARANCE] = {0}, size = 0;
    (void)restored;
    ck_assert_uint_eq(count, t->dataset->frame_count);
    for (size_t p = 0; p < count; p++) {
        trained += codes[p * RN_APPEARANCE] != 0;
        for (int i = 0; i < RN_APPEARANCE; i++) {
            sum[i] += (double)codes[p * RN_APPEARANCE + i];
            size = fmax(size, fabs((double)codes[p * RN_APPEARANCE + i]));
        }
    }
    ck_assert_uint_eq(trained, (size_t)t->train.frame_count);
    ck_assert_double_gt(size, 0.01);
    for (int i = 0; i < RN_APPEARANCE; i++)
        ck_assert_double_lt(fabs(sum[i]), 1e-6 * (double)count * size);
}

START_TEST(codes_go_on_from_a_checkpoint) {
    struct capture c = in_light(0.2);
    struct rn_train_config config = config_of(&c, 60);
    check_goes_on(&c.dataset, &config, look_at_codes);
    free(c.frames);
}
END_TEST

START_TEST(a_scenes_file_keeps_the_codes) {
    struct capture c = in_light(0.2);
    struct rn_train_config config = config_of(&c, 30);
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = trainer_for(engine, &c.dataset, &config);
    struct rn_viewing viewing = {.bits = 8};
    struct rn_field *field;
    struct rn_error err;
    char path[128];
    run_to_end(t);
    snprintf(path, sizeof path, "%s/scene", folder);
    ck_assert_msg(rn_viewing_write(t->field, &viewing, path, &err) == RN_OK, "%s", err.text);
    ck_assert_msg(rn_field_load(engine, path, &field, &err) == RN_OK, "%s", err.text);
    ck_assert_mem_eq(rn_field_appearances(field), codes_of(t),
                     t->field->parameters.appearance_count * sizeof(float));
    struct rn_appearance first = rn_field_appearance(field, 0);
    ck_assert(first.own && !rn_field_appearance(field, c.dataset.frame_count).own);
    rn_field_destroy(&field);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    free(c.frames);
}
END_TEST

static void add(TCase *tests) {
    tcase_add_loop_test(tests, gradients_are_those_of_differences, 0, 2);
    tcase_add_test(tests, each_photograph_has_its_own_light);
    tcase_add_test(tests, like_light_is_left_alone);
    tcase_add_test(tests, codes_go_on_from_a_checkpoint);
    tcase_add_test(tests, a_scenes_file_keeps_the_codes);
}

int main(void) {
    return run_on_scene("appearance", add);
}
