// Reading texels: where samples look in a plane's maps, and their features (paper, section 3.3).
// Features of constant planes are the constant within 4 ULP; one ULP of a position or level across
// a border of texels or levels moves a feature, or a texel's weight, by at most 8 ULP of the base
// (the condition number of a position: an ULP of it is base / 2 ULP of a texel).
#ifndef RN_ENGINE_CPU_FETCH_H
#define RN_ENGINE_CPU_FETCH_H

#include <stdbool.h>

#include "server/engine/cpu/features.h"
#include "server/engine/field/ripmap.h"

RN_INLINE vf vf_whole(vf x) {
    return vf_from_int(vi_from_float(x));
}
RN_TEXEL_FUNCTION(texel_lanes, vf, vf_set, vf_min, vf_max, vf_whole)

// The same on a line of one size.
RN_INLINE void lerp_vector(vf p, int size, vi *ret_low, vf *ret_fraction) {
    vf low;
    texel_lanes(p, vf_set((float)size), &low, ret_fraction);
    *ret_low = vi_from_float(low);
}

// Where RN_VL samples look on one axis of a pyramid: level, weight of the next level, and at both
// levels the map's size, the texel and the weight of its neighbour.
struct axis_lookup {
    vi level, size[2], low[2];
    vf upper, fraction[2];
};

RN_INLINE void look_up_axis(vf p, vf level, int base, struct axis_lookup *ret) {
    vi whole = vi_from_float(level);
    ret->level = whole;
    ret->upper = level - vf_from_int(whole);
    for (int i = 0; i < 2; i++) {
        vf texels = vf_max(vf_from_int(base >> (whole + i)), vf_set(1)), low;
        texel_lanes(p, texels, &low, &ret->fraction[i]);
        ret->size[i] = vi_from_float(texels);
        ret->low[i] = vi_from_float(low);
    }
}

// The maps of a query: corner 0, and with weights between levels 1, 2 and 3 (bit 0 steps up along
// x, bit 1 along y), of which a mipmap has 3 alone.
#define RN_MAPS_RIP 4
#define RN_MAPS_MIP 2

// Where RN_VL samples look in the maps of one corner: which map, of maps[ly][lx]; the first of
// their four texels, and how far the row below is (0 where there is none); the texels' weights.
// Lanes without a weight are given a valid place too.
struct map_lookup {
    int32_t map[RN_VL], offset[RN_VL], row[RN_VL];
    float weight[4][RN_VL];
    unsigned active; // a bit a lane that has a weight
};

RN_INLINE void look_up_map(const struct axis_lookup *x, const struct axis_lookup *y, bool mip,
                           int corner, struct map_lookup *ret) {
    int up_x = corner & 1, up_y = corner >> 1;
    vf weight = up_x ? x->upper : 1.0f - x->upper;
    if (!mip) weight = weight * (up_y ? y->upper : 1.0f - y->upper);
    vi active = weight > 0.0f, level = y->level * RN_MAX_LEVELS + x->level;
    if (corner) level += active & (up_y * RN_MAX_LEVELS + up_x);
    vi_store(ret->map, level);
    vi_store(ret->offset, y->low[up_y] * x->size[up_x] + x->low[up_x]);
    vi_store(ret->row, x->size[up_x] & (y->size[up_y] > 1));
    vf right = x->fraction[up_x], below = y->fraction[up_y] * weight;
    vf above = weight - below;
    vf_store(ret->weight[0], above - above * right);
    vf_store(ret->weight[1], above * right);
    vf_store(ret->weight[2], below - below * right);
    vf_store(ret->weight[3], below * right);
    ret->active = vi_mask_bits(active);
}

// All of a query's maps; returns their count.
RN_INLINE int look_up_maps(const struct axis_lookup *x, const struct axis_lookup *y, bool mip,
                           struct map_lookup ret[RN_MAPS_RIP]) {
    look_up_map(x, y, mip, 0, &ret[0]);
    if (mip) {
        look_up_map(x, y, true, 3, &ret[1]);
        return RN_MAPS_MIP;
    }
    look_up_map(x, y, false, 1, &ret[1]);
    look_up_map(x, y, false, 2, &ret[2]);
    look_up_map(x, y, false, 3, &ret[3]);
    return RN_MAPS_RIP;
}

// Asks for the lines of a texel, its right neighbour, and both in the row `below`. Of 8 channels
// and fewer the neighbour is on the same line or the next.
RN_INLINE void fetch_ahead(const float *texel, size_t below, int channels) {
    __builtin_prefetch(texel);
    __builtin_prefetch(texel + below);
    if (channels < 8) return;
    __builtin_prefetch(texel + channels);
    __builtin_prefetch(texel + below + channels);
}

// Where a few vectors of samples look in a map that is alone, found before any texel is read: what
// they will read is on its way to the cache by then.
#define RN_AHEAD (4 * RN_VL)
struct flat_lookup {
    int32_t offset[RN_AHEAD];
    float fx[RN_AHEAD], fy[RN_AHEAD];
};

RN_INLINE void look_up_flat(const struct rn_map *map, const float *u, const float *v, int n,
                            int channels, struct flat_lookup *ret) {
    size_t below = (size_t)map->width * (size_t)channels;
    for (int i = 0; i < n; i += RN_VL) {
        vi column, line;
        vf fx, fy;
        lerp_vector(vf_load(u + i), map->width, &column, &fx);
        lerp_vector(vf_load(v + i), map->height, &line, &fy);
        vi_store(ret->offset + i, (line * map->width + column) * channels);
        vf_store(ret->fx + i, fx);
        vf_store(ret->fy + i, fy);
        for (int j = i; j < i + RN_VL && j < n; j++)
            fetch_ahead(map->texels + ret->offset[j], below, channels);
    }
}

// The same of a pyramid's maps: RN_VL samples, of which the first n are there. Returns the maps.
RN_INLINE int look_up_leveled(const struct rn_map *maps, int base, bool mip, const float *u,
                              const float *v, const float *lx, const float *ly, int n, int channels,
                              struct map_lookup ret[RN_MAPS_RIP]) {
    struct axis_lookup x, y;
    look_up_axis(vf_load(u), vf_load(lx), base, &x);
    look_up_axis(vf_load(v), vf_load(ly), base, &y);
    int count = 1;
    if (vi_mask_bits((x.upper > 0.0f) | (y.upper > 0.0f)))
        count = look_up_maps(&x, &y, mip, ret);
    else
        look_up_map(&x, &y, mip, 0, &ret[0]);
    for (int k = 0; k < count; k++) {
        if (n < RN_VL) ret[k].active &= (1u << n) - 1;
        for (unsigned left = ret[k].active; left; left &= left - 1) {
            int j = __builtin_ctz(left);
            size_t below = (size_t)ret[k].row[j] * (size_t)channels;
            fetch_ahead(maps[ret[k].map[j]].texels + (size_t)ret[k].offset[j] * (size_t)channels,
                        below, channels);
        }
    }
    return count;
}

// Between two texels in a row and the two below: RN_VL numbers of each at once where texels are as
// wide; of narrow texels two neighbours in a row fit together, and are interpolated along v at
// once. `channels` is a constant where these are called.
#if RN_VL >= 8
RN_INLINE void fetch_pair_4(const float *texel, size_t row, float fx, float fy, feature *to) {
    v8 above = *(const v8 *)texel, below = *(const v8 *)(texel + row);
    v8 both = above + fy * (below - above);
    v4 left = __builtin_shufflevector(both, both, 0, 1, 2, 3);
    v4 right = __builtin_shufflevector(both, both, 4, 5, 6, 7);
    store_features_4(to, left + fx * (right - left));
}
#endif
#if RN_VL >= 16
RN_INLINE void fetch_pair_8(const float *texel, size_t row, float fx, float fy, feature *to) {
    v16 above = *(const v16 *)texel, below = *(const v16 *)(texel + row);
    v16 both = above + fy * (below - above);
    v8 left = __builtin_shufflevector(both, both, 0, 1, 2, 3, 4, 5, 6, 7);
    v8 right = __builtin_shufflevector(both, both, 8, 9, 10, 11, 12, 13, 14, 15);
    store_features_8(to, left + fx * (right - left));
}
#endif
RN_INLINE void fetch(const float *texel, size_t row, float fx, float fy, feature *to,
                     const int channels) {
#if RN_VL >= 8
    if (channels == 4) {
        fetch_pair_4(texel, row, fx, fy, to);
        return;
    }
#endif
#if RN_VL >= 16
    if (channels == 8) {
        fetch_pair_8(texel, row, fx, fy, to);
        return;
    }
#endif
    for (int i = 0; i < channels; i += RN_VL) {
        vf a = vf_load(texel + i), b = vf_load(texel + i + channels);
        vf c = vf_load(texel + i + row), d = vf_load(texel + i + row + channels);
        vf left = a + fy * (c - a), right = b + fy * (d - b);
        store_features(to + i, left + fx * (right - left));
    }
}

// Features of samples [begin, end) to rows `out`, `stride` apart: of level 0 alone.
RN_INLINE void encode_flat(const struct rn_map *map, const float *u, const float *v, int begin,
                           int end, feature *out, size_t stride, const int channels) {
    size_t row = (size_t)map->width * (size_t)channels;
    struct flat_lookup at;
    for (int i = begin; i < end; i += RN_AHEAD) {
        int n = end - i < RN_AHEAD ? end - i : RN_AHEAD;
        look_up_flat(map, u + i, v + i, n, channels, &at);
        for (int j = 0; j < n; j++)
            fetch(map->texels + at.offset[j], row, at.fx[j], at.fy[j],
                  out + (size_t)(i + j) * stride, channels);
    }
}

// Numbers of a texel that are summed together: what fits in a vector. Where compilers are given
// wider types they pass them through memory.
#define RN_WEIGH_FUNCTIONS(LANES)                                                                  \
    RN_INLINE v##LANES weigh_##LANES(const struct rn_map *maps, const struct map_lookup *l, int j, \
                                     int i, const int channels) {                                  \
        const float *texel = maps[l->map[j]].texels + (size_t)l->offset[j] * channels + i;         \
        const float *below = texel + (size_t)l->row[j] * channels;                                 \
        v##LANES value = l->weight[0][j] * *(const v##LANES *)texel;                               \
        value += l->weight[1][j] * *(const v##LANES *)(texel + channels);                          \
        value += l->weight[2][j] * *(const v##LANES *)below;                                       \
        return value + l->weight[3][j] * *(const v##LANES *)(below + channels);                    \
    }                                                                                              \
    RN_INLINE void weigh_all_##LANES(const struct rn_map *maps, const struct map_lookup *at,       \
                                     int count, int j, int i, feature *to, const int channels) {   \
        v##LANES value = weigh_##LANES(maps, &at[0], j, i, channels);                              \
        for (int k = 1; k < count; k++)                                                            \
            value += weigh_##LANES(maps, &at[k], j, i, channels);                                  \
        store_features_##LANES(to, value);                                                         \
    }
RN_WEIGH_FUNCTIONS(4)
RN_WEIGH_FUNCTIONS(8)
RN_WEIGH_FUNCTIONS(16)

// A sample's features out of `count` maps.
RN_INLINE void weigh_maps(const struct rn_map *maps, const struct map_lookup *at, int count, int j,
                          feature *to, const int channels) {
    if (channels == 4 || RN_VL == 4)
        for (int i = 0; i < channels; i += 4)
            weigh_all_4(maps, at, count, j, i, to + i, channels);
    else if (channels == 8 || RN_VL == 8)
        for (int i = 0; i < channels; i += 8)
            weigh_all_8(maps, at, count, j, i, to + i, channels);
    else
        weigh_all_16(maps, at, count, j, 0, to, channels);
}

// The same between the levels of a pyramid's maps.
RN_INLINE void encode_leveled(const struct rn_map (*maps)[RN_MAX_LEVELS], bool mip, const float *u,
                              const float *v, const float *lx, const float *ly, int begin, int end,
                              feature *out, size_t stride, const int channels) {
    struct map_lookup at[RN_MAPS_RIP];
    int base = maps[0][0].width;
    for (int i = begin; i < end; i += RN_VL) {
        int n = end - i < RN_VL ? end - i : RN_VL;
        int count =
            look_up_leveled(maps[0], base, mip, u + i, v + i, lx + i, ly + i, n, channels, at);
        unsigned between = 0; // in more than one map, mostly then in all: one test
        for (int k = 1; k < count; k++)
            between |= at[k].active;
        for (int j = 0; j < n; j++)
            weigh_maps(maps[0], at, between >> j & 1 ? count : 1, j, out + (size_t)(i + j) * stride,
                       channels);
    }
}

#endif
