// What a scene calls for, as it is recorded.
#ifndef RN_ENGINE_SCENE_EFFECT_H
#define RN_ENGINE_SCENE_EFFECT_H

#include <stdbool.h>

// What a scene calls for. An effect that is off is not computed.
enum rn_effect {
    RN_EFFECT_BACKGROUND,
    RN_EFFECT_SCALE_PYRAMID,
    RN_EFFECT_ANISOTROPY,
    RN_EFFECT_VIEW_DEPENDENCE,
    RN_EFFECT_COUNT
};
struct rn_effect_record {
    const char *name; // "background", "scale-pyramid", "anisotropy", "view-dependence"
    bool on;
    bool decided;     // false: measured later in training (view dependence)
    double number;    // the evidence
    double threshold; // what the number is compared with
    char reason[160]; // one sentence with the number and its unit
};

#endif
