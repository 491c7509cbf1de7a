// A forward-facing space (field/disparity.h) in vectors: rays cut to its box, and where a sample
// lies and how wide its cone is there. Error bounds: tests/numerics/space.c.
#ifndef RN_ENGINE_CPU_FORWARD_H
#define RN_ENGINE_CPU_FORWARD_H

#include "server/engine/cpu/simd.h"
#include "server/engine/kernels/ray.h"

// RN_VD rays as they are cut; all 0 but the stride, 1, where a ray misses.
struct cut_lanes {
    vd origin[3], near, length, stride;
};

// rn_ray_cut_forward; `d` becomes the direction in the cube. All 0 where a ray misses.
RN_INLINE void cut_forward(const struct rn_disparity *space, const vd o[3], vd d[3], double step,
                           vd jitter, struct cut_lanes *ret) {
    vl hit = d[2] > RN_FORWARD_LEAST;
    vd along = 1.0 / vd_select(hit, d[2], vd_set(1)), base[3], slope[3], norm = vd_set(0);
    vd low = vd_set(1 / space->far), high = vd_set(1 / space->near);
    for (int i = 0; i < 3; i++) {
        vd u = d[i] * along;
        base[i] = i < 2 ? space->scale[i] * u + space->shift[i] : vd_set(space->shift[i]);
        slope[i] = i < 2 ? space->scale[i] * (o[i] - o[2] * u) : vd_set(space->scale[i]);
        norm += slope[i] * slope[i];
    }
    vl ahead = o[2] > 0.0;
    vd own = vd_select(ahead, 1.0 / vd_select(ahead, o[2], vd_set(1)), high);
    high = vd_select(own < high, own, high);
    for (int i = 0; i < 2; i++) {
        vl sign = (vl)slope[i] & (vl)vd_set(-0.0), tiny = (vd)((vl)slope[i] ^ sign) < 1e-300;
        vd s = 1.0 / vd_select(tiny, (vd)((vl)vd_set(1e-300) | sign), slope[i]);
        vd a = (-space->half[i] - base[i]) * s, b = (space->half[i] - base[i]) * s;
        vd first = vd_select(a < b, a, b), last = vd_select(a < b, b, a);
        low = vd_select(first > low, first, low);
        high = vd_select(last < high, last, high);
    }
    hit &= high > low;
    norm = vd_sqrt(norm);
    vd begin = high - jitter * step / norm;
    for (int i = 0; i < 3; i++) {
        ret->origin[i] = (vd)((vl)(base[i] + slope[i] * begin) & hit);
        d[i] = (vd)((vl)(-slope[i] / norm) & hit);
    }
    ret->near = (vd)((vl)((1.0 / begin - o[2]) * along) & hit);
    ret->length = (vd)((vl)((begin - low) * norm) & hit);
    ret->stride = vd_set(1);
}

RN_FORWARD_FUNCTION(RN_INLINE, forward_sample, vf)

// A cone's largest radius along a ray: at one of its ends, as it is linear in 1 / z.
RN_INLINE float widest_forward(const struct rn_forward_line *line, float length) {
    vf s = vf_set(0), distance, width;
    s[1] = length;
    forward_sample(line, s, &distance, &width);
    return width[0] > width[1] ? width[0] : width[1];
}

#endif
