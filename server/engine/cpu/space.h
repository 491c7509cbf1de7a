// Unbounded space (field/space.h) in vectors of fp32.
#ifndef RN_ENGINE_CPU_SPACE_H
#define RN_ENGINE_CPU_SPACE_H

#include "server/engine/cpu/simd.h"
#include "server/engine/kernels/kernels.h"

// As struct rn_contraction.
struct contraction_lanes {
    vf scale, across, along;
};

RN_CONTRACTION_FUNCTION(RN_INLINE, contraction_at, struct contraction_lanes, vf, vf_set, vf_max)
RN_CONTRACTED_FUNCTIONS(RN_INLINE, contracted_variance, contracted_ball_level,
                        struct contraction_lanes, vf, vf_set, vf_max, vf_clamp, vf_log2)
RN_DISTANCE_FUNCTION(RN_INLINE, distance_of_place, vf, vf_set, vf_max, vf_abs, vf_select)

// From the ray's origin to the middle of its steps `k`.
RN_INLINE vf unbounded_distance(const struct rn_march_ray *ray, vf k, float step) {
    return distance_of_place((k + 0.5f) * (2 * step) + (2 - ray->length));
}

RN_INLINE vf distance_from_centre(const struct rn_march_ray *ray, vf s) {
    vf squares = vf_set(0);
    for (int i = 0; i < 3; i++) {
        vf p = ray->direction[i] * s + ray->origin[i];
        squares += p * p;
    }
    return vf_sqrt(squares);
}

#endif
