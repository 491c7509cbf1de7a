// The maps: planes pooled along both axes, the adjoint, and smoothing.
#include <math.h>
#include <string.h>

#include "server/engine/field/ripmap.h"
#include "server/engine/reference/tape.h"

double rn_reference_half(double x) {
    int exponent;
    frexp(x, &exponent);
    int shift = 11 - (exponent > -13 ? exponent : -13); // digits behind the point
    return ldexp(nearbyint(ldexp(x, shift)), -shift);
}

static size_t map_size(const struct rn_reference *ref, int lx, int ly) {
    return (size_t)rn_rip_size(ref->config.base, lx) * rn_rip_size(ref->config.base, ly) *
           ref->config.channels;
}

size_t rn_reference_map_offset(const struct rn_reference *ref, int plane, int lx, int ly) {
    int levels = ref->config.levels;
    size_t per_plane = 0, before = 0;
    for (int y = 0; y < levels; y++)
        for (int x = 0; x < levels; x++) {
            if (y == ly && x == lx) before = per_plane;
            per_plane += map_size(ref, x, y);
        }
    return (size_t)plane * per_plane + before;
}

// One pooling along a line of texels whose neighbours are `stride` numbers apart; adjoint adds
// the coarse gradient to the fine one.
static void pool_line(int size, int out_size, int channels, size_t stride, double *fine,
                      double *coarse, size_t coarse_stride) {
    for (int i = 0; i < out_size; i++) {
        double weight[3];
        int first, taps = rn_rip_taps(size, i, &first, weight);
        for (int c = 0; c < channels; c++) {
            double sum = 0;
            for (int t = 0; t < taps; t++)
                sum += weight[t] * fine[(first + t) * stride + c];
            coarse[i * coarse_stride + c] = sum;
        }
    }
}

static void unpool_line(int size, int out_size, int channels, size_t stride, double *fine,
                        double *coarse, size_t coarse_stride) {
    for (int i = 0; i < out_size; i++) {
        double weight[3];
        int first, taps = rn_rip_taps(size, i, &first, weight);
        for (int c = 0; c < channels; c++)
            for (int t = 0; t < taps; t++)
                fine[(first + t) * stride + c] += weight[t] * coarse[i * coarse_stride + c];
    }
}

typedef void (*line_fn)(int, int, int, size_t, double *, double *, size_t);

// Applies `line` between map (lx, ly) and the one pooled once more along x or y.
static void between(struct rn_reference *ref, double *maps, int plane, int lx, int ly, bool along_x,
                    line_fn line) {
    int channels = ref->config.channels, base = ref->config.base;
    int w = rn_rip_size(base, lx), h = rn_rip_size(base, ly);
    double *fine = maps + rn_reference_map_offset(ref, plane, lx, ly);
    double *coarse = maps + rn_reference_map_offset(ref, plane, lx + along_x, ly + !along_x);
    size_t row = (size_t)w * channels;
    if (along_x) {
        int out = rn_rip_size(base, lx + 1);
        for (int y = 0; y < h; y++)
            line(w, out, channels, channels, fine + y * row, coarse + (size_t)y * out * channels,
                 channels);
    } else {
        for (int x = 0; x < w; x++)
            line(h, rn_rip_size(base, ly + 1), channels, row, fine + (size_t)x * channels,
                 coarse + (size_t)x * channels, row);
    }
}

void rn_reference_build(struct rn_reference *ref) {
    int levels = ref->config.levels;
    size_t plane_size = map_size(ref, 0, 0);
    for (int k = 0; k < ref->config.planes; k++) {
        memcpy(ref->maps + rn_reference_map_offset(ref, k, 0, 0), ref->planes + k * plane_size,
               plane_size * sizeof(double));
        for (int x = 0; x + 1 < levels; x++)
            between(ref, ref->maps, k, x, 0, true, pool_line);
        for (int y = 0; y + 1 < levels; y++)
            for (int x = 0; x < levels; x++)
                between(ref, ref->maps, k, x, y, false, pool_line);
    }
    for (size_t i = 0; ref->half && i < ref->map_count; i++)
        ref->maps[i] = rn_reference_half(ref->maps[i]);
}

static double smoothed(const double *texel, int channels, int size, int u, int v, double share) {
    double left = texel[u > 0 ? -channels : 0], right = texel[u + 1 < size ? channels : 0];
    double above = texel[v > 0 ? -size * channels : 0];
    double below = texel[v + 1 < size ? size * channels : 0];
    return *texel + share * (left + right + above + below - 4 * *texel);
}

void rn_reference_smooth(struct rn_reference *ref, double share) {
    int size = ref->config.base, channels = ref->config.channels;
    for (int odd = 0; odd < 2; odd++)
        for (int k = 0; k < ref->config.planes; k++)
            for (int v = 0; v < size; v++)
                for (int u = (v + odd) % 2; u < size; u += 2)
                    for (int c = 0; c < channels; c++) {
                        double *at = ref->planes + k * map_size(ref, 0, 0);
                        at += (size_t)(v * size + u) * (size_t)channels + (size_t)c;
                        *at = smoothed(at, channels, size, u, v, share);
                    }
}

void rn_reference_pull_down(struct rn_reference *ref) {
    int levels = ref->config.levels;
    size_t plane_size = map_size(ref, 0, 0);
    for (int k = 0; k < ref->config.planes; k++) {
        for (int y = levels - 2; y >= 0; y--)
            for (int x = 0; x < levels; x++)
                between(ref, ref->map_grad, k, x, y, false, unpool_line);
        for (int x = levels - 2; x >= 0; x--)
            between(ref, ref->map_grad, k, x, 0, true, unpool_line);
        const double *grad = ref->map_grad + rn_reference_map_offset(ref, k, 0, 0);
        for (size_t i = 0; i < plane_size; i++)
            ref->plane_grad[k * plane_size + i] += grad[i];
    }
    memset(ref->map_grad, 0, ref->map_count * sizeof(double));
}
