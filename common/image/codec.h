// The file formats behind image.h: one row a format, one file a row; internal to common/image.
#ifndef RN_COMMON_IMAGE_CODEC_H
#define RN_COMMON_IMAGE_CODEC_H

#include "common/image/image.h"

// A format. A build without its library knows the file by its first bytes and has no decoder.
// Thread-safety: constant; its functions may be called by any thread.
struct rn_codec {
    const char *title;   // "WebP"
    const char *library; // Debian's name of what reads it, for the message of a build without
    bool (*is)(const uint8_t *bytes, size_t size_bytes);
    // Header only; the bytes may end anywhere behind it. RN_ERROR_INVALID when they end before.
    enum rn_status (*probe)(const uint8_t *bytes, size_t size_bytes, const char *where,
                            struct rn_image_info *ret_info, struct rn_error *err);
    // The pixels as they are stored, in the file's own colours.
    enum rn_status (*decode)(const uint8_t *bytes, size_t size_bytes, const char *where,
                             const struct rn_image_limits *limits, struct rn_image *ret_image,
                             struct rn_error *err);
    // The same made smaller while it is decoded, for less: each pixel is the mean of *ret_times x
    // *ret_times, in the file's own colours; *ret_times divides `most` and both sides. Only called
    // with 2 or more; 1: as decode. NULL: the format cannot.
    enum rn_status (*decode_smaller)(const uint8_t *bytes, size_t size_bytes, const char *where,
                                     const struct rn_image_limits *limits, int most,
                                     struct rn_image *ret_image, int *ret_times,
                                     struct rn_error *err);
    // The file's ICC profile, malloc'd; false without one, or where memory is out. NULL: the format
    // has none.
    bool (*profile)(const uint8_t *bytes, size_t size_bytes, uint8_t **ret_profile,
                    size_t *ret_size);
    // The file without what is not the picture, malloc'd; a decodable one. NULL: files of this
    // format are not kept.
    enum rn_status (*strip)(const uint8_t *bytes, size_t size_bytes, const char *where,
                            uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err);
};

extern const struct rn_codec rn_codec_png, rn_codec_jpeg, rn_codec_webp, rn_codec_tiff,
    rn_codec_heif, rn_codec_exr;

// RN_ERROR_INVALID below 1 x 1, RN_ERROR_LIMIT above a limit.
enum rn_status rn_image_check_size(int width, int height, const struct rn_image_limits *limits,
                                   const char *where, struct rn_error *err) RN_MUST_CHECK;

// Whether the pictures of a HEIC or AVIF file, whole or its beginning, are made of a bounded number
// of parts (derived pictures of their sources, pictures with their alpha channels), none of itself:
// libheif 1.15 follows them without end, and by its caller's stack. Allocates by the references
// that the file has, at most 65,536. RN_ERROR_INVALID, RN_ERROR_LIMIT, RN_ERROR_NO_MEMORY. What
// else is wrong with the file, and what is cut off, is not looked at.
enum rn_status rn_heif_check_parts(const uint8_t *bytes, size_t size_bytes, const char *where,
                                   struct rn_error *err) RN_MUST_CHECK;

// Whether all pictures of a whole HEIC or AVIF file are within the limits, and none of a grid or
// coded larger than is said of it: as their own data have it, for which libheif 1.15 and
// its decoders make room, and beyond which they write. RN_ERROR_INVALID, RN_ERROR_LIMIT,
// RN_ERROR_NO_MEMORY; RN_ERROR_UNSUPPORTED for overlays and identities, which that library follows
// to pictures that are not there. What else is wrong with the file is not looked at, nor at a size
// that one frame of an AV1 stream has for itself.
enum rn_status rn_heif_check_sizes(const uint8_t *bytes, size_t size_bytes,
                                   const struct rn_image_limits *limits, const char *where,
                                   struct rn_error *err) RN_MUST_CHECK;

// What an EXIF block, which begins with the TIFF header, says of `orientation`, `camera_key` and
// `located_at`; 1, 0 and not located where it says nothing or is damaged.
void rn_exif_read(const uint8_t *bytes, size_t size_bytes, struct rn_image_info *info);

// Takes the picture's colours from an ICC profile to sRGB, with relative colorimetric intent and
// black point compensation. A profile that changes no colour by more than one of 255 changes none.
// RN_ERROR_INVALID for a damaged profile or one of other colours than grey or RGB.
enum rn_status rn_icc_to_srgb(const uint8_t *profile, size_t size_bytes, const char *where,
                              struct rn_image *image, struct rn_error *err) RN_MUST_CHECK;

// Whether that changes nothing; false for a profile that it refuses.
bool rn_icc_is_srgb(const uint8_t *profile, size_t size_bytes);

// Linear light to an sRGB byte: IEC 61966-2-1's curve, clamped to 0 to 1; not finite: 0.
uint8_t rn_srgb_byte(float linear);

#endif
