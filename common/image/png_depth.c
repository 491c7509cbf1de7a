// Depths out of a PNG as rn_picture_encode_depth_png writes it: 16-bit grey, the scale in a text.
#include <png.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/codec.h"

// libpng reports failure by longjmp: what must survive one lives here.
struct depth_reader {
    const uint8_t *bytes;
    size_t size, at;
    png_structp png;
    png_infop info;
    int width, height;
    float scale;
    uint8_t *samples; // two bytes each, big endian
    png_bytepp rows;
    char problem[160];
};

static void keep_problem(png_structp png, png_const_charp text) {
    snprintf(png_get_error_ptr(png), sizeof(((struct depth_reader *)0)->problem), "%s", text);
    png_longjmp(png, 1);
}

static void ignore_warning(png_structp png, png_const_charp text) {
    (void)png;
    (void)text;
}

static void take_bytes(png_structp png, png_bytep to, size_t size) {
    struct depth_reader *r = png_get_io_ptr(png);
    if (size > r->size - r->at) png_error(png, "the file ends too early");
    memcpy(to, r->bytes + r->at, size);
    r->at += size;
}

static void take_scale(struct depth_reader *r) {
    png_textp text;
    int count = 0;
    png_get_text(r->png, r->info, &text, &count);
    for (int i = 0; i < count; i++)
        if (strcmp(text[i].key, "ripnerf:depth_scale") == 0) r->scale = strtof(text[i].text, NULL);
}

// False after an error; the problem says which.
static bool guarded_header(struct depth_reader *r) {
    if (setjmp(png_jmpbuf(r->png))) return false;
    png_set_read_fn(r->png, r, take_bytes);
    png_read_info(r->png, r->info);
    r->width = (int)png_get_image_width(r->png, r->info);
    r->height = (int)png_get_image_height(r->png, r->info);
    take_scale(r);
    if (png_get_bit_depth(r->png, r->info) != 16 ||
        png_get_color_type(r->png, r->info) != PNG_COLOR_TYPE_GRAY ||
        !(r->scale > 0 && isfinite(r->scale)))
        png_error(r->png, "it is no depth picture: 16-bit grey with a depth scale");
    return true;
}

static bool guarded_rows(struct depth_reader *r) {
    if (setjmp(png_jmpbuf(r->png))) return false;
    png_read_image(r->png, r->rows);
    return true;
}

static enum rn_status read_samples(struct depth_reader *r, struct rn_error *err) {
    if (!guarded_header(r)) return rn_error_set(err, RN_ERROR_CORRUPT, "depth", "%s", r->problem);
    enum rn_status status =
        rn_image_check_size(r->width, r->height, &rn_image_default_limits, "depth", err);
    if (status != RN_OK) return status;
    size_t stride = 2 * (size_t)r->width;
    r->samples = malloc(stride * (size_t)r->height);
    r->rows = malloc((size_t)r->height * sizeof *r->rows);
    if (!r->samples || !r->rows)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "depth", "out of memory");
    for (int y = 0; y < r->height; y++)
        r->rows[y] = r->samples + (size_t)y * stride;
    if (!guarded_rows(r)) return rn_error_set(err, RN_ERROR_CORRUPT, "depth", "%s", r->problem);
    return RN_OK;
}

static enum rn_status to_picture(const struct depth_reader *r, struct rn_picture *ret_depth,
                                 struct rn_error *err) {
    size_t count = (size_t)r->width * (size_t)r->height;
    float *values = malloc(count * sizeof *values);
    if (!values) return rn_error_set(err, RN_ERROR_NO_MEMORY, "depth", "out of memory");
    for (size_t i = 0; i < count; i++) {
        unsigned sample = (unsigned)r->samples[2 * i] << 8 | r->samples[2 * i + 1];
        values[i] = sample == 65535 ? INFINITY : (float)sample * (r->scale / 65535);
    }
    *ret_depth = (struct rn_picture){
        .width = r->width, .height = r->height, .channels = 1, .values = values};
    return RN_OK;
}

enum rn_status rn_picture_decode_depth_png(const void *bytes, size_t size,
                                           struct rn_picture *ret_depth, struct rn_error *err) {
    struct depth_reader r = {.bytes = bytes, .size = size};
    r.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, r.problem, keep_problem, ignore_warning);
    r.info = r.png ? png_create_info_struct(r.png) : NULL;
    enum rn_status status = r.info
                                ? read_samples(&r, err)
                                : rn_error_set(err, RN_ERROR_NO_MEMORY, "depth", "out of memory");
    if (status == RN_OK) status = to_picture(&r, ret_depth, err);
    png_destroy_read_struct(&r.png, &r.info, NULL);
    free(r.samples);
    free(r.rows);
    return status;
}
