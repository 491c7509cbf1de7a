// Effects that are asked for, or switched off, whatever the data calls for.
#include <math.h>
#include <string.h>

#include "server/engine/effects/about.h"
#include "tests/ops/train_scene.h"
#include "tests/support/suite.h"

// What a scene of small photographs that alpha cuts out can have, at three scales.
static const enum rn_effect possible[] = {RN_EFFECT_BACKGROUND,   RN_EFFECT_SCALE_PYRAMID,
                                          RN_EFFECT_ANISOTROPY,   RN_EFFECT_VIEW_DEPENDENCE,
                                          RN_EFFECT_SPLIT_PIXELS, RN_EFFECT_CONES,
                                          RN_EFFECT_UNBOUNDED,    RN_EFFECT_DOWNSCALING,
                                          RN_EFFECT_ROBUST_LOSS,  RN_EFFECT_APPEARANCE};

static bool is_possible(int effect) {
    for (size_t i = 0; i < sizeof possible / sizeof *possible; i++)
        if ((int)possible[i] == effect) return true;
    return false;
}

static bool ends_with(const char *text, const char *end) {
    size_t length = strlen(text), size = strlen(end);
    return length >= size && strcmp(text + length - size, end) == 0;
}

// Every effect but those that it rests on as the data has it.
static struct rn_trainer *with(struct rn_engine *engine, int effect, enum rn_effect_choice choice) {
    struct rn_train_config config = config_for(scaled);
    config.split_pixels = 0.1;
    config.field.footprint = RN_FOOTPRINT_RIP;
    config.effect[RN_EFFECT_SCALE_PYRAMID] = RN_EFFECT_WANTED; // which anisotropy needs
    config.effect[effect] = choice;
    return trainer_for(engine, scaled, &config);
}

// Each effect with that choice: whether it is on, and how its reason ends.
static void check_each(enum rn_effect_choice choice) {
    struct rn_engine *engine = engine_with(2);
    for (int i = 0; i < RN_EFFECT_COUNT; i++) {
        bool on = choice == RN_EFFECT_WANTED && is_possible(i);
        struct rn_trainer *t = with(engine, i, choice);
        run_to_end(t);
        const struct rn_effect_record *r = &rn_trainer_field(t)->effects[i];
        const char *end = choice == RN_EFFECT_UNWANTED ? "; switched off as asked"
                          : on                         ? "; on as asked"
                                                       : "; asked for, but it cannot be";
        ck_assert_msg(r->decided && r->on == on, "%s: %s", r->name, r->reason);
        ck_assert_msg(ends_with(r->reason, end), "%s: %s", r->name, r->reason);
        ck_assert_msg(held_out_psnr(t) > 10, "%s: %.1f dB", r->name, held_out_psnr(t));
        rn_trainer_destroy(&t);
    }
    rn_engine_destroy(&engine);
}

START_TEST(what_is_off_stays_off) {
    check_each(RN_EFFECT_UNWANTED);
}
END_TEST

START_TEST(what_is_asked_for_is_on_where_it_can_be) {
    check_each(RN_EFFECT_WANTED);
}
END_TEST

// The inner ball of unbounded space of cameras that lie as `kind` says.
static struct rn_bounds inner_ball(struct rn_engine *engine, enum rn_capture_kind kind) {
    struct rn_dataset place = *scaled;
    place.lie.kind = kind;
    place.bounds.source = RN_BOUNDS_CAMERAS;
    struct rn_train_config config = config_for(&place);
    config.effect[RN_EFFECT_UNBOUNDED] = RN_EFFECT_WANTED;
    struct rn_trainer *t = trainer_for(engine, &place, &config);
    struct rn_bounds bounds = rn_trainer_field(t)->bounds;
    rn_trainer_destroy(&t);
    return bounds;
}

static size_t cameras_within(const struct rn_bounds *bounds) {
    size_t count = 0;
    for (size_t f = 0; f < scaled->frame_count; f++)
        count += rn_camera_distance(&scaled->frames[f].camera, bounds->centre) < bounds->radius;
    return count;
}

// Cameras that look around from within are within; those that look at something are without.
START_TEST(a_room_holds_its_cameras) {
    struct rn_engine *engine = engine_with(1);
    struct rn_bounds room = inner_ball(engine, RN_CAPTURE_ROOM);
    struct rn_bounds outdoor = inner_ball(engine, RN_CAPTURE_OUTDOOR);
    ck_assert_uint_eq(cameras_within(&room), scaled->frame_count);
    ck_assert_uint_eq(cameras_within(&outdoor), 0);
    rn_engine_destroy(&engine);
}
END_TEST

// What the configuration makes of it: the network sees no direction, pictures have one cone a
// pixel, planes one level.
START_TEST(what_is_off_is_not_computed) {
    struct rn_engine *engine = engine_with(1);
    struct rn_train_config config = config_for(scaled);
    config.effect[RN_EFFECT_VIEW_DEPENDENCE] = config.effect[RN_EFFECT_CONES] =
        config.effect[RN_EFFECT_BACKGROUND] = RN_EFFECT_UNWANTED;
    struct rn_trainer *t = trainer_for(engine, scaled, &config);
    const struct rn_train_config *own = &rn_trainer_field(t)->config;
    ck_assert(!own->field.view_dependence && !own->supersample && !own->carve);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// A ratio says what is counted, and what it is called where all are alike: no "1 times".
START_TEST(ratios_say_what_is_counted) {
    static const struct {
        enum rn_effect effect;
        double number;
        const char *text;
    } told[] = {{RN_EFFECT_SCALE_PYRAMID, 3, "8 times the finest footprint"},
                {RN_EFFECT_SCALE_PYRAMID, 10, "1.02e+03 times the finest footprint"},
                {RN_EFFECT_SCALE_PYRAMID, 0, "all footprints alike"},
                {RN_EFFECT_SPLIT_PIXELS, 0.001, "all footprints alike"},
                {RN_EFFECT_CONES, 0, "all cones alike"},
                {RN_EFFECT_ANISOTROPY, 1, "2 times as long as wide"},
                {RN_EFFECT_BACKGROUND, 0.01, "1 %"},
                {RN_EFFECT_CONES, NAN, ""}};
    char text[48];
    for (size_t i = 0; i < sizeof told / sizeof *told; i++) {
        rn_effect_text(told[i].effect, told[i].number, text, sizeof text);
        ck_assert_str_eq(text, told[i].text);
    }
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, what_is_off_stays_off);
    tcase_add_test(tests, what_is_asked_for_is_on_where_it_can_be);
    tcase_add_test(tests, what_is_off_is_not_computed);
    tcase_add_test(tests, ratios_say_what_is_counted);
    tcase_add_test(tests, a_room_holds_its_cameras);
}

int main(void) {
    return run_on_scene("choices of effects", add);
}
