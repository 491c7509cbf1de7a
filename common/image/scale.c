#include <stdlib.h>
#include <string.h>

#include "common/image/image.h"

#define MAX_LEVELS 15 // 2^14 = 16384, the largest side

// Part of source cell `i` that lies in target cell `j`, in units of 1 / target: source cells are
// `target` units long, target cells `source` units.
static uint64_t overlap(int i, int j, int source, int target) {
    int64_t begin = (int64_t)i * target, end = begin + target;
    int64_t first = (int64_t)j * source, last = first + source;
    return (uint64_t)((end < last ? end : last) - (begin > first ? begin : first));
}

static int first_overlapping(int j, int source, int target) {
    return (int)((int64_t)j * source / target);
}

static int end_overlapping(int j, int source, int target) {
    return (int)(((int64_t)(j + 1) * source + target - 1) / target);
}

// Adds one source row, weighted by its overlap and averaged over columns, to `sums` (4 a target
// pixel). Premultiplied colour sums are of c * a. At most 255 * 255 * source area <= 2^44.
static void add_row(const struct rn_image *image, int y, int width, uint64_t row_weight,
                    enum rn_downscale mode, uint64_t *sums) {
    const uint8_t *row = image->pixels + 4 * (size_t)y * (size_t)image->width;
    for (int x = 0; x < width; x++) {
        uint64_t *sum = sums + 4 * (size_t)x;
        int end = end_overlapping(x, image->width, width);
        for (int i = first_overlapping(x, image->width, width); i < end; i++) {
            const uint8_t *pixel = row + 4 * (size_t)i;
            uint64_t weight = row_weight * overlap(i, x, image->width, width);
            uint64_t factor = mode == RN_DOWNSCALE_PREMULTIPLIED ? weight * pixel[3] : weight;
            for (int c = 0; c < 3; c++)
                sum[c] += factor * pixel[c];
            sum[3] += weight * pixel[3];
        }
    }
}

// n / d rounded half up.
static uint8_t divide_rounded(uint64_t n, uint64_t d) {
    return (uint8_t)((2 * n + d) / (2 * d));
}

static void store_row(const uint64_t *sums, int width, uint64_t area, enum rn_downscale mode,
                      uint8_t *to) {
    for (int x = 0; x < width; x++, sums += 4, to += 4) {
        for (int c = 0; c < 3; c++)
            if (mode == RN_DOWNSCALE_STRAIGHT)
                to[c] = (uint8_t)(sums[c] / area);
            else
                to[c] = sums[3] > 0 ? divide_rounded(sums[c], sums[3]) : 0;
        to[3] = mode == RN_DOWNSCALE_STRAIGHT ? (uint8_t)(sums[3] / area)
                                              : divide_rounded(sums[3], area);
    }
}

enum rn_status rn_image_downscale(const struct rn_image *image, int width, int height,
                                  enum rn_downscale mode, struct rn_image *ret_image,
                                  struct rn_error *err) {
    if (width < 1 || height < 1 || width > image->width || height > image->height)
        return rn_error_set(err, RN_ERROR_INVALID, "",
                            "cannot scale an image of %d x %d pixels down to %d x %d", image->width,
                            image->height, width, height);
    struct rn_image out;
    enum rn_status status = rn_image_init(width, height, &out, err);
    if (status != RN_OK) return status;
    out.has_alpha = image->has_alpha;
    size_t row_bytes = 4 * (size_t)width * sizeof(uint64_t);
    if (width == image->width && height == image->height) {
        memcpy(out.pixels, image->pixels, 4 * (size_t)width * (size_t)height);
        *ret_image = out;
        return RN_OK;
    }
    uint64_t *sums = malloc(row_bytes);
    if (!sums) {
        rn_image_finish(&out);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory to scale an image");
    }
    uint64_t area = (uint64_t)image->width * (uint64_t)image->height;
    for (int y = 0; y < height; y++) {
        memset(sums, 0, row_bytes);
        int end = end_overlapping(y, image->height, height);
        for (int i = first_overlapping(y, image->height, height); i < end; i++)
            add_row(image, i, width, overlap(i, y, image->height, height), mode, sums);
        store_row(sums, width, area, mode, out.pixels + 4 * (size_t)y * (size_t)width);
    }
    free(sums);
    *ret_image = out;
    return RN_OK;
}

// The 2x2 box mean of a float image, in place: the published converter's order of additions,
// ((top left + top right) + bottom left) + bottom right, in fp32.
static void halve(float *values, size_t width, size_t height) {
    size_t half = width / 2;
    for (size_t y = 0; y < height / 2; y++)
        for (size_t x = 0; x < half; x++) {
            const float *top = values + 4 * (2 * y * width + 2 * x), *bottom = top + 4 * width;
            float *to = values + 4 * (y * half + x); // never behind what is still to be read
            for (int c = 0; c < 4; c++)
                to[c] = (top[c] + top[c + 4] + bottom[c] + bottom[c + 4]) / 4.0f;
        }
}

// Levels 1 .. levels - 1; level 0 gives the size.
static enum rn_status fill_pyramid(float *values, int levels, bool has_alpha,
                                   struct rn_image *pyramid, struct rn_error *err) {
    for (int level = 1; level < levels; level++) {
        int width = pyramid[level - 1].width, height = pyramid[level - 1].height;
        halve(values, (size_t)width, (size_t)height);
        struct rn_image *out = &pyramid[level];
        enum rn_status status = rn_image_init(width / 2, height / 2, out, err);
        if (status != RN_OK) return status;
        out->has_alpha = has_alpha;
        size_t count = 4 * (size_t)out->width * (size_t)out->height;
        for (size_t i = 0; i < count; i++)
            out->pixels[i] = (uint8_t)(values[i] * 255.0f);
    }
    return RN_OK;
}

enum rn_status rn_image_legacy_pyramid(const struct rn_image *image, int levels,
                                       struct rn_image *ret_levels, struct rn_error *err) {
    if (levels < 1 || levels > MAX_LEVELS)
        return rn_error_set(err, RN_ERROR_INVALID, "levels", "must be 1 to %d", MAX_LEVELS);
    int divisor = 1 << (levels - 1);
    if (image->width % divisor != 0 || image->height % divisor != 0)
        return rn_error_set(err, RN_ERROR_INVALID, "",
                            "an image of %d x %d pixels cannot be halved %d times: its sides must "
                            "be multiples of %d",
                            image->width, image->height, levels - 1, divisor);
    size_t count = 4 * (size_t)image->width * (size_t)image->height;
    float *values = malloc(count * sizeof *values);
    if (!values) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory to scale an image");
    for (size_t i = 0; i < count; i++)
        values[i] = (float)image->pixels[i] / 255.0f;
    struct rn_image pyramid[MAX_LEVELS] = {0};
    enum rn_status status = rn_image_downscale(image, image->width, image->height,
                                               RN_DOWNSCALE_STRAIGHT, &pyramid[0], err);
    if (status == RN_OK) status = fill_pyramid(values, levels, image->has_alpha, pyramid, err);
    free(values);
    for (int level = 0; level < levels; level++)
        if (status == RN_OK)
            ret_levels[level] = pyramid[level];
        else
            rn_image_finish(&pyramid[level]);
    return status;
}
