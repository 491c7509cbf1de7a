// Masks: pixels that are no part of the scene, such as who walks by. No training ray goes through
// them, and no evaluation counts them.
#include <stdio.h>

#include "server/engine/effects/effects.h"

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_pixels *photographs = e->photographs;
    size_t used = 0, masked = 0;
    for (int f = 0; f < photographs->frame_count; f++) {
        used += rn_pixels_used(photographs, &photographs->frames[f]);
        masked += photographs->frames[f].frame->mask_path != NULL;
    }
    r->number = 100 * (1 - (double)used / (double)photographs->pixel_count);
    r->threshold = 0;
    r->on = r->number > r->threshold;
    snprintf(r->reason, sizeof r->reason,
             "masks of %zu of %d photographs leave out %.3g %% of the training pixels", masked,
             photographs->frame_count, r->number);
}

const struct rn_effect_row rn_effect_masks = {.detect = detect};
