// The two file formats behind image.h; internal to common/image.
#ifndef RN_COMMON_IMAGE_CODEC_H
#define RN_COMMON_IMAGE_CODEC_H

#include "common/image/image.h"

// Whether the bytes begin as a PNG or a JPEG does.
bool rn_png_is(const uint8_t *bytes, size_t size_bytes);
bool rn_jpeg_is(const uint8_t *bytes, size_t size_bytes);

// Header only; the bytes may end anywhere behind it. RN_ERROR_INVALID when they end before.
enum rn_status rn_png_probe(const uint8_t *bytes, size_t size_bytes, const char *where,
                            struct rn_image_info *ret_info, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_jpeg_probe(const uint8_t *bytes, size_t size_bytes, const char *where,
                             struct rn_image_info *ret_info, struct rn_error *err) RN_MUST_CHECK;

enum rn_status rn_png_decode(const uint8_t *bytes, size_t size_bytes, const char *where,
                             const struct rn_image_limits *limits, struct rn_image *ret_image,
                             struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_jpeg_decode(const uint8_t *bytes, size_t size_bytes, const char *where,
                              const struct rn_image_limits *limits, struct rn_image *ret_image,
                              struct rn_error *err) RN_MUST_CHECK;

// RN_ERROR_INVALID below 1 x 1, RN_ERROR_LIMIT above a limit.
enum rn_status rn_image_check_size(int width, int height, const struct rn_image_limits *limits,
                                   const char *where, struct rn_error *err) RN_MUST_CHECK;

#endif
