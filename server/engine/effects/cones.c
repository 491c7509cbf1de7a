// Cones a pixel: a pixel that is wider than the finest ones that were trained on is rendered as the
// mean of several cones as narrow as theirs (render/cones.h).
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

// The finest cone that training rays have as of now.
static void measure(const struct rn_evidence *e) {
    double smallest, largest;
    rn_evidence_cones(e, &smallest, &largest);
    e->field->finest_cone = largest > 0 ? e->march.split ? smallest / 2 : smallest : 0;
}

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    double smallest, largest;
    rn_evidence_cones(e, &smallest, &largest);
    measure(e);
    r->number = largest > 0 ? log2(largest / smallest) : 0;
    r->threshold = log2(RN_CONES_RATIO);
    bool asked = rn_effect_choose(config, RN_EFFECT_CONES, true, config->supersample);
    r->on = asked && e->field->finest_cone > 0;
    if (r->on)
        snprintf(
            r->reason, sizeof r->reason,
            "pixels of pictures over %.2f times as wide as the finest trained on become several "
            "cones; the widest trained on is %.2f times as wide",
            RN_CONES_RATIO, exp2(r->number));
    else
        snprintf(r->reason, sizeof r->reason, "%s",
                 asked ? "no training pixel's cone has a width" : "the configuration asks for one");
}

static void settle(const struct rn_evidence *e) {
    struct rn_train_config *config = &e->field->config;
    config->supersample = rn_effect_choose(config, RN_EFFECT_CONES, true, config->supersample);
}

const struct rn_effect_row rn_effect_cones = {
    .unit = {" times the finest cone", 0, "all cones alike"},
    .side = RN_EFFECT_EITHER, // a picture's pixels are held against the threshold
    .detect = detect,
    .settle = settle,
    .turn = measure,
};
