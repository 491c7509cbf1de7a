// Which photographs tell the progress, and those that are withheld for it until they are given
// back.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/train/withheld.h"
#include "tests/ops/train_scene.h"

// Where there are no validation views, test views tell the progress and every training view is
// trained on.
START_TEST(nothing_is_withheld_where_there_are_test_views) {
    struct rn_train_config config = config_for(dataset);
    struct rn_engine *engine = engine_with(1);
    struct rn_dataset split = *dataset;
    split.frame_count = 24;
    split.frames = calloc(split.frame_count, sizeof *split.frames);
    ck_assert_ptr_nonnull(split.frames);
    memset(split.view_count, 0, sizeof split.view_count);
    for (int f = 0; f < 24; f++) {
        split.frames[f] = dataset->frames[0];
        split.frames[f].split = f < 20 ? RN_SPLIT_TRAIN : RN_SPLIT_TEST;
        split.frames[f].index = split.view_count[split.frames[f].split]++;
    }
    struct rn_trainer *trainer = trainer_for(engine, &split, &config);
    ck_assert_str_eq(rn_trainer_held_out(trainer), "4 evenly spaced views of 4 test views");
    ck_assert_int_eq(trainer->train.frame_count, 20);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
    free(split.frames);
}
END_TEST

// Of few training views one of eight, of many about sixteen in all: a round over them does not
// grow.
START_TEST(few_of_many_views_are_withheld) {
    static const struct {
        int views;
        const char *told;
    } cases[] = {{16, "2 training views (one of 8) withheld"},
                 {143, "17 training views (one of 8) withheld"},
                 {300, "16 training views (one of 18) withheld"}};
    struct rn_engine *engine = engine_with(1);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct rn_train_config config = config_for(dataset);
        struct rn_dataset many = *dataset;
        many.frame_count = (size_t)cases[i].views;
        many.frames = calloc(many.frame_count, sizeof *many.frames);
        for (int f = 0; f < cases[i].views; f++) {
            many.frames[f] = dataset->frames[0];
            many.frames[f].split = RN_SPLIT_TRAIN;
            many.frames[f].index = f;
        }
        memset(many.view_count, 0, sizeof many.view_count);
        many.view_count[RN_SPLIT_TRAIN] = cases[i].views;
        struct rn_trainer *trainer = trainer_for(engine, &many, &config);
        const char *held = rn_trainer_held_out(trainer);
        ck_assert_msg(strncmp(held, cases[i].told, strlen(cases[i].told)) == 0, "%s", held);
        rn_trainer_destroy(&trainer);
        free(many.frames);
    }
    rn_engine_destroy(&engine);
}
END_TEST

// ---- given back -----------------------------------------------------------------------------

// The sphere's photographs as a folder without any split has them.
static struct rn_dataset without_splits(void) {
    struct rn_dataset all = *dataset;
    all.frames = calloc(dataset->frame_count, sizeof *all.frames);
    ck_assert_ptr_nonnull(all.frames);
    memset(all.view_count, 0, sizeof all.view_count);
    all.frame_count = 0;
    for (size_t f = 0; f < dataset->frame_count; f++) {
        struct rn_frame *frame = &all.frames[all.frame_count++];
        *frame = dataset->frames[f];
        frame->split = RN_SPLIT_TRAIN;
        frame->index = all.view_count[RN_SPLIT_TRAIN]++;
    }
    return all;
}

static bool draws_from_withheld(const struct rn_trainer *t) {
    for (size_t i = 0; i < t->sampler.live_count; i++)
        if (t->train.frames[rn_trainer_live(t, i).frame].frame->index % 8 == 7) return true;
    return false;
}

// Seen with each step: whether rays are drawn from them, and which figures there are.
START_TEST(withheld_photographs_are_given_back) {
    struct rn_error err;
    struct rn_dataset all = without_splits();
    struct rn_train_config config = config_for(dataset);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, &all, &config);
    int offered = 0, views = (int)all.frame_count;
    ck_assert_double_eq(config.give_back, 0.5);
    ck_assert_int_eq(t->train.frame_count, views);
    ck_assert_int_eq(t->held.frame_count, views / 8);
    ck_assert(strstr(rn_trainer_held_out(t), "withheld from training so far"));
    for (bool back = false; !done(t);) {
        bool last = rn_trainer_figure(t) == RN_FIGURE_LAST;
        offered += last;
        if (last) ck_assert_int_eq(t->progress.step, config.max_steps / 2);
        if (last || t->progress.step == 10) ck_assert(isfinite(held_out_psnr(t)));
        ck_assert(draws_from_withheld(t) == back);
        ck_assert((rn_trainer_figure(t) == RN_FIGURE_NONE) == back);
        // Cells that no other photograph sees are empty only once these have looked at them.
        ck_assert(rn_trainer_seen_round(t).all_looked == (back && t->progress.step >= 30));
        ck_assert(rn_trainer_advance(t, 0, &err) == RN_OK);
        back = t->progress.given_back > 0;
        if (!back) ck_assert_int_le(t->progress.step, config.max_steps / 2);
    }
    ck_assert_int_eq(offered, 1);
    ck_assert_int_eq(t->progress.given_back, config.max_steps / 2);
    double before = t->progress.psnr;
    ck_assert_double_eq(held_out_psnr(t), before); // nothing is left to measure by
    ck_assert_int_eq(t->progress.psnr_step, config.max_steps / 2);
    ck_assert(strstr(rn_trainer_held_out(t), "withheld from training until step 25 and trained on"
                                             " since (the figure is of before)"));
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    free(all.frames);
}
END_TEST

static void look_at_given_back(const struct rn_trainer *t, bool restored) {
    int64_t at = t->field->config.give_back == 0.3 ? 15 : 25;
    if (restored && at == 25) return; // before or after the turn of that step
    ck_assert_int_eq(t->progress.given_back, at);
    ck_assert(draws_from_withheld(t));
    ck_assert(rn_trainer_figure(t) == RN_FIGURE_NONE);
}

// Before a checkpoint and at it; rays evenly, and by errors, which begin anew then.
START_TEST(a_training_goes_on_from_before_and_after) {
    static const double shares[] = {0.5, 0.3, 0.3};
    struct rn_dataset all = without_splits();
    for (int i = 0; i < 3; i++) {
        struct rn_train_config config = config_for(dataset);
        config.give_back = shares[i];
        config.draw_by_error = i == 2;
        check_goes_on(&all, &config, look_at_given_back);
    }
    free(all.frames);
}
END_TEST

// Until they are given back they leave nothing in the training: it is the one that never has them.
START_TEST(withheld_photographs_leave_nothing) {
    char hash[2][65];
    struct rn_error err;
    struct rn_dataset all = without_splits();
    for (int i = 0; i < 2; i++) {
        struct rn_train_config config = config_for(dataset);
        config.give_back = i ? 0.9 : 0;
        struct rn_engine *engine = engine_with(2);
        struct rn_trainer *t = trainer_for(engine, &all, &config);
        int views = (int)all.frame_count;
        ck_assert_int_eq(t->train.frame_count, i ? views : views - views / 8);
        while (t->progress.step < 40)
            ck_assert(rn_trainer_advance(t, 0, &err) == RN_OK);
        rn_field_sha256(t->field, hash[i]);
        rn_trainer_destroy(&t);
        rn_engine_destroy(&engine);
    }
    ck_assert_str_eq(hash[0], hash[1]);
    free(all.frames);
}
END_TEST

// An end by a PSNR needs the figure to the last; by a plateau, until it is found.
START_TEST(ends_by_a_figure_have_it) {
    static const struct {
        double share, psnr;
        bool until_plateau, plateau;
        double done;
        bool back;
    } cases[] = {{0.5, 0, false, false, 0.49, false}, {0.5, 0, false, false, 0.5, true},
                 {0, 0, false, false, 1, false},      {0.5, 40, false, false, 0.9, false},
                 {0.5, 0, true, false, 0.9, false},   {0.5, 0, true, true, 0.4, true}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct rn_train_config config;
        union rn_setting_value values[RN_TRAIN_SETTINGS];
        for (size_t row = 0; row < RN_TRAIN_SETTINGS; row++)
            values[row] = rn_setting_absent(&rn_train_settings.rows[row]);
        ck_assert(rn_preset("standard", false, &config, NULL) == RN_OK);
        config.give_back = cases[i].share;
        config.until_psnr = cases[i].psnr;
        config.until_plateau = cases[i].until_plateau;
        rn_train_config_choose(&config, values);
        config.max_seconds = 0;
        config.max_steps = 1000;
        struct rn_progress p = {.step = (int64_t)(1000 * cases[i].done),
                                .plateau = cases[i].plateau};
        ck_assert_msg(rn_schedule_gives_back(&config, &p) == cases[i].back, "case %zu", i);
        config.max_steps = 0; // without a limit
        if (!cases[i].plateau) ck_assert(!rn_schedule_gives_back(&config, &p));
    }
}
END_TEST

static void add_tests(TCase *tests) {
    tcase_add_test(tests, few_of_many_views_are_withheld);
    tcase_add_test(tests, nothing_is_withheld_where_there_are_test_views);
    tcase_add_test(tests, withheld_photographs_are_given_back);
    tcase_add_test(tests, a_training_goes_on_from_before_and_after);
    tcase_add_test(tests, withheld_photographs_leave_nothing);
    tcase_add_test(tests, ends_by_a_figure_have_it);
}

int main(void) {
    return run_on_scene("withheld photographs", add_tests);
}
