// A Gaussian's footprint on a plane, and the ripmap levels it asks for (paper, section 3.3).
#ifndef RN_ENGINE_FIELD_FOOTPRINT_H
#define RN_ENGINE_FIELD_FOOTPRINT_H

#include <stdbool.h>

#include "server/engine/field/real.h"

// Half the footprint's extent in standard deviations: 2 * RN_FOOTPRINT_SCALE * sigma spans the
// texel of the chosen level.
#define RN_FOOTPRINT_SCALE 2

// Variance along a unit axis x of the Gaussian with variance `axial` along the unit direction d
// and `radial` across it: axial (x.d)^2 + radial |x cross d|^2. Never negative. The cross product
// is taken as differences of products and the dot product with its rounding carried along, so an
// axis within an ULP of parallel or of orthogonal keeps its relative accuracy: within 8 ULP of the
// Gaussian as represented, for standard deviations up to 1e8 apart.
RN_HD rn_real rn_projected_variance(const rn_real x[3], const rn_real d[3], rn_real axial,
                                    rn_real radial) {
    rn_real dot = rn_dot3(x, d);
    rn_real c0 = rn_difference_of_products(x[1], d[2], x[2], d[1]);
    rn_real c1 = rn_difference_of_products(x[2], d[0], x[0], d[2]);
    rn_real c2 = rn_difference_of_products(x[0], d[1], x[1], d[0]);
    return axial * (dot * dot) + radial * (c0 * c0 + c1 * c1 + c2 * c2);
}

// What of it is the same all along a ray in direction d: (x.d)^2 and |x cross d|^2. Their sum with
// a sample's variances, in fp32, is within 8 ULP.
RN_HD void rn_variance_factors(const rn_real x[3], const rn_real d[3], float *ret_axial,
                               float *ret_radial) {
    *ret_axial = (float)rn_projected_variance(x, d, 1, 0);
    *ret_radial = (float)rn_projected_variance(x, d, 0, 1);
}

// No sample of a ray has larger variances along and across it where samples are `step` wide and the
// cone's radius is `far` at its end: h^2 / 3 and 3/20 .. 1/4 of r^2 t^2 (frustum.h), and some more.
RN_HD void rn_variance_bounds(float far, float step, float *ret_axial, float *ret_radial) {
    *ret_axial = step * step / 12 * 1.01f;
    *ret_radial = far * far * 0.26f + step * step * 0.05f;
}

// Whether a sample of a ray through unbounded space may ask for more than level 0, planes of `size`
// texels: a footprint's radius is at most that of the cone at half the camera's distance from the
// ray's `foot`, the point nearest to the centre, and 1 more, as lengths at a distance s are drawn
// together by 1 / s or more; a step is at most 1/2 and the distance from the centre at which the
// ray passes it times as long as one through the centre.
RN_HD bool rn_contracted_leveled(const float foot[3], float near, float cone, float step, int size,
                                 bool by_axis) {
    float radius = (0.5f * fabsf(near) + 1) * cone;
    if (!by_axis) return radius * (float)size > 1;
    float passes = sqrtf(foot[0] * foot[0] + foot[1] * foot[1] + foot[2] * foot[2]);
    float length = (0.5f + passes) * 2 * step, limit = 1 / (RN_FOOTPRINT_SCALE * (float)size);
    return radius * radius * 0.26f + length * length * 0.085f > limit * limit;
}

// Levels that footprints ask for, in [0, levels - 1]. Of a Gaussian whose variance along an axis is
// sigma^2 in the frame where the plane spans [-1, 1], `size` texels a side: log2(RN_FOOTPRINT_SCALE
// * sigma * size). (The paper's equation leaves out the size; the released code has it.) For the
// isotropic ablation, one for both axes of every plane: log2 of the ball that the cone's
// cross-section spans, in texels. What goes into the logarithm is clamped, not the level: never NaN
// or infinite, continuous at both ends, 0 for NaN. Error: 2 ULP of max(1, level).
// One pair of functions a type, numbers or vectors that hold a sample a lane: CLAMP(x, low, high)
// gives `low` for NaN, constants are of type NUMBER; WHERE is RN_HD, or RN_DEVICE where CLAMP and
// LOG2 are a GPU's alone.
#define RN_LEVEL_FUNCTIONS(WHERE, OF_VARIANCE, OF_BALL, TYPE, NUMBER, CLAMP, LOG2)                 \
    WHERE TYPE OF_VARIANCE(TYPE variance, int size, int levels) {                                  \
        NUMBER unit = (NUMBER)RN_FOOTPRINT_SCALE * (NUMBER)size;                                   \
        NUMBER top = (NUMBER)(1u << (2 * (levels - 1)));                                           \
        return (NUMBER)0.5 * LOG2(CLAMP(variance * (unit * unit), (NUMBER)1, top));                \
    }                                                                                              \
    WHERE TYPE OF_BALL(TYPE texels, int levels) {                                                  \
        return LOG2(CLAMP(texels, (NUMBER)1, (NUMBER)(1u << (levels - 1))));                       \
    }
RN_LEVEL_FUNCTIONS(RN_HD, rn_level_from_variance, rn_level_from_ball, rn_real, rn_real, rn_clamp,
                   log2)

#endif
