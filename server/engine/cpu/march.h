// Marching: which of a ray's samples lie in occupied cells.
#ifndef RN_ENGINE_CPU_MARCH_H
#define RN_ENGINE_CPU_MARCH_H

#include "server/engine/cpu/kernels.h"
#include "server/engine/cpu/simd.h"

// First march index whose middle lies at or behind `s`.
RN_INLINE int index_at(float s, float inverse_step) {
    float k = s * inverse_step - 0.5f;
    return k <= 0 ? 0 : k < 1e6f ? (int)k + 1 : 1000000;
}

// A ray in units of bricks: brick coordinate = at + along * s. `inverse` of a direction that is
// none is 0, and takes no part.
struct brick_ray {
    float at[3], along[3], inverse[3];
};

static void brick_ray_init(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray,
                           struct brick_ray *ret) {
    float half = 0.5f * (float)(o->cells / RN_BRICK);
    for (int i = 0; i < 3; i++) {
        float d = ray->direction[i];
        ret->at[i] = (ray->origin[i] + 1) * half;
        ret->along[i] = d * half;
        ret->inverse[i] = d > 1e-12f || d < -1e-12f ? 1 / (d * half) : 0;
    }
}

// Restricts [*begin, *end) to the box around all occupied cells.
static void clip_to_box(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray,
                        const struct brick_ray *bricks, float inverse_step, int *begin, int *end) {
    float enter = 0, leave = ray->length, half = 0.5f * (float)(o->cells / RN_BRICK);
    for (int i = 0; i < 3; i++) {
        float low = (o->low[i] + 1) * half, high = (o->high[i] + 1) * half;
        if (bricks->inverse[i] != 0) {
            float a = (low - bricks->at[i]) * bricks->inverse[i];
            float b = (high - bricks->at[i]) * bricks->inverse[i];
            float first = a < b ? a : b, last = a < b ? b : a;
            enter = first > enter ? first : enter;
            leave = last < leave ? last : leave;
        } else if (bricks->at[i] < low || bricks->at[i] > high) {
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
RN_INLINE int skip_empty(const struct rn_occupancy_bits *o, const struct brick_ray *ray, int k,
                         float step, float inverse_step, int *ret_distance) {
    int bricks = o->cells / RN_BRICK, index = 0, brick[3];
    float at[3], s = ((float)k + 0.5f) * step, top = (float)(bricks - 1);
    for (int i = 0; i < 3; i++) {
        at[i] = ray->at[i] + ray->along[i] * s;
        float b = at[i] > 0 ? at[i] : 0;
        brick[i] = (int)(b < top ? b : top);
        index = index * bricks + brick[i];
    }
    int distance = o->distance[index];
    *ret_distance = distance;
    if (distance == 0) return k;
    float leave = 1e30f;
    for (int i = 0; i < 3; i++) {
        int face = ray->along[i] > 0 ? brick[i] + distance : brick[i] - distance + 1;
        float e = ((float)face - at[i]) * ray->inverse[i];
        e = ray->inverse[i] != 0 ? e : 1e30f;
        leave = e < leave ? e : leave;
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

#define RN_CHUNK (RN_VL < 8 ? 8 : RN_VL) // steps looked at together: whole samples

// Bits of the steps k .. k + RN_CHUNK - 1 that lie in occupied cells.
RN_INLINE unsigned test_chunk(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray,
                              int k, float step) {
    unsigned bits = test_cells(o, ray, k, step);
    if (RN_CHUNK > RN_VL) bits |= test_cells(o, ray, k + RN_VL, step) << RN_VL;
    return bits;
}

// Writes (k + i) >> shift for every bit i, in order; returns how many. May write RN_CHUNK numbers.
RN_INLINE int write_samples(unsigned bits, int k, int shift, uint16_t *ret_k) {
#if RN_VL == 16
    __m512i index =
        _mm512_add_epi32(_mm512_set1_epi32(k),
                         _mm512_set_epi32(15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0));
    index = _mm512_srl_epi32(index, _mm_cvtsi32_si128(shift));
    index = _mm512_maskz_compress_epi32((__mmask16)bits, index);
    _mm256_storeu_si256((__m256i *)ret_k, _mm512_cvtepi32_epi16(index));
    return __builtin_popcount(bits);
#else
    int count = 0;
    for (; bits; bits &= bits - 1)
        ret_k[count++] = (uint16_t)((k + __builtin_ctz(bits)) >> shift);
    return count;
#endif
}

// Of steps in occupied cells, `bits` from step k on (a multiple of 2^shift), the first of each
// sample: a sample of several steps is there when any of them is.
RN_INLINE unsigned first_steps(unsigned bits, int shift) {
    static const unsigned firsts[4] = {0xffff, 0x5555, 0x1111, 0x0101};
    if (shift > 0) bits |= bits >> 1;
    if (shift > 1) bits |= bits >> 2;
    if (shift > 2) bits |= bits >> 4;
    return bits & firsts[shift];
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
    struct brick_ray bricks;
    brick_ray_init(o, ray, &bricks);
    clip_to_box(o, ray, &bricks, inverse_step, &begin, &end);
    for (int k = begin; k < end && count < room;) {
        int next = skip_empty(o, &bricks, k, step, inverse_step, &distance);
        if (distance > 0) {
            k = next;
            continue;
        }
        k = k >> shift << shift; // a sample's steps together; those before are empty or repeated
        unsigned bits = test_chunk(o, ray, k, step);
        if (end - k < RN_CHUNK) bits &= (1u << (end - k)) - 1;
        bits = first_steps(bits, shift);
        if (k >> shift == last) bits &= ~1u;
        if (bits) last = (k + 31 - __builtin_clz(bits)) >> shift;
        uint16_t some[RN_CHUNK]; // where a vector would reach over the room
        bool over = room - count < RN_CHUNK;
        int n = write_samples(bits, k, shift, over ? some : ret_k + count);
        if (over) {
            n = n < room - count ? n : room - count;
            memcpy(ret_k + count, some, (size_t)n * sizeof *some);
        }
        count += n;
        k += RN_CHUNK;
    }
    return count;
}

#endif
