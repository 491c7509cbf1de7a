// Which pixels rays are drawn from: nearly without replacement.
#ifndef RN_ENGINE_TRAIN_DRAW_H
#define RN_ENGINE_TRAIN_DRAW_H

#include <stdint.h>

#include "common/math/hd.h"

#define RN_LIVE_BLOCK 8 // pixels a side

// One of a list of blocks, and a pixel of it.
struct rn_live_pixel {
    uint64_t block;
    int x, y; // 0 .. RN_LIVE_BLOCK - 1
};

// The pixel of turn `turn` over `count` blocks, 0 < count < 2^53. One turn after the other takes
// the next place of a golden-ratio sequence over the blocks: any run of turns, so every step's
// rays, lies evenly over all of them, and each round over the blocks takes another pixel of each,
// no two neighbours in turn. Seeds start anywhere in the sequence.
RN_HD struct rn_live_pixel rn_live_pixel(uint64_t seed, uint64_t turn, uint64_t count) {
    uint64_t golden = 0x9e3779b97f4a7c15u; // 2^64 over the golden ratio
    uint64_t place = turn * golden + seed * 0xd1b54a32d192ed03u;
    uint64_t block = (uint64_t)((double)(place >> 11) * 0x1p-53 * (double)count);
    uint32_t pixel = (uint32_t)(block * golden >> 40) + (uint32_t)(turn / count) * 29;
    struct rn_live_pixel out = {block, (int)(pixel % RN_LIVE_BLOCK),
                                (int)(pixel / RN_LIVE_BLOCK % RN_LIVE_BLOCK)};
    return out;
}

#endif
