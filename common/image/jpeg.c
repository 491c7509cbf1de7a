#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>

#include "common/image/codec.h"

static bool is_jpeg(const uint8_t *bytes, size_t size_bytes) {
    return size_bytes >= 3 && bytes[0] == 0xff && bytes[1] == 0xd8 && bytes[2] == 0xff;
}

// The next application segment of a kind in front of the picture, from *at on: its content.
static bool next_segment(const uint8_t *bytes, size_t size_bytes, uint8_t marker, size_t *at,
                         const uint8_t **ret_content, size_t *ret_size) {
    while (*at + 4 <= size_bytes && bytes[*at] == 0xff) {
        uint8_t found = bytes[*at + 1];
        size_t length = (size_t)bytes[*at + 2] << 8 | bytes[*at + 3], begin = *at + 4;
        if (found == 0xff) { // padding
            ++*at;
            continue;
        }
        if (found == 0xda || length < 2 || *at + 2 + length > size_bytes) return false;
        *at += 2 + length;
        if (found != marker) continue;
        *ret_content = bytes + begin;
        *ret_size = length - 2;
        return true;
    }
    return false;
}

static void read_exif(const uint8_t *bytes, size_t size_bytes, struct rn_image_info *info) {
    const uint8_t *content;
    size_t at = 2, size;
    info->orientation = 1;
    while (next_segment(bytes, size_bytes, 0xe1, &at, &content, &size)) {
        if (size <= 6 || memcmp(content, "Exif\0\0", 6) != 0) continue;
        rn_exif_read(content + 6, size - 6, info);
        return;
    }
}

// The profile is cut into segments that bear their number and how many there are.
static bool profile_jpeg(const uint8_t *bytes, size_t size_bytes, uint8_t **ret_profile,
                         size_t *ret_size) {
    static const char name[12] = "ICC_PROFILE";
    const uint8_t *content, *parts[256] = {NULL};
    size_t at = 2, size, sizes[256] = {0}, total = 0;
    int count = 0;
    while (next_segment(bytes, size_bytes, 0xe2, &at, &content, &size)) {
        if (size < 14 || memcmp(content, name, sizeof name) != 0) continue;
        parts[content[12]] = content + 14;
        sizes[content[12]] = size - 14;
        count = content[13];
    }
    for (int i = 1; i <= count; i++) {
        if (!parts[i]) return false;
        total += sizes[i];
    }
    uint8_t *profile = count ? malloc(total + 1) : NULL;
    if (!profile) return false;
    *ret_profile = profile;
    *ret_size = total;
    for (int i = 1; i <= count; profile += sizes[i], i++)
        memcpy(profile, parts[i], sizes[i]);
    return true;
}

// Whether a segment says what the picture is: not what applications say of it, but for JFIF's and
// Adobe's, which name its colours, and no comment.
static bool is_of_picture(uint8_t marker) {
    bool application = marker >= 0xe0 && marker <= 0xef;
    return marker != 0xfe && (!application || marker == 0xe0 || marker == 0xee);
}

// Where the coded pixels behind a scan's header end: at the next marker that is none of theirs.
static size_t end_of_scan(const uint8_t *bytes, size_t size_bytes, size_t at) {
    for (; at + 1 < size_bytes; at++) {
        uint8_t next = bytes[at + 1];
        if (bytes[at] == 0xff && next != 0 && next != 0xff && (next < 0xd0 || next > 0xd7))
            return at;
    }
    return size_bytes;
}

// How long the segment is that begins at `at`, coded pixels included; what no marker begins ends
// the file.
static size_t segment_length(const uint8_t *bytes, size_t size_bytes, size_t at) {
    if (at + 4 > size_bytes || bytes[at] != 0xff) return size_bytes - at;
    if (bytes[at + 1] == 0xff) return 1; // padding
    size_t length = 2 + ((size_t)bytes[at + 2] << 8 | bytes[at + 3]);
    if (length > size_bytes - at) return size_bytes - at;
    if (bytes[at + 1] == 0xda) length = end_of_scan(bytes, size_bytes, at + length) - at;
    return length;
}

// What lies behind the picture's end, another picture or a film, is left out too.
static enum rn_status strip_jpeg(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    static const uint8_t end[2] = {0xff, 0xd9};
    uint8_t *kept = malloc(size_bytes + sizeof end);
    if (!kept) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to keep the JPEG");
    size_t at = 2, size = 2;
    memcpy(kept, bytes, 2);
    while (at + 2 <= size_bytes && memcmp(bytes + at, end, sizeof end) != 0) {
        size_t length = segment_length(bytes, size_bytes, at);
        if (length > 1 && is_of_picture(bytes[at + 1])) {
            memcpy(kept + size, bytes + at, length);
            size += length;
        }
        at += length;
    }
    memcpy(kept + size, end, sizeof end);
    *ret_bytes = kept;
    *ret_size = size + sizeof end;
    return RN_OK;
}

static enum rn_status damaged(const char *problem, const char *where, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "the JPEG file is damaged (%s): copy or export it again", problem);
}

static enum rn_status read_header(tjhandle handle, const uint8_t *bytes, size_t size_bytes,
                                  const char *where, struct rn_image_info *ret_info,
                                  struct rn_error *err) {
    struct rn_image_info info = {.bit_depth = 8};
    int subsampling, colour_space;
    if (tjDecompressHeader3(handle, bytes, (unsigned long)size_bytes, &info.width, &info.height,
                            &subsampling, &colour_space) != 0)
        return damaged(tjGetErrorStr2(handle), where, err);
    if (info.width < 1 || info.height < 1) // the library takes an early end for a file of tables
        return damaged("the file ends before the picture's header", where, err);
    if (colour_space == TJCS_CMYK || colour_space == TJCS_YCCK)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                            "the JPEG file has CMYK colours: convert it to RGB");
    *ret_info = info;
    return RN_OK;
}

static enum rn_status probe_jpeg(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 struct rn_image_info *ret_info, struct rn_error *err) {
    tjhandle handle = tjInitDecompress();
    if (!handle) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the JPEG");
    enum rn_status status = read_header(handle, bytes, size_bytes, where, ret_info, err);
    tjDestroy(handle);
    if (status == RN_OK) read_exif(bytes, size_bytes, ret_info);
    return status;
}

// Cameras pad between segments, which the library warns of; any other warning means lost pixels.
static bool lost_pixels(tjhandle handle) {
    return tjGetErrorCode(handle) != TJERR_WARNING ||
           !strstr(tjGetErrorStr2(handle), "extraneous bytes");
}

static enum rn_status decode(tjhandle handle, const uint8_t *bytes, size_t size_bytes,
                             const char *where, const struct rn_image_limits *limits, int most,
                             struct rn_image *ret_image, int *ret_times, struct rn_error *err) {
    struct rn_image_info info = {0};
    enum rn_status status = read_header(handle, bytes, size_bytes, where, &info, err);
    if (status == RN_OK) status = rn_image_check_size(info.width, info.height, limits, where, err);
    if (status != RN_OK) return status;
    struct rn_image image;
    int times = rn_image_times_smaller(info.width, info.height, most);
    status = rn_image_init(info.width / times, info.height / times, &image, err);
    if (status != RN_OK) return status;
    image.has_alpha = false;
    if (tjDecompress2(handle, bytes, (unsigned long)size_bytes, image.pixels, image.width, 0,
                      image.height, TJPF_RGBA, TJFLAG_ACCURATEDCT | TJFLAG_LIMITSCANS) != 0 &&
        lost_pixels(handle)) {
        status = damaged(tjGetErrorStr2(handle), where, err);
        rn_image_finish(&image);
        return status;
    }
    *ret_image = image;
    *ret_times = times;
    return RN_OK;
}

static enum rn_status decode_smaller_jpeg(const uint8_t *bytes, size_t size_bytes,
                                          const char *where, const struct rn_image_limits *limits,
                                          int most, struct rn_image *ret_image, int *ret_times,
                                          struct rn_error *err) {
    tjhandle handle = tjInitDecompress();
    if (!handle) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the JPEG");
    enum rn_status status =
        decode(handle, bytes, size_bytes, where, limits, most, ret_image, ret_times, err);
    tjDestroy(handle);
    return status;
}

static enum rn_status decode_jpeg(const uint8_t *bytes, size_t size_bytes, const char *where,
                                  const struct rn_image_limits *limits, struct rn_image *ret_image,
                                  struct rn_error *err) {
    int times;
    return decode_smaller_jpeg(bytes, size_bytes, where, limits, 1, ret_image, &times, err);
}

const struct rn_codec rn_codec_jpeg = {.title = "JPEG",
                                       .library = "libturbojpeg",
                                       .is = is_jpeg,
                                       .probe = probe_jpeg,
                                       .decode = decode_jpeg,
                                       .decode_smaller = decode_smaller_jpeg,
                                       .profile = profile_jpeg,
                                       .strip = strip_jpeg};

static enum rn_status encode(tjhandle handle, const struct rn_image *image, int quality,
                             uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    unsigned long size = tjBufSize(image->width, image->height, TJSAMP_444);
    unsigned char *bytes = size == ULONG_MAX ? NULL : malloc(size);
    if (!bytes) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory to write a JPEG");
    if (tjCompress2(handle, image->pixels, image->width, 0, image->height, TJPF_RGBX, &bytes, &size,
                    TJSAMP_444, quality, TJFLAG_NOREALLOC | TJFLAG_ACCURATEDCT) != 0) {
        free(bytes);
        return rn_error_set(err, RN_ERROR_INVALID, "", "cannot write a JPEG: %s",
                            tjGetErrorStr2(handle));
    }
    uint8_t *trimmed = realloc(bytes, size);
    *ret_bytes = trimmed ? trimmed : bytes;
    *ret_size = size;
    return RN_OK;
}

enum rn_status rn_image_encode_jpeg(const struct rn_image *image, int quality, uint8_t **ret_bytes,
                                    size_t *ret_size, struct rn_error *err) {
    if (quality < 1 || quality > 100)
        return rn_error_set(err, RN_ERROR_INVALID, "quality", "a JPEG quality is 1 to 100, not %d",
                            quality);
    tjhandle handle = tjInitCompress();
    if (!handle) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory to write a JPEG");
    enum rn_status status = encode(handle, image, quality, ret_bytes, ret_size, err);
    tjDestroy(handle);
    return status;
}
