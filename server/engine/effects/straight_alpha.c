// Straight alpha: where the coarser photographs of a view average colour and opacity apart, as the
// published benchmark's do, a pixel that an object's edge crosses is darker than any camera would
// see it. Training then takes coarser pixels anew from the finest photographs, weighted by opacity,
// and a picture that is compared with such a photograph averages its cones as that was averaged.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

#define FRAMES 8              // of the coarsest scale that are looked at
#define THRESHOLD (1.0 / 255) // what rounding explains, and half as much again

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    bool several = rn_effect_choose(config, RN_EFFECT_CONES, true, config->supersample);
    bool asked = config->auto_effects && several;
    r->number = e->photographs->scale_count > 1 ? rn_pixels_scale_error(e->photographs, FRAMES) : 0;
    r->threshold = THRESHOLD;
    r->on = rn_effect_choose(config, RN_EFFECT_STRAIGHT_ALPHA, several && r->number > 0,
                             asked && r->number > r->threshold);
    if (asked || r->number <= r->threshold)
        snprintf(r->reason, sizeof r->reason,
                 "at edges the coarsest photographs differ by %.1f/255 RMS from means that weigh "
                 "colours by opacity",
                 255 * r->number);
    else
        snprintf(r->reason, sizeof r->reason,
                 "the configuration asks for one cone a pixel, or for no effects by evidence");
}

const struct rn_effect_row rn_effect_straight_alpha = {
    .unit = {"/255", 255},
    .detect = detect,
    .take = rn_pixels_remake_scales,
};
