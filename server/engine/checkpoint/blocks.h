// Planes in few bits: blocks of 8 x 8 texels of one channel, each with its own low end and step.
//
// A value x of a block is kept as the whole number q nearest to (x - low) / step, 0 <= q < 2^bits,
// and comes back as low + step q. Low end and step are halves (binary16), rounded outwards, so that
// every value of the block lies between low and low + step (2^bits - 1): it is off by at most half
// a step and the rounding of the sum to fp32. Blocks of a plane's border repeat its last texels.
#ifndef RN_ENGINE_CHECKPOINT_BLOCKS_H
#define RN_ENGINE_CHECKPOINT_BLOCKS_H

#include <stddef.h>
#include <stdint.h>

#include "common/settings/train.h"

#define RN_BLOCK_SIDE 8
#define RN_BLOCK_VALUES 64
#define RN_BLOCK_BITS_MAX 8

// Of all planes of a field, by plane, then row and column of blocks, then channel.
struct rn_blocks {
    int bits;             // of a value, 2 .. RN_BLOCK_BITS_MAX
    size_t count;         // of blocks
    uint8_t *codes;       // [count][8 * bits]: value 8 v + u, its lowest bit first
    uint16_t *low, *step; // [count], halves
};

// How many blocks a field's planes have.
size_t rn_blocks_count(const struct rn_field_config *config);

// One block. `values` must be finite and within RN_HALF_MAX; codes: 8 * bits bytes.
void rn_block_pack(const float values[RN_BLOCK_VALUES], int bits, uint8_t *ret_codes,
                   uint16_t *ret_low, uint16_t *ret_step);
void rn_block_unpack(const uint8_t *codes, int bits, uint16_t low, uint16_t step,
                     float ret_values[RN_BLOCK_VALUES]);

// All of them. planes: [plane][v][u][channel].
void rn_blocks_pack(const struct rn_field_config *config, const float *planes,
                    struct rn_blocks *blocks);
void rn_blocks_unpack(const struct rn_field_config *config, const struct rn_blocks *blocks,
                      float *ret_planes);

#endif
