// Where along a ray the samples lie, and what space does to them there (cpu/space.h and
// cpu/forward.h have the same by vectors).
#ifndef RN_ENGINE_CUDA_SPACE_CUH
#define RN_ENGINE_CUDA_SPACE_CUH

#include "server/engine/cuda/scene.cuh"
#include "server/engine/field/footprint.h"

RN_DEVICE float rn_clamp_lane(float x, float low, float high) {
    return fminf(fmaxf(x, low), high); // NaN gives low
}
RN_DEVICE float rn_choose_lane(bool first, float x, float y) {
    return first ? x : y;
}

struct rn_contraction_lane {
    float scale, across, along;
};
RN_CONTRACTION_FUNCTION(RN_DEVICE, rn_contraction_at_lane, struct rn_contraction_lane, float,
                        (float), fmaxf)
RN_CONTRACTED_FUNCTIONS(RN_DEVICE, rn_contracted_variance_lane, rn_contracted_level_lane,
                        struct rn_contraction_lane, float, (float), fmaxf, rn_clamp_lane, rn_log2)
RN_DISTANCE_FUNCTION(RN_DEVICE, rn_distance_of_place_lane, float, (float), fmaxf, fabsf,
                     rn_choose_lane)
RN_PLACE_FUNCTION(RN_DEVICE, rn_place_of_distance_lane, float, fabsf, copysignf)
RN_FORWARD_FUNCTION(RN_DEVICE, rn_forward_lane, float)

// How far behind the ray's origin the middle of sample `index` lies, of samples `step` wide.
template <int WORLD>
RN_DEVICE float rn_middle(const struct rn_march_ray *ray, int index, float step) {
    float k = (float)index + 0.5f;
    if (WORLD != RN_WORLD_UNBOUNDED) return k * step;
    return rn_distance_of_place_lane(k * (2 * step) + (2 - ray->length));
}

// What the contraction does at `s` behind the origin.
RN_DEVICE struct rn_contraction_lane rn_lengths_at(const struct rn_march_ray *ray, float s) {
    float squares = 0;
    for (int i = 0; i < 3; i++) {
        float p = ray->direction[i] * s + ray->origin[i];
        squares += p * p;
    }
    return rn_contraction_at_lane(rn_root(squares));
}

#endif
