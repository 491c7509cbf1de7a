// Marching: which of a ray's samples lie in occupied cells.
#ifndef RN_ENGINE_CPU_MARCH_H
#define RN_ENGINE_CPU_MARCH_H

#include "server/engine/cpu/kernels.h"
#include "server/engine/cpu/simd.h"

// Distance along one axis from `at` to the face of [low, high] that the ray leaves through.
RN_INLINE float axis_exit(float at, float direction, float low, float high) {
    if (direction > 1e-12f) return (high - at) / direction;
    if (direction < -1e-12f) return (low - at) / direction;
    return 1e30f;
}

// First march index whose middle lies at or behind `s`.
RN_INLINE int index_at(float s, float inverse_step) {
    float k = s * inverse_step - 0.5f;
    return k <= 0 ? 0 : k < 1e6f ? (int)k + 1 : 1000000;
}

// Restricts [*begin, *end) to the box around all occupied cells.
static void clip_to_box(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray,
                        float inverse_step, int *begin, int *end) {
    float enter = 0, leave = ray->length;
    for (int i = 0; i < 3; i++) {
        float d = ray->direction[i], at = ray->origin[i];
        if (d > 1e-12f || d < -1e-12f) {
            float inverse = 1 / d, a = (o->low[i] - at) * inverse, b = (o->high[i] - at) * inverse;
            enter = a < b ? (a > enter ? a : enter) : (b > enter ? b : enter);
            leave = a < b ? (b < leave ? b : leave) : (a < leave ? a : leave);
        } else if (at < o->low[i] || at > o->high[i]) {
            leave = -1;
        }
    }
    if (!(leave > enter)) {
        *end = *begin;
        return;
    }
    int first = index_at(enter, inverse_step) - 1, last = index_at(leave, inverse_step) + 1;
    if (first > *begin) *begin = first;
    if (last < *end) *end = last;
}

// Index of the first sample behind the run of empty bricks around sample k.
RN_INLINE int skip_empty(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray, int k,
                         float step, float inverse_step, int *ret_distance) {
    int bricks = o->cells / RN_BRICK, index = 0;
    float at[3], s = ((float)k + 0.5f) * step, side = 2.0f / (float)bricks;
    int brick[3];
    for (int i = 0; i < 3; i++) {
        at[i] = ray->origin[i] + ray->direction[i] * s;
        float b = (at[i] + 1) * 0.5f * (float)bricks;
        brick[i] = b > 0 ? (b < (float)bricks ? (int)b : bricks - 1) : 0;
        index = index * bricks + brick[i];
    }
    int distance = o->distance[index];
    *ret_distance = distance;
    if (distance == 0) return k;
    float leave = 1e30f;
    for (int i = 0; i < 3; i++) {
        float low = (float)(brick[i] - distance + 1) * side - 1;
        float e = axis_exit(at[i], ray->direction[i], low, low + (float)(2 * distance - 1) * side);
        if (e < leave) leave = e;
    }
    int next = leave < 1e6f ? index_at(s + leave, inverse_step) : 1000000;
    return next > k ? next : k + 1;
}

// Bits of the samples k .. k + RN_VL - 1 that lie in occupied cells.
RN_INLINE unsigned test_cells(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray,
                              int k, float step) {
    vf s = (vf_iota() + ((float)k + 0.5f)) * step;
    float half = 0.5f * (float)o->cells, top = (float)(o->cells - 1);
    vi cell[3];
    for (int i = 0; i < 3; i++) {
        vf p = ray->direction[i] * s + ray->origin[i];
        cell[i] = vi_from_float(vf_clamp(p * half + half, 0.0f, top));
    }
    int bricks = o->cells / RN_BRICK;
    vi brick = ((cell[0] >> 3) * bricks + (cell[1] >> 3)) * bricks + (cell[2] >> 3);
    vi word = brick * 16 + (cell[2] & 7) * 2 + ((cell[1] >> 2) & 1);
    vi bit = (cell[1] & 3) * 8 + (cell[0] & 7);
    vi bits = vi_gather((const int32_t *)o->words, word);
    return vi_mask_bits(((bits >> bit) & 1) != 0);
}

// Writes the indices of the ray's samples in occupied cells, in order, at most `room`. A sample
// that spans several steps is there when any of them lies in an occupied cell. Terminates: every
// turn advances k.
static int march(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray, float step,
                 uint16_t *ret_k, int room) {
    if (!(ray->length > 0) || o->low[0] > o->high[0]) return 0;
    float inverse_step = 1 / step;
    int shift = __builtin_ctz((unsigned)ray->stride), last = -1;
    int begin = 0, end = index_at(ray->length, inverse_step), count = 0, distance;
    if (end > 65535) end = 65535;
    clip_to_box(o, ray, inverse_step, &begin, &end);
    for (int k = begin; k < end && count < room;) {
        int next = skip_empty(o, ray, k, step, inverse_step, &distance);
        if (distance > 0) {
            k = next;
            continue;
        }
        unsigned bits = test_cells(o, ray, k, step);
        if (end - k < RN_VL) bits &= (1u << (end - k)) - 1;
        for (; bits && count < room; bits &= bits - 1) {
            int sample = (k + __builtin_ctz(bits)) >> shift;
            if (sample != last) ret_k[count++] = (uint16_t)sample;
            last = sample;
        }
        k += RN_VL;
    }
    return count;
}

#endif
