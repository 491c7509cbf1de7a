// Smoothing of a plane in place. A texel's neighbours are all of the other colour of a chessboard,
// so that neither order nor vectors matter; a row of one colour and the row above of the other are
// done in one pass over the plane.
#ifndef RN_ENGINE_CPU_SMOOTH_H
#define RN_ENGINE_CPU_SMOOTH_H

#include "server/engine/cpu/features.h"

#define RN_SMOOTH(NAME, TYPE)                                                                      \
    static void smooth_row_##NAME(TYPE *row, int side, int y, int first, float share) {            \
        const TYPE *above = y > 0 ? row - side : row, *below = y + 1 < side ? row + side : row;    \
        for (int x = first; x < side; x += 2) {                                                    \
            TYPE left = row[x > 0 ? x - 1 : x], right = row[x + 1 < side ? x + 1 : x];             \
            TYPE around = (above[x] + below[x]) + (left + right);                                  \
            row[x] += share * (around - 4 * row[x]);                                               \
        }                                                                                          \
    }                                                                                              \
    static void smooth_##NAME(TYPE *texels, int side, float share) {                               \
        for (int y = 0; y <= side; y++, texels += side) {                                          \
            if (y < side) smooth_row_##NAME(texels, side, y, y % 2, share);                        \
            if (y > 0) smooth_row_##NAME(texels - side, side, y - 1, y % 2, share);                \
        }                                                                                          \
    }

RN_SMOOTH(4, v4)
RN_SMOOTH(8, v8)
RN_SMOOTH(16, v16)

static void smooth(float *texels, int side, int channels, float share) {
    if (channels == 4)
        smooth_4((v4 *)texels, side, share);
    else if (channels == 8)
        smooth_8((v8 *)texels, side, share);
    else
        smooth_16((v16 *)texels, side, share);
}

#endif
