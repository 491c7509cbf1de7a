// Split pixels: at the end of a training a pixel is supersampled, 2 x 2 cones whose mean is its
// colour, and rendered so: sharper than one cone, and four times as much work.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

// Photographs of several scales say as much as split pixels do.
static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    bool asked = config->split_pixels > 0;
    r->number = e->field->effects[RN_EFFECT_SCALE_PYRAMID].number;
    r->threshold = RN_SCALE_RANGE;
    r->on = asked && !(config->auto_effects && r->number > r->threshold);
    if (r->on)
        snprintf(r->reason, sizeof r->reason,
                 "the last %.0f %% of the schedule train pixels as 2 x 2 cones: cameras see the "
                 "scene at one scale, footprints differ by a factor of %.2f",
                 100 * config->split_pixels, exp2(r->number));
    else
        snprintf(r->reason, sizeof r->reason, "%s",
                 asked ? "photographs of several scales say as much, and frames would take four "
                         "times as long"
                       : "the configuration asks for none");
}

static void settle(const struct rn_evidence *e) {
    if (!e->field->effects[RN_EFFECT_SPLIT_PIXELS].on) e->field->config.split_pixels = 0;
}

static void march(const struct rn_train_config *config, double done, struct rn_march_options *m) {
    m->split = config->split_pixels > 0 && done >= 1 - config->split_pixels;
}

const struct rn_effect_row rn_effect_split_pixels = {
    .detect = detect, .settle = settle, .march = march};
