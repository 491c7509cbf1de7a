// Marching: which of a ray's samples lie in occupied cells.
#ifndef RN_ENGINE_CPU_MARCH_H
#define RN_ENGINE_CPU_MARCH_H

#include "server/engine/cpu/simd.h"
#include "server/engine/cpu/space.h"
#include "server/engine/kernels/kernels.h"

#define RN_MARCH_FAR 1000000 // an index behind every ray's end

// First march index whose middle lies at or behind `s`.
RN_INLINE vi index_at(vf s, float inverse_step) {
    vf k = s * inverse_step - 0.5f;
    return (vi_from_float(vf_clamp(k, 0.0f, RN_MARCH_FAR - 1)) + 1) & (k > 0.0f);
}

// Bricks a side, a power of two, as its logarithm.
RN_INLINE int brick_bits(const struct rn_occupancy_bits *o) {
    return __builtin_ctz((unsigned)(o->cells / RN_BRICK));
}

// RN_VL rays on their way, one a lane, in units of bricks: brick coordinate = at + along * s.
// `inverse` of a direction that is none is 0, and takes no part. Steps [k, end) are still to do.
struct march_lanes {
    vf at[3], along[3], inverse[3];
    vi k, end;
};

// Restricts [k, end) to the box around all occupied cells.
RN_INLINE void clip_to_box(const struct rn_occupancy_bits *o, vf length, float inverse_step,
                           struct march_lanes *l) {
    vf enter = vf_set(0), leave = length;
    float half = 0.5f * (float)(o->cells / RN_BRICK);
    for (int i = 0; i < 3; i++) {
        float low = (o->low[i] + 1) * half, high = (o->high[i] + 1) * half;
        vf a = (low - l->at[i]) * l->inverse[i], b = (high - l->at[i]) * l->inverse[i];
        vi crosses = l->inverse[i] != 0.0f, beside = (l->at[i] < low) | (l->at[i] > high);
        vf first = vf_select(crosses, vf_min(a, b), vf_set(0));
        vf last = vf_select(crosses, vf_max(a, b), vf_select(beside, vf_set(-1), leave));
        enter = vf_max(first, enter);
        leave = vf_min(last, leave);
    }
    vi begin = index_at(enter, inverse_step) - 1, end = index_at(leave, inverse_step) + 1;
    l->k = vi_select(begin > 0, begin, vi_set(0));
    l->end = vi_select(end < l->end, end, l->end) & (leave > enter);
}

// Through unbounded space rays are bent: every step is looked at.
static void march_start_unbounded(const struct rn_occupancy_bits *o,
                                  const struct rn_march_ray *rays, int n, float step,
                                  struct march_lanes *l) {
    memset(l, 0, sizeof *l);
    for (int j = 0; j < n && o->low[0] <= o->high[0]; j++)
        if (rays[j].length > 0) l->end[j] = (int)(rays[j].length / (2 * step));
}

// Puts `n` rays, at most RN_VL, at their first step inside the box; lanes behind them have ended.
static void march_start(const struct rn_occupancy_bits *o, const struct rn_march_ray *rays, int n,
                        float step, struct march_lanes *l) {
    float half = 0.5f * (float)(o->cells / RN_BRICK), inverse_step = 1 / step;
    vf length = vf_set(0);
    if (o->space == RN_SPACE_UNBOUNDED) {
        march_start_unbounded(o, rays, n, step, l);
        return;
    }
    for (int i = 0; i < 3; i++) {
        vf origin = vf_set(0), d = vf_set(0);
        for (int j = 0; j < n; j++) {
            origin[j] = rays[j].origin[i];
            d[j] = rays[j].direction[i];
        }
        l->at[i] = (origin + 1.0f) * half;
        l->along[i] = d * half;
        l->inverse[i] = vf_bits(vi_bits(1.0f / l->along[i]) & (vf_abs(d) > 1e-12f));
    }
    for (int j = 0; j < n; j++)
        length[j] = rays[j].length;
    vi end = index_at(length, inverse_step);
    l->end = vi_select(end > 65535, vi_set(65535), end);
    l->k = vi_set(0);
    if (o->low[0] > o->high[0]) l->end = vi_set(0);
    clip_to_box(o, length, inverse_step, l);
}

// Moves the lanes of `go` out of empty bricks, each to a step in an occupied one or to its end.
// Returns those that have not ended. Terminates: every turn advances some lane.
static vi march_land(const struct rn_occupancy_bits *o, float step, vi go, struct march_lanes *l) {
    int side = brick_bits(o);
    float top = (float)((1 << side) - 1), inverse_step = 1 / step;
    if (o->space == RN_SPACE_UNBOUNDED) return go & (l->k < l->end);
    for (;;) {
        vi brick[3], index = vi_set(0);
        vf at[3], s = (vf_from_int(l->k) + 0.5f) * step, leave = vf_set(1e30f);
        for (int i = 0; i < 3; i++) {
            at[i] = l->at[i] + l->along[i] * s;
            brick[i] = vi_from_float(vf_clamp(at[i], 0.0f, top));
            index = index << side | brick[i];
        }
        go &= l->k < l->end;
        vi distance = vi_gather_bytes(o->distance, index), empty = go & (distance > 0);
        if (!vi_mask_bits(empty)) return go;
        for (int i = 0; i < 3; i++) {
            vi face = vi_select(l->along[i] > 0.0f, brick[i] + distance, brick[i] - distance + 1);
            vf e = (vf_from_int(face) - at[i]) * l->inverse[i];
            leave = vf_min(vf_select(l->inverse[i] != 0.0f, e, vf_set(1e30f)), leave);
        }
        vi next = index_at(s + leave, inverse_step), after = l->k + 1;
        next = vi_select(next > l->k, next, after);
        l->k = vi_select(empty, next, l->k);
    }
}

// Bits of the samples k .. k + RN_VL - 1 that lie in occupied cells.
RN_INLINE unsigned test_cells(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray,
                              int k, float step) {
    vf s = (vf_iota() + ((float)k + 0.5f)) * step, scale = vf_set(1);
    float half = 0.5f * (float)o->cells, top = (float)(o->cells - 1);
    vi cell[3];
    if (o->space == RN_SPACE_UNBOUNDED) {
        s = unbounded_distance(ray, vf_iota() + (float)k, step);
        scale = contraction_at(distance_from_centre(ray, s)).scale;
    }
    for (int i = 0; i < 3; i++) {
        vf p = (ray->direction[i] * s + ray->origin[i]) * scale;
        cell[i] = vi_from_float(vf_clamp(p * half + half, 0.0f, top));
    }
    int side = brick_bits(o);
    vi brick = (((cell[0] >> 3) << side | cell[1] >> 3) << side) | cell[2] >> 3;
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

// Writes the indices of the samples among the RN_CHUNK steps from `from` on, of which those of
// `bits` lie in occupied cells, but for one that is written already: sample *last. A sample that
// spans several steps is there when any of them lies in an occupied cell. Returns how many; may
// write RN_CHUNK numbers.
RN_INLINE int write_chunk(unsigned bits, int shift, int from, int end, int *last, uint16_t *ret_k) {
    if (end - from < RN_CHUNK) bits &= (1u << (end - from)) - 1;
    bits = first_steps(bits, shift);
    if (from >> shift == *last) bits &= ~1u;
    if (bits) *last = (from + 31 - __builtin_clz(bits)) >> shift;
    return write_samples(bits, from, shift, ret_k);
}

// Where RN_PACKET_RAYS rays stand. What they found lies in the workspace.
struct marches {
    struct march_lanes lanes[RN_PACKET_RAYS / RN_VL];
    const struct rn_march_ray *ray[RN_PACKET_RAYS]; // NULL: a free place, or one that has ended
    int last[RN_PACKET_RAYS];
};

// Looks at the next chunk of the rays g + j, bits j of `need`, a sample's steps together: those
// before it are empty, or written. All cells are looked up before the first answer is used. Returns
// the rays that still have fewer than `ahead` samples.
RN_INLINE unsigned march_chunks(const struct rn_occupancy_bits *o, float step, int ahead, int g,
                                unsigned need, struct marches *m, struct rn_workspace *w) {
    struct march_lanes *l = &m->lanes[g / RN_VL];
    unsigned bits[RN_VL];
    int from[RN_VL], shift[RN_VL];
    for (unsigned left = need; left; left &= left - 1) {
        int j = __builtin_ctz(left);
        shift[j] = __builtin_ctz((unsigned)m->ray[g + j]->stride);
        from[j] = l->k[j] >> shift[j] << shift[j];
        bits[j] = test_chunk(o, m->ray[g + j], from[j], step);
    }
    for (unsigned left = need; left; left &= left - 1) {
        int j = __builtin_ctz(left), r = g + j;
        uint16_t *found = w->candidate + (size_t)r * (size_t)w->room;
        w->candidate_count[r] += write_chunk(bits[j], shift[j], from[j], l->end[j], &m->last[r],
                                             found + w->candidate_count[r]);
        l->k[j] = from[j] + RN_CHUNK;
        if (w->candidate_count[r] - w->ray_next[r] >= ahead) need &= ~(1u << j);
    }
    return need;
}

// Marches on where fewer than `ahead` samples are found and not evaluated yet: to that many or the
// ray's end.
static void march_round(const struct rn_occupancy_bits *o, float step, int ahead, struct marches *m,
                        struct rn_workspace *w) {
    for (int g = 0; g < RN_PACKET_RAYS; g += RN_VL) {
        struct march_lanes *l = &m->lanes[g / RN_VL];
        unsigned need = 0;
        for (int r = g; r < g + RN_VL; r++)
            need |= (unsigned)(m->ray[r] && w->candidate_count[r] - w->ray_next[r] < ahead)
                    << (r - g);
        while (need && (need = vi_mask_bits(march_land(o, step, vi_mask_of(need), l))))
            need = march_chunks(o, step, ahead, g, need, m, w);
    }
}

#endif
