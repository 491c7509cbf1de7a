// What is shared by those that look at how large parts of a HEIC file are.
#ifndef RN_COMMON_IMAGE_HEIF_SIZES_H
#define RN_COMMON_IMAGE_HEIF_SIZES_H

#include <stdbool.h>
#include <stdint.h>

#include "common/image/boxes.h"

#define RN_HEVC_SPS 33 // the type of a unit that is a sequence parameter set

// In pixels.
struct rn_extent {
    uint32_t width, height;
};

// The size for which a decoder of HEVC makes room, by a sequence parameter set (ITU-T H.265,
// 7.3.2.2): a unit of the stream, its header of two bytes first. False for units of other types,
// and where it is cut off.
bool rn_hevc_size(struct rn_span unit, struct rn_extent *ret_size);

#endif
