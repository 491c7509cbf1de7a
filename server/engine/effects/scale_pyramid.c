// The scale pyramid: where footprints differ in size, a coarser level of the planes is looked up
// for larger ones; elsewhere none is built.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    double smallest, largest;
    rn_evidence_cones(e, &smallest, &largest);
    bool can = config->field.footprint != RN_FOOTPRINT_POINT && config->field.levels > 1;
    bool asked = !config->auto_effects || config->footprint_given;
    r->number = largest > 0 ? log2(largest / smallest) : 0;
    r->threshold = RN_SCALE_RANGE;
    r->on =
        rn_effect_choose(config, RN_EFFECT_SCALE_PYRAMID, can, asked || r->number > r->threshold);
    snprintf(
        r->reason, sizeof r->reason,
        "footprints at the scene's centre differ by a factor of %.2f over the training cameras%s",
        exp2(r->number), can ? "" : "; the field samples points");
}

// Where footprints hardly differ, they are measured in texels so wide that all of them are at level
// 0: no pyramid is built or read in training; a camera farther away still gets its levels.
static void settle(const struct rn_evidence *e) {
    struct rn_train_config *config = &e->field->config;
    struct rn_field_config *c = &config->field;
    bool asked = !config->auto_effects || config->footprint_given;
    if (config->effect[RN_EFFECT_SCALE_PYRAMID] == RN_EFFECT_AUTO && asked) return;
    if (c->footprint == RN_FOOTPRINT_POINT || e->field->effects[RN_EFFECT_SCALE_PYRAMID].on) return;
    int base = config->grow_to > c->base ? config->grow_to : c->base;
    double top = 0;
    c->footprint_base = base;
    for (int f = 0; f < e->photographs->frame_count; f++)
        top = fmax(top, rn_top_level(e->field, &e->photographs->frames[f].camera, config->step));
    if (top > 0) c->footprint_base = (int)(base / exp2(top));
    if (c->footprint_base < 1) c->footprint_base = 1;
}

const struct rn_effect_row rn_effect_scale_pyramid = {
    .unit = {" times the finest footprint", 0, "all footprints alike"},
    .optional = true,
    .optional_when_off = true,
    .detect = detect,
    .settle = settle,
};
