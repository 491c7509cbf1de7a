// How large the pictures of an AV1 stream are, before a decoder makes room for them.
#include <string.h>

#include "common/image/heif_sizes.h"

#define SEQUENCE_HEADER 1
#define MOST_LEVEL_WITHOUT_TIER 7

// Returns the bits of a decoder's delays; 0: there are none.
static int skip_timing(struct rn_bits *from) {
    if (!rn_bits_take(from, 1)) return 0;
    (void)rn_bits_take(from, 32);
    (void)rn_bits_take(from, 32);
    if (rn_bits_take(from, 1)) (void)rn_bits_take_number(from);
    if (!rn_bits_take(from, 1)) return 0;
    int delays = (int)rn_bits_take(from, 5) + 1;
    (void)rn_bits_take(from, 32);
    (void)rn_bits_take(from, 10);
    return delays;
}

static void skip_points(struct rn_bits *from) {
    int delays = skip_timing(from);
    bool shown_late = rn_bits_take(from, 1);
    for (unsigned left = rn_bits_take(from, 5) + 1; left > 0; left--) {
        (void)rn_bits_take(from, 12);
        if (rn_bits_take(from, 5) > MOST_LEVEL_WITHOUT_TIER) (void)rn_bits_take(from, 1);
        if (delays > 0 && rn_bits_take(from, 1)) {
            (void)rn_bits_take(from, delays);
            (void)rn_bits_take(from, delays);
            (void)rn_bits_take(from, 1);
        }
        if (shown_late && rn_bits_take(from, 1)) (void)rn_bits_take(from, 4);
    }
}

static struct rn_extent size_of_sequence(struct rn_span unit) {
    struct rn_bits bits = {.count = 0};
    size_t size = (size_t)(unit.end - unit.at);
    if (size > RN_BITS_BYTES) size = RN_BITS_BYTES;
    memcpy(bits.bytes, unit.at, size);
    bits.count = 8 * size;
    (void)rn_bits_take(&bits, 4);
    if (rn_bits_take(&bits, 1))
        (void)rn_bits_take(&bits, 5);
    else
        skip_points(&bits);
    int across = (int)rn_bits_take(&bits, 4) + 1, down = (int)rn_bits_take(&bits, 4) + 1;
    uint32_t width = rn_bits_take(&bits, across) + 1, height = rn_bits_take(&bits, down) + 1;
    return bits.at <= bits.count ? (struct rn_extent){width, height} : (struct rn_extent){0, 0};
}

// leb128 (4.10.5).
static bool take_length(struct rn_span *from, uint64_t *ret_length) {
    uint64_t byte, value = 0;
    for (int i = 0; i < 8; i++) {
        if (!rn_span_take(from, 1, &byte)) return false;
        value |= (byte & 0x7f) << 7 * i;
        if (!(byte & 0x80)) break;
    }
    *ret_length = value;
    return true;
}

struct rn_extent rn_av1_size(struct rn_span units) {
    struct rn_extent most = {0, 0};
    uint64_t header, skipped, length;
    while (rn_span_take(&units, 1, &header)) {
        uint64_t left;
        if (header & 4 && !rn_span_take(&units, 1, &skipped)) break;
        left = (uint64_t)(units.end - units.at);
        length = left;
        if (header & 2 && !take_length(&units, &length)) break;
        left = (uint64_t)(units.end - units.at);
        if (length > left) length = left;
        if ((header >> 3 & 15) == SEQUENCE_HEADER) {
            struct rn_extent size = size_of_sequence((struct rn_span){units.at, units.at + length});
            if (size.width > most.width) most.width = size.width;
            if (size.height > most.height) most.height = size.height;
        }
        units.at += length;
    }
    return most;
}
