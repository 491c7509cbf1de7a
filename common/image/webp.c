#include <string.h>

#include "common/image/codec.h"

static bool is_webp(const uint8_t *bytes, size_t size_bytes) {
    return size_bytes >= 12 && memcmp(bytes, "RIFF", 4) == 0 && memcmp(bytes + 8, "WEBP", 4) == 0;
}

#ifdef RN_HAVE_WEBP
#include <stdlib.h>
#include <webp/decode.h>

// The content of a chunk of the RIFF file; the numbers are little-endian, chunks end on even bytes.
static bool find_chunk(const uint8_t *bytes, size_t size_bytes, const char name[4],
                       const uint8_t **ret_content, size_t *ret_size) {
    size_t at = 12;
    while (size_bytes >= 8 && at <= size_bytes - 8) {
        const uint8_t *head = bytes + at;
        size_t size =
            head[4] | (size_t)head[5] << 8 | (size_t)head[6] << 16 | (size_t)head[7] << 24;
        if (size > size_bytes - at - 8) return false;
        if (memcmp(head, name, 4) == 0) {
            *ret_content = head + 8;
            *ret_size = size;
            return true;
        }
        at += 8 + size + (size & 1);
    }
    return false;
}

static enum rn_status read_header(const uint8_t *bytes, size_t size_bytes, const char *where,
                                  struct rn_image_info *ret_info, struct rn_error *err) {
    WebPBitstreamFeatures features;
    if (WebPGetFeatures(bytes, size_bytes, &features) != VP8_STATUS_OK)
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "the WebP file's header is damaged: copy or export it again");
    if (features.has_animation)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                            "the WebP file is an animation: export one picture of it");
    *ret_info = (struct rn_image_info){.width = features.width,
                                       .height = features.height,
                                       .bit_depth = 8,
                                       .has_alpha = features.has_alpha != 0,
                                       .orientation = 1};
    return RN_OK;
}

// EXIF stands behind the pixels: a head alone does not have it.
static enum rn_status probe_webp(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 struct rn_image_info *ret_info, struct rn_error *err) {
    const uint8_t *exif;
    size_t size;
    enum rn_status status = read_header(bytes, size_bytes, where, ret_info, err);
    if (status == RN_OK && find_chunk(bytes, size_bytes, "EXIF", &exif, &size))
        rn_exif_read(exif, size, ret_info);
    return status;
}

static enum rn_status decode_webp(const uint8_t *bytes, size_t size_bytes, const char *where,
                                  const struct rn_image_limits *limits, struct rn_image *ret_image,
                                  struct rn_error *err) {
    struct rn_image_info info = {0};
    struct rn_image image;
    enum rn_status status = read_header(bytes, size_bytes, where, &info, err);
    if (status == RN_OK) status = rn_image_check_size(info.width, info.height, limits, where, err);
    if (status == RN_OK) status = rn_image_init(info.width, info.height, &image, err);
    if (status) return status;
    image.has_alpha = info.has_alpha;
    size_t stride = 4 * (size_t)image.width;
    if (!WebPDecodeRGBAInto(bytes, size_bytes, image.pixels, stride * (size_t)image.height,
                            (int)stride)) {
        rn_image_finish(&image);
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "the WebP file is damaged: copy or export it again");
    }
    *ret_image = image;
    return RN_OK;
}

static bool profile_webp(const uint8_t *bytes, size_t size_bytes, uint8_t **ret_profile,
                         size_t *ret_size) {
    const uint8_t *profile;
    if (!find_chunk(bytes, size_bytes, "ICCP", &profile, ret_size)) return false;
    *ret_profile = malloc(*ret_size + 1);
    if (*ret_profile) memcpy(*ret_profile, profile, *ret_size);
    return *ret_profile != NULL;
}
#endif

const struct rn_codec rn_codec_webp = {.title = "WebP",
                                       .library = "libwebp-dev",
#ifdef RN_HAVE_WEBP
                                       .probe = probe_webp,
                                       .decode = decode_webp,
                                       .profile = profile_webp,
#endif
                                       .is = is_webp};
