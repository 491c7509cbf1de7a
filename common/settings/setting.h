// Settings as tables: a row says all there is to say of one, and what checks, reads, writes, asks
// for or explains settings goes by the rows.
//
// A settings struct is plain (struct rn_train_config, struct rn_render_settings); a row names a
// member of it. How to add one: a member, a row, and whoever uses it; then
// `tests/api/test_settings.py --write` brings proto/openapi.yaml up to date.
#ifndef RN_COMMON_SETTINGS_SETTING_H
#define RN_COMMON_SETTINGS_SETTING_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

enum rn_setting_type {
    RN_SETTING_BOOL,   // bool; with `choices` it is told and asked for by their two names
    RN_SETTING_INT,    // int
    RN_SETTING_INT64,  // int64_t
    RN_SETTING_UINT64, // uint64_t, told as a signed one
    RN_SETTING_NUMBER, // double
    RN_SETTING_CHOICE, // an enum: index in `choices`
    RN_SETTING_COLOUR, // float[3]
    RN_SETTING_TEXT,   // char[RN_SETTING_TEXT_MAX]
};
#define RN_SETTING_TEXT_MAX 16

enum {
    RN_SETTING_OVER_MIN = 1,     // min itself is not allowed
    RN_SETTING_UNDER_MAX = 2,    // max itself is not allowed
    RN_SETTING_OR_ZERO = 4,      // 0 is allowed beside the range: none, or "as the rest calls for"
    RN_SETTING_POWER_OF_TWO = 8, // in the range
    RN_SETTING_SIXTEENS = 16,    // multiples of 16 in the range
    RN_SETTING_LATER = 32,       // records may lack it, which means 0
    RN_SETTING_SAME_BYTES = 64,  // a run's or picture's bytes up to a step do not depend on it
    RN_SETTING_OF_DATA = 128,    // follows from what the photographs show, or from other settings
};

struct rn_setting {
    const char *name; // in records, checkpoints and errors
    enum rn_setting_type type;
    unsigned flags;
    size_t offset;              // of the member
    double min, max;            // of numbers, and of each channel of a colour
    const char *unit;           // "" where it has none
    const char *const *choices; // NULL-terminated
    const char *meaning;        // one line
    const char *option;         // its name in requests; NULL: not asked for
    const char *flag;           // in command lines, "max-time"; NULL: not asked for
    const char *key;  // of rows that share a flag: what is before "=" in its value; else NULL
    const char *told; // its name in the daemon's records; NULL: as `name`
    // Training: the value of each preset; a colour's is of all channels.
    double paper, standard, draft;
    // Training: what a run that differs from the paper's here says of it, and the gain, NULL where
    // that was not measured; gain_of_none where the value is 0 and that is something else.
    const char *unlike, *gain, *gain_of_none;
    // Rendering: what an absent option is written as, where it is the same for every scene; NAN.
    double settled;
};

// Thread-safety: constant.
struct rn_settings {
    const struct rn_setting *rows;
    size_t count;
};

// A value by itself. Absent: INT64_MIN, NAN, -1, NAN in the first channel, "".
union rn_setting_value {
    int64_t whole;    // INT, INT64, UINT64
    double number;    // NUMBER
    int choice;       // BOOL (0, 1), CHOICE
    double colour[3]; // COLOUR
    char text[RN_SETTING_TEXT_MAX];
};

union rn_setting_value rn_setting_absent(const struct rn_setting *row);
bool rn_setting_is_absent(const struct rn_setting *row, const union rn_setting_value *value);

// The row of that name; NULL when there is none.
const struct rn_setting *rn_settings_find(const struct rn_settings *settings, const char *name);
// The first row from `from` on that has this flag; NULL when there is none.
const struct rn_setting *rn_settings_flagged(const struct rn_settings *settings, size_t from,
                                             const char *flag, size_t size);
// Of values in the order of the rows, the one of that name, which there is.
union rn_setting_value *rn_settings_value(const struct rn_settings *settings,
                                          union rn_setting_value *values, const char *name);
// A value into its member of `config`, a struct of the kind that the table is of; one that is
// absent changes nothing.
void rn_setting_put(const struct rn_setting *row, const union rn_setting_value *value,
                    void *config);
// All members, in the order of the rows.
void rn_settings_get(const struct rn_settings *settings, const void *config,
                     union rn_setting_value *ret_values);
void rn_settings_put(const struct rn_settings *settings, const union rn_setting_value *values,
                     void *config);
// A number as a value: of a colour all channels, of a text none.
union rn_setting_value rn_setting_of_number(const struct rn_setting *row, double number);
void rn_setting_put_number(const struct rn_setting *row, double number, void *config);
// BOOL, whole numbers and CHOICE as they are; a colour's first channel; 0 for a text.
double rn_setting_number(const struct rn_setting *row, const void *config);

// Every member in its range. RN_ERROR_INVALID names the setting.
enum rn_status rn_settings_check(const struct rn_settings *settings, const void *config,
                                 struct rn_error *err) RN_MUST_CHECK;
// A value as people write it: "64", "0.005", "rip", "true"; seconds also as "60s", "10m", "1h".
// What a request may ask for: 0 of RN_SETTING_OR_ZERO is not. RN_ERROR_INVALID; err->where is the
// setting's name.
enum rn_status rn_setting_parse(const struct rn_setting *row, const char *text,
                                union rn_setting_value *ret_value,
                                struct rn_error *err) RN_MUST_CHECK;

// Whether requests may ask for it by its name alone: what has no option, unless data decide it.
static inline bool rn_setting_is_by_name(const struct rn_setting *row) {
    return !row->option && !(row->flags & RN_SETTING_OF_DATA);
}

// Whether its flag alone means that it is wanted: of BOOL without names.
static inline bool rn_setting_is_flag(const struct rn_setting *row) {
    return row->type == RN_SETTING_BOOL && !row->choices;
}

#endif
