// What photographs show and the others do not: its formulas against plain ones in float64, and
// trainings on photographs with a card before the camera, elsewhere in each.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/base/file.h"
#include "common/math/rng.h"
#include "tests/ops/train_scene.h"

#define EFFECT RN_EFFECT_ROBUST_LOSS
enum { ACROSS = 13, DOWN = 9, BLOCKS = ACROSS * DOWN };

static float uniform(uint64_t i) {
    return 2 * rn_rng_unit(rn_rng_draw(5, 0, i).v[0]) - 1;
}

static double kept_median(float (*difference)[3], const uint8_t *known, int c) {
    for (int i = 0; i < BLOCKS; i++) {
        int below = 0, same = 0, all = 0;
        for (int j = 0; j < BLOCKS; j++) {
            all += known[j];
            below += known[j] && difference[j][c] < difference[i][c];
            same += known[j] && difference[j][c] == difference[i][c];
        }
        if (known[i] && below <= all / 2 && below + same > all / 2) return difference[i][c];
    }
    return 0;
}

static double plain_size(float (*difference)[3], const uint8_t *known, int x, int y,
                         const double middle[3]) {
    double sum[3] = {0}, squares = 0;
    int count = 0;
    for (int b = 0; b < BLOCKS; b++) {
        if (abs(b % ACROSS - x) > 1 || abs(b / ACROSS - y) > 1 || !known[b]) continue;
        for (int c = 0; c < 3; c++)
            sum[c] += (double)difference[b][c] - middle[c];
        count++;
    }
    for (int c = 0; c < 3 && count > 0; c++)
        squares += pow(sum[c] / count, 2);
    return sqrt(squares / 3);
}

START_TEST(sizes_are_those_of_float64) {
    float difference[BLOCKS][3], size[BLOCKS];
    uint8_t known[BLOCKS];
    struct rn_error err;
    double worst = 0;
    for (int round = 0; round < 50; round++) {
        double middle[3];
        for (int b = 0; b < BLOCKS; b++) {
            known[b] = uniform((uint64_t)(4 * (round * BLOCKS + b))) > -0.6f;
            for (int c = 0; c < 3; c++)
                difference[b][c] = uniform((uint64_t)(4 * (round * BLOCKS + b) + c + 1));
        }
        ck_assert(rn_outlier_sizes(difference[0], known, ACROSS, DOWN, size, &err) == RN_OK);
        for (int c = 0; c < 3; c++)
            middle[c] = kept_median(difference, known, c);
        for (int b = 0; b < BLOCKS; b++)
            worst = fmax(worst, fabs((double)size[b] - plain_size(difference, known, b % ACROSS,
                                                                  b / ACROSS, middle)));
    }
    printf("sizes off by %.3g of a colour at most\n", worst);
    ck_assert_double_lt(worst, 4e-7);
}
END_TEST

// A photograph that is lighter all over has no outliers, a thing in it is one with its rim, and
// what changes its sign from block to block is none.
START_TEST(a_thing_is_told_from_detail_and_light) {
    float difference[BLOCKS][3], size[BLOCKS];
    uint8_t known[BLOCKS], large[BLOCKS], out[BLOCKS];
    struct rn_error err;
    for (int b = 0; b < BLOCKS; b++) {
        int x = b % ACROSS, y = b / ACROSS;
        bool thing = x >= 2 && x <= 4 && y >= 3 && y <= 5, detail = x >= 8;
        known[b] = 1;
        for (int c = 0; c < 3; c++)
            difference[b][c] =
                0.2f + (thing ? 0.3f : 0) + (detail ? (x + y) % 2 ? 0.3f : -0.3f : 0);
    }
    ck_assert(rn_outlier_sizes(difference[0], known, ACROSS, DOWN, size, &err) == RN_OK);
    for (int b = 0; b < BLOCKS; b++)
        large[b] = size[b] > 0.1f;
    rn_outlier_trim(large, ACROSS, DOWN, out);
    for (int b = 0; b < BLOCKS; b++) {
        int x = b % ACROSS, y = b / ACROSS;
        if (x >= 2 && x <= 4 && y >= 3 && y <= 5)
            ck_assert_msg(out[b], "block %d %d of the thing is in", x, y);
        if (x > 6) ck_assert_msg(!out[b], "block %d %d of the detail is out", x, y);
    }
}
END_TEST

// ---- trainings --------------------------------------------------------------------------------

enum { SIDE = 30 }; // pixels, of what is held before the camera

// Where the card of a photograph is held: which of its pixels is the first.
static void card_of(const struct rn_frame *frame, int *ret_left, int *ret_top,
                    uint32_t *ret_colour) {
    struct rn_rng4 draw = rn_rng_draw(9, 0, (uint64_t)frame->photo);
    *ret_left = (int)rn_rng_below(draw.v[0], (uint32_t)(frame->camera.width - SIDE));
    *ret_top = (int)rn_rng_below(draw.v[1], (uint32_t)(frame->camera.height - SIDE));
    *ret_colour = draw.v[2];
}

// Whether a block meets it, or lies beside it.
static bool is_card(const struct rn_frame *frame, int x, int y) {
    int left, top;
    uint32_t colour;
    card_of(frame, &left, &top, &colour);
    return x > left - 2 * RN_OUTLIER_BLOCK && x < left + SIDE + RN_OUTLIER_BLOCK &&
           y > top - 2 * RN_OUTLIER_BLOCK && y < top + SIDE + RN_OUTLIER_BLOCK;
}

// A card of another colour, somewhere else in each training photograph.
static void hold_cards(const struct rn_dataset *d) {
    struct rn_error err;
    for (size_t f = 0; f < d->frame_count; f++) {
        struct rn_image image;
        int left, top;
        uint32_t colour;
        if (d->frames[f].split == RN_SPLIT_TEST) continue;
        ck_assert(rn_image_read(d->frames[f].path, &rn_image_default_limits, &image, &err) ==
                  RN_OK);
        card_of(&d->frames[f], &left, &top, &colour);
        for (int i = 0; i < SIDE * SIDE; i++)
            for (int c = 0; c < 3; c++)
                image.pixels[4 * ((top + i / SIDE) * image.width + left + i % SIDE) + c] =
                    (uint8_t)(colour >> 8 * c);
        ck_assert(rn_image_write_png(&image, d->frames[f].path, 3, &err) == RN_OK);
        rn_image_finish(&image);
    }
}

static struct rn_dataset *place(const char *name, int views, bool cards) {
    struct rn_synth_options synth = {
        .size = 96, .views = views, .threads = 2, .samples = 4, .capture = true};
    struct rn_import_options import = {.scales = 1, .threads = 2, .test_every = 8};
    struct rn_error err = {0};
    struct rn_dataset *source, *made;
    char made_at[128], kept_at[128];
    snprintf(made_at, sizeof made_at, "%s/%s", folder, name);
    snprintf(kept_at, sizeof kept_at, "%s/%s-kept", folder, name);
    ck_assert(rn_mkdirs(made_at, 0755, &err) == RN_OK && rn_mkdirs(kept_at, 0755, &err) == RN_OK);
    ck_assert_msg(rn_synthesise("place", &synth, made_at, NULL, NULL, &err) == RN_OK, "%s",
                  err.text);
    ck_assert_msg(rn_dataset_read(made_at, NULL, &source, &err) == RN_OK, "%s", err.text);
    ck_assert_msg(rn_dataset_import(source, name, &import, kept_at, NULL, NULL, NULL, &err) ==
                      RN_OK,
                  "%s", err.text);
    ck_assert_msg(rn_dataset_read(kept_at, NULL, &made, &err) == RN_OK, "%s", err.text);
    rn_dataset_destroy(&source);
    if (cards) hold_cards(made);
    return made;
}

static struct rn_train_config config_of(const struct rn_dataset *d, enum rn_effect_choice choice) {
    struct rn_train_config config = config_for(d);
    config.max_steps = 400;
    config.field.base = 64;
    config.grow_to = 128;
    config.target_samples = 16384;
    config.effect[EFFECT] = choice;
    config.effect[RN_EFFECT_POSE_REFINEMENT] = RN_EFFECT_UNWANTED;
    return config;
}

static struct rn_trainer *train_with(struct rn_engine *engine, const struct rn_dataset *d,
                                     enum rn_effect_choice choice) {
    struct rn_train_config config = config_of(d, choice);
    struct rn_trainer *t = trainer_for(engine, d, &config);
    t->outliers.affords = INFINITY; // every pass, of all photographs
    run_to_end(t);
    return t;
}

// The test views, before which nothing is held.
static double test_psnr(struct rn_trainer *t, const struct rn_dataset *d) {
    double sum = 0;
    int views = 0;
    struct rn_error err;
    for (size_t i = 0; i < d->frame_count; i++) {
        struct rn_render_options options = {.settings = {.supersample = 1}};
        struct rn_view_score score;
        if (d->frames[i].split != RN_SPLIT_TEST) continue;
        ck_assert(rn_evaluate_view(t->engine, t->field, &d->frames[i], &options, NULL, NULL, &score,
                                   &err) == RN_OK);
        sum += score.psnr;
        views++;
    }
    return sum / views;
}

START_TEST(what_one_photograph_shows_is_left_out) {
    struct rn_dataset *d = place("cards", 40, true);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = train_with(engine, d, RN_EFFECT_AUTO);
    const struct rn_effect_record *r = &t->field->effects[EFFECT];
    int out = 0, of_cards = 0;
    for (int f = 0; f < t->train.frame_count; f++) {
        const struct rn_pixel_frame *frame = &t->train.frames[f];
        for (int y = 0; y < frame->camera.height; y += RN_OUTLIER_BLOCK)
            for (int x = 0; x < frame->camera.width; x += RN_OUTLIER_BLOCK) {
                bool is_out = rn_trainer_is_outlier(t, frame, x, y);
                out += is_out;
                of_cards += is_out && is_card(frame->frame, x, y);
            }
    }
    printf("cards: %d of %d blocks that are left out are theirs; %s\n", of_cards, out, r->reason);
    ck_assert_msg(r->on && r->decided && r->number > r->threshold, "%s", r->reason);
    ck_assert_int_gt(out, 40);
    ck_assert_int_gt(10 * of_cards, 7 * out);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&d);
}
END_TEST

// Where all photographs are more than a pass looks at, they take turns.
START_TEST(many_photographs_take_turns) {
    struct rn_dataset *d = place("many", 80, true);
    struct rn_engine *engine = engine_with(2);
    struct rn_train_config config = config_of(d, RN_EFFECT_WANTED);
    struct rn_trainer *t = trainer_for(engine, d, &config);
    int out[2][2] = {{0}}; // after the first turn, in the end; of photographs 0, 2, .. and 1, 3, ..
    t->outliers.most = 1;
    for (int when = 0; when < 2; when++) {
        while (!t->progress.done && (when || !t->outliers.turns))
            ck_assert(rn_trainer_advance(t, 0, NULL) == RN_OK);
        for (size_t f = 0, b = 0; b < t->outliers.count; b++) {
            while ((int)f + 1 < t->train.frame_count && b >= t->outliers.first[f + 1])
                f++;
            out[when][f % 2] += t->outliers.out[b];
        }
    }
    printf("turns: %d and %d blocks out, then %d and %d\n", out[0][0], out[0][1], out[1][0],
           out[1][1]);
    ck_assert_int_gt(out[0][0], 10);
    ck_assert_int_eq(out[0][1], 0);
    ck_assert_int_gt(out[1][0], 20);
    ck_assert_int_gt(out[1][1], 20);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&d);
}
END_TEST

// What is looked at is a part of what is trained on, and one turn where that is too little for any.
START_TEST(short_trainings_have_few_turns) {
    static const double affords[] = {1, 0.2, 0, 0.01}; // 0: as by default
    struct rn_dataset *d = place("short", 40, true);
    struct rn_engine *engine = engine_with(2);
    int turns[4];
    for (int run = 0; run < 4; run++) {
        struct rn_train_config config = config_of(d, RN_EFFECT_AUTO);
        struct rn_trainer *t = trainer_for(engine, d, &config);
        t->outliers.affords = affords[run];
        run_to_end(t);
        double looks = 2.0 * (turns[run] = t->outliers.turns) * (double)t->outliers.count;
        printf("%d turns: %.3f of the rays\n", turns[run], looks / (double)t->progress.rays);
        ck_assert(looks < t->outliers.affords * (double)t->progress.rays || turns[run] == 1);
        rn_trainer_destroy(&t);
    }
    ck_assert(turns[0] > turns[1] && turns[1] > turns[2]);
    ck_assert(turns[2] >= turns[3] && turns[3] == 1);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&d);
}
END_TEST

START_TEST(a_place_that_holds_still_is_left_alone) {
    struct rn_dataset *d = place("still", 40, false);
    struct rn_engine *engine = engine_with(2);
    char hash[2][65];
    for (int run = 0; run < 2; run++) {
        struct rn_trainer *t = train_with(engine, d, run ? RN_EFFECT_AUTO : RN_EFFECT_UNWANTED);
        const struct rn_effect_record *r = &t->field->effects[EFFECT];
        printf("still: %.2f dB; %s\n", test_psnr(t, d), r->reason);
        ck_assert_msg(!r->on && r->decided, "%s", r->reason);
        ck_assert_int_eq(isfinite(r->number), run);
        // Of what is not learned yet little is taken for what moves.
        if (run) ck_assert_double_lt(r->number, 0.5 * r->threshold);
        rn_field_sha256(t->field, hash[run]);
        rn_trainer_destroy(&t);
    }
    ck_assert_str_eq(hash[0], hash[1]);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&d);
}
END_TEST

// Early in a short training most of what photographs differ by is not learned yet, whatever the
// seed.
START_TEST(what_is_not_learned_yet_is_no_outlier) {
    struct rn_dataset *d = place("early", 40, false);
    struct rn_engine *engine = engine_with(2);
    double mean = 0;
    for (uint64_t seed = 1; seed <= 3; seed++) {
        struct rn_train_config config = config_of(d, RN_EFFECT_AUTO);
        config.max_steps = 200;
        config.seed = seed;
        struct rn_trainer *t = trainer_for(engine, d, &config);
        t->outliers.affords = INFINITY;
        while (!t->outliers.share_known)
            ck_assert(rn_trainer_advance(t, 0, NULL) == RN_OK);
        mean += t->outliers.share / 3;
        rn_trainer_destroy(&t);
    }
    printf("early: %.3f %% of the pixels\n", 100 * mean);
    ck_assert_double_lt(mean, 0.0005);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&d);
}
END_TEST

static void look_at_what_is_left_out(const struct rn_trainer *t, bool restored) {
    size_t out = 0;
    if (!restored) {
        ck_assert_int_gt(t->outliers.turns, 5);
        return;
    }
    for (size_t i = 0; i < t->outliers.count; i++)
        out += t->outliers.out[i];
    ck_assert_uint_gt(out, 0);
}

START_TEST(what_is_left_out_goes_on_from_a_checkpoint) {
    struct rn_dataset *d = place("kept", 40, true);
    struct rn_train_config config = config_of(d, RN_EFFECT_WANTED);
    config.max_steps = 150;
    check_goes_on(d, &config, look_at_what_is_left_out);
    rn_dataset_destroy(&d);
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, sizes_are_those_of_float64);
    tcase_add_test(tests, a_thing_is_told_from_detail_and_light);
    tcase_add_test(tests, what_one_photograph_shows_is_left_out);
    tcase_add_test(tests, many_photographs_take_turns);
    tcase_add_test(tests, short_trainings_have_few_turns);
    tcase_add_test(tests, a_place_that_holds_still_is_left_alone);
    tcase_add_test(tests, what_is_not_learned_yet_is_no_outlier);
    tcase_add_test(tests, what_is_left_out_goes_on_from_a_checkpoint);
}

int main(void) {
    return run_on_scene("outliers", add);
}
