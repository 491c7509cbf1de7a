#include "common/settings/ladder.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *const rn_ladder_equal_names[] = {"time", "steps", "size", NULL};

#define AXES 8
#define VALUES 32 // of an axis

// One setting of a table and the values that it takes there.
struct axis {
    const struct rn_setting *row;
    char texts[VALUES][40];
    union rn_setting_value values[VALUES];
    int count;
};

struct parser {
    struct rn_ladder_plan *plan;
    const union rn_setting_value *options;
    struct axis axes[AXES];
    int count;
};

static const char *name_of(const struct rn_setting *row) {
    return row->option ? row->option : row->name;
}

static bool is_called(const struct rn_setting *row, const char *name, size_t size) {
    const char *names[] = {row->name, row->option, row->key ? NULL : row->flag, row->told};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (names[i] && strlen(names[i]) == size && memcmp(names[i], name, size) == 0) return true;
    return false;
}

static enum rn_status find_row(const char *name, size_t size, const struct rn_setting **ret_row,
                               struct rn_error *err) {
    for (size_t i = 0; i < RN_TRAIN_SETTINGS; i++) {
        const struct rn_setting *row = &rn_train_settings.rows[i];
        if (!is_called(row, name, size)) continue;
        *ret_row = row;
        if (!row->option && !rn_setting_is_by_name(row))
            return rn_error_set(err, RN_ERROR_INVALID, "over",
                                "%s follows from the photographs and cannot be varied", row->name);
        if (strcmp(row->name, "seed") == 0)
            return rn_error_set(err, RN_ERROR_INVALID, "over",
                                "seeds are the ladder's own: say how many there are to be");
        return RN_OK;
    }
    return rn_error_set(err, RN_ERROR_INVALID, "over",
                        "there is no setting '%.*s'; a scene's record lists all of them",
                        (int)(size < 40 ? size : 40), name);
}

static enum rn_status add_value(struct axis *axis, const char *text, size_t size,
                                struct rn_error *err) {
    struct rn_error why;
    if (axis->count == VALUES)
        return rn_error_set(err, RN_ERROR_LIMIT, "over", "%s has more than %d values",
                            name_of(axis->row), VALUES);
    char *own = axis->texts[axis->count];
    snprintf(own, sizeof axis->texts[0], "%.*s", (int)size, text);
    if (size >= sizeof axis->texts[0] ||
        rn_setting_parse(axis->row, own, &axis->values[axis->count], &why) != RN_OK)
        return rn_error_set(err, RN_ERROR_INVALID, "over", "%s %s", name_of(axis->row),
                            size < sizeof axis->texts[0] ? why.text : "has too long a value");
    axis->count++;
    return RN_OK;
}

// "planes=3,4" as the table's next axis.
static enum rn_status add_axis(struct parser *p, const char *word, size_t size,
                               struct rn_error *err) {
    const char *equals = memchr(word, '=', size), *end = word + size;
    if (!equals || equals == word || equals + 1 == end)
        return rn_error_set(err, RN_ERROR_INVALID, "over",
                            "'%.*s' is not NAME=VALUE,VALUE, ..., such as planes=3,4",
                            (int)(size < 40 ? size : 40), word);
    if (p->count == AXES)
        return rn_error_set(err, RN_ERROR_LIMIT, "over", "more than %d settings in a table", AXES);
    struct axis *axis = &p->axes[p->count];
    axis->count = 0;
    enum rn_status status = find_row(word, (size_t)(equals - word), &axis->row, err);
    for (int i = 0; status == RN_OK && i < p->count; i++)
        if (p->axes[i].row == axis->row)
            status = rn_error_set(err, RN_ERROR_INVALID, "over", "%s is there twice",
                                  name_of(axis->row));
    for (const char *at = equals + 1; status == RN_OK; at++) {
        const char *comma = memchr(at, ',', (size_t)(end - at));
        status = add_value(axis, at, (size_t)((comma ? comma : end) - at), err);
        if (!comma) break;
        at = comma;
    }
    if (status == RN_OK) p->count++;
    return status;
}

static enum rn_status add_arm(struct parser *p, const int *chosen, struct rn_error *err) {
    struct rn_ladder_plan *plan = p->plan;
    if (plan->count == RN_LADDER_ARMS)
        return rn_error_set(err, RN_ERROR_LIMIT, "over",
                            "asks for more than %d arms, the most that a ladder has",
                            RN_LADDER_ARMS);
    struct rn_ladder_arm *arm = &plan->arms[plan->count];
    size_t length = 0;
    memcpy(arm->values, p->options, sizeof arm->values);
    for (int i = 0; i < p->count; i++) {
        const struct axis *axis = &p->axes[i];
        arm->values[axis->row - rn_train_settings.rows] = axis->values[chosen[i]];
        length += (size_t)snprintf(arm->label + length, sizeof arm->label - length, "%s%s=%s",
                                   i ? " " : "", name_of(axis->row), axis->texts[chosen[i]]);
        if (length >= sizeof arm->label)
            return rn_error_set(err, RN_ERROR_LIMIT, "over", "varies too much at once");
    }
    for (size_t i = 0; i < plan->count; i++)
        if (strcmp(plan->arms[i].label, arm->label) == 0) return RN_OK;
    plan->count++;
    return RN_OK;
}

// All values of the table with all others, the last axis the quickest.
static enum rn_status close_table(struct parser *p, struct rn_error *err) {
    int chosen[AXES] = {0}, i;
    if (p->count == 0)
        return rn_error_set(err, RN_ERROR_INVALID, "over",
                            "names no settings to vary, such as planes=3,4");
    do {
        enum rn_status status = add_arm(p, chosen, err);
        if (status != RN_OK) return status;
        for (i = p->count - 1; i >= 0 && ++chosen[i] == p->axes[i].count; i--)
            chosen[i] = 0;
    } while (i >= 0);
    p->count = 0;
    return RN_OK;
}

static enum rn_status parse(struct parser *p, const char *over, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (const char *word = over; status == RN_OK;) {
        word += strspn(word, " \t\n");
        size_t size = strcspn(word, " \t\n");
        if (size == 0) return close_table(p, err);
        status = size == 1 && *word == '+' ? close_table(p, err) : add_axis(p, word, size, err);
        word += size;
    }
    return status;
}

// ---- what must be equal ---------------------------------------------------------------------

static union rn_setting_value *value_of(union rn_setting_value *values, const char *name) {
    return rn_settings_value(&rn_train_settings, values, name);
}

static bool varies(const struct rn_ladder_plan *plan, const union rn_setting_value *options,
                   const char *name) {
    const struct rn_setting *row = rn_settings_find(&rn_train_settings, name);
    size_t at = (size_t)(row - rn_train_settings.rows);
    for (size_t i = 0; i < plan->count; i++)
        if (memcmp(&plan->arms[i].values[at], &options[at], sizeof options[at]) != 0) return true;
    return false;
}

static enum rn_status configure(enum rn_preset_name preset,
                                const union rn_setting_value values[RN_TRAIN_SETTINGS],
                                struct rn_train_config *ret_config, struct rn_error *err) {
    enum rn_status status = rn_preset(rn_preset_names[preset], false, ret_config, err);
    if (status == RN_OK) rn_train_config_choose(ret_config, values);
    return status;
}

static double side_of(const struct rn_train_config *config) {
    return config->grow_to > 0 ? config->grow_to : config->field.base;
}

// The base grids' sides; those that grow are multiples of 8.
static enum rn_status make_sizes_equal(struct rn_ladder_plan *plan, enum rn_preset_name preset,
                                       const union rn_setting_value *options,
                                       struct rn_error *err) {
    struct rn_train_config model, config;
    enum rn_status status = configure(preset, options, &model, err);
    for (size_t i = 0; status == RN_OK && i < plan->count; i++) {
        status = configure(preset, plan->arms[i].values, &config, err);
        if (status != RN_OK) break;
        double texels = side_of(&model) * side_of(&model) * model.field.planes *
                        model.field.channels / (config.field.planes * config.field.channels);
        int unit = config.grow_to > 0 ? 8 : 1;
        value_of(plan->arms[i].values, "base")->whole = unit * (int64_t)(sqrt(texels) / unit + 0.5);
    }
    return status;
}

static enum rn_status settle(struct rn_ladder_plan *plan, enum rn_ladder_equal equal,
                             enum rn_preset_name preset, const union rn_setting_value *options,
                             struct rn_error *err) {
    static const char *const fixed[][3] = {
        {"max_seconds", "until_psnr", "until_plateau"}, {"max_steps", NULL}, {"base", NULL}};
    for (int i = 0; i < 3 && fixed[equal][i]; i++)
        if (varies(plan, options, fixed[equal][i]))
            return rn_error_set(err, RN_ERROR_INVALID, "over",
                                "%s cannot be varied where arms are equal by %s", fixed[equal][i],
                                rn_ladder_equal_names[equal]);
    struct rn_train_config config;
    enum rn_status status = configure(preset, options, &config, err);
    if (status == RN_OK && equal == RN_LADDER_EQUAL_STEPS && config.max_steps == 0)
        status = rn_error_set(err, RN_ERROR_INVALID, "max_steps",
                              "must be given where arms are equal by steps");
    if (status == RN_OK && equal == RN_LADDER_EQUAL_SIZE)
        status = make_sizes_equal(plan, preset, options, err);
    for (size_t i = 0; status == RN_OK && i < plan->count; i++) {
        struct rn_error why;
        if (rn_train_choice_check(plan->arms[i].values, &why) == RN_OK) continue;
        status = rn_error_set(err, RN_ERROR_INVALID, "over", "%s: %s: %s", plan->arms[i].label,
                              why.where, why.text);
    }
    return status;
}

enum rn_status rn_ladder_plan(const char *over, enum rn_ladder_equal equal,
                              enum rn_preset_name preset,
                              const union rn_setting_value options[RN_TRAIN_SETTINGS],
                              struct rn_ladder_plan *ret_plan, struct rn_error *err) {
    struct rn_ladder_plan plan = {.arms = calloc(RN_LADDER_ARMS, sizeof *plan.arms)};
    struct parser *parser = calloc(1, sizeof *parser);
    enum rn_status status =
        plan.arms && parser ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "over", "no memory");
    if (status == RN_OK) {
        *parser = (struct parser){.plan = &plan, .options = options};
        status = parse(parser, over, err);
    }
    if (status == RN_OK) status = settle(&plan, equal, preset, options, err);
    free(parser);
    if (status == RN_OK)
        *ret_plan = plan;
    else
        rn_ladder_plan_finish(&plan);
    return status;
}

void rn_ladder_plan_finish(struct rn_ladder_plan *plan) {
    free(plan->arms);
    *plan = (struct rn_ladder_plan){0};
}
