// What EXIF says that matters: how the camera was held, and which camera it was.
// Source: CIPA DC-008 (Exif 2.32), sections 4.5 and 4.6; the block is a TIFF file of its own.
#include "common/image/codec.h"

#define MAKE 0x010f
#define MODEL 0x0110
#define ORIENTATION 0x0112
#define EXIF_FOLDER 0x8769
#define FOCAL_LENGTH 0x920a
#define TYPE_SHORT 3
#define MAX_TEXT 64         // bytes of a maker's or model's name that count
#define NOTHING 2166136261u // FNV-1a of no bytes

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

// Of FNV-1a.
static uint32_t mix(uint32_t key, uint8_t byte) {
    return (key ^ byte) * 16777619u;
}

// With a text of `size` bytes at most that the entry holds, or holds the place of. What editors pad
// it with says nothing of the camera.
static uint32_t mix_text(const struct block *block, size_t entry, size_t size, uint32_t key) {
    size_t at = size <= 4 ? entry + 8 : number(block, entry + 8, 4), end = 0;
    while (end < size && end < MAX_TEXT && at + end < block->size && block->bytes[at + end])
        end++;
    while (end > 0 && block->bytes[at + end - 1] == ' ')
        end--;
    for (size_t i = 0; i < end; i++)
        key = mix(key, block->bytes[at + i]);
    return end > 0 ? mix(key, 0) : key; // a maker's name ends before the model's
}

// With the thousandths of a rational, the same in either order of bytes and however it is reduced.
static uint32_t mix_rational(const struct block *block, size_t entry, uint32_t key) {
    size_t at = number(block, entry + 8, 4);
    uint32_t over = number(block, at, 4), under = number(block, at + 4, 4);
    uint64_t value = under ? (uint64_t)over * 1000 / under : 0;
    for (int i = 0; i < 8; i++)
        key = mix(key, (uint8_t)(value >> 8 * i));
    return key;
}

// One folder of tags; *ret_inner: where the folder of EXIF's own tags is, else as it was.
static void read_folder(const struct block *block, size_t at, struct rn_image_info *info,
                        size_t *ret_inner) {
    uint32_t count = number(block, at, 2);
    for (uint32_t i = 0; i < count; i++) {
        size_t entry = at + 2 + 12 * (size_t)i;
        if (entry + 12 > block->size) return;
        uint32_t tag = number(block, entry, 2), length = number(block, entry + 4, 4);
        if (tag == ORIENTATION && number(block, entry + 2, 2) == TYPE_SHORT) {
            uint32_t value = number(block, entry + 8, 2);
            if (value >= 1 && value <= 8) info->orientation = (int)value;
        }
        if (tag == EXIF_FOLDER) *ret_inner = number(block, entry + 8, 4);
        if (tag == MAKE || tag == MODEL)
            info->camera_key = mix_text(block, entry, length, info->camera_key);
        if (tag == FOCAL_LENGTH) info->camera_key = mix_rational(block, entry, info->camera_key);
    }
}

void rn_exif_read(const uint8_t *bytes, size_t size_bytes, struct rn_image_info *info) {
    struct block block = {bytes, size_bytes, size_bytes > 0 && bytes[0] == 'M'};
    size_t inner = 0;
    info->orientation = 1;
    info->camera_key = 0;
    if (size_bytes < 8 || bytes[0] != bytes[1] || number(&block, 2, 2) != 42) return;
    info->camera_key = NOTHING;
    read_folder(&block, number(&block, 4, 4), info, &inner);
    if (inner) read_folder(&block, inner, info, &inner);
    if (info->camera_key == NOTHING) info->camera_key = 0;
}
