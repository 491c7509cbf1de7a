// Which trainings a text of settings and values asks for.
#include <stdio.h>
#include <string.h>

#include "common/settings/ladder.h"
#include "tests/support/suite.h"

static void absent(union rn_setting_value *values) {
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++)
        values[i] = rn_setting_absent(&rn_train_settings.rows[i]);
}

static enum rn_status plan(const char *over, enum rn_ladder_equal equal, enum rn_preset_name preset,
                           struct rn_ladder_plan *ret_plan, struct rn_error *err) {
    union rn_setting_value options[RN_TRAIN_SETTINGS];
    absent(options);
    return rn_ladder_plan(over, equal, preset, options, ret_plan, err);
}

static const union rn_setting_value *value(const struct rn_ladder_plan *p, size_t arm,
                                           const char *name) {
    return rn_settings_value(&rn_train_settings, p->arms[arm].values, name);
}

START_TEST(every_value_meets_every_other) {
    struct rn_ladder_plan p;
    struct rn_error err;
    ck_assert_int_eq(plan(" planes=3,10  footprint=rip,mip + planes=10 footprint=mip\tbase=64",
                          RN_LADDER_EQUAL_TIME, RN_PRESET_STANDARD, &p, &err),
                     RN_OK);
    ck_assert_uint_eq(p.count, 5);
    ck_assert_str_eq(p.arms[0].label, "planes=3 footprint=rip");
    ck_assert_str_eq(p.arms[3].label, "planes=10 footprint=mip");
    ck_assert_str_eq(p.arms[4].label, "planes=10 footprint=mip base=64");
    ck_assert_int_eq(value(&p, 3, "planes")->whole, 10);
    ck_assert_int_eq(value(&p, 3, "footprint")->choice, RN_FOOTPRINT_MIP);
    ck_assert(
        rn_setting_is_absent(rn_settings_find(&rn_train_settings, "base"), value(&p, 3, "base")));
    ck_assert_int_eq(value(&p, 4, "base")->whole, 64);
    rn_ladder_plan_finish(&p);
}
END_TEST

// A name may be a record's, a request's or a command line's, and the same arm is there once.
START_TEST(names_and_repetitions) {
    struct rn_ladder_plan p;
    struct rn_error err;
    ck_assert_int_eq(plan("max_seconds=5 + max_time_s=5 + max-time=5", RN_LADDER_EQUAL_SIZE,
                          RN_PRESET_STANDARD, &p, &err),
                     RN_OK);
    ck_assert_uint_eq(p.count, 1);
    ck_assert_str_eq(p.arms[0].label, "max_time_s=5");
    rn_ladder_plan_finish(&p);
}
END_TEST

// Texels of all planes as many as the preset's, to within half a texel of the side; bases that grow
// are multiples of 8.
START_TEST(sizes_are_equal) {
    static const int planes[] = {3, 4, 6, 10}, paper[] = {935, 810, 661, 512},
                     standard[] = {512, 440, 360, 280};
    for (int preset = 0; preset < 2; preset++) {
        struct rn_ladder_plan p;
        struct rn_error err;
        ck_assert_int_eq(plan("planes=3,4,6,10", RN_LADDER_EQUAL_SIZE,
                              preset ? RN_PRESET_PAPER : RN_PRESET_STANDARD, &p, &err),
                         RN_OK);
        for (size_t i = 0; i < 4; i++) {
            ck_assert_int_eq(value(&p, i, "planes")->whole, planes[i]);
            ck_assert_int_eq(value(&p, i, "base")->whole, preset ? paper[i] : standard[i]);
        }
        rn_ladder_plan_finish(&p);
    }
}
END_TEST

START_TEST(there_are_bounds) {
    char text[RN_LADDER_TEXT] = "base=2";
    struct rn_ladder_plan p;
    struct rn_error err;
    for (int i = 3; i < 34; i++)
        snprintf(text + strlen(text), sizeof text - strlen(text), ",%d", i);
    ck_assert_int_eq(plan(text, RN_LADDER_EQUAL_TIME, RN_PRESET_DRAFT, &p, &err), RN_OK);
    rn_ladder_plan_finish(&p);
    strcat(text, ",34");
    ck_assert_int_eq(plan(text, RN_LADDER_EQUAL_TIME, RN_PRESET_DRAFT, &p, &err), RN_ERROR_LIMIT);
    strcpy(strrchr(text, ','), " planes=3,4,6");
    ck_assert_int_eq(plan(text, RN_LADDER_EQUAL_TIME, RN_PRESET_DRAFT, &p, &err), RN_ERROR_LIMIT);
    ck_assert_ptr_nonnull(strstr(err.text, "64 arms"));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("ladder");
    TCase *tcase = tcase_create("plan");
    tcase_add_test(tcase, every_value_meets_every_other);
    tcase_add_test(tcase, names_and_repetitions);
    tcase_add_test(tcase, sizes_are_equal);
    tcase_add_test(tcase, there_are_bounds);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
