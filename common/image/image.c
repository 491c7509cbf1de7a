#include "common/image/image.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "common/base/file.h"
#include "common/image/codec.h"

#define FIRST_HEAD_BYTES 4096
#define PAGE 4096
#define LARGE_BYTES (8u << 20)

const struct rn_image_limits rn_image_default_limits = {
    .max_width = 16384,
    .max_height = 16384,
    .max_pixels = (size_t)1 << 27,
    .max_file_bytes = (size_t)1 << 30,
};

enum rn_status rn_image_check_size(int width, int height, const struct rn_image_limits *limits,
                                   const char *where, struct rn_error *err) {
    if (width < 1 || height < 1)
        return rn_error_set(err, RN_ERROR_INVALID, where, "an image of %d x %d pixels is empty",
                            width, height);
    if (width > limits->max_width || height > limits->max_height ||
        (size_t)width * (size_t)height > limits->max_pixels)
        return rn_error_set(err, RN_ERROR_LIMIT, where,
                            "an image of %d x %d pixels is over the limit (%d x %d, %zu in all): "
                            "scale it down",
                            width, height, limits->max_width, limits->max_height,
                            limits->max_pixels);
    return RN_OK;
}

static enum rn_status no_memory(struct rn_error *err, int width, int height) {
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for an image of %d x %d pixels",
                        width, height);
}

// Zeros. Large ones come from the kernel page by page as they are first written, which takes as
// long as a decoder does: on huge pages where the machine has them, a hint that may be refused.
static void *zeros(size_t count, size_t size) {
    void *block = calloc(count, size);
    size_t bytes = count * size;
    if (!block || bytes < LARGE_BYTES) return block;
    char *first = (char *)block + (PAGE - (uintptr_t)block % PAGE) % PAGE;
    (void)madvise(first, (bytes - PAGE) / PAGE * PAGE, MADV_HUGEPAGE);
    return block;
}

enum rn_status rn_image_init(int width, int height, struct rn_image *ret_image,
                             struct rn_error *err) {
    enum rn_status status = rn_image_check_size(width, height, &rn_image_default_limits, "", err);
    if (status != RN_OK) return status;
    uint8_t *pixels = zeros((size_t)width * (size_t)height, 4);
    if (!pixels) return no_memory(err, width, height);
    *ret_image =
        (struct rn_image){.width = width, .height = height, .has_alpha = true, .pixels = pixels};
    return RN_OK;
}

void rn_image_finish(struct rn_image *image) {
    free(image->pixels);
    *image = (struct rn_image){0};
}

enum rn_status rn_picture_init(int width, int height, int channels, struct rn_picture *ret_picture,
                               struct rn_error *err) {
    if (channels != 1 && channels != 3 && channels != 4)
        return rn_error_set(err, RN_ERROR_INVALID, "", "a picture has 1, 3 or 4 channels, not %d",
                            channels);
    enum rn_status status = rn_image_check_size(width, height, &rn_image_default_limits, "", err);
    if (status != RN_OK) return status;
    float *values = zeros((size_t)width * (size_t)height, (size_t)channels * sizeof(float));
    if (!values) return no_memory(err, width, height);
    *ret_picture = (struct rn_picture){
        .width = width, .height = height, .channels = channels, .values = values};
    return RN_OK;
}

void rn_picture_finish(struct rn_picture *picture) {
    free(picture->values);
    *picture = (struct rn_picture){0};
}

static const struct rn_codec *const codecs[] = {&rn_codec_png,  &rn_codec_jpeg, &rn_codec_webp,
                                                &rn_codec_tiff, &rn_codec_heif, &rn_codec_exr};

// The format of the bytes, by how they begin.
static enum rn_status find_codec(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 const struct rn_codec **ret_codec, struct rn_error *err) {
    for (size_t i = 0; i < sizeof codecs / sizeof *codecs; i++) {
        if (!codecs[i]->is(bytes, size_bytes)) continue;
        if (!codecs[i]->decode)
            return rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                                "this is a file of the format %s, which was built without: build "
                                "with %s, or convert the file to PNG or JPEG",
                                codecs[i]->title, codecs[i]->library);
        *ret_codec = codecs[i];
        return RN_OK;
    }
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        size_bytes == 0 ? "the file is empty"
                                        : "this is no picture of a known format: convert it to PNG "
                                          "or JPEG");
}

// Most headers are within the first kilobytes, but metadata may push them anywhere: reads longer
// and longer heads until one suffices or the file ends.
static enum rn_status probe_file(const char *path, const struct rn_image_limits *limits,
                                 struct rn_image_info *ret_info, struct rn_error *err) {
    const struct rn_codec *codec = NULL;
    uint8_t *head = NULL;
    enum rn_status status;
    size_t size = 0;
    uint64_t file_size = 0;
    for (size_t capacity = FIRST_HEAD_BYTES;; capacity *= 8) {
        uint8_t *grown = realloc(head, capacity);
        if (!grown) {
            status = rn_error_set(err, RN_ERROR_NO_MEMORY, path, "no memory to read the header");
            break;
        }
        head = grown;
        status = rn_file_read_head(path, head, capacity, &size, &file_size, err);
        if (status != RN_OK) break;
        if (file_size > limits->max_file_bytes) {
            status = rn_error_set(err, RN_ERROR_LIMIT, path,
                                  "the file is larger than the limit of %zu bytes",
                                  limits->max_file_bytes);
            break;
        }
        if ((status = find_codec(head, size, path, &codec, err))) break;
        status = codec->probe(head, size, path, ret_info, err);
        if (status != RN_ERROR_INVALID || size < capacity) break;
    }
    free(head);
    return status;
}

enum rn_status rn_image_probe(const char *path, const struct rn_image_limits *limits,
                              struct rn_image_info *ret_info, struct rn_error *err) {
    if (!limits) limits = &rn_image_default_limits;
    struct rn_image_info info;
    enum rn_status status = probe_file(path, limits, &info, err);
    if (status == RN_OK) status = rn_image_check_size(info.width, info.height, limits, path, err);
    if (status == RN_OK) *ret_info = info;
    return status;
}

static enum rn_status decode(const struct rn_codec *codec, const uint8_t *bytes, size_t size_bytes,
                             const char *where, const struct rn_image_limits *limits, int most,
                             struct rn_image *ret_image, int *ret_times, struct rn_error *err) {
    *ret_times = 1;
    if (most > 1 && codec->decode_smaller)
        return codec->decode_smaller(bytes, size_bytes, where, limits, most, ret_image, ret_times,
                                     err);
    return codec->decode(bytes, size_bytes, where, limits, ret_image, err);
}

static enum rn_status decode_smaller(const uint8_t *bytes, size_t size_bytes, const char *where,
                                     const struct rn_image_limits *limits, int most,
                                     struct rn_image *ret_image, int *ret_times,
                                     struct rn_error *err) {
    const struct rn_codec *codec = NULL;
    struct rn_image image;
    uint8_t *profile;
    size_t profile_size;
    int times;
    enum rn_status status = find_codec(bytes, size_bytes, where, &codec, err);
    if (status == RN_OK)
        status = decode(codec, bytes, size_bytes, where, limits, most, &image, &times, err);
    if (status) return status;
    if (codec->profile && codec->profile(bytes, size_bytes, &profile, &profile_size)) {
        status = rn_icc_to_srgb(profile, profile_size, where, &image, err);
        free(profile);
    }
    if (status != RN_OK) {
        rn_image_finish(&image);
        return status;
    }
    *ret_image = image;
    *ret_times = times;
    return RN_OK;
}

enum rn_status rn_image_decode(const void *bytes, size_t size_bytes, const char *where,
                               const struct rn_image_limits *limits, struct rn_image *ret_image,
                               struct rn_error *err) {
    int times;
    if (!limits) limits = &rn_image_default_limits;
    return decode_smaller(bytes, size_bytes, where, limits, 1, ret_image, &times, err);
}

static enum rn_status strip(const struct rn_codec *codec, const uint8_t *bytes, size_t size,
                            const char *path, uint8_t **ret_bytes, size_t *ret_size,
                            struct rn_error *err) {
    uint8_t *profile = NULL;
    size_t profile_size;
    if (!codec->is(bytes, size))
        return rn_error_set(err, RN_ERROR_INVALID, path, "the file changes while it is read");
    bool converted = codec->profile && codec->profile(bytes, size, &profile, &profile_size) &&
                     !rn_icc_is_srgb(profile, profile_size);
    free(profile);
    if (converted)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, path, "its colours are not sRGB's");
    return codec->strip(bytes, size, path, ret_bytes, ret_size, err);
}

// By its first bytes: others are not read in whole.
static enum rn_status find_kept(const char *path, const struct rn_codec **ret_codec,
                                struct rn_error *err) {
    uint8_t head[FIRST_HEAD_BYTES];
    uint64_t file_size;
    size_t size;
    enum rn_status status = rn_file_read_head(path, head, sizeof head, &size, &file_size, err);
    if (status == RN_OK) status = find_codec(head, size, path, ret_codec, err);
    if (status != RN_OK || (*ret_codec)->strip) return status;
    return rn_error_set(err, RN_ERROR_UNSUPPORTED, path, "%s files are not kept as they are",
                        (*ret_codec)->title);
}

enum rn_status rn_image_strip(const char *path, const struct rn_image_limits *limits,
                              uint8_t **ret_bytes, size_t *ret_size, struct rn_error *err) {
    if (!limits) limits = &rn_image_default_limits;
    const struct rn_codec *codec = NULL;
    uint8_t *bytes;
    size_t size;
    enum rn_status status = find_kept(path, &codec, err);
    if (status == RN_OK) status = rn_file_read(path, limits->max_file_bytes, &bytes, &size, err);
    if (status != RN_OK) return status;
    status = strip(codec, bytes, size, path, ret_bytes, ret_size, err);
    free(bytes);
    return status;
}

// Where the stored pixel (x, y) goes; the new picture is `across` wide.
static size_t turned_place(int orientation, int width, int height, int x, int y, int across) {
    int right = width - 1 - x, up = height - 1 - y;
    int to_x = x, to_y = y;
    switch (orientation) {
    case 2:
        to_x = right;
        break;
    case 3:
        to_x = right, to_y = up;
        break;
    case 4:
        to_y = up;
        break;
    case 5:
        to_x = y, to_y = x;
        break;
    case 6:
        to_x = up, to_y = x;
        break;
    case 7:
        to_x = up, to_y = right;
        break;
    case 8:
        to_x = y, to_y = right;
        break;
    default:
        break;
    }
    return (size_t)to_y * (size_t)across + (size_t)to_x;
}

enum rn_status rn_image_turn(struct rn_image *image, int orientation, struct rn_error *err) {
    struct rn_image turned;
    bool lies = orientation >= 5;
    if (orientation < 1 || orientation > 8)
        return rn_error_set(err, RN_ERROR_INVALID, "orientation", "is 1 to 8, not %d", orientation);
    if (orientation == 1) return RN_OK;
    int across = lies ? image->height : image->width;
    enum rn_status status =
        rn_image_init(across, lies ? image->width : image->height, &turned, err);
    if (status) return status;
    turned.has_alpha = image->has_alpha;
    const uint8_t *from = image->pixels;
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width; x++, from += 4)
            memcpy(turned.pixels +
                       4 * turned_place(orientation, image->width, image->height, x, y, across),
                   from, 4);
    rn_image_finish(image);
    *image = turned;
    return RN_OK;
}

enum rn_status rn_image_read_smaller(const char *path, const struct rn_image_limits *limits,
                                     int most, struct rn_image *ret_image, int *ret_times,
                                     struct rn_error *err) {
    if (!limits) limits = &rn_image_default_limits;
    uint8_t *bytes;
    size_t size;
    enum rn_status status = rn_file_read(path, limits->max_file_bytes, &bytes, &size, err);
    if (status != RN_OK) return status;
    status = decode_smaller(bytes, size, path, limits, most, ret_image, ret_times, err);
    free(bytes);
    return status;
}

enum rn_status rn_image_read(const char *path, const struct rn_image_limits *limits,
                             struct rn_image *ret_image, struct rn_error *err) {
    int times;
    return rn_image_read_smaller(path, limits, 1, ret_image, &times, err);
}

enum rn_status rn_image_write_png(const struct rn_image *image, const char *path, int level,
                                  struct rn_error *err) {
    uint8_t *bytes;
    size_t size;
    enum rn_status status = rn_image_encode_png(image, level, &bytes, &size, err);
    if (status != RN_OK) return status;
    status = rn_file_write_atomic(path, bytes, size, err);
    free(bytes);
    return status;
}

// What is not finite is 0. Positive floats are in the order of their bits; compared as integers
// many are done at once, in a tenth of the time.
static uint8_t to_byte(float value) {
    const int32_t one = 0x3f800000, infinite = 0x7f800000;
    int32_t bits;
    memcpy(&bits, &value, sizeof bits);
    bits &= -((bits > 0) & (bits < infinite));
    bits = bits < one ? bits : one;
    memcpy(&value, &bits, sizeof value);
    return (uint8_t)(int32_t)(value * 255.0f + 0.5f);
}

#define BLOCK 256 // pixels

static void to_bytes(const float *restrict values, size_t n, uint8_t *restrict ret_bytes) {
    for (size_t i = 0; i < n; i++)
        ret_bytes[i] = to_byte(values[i]);
}

// Bytes of 1, 3 or 4 channels as red, green, blue, alpha. Up to three beyond the last are read.
static void spread(const uint8_t *bytes, size_t n, size_t channels, uint8_t *ret_pixels) {
    for (size_t i = 0; i < n; i++) {
        uint8_t *to = ret_pixels + 4 * i;
        memcpy(to, bytes + i * channels, 4);
        if (channels == 1) to[1] = to[2] = to[0];
        if (channels < 4) to[3] = 255;
    }
}

enum rn_status rn_picture_to_image(const struct rn_picture *picture, struct rn_image *ret_image,
                                   struct rn_error *err) {
    struct rn_image image;
    enum rn_status status = rn_image_init(picture->width, picture->height, &image, err);
    if (status != RN_OK) return status;
    size_t channels = (size_t)picture->channels;
    image.has_alpha = channels == 4;
    size_t count = (size_t)image.width * (size_t)image.height;
    for (size_t at = 0; at < count; at += BLOCK) {
        size_t n = count - at < BLOCK ? count - at : BLOCK;
        uint8_t bytes[4 * BLOCK + 3];
        to_bytes(picture->values + at * channels, n * channels, bytes);
        spread(bytes, n, channels, image.pixels + 4 * at);
    }
    *ret_image = image;
    return RN_OK;
}

enum rn_status rn_image_composite(const struct rn_image *image, const float background[3],
                                  struct rn_picture *ret_picture, struct rn_error *err) {
    for (int c = 0; c < 3; c++)
        if (!(background[c] >= 0 && background[c] <= 1))
            return rn_error_set(err, RN_ERROR_INVALID, "background",
                                "a background colour's values must be 0 to 1");
    struct rn_picture picture;
    enum rn_status status = rn_picture_init(image->width, image->height, 3, &picture, err);
    if (status != RN_OK) return status;
    float unit[256];
    for (int i = 0; i < 256; i++)
        unit[i] = (float)i / 255.0f;
    size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++) {
        const uint8_t *from = image->pixels + 4 * i;
        float alpha = unit[from[3]], rest = 1.0f - alpha;
        for (int c = 0; c < 3; c++)
            picture.values[3 * i + (size_t)c] = unit[from[c]] * alpha + rest * background[c];
    }
    *ret_picture = picture;
    return RN_OK;
}
