// Adding samples' gradients to texels: the adjoint of cpu/fetch.h, for a band of rows:
// <Q x, y> = <x, Q^T y> within 16 ULP of sum |x y|.
#ifndef RN_ENGINE_CPU_SCATTER_H
#define RN_ENGINE_CPU_SCATTER_H

#include "server/engine/cpu/fetch.h"
#include "server/engine/cpu/voxels.h"

// A band of a plane's rows, of level 0 and of the rows pooled from them.
struct band {
    int begin, end; // level 0
    bool last;
};

// Bits of the lanes whose texels on one of the two levels may lie in the band.
RN_INLINE unsigned lanes_in_band(const struct axis_lookup *y, const struct band *band) {
    vi inside = vi_set(0);
    for (int k = 0; k < 2; k++) {
        vi level = y->level + k, end = vi_set(band->end) >> level;
        if (band->last) end = y->size[k];
        inside |= (y->low[k] + 1 >= vi_set(band->begin) >> level) & (y->low[k] < end);
    }
    return vi_mask_bits(inside);
}

// What a scatter to the maps of one corner needs beside the fetch: which of the two rows are in
// the band, and the tile of the first texel with the steps to its neighbours' tiles.
struct map_target {
    struct map_lookup at;
    unsigned upper, lower; // a bit a lane
    int32_t tile[RN_VL], right[RN_VL], below[RN_VL];
};

RN_INLINE void look_up_target(const struct axis_lookup *x, const struct axis_lookup *y, bool mip,
                              int corner, const struct band *band, const struct rn_tiling *tiling,
                              struct map_target *ret) {
    int up_x = corner & 1, up_y = corner >> 1;
    look_up_map(x, y, mip, corner, &ret->at);
    vi level = y->level + up_y, row = y->low[up_y], column = x->low[up_x];
    vi begin = vi_set(band->begin) >> level, end = vi_set(band->end) >> level;
    if (band->last) end = y->size[up_y];
    ret->upper = ret->at.active & vi_mask_bits((row >= begin) & (row < end));
    ret->lower =
        ret->at.active & vi_mask_bits((row + 1 >= begin) & (row + 1 < end) & (y->size[up_y] > 1));
    vi shift_x = tiling->shift_x - x->level - up_x, shift_y = tiling->shift_y - level;
    shift_x &= shift_x > 0; // lanes that are not active
    shift_y &= shift_y > 0;
    vi tile_x = column >> shift_x, tile_y = row >> shift_y;
    vi_store(ret->tile, tile_y * tiling->columns + tile_x);
    vi_store(ret->right, ((column + 1) >> shift_x) - tile_x);
    vi_store(ret->below, (((row + 1) >> shift_y) - tile_y) * tiling->columns);
}

RN_INLINE void look_up_targets(const struct axis_lookup *x, const struct axis_lookup *y, bool mip,
                               const struct band *band, const struct rn_tiling *tiling,
                               struct map_target ret[RN_MAPS_RIP]) {
    look_up_target(x, y, mip, 0, band, tiling, &ret[0]);
    if (mip) {
        look_up_target(x, y, true, 3, band, tiling, &ret[1]);
        return;
    }
    look_up_target(x, y, false, 1, band, tiling, &ret[1]);
    look_up_target(x, y, false, 2, band, tiling, &ret[2]);
    look_up_target(x, y, false, 3, band, tiling, &ret[3]);
}

// Where a few vectors of samples are added to a map that is alone, and which of them lie in the
// band, found before any is added: the texels are on their way to the cache by then.
struct flat_target {
    int32_t line[RN_AHEAD], column[RN_AHEAD], first[RN_AHEAD], last[RN_AHEAD]; // texel; tiles
    float fx[RN_AHEAD], fy[RN_AHEAD];
    uint8_t sample[RN_AHEAD];
};

RN_INLINE int look_up_flat_targets(const float *u, const float *v, int n, const struct band *band,
                                   const struct rn_tiling *tiling, const struct rn_map *map,
                                   int channels, struct flat_target *ret) {
    size_t row = (size_t)map->width * (size_t)channels;
    int found = 0;
    for (int i = 0; i < n; i += RN_VL) {
        vi column, line;
        vf fx, fy;
        lerp_vector(vf_load(v + i), map->height, &line, &fy);
        unsigned bits = vi_mask_bits((line >= band->begin - 1) & (line < band->end));
        if (n - i < RN_VL) bits &= (1u << (n - i)) - 1;
        if (!bits) continue;
        lerp_vector(vf_load(u + i), map->width, &column, &fx);
        vi_store(ret->line + i, line);
        vi_store(ret->column + i, column);
        vi_store(ret->first + i, column >> tiling->shift_x);
        vi_store(ret->last + i, (column + 1) >> tiling->shift_x);
        vf_store(ret->fx + i, fx);
        vf_store(ret->fy + i, fy);
        for (; bits; bits &= bits - 1) {
            int j = i + __builtin_ctz(bits);
            const float *texel =
                map->texels + (size_t)ret->line[j] * row + (size_t)(ret->column[j] * channels);
            ret->sample[found++] = (uint8_t)j;
            fetch_ahead(texel, row, channels);
        }
    }
    return found;
}

// Adds a gradient to two neighbours in a row. `channels` is a constant where these are called.
RN_INLINE void add_row(float *texel, float left, float right, const float *grad,
                       const int channels) {
    float g[16];
    for (int c = 0; c < channels; c++)
        g[c] = grad[c];
    for (int c = 0; c < channels; c++)
        texel[c] += g[c] * left;
    for (int c = 0; c < channels; c++)
        texel[channels + c] += g[c] * right;
}

RN_INLINE void scatter_flat(const struct rn_slab *slab, int plane, const struct band *band,
                            const struct rn_tiling *tiling, const struct rn_map *map,
                            uint8_t *touched, const int channels) {
    size_t row = (size_t)map->width * (size_t)channels, tiles = (size_t)tiling->columns;
    struct flat_target at;
    for (int i = 0; i < slab->count; i += RN_AHEAD) {
        int n = slab->count - i < RN_AHEAD ? slab->count - i : RN_AHEAD;
        int found = look_up_flat_targets(slab->u[plane] + i, slab->v[plane] + i, n, band, tiling,
                                         map, channels, &at);
        for (int k = 0; k < found; k++) {
            int j = at.sample[k], line = at.line[j];
            uint8_t *mark = touched + (size_t)line * tiles;
            const float *grad = slab->grad[plane] + (size_t)(i + j) * (size_t)channels;
            float *texel = map->texels + (size_t)line * row + (size_t)(at.column[j] * channels);
            float fx = at.fx[j], fy = at.fy[j], share[16];
            if (line >= band->begin) {
                mark[at.first[j]] = mark[at.last[j]] = 1;
                for (int c = 0; c < channels; c++)
                    share[c] = grad[c] * (1 - fy);
                add_row(texel, 1 - fx, fx, share, channels);
            }
            if (line + 1 < band->end) {
                mark[tiles + at.first[j]] = mark[tiles + at.last[j]] = 1;
                for (int c = 0; c < channels; c++)
                    share[c] = grad[c] * fy;
                add_row(texel + row, 1 - fx, fx, share, channels);
            }
        }
    }
}

RN_INLINE void add_to_map(const struct rn_map *maps, const struct map_target *t, int j,
                          uint8_t *touched, const float *grad, const int channels) {
    float *texel = maps[t->at.map[j]].texels + (size_t)t->at.offset[j] * (size_t)channels;
    uint8_t *mark = touched + t->tile[j];
    if (t->upper >> j & 1) {
        mark[0] = mark[t->right[j]] = 1;
        add_row(texel, t->at.weight[0][j], t->at.weight[1][j], grad, channels);
    }
    if (t->lower >> j & 1) {
        mark[t->below[j]] = mark[t->below[j] + t->right[j]] = 1;
        add_row(texel + (size_t)t->at.row[j] * (size_t)channels, t->at.weight[2][j],
                t->at.weight[3][j], grad, channels);
    }
}

RN_INLINE void scatter_leveled(const struct rn_slab *slab, int plane, bool mip,
                               const struct band *band, const struct rn_tiling *tiling,
                               struct rn_map (*maps)[RN_MAX_LEVELS], uint8_t *touched,
                               const int channels) {
    struct axis_lookup x, y;
    struct map_target targets[RN_MAPS_RIP];
    int base = maps[0][0].width, count = mip ? RN_MAPS_MIP : RN_MAPS_RIP;
    for (int i = 0; i < slab->count; i += RN_VL) {
        look_up_axis(vf_load(slab->v[plane] + i), vf_load(slab->ly[plane] + i), base, &y);
        unsigned bits = lanes_in_band(&y, band);
        if (slab->count - i < RN_VL) bits &= (1u << (slab->count - i)) - 1;
        if (!bits) continue;
        look_up_axis(vf_load(slab->u[plane] + i), vf_load(slab->lx[plane] + i), base, &x);
        look_up_targets(&x, &y, mip, band, tiling, targets);
        for (; bits; bits &= bits - 1) {
            int j = __builtin_ctz(bits);
            const float *grad = slab->grad[plane] + (size_t)(i + j) * (size_t)channels;
            for (int k = 0; k < count; k++)
                if (targets[k].at.active >> j & 1)
                    add_to_map(maps[0], &targets[k], j, touched, grad, channels);
        }
    }
}

RN_INLINE void scatter_band(const struct rn_slab *slab, int plane, int levels, bool mip,
                            const struct band *band, const struct rn_tiling *tiling,
                            struct rn_map (*maps)[RN_MAX_LEVELS], uint8_t *touched,
                            const int channels) {
    if (levels > 1)
        scatter_leveled(slab, plane, mip, band, tiling, maps, touched, channels);
    else
        scatter_flat(slab, plane, band, tiling, &maps[0][0], touched, channels);
}

static void scatter(const struct rn_cpu_field *field, const struct rn_slab *slab, int plane,
                    int levels, int row_begin, int row_end,
                    struct rn_map (*grad_maps)[RN_MAX_LEVELS], uint8_t *touched) {
    if (plane == field->config->planes) {
        struct voxels voxels = voxels_of(field->config, &grad_maps[0][0]);
        struct voxel_band part = band_of_voxels(field->config, row_begin, row_end);
        scatter_voxels(&voxels, slab, &part, touched);
        return;
    }
    bool mip = field->config->footprint == RN_FOOTPRINT_MIP;
    struct band band = {row_begin, row_end, row_end == field->config->base};
    int channels = field->config->channels;
    struct rn_tiling tiling = rn_tiling(field->config->base, channels, levels);
    if (channels == 4)
        scatter_band(slab, plane, levels, mip, &band, &tiling, grad_maps, touched, 4);
    else if (channels == 8)
        scatter_band(slab, plane, levels, mip, &band, &tiling, grad_maps, touched, 8);
    else
        scatter_band(slab, plane, levels, mip, &band, &tiling, grad_maps, touched, 16);
}

#endif
