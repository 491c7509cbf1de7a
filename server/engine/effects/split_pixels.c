// Split pixels: at the end of a training a pixel is supersampled, 2 x 2 cones whose mean is its
// colour, and rendered so: sharper than one cone, and four times as much work. In a place no gain
// pays for that: after 120 CPU seconds of one thread fox has 29.67 dB with what `standard` does in
// that time, split pixels among it, and 844 ms a picture, after 119 without it 29.90 dB and 158 ms.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

// Photographs of several scales say as much as split pixels do.
static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    bool asked = config->split_pixels > 0;
    r->number = e->field->effects[RN_EFFECT_SCALE_PYRAMID].number;
    r->threshold = RN_SCALE_RANGE;
    r->on = rn_effect_choose(config, RN_EFFECT_SPLIT_PIXELS, asked,
                             !(config->auto_effects && r->number > r->threshold));
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

// Whether it is one is known when the effects that follow have settled.
static void settle(const struct rn_evidence *e) {
    struct rn_effect_record *r = &e->field->effects[RN_EFFECT_SPLIT_PIXELS];
    bool asked = e->field->config.effect[RN_EFFECT_SPLIT_PIXELS] == RN_EFFECT_WANTED;
    if (r->on && !asked && e->field->config.auto_effects && rn_is_place(&e->field->cpu)) {
        r->on = false;
        snprintf(r->reason, sizeof r->reason,
                 "pictures of places take five times as long with them and are no better");
    }
    if (!e->field->effects[RN_EFFECT_SPLIT_PIXELS].on) e->field->config.split_pixels = 0;
}

static void march(const struct rn_train_config *config, double done, struct rn_march_options *m) {
    m->split = config->split_pixels > 0 && done >= 1 - config->split_pixels;
}

const struct rn_effect_row rn_effect_split_pixels = {
    .unit = {" times the finest footprint", 0, "all footprints alike"},
    .side = RN_EFFECT_AT_MOST,
    .optional = true,
    .detect = detect,
    .settle = settle,
    .march = march,
};
