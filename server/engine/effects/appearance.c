// Appearance: where the light on a place differs from photograph to photograph, as between days,
// the colour network sees a code of the photograph, which is trained with it (Martin-Brualla et al.
// 2021, "NeRF in the Wild", section 4.1). What is rendered is their mean, the code 0. An exposure's
// gains cannot say where shadows fall. The number is the import's, measured on shared points.
#include <math.h>
#include <stdio.h>

#include "common/dataset/exposure.h"
#include "server/engine/effects/effects.h"

static void prepare(const struct rn_dataset *dataset, struct rn_train_config *config,
                    struct rn_bounds *bounds, struct rn_effect_record *r) {
    (void)bounds;
    r->number = 100 * rn_light_unrest(dataset->frames, dataset->frame_count);
    r->threshold = 100 * RN_LIGHT_UNREST;
    r->on = rn_effect_choose(config, RN_EFFECT_APPEARANCE, true,
                             config->auto_effects && r->number > r->threshold);
    config->field.appearances = r->on ? (int)dataset->frame_count : 0;
    if (isnan(r->number))
        snprintf(r->reason, sizeof r->reason,
                 "not measured: no file says which photographs see the same points");
    else
        snprintf(r->reason, sizeof r->reason,
                 "the light on shared points differs by %.3g %% between photographs that look most "
                 "nearly the same way, their exposures left out",
                 r->number);
}

const struct rn_effect_row rn_effect_appearance = {
    .unit = {" %", 1},
    .optional = true,
    .optional_when_off = true,
    .cpu_alone = true,
    .fit = RN_FIT_EXPOSURE | RN_FIT_APPEARANCE,
    .prepare = prepare,
};
