// The boxes of which HEIC and AVIF files are made (ISO/IEC 14496-12, 4.2).
#ifndef RN_COMMON_IMAGE_BOXES_H
#define RN_COMMON_IMAGE_BOXES_H

#include <stdbool.h>
#include <stdint.h>

// A box's or an item's type.
#define RN_BOX(a, b, c, d) ((uint32_t)(a) << 24 | (uint32_t)(b) << 16 | (uint32_t)(c) << 8 | (d))

// Bytes that are left to be read.
struct rn_span {
    const uint8_t *at, *end;
};

// Big-endian, of 0 to 8 bytes; false beyond the end.
bool rn_span_take(struct rn_span *from, int size, uint64_t *ret_value);

// Without a box's size where the caller has no use for it: that of a reference is not heeded. False
// where it is cut off, or is larger than the box.
bool rn_box_take_header(struct rn_span *from, uint64_t *ret_size, uint32_t *ret_type);

// The next box and what it holds; false at the end, and where a box is cut off or damaged.
bool rn_box_take(struct rn_span *from, uint32_t *ret_type, struct rn_span *ret_body);

#endif
