// What a scene calls for, as it is recorded. What an effect does is in effects/.
#ifndef RN_ENGINE_SCENE_EFFECT_H
#define RN_ENGINE_SCENE_EFFECT_H

#include <stdbool.h>

#include "common/settings/effects.h"

// What a photograph may be given of its own before it is compared.
enum rn_fit {
    RN_FIT_EXPOSURE = 1,   // a gain and an offset a channel
    RN_FIT_POSE = 2,       // and where its camera was, and its focal length
    RN_FIT_APPEARANCE = 4, // and its appearance (effect appearance)
};

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
