#include "server/engine/checkpoint/blocks.h"
#include "server/engine/field/voxels.h"

#include <math.h>
#include <string.h>

#include "common/math/half.h"

static int across(const struct rn_field_config *c) {
    return (c->base + RN_BLOCK_SIDE - 1) / RN_BLOCK_SIDE;
}

size_t rn_blocks_count(const struct rn_field_config *c) {
    size_t side = (size_t)across(c);
    return (size_t)rn_grid_count(c) * side * side * (size_t)c->channels;
}

// ---- one block ------------------------------------------------------------------------------

static void put_code(uint8_t *codes, int bits, int i, unsigned code) {
    unsigned both = code << (i * bits & 7);
    size_t at = (size_t)(i * bits) / 8;
    codes[at] |= (uint8_t)both;
    if (both > 0xff) codes[at + 1] |= (uint8_t)(both >> 8);
}

static unsigned get_code(const uint8_t *codes, int bits, int i) {
    size_t at = (size_t)(i * bits) / 8;
    int shift = i * bits & 7;
    unsigned both = codes[at];
    if (shift + bits > 8) both |= (unsigned)codes[at + 1] << 8;
    return both >> shift & ((1u << bits) - 1);
}

void rn_block_pack(const float values[RN_BLOCK_VALUES], int bits, uint8_t *ret_codes,
                   uint16_t *ret_low, uint16_t *ret_step) {
    float least = values[0], most = values[0];
    for (int i = 1; i < RN_BLOCK_VALUES; i++) {
        least = fminf(least, values[i]);
        most = fmaxf(most, values[i]);
    }
    double last = (1 << bits) - 1;
    *ret_low = rn_half_below(least);
    double low = (double)rn_half_to_float(*ret_low), reach = ((double)most - low) / last;
    *ret_step = rn_half_above(nextafterf((float)reach, INFINITY));
    double step = (double)rn_half_to_float(*ret_step);
    memset(ret_codes, 0, (size_t)(RN_BLOCK_VALUES / 8 * bits));
    for (int i = 0; i < RN_BLOCK_VALUES; i++)
        put_code(ret_codes, bits, i,
                 (unsigned)fmin(floor(((double)values[i] - low) / step + 0.5), last));
}

void rn_block_unpack(const uint8_t *codes, int bits, uint16_t low, uint16_t step,
                     float ret_values[RN_BLOCK_VALUES]) {
    double from = (double)rn_half_to_float(low), size = (double)rn_half_to_float(step);
    for (int i = 0; i < RN_BLOCK_VALUES; i++)
        ret_values[i] = (float)(from + size * get_code(codes, bits, i));
}

// ---- planes ---------------------------------------------------------------------------------

// Where the values of a block lie among the planes; those beyond the border are its last ones.
static void places_of(const struct rn_field_config *c, size_t block,
                      size_t ret_at[RN_BLOCK_VALUES]) {
    size_t channels = (size_t)c->channels, side = (size_t)across(c), base = (size_t)c->base;
    size_t channel = block % channels, column = block / channels % side,
           row = block / channels / side % side, plane = block / channels / side / side;
    for (size_t i = 0; i < RN_BLOCK_VALUES; i++) {
        size_t u = column * RN_BLOCK_SIDE + i % RN_BLOCK_SIDE,
               v = row * RN_BLOCK_SIDE + i / RN_BLOCK_SIDE;
        if (u >= base) u = base - 1;
        if (v >= base) v = base - 1;
        ret_at[i] = ((plane * base + v) * base + u) * channels + channel;
    }
}

void rn_blocks_pack(const struct rn_field_config *c, const float *planes,
                    struct rn_blocks *blocks) {
    size_t at[RN_BLOCK_VALUES], bytes = (size_t)(RN_BLOCK_VALUES / 8 * blocks->bits);
    float values[RN_BLOCK_VALUES];
    for (size_t b = 0; b < blocks->count; b++) {
        places_of(c, b, at);
        for (int i = 0; i < RN_BLOCK_VALUES; i++)
            values[i] = planes[at[i]];
        rn_block_pack(values, blocks->bits, blocks->codes + b * bytes, &blocks->low[b],
                      &blocks->step[b]);
    }
}

void rn_blocks_unpack(const struct rn_field_config *c, const struct rn_blocks *blocks,
                      float *ret_planes) {
    size_t at[RN_BLOCK_VALUES], bytes = (size_t)(RN_BLOCK_VALUES / 8 * blocks->bits);
    float values[RN_BLOCK_VALUES];
    for (size_t b = 0; b < blocks->count; b++) {
        places_of(c, b, at);
        rn_block_unpack(blocks->codes + b * bytes, blocks->bits, blocks->low[b], blocks->step[b],
                        values);
        for (int i = 0; i < RN_BLOCK_VALUES; i++)
            ret_planes[at[i]] = values[i];
    }
}
