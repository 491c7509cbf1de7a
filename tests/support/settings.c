// Prints the tables of settings, and the names of what else stands in a table, as JSON, for
// tests/api/test_settings.py.
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/math/lens.h"
#include "common/path/formats/formats.h"
#include "common/settings/effects.h"
#include "common/settings/optics.h"
#include "common/settings/render.h"
#include "common/settings/train.h"

static json_t *text(const char *value) {
    return value ? json_string(value) : json_null();
}

static json_t *flags_of(const struct rn_setting *row) {
    return json_pack("{s:b,s:b,s:b,s:b,s:b,s:b}", "over_min", row->flags & RN_SETTING_OVER_MIN,
                     "under_max", row->flags & RN_SETTING_UNDER_MAX, "or_zero",
                     row->flags & RN_SETTING_OR_ZERO, "power_of_two",
                     row->flags & RN_SETTING_POWER_OF_TWO, "later", row->flags & RN_SETTING_LATER,
                     "same_bytes", row->flags & RN_SETTING_SAME_BYTES);
}

static json_t *row_of(const struct rn_setting *row) {
    static const char *const types[] = {"bool",   "int",    "int",    "int",
                                        "number", "choice", "colour", "text"};
    json_t *choices = json_array();
    for (int i = 0; row->choices && row->choices[i]; i++)
        json_array_append_new(choices, json_string(row->choices[i]));
    return json_pack("{s:s,s:s,s:f,s:f,s:s,s:s,s:o,s:o,s:o,s:o,s:o,s:o,s:b,s:[f,f,f]}", "name",
                     row->name, "type", types[row->type], "min", row->min, "max", row->max, "unit",
                     row->unit, "meaning", row->meaning, "option", text(row->option), "flag",
                     text(row->flag), "told", text(row->told ? row->told : row->name), "choices",
                     choices, "flags", flags_of(row), "settled",
                     isnan(row->settled) ? json_null() : json_real(row->settled), "by_name",
                     rn_setting_is_by_name(row), "presets", row->paper, row->standard, row->draft);
}

static json_t *table(const struct rn_settings *settings) {
    json_t *rows = json_array();
    for (size_t i = 0; i < settings->count; i++)
        json_array_append_new(rows, row_of(&settings->rows[i]));
    return rows;
}

static json_t *effects(void) {
    json_t *names = json_array();
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        json_array_append_new(names, json_string(rn_effect_name((enum rn_effect)i)));
    return names;
}

// Each with its parameters and the most of their size.
static json_t *lenses(void) {
    json_t *all = json_object();
    for (int i = 0; i < RN_LENS_COUNT; i++) {
        json_t *parameters = json_object();
        for (int k = 0; k < rn_lens_models[i].count; k++)
            json_object_set_new(parameters, rn_lens_models[i].parameters[k],
                                json_real(rn_lens_models[i].most));
        json_object_set_new(all, rn_lens_names[i], parameters);
    }
    return all;
}

static json_t *path_formats(void) {
    json_t *names = json_array();
    for (size_t i = 0; rn_path_formats[i]; i++)
        json_array_append_new(names, json_string(rn_path_formats[i]->name));
    return names;
}

int main(void) {
    json_t *all =
        json_pack("{s:o,s:o,s:o,s:o,s:o,s:o}", "train", table(&rn_train_settings), "render",
                  table(&rn_render_settings), "optics", table(&rn_optics_settings), "effects",
                  effects(), "lenses", lenses(), "path_formats", path_formats());
    char *json = all ? json_dumps(all, JSON_INDENT(1)) : NULL;
    if (json) puts(json);
    free(json);
    json_decref(all);
    return json ? 0 : 1;
}
