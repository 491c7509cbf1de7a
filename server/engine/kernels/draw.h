// Which pixels rays are drawn from: mostly of the finest scale, nearly without replacement.
#ifndef RN_ENGINE_KERNELS_DRAW_H
#define RN_ENGINE_KERNELS_DRAW_H

#include <stdint.h>

#include "common/math/hd.h"

#define RN_LIVE_BLOCK 8   // pixels a side
#define RN_SCALE_TURNS 16 // of a round; one of them for each scale but the finest

// Where a ray of all rays ever drawn comes from.
struct rn_scale_turn {
    int scale;
    uint64_t turn; // of this scale, counted from 0 without gaps
};
// Ray `index` of a training on `scales` scales, 1 to RN_SCALE_TURNS.
RN_HD struct rn_scale_turn rn_scale_turn(uint64_t index, int scales) {
    uint64_t round = index / RN_SCALE_TURNS;
    int k = (int)(index % RN_SCALE_TURNS), fine = RN_SCALE_TURNS + 1 - scales; // of the finest
    struct rn_scale_turn coarse = {k - fine + 1, round};
    struct rn_scale_turn finest = {0, round * (uint64_t)fine + (uint64_t)k};
    return k < fine ? finest : coarse;
}

// One of a list of blocks, and a pixel of it.
struct rn_live_pixel {
    uint64_t block;
    int x, y; // 0 .. RN_LIVE_BLOCK - 1
};

// Where in [0, 1) turn `turn` lies: the next place of a golden-ratio sequence. Any run of turns, so
// every step's rays, lies evenly over all of it. Seeds start anywhere in the sequence.
RN_HD double rn_golden_place(uint64_t seed, uint64_t turn) {
    uint64_t place = turn * 0x9e3779b97f4a7c15u + seed * 0xd1b54a32d192ed03u; // 2^64 / golden ratio
    return (double)(place >> 11) * 0x1p-53;
}

// Pixel number `index` of a block, modulo all: one index after the other takes each pixel once, no
// two neighbours in turn, and blocks begin with different ones.
RN_HD struct rn_live_pixel rn_pixel_of_block(uint64_t block, uint32_t index) {
    uint32_t pixel = (uint32_t)(block * 0x9e3779b97f4a7c15u >> 40) + index * 29;
    struct rn_live_pixel out = {block, (int)(pixel % RN_LIVE_BLOCK),
                                (int)(pixel / RN_LIVE_BLOCK % RN_LIVE_BLOCK)};
    return out;
}

// The pixel of turn `turn` over `count` blocks, 0 < count < 2^53, all drawn alike: each round over
// the blocks takes another pixel of each.
RN_HD struct rn_live_pixel rn_live_pixel(uint64_t seed, uint64_t turn, uint64_t count) {
    uint64_t block = (uint64_t)(rn_golden_place(seed, turn) * (double)count);
    return rn_pixel_of_block(block, (uint32_t)(turn / count));
}

// ---- blocks that are drawn by shares (train/importance.h) -------------------------------------

#define RN_IMPORTANCE_FRESH 0.3f // weight of a block's newest loss in its mean

// The running mean of the losses of a block's rays after one more; < 0: none yet.
RN_HD float rn_block_error(float error, float loss) {
    return error < 0 ? loss : error + RN_IMPORTANCE_FRESH * (loss - error);
}

#define RN_SHARE_RUN 16 // blocks of a run

// Of blocks in lists, one after the other. What is kept of where a block's part of its list's
// [0, 1) begins is the sum of the shares before each run of blocks; from there on it is summed up
// in the same order.
struct rn_shares {
    const float *share;    // how often a block is drawn, 1 = as often as the mean of its list
    const double *sum;     // of the shares before a run; after a list's last one, of all
    const uint32_t *guide; // of a list of n runs, the run at i / n
};
RN_HD uint64_t rn_share_runs(uint64_t count) {
    return (count + RN_SHARE_RUN - 1) / RN_SHARE_RUN;
}
// Where list number `list`, whose first block is `first`, begins in `sum` and in `guide`. Of
// `list` lists of `first` blocks in all: how many numbers both have.
RN_HD uint64_t rn_share_place(int list, uint64_t first) {
    return (first + (uint64_t)list * (2 * RN_SHARE_RUN - 1)) / RN_SHARE_RUN;
}

// The pixel of turn `turn` over list number `list`, [first, first + count), count > 0; *ret_weight
// is 1 / share. Turns lie evenly over the list's [0, 1), so evenly over a block's part of it too:
// its pixels take turns.
RN_HD struct rn_live_pixel rn_shared_pixel(const struct rn_shares *shares, int list, uint64_t first,
                                           uint64_t count, uint64_t seed, uint64_t turn,
                                           float *ret_weight) {
    double at = rn_golden_place(seed, turn);
    uint64_t place = rn_share_place(list, first), runs = rn_share_runs(count);
    const double *sum = shares->sum + place;
    const float *share = shares->share + first;
    uint64_t run = shares->guide[place + (uint64_t)(at * (double)runs)];
    while (run + 1 < runs && sum[run + 1] / sum[runs] <= at)
        run++;
    uint64_t block = run * RN_SHARE_RUN;
    double from = sum[run], to = from + (double)share[block];
    while (block + 1 < count && to / sum[runs] <= at) {
        from = to;
        to += (double)share[++block];
    }
    double begin = from / sum[runs], end = block + 1 < count ? to / sum[runs] : 1;
    *ret_weight = 1 / share[block];
    return rn_pixel_of_block(
        block, (uint32_t)((at - begin) / (end - begin) * (RN_LIVE_BLOCK * RN_LIVE_BLOCK)));
}

#endif
