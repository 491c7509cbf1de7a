#include "common/image/heif_sizes.h"

static unsigned take_bit(struct rn_bits *from) {
    if (from->at >= from->count) {
        from->at = SIZE_MAX / 2; // beyond the end for good
        return 0;
    }
    unsigned bit = from->bytes[from->at / 8] >> (7 - from->at % 8) & 1u;
    from->at++;
    return bit;
}

unsigned rn_bits_take(struct rn_bits *from, int count) {
    unsigned value = 0;
    for (int i = 0; i < count; i++)
        value = value << 1 | take_bit(from);
    return value;
}

uint32_t rn_bits_take_number(struct rn_bits *from) {
    int zeros = 0;
    while (zeros < 32 && !rn_bits_take(from, 1))
        zeros++;
    if (zeros == 32) return UINT32_MAX;
    return (uint32_t)(((uint64_t)1 << zeros) - 1 + rn_bits_take(from, zeros));
}
