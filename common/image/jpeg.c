#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>

#include "common/image/codec.h"

bool rn_jpeg_is(const uint8_t *bytes, size_t size_bytes) {
    return size_bytes >= 3 && bytes[0] == 0xff && bytes[1] == 0xd8 && bytes[2] == 0xff;
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

enum rn_status rn_jpeg_probe(const uint8_t *bytes, size_t size_bytes, const char *where,
                             struct rn_image_info *ret_info, struct rn_error *err) {
    tjhandle handle = tjInitDecompress();
    if (!handle) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the JPEG");
    enum rn_status status = read_header(handle, bytes, size_bytes, where, ret_info, err);
    tjDestroy(handle);
    return status;
}

// Cameras pad between segments, which the library warns of; any other warning means lost pixels.
static bool lost_pixels(tjhandle handle) {
    return tjGetErrorCode(handle) != TJERR_WARNING ||
           !strstr(tjGetErrorStr2(handle), "extraneous bytes");
}

static enum rn_status decode(tjhandle handle, const uint8_t *bytes, size_t size_bytes,
                             const char *where, const struct rn_image_limits *limits,
                             struct rn_image *ret_image, struct rn_error *err) {
    struct rn_image_info info = {0};
    enum rn_status status = read_header(handle, bytes, size_bytes, where, &info, err);
    if (status == RN_OK) status = rn_image_check_size(info.width, info.height, limits, where, err);
    struct rn_image image;
    if (status == RN_OK) status = rn_image_init(info.width, info.height, &image, err);
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
    return RN_OK;
}

enum rn_status rn_jpeg_decode(const uint8_t *bytes, size_t size_bytes, const char *where,
                              const struct rn_image_limits *limits, struct rn_image *ret_image,
                              struct rn_error *err) {
    tjhandle handle = tjInitDecompress();
    if (!handle) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the JPEG");
    enum rn_status status = decode(handle, bytes, size_bytes, where, limits, ret_image, err);
    tjDestroy(handle);
    return status;
}

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
