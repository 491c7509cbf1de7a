// Unbounded space (field/space.h) in vectors of fp32.
#ifndef RN_ENGINE_CPU_SPACE_H
#define RN_ENGINE_CPU_SPACE_H

#include "server/engine/cpu/simd.h"
#include "server/engine/kernels/kernels.h"

// As struct rn_contraction.
struct contraction_lanes {
    vf scale, across, along;
};

// As rn_contraction_at: each within 4 ULP for r up to 1e12.
RN_INLINE struct contraction_lanes contraction_at(vf r) {
    vf inverse = 1.0f / vf_max(r, vf_set(1.0f)), half = 0.5f * inverse;
    vf across = half * (2.0f - inverse);
    return (struct contraction_lanes){across, across, half * inverse};
}

// As rn_distance_of_place; a place within 1e-6 of the end is taken for that.
RN_INLINE vf distance_of_place(vf place) {
    vf size = vf_abs(place), far = 1.0f / vf_max(2.0f - size, vf_set(1e-6f));
    return vf_select(size <= 1.0f, place, vf_select(place < 0.0f, -far, far));
}

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
