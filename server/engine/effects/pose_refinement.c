// Pose refinement: the photographs' cameras are moved while the field is trained, where photographs
// that it is not trained on gain by it. Whether they do is found out early in training
// (train/poses.c): the held-out cameras are sought by some of the pixels that they show, and others
// are compared before and after.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

#define GAIN 0.5 // dB of the pixels that were not looked at

static bool can(const struct rn_evidence *e) {
    return e->photographs->scale_count == 1;
}

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    enum rn_effect_choice choice = config->effect[RN_EFFECT_POSE_REFINEMENT];
    r->number = NAN;
    r->threshold = GAIN;
    r->on = rn_effect_choose(config, RN_EFFECT_POSE_REFINEMENT, can(e), false);
    r->decided =
        choice != RN_EFFECT_AUTO || !config->auto_effects || !can(e) || rn_evidence_is_rendered(e);
    const char *reason = "to be measured on held-out photographs once the field shows something";
    if (!can(e))
        reason = "not measured: photographs are there at several scales";
    else if (rn_evidence_is_rendered(e))
        reason = "poses are those that the pictures were rendered with";
    else if (r->decided)
        reason = "not measured";
    snprintf(r->reason, sizeof r->reason, "%s", reason);
}

static bool is_due(const struct rn_evidence *e) {
    return e->pose_gain_known;
}

static void decide(const struct rn_evidence *e, struct rn_effect_record *r) {
    r->number = e->pose_gain;
    r->on = r->number > r->threshold;
    if (isnan(r->number))
        snprintf(r->reason, sizeof r->reason, "not measured: no photographs are held out");
    else
        snprintf(r->reason, sizeof r->reason,
                 "with their poses fitted on some pixels, held-out photographs gain %.2f dB at "
                 "others",
                 r->number);
}

void rn_effect_tell_moves(struct rn_effect_record *r, double turn_deg, double shift) {
    char gain[64] = "; on as asked";
    if (isfinite(r->number))
        snprintf(gain, sizeof gain, ", as held-out ones gained %.2f dB by it", r->number);
    snprintf(r->reason, sizeof r->reason,
             "cameras were turned by %.3g degrees and moved by %.2g of the radius on the mean%s",
             turn_deg, shift, gain);
}

const struct rn_effect_row rn_effect_pose_refinement = {
    .unit = {" dB", 1},
    .fit = RN_FIT_EXPOSURE | RN_FIT_POSE,
    .detect = detect,
    .is_due = is_due,
    .decide = decide,
};
