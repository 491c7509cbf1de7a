// What is shared by those that look at how large parts of a HEIC file are.
#ifndef RN_COMMON_IMAGE_HEIF_SIZES_H
#define RN_COMMON_IMAGE_HEIF_SIZES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/image/boxes.h"

#define RN_HEVC_SPS 33 // the type of a unit that is a sequence parameter set

// In pixels.
struct rn_extent {
    uint32_t width, height;
};

#define RN_BITS_BYTES 256 // of a header that is looked at: its size stands within the first 140

// The beginning of a header; at > count: it was cut off before what was taken.
struct rn_bits {
    uint8_t bytes[RN_BITS_BYTES];
    size_t count, at; // in bits
};

// Of 0 to 32 bits; zeros beyond the end.
unsigned rn_bits_take(struct rn_bits *from, int count);

// A number of as many bits as zeros say that stand before it: ue(v) of ITU-T H.265, 9.2, uvlc of
// AV1, 4.10.3. UINT32_MAX where it takes more than 32 bits.
uint32_t rn_bits_take_number(struct rn_bits *from);

// The size for which a decoder of HEVC makes room, by a sequence parameter set (ITU-T H.265,
// 7.3.2.2): a unit of the stream, its header of two bytes first. False for units of other types,
// and where it is cut off.
bool rn_hevc_size(struct rn_span unit, struct rn_extent *ret_size);

// The largest size of a stream of AV1 by its sequence headers (AV1 Bitstream & Decoding Process
// Specification, 5.5): open bitstream units, each with its length. 0 x 0 without one. A frame of a
// stream that is not a reduced still picture may have another size of its own.
struct rn_extent rn_av1_size(struct rn_span units);

#endif
