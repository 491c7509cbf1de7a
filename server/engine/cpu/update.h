// The optimiser's step on planes, tile by tile: the gradients of a tile's coarser maps are pulled
// down, its texels change, and its coarser maps are pooled anew, all while it is in the cache.
#ifndef RN_ENGINE_CPU_UPDATE_H
#define RN_ENGINE_CPU_UPDATE_H

#include "server/engine/cpu/fetch.h"

#define RN_RUN 64  // texels along u at most that are done together
#define RN_ASKED 4 // rectangles on their way to the cache

// Gradients beyond 1.8e19, whose squares fp32 does not hold, count as 1.8e19; NaN stays NaN. The
// decay is part of the change: 1 - rate * decay, in fp32, would be 1 for the networks. Error of the
// change, beyond the parameter's own rounding: 8 ULP; of the second moment: 4 ULP; for gradients of
// 1e-30 to 1e30. With denormals flushed the change differs by 2e-5 of the rate at most.
// Returns a mask of the new parameters that are not finite.
RN_INLINE vi adamw_vector(const struct rn_adamw *o, const float *parameter, float *to, float *grad,
                          float *m, float *v) {
    float rate = o->rate / o->correction1, fade = o->rate * o->decay;
    float root = 1 / __builtin_sqrtf(o->correction2);
    vf g = vf_min(vf_set(1.8e19f), vf_max(vf_set(-1.8e19f), vf_load(grad) * o->scale));
    vf first = vf_load(m) * 0.9f + g * 0.1f, second = vf_load(v) * o->keep + g * g * o->fresh;
    vf_store(m, first);
    vf_store(v, second);
    vf p = vf_load(parameter), change = p * fade + rate * first / (vf_sqrt(second) * root + o->eps);
    p = p - change;
    vf_store(to, p);
    vf_store(grad, vf_set(0));
    return (vi_bits(p) & 0x7f800000) == 0x7f800000;
}

// The new parameters go to `to`, which may be where the old ones are.
static bool adamw_to(const struct rn_adamw *o, size_t n, const float *parameter, float *to,
                     float *grad, float *m, float *v) {
    size_t i = 0;
    vi wild = vi_set(0);
    for (; i + RN_VL <= n; i += RN_VL)
        wild |= adamw_vector(o, parameter + i, to + i, grad + i, m + i, v + i);
    if (i == n) return !vi_mask_bits(wild);
    float tail[4][RN_VL] = {{0}}, *all[4] = {to + i, grad + i, m + i, v + i};
    memcpy(tail[0], parameter + i, (n - i) * sizeof(float));
    for (int k = 1; k < 4; k++)
        memcpy(tail[k], all[k], (n - i) * sizeof(float));
    wild |= adamw_vector(o, tail[0], tail[0], tail[1], tail[2], tail[3]);
    for (int k = 0; k < 4; k++)
        memcpy(all[k], tail[k], (n - i) * sizeof(float));
    return !vi_mask_bits(wild);
}

static bool adamw(const struct rn_adamw *o, size_t n, float *parameter, float *grad, float *m,
                  float *v) {
    return adamw_to(o, n, parameter, parameter, grad, m, v);
}

// A rectangle of a plane's texels at level 0; its sides are multiples of the coarsest level's.
struct rect {
    int column, row, width, height;
};

// The part of map (x, y) that a rectangle pools into: its first number, and numbers a row.
RN_INLINE float *part_of(struct rn_map (*maps)[RN_MAX_LEVELS], int x, int y, int channels,
                         const struct rect *rect, size_t *ret_row) {
    const struct rn_map *map = &maps[y][x];
    *ret_row = (size_t)map->width * (size_t)channels;
    return map->texels + (size_t)(rect->row >> y) * *ret_row +
           (size_t)(rect->column >> x) * (size_t)channels;
}

// The `channels` of a texel, a constant where these are called.
RN_INLINE void mean_of_four(float *restrict to, const float *restrict a, const float *restrict b,
                            const int channels) {
    for (int c = 0; c < channels; c++)
        to[c] = ((a[c] + a[channels + c]) + (b[c] + b[channels + c])) * 0.25f;
}
RN_INLINE void mean_of_two(float *restrict to, const float *restrict a, const float *restrict b,
                           const int channels) {
    for (int c = 0; c < channels; c++)
        to[c] = (a[c] + b[c]) * 0.5f;
}
// Their adjoints, which clear the mean's gradient.
RN_INLINE void share_among_four(float *restrict from, float *restrict a, float *restrict b,
                                const int channels) {
    for (int c = 0; c < channels; c++) {
        float g = from[c] * 0.25f;
        from[c] = 0;
        a[c] += g, a[channels + c] += g, b[c] += g, b[channels + c] += g;
    }
}
RN_INLINE void share_among_two(float *restrict from, float *restrict a, float *restrict b,
                               const int channels) {
    for (int c = 0; c < channels; c++) {
        float g = from[c] * 0.5f;
        from[c] = 0;
        a[c] += g;
        b[c] += g;
    }
}

// Sizes here are even at every level but the coarsest: pooling is the mean of two (field/ripmap.h).
// Between levels of a mipmap: squares of four texels; `up` pools them, else their gradients follow.
RN_INLINE void pass_squares(struct rn_map (*maps)[RN_MAX_LEVELS], int level,
                            const struct rect *rect, const int channels, const bool up) {
    size_t fine_row, row;
    float *fine = part_of(maps, level - 1, level - 1, channels, rect, &fine_row);
    float *coarse = part_of(maps, level, level, channels, rect, &row);
    for (int y = 0; y < rect->height >> level; y++, fine += 2 * fine_row, coarse += row)
        for (int x = 0; x < rect->width >> level; x++) {
            float *a = fine + 2 * x * channels, *b = a + fine_row, *mean = coarse + x * channels;
            if (up)
                mean_of_four(mean, a, b, channels);
            else
                share_among_four(mean, a, b, channels);
        }
}

// Between maps of a ripmap: pairs along x in the maps that are pooled along x alone, else along y.
RN_INLINE void pass_pairs(struct rn_map (*maps)[RN_MAX_LEVELS], int x, int y,
                          const struct rect *rect, const int channels, const bool up) {
    size_t fine_row, row;
    bool along_x = y == 0;
    float *fine = part_of(maps, x - along_x, y - !along_x, channels, rect, &fine_row);
    float *coarse = part_of(maps, x, y, channels, rect, &row);
    for (int j = 0; j < rect->height >> y; j++, coarse += row)
        for (int i = 0; i < rect->width >> x; i++) {
            float *a = along_x ? fine + (size_t)j * fine_row + 2 * i * channels
                               : fine + (size_t)j * 2 * fine_row + i * channels;
            float *b = a + (along_x ? (size_t)channels : fine_row), *mean = coarse + i * channels;
            if (up)
                mean_of_two(mean, a, b, channels);
            else
                share_among_two(mean, a, b, channels);
        }
}

RN_INLINE void pull_down_rect(const struct rn_plane_update *u, const struct rect *rect,
                              const int channels) {
    for (int level = u->levels - 1; u->mip && level > 0; level--)
        pass_squares(u->grad_maps, level, rect, channels, false);
    for (int y = u->levels - 1; !u->mip && y >= 0; y--)
        for (int x = u->levels - 1; x >= (y == 0); x--)
            pass_pairs(u->grad_maps, x, y, rect, channels, false);
}

RN_INLINE void build_rect(const struct rn_plane_update *u, const struct rect *rect,
                          const int channels) {
    struct rn_map(*to)[RN_MAX_LEVELS] = u->to ? u->to : u->maps;
    for (int level = 1; u->mip && level < u->levels; level++)
        pass_squares(to, level, rect, channels, true);
    for (int y = 0; !u->mip && y < u->levels; y++)
        for (int x = y == 0; x < u->levels; x++)
            pass_pairs(to, x, y, rect, channels, true);
}

RN_INLINE bool update_texels(const struct rn_plane_update *u, const struct rect *rect,
                             const int channels) {
    size_t row = (size_t)u->maps[0][0].width * (size_t)channels;
    size_t at = (size_t)rect->row * row + (size_t)(rect->column * channels);
    const float *texels = u->maps[0][0].texels;
    float *to = u->to ? u->to[0][0].texels : u->maps[0][0].texels;
    bool finite = true;
    pull_down_rect(u, rect, channels);
    for (int y = 0; y < rect->height; y++, at += row)
        finite &= adamw_to(u->options, (size_t)(rect->width * channels), texels + at, to + at,
                           u->grad_maps[0][0].texels + at, u->m + at, u->v + at);
    build_rect(u, rect, channels);
    return finite;
}

static bool update_rect(const struct rn_plane_update *u, const struct rect *rect) {
    if (u->channels == 4) return update_texels(u, rect, 4);
    if (u->channels == 8) return update_texels(u, rect, 8);
    return update_texels(u, rect, 16);
}

// Asks for a rectangle's level 0, while another one is being done.
static void fetch_rect(const struct rn_plane_update *u, const struct rect *rect) {
    size_t row = (size_t)u->maps[0][0].width * (size_t)u->channels;
    size_t at = (size_t)rect->row * row + (size_t)(rect->column * u->channels);
    float *all[5] = {u->maps[0][0].texels, u->grad_maps[0][0].texels, u->m, u->v,
                     u->to ? u->to[0][0].texels : NULL};
    int count = u->to ? 5 : 4;
    for (int y = 0; y < rect->height; y++, at += row)
        for (int i = 0; i < rect->width * u->channels; i += 16)
            for (int k = 0; k < count; k++)
                __builtin_prefetch(all[k] + at + i, 1);
}

// The first mark at or behind `at`; `count` where there is none.
static int next_mark(const uint8_t *marks, int at, int count) {
    for (uint64_t eight; at + 8 <= count; at += 8) {
        memcpy(&eight, marks + at, sizeof eight);
        if (eight) break;
    }
    while (at < count && !marks[at])
        at++;
    return at;
}

// Runs of neighbouring tiles that the step touched are done as one rectangle.
static bool update(const struct rn_plane_update *u, int row_begin, int row_end) {
    int base = u->maps[0][0].width, asked = 0;
    struct rn_tiling tiling = rn_tiling(base, u->channels, u->levels);
    int width = 1 << tiling.shift_x, height = 1 << tiling.shift_y;
    int most = RN_RUN > width ? RN_RUN : width;
    bool finite = true;
    struct rect queue[RN_ASKED] = {{0}}; // asked for, not done yet
    for (int row = row_begin; row < row_end; row += height) {
        uint8_t *marks =
            u->touched ? u->touched + (size_t)(row >> tiling.shift_y) * tiling.columns : NULL;
        for (int column = 0;;) {
            if (marks)
                column = next_mark(marks, column >> tiling.shift_x, tiling.columns)
                         << tiling.shift_x;
            if (column >= base) break;
            int end = column;
            while (end < base && end - column < most && (!marks || marks[end >> tiling.shift_x])) {
                if (marks) marks[end >> tiling.shift_x] = 0;
                end += width;
            }
            struct rect *next = &queue[asked++ % RN_ASKED];
            if (next->width) finite &= update_rect(u, next);
            *next = (struct rect){column, row, (end < base ? end : base) - column, height};
            fetch_rect(u, next);
            column = end;
        }
    }
    for (int i = 0; i < RN_ASKED; i++)
        if (queue[i].width) finite &= update_rect(u, &queue[i]);
    return finite;
}

#endif
