// The table of effects.
#include "server/engine/effects/effects.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define ROW(CONSTANT, ROW, NAME) &rn_effect_##ROW,
static const struct rn_effect_row *const rows[RN_EFFECT_COUNT] = {RN_EFFECTS(ROW)};
#undef ROW

static struct rn_effect_record blank(int effect) {
    return (struct rn_effect_record){.name = rn_effect_name((enum rn_effect)effect),
                                     .decided = true};
}

// What was asked for in place of what was measured.
static void tell_choice(const struct rn_train_config *config, struct rn_effect_record *record,
                        int effect) {
    enum rn_effect_choice choice = config->effect[effect];
    size_t length = strlen(record->reason);
    if (choice == RN_EFFECT_AUTO || !record->decided || !length) return;
    snprintf(record->reason + length, sizeof record->reason - length, "; %s",
             choice == RN_EFFECT_UNWANTED ? "switched off as asked"
             : record->on                 ? "on as asked"
                                          : "asked for, but it cannot be");
}

struct rn_bounds rn_effects_prepare(const struct rn_dataset *dataset, bool on_gpu,
                                    struct rn_train_config *config,
                                    struct rn_effect_record ret_records[RN_EFFECT_COUNT]) {
    struct rn_bounds bounds = dataset->bounds;
    config->field.appearances = 0; // of another training, which it may go on from
    for (int i = 0; i < RN_EFFECT_COUNT; i++) {
        ret_records[i] = blank(i);
        if (on_gpu && rows[i]->cpu_alone)
            snprintf(ret_records[i].reason, sizeof ret_records[i].reason,
                     "a GPU does not train with it: --device cpu does");
        else if (rows[i]->prepare)
            rows[i]->prepare(dataset, config, &bounds, &ret_records[i]);
        tell_choice(config, &ret_records[i], i);
    }
    return bounds;
}

void rn_effects_detect(const struct rn_evidence *e) {
    for (int i = 0; i < RN_EFFECT_COUNT; i++) {
        struct rn_effect_record *record = &e->field->effects[i];
        if (!rows[i]->detect) continue;
        *record = blank(i);
        rows[i]->detect(e, record);
        tell_choice(&e->field->config, record, i);
    }
    for (int i = RN_EFFECT_COUNT - 1; i >= 0; i--)
        if (rows[i]->settle) rows[i]->settle(e);
}

static bool is_due(const struct rn_evidence *e, int i) {
    return !e->field->effects[i].decided && rows[i]->is_due && rows[i]->is_due(e);
}

bool rn_effects_are_due(const struct rn_evidence *e) {
    bool any = false;
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        any |= is_due(e, i);
    return any;
}

void rn_effects_decide(const struct rn_evidence *e) {
    for (int i = 0; i < RN_EFFECT_COUNT; i++) {
        if (!is_due(e, i)) continue;
        e->field->effects[i].decided = true;
        rows[i]->decide(e, &e->field->effects[i]);
    }
}

struct rn_march_options rn_effects_march_trained(const struct rn_field *field) {
    struct rn_march_options march = {.step = (float)field->config.step,
                                     .stop_depth = (float)-log(field->config.stop)};
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        if (rows[i]->colour) rows[i]->colour(field, &march.colour);
    return march;
}

struct rn_march_options rn_effects_march_pictures(const struct rn_field *field) {
    struct rn_march_options march = rn_effects_march_trained(field);
    march.step = (float)rn_picture_step(field);
    return march;
}

void rn_effects_march(const struct rn_train_config *config, double done,
                      struct rn_march_options *march) {
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        if (rows[i]->march) rows[i]->march(config, done, march);
}

void rn_effects_treat(const struct rn_train_config *config,
                      const struct rn_effect_record records[RN_EFFECT_COUNT], bool held,
                      struct rn_pixel_treatment *treatment) {
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        if (rows[i]->treat) rows[i]->treat(config, &records[i], held, treatment);
}

void rn_effects_take(struct rn_field *field, struct rn_pixels *photographs,
                     struct rn_engine *engine) {
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        if (rows[i]->take && field->effects[i].on) rows[i]->take(photographs, engine);
}

void rn_effects_turn(const struct rn_evidence *e) {
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        if (rows[i]->turn) rows[i]->turn(e);
}

// ---- what is told of them ---------------------------------------------------------------------

void rn_effect_text(enum rn_effect effect, double number, char *text, size_t capacity) {
    const struct rn_effect_unit *unit = &rows[effect]->unit;
    double told = unit->factor == 0 ? exp2(number) : unit->factor * number;
    *text = '\0';
    if (unit->one && fabs(told - 1) < 0.005)
        snprintf(text, capacity, "%s", unit->one);
    else if (!isnan(number))
        snprintf(text, capacity, "%.3g%s", told, unit->name);
}

int rn_effect_below(enum rn_effect effect) {
    enum rn_effect_side side = rows[effect]->side;
    return side == RN_EFFECT_EITHER ? -1 : side == RN_EFFECT_AT_MOST;
}

bool rn_effect_is_optional(enum rn_effect effect, bool on) {
    return on ? rows[effect]->optional : rows[effect]->optional_when_off;
}

unsigned rn_effects_fit(const struct rn_effect_record records[RN_EFFECT_COUNT]) {
    unsigned fit = 0;
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        if (records[i].on) fit |= rows[i]->fit;
    return fit;
}
