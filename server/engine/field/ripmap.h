// Ripmaps: anisotropic pyramids of one learnable base grid (paper, section 3.3).
//
// Map (lx, ly) of a base of size n has rip_size(n, lx) columns and rip_size(n, ly) rows: each
// axis is pooled on its own. Even sizes pool by the two-tap mean; odd sizes 2m+1 by three taps
// whose weights keep the texels registered (Guthe & Heckbert 2005), so any size works and the
// order of the axes does not matter.
#ifndef RN_ENGINE_FIELD_RIPMAP_H
#define RN_ENGINE_FIELD_RIPMAP_H

#include <stdbool.h>
#include <stddef.h>

#include "server/engine/field/real.h"

// Texels a side after `level` poolings: halved, rounded down, at least 1.
RN_HD int rn_rip_size(int base, int level) {
    int size = base >> level;
    return size > 0 ? size : 1;
}

// The taps of pooled texel i of a line of `size` texels: *ret_first and up to three weights that
// sum to 1 (weights and sum within 1 ULP of 1); returns their count.
RN_HD int rn_rip_taps(int size, int i, int *ret_first, rn_real weight[3]) {
    if (size == 1) {
        *ret_first = 0;
        weight[0] = 1;
        return 1;
    }
    *ret_first = 2 * i;
    if (size % 2 == 0) {
        weight[0] = weight[1] = (rn_real)0.5;
        return 2;
    }
    int m = size / 2;
    weight[0] = (rn_real)(m - i) / (rn_real)size;
    weight[1] = (rn_real)m / (rn_real)size;
    weight[2] = (rn_real)(i + 1) / (rn_real)size;
    return 3;
}

// Linear interpolation along one axis: texels low, low + 1 and the weight of the second.
struct rn_lerp {
    int low, high;
    rn_real fraction;
};

// Where coordinate p in [-1, 1] falls on a line of `texels` texels with centres at (i + 1/2) /
// texels: the texel before it and the weight of the next; clamped to the edge texels outside, NaN
// at the low edge. low + fraction: error at most 2 ULP of `texels`. One function a type, numbers or
// vectors that hold a sample a lane: CONSTANT(x) is one of it, WHOLE(x) drops the fraction of x >=
// 0, MAX(NaN, x) is x.
#define RN_TEXEL_FUNCTION(NAME, TYPE, CONSTANT, MIN, MAX, WHOLE)                                   \
    RN_HD void NAME(TYPE p, TYPE texels, TYPE *ret_low, TYPE *ret_fraction) {                      \
        TYPE half = CONSTANT(0.5) * texels, x = p * half + (half - CONSTANT(0.5));                 \
        x = MIN(MAX(x, CONSTANT(0)), texels - CONSTANT(1));                                        \
        *ret_low = MIN(WHOLE(x), MAX(texels - CONSTANT(2), CONSTANT(0)));                          \
        *ret_fraction = x - *ret_low;                                                              \
    }
RN_TEXEL_FUNCTION(rn_rip_texel, rn_real, (rn_real), rn_min, rn_max, (rn_real)(int))

RN_HD struct rn_lerp rn_rip_lerp(rn_real p, int size) {
    rn_real low, fraction;
    rn_rip_texel(p, (rn_real)size, &low, &fraction);
    struct rn_lerp out = {(int)low, (int)low + 1 < size ? (int)low + 1 : (int)low, fraction};
    return out;
}

// The two levels around `level` in [0, levels - 1] and the weight of the upper.
RN_HD struct rn_lerp rn_rip_level(rn_real level, int levels) {
    struct rn_lerp out;
    rn_real x = rn_clamp(level, 0, (rn_real)(levels - 1));
    out.low = (int)x;
    out.high = out.low + 1 < levels ? out.low + 1 : out.low;
    out.fraction = x - (rn_real)out.low;
    return out;
}

// The weight of one of the four maps of a query between levels x and y: bit 0 of `corner` is the
// upper level along x, bit 1 along y. A mipmap has square maps alone, told apart along one axis.
RN_HD rn_real rn_rip_map_weight(const struct rn_lerp *x, const struct rn_lerp *y, bool mip,
                                int corner) {
    rn_real along_x = corner & 1 ? x->fraction : 1 - x->fraction;
    rn_real along_y = corner & 2 ? y->fraction : 1 - y->fraction;
    if (!mip) return along_x * along_y;
    return corner == 0 || corner == 3 ? along_x : 0;
}

#endif
