// Exposure and white balance: where photographs of one place differ in brightness, each is brought
// to the mean of all before training, by the gains that its import measured on shared points. What
// is rendered is the mean exposure.
#include <math.h>
#include <stdio.h>

#include "common/dataset/exposure.h"
#include "server/engine/effects/effects.h"

static void prepare(const struct rn_dataset *dataset, struct rn_train_config *config,
                    struct rn_bounds *bounds, struct rn_effect_record *r) {
    r->number = 100 * rn_exposure_unrest(dataset->frames, dataset->frame_count);
    r->threshold = 100 * RN_EXPOSURE_UNREST;
    r->on = rn_effect_choose(config, RN_EFFECT_EXPOSURE, !isnan(r->number),
                             config->auto_effects && r->number > r->threshold);
    if (isnan(r->number))
        snprintf(r->reason, sizeof r->reason,
                 "not measured: no file says which photographs see the same points");
    else
        snprintf(
            r->reason, sizeof r->reason,
            "90 %% of the photographs are within %.3g %% of the brightness of the one that looks "
            "most nearly the same way, by what they show of shared points",
            r->number);
}

static void treat(const struct rn_train_config *config, const struct rn_effect_record *r, bool held,
                  struct rn_pixel_treatment *treatment) {
    (void)config;
    (void)held;
    treatment->even = r->on;
}

const struct rn_effect_row rn_effect_exposure = {
    .unit = {" %", 1},
    .optional = true,
    .optional_when_off = true,
    .fit = RN_FIT_EXPOSURE,
    .prepare = prepare,
    .treat = treat,
};
