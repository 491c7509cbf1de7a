// Building ripmaps and pulling their gradients down (paper, section 3.3), one plane at a time.
// Pooling keeps the mean and does not care for the order of the axes: 4 ULP of the largest texel.
// Building A and pulling down A^T are adjoint: <A x, y> = <x, A^T y> within 16 ULP of sum |x y|.
#ifndef RN_ENGINE_CPU_PYRAMID_H
#define RN_ENGINE_CPU_PYRAMID_H

#include "server/engine/cpu/fetch.h"
#include "server/engine/field/ripmap.h"

// One pooled line element: out += weight * in over `n` numbers (or the first tap: out = ...).
RN_INLINE void axpy(size_t n, float weight, const float *in, float *out, bool first) {
    size_t i = 0;
    for (; i + 4 <= n; i += 4) {
        v4 value = *(const v4 *)(in + i) * weight;
        if (!first) value += *(const v4 *)(out + i);
        *(v4 *)(out + i) = value;
    }
}

RN_INLINE int taps_of(int size, int i, int *ret_first, float weight[3]) {
    rn_real exact[3] = {0, 0, 0};
    int taps = rn_rip_taps(size, i, ret_first, exact);
    for (int t = 0; t < 3; t++)
        weight[t] = (float)exact[t];
    return taps;
}

// coarse = pooled fine, along x or y, for coarse rows [begin, end).
static void pool(const struct rn_map *fine, struct rn_map *coarse, int channels, bool along_x,
                 int begin, int end) {
    float weight[3];
    int first;
    size_t fine_row = (size_t)fine->width * channels, coarse_row = (size_t)coarse->width * channels;
    for (int y = begin; y < end; y++) {
        float *out = coarse->texels + y * coarse_row;
        if (!along_x) {
            int taps = taps_of(fine->height, y, &first, weight);
            for (int t = 0; t < taps; t++)
                axpy(fine_row, weight[t], fine->texels + (first + t) * fine_row, out, t == 0);
            continue;
        }
        const float *in = fine->texels + y * fine_row;
        for (int x = 0; x < coarse->width; x++) {
            int taps = taps_of(fine->width, x, &first, weight);
            for (int t = 0; t < taps; t++)
                axpy((size_t)channels, weight[t], in + (size_t)(first + t) * channels,
                     out + (size_t)x * channels, t == 0);
        }
    }
}

// fine += adjoint of pool(coarse); coarse is cleared.
static void unpool(struct rn_map *fine, struct rn_map *coarse, int channels, bool along_x) {
    float weight[3];
    int first;
    size_t fine_row = (size_t)fine->width * channels, coarse_row = (size_t)coarse->width * channels;
    for (int y = 0; y < coarse->height; y++) {
        float *in = coarse->texels + y * coarse_row;
        if (!along_x) {
            int taps = taps_of(fine->height, y, &first, weight);
            for (int t = 0; t < taps; t++)
                axpy(coarse_row, weight[t], in, fine->texels + (first + t) * fine_row, false);
        } else {
            float *out = fine->texels + y * fine_row;
            for (int x = 0; x < coarse->width; x++) {
                int taps = taps_of(fine->width, x, &first, weight);
                for (int t = 0; t < taps; t++)
                    axpy((size_t)channels, weight[t], in + (size_t)x * channels,
                         out + (size_t)(first + t) * channels, false);
            }
        }
        memset(in, 0, coarse_row * sizeof(float));
    }
}

// Which map a map is pooled from: rip maps chain along x in row 0, then along y; mip maps zigzag
// along the diagonal. false for maps that do not exist.
static bool pooled_from(bool mip, int x, int y, int *ret_x, int *ret_y) {
    bool along_x = mip ? x == y + 1 : y == 0;
    if (!rn_map_exists(mip, x, y)) return false;
    *ret_x = along_x ? x - 1 : x;
    *ret_y = along_x ? y : y - 1;
    return true;
}

static void build_plane(struct rn_map (*maps)[RN_MAX_LEVELS], int levels, bool mip, int channels) {
    for (int y = 0; y < levels; y++)
        for (int x = 0; x < levels; x++) {
            int fx, fy;
            if ((x == 0 && y == 0) || !pooled_from(mip, x, y, &fx, &fy)) continue;
            pool(&maps[fy][fx], &maps[y][x], channels, fy == y, 0, maps[y][x].height);
        }
}

static void pull_down_plane(struct rn_map (*maps)[RN_MAX_LEVELS], int levels, bool mip,
                            int channels) {
    for (int y = levels - 1; y >= 0; y--)
        for (int x = levels - 1; x >= 0; x--) {
            int fx, fy;
            if ((x == 0 && y == 0) || !pooled_from(mip, x, y, &fx, &fy)) continue;
            unpool(&maps[fy][fx], &maps[y][x], channels, fy == y);
        }
}

#endif
