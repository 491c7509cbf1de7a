// Ripmaps: anisotropic pyramids of one learnable base grid (paper, section 3.3).
//
// Map (lx, ly) of a base of size n has rip_size(n, lx) columns and rip_size(n, ly) rows: each
// axis is pooled on its own. Even sizes pool by the two-tap mean; odd sizes 2m+1 by three taps
// whose weights keep the texels registered (Guthe & Heckbert 2005), so any size works and the
// order of the axes does not matter.
#ifndef RN_ENGINE_FIELD_RIPMAP_H
#define RN_ENGINE_FIELD_RIPMAP_H

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

// Coordinate p in [-1, 1] on a line of `size` texels with centres at (i + 1/2) / size; clamped to
// the edge texels outside; NaN goes to the low edge. low + fraction: error at most 2 ULP of `size`.
RN_HD struct rn_lerp rn_rip_lerp(rn_real p, int size) {
    struct rn_lerp out;
    rn_real x =
        rn_clamp((p + 1) * (rn_real)0.5 * (rn_real)size - (rn_real)0.5, 0, (rn_real)(size - 1));
    int low = (int)x;
    if (low > size - 2) low = size - 2 > 0 ? size - 2 : 0;
    out.low = low;
    out.high = low + 1 < size ? low + 1 : low;
    out.fraction = x - (rn_real)low;
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

#endif
