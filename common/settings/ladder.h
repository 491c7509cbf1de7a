// Ladders: which trainings a text of settings and values asks for.
//
//   planes=3,4 footprint=rip,mip          every value with every other: four arms
//   planes=3,10 + planes=10 footprint=mip  two such tables, joined: three arms
//
// A name is that of a row of rn_train_settings, as requests (max_time_s), command lines (max-time)
// or records (max_seconds) have it; a value is written as on a command line.
#ifndef RN_COMMON_SETTINGS_LADDER_H
#define RN_COMMON_SETTINGS_LADDER_H

#include "common/settings/train.h"

#define RN_LADDER_TEXT 2048     // bytes of such a text, with its NUL
#define RN_LADDER_ARMS 64       // at most
#define RN_LADDER_TRAININGS 256 // of all arms and seeds together, at most

// What the trainings of a ladder have in common beside their options.
enum rn_ladder_equal {
    RN_LADDER_EQUAL_TIME,
    RN_LADDER_EQUAL_STEPS,
    RN_LADDER_EQUAL_SIZE, // texels of the planes, by the side of their base grids
};
extern const char *const rn_ladder_equal_names[]; // "time", "steps", "size"

struct rn_ladder_arm {
    char label[160]; // "planes=3 footprint=rip"
    union rn_setting_value values[RN_TRAIN_SETTINGS];
};
// Owner: whoever made it; rn_ladder_plan_finish.
struct rn_ladder_plan {
    struct rn_ladder_arm *arms;
    size_t count;
};

// The arms that `over` asks for, in its order, each once, on top of `options` of a preset, which
// they take with them. With equal size each arm's base grid is as large as makes its planes' texels
// as many as those of `options` alone. RN_ERROR_INVALID says what of the text is wrong,
// RN_ERROR_LIMIT that there are more than RN_LADDER_ARMS; err->where is "over" or an option's name.
enum rn_status rn_ladder_plan(const char *over, enum rn_ladder_equal equal,
                              enum rn_preset_name preset,
                              const union rn_setting_value options[RN_TRAIN_SETTINGS],
                              struct rn_ladder_plan *ret_plan, struct rn_error *err) RN_MUST_CHECK;
void rn_ladder_plan_finish(struct rn_ladder_plan *plan);

#endif
