#include <png.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/buf.h"
#include "common/image/codec.h"

#define PROFILE_MAX (8 << 20) // bytes

// libpng reports failure by longjmp. Everything that must survive one lives in these two structs,
// and only the small `guarded` functions call setjmp.

struct reader {
    const uint8_t *bytes;
    size_t size, at;
    png_structp png;
    png_infop info;
    struct rn_image *image;
    bool profile_wanted;
    char problem[160];
};

static void keep_problem(png_structp png, png_const_charp text) {
    snprintf(png_get_error_ptr(png), sizeof(((struct reader *)0)->problem), "%s", text);
    png_longjmp(png, 1);
}

static void ignore_warning(png_structp png, png_const_charp text) {}

static bool is_png(const uint8_t *bytes, size_t size_bytes) {
    return size_bytes >= 8 && png_sig_cmp(bytes, 0, 8) == 0;
}

static void take_bytes(png_structp png, png_bytep to, size_t size) {
    struct reader *reader = png_get_io_ptr(png);
    if (size > reader->size - reader->at) png_error(png, "the file ends too early");
    memcpy(to, reader->bytes + reader->at, size);
    reader->at += size;
}

// Up to the first pixel data; everything but sizes, palette, transparency, how the camera was held
// and, where it is `wanted`, the colour profile is skipped. libpng's own size limit is lifted:
// ours, which the caller checks next, names itself. Damage in a chunk that libpng calls ancillary
// is an error too, or transparency could get lost silently.
static void read_header(struct reader *reader) {
    static const char kept[] = "eXIf\0iCCP";
    png_set_read_fn(reader->png, reader, take_bytes);
    png_set_user_limits(reader->png, PNG_UINT_31_MAX, PNG_UINT_31_MAX);
    png_set_crc_action(reader->png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
    png_set_keep_unknown_chunks(reader->png, PNG_HANDLE_CHUNK_NEVER, NULL, -1);
    png_set_keep_unknown_chunks(reader->png, PNG_HANDLE_CHUNK_AS_DEFAULT, (png_const_bytep)kept,
                                reader->profile_wanted ? 2 : 1);
    if (reader->profile_wanted) png_set_chunk_malloc_max(reader->png, PROFILE_MAX);
    png_read_info(reader->png, reader->info);
}

static bool has_alpha(const struct reader *reader) {
    return (png_get_color_type(reader->png, reader->info) & PNG_COLOR_MASK_ALPHA) != 0 ||
           png_get_valid(reader->png, reader->info, PNG_INFO_tRNS) != 0;
}

static void read_exif(const struct reader *reader, struct rn_image_info *info) {
    png_bytep exif = NULL;
    png_uint_32 size = 0;
    info->orientation = 1;
    if (png_get_eXIf_1(reader->png, reader->info, &size, &exif) != 0)
        rn_exif_read(exif, size, info);
}

static void read_pixels(struct reader *reader) {
    png_structp png = reader->png;
    png_set_expand(png);
    png_set_scale_16(png);
    png_set_gray_to_rgb(png);
    if (!has_alpha(reader)) png_set_add_alpha(png, 255, PNG_FILLER_AFTER);
    int passes = png_set_interlace_handling(png);
    png_read_update_info(png, reader->info);
    size_t stride = 4 * (size_t)reader->image->width;
    if (png_get_rowbytes(png, reader->info) != stride) png_error(png, "unexpected row size");
    for (int pass = 0; pass < passes; pass++)
        for (int y = 0; y < reader->image->height; y++)
            png_read_row(png, reader->image->pixels + (size_t)y * stride, NULL);
    png_read_end(png, NULL);
}

static bool guarded_read(struct reader *reader, void (*step)(struct reader *reader)) {
    if (setjmp(png_jmpbuf(reader->png))) return false;
    step(reader);
    return true;
}

static enum rn_status open_reader(struct reader *reader, const char *where, struct rn_error *err) {
    reader->png = png_create_read_struct(PNG_LIBPNG_VER_STRING, reader->problem, keep_problem,
                                         ignore_warning);
    if (reader->png) reader->info = png_create_info_struct(reader->png);
    if (reader->info) return RN_OK;
    png_destroy_read_struct(&reader->png, NULL, NULL);
    return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory to read the PNG");
}

static enum rn_status damaged(const struct reader *reader, const char *where,
                              struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_INVALID, where,
                        "the PNG file is damaged (%s): copy or export it again", reader->problem);
}

static enum rn_status probe_png(const uint8_t *bytes, size_t size_bytes, const char *where,
                                struct rn_image_info *ret_info, struct rn_error *err) {
    struct reader reader = {.bytes = bytes, .size = size_bytes};
    enum rn_status status = open_reader(&reader, where, err);
    if (status != RN_OK) return status;
    if (guarded_read(&reader, read_header)) {
        *ret_info = (struct rn_image_info){
            .width = (int)png_get_image_width(reader.png, reader.info),
            .height = (int)png_get_image_height(reader.png, reader.info),
            .bit_depth = png_get_bit_depth(reader.png, reader.info),
            .has_alpha = has_alpha(&reader),
        };
        read_exif(&reader, ret_info);
    } else {
        status = damaged(&reader, where, err);
    }
    png_destroy_read_struct(&reader.png, &reader.info, NULL);
    return status;
}

static enum rn_status decode_png(const uint8_t *bytes, size_t size_bytes, const char *where,
                                 const struct rn_image_limits *limits, struct rn_image *ret_image,
                                 struct rn_error *err) {
    struct rn_image image = {0};
    struct reader reader = {.bytes = bytes, .size = size_bytes, .image = &image};
    enum rn_status status = open_reader(&reader, where, err);
    if (status != RN_OK) return status;
    bool sound = guarded_read(&reader, read_header);
    if (sound) {
        int width = (int)png_get_image_width(reader.png, reader.info);
        int height = (int)png_get_image_height(reader.png, reader.info);
        status = rn_image_check_size(width, height, limits, where, err);
        if (status == RN_OK) status = rn_image_init(width, height, &image, err);
        image.has_alpha = has_alpha(&reader);
    }
    if (sound && status == RN_OK) sound = guarded_read(&reader, read_pixels);
    if (!sound) status = damaged(&reader, where, err);
    png_destroy_read_struct(&reader.png, &reader.info, NULL);
    if (status == RN_OK)
        *ret_image = image;
    else
        rn_image_finish(&image);
    return status;
}

static bool profile_png(const uint8_t *bytes, size_t size_bytes, uint8_t **ret_profile,
                        size_t *ret_size) {
    struct reader reader = {.bytes = bytes, .size = size_bytes, .profile_wanted = true};
    png_charp name;
    png_bytep profile;
    png_uint_32 size;
    int compression;
    uint8_t *copy = NULL;
    if (open_reader(&reader, "", NULL)) return false;
    if (guarded_read(&reader, read_header) &&
        png_get_iCCP(reader.png, reader.info, &name, &compression, &profile, &size) != 0 &&
        (copy = malloc(size + 1))) {
        memcpy(copy, profile, size);
        *ret_profile = copy;
        *ret_size = size;
    }
    png_destroy_read_struct(&reader.png, &reader.info, NULL);
    return copy != NULL;
}

const struct rn_codec rn_codec_png = {.title = "PNG",
                                      .library = "libpng",
                                      .is = is_png,
                                      .probe = probe_png,
                                      .decode = decode_png,
                                      .profile = profile_png};

struct writer {
    int width, height;
    int colour_type, bit_depth;
    int level;           // zlib, 0..9
    bool drop_alpha;     // rows are RGBA, the file is RGB
    const uint8_t *rows; // network byte order
    size_t stride;       // bytes
    char *key, *value;   // one tEXt chunk, or NULL
    struct rn_buf out;
    png_structp png;
    png_infop info;
    char problem[160];
};

static void put_bytes(png_structp png, png_bytep from, size_t size) {
    struct writer *writer = png_get_io_ptr(png);
    rn_buf_append(&writer->out, from, size);
    if (writer->out.failed) png_error(png, "out of memory");
}

static void flush_nothing(png_structp png) {}

static void write_file(struct writer *writer) {
    png_structp png = writer->png;
    png_set_write_fn(png, writer, put_bytes, flush_nothing);
    png_set_compression_level(png, writer->level);
    // The full filter search costs more than it saves at the quick levels.
    if (writer->level <= 3) png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_set_IHDR(png, writer->info, (png_uint_32)writer->width, (png_uint_32)writer->height,
                 writer->bit_depth, writer->colour_type, PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    if (writer->key) {
        png_text text = {
            .compression = PNG_TEXT_COMPRESSION_NONE, .key = writer->key, .text = writer->value};
        png_set_text(png, writer->info, &text, 1);
    }
    png_write_info(png, writer->info);
    if (writer->drop_alpha) png_set_filler(png, 0, PNG_FILLER_AFTER);
    for (int y = 0; y < writer->height; y++)
        png_write_row(png, writer->rows + (size_t)y * writer->stride);
    png_write_end(png, NULL);
}

static bool guarded_write(struct writer *writer) {
    if (setjmp(png_jmpbuf(writer->png))) return false;
    write_file(writer);
    return true;
}

static enum rn_status encode(struct writer *writer, uint8_t **ret_bytes, size_t *ret_size,
                             struct rn_error *err) {
    if (writer->level < 0 || writer->level > 9)
        return rn_error_set(err, RN_ERROR_INVALID, "level", "a PNG level is 0 to 9, not %d",
                            writer->level);
    enum rn_status status =
        rn_image_check_size(writer->width, writer->height, &rn_image_default_limits, "", err);
    if (status != RN_OK) return status;
    writer->png = png_create_write_struct(PNG_LIBPNG_VER_STRING, writer->problem, keep_problem,
                                          ignore_warning);
    if (writer->png) writer->info = png_create_info_struct(writer->png);
    rn_buf_init(&writer->out, SIZE_MAX);
    if (!writer->info)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory to write a PNG");
    else if (!guarded_write(writer))
        status =
            rn_error_set(err, RN_ERROR_NO_MEMORY, "", "cannot write a PNG: %s", writer->problem);
    png_destroy_write_struct(&writer->png, &writer->info);
    if (status == RN_OK) *ret_bytes = rn_buf_take(&writer->out, ret_size);
    rn_buf_finish(&writer->out);
    return status;
}

enum rn_status rn_image_encode_png(const struct rn_image *image, int level, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err) {
    struct writer writer = {
        .width = image->width,
        .height = image->height,
        .colour_type = image->has_alpha ? PNG_COLOR_TYPE_RGBA : PNG_COLOR_TYPE_RGB,
        .bit_depth = 8,
        .level = level,
        .drop_alpha = !image->has_alpha,
        .rows = image->pixels,
        .stride = 4 * (size_t)image->width,
    };
    return encode(&writer, ret_bytes, ret_size, err);
}

// round(clamp(value / scale, 0, 1) * 65535), big-endian; NaN becomes 0.
static uint8_t *samples_of(const struct rn_picture *picture, float scale) {
    size_t count = (size_t)picture->width * (size_t)picture->height * (size_t)picture->channels;
    uint8_t *to = malloc(2 * count);
    for (size_t i = 0; to && i < count; i++) {
        double share = (double)picture->values[i] / (double)scale;
        unsigned value = share >= 1 ? 65535 : share > 0 ? (unsigned)(share * 65535 + 0.5) : 0;
        to[2 * i] = (uint8_t)(value >> 8);
        to[2 * i + 1] = (uint8_t)value;
    }
    return to;
}

// `key` with the scale as its text; NULL: none.
static enum rn_status encode_samples(const struct rn_picture *picture, float scale, char *key,
                                     int level, uint8_t **ret_bytes, size_t *ret_size,
                                     struct rn_error *err) {
    enum rn_status status =
        rn_image_check_size(picture->width, picture->height, &rn_image_default_limits, "", err);
    if (status != RN_OK) return status;
    uint8_t *rows = samples_of(picture, scale);
    if (!rows) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory to write a PNG");
    char value[32];
    snprintf(value, sizeof value, "%.9g", (double)scale);
    struct writer writer = {
        .width = picture->width,
        .height = picture->height,
        .colour_type = picture->channels == 4   ? PNG_COLOR_TYPE_RGBA
                       : picture->channels == 3 ? PNG_COLOR_TYPE_RGB
                                                : PNG_COLOR_TYPE_GRAY,
        .bit_depth = 16,
        .level = level,
        .rows = rows,
        .stride = 2 * (size_t)picture->channels * (size_t)picture->width,
        .key = key,
        .value = value,
    };
    status = encode(&writer, ret_bytes, ret_size, err);
    free(rows);
    return status;
}

enum rn_status rn_picture_encode_png16(const struct rn_picture *picture, int level,
                                       uint8_t **ret_bytes, size_t *ret_size,
                                       struct rn_error *err) {
    return encode_samples(picture, 1, NULL, level, ret_bytes, ret_size, err);
}

enum rn_status rn_picture_encode_depth_png(const struct rn_picture *depth, float scale, int level,
                                           uint8_t **ret_bytes, size_t *ret_size,
                                           struct rn_error *err) {
    char key[] = "ripnerf:depth_scale";
    if (depth->channels != 1)
        return rn_error_set(err, RN_ERROR_INVALID, "depth", "a depth picture has one channel");
    if (!(scale > 0) || !isfinite(scale))
        return rn_error_set(err, RN_ERROR_INVALID, "scale",
                            "the depth scale must be a positive number");
    return encode_samples(depth, scale, key, level, ret_bytes, ret_size, err);
}
