// How large the pictures of an HEVC stream are, before a decoder makes room for them.
#include <string.h>

#include "common/image/heif_sizes.h"

#define TIER_AND_LEVEL 96
#define SUB_LAYER_TIER 88
#define SUB_LAYER_LEVEL 8

// Without the bytes that keep a start code from standing in it (7.3.1.1).
static void unescape(struct rn_span unit, struct rn_bits *ret_bits) {
    size_t count = 0;
    int zeros = 0;
    for (; unit.at < unit.end && count < RN_BITS_BYTES; unit.at++) {
        bool escape = zeros >= 2 && *unit.at == 3;
        zeros = *unit.at == 0 ? zeros + 1 : 0;
        if (!escape) ret_bits->bytes[count++] = *unit.at;
    }
    ret_bits->count = 8 * count;
    ret_bits->at = 0;
}

// profile_tier_level (7.3.3) of so many layers beside the first.
static void skip_levels(struct rn_bits *from, unsigned layers) {
    unsigned present[8] = {0};
    from->at += TIER_AND_LEVEL;
    for (unsigned i = 0; i < layers; i++)
        present[i] = rn_bits_take(from, 2);
    if (layers > 0) from->at += 2 * (8 - (size_t)layers);
    for (unsigned i = 0; i < layers; i++)
        from->at += (present[i] & 2 ? SUB_LAYER_TIER : 0) + (present[i] & 1 ? SUB_LAYER_LEVEL : 0);
}

bool rn_hevc_size(struct rn_span unit, struct rn_extent *ret_size) {
    struct rn_bits bits;
    if (unit.end - unit.at < 2 || (unit.at[0] >> 1 & 63) != RN_HEVC_SPS) return false;
    unit.at += 2;
    unescape(unit, &bits);
    (void)rn_bits_take(&bits, 4);
    unsigned layers = rn_bits_take(&bits, 3);
    (void)rn_bits_take(&bits, 1);
    skip_levels(&bits, layers);
    (void)rn_bits_take_number(&bits);
    if (rn_bits_take_number(&bits) == 3)
        (void)rn_bits_take(&bits, 1); // planes of 4:4:4 may be coded apart
    uint32_t width = rn_bits_take_number(&bits), height = rn_bits_take_number(&bits);
    *ret_size = (struct rn_extent){width, height};
    return bits.at <= bits.count;
}
