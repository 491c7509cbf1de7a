// Distortion: the lenses of the photographs. Where they move no pixel by as much as would show,
// they are taken for pinholes.
#include <stdio.h>

#include "common/dataset/calls.h"
#include "server/engine/effects/effects.h"

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    struct rn_lens_shift shifts = {0};
    char folded[64] = "";
    for (int f = 0; f < e->photographs->frame_count; f++)
        rn_lens_shift_add(&shifts, &e->photographs->frames[f].frame->camera);
    r->number = shifts.most;
    r->threshold = RN_LENS_SHIFT;
    r->on = rn_effect_choose(&e->field->config, RN_EFFECT_DISTORTION, r->number > 0,
                             r->number > r->threshold);
    if (shifts.folded > 0)
        snprintf(folded, sizeof folded, "; %zu pixels beyond its fold are left out", shifts.folded);
    snprintf(r->reason, sizeof r->reason, "the lens moves pixels by up to %.3g pixels%s",
             shifts.most, folded);
}

const struct rn_effect_row rn_effect_distortion = {
    .unit = {" pixels", 1},
    .optional = true,
    .detect = detect,
};
