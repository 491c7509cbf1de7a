// The effects that a scene may call for. What each measures and does is in server/engine/effects.
#ifndef RN_COMMON_SETTINGS_EFFECTS_H
#define RN_COMMON_SETTINGS_EFFECTS_H

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
    X(APPEARANCE, appearance, "appearance")                                                        \
    X(FORWARD_FACING, forward_facing, "forward-facing")                                            \
    X(UNBOUNDED, unbounded, "unbounded")                                                           \
    X(STRAIGHT_ALPHA, straight_alpha, "straight-alpha")                                            \
    X(POSE_REFINEMENT, pose_refinement, "pose-refinement")                                         \
    X(ROBUST_LOSS, robust_loss, "robust-loss")                                                     \
    X(DOWNSCALING, downscaling, "downscaling")

#define RN_EFFECT_CONSTANT(CONSTANT, ROW, NAME) RN_EFFECT_##CONSTANT,
enum rn_effect { RN_EFFECTS(RN_EFFECT_CONSTANT) RN_EFFECT_COUNT };
#undef RN_EFFECT_CONSTANT

// Auto: as the data calls for.
enum rn_effect_choice { RN_EFFECT_AUTO, RN_EFFECT_WANTED, RN_EFFECT_UNWANTED };
extern const char *const rn_effect_choice_names[]; // "auto", "on", "off"

static inline const char *rn_effect_name(enum rn_effect effect) {
#define RN_EFFECT_NAME(CONSTANT, ROW, NAME) NAME,
    static const char *const names[RN_EFFECT_COUNT] = {RN_EFFECTS(RN_EFFECT_NAME)};
#undef RN_EFFECT_NAME
    return names[effect];
}

#endif
