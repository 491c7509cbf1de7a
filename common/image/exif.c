// What EXIF says that matters: how the camera was held, which camera it was, and where it stood.
// Source: CIPA DC-008 (Exif 2.32), sections 4.5 and 4.6; the block is a TIFF file of its own.
#include <math.h>
#include <string.h>

#include "common/image/codec.h"

#define MAKE 0x010f
#define MODEL 0x0110
#define ORIENTATION 0x0112
#define EXIF_FOLDER 0x8769
#define GPS_FOLDER 0x8825
#define FOCAL_LENGTH 0x920a
#define GPS_FIRST 1 // GPSLatitudeRef
#define GPS_LAST 6  // GPSAltitude
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

// Where the folders of EXIF's own tags and of GPS's are; 0: nowhere.
struct inner {
    size_t exif, gps;
};

static void read_entry(const struct block *block, size_t entry, struct rn_image_info *info,
                       struct inner *inner) {
    uint32_t tag = number(block, entry, 2), length = number(block, entry + 4, 4);
    if (tag == ORIENTATION && number(block, entry + 2, 2) == TYPE_SHORT) {
        uint32_t value = number(block, entry + 8, 2);
        if (value >= 1 && value <= 8) info->orientation = (int)value;
    }
    if (tag == EXIF_FOLDER) inner->exif = number(block, entry + 8, 4);
    if (tag == GPS_FOLDER) inner->gps = number(block, entry + 8, 4);
    if (tag == MAKE || tag == MODEL)
        info->camera_key = mix_text(block, entry, length, info->camera_key);
    if (tag == FOCAL_LENGTH) info->camera_key = mix_rational(block, entry, info->camera_key);
}

// The sum of `count` rationals, each a sixtieth of the one before: degrees, minutes, seconds. NAN
// where there are fewer, or one is over nothing.
static double sixtieths(const struct block *block, size_t entry, uint32_t count) {
    size_t at = number(block, entry + 8, 4);
    double sum = 0, unit = 1;
    if (number(block, entry + 4, 4) < count) return NAN;
    for (uint32_t i = 0; i < count; i++, unit /= 60, at += 8) {
        uint32_t under = number(block, at + 4, 4);
        sum += under ? unit * number(block, at, 4) / under : NAN;
    }
    return sum;
}

// Tags come in pairs, a latitude's, a longitude's and an altitude's: which side of 0, and how far.
static void read_gps_entry(const struct block *block, size_t entry, double place[3],
                           double sign[3]) {
    static const uint32_t below[3] = {'S', 'W', 1};
    uint32_t tag = number(block, entry, 2), axis = (tag - 1) / 2;
    if (tag < GPS_FIRST || tag > GPS_LAST) return;
    if (tag % 2)
        sign[axis] = number(block, entry + 8, 1) == below[axis] ? -1 : 1;
    else
        place[axis] = sixtieths(block, entry, axis < 2 ? 3 : 1);
}

// How many entries, of 12 bytes from *ret_first, a folder has within the block.
static uint32_t count_entries(const struct block *block, size_t at, size_t *ret_first) {
    uint32_t count = at ? number(block, at, 2) : 0;
    *ret_first = at + 2;
    while (count > 0 && *ret_first + 12 * (size_t)count > block->size)
        count--;
    return count;
}

static void read_folder(const struct block *block, size_t at, struct rn_image_info *info,
                        struct inner *inner) {
    size_t first;
    uint32_t count = count_entries(block, at, &first);
    for (uint32_t i = 0; i < count; i++)
        read_entry(block, first + 12 * (size_t)i, info, inner);
}

// A receiver that knew nothing wrote 0, 0.
static void read_gps(const struct block *block, size_t at, struct rn_image_info *info) {
    double place[3] = {NAN, NAN, NAN}, sign[3] = {1, 1, 1};
    size_t first;
    uint32_t count = count_entries(block, at, &first);
    for (uint32_t i = 0; i < count; i++)
        read_gps_entry(block, first + 12 * (size_t)i, place, sign);
    info->located =
        place[0] <= 90 && place[1] <= 180 && place[0] + place[1] > 0 && isfinite(place[2]);
    for (int i = 0; i < 3; i++)
        info->located_at[i] = info->located ? sign[i] * place[i] : 0;
}

void rn_exif_read(const uint8_t *bytes, size_t size_bytes, struct rn_image_info *info) {
    struct block block = {bytes, size_bytes, size_bytes > 0 && bytes[0] == 'M'};
    struct inner inner = {0};
    info->orientation = 1;
    info->camera_key = 0;
    info->located = false;
    memset(info->located_at, 0, sizeof info->located_at);
    if (size_bytes < 8 || bytes[0] != bytes[1] || number(&block, 2, 2) != 42) return;
    info->camera_key = NOTHING;
    read_folder(&block, number(&block, 4, 4), info, &inner);
    read_folder(&block, inner.exif, info, &inner);
    read_gps(&block, inner.gps, info);
    if (info->camera_key == NOTHING) info->camera_key = 0;
}
