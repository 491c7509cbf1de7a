// What a training begins with: presets, what they make of the time, what a request puts over them;
// and in which it differs from the paper.
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "common/base/names.h"
#include "common/settings/train.h"

static double preset_value(const struct rn_setting *row, int preset) {
    return preset == RN_PRESET_PAPER   ? row->paper
           : preset == RN_PRESET_DRAFT ? row->draft
                                       : row->standard;
}

enum rn_status rn_preset(const char *name, bool multi_scale, struct rn_train_config *ret_config,
                         struct rn_error *err) {
    int preset = rn_name_index(rn_preset_names, name);
    if (preset < 0)
        return rn_error_set(err, RN_ERROR_INVALID, "preset",
                            "'%s' is no preset; use draft, standard or paper", name);
    const struct rn_setting *rows = rn_train_settings.rows;
    struct rn_train_config config = {.preset = ""};
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++)
        rn_setting_put_number(&rows[i], preset_value(&rows[i], preset), &config);
    snprintf(config.preset, sizeof config.preset, "%s", name);
    // Few rays need levels then, and those of the isotropic pyramid cost half the fetches.
    if (multi_scale && preset != RN_PRESET_PAPER) config.field.footprint = RN_FOOTPRINT_MIP;
    *ret_config = config;
    return RN_OK;
}

// What `standard` makes of the time it has. On two cores, lego: a second hidden layer of the colour
// network is 0.1 dB behind after 15 s (two seeds) and 0.25 dB ahead after 60; networks twice as
// wide are level after 60 s and 0.4 dB ahead after 300. In 10,000 steps of these, half the
// smoothing is 0.15 dB ahead, the networks' decay 0.1, and splitting pixels 0.6; frames then take
// three times as long or more. After 119 CPU seconds decay is level on lego and 0.15 dB
// ahead on a captured cup; it was not tried in 15 s.
#define PLATEAU_TIMES 10 // the preset's time, for a training that ends at its plateau
#define SHORT_RUN 40     // seconds
static const struct {
    const char *name;
    double in_short, between, in_long; // no limit counts as between
} by_time[] = {{"head_layers", 1, 2, 2},        {"draw_by_error", 1, 0, 0},
               {"width", 64, 64, 128},          {"smoothing", 0.1, 0.1, 0.05},
               {"weight_decay", 0, 0.05, 0.05}, {"split_pixels", 0, 0, 0.4}};

void rn_train_config_suit_time(struct rn_train_config *config) {
    double seconds = config->max_seconds;
    if (strcmp(config->preset, "standard") != 0) return;
    for (size_t i = 0; i < sizeof by_time / sizeof *by_time; i++)
        rn_setting_put_number(rn_settings_find(&rn_train_settings, by_time[i].name),
                              seconds >= RN_TRAIN_LONG_RUN         ? by_time[i].in_long
                              : seconds > 0 && seconds < SHORT_RUN ? by_time[i].in_short
                                                                   : by_time[i].between,
                              config);
}

#define LEAST_SIDE 480 // pixels of the longest side that are left at least
#define LARGEST 16     // times smaller, at most

int rn_train_scale_by_time(double megapixels, int longest_side, double seconds) {
    int scale = 1;
    while (seconds > 0 && scale < LARGEST && longest_side / (2 * scale) >= LEAST_SIDE &&
           megapixels / (scale * scale) > RN_TRAIN_MEGAPIXELS * seconds)
        scale *= 2;
    return scale;
}

// Planes of `base` texels a side: where the preset's grow, from an eighth of that.
static void set_base(struct rn_train_config *config, int base) {
    bool grows = config->grow_to > 0 && base % 8 == 0 && base >= 128;
    config->field.base = grows ? base / 8 : base;
    config->grow_to = grows ? base : 0;
}

static bool asks(const union rn_setting_value *values, size_t offset) {
    const struct rn_setting *rows = rn_train_settings.rows;
    size_t i = 0;
    while (rows[i].offset != offset)
        i++;
    return !rn_setting_is_absent(&rows[i], &values[i]);
}
#define ASKS(member) asks(values, offsetof(struct rn_train_config, member))

void rn_train_config_choose(struct rn_train_config *config,
                            const union rn_setting_value values[RN_TRAIN_SETTINGS]) {
    bool limited = ASKS(max_steps) || ASKS(max_seconds);
    if (limited) config->max_seconds = 0, config->max_steps = 0;
    rn_settings_put(&rn_train_settings, values, config);
    bool longer = config->until_plateau && !limited;
    if (longer) config->max_seconds *= PLATEAU_TIMES;
    if (limited || longer) rn_train_config_suit_time(config);
    rn_settings_put(&rn_train_settings, values, config); // what the time suits gives way
    if (ASKS(field.base) && !ASKS(grow_to)) set_base(config, config->field.base);
    if (ASKS(field.footprint)) config->footprint_given = true;
    if (config->until_psnr > 0) config->give_back = 0; // which needs its figure to the end
}

void rn_train_config_suit_data(struct rn_train_config *config, const char *name, double value) {
    const struct rn_setting *row = rn_settings_find(&rn_train_settings, name);
    int preset = rn_name_index(rn_preset_names, config->preset);
    if (preset < 0 || rn_setting_number(row, config) == preset_value(row, preset))
        rn_setting_put_number(row, value, config);
}

// ---- checks ---------------------------------------------------------------------------------

enum rn_status rn_planes_check(int planes, enum rn_orientation orientation, struct rn_error *err) {
    bool platonic = planes == 3 || planes == 4 || planes == 6 || planes == 10;
    if (orientation == RN_ORIENTATION_PLATONIC && !platonic)
        return rn_error_set(err, RN_ERROR_INVALID, "planes",
                            "%d planes belong to no Platonic solid; use 3, 4, 6 or 10", planes);
    if (planes < 1 || planes > RN_MAX_PLANES)
        return rn_error_set(err, RN_ERROR_INVALID, "planes", "%d planes; use 1 to %d", planes,
                            RN_MAX_PLANES);
    return RN_OK;
}

enum rn_status rn_train_config_check(const struct rn_train_config *c, struct rn_error *err) {
    enum rn_status status = rn_planes_check(c->field.planes, c->field.orientation, err);
    if (status == RN_OK && c->field.voxels && c->field.planes == RN_MAX_PLANES)
        return rn_error_set(err, RN_ERROR_INVALID, "voxels",
                            "there is room for voxels beside at most %d planes", RN_MAX_PLANES - 1);
    return status != RN_OK ? status : rn_settings_check(&rn_train_settings, c, err);
}

enum rn_status rn_train_choice_check(const union rn_setting_value values[RN_TRAIN_SETTINGS],
                                     struct rn_error *err) {
    struct rn_train_config config;
    enum rn_status status = rn_preset("standard", false, &config, err);
    if (status != RN_OK) return status;
    rn_train_config_choose(&config, values);
    return rn_train_config_check(&config, err);
}

// ---- the paper ------------------------------------------------------------------------------

// Of the base grid the one in the end counts.
static double told_value(const struct rn_setting *row, const struct rn_train_config *config) {
    bool is_base = row->offset == offsetof(struct rn_train_config, field.base);
    return is_base && config->grow_to > 0 ? config->grow_to : rn_setting_number(row, config);
}

static bool differs(const struct rn_setting *row, const struct rn_train_config *config) {
    return row->unlike && fabs(told_value(row, config) - row->paper) > 1e-9 * fabs(row->paper);
}

int rn_train_config_differences(const struct rn_train_config *config, struct rn_difference *items,
                                int capacity) {
    int n = 0;
    const char *last = "";
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++) {
        const struct rn_setting *row = &rn_train_settings.rows[i];
        if (!differs(row, config) || strcmp(row->unlike, last) == 0) continue;
        bool none = row->gain_of_none && rn_setting_number(row, config) == 0;
        const char *gain = none ? row->gain_of_none : row->gain;
        last = row->unlike;
        if (n < capacity) items[n] = (struct rn_difference){last, gain ? gain : ""};
        n++;
    }
    return n;
}
