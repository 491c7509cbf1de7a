// Masks: pixels that are no part of the scene, such as who walks by. No training ray goes through
// them, and no evaluation counts them. Where they leave out most of the photographs, they cut an
// object out of its surroundings, as an alpha channel does: what they leave out is empty. Otherwise
// nothing would keep it so, and what fills it would show each photograph its own picture. Where the
// effect is asked for, they do so however little they leave out.
#include <stdio.h>

#include "common/dataset/calls.h"
#include "server/engine/effects/effects.h"

static void prepare(const struct rn_dataset *dataset, struct rn_train_config *config,
                    struct rn_bounds *bounds, struct rn_effect_record *r) {
    (void)bounds;
    (void)r;
    enum rn_effect_choice choice = config->effect[RN_EFFECT_MASKS];
    double most = choice == RN_EFFECT_WANTED ? 0 : RN_SHARE_LEFT_OUT;
    if (config->auto_effects || choice == RN_EFFECT_WANTED)
        config->cut_out = choice != RN_EFFECT_UNWANTED && rn_share_left_out(dataset) > most;
}

// Pixels that no mask has made transparent.
static size_t opaque(const struct rn_pixels *photographs, const struct rn_pixel_frame *frame) {
    size_t count = (size_t)frame->camera.width * (size_t)frame->camera.height, opaque = 0;
    for (size_t i = frame->offset; i < frame->offset + count; i++)
        opaque += photographs->rgba[4 * i + 3] > 0;
    return opaque;
}

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_pixels *photographs = e->photographs;
    bool cut_out = e->field->config.cut_out;
    size_t used = 0, masked = 0;
    for (int f = 0; f < photographs->frame_count; f++) {
        const struct rn_pixel_frame *frame = &photographs->frames[f];
        used += cut_out && frame->frame->mask_path ? opaque(photographs, frame)
                                                   : rn_pixels_used(photographs, frame);
        masked += frame->frame->mask_path != NULL;
        rn_pixels_let_go(photographs);
    }
    r->number = 100 * (1 - (double)used / (double)photographs->pixel_count);
    r->threshold = 0;
    r->on = r->number > r->threshold;
    snprintf(r->reason, sizeof r->reason,
             "masks of %zu of %d photographs leave out %.3g %% of the training pixels%s", masked,
             photographs->frame_count, r->number,
             cut_out ? ": they cut an object out, and around it is nothing" : "");
}

// Of photographs that are held out, what masks leave out is not scored.
static void treat(const struct rn_train_config *config, const struct rn_effect_record *r, bool held,
                  struct rn_pixel_treatment *treatment) {
    (void)r;
    treatment->cut_out = !held && config->cut_out;
    treatment->unmasked = !held && config->effect[RN_EFFECT_MASKS] == RN_EFFECT_UNWANTED;
}

const struct rn_effect_row rn_effect_masks = {
    .unit = {" %", 1},
    .prepare = prepare,
    .detect = detect,
    .treat = treat,
};
