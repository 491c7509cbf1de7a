// What a scene calls for, as it is recorded. What an effect does is in effects/.
#ifndef RN_ENGINE_SCENE_EFFECT_H
#define RN_ENGINE_SCENE_EFFECT_H

#include <stdbool.h>

#include "common/settings/effects.h"

// An effect that is off is not computed.
struct rn_effect_record {
    const char *name;
    bool on;
    bool decided;     // false: measured later in training
    double number;    // the evidence; NAN where there is none
    double threshold; // what the number is compared with
    char reason[160]; // one sentence with the number and its unit
};

#endif
