// Photographs at several scales that average colour and opacity apart: what is wrong with them at
// edges is seen, put right for training, and done to the pictures that are compared with them.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/math/rng.h"
#include "server/engine/render/cones.h"
#include "tests/ops/train_scene.h"

static struct rn_dataset *straight;

// `scaled`, but for the way in which its scales are averaged.
static void read_straight(void) {
    struct rn_error err = {0};
    char target[128];
    struct rn_import_options import = {
        .scales = 3, .threads = 2, .downscale = RN_DOWNSCALE_STRAIGHT};
    snprintf(target, sizeof target, "%s/straight", folder);
    ck_assert(rn_remove_tree(target, &err) == RN_OK && rn_mkdirs(target, 0755, &err) == RN_OK);
    ck_assert_msg(rn_dataset_import(dataset, "straight", &import, target, NULL, NULL, NULL, &err) ==
                      RN_OK,
                  "%s", err.text);
    ck_assert_msg(rn_dataset_read(target, NULL, &straight, &err) == RN_OK, "%s", err.text);
}

static struct rn_effect_record effect(const struct rn_trainer *t) {
    return t->field->effects[RN_EFFECT_STRAIGHT_ALPHA];
}

// The largest difference of two trainings' pixels, transparent ones' colours aside.
static int difference(const struct rn_trainer *a, const struct rn_trainer *b) {
    int largest = 0;
    ck_assert_uint_eq(a->train.pixel_count, b->train.pixel_count);
    for (size_t i = 0; i < 4 * a->train.pixel_count; i++) {
        int alpha = a->train.rgba[i | 3], d = abs(a->train.rgba[i] - b->train.rgba[i]);
        if (i % 4 < 3 && alpha < 16) continue; // what a colour is rounded to hardly shows
        largest = d > largest ? d : largest;
    }
    return largest;
}

START_TEST(coarser_pixels_are_made_anew_from_the_finest) {
    read_straight();
    struct rn_train_config config = config_for(scaled);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *right = trainer_for(engine, scaled, &config);
    struct rn_trainer *wrong = trainer_for(engine, straight, &config);
    struct rn_trainer *single = trainer_for(engine, dataset, &config);
    printf("weighted: %.4f, straight: %.4f\n", effect(right).number, effect(wrong).number);
    ck_assert(!effect(right).on && effect(right).number < 0.6 / 255);
    ck_assert(effect(wrong).on && effect(wrong).number > 4.0 / 255);
    ck_assert(!effect(single).on && effect(single).number == 0);
    ck_assert_int_le(difference(right, wrong), 2); // two ways of rounding
    for (int given = 0; given < 2; given++) {
        struct rn_trainer *as_given;
        struct rn_train_config other = config_for(scaled);
        if (given) other.supersample = 0;
        if (!given) other.auto_effects = false;
        as_given = trainer_for(engine, straight, &other);
        ck_assert(!effect(as_given).on);
        ck_assert_int_gt(difference(as_given, right), 16);
        rn_trainer_destroy(&as_given);
    }
    rn_trainer_destroy(&right);
    rn_trainer_destroy(&wrong);
    rn_trainer_destroy(&single);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&straight);
}
END_TEST

// An interrupted training goes on with the pixels that it had.
START_TEST(a_resumed_training_has_the_same_pixels) {
    read_straight();
    struct rn_error err;
    struct rn_train_config config = config_for(straight);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, straight, &config), *again;
    char path[128];
    snprintf(path, sizeof path, "%s/straight.ripnerf", folder);
    ck_assert_msg(rn_trainer_save(t, path, &err) == RN_OK, "%s", err.text);
    ck_assert_msg(rn_trainer_restore(engine, straight, path, 0, &again, &err) == RN_OK, "%s",
                  err.text);
    ck_assert(effect(again).on);
    ck_assert_int_eq(difference(t, again), 0);
    rn_trainer_destroy(&t);
    rn_trainer_destroy(&again);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&straight);
}
END_TEST

// Cones of pixels that are whole or empty, as a photograph's are: the mean of straight colours
// times the mean opacity, over the background.
START_TEST(cones_are_averaged_as_the_photographs) {
    for (uint32_t n = 2; n <= 8; n *= 2) {
        struct rn_pixel cones[64];
        const float background[3] = {1, 0.5f, 0};
        double colour[3] = {0}, alpha = 0;
        for (uint32_t i = 0; i < n * n; i++) {
            struct rn_rng4 draw = rn_rng_draw(11, n, i);
            float a = i % 3 == 0 ? 0 : i % 3 == 1 ? 1 : 0.25f + 0.75f * rn_rng_unit(draw.v[3]);
            cones[i] = (struct rn_pixel){.alpha = a, .depth = 1};
            alpha += (double)a / (n * n);
            for (int c = 0; c < 3; c++) {
                float bare = rn_rng_unit(draw.v[c]);
                cones[i].rgb[c] = bare * a + (1 - a) * background[c];
                colour[c] += a > 0 ? (double)bare / (n * n) : 0;
            }
        }
        struct rn_pixel straight_mean = rn_cones_mean(cones, (int)n, background);
        struct rn_pixel mean = rn_cones_mean(cones, (int)n, NULL);
        double apart = 0;
        for (int c = 0; c < 3; c++) {
            double expected = colour[c] * alpha + (1 - alpha) * (double)background[c];
            ck_assert_double_eq_tol((double)straight_mean.rgb[c], expected, 3e-6);
            apart = fmax(apart, fabs((double)mean.rgb[c] - expected));
        }
        ck_assert_double_gt(apart, 0.02);
        ck_assert_float_eq(straight_mean.alpha, mean.alpha);
        ck_assert_float_eq(straight_mean.depth, mean.depth);
    }
}
END_TEST

// A haze that no photograph shows has next to no colour: it is not multiplied up to a full one.
START_TEST(haze_stays_faint) {
    struct rn_pixel cones[4];
    const float background[3] = {1, 1, 1};
    for (int i = 0; i < 4; i++)
        cones[i] = (struct rn_pixel){{0.99f, 0.99f, 0.99f}, 0.01f, 1}; // black, 1 % of it
    cones[0] = (struct rn_pixel){{1, 0, 0}, 1, 1};
    struct rn_pixel seen = rn_cones_mean(cones, 2, background);
    double alpha = 1.03 / 4;
    ck_assert_double_eq_tol((double)seen.alpha, alpha, 1e-6);
    ck_assert_double_eq_tol((double)seen.rgb[0], alpha * 0.25 + 1 - alpha, 1e-5);
    for (int c = 0; c < 3; c++)
        ck_assert(seen.rgb[c] >= 0 && seen.rgb[c] <= 1);
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, coarser_pixels_are_made_anew_from_the_finest);
    tcase_add_test(tests, a_resumed_training_has_the_same_pixels);
    tcase_add_test(tests, cones_are_averaged_as_the_photographs);
    tcase_add_test(tests, haze_stays_faint);
}

int main(void) {
    return run_on_scene("photographs at several scales", add);
}
