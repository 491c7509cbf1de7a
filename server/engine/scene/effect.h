// What a scene calls for, as it is recorded. What an effect does is in effects/.
#ifndef RN_ENGINE_SCENE_EFFECT_H
#define RN_ENGINE_SCENE_EFFECT_H

#include <stdbool.h>

// All effects, in the order in which they are measured and told: X(constant, row of the table,
// name).
#define RN_EFFECTS(X)                                                                              \
    X(BACKGROUND, background, "background")                                                        \
    X(SCALE_PYRAMID, scale_pyramid, "scale-pyramid")                                               \
    X(ANISOTROPY, anisotropy, "anisotropy")                                                        \
    X(VIEW_DEPENDENCE, view_dependence, "view-dependence")                                         \
    X(SPLIT_PIXELS, split_pixels, "split-pixels")                                                  \
    X(CONES, cones, "cones")                                                                       \
    X(DISTORTION, distortion, "distortion")                                                        \
    X(MASKS, masks, "masks")                                                                       \
    X(EXPOSURE, exposure, "exposure")                                                              \
    X(FORWARD_FACING, forward_facing, "forward-facing")                                            \
    X(UNBOUNDED, unbounded, "unbounded")                                                           \
    X(STRAIGHT_ALPHA, straight_alpha, "straight-alpha")

#define RN_EFFECT_CONSTANT(CONSTANT, ROW, NAME) RN_EFFECT_##CONSTANT,
enum rn_effect { RN_EFFECTS(RN_EFFECT_CONSTANT) RN_EFFECT_COUNT };
#undef RN_EFFECT_CONSTANT

// An effect that is off is not computed.
struct rn_effect_record {
    const char *name;
    bool on;
    bool decided;     // false: measured later in training
    double number;    // the evidence; NAN where there is none
    double threshold; // what the number is compared with
    char reason[160]; // one sentence with the number and its unit
};

static inline const char *rn_effect_name(enum rn_effect effect) {
#define RN_EFFECT_NAME(CONSTANT, ROW, NAME) NAME,
    static const char *const names[RN_EFFECT_COUNT] = {RN_EFFECTS(RN_EFFECT_NAME)};
#undef RN_EFFECT_NAME
    return names[effect];
}

#endif
