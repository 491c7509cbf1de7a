// A robust loss: what some photographs show and the others do not, such as what moves, is not
// trained on (train/outliers.c). Whether there is any is found out early in training.
#include <math.h>
#include <stdio.h>

#include "server/engine/effects/effects.h"

#define SHARE 0.8 // % of the pixels

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    enum rn_effect_choice choice = config->effect[RN_EFFECT_ROBUST_LOSS];
    r->number = NAN;
    r->threshold = SHARE;
    r->on = rn_effect_choose(config, RN_EFFECT_ROBUST_LOSS, true, false);
    r->decided = choice != RN_EFFECT_AUTO || !config->auto_effects || rn_evidence_is_rendered(e);
    const char *reason = "to be measured once the field shows something";
    if (rn_evidence_is_rendered(e))
        reason = "photographs are a renderer's, which agree";
    else if (r->decided)
        reason = "not measured";
    snprintf(r->reason, sizeof r->reason, "%s", reason);
}

static bool is_due(const struct rn_evidence *e) {
    return e->outlier_share_known;
}

static void decide(const struct rn_evidence *e, struct rn_effect_record *r) {
    r->number = 100 * e->outlier_share;
    r->on = r->number > r->threshold;
    snprintf(
        r->reason, sizeof r->reason,
        "%.3g %% of the pixels lie where photographs differ from all others, as what moves does",
        r->number);
}

const struct rn_effect_row rn_effect_robust_loss = {
    .unit = {" %", 1},
    .optional = true,
    .detect = detect,
    .is_due = is_due,
    .decide = decide,
};
