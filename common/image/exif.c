// How the camera was held: the one tag of EXIF that changes where a pixel is.
// Source: CIPA DC-008 (Exif 2.32), section 4.5; the block is a TIFF file of its own.
#include "common/image/codec.h"

#define ORIENTATION 0x0112
#define TYPE_SHORT 3

struct block {
    const uint8_t *bytes;
    size_t size;
    bool big; // big-endian
};

static uint32_t number(const struct block *block, size_t at, int bytes) {
    uint32_t value = 0;
    if (at > block->size || block->size - at < (size_t)bytes) return 0;
    for (int i = 0; i < bytes; i++)
        value |= (uint32_t)block->bytes[at + (size_t)i] << 8 * (block->big ? bytes - 1 - i : i);
    return value;
}

int rn_exif_orientation(const uint8_t *bytes, size_t size_bytes) {
    struct block block = {bytes, size_bytes, size_bytes > 0 && bytes[0] == 'M'};
    if (size_bytes < 8 || bytes[0] != bytes[1] || number(&block, 2, 2) != 42) return 1;
    size_t at = number(&block, 4, 4);
    uint32_t count = number(&block, at, 2);
    for (uint32_t i = 0; i < count; i++) {
        size_t entry = at + 2 + 12 * (size_t)i;
        if (entry + 12 > size_bytes) return 1;
        if (number(&block, entry, 2) != ORIENTATION) continue;
        uint32_t value =
            number(&block, entry + 2, 2) == TYPE_SHORT ? number(&block, entry + 8, 2) : 1;
        return value >= 1 && value <= 8 ? (int)value : 1;
    }
    return 1;
}
