// Smoothing of a plane in place. A texel's neighbours are all of the other colour of a chessboard,
// so that neither order nor vectors matter; a row of one colour and the row above of the other are
// done in one pass over the plane.
#ifndef RN_ENGINE_CPU_SMOOTH_H
#define RN_ENGINE_CPU_SMOOTH_H

#include "server/engine/cpu/features.h"

// Draws a texel towards its neighbours. `channels` is a constant where these are called.
RN_INLINE void smooth_texel(float *texel, const float *left, const float *right, const float *above,
                            const float *below, float share, const int channels) {
    float around[16];
    for (int c = 0; c < channels; c++)
        around[c] = (above[c] + below[c]) + (left[c] + right[c]);
    for (int c = 0; c < channels; c++)
        texel[c] += share * (around[c] - 4 * texel[c]);
}

RN_INLINE void smooth_row(float *row, int side, int y, int first, float share, const int channels) {
    size_t stride = (size_t)side * (size_t)channels;
    const float *above = y > 0 ? row - stride : row, *below = y + 1 < side ? row + stride : row;
    for (int x = first; x < side; x += 2) {
        size_t at = (size_t)x * (size_t)channels;
        size_t left = x > 0 ? at - (size_t)channels : at;
        size_t right = x + 1 < side ? at + (size_t)channels : at;
        smooth_texel(row + at, row + left, row + right, above + at, below + at, share, channels);
    }
}

RN_INLINE void smooth_plane(float *texels, int side, float share, const int channels) {
    size_t stride = (size_t)side * (size_t)channels;
    for (int y = 0; y <= side; y++, texels += stride) {
        if (y < side) smooth_row(texels, side, y, y % 2, share, channels);
        if (y > 0) smooth_row(texels - stride, side, y - 1, y % 2, share, channels);
    }
}

static void smooth(float *texels, int side, int channels, float share) {
    if (channels == 4)
        smooth_plane(texels, side, share, 4);
    else if (channels == 8)
        smooth_plane(texels, side, share, 8);
    else
        smooth_plane(texels, side, share, 16);
}

#endif
