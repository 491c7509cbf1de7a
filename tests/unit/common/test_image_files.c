// PNG and JPEG: every kind of file, limits, damage, and what the encoders write.
#include <math.h>
#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/image/image.h"
#include "tests/support/suite.h"

struct bytes {
    uint8_t *data;
    size_t size;
};

static char folder[64];

static void enter_folder(void) {
    strcpy(folder, "/tmp/test_image.XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
}

static void leave_folder(void) {
    ck_assert_int_eq(rn_remove_tree(folder, NULL), RN_OK);
}

static const char *store(struct bytes bytes) {
    static char path[256];
    snprintf(path, sizeof path, "%s/image", folder);
    ck_assert_int_eq(rn_file_write_atomic(path, bytes.data, bytes.size, NULL), RN_OK);
    return path;
}

// What kind of PNG to build, and the samples in it.
struct kind {
    int colour_type, bit_depth;
    bool transparency; // a tRNS chunk
};

static const struct kind kinds[] = {
    {PNG_COLOR_TYPE_GRAY, 1, false},        {PNG_COLOR_TYPE_GRAY, 2, true},
    {PNG_COLOR_TYPE_GRAY, 4, false},        {PNG_COLOR_TYPE_GRAY, 8, false},
    {PNG_COLOR_TYPE_GRAY, 8, true},         {PNG_COLOR_TYPE_GRAY, 16, false},
    {PNG_COLOR_TYPE_GRAY, 16, true},        {PNG_COLOR_TYPE_GRAY_ALPHA, 8, false},
    {PNG_COLOR_TYPE_GRAY_ALPHA, 16, false}, {PNG_COLOR_TYPE_PALETTE, 1, false},
    {PNG_COLOR_TYPE_PALETTE, 2, true},      {PNG_COLOR_TYPE_PALETTE, 4, false},
    {PNG_COLOR_TYPE_PALETTE, 8, true},      {PNG_COLOR_TYPE_RGB, 8, false},
    {PNG_COLOR_TYPE_RGB, 8, true},          {PNG_COLOR_TYPE_RGB, 16, false},
    {PNG_COLOR_TYPE_RGB, 16, true},         {PNG_COLOR_TYPE_RGBA, 8, false},
    {PNG_COLOR_TYPE_RGBA, 16, false},
};
#define KINDS (int)(sizeof kinds / sizeof *kinds)
enum { TRANSPARENT_ENTRIES = 2 };

static int channels_of(struct kind kind) {
    return kind.colour_type == PNG_COLOR_TYPE_GRAY_ALPHA ? 2
           : kind.colour_type == PNG_COLOR_TYPE_RGB      ? 3
           : kind.colour_type == PNG_COLOR_TYPE_RGBA     ? 4
                                                         : 1;
}

// Sample c of pixel (x, y); the first pixel has the transparent colour, all zero.
static unsigned sample(struct kind kind, int x, int y, int c) {
    unsigned hash = (unsigned)(x * 7919 + y * 104729 + c * 1299709) * 2654435761u >> 8;
    return x + y == 0 ? 0 : hash & ((1u << kind.bit_depth) - 1);
}

static png_color palette_entry(unsigned i) {
    return (png_color){(png_byte)(i * 3), (png_byte)(255 - i), (png_byte)(i ^ 0x55)};
}

static png_byte palette_alpha(unsigned i) {
    return (png_byte)(i == 0 ? 0 : 100);
}

static void fill_row(struct kind kind, int width, int y, uint8_t *row) {
    int channels = channels_of(kind);
    memset(row, 0, (size_t)width * 8);
    for (int x = 0; x < width; x++)
        for (int c = 0; c < channels; c++) {
            unsigned value = sample(kind, x, y, c);
            int at = x * channels + c;
            if (kind.bit_depth == 16) {
                row[2 * at] = (uint8_t)(value >> 8);
                row[2 * at + 1] = (uint8_t)value;
            } else {
                int bit = at * kind.bit_depth;
                row[bit / 8] |= (uint8_t)(value << (8 - kind.bit_depth - bit % 8));
            }
        }
}

static void write_chunks(png_structp png, png_infop info, struct kind kind) {
    png_color palette[256];
    png_byte alphas[TRANSPARENT_ENTRIES];
    png_color_16 key = {0};
    for (unsigned i = 0; i < 256; i++)
        palette[i] = palette_entry(i);
    for (unsigned i = 0; i < TRANSPARENT_ENTRIES; i++)
        alphas[i] = palette_alpha(i);
    bool indexed = kind.colour_type == PNG_COLOR_TYPE_PALETTE;
    if (indexed) png_set_PLTE(png, info, palette, 1 << kind.bit_depth);
    if (kind.transparency)
        png_set_tRNS(png, info, indexed ? alphas : NULL, indexed ? TRANSPARENT_ENTRIES : 0,
                     indexed ? NULL : &key);
}

// A whole file when `rows`, else one that ends where the pixels begin. comment_bytes of text stand
// before them.
static struct bytes make_png(struct kind kind, int width, int height, bool interlaced, bool rows,
                             size_t comment_bytes) {
    char *data = NULL;
    size_t size = 0;
    FILE *file = open_memstream(&data, &size);
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    ck_assert(file && info);
    png_init_io(png, file);
    png_set_user_limits(png, PNG_UINT_31_MAX, PNG_UINT_31_MAX);
    png_set_IHDR(png, info, (png_uint_32)width, (png_uint_32)height, kind.bit_depth,
                 kind.colour_type, interlaced ? PNG_INTERLACE_ADAM7 : PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    write_chunks(png, info, kind);
    png_write_info(png, info);
    char *comment = malloc(comment_bytes + 1);
    ck_assert_ptr_nonnull(comment);
    memset(comment, 'c', comment_bytes);
    if (comment_bytes > 0)
        png_write_chunk(png, (png_const_bytep) "quIt", (png_const_bytep)comment, comment_bytes);
    free(comment);
    if (rows) {
        uint8_t *row = malloc((size_t)width * 8);
        ck_assert_ptr_nonnull(row);
        int passes = png_set_interlace_handling(png);
        for (int pass = 0; pass < passes; pass++)
            for (int y = 0; y < height; y++) {
                fill_row(kind, width, y, row);
                png_write_row(png, row);
            }
        free(row);
        png_write_end(png, info);
    } else
        png_write_chunk(png, (png_const_bytep) "IDAT", NULL, 0);
    png_destroy_write_struct(&png, &info);
    fclose(file);
    return (struct bytes){(uint8_t *)data, size};
}

// The sample as 8 bits, rounded.
static int as_byte(struct kind kind, unsigned value) {
    return (int)floor(value * 255.0 / ((1u << kind.bit_depth) - 1) + 0.5);
}

static void expect_pixel(struct kind kind, int x, int y, int ret_rgba[4]) {
    unsigned first = sample(kind, x, y, 0);
    int channels = channels_of(kind);
    bool is_key = true;
    for (int c = 0; c < channels; c++)
        is_key = is_key && sample(kind, x, y, c) == 0;
    ret_rgba[3] = kind.transparency && is_key ? 0 : 255;
    if (kind.colour_type == PNG_COLOR_TYPE_PALETTE) {
        png_color entry = palette_entry(first);
        ret_rgba[0] = entry.red;
        ret_rgba[1] = entry.green;
        ret_rgba[2] = entry.blue;
        if (kind.transparency && first < TRANSPARENT_ENTRIES) ret_rgba[3] = palette_alpha(first);
        return;
    }
    for (int c = 0; c < 3; c++)
        ret_rgba[c] = as_byte(kind, sample(kind, x, y, channels < 3 ? 0 : c));
    if (channels % 2 == 0) ret_rgba[3] = as_byte(kind, sample(kind, x, y, channels - 1));
}

static void assert_pixels(struct kind kind, const struct rn_image *image) {
    for (int y = 0; y < image->height; y++)
        for (int x = 0; x < image->width; x++) {
            int expected[4];
            expect_pixel(kind, x, y, expected);
            const uint8_t *pixel = image->pixels + 4 * (y * image->width + x);
            for (int c = 0; c < 4; c++)
                ck_assert_msg(pixel[c] == expected[c], "type %d depth %d (%d,%d)[%d]: %d not %d",
                              kind.colour_type, kind.bit_depth, x, y, c, pixel[c], expected[c]);
        }
}

START_TEST(png_kinds) {
    struct kind kind = kinds[_i % KINDS];
    bool interlaced = _i >= KINDS;
    bool alpha = kind.transparency || channels_of(kind) % 2 == 0;
    static const int sizes[][2] = {{1, 1}, {3, 5}, {17, 9}, {8, 64}};
    for (int s = 0; s < 4; s++) {
        int width = sizes[s][0], height = sizes[s][1];
        struct bytes file = make_png(kind, width, height, interlaced, true, 0);
        struct rn_image_info info;
        const char *path = store(file);
        ck_assert_int_eq(rn_image_probe(path, NULL, &info, NULL), RN_OK);
        ck_assert(info.width == width && info.height == height);
        ck_assert(info.bit_depth == kind.bit_depth && info.has_alpha == alpha);
        struct rn_image image;
        ck_assert_int_eq(rn_image_read(path, NULL, &image, NULL), RN_OK);
        ck_assert(image.width == width && image.height == height && image.has_alpha == alpha);
        assert_pixels(kind, &image);
        rn_image_finish(&image);
        free(file.data);
    }
}
END_TEST

static enum rn_status decode(struct bytes file, size_t size, struct rn_error *err) {
    struct rn_image image;
    enum rn_status status = rn_image_decode(file.data, size, "some/file", NULL, &image, err);
    if (status == RN_OK) rn_image_finish(&image);
    return status;
}

START_TEST(png_truncated_anywhere) {
    struct bytes file = make_png(kinds[_i], 17, 9, _i % 2, true, 0);
    for (size_t size = 0; size < file.size; size++) {
        struct rn_error err = {0};
        ck_assert_msg(decode(file, size, &err) == RN_ERROR_INVALID, "%zu bytes", size);
        ck_assert_str_eq(err.where, "some/file");
        ck_assert_str_ne(err.text, "");
    }
    ck_assert_int_eq(decode(file, file.size, NULL), RN_OK);
    free(file.data);
}
END_TEST

START_TEST(png_damaged_anywhere) {
    struct bytes file = make_png(kinds[KINDS - 1 - _i], 17, 9, _i % 2, true, 0);
    for (size_t i = 0; i < file.size; i++) {
        file.data[i] ^= (uint8_t)(1u << (i % 8));
        enum rn_status status = decode(file, file.size, NULL);
        ck_assert_msg(status == RN_ERROR_INVALID || status == RN_ERROR_LIMIT, "byte %zu: %s", i,
                      rn_status_name(status));
        file.data[i] ^= (uint8_t)(1u << (i % 8));
    }
    free(file.data);
}
END_TEST

START_TEST(limits_come_first) {
    struct kind rgba = {PNG_COLOR_TYPE_RGBA, 8, false};
    static const int sizes[][2] = {
        {16385, 1}, {1, 16385}, {16384, 16384}, {2147483647, 2147483647}};
    for (int i = 0; i < 4; i++) {
        struct bytes file = make_png(rgba, sizes[i][0], sizes[i][1], false, false, 0);
        struct rn_image_info info;
        struct rn_error err;
        ck_assert_int_eq(rn_image_probe(store(file), NULL, &info, &err), RN_ERROR_LIMIT);
        ck_assert_int_eq(decode(file, file.size, &err), RN_ERROR_LIMIT);
        ck_assert_ptr_nonnull(strstr(err.text, "limit"));
        free(file.data);
    }
    struct bytes file = make_png(rgba, 20, 10, false, true, 0);
    const char *path = store(file);
    const struct rn_image_limits limits[] = {{19, 10, 200, 10000},
                                             {20, 9, 200, 10000},
                                             {20, 10, 199, 10000},
                                             {20, 10, 200, file.size - 1}};
    struct rn_image image;
    struct rn_image_info info;
    for (int i = 0; i < 4; i++) {
        ck_assert_int_eq(rn_image_probe(path, &limits[i], &info, NULL), RN_ERROR_LIMIT);
        ck_assert_int_eq(rn_image_read(path, &limits[i], &image, NULL), RN_ERROR_LIMIT);
    }
    const struct rn_image_limits enough = {20, 10, 200, file.size};
    ck_assert_int_eq(rn_image_probe(path, &enough, &info, NULL), RN_OK);
    ck_assert_int_eq(rn_image_read(path, &enough, &image, NULL), RN_OK);
    rn_image_finish(&image);
    free(file.data);
}
END_TEST

// The pixels may lie far behind the beginning of the file.
START_TEST(probe_behind_long_chunks) {
    struct bytes file = make_png(kinds[KINDS - 1], 5, 4, false, true, 300000);
    struct rn_image_info info;
    ck_assert_int_eq(rn_image_probe(store(file), NULL, &info, NULL), RN_OK);
    ck_assert(info.width == 5 && info.height == 4 && info.bit_depth == 16 && info.has_alpha);
    ck_assert_int_eq(decode(file, file.size, NULL), RN_OK);
    free(file.data);
}
END_TEST

START_TEST(not_an_image) {
    struct rn_image image;
    struct rn_image_info info;
    struct rn_error err;
    const char *path = store((struct bytes){(uint8_t *)"GIF89a, say", 11});
    ck_assert_int_eq(rn_image_probe(path, NULL, &info, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "no picture of a known format"));
    ck_assert_int_eq(rn_image_read(path, NULL, &image, &err), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, path);
    path = store((struct bytes){NULL, 0});
    ck_assert_int_eq(rn_image_probe(path, NULL, &info, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "empty"));
    ck_assert_int_eq(rn_image_read(path, NULL, &image, &err), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_probe(folder, NULL, &info, &err), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_read("/no/such/file", NULL, &image, &err), RN_ERROR_NOT_FOUND);
    ck_assert_int_eq(rn_image_probe("/no/such/file", NULL, &info, &err), RN_ERROR_NOT_FOUND);
}
END_TEST

// A smooth picture, so that JPEG's loss is small.
static struct rn_image smooth(int width, int height, bool has_alpha) {
    struct rn_image image;
    ck_assert_int_eq(rn_image_init(width, height, &image, NULL), RN_OK);
    ck_assert(image.has_alpha);
    image.has_alpha = has_alpha;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            uint8_t *pixel = image.pixels + 4 * (y * width + x);
            pixel[0] = (uint8_t)(x * 255 / width);
            pixel[1] = (uint8_t)(y * 255 / height);
            pixel[2] = (uint8_t)(128 + (x - y) / 2);
            pixel[3] = has_alpha ? (uint8_t)(x * y) : 255;
        }
    return image;
}

static struct bytes make_jpeg(const struct rn_image *image, int format, int subsampling) {
    tjhandle handle = tjInitCompress();
    struct bytes out = {0};
    unsigned long size = 0;
    ck_assert_int_eq(tjCompress2(handle, image->pixels, image->width, 0, image->height, format,
                                 &out.data, &size, subsampling, 95, 0),
                     0);
    tjDestroy(handle);
    out.size = size;
    return out;
}

static void assert_close(const struct rn_image *a, const struct rn_image *b, int tolerance) {
    ck_assert(a->width == b->width && a->height == b->height);
    for (int i = 0; i < a->width * a->height * 4; i++)
        ck_assert_msg(i % 4 == 3 || abs(a->pixels[i] - b->pixels[i]) <= tolerance,
                      "byte %d: %d and %d", i, a->pixels[i], b->pixels[i]);
}

START_TEST(jpeg_colours) {
    static const int subsamplings[] = {TJSAMP_444, TJSAMP_422, TJSAMP_420};
    struct rn_image image = smooth(67, 45, false), decoded;
    struct rn_image_info info;
    for (int i = 0; i < 3; i++) {
        struct bytes file = make_jpeg(&image, TJPF_RGBX, subsamplings[i]);
        ck_assert_int_eq(rn_image_probe(store(file), NULL, &info, NULL), RN_OK);
        ck_assert(info.width == 67 && info.height == 45 && info.bit_depth == 8 && !info.has_alpha);
        ck_assert_int_eq(rn_image_read(store(file), NULL, &decoded, NULL), RN_OK);
        ck_assert(!decoded.has_alpha && decoded.pixels[3] == 255);
        assert_close(&decoded, &image, i == 0 ? 6 : 12);
        rn_image_finish(&decoded);
        tjFree(file.data);
    }
    struct bytes grey = make_jpeg(&image, TJPF_RGBX, TJSAMP_GRAY);
    ck_assert_int_eq(rn_image_read(store(grey), NULL, &decoded, NULL), RN_OK);
    for (int i = 0; i < 67 * 45; i++) {
        const uint8_t *p = image.pixels + 4 * i, *q = decoded.pixels + 4 * i;
        ck_assert(q[0] == q[1] && q[1] == q[2] && q[3] == 255);
        ck_assert_double_eq_tol(q[0], 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2], 4);
    }
    rn_image_finish(&decoded);
    tjFree(grey.data);
    rn_image_finish(&image);
}
END_TEST

// Made smaller while it is decoded: the means of what is decoded whole, to a rounding, where the
// library's own sizes divide what is asked for and the picture.
START_TEST(jpeg_made_smaller) {
    static const struct {
        int width, most, times;
    } cases[] = {{64, 2, 2}, {64, 4, 4}, {64, 8, 8}, {64, 16, 8}, {64, 6, 2},
                 {64, 3, 1}, {64, 1, 1}, {64, 0, 1}, {60, 8, 4},  {61, 8, 1}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct rn_image image = smooth(cases[i].width, 48, false), whole, mean, smaller;
        int times = 0;
        for (int at = 0; at < 4 * image.width * image.height; at++)
            if (at % 4 < 3)
                image.pixels[at] = (uint8_t)(60 + (image.pixels[at] * 5 + at * 3) % 131);
        struct bytes file = make_jpeg(&image, TJPF_RGBX, TJSAMP_444);
        const char *path = store(file);
        ck_assert_int_eq(rn_image_read(path, NULL, &whole, NULL), RN_OK);
        ck_assert_int_eq(rn_image_read_smaller(path, NULL, cases[i].most, &smaller, &times, NULL),
                         RN_OK);
        ck_assert_int_eq(times, cases[i].times);
        ck_assert_int_eq(rn_image_downscale(&whole, whole.width / times, whole.height / times,
                                            RN_DOWNSCALE_PREMULTIPLIED, &mean, NULL),
                         RN_OK);
        ck_assert(!smaller.has_alpha && smaller.pixels[3] == 255);
        assert_close(&smaller, &mean, 2);
        rn_image_finish(&image);
        rn_image_finish(&whole);
        rn_image_finish(&mean);
        rn_image_finish(&smaller);
        tjFree(file.data);
    }
}
END_TEST

START_TEST(jpeg_cmyk_is_refused) {
    struct rn_image image = smooth(16, 16, true);
    struct bytes file = make_jpeg(&image, TJPF_CMYK, TJSAMP_444);
    struct rn_image_info info;
    struct rn_error err;
    ck_assert_int_eq(decode(file, file.size, &err), RN_ERROR_UNSUPPORTED);
    ck_assert_ptr_nonnull(strstr(err.text, "convert it to RGB"));
    ck_assert_int_eq(rn_image_probe(store(file), NULL, &info, &err), RN_ERROR_UNSUPPORTED);
    tjFree(file.data);
    rn_image_finish(&image);
}
END_TEST

START_TEST(jpeg_truncated_anywhere) {
    struct rn_image image = smooth(40, 24, false);
    struct bytes file = make_jpeg(&image, TJPF_RGBX, TJSAMP_420);
    for (size_t size = 0; size < file.size; size++) {
        struct rn_error err = {0};
        ck_assert_msg(decode(file, size, &err) == RN_ERROR_INVALID, "%zu bytes", size);
        ck_assert_str_eq(err.where, "some/file");
    }
    ck_assert_int_eq(decode(file, file.size, NULL), RN_OK);
    tjFree(file.data);
    rn_image_finish(&image);
}
END_TEST

// Metadata of 200 kB before the header, stray bytes before the end, and limits.
START_TEST(jpeg_odd_but_sound) {
    struct rn_image image = smooth(40, 24, false);
    struct bytes file = make_jpeg(&image, TJPF_RGBX, TJSAMP_444);
    enum { SEGMENT = 50000, SEGMENTS = 4, STRAY = 3 };
    size_t size = file.size + SEGMENTS * SEGMENT + STRAY;
    struct bytes odd = {calloc(1, size), size};
    ck_assert_ptr_nonnull(odd.data);
    memcpy(odd.data, file.data, 2);
    for (int i = 0; i < SEGMENTS; i++) {
        const uint8_t start[4] = {0xff, 0xe5, (SEGMENT - 2) >> 8, (SEGMENT - 2) & 255};
        memcpy(odd.data + 2 + i * SEGMENT, start, sizeof start);
    }
    memcpy(odd.data + 2 + SEGMENTS * SEGMENT, file.data + 2, file.size - 4);
    memcpy(odd.data + size - 2, file.data + file.size - 2, 2);
    struct rn_image_info info;
    struct rn_error err = {0};
    ck_assert_msg(rn_image_probe(store(odd), NULL, &info, &err) == RN_OK, "%s", err.text);
    ck_assert(info.width == 40 && info.height == 24);
    ck_assert_int_eq(decode(odd, odd.size, NULL), RN_OK);
    const struct rn_image_limits limits = {40, 24, 40 * 24 - 1, 1 << 20};
    struct rn_image decoded;
    ck_assert_int_eq(rn_image_decode(odd.data, odd.size, "", &limits, &decoded, NULL),
                     RN_ERROR_LIMIT);
    free(odd.data);
    tjFree(file.data);
    rn_image_finish(&image);
}
END_TEST

static struct bytes with(struct bytes file, const void *more, size_t size) {
    struct bytes all = {malloc(file.size + size), file.size + size};
    ck_assert_ptr_nonnull(all.data);
    memcpy(all.data, file.data, file.size);
    memcpy(all.data + file.size, more, size);
    return all;
}

// A JPEG, baseline or progressive, with EXIF, a comment and padding in front and another picture
// behind it: what is kept is the file without them.
START_TEST(jpeg_without_what_is_said_of_it) {
    static const uint8_t said[] = {0xff, 0xd8, 0xff, 0xe1, 0,    9, 'w', 'h', 'e', 'r', 'e',
                                   '!',  '!',  0xff, 0xff, 0xfe, 0, 6,   'm', 'i', 'n', 'e'};
    struct rn_image image = smooth(40, 24, false);
    for (int progressive = 0; progressive < 2; progressive++) {
        tjhandle handle = tjInitCompress();
        struct bytes plain = {0}, kept;
        unsigned long size = 0;
        ck_assert_int_eq(tjCompress2(handle, image.pixels, 40, 0, 24, TJPF_RGBX, &plain.data, &size,
                                     TJSAMP_420, 95, progressive ? TJFLAG_PROGRESSIVE : 0),
                         0);
        plain.size = size;
        struct bytes head = with((struct bytes){(uint8_t *)said, sizeof said}, plain.data + 2,
                                 plain.size - 2),
                     all = with(head, plain.data, plain.size);
        const char *path = store(all);
        ck_assert_int_eq(rn_image_strip(path, NULL, &kept.data, &kept.size, NULL), RN_OK);
        ck_assert_uint_eq(kept.size, plain.size);
        ck_assert_mem_eq(kept.data, plain.data, plain.size);
        free(kept.data);
        for (size_t end = 0; end < all.size;
             end += 17) { // nothing is read beyond a file that is cut
            ck_assert_int_eq(truncate(path, (off_t)(all.size - end)), 0);
            if (rn_image_strip(path, NULL, &kept.data, &kept.size, NULL) == RN_OK) free(kept.data);
        }
        free(all.data);
        free(head.data);
        tjFree(plain.data);
        tjDestroy(handle);
    }
    rn_image_finish(&image);
}
END_TEST

START_TEST(encoded_png_is_lossless) {
    static const int sizes[][2] = {{1, 1}, {37, 21}};
    for (int i = 0; i < 2 * 2 * 10; i++) {
        struct rn_image image = smooth(sizes[i / 20][0], sizes[i / 20][1], i / 10 % 2), decoded;
        struct bytes file;
        ck_assert_int_eq(rn_image_encode_png(&image, i % 10, &file.data, &file.size, NULL), RN_OK);
        ck_assert_int_eq(rn_image_decode(file.data, file.size, "", NULL, &decoded, NULL), RN_OK);
        ck_assert_int_eq(decoded.has_alpha, image.has_alpha);
        ck_assert(decoded.width == image.width && decoded.height == image.height);
        ck_assert_mem_eq(decoded.pixels, image.pixels, (size_t)(4 * image.width * image.height));
        free(file.data);
        rn_image_finish(&decoded);
        rn_image_finish(&image);
    }
}
END_TEST

START_TEST(encoded_jpeg) {
    struct rn_image image = smooth(61, 33, true), decoded;
    struct bytes small, large;
    ck_assert_int_eq(rn_image_encode_jpeg(&image, 20, &small.data, &small.size, NULL), RN_OK);
    ck_assert_int_eq(rn_image_encode_jpeg(&image, 100, &large.data, &large.size, NULL), RN_OK);
    ck_assert_uint_lt(small.size, large.size);
    ck_assert_int_eq(rn_image_decode(large.data, large.size, "", NULL, &decoded, NULL), RN_OK);
    assert_close(&decoded, &image, 3);
    rn_image_finish(&decoded);
    free(small.data);
    free(large.data);
    struct rn_error err;
    ck_assert_int_eq(rn_image_encode_jpeg(&image, 0, &small.data, &small.size, &err),
                     RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_encode_jpeg(&image, 101, &small.data, &small.size, &err),
                     RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_encode_png(&image, 10, &small.data, &small.size, &err),
                     RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_encode_png(&image, -1, &small.data, &small.size, &err),
                     RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "level");
    rn_image_finish(&image);
}
END_TEST

START_TEST(written_png) {
    char path[256];
    snprintf(path, sizeof path, "%s/out.png", folder);
    struct rn_image image = smooth(30, 20, true), decoded;
    ck_assert_int_eq(rn_image_write_png(&image, path, 6, NULL), RN_OK);
    ck_assert_int_eq(rn_image_read(path, NULL, &decoded, NULL), RN_OK);
    ck_assert_mem_eq(decoded.pixels, image.pixels, 4 * 30 * 20);
    rn_image_finish(&decoded);
    snprintf(path, sizeof path, "%s/missing/out.png", folder);
    struct rn_error err;
    ck_assert_int_eq(rn_image_write_png(&image, path, 6, &err), RN_ERROR_NOT_FOUND);
    ck_assert_str_eq(err.where, path);
    rn_image_finish(&image);
}
END_TEST

START_TEST(depth_png) {
    static const float depths[6] = {0, 1, 2.5f, 7, NAN, -1};
    static const int expected[6] = {0, 16384, 40959, 65535, 0, 0}; // of 4: 2.5/4 * 65535 = 40959.4
    struct rn_picture depth;
    ck_assert_int_eq(rn_picture_init(3, 2, 1, &depth, NULL), RN_OK);
    memcpy(depth.values, depths, sizeof depths);
    struct bytes file;
    ck_assert_int_eq(rn_picture_encode_depth_png(&depth, 4, 6, &file.data, &file.size, NULL),
                     RN_OK);
    FILE *stream = fmemopen(file.data, file.size, "rb");
    png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    png_init_io(png, stream);
    png_read_png(png, info, PNG_TRANSFORM_IDENTITY, NULL);
    ck_assert_int_eq(png_get_bit_depth(png, info), 16);
    ck_assert_int_eq(png_get_color_type(png, info), PNG_COLOR_TYPE_GRAY);
    for (int i = 0; i < 6; i++) {
        const uint8_t *value = png_get_rows(png, info)[i / 3] + 2 * (i % 3);
        ck_assert_int_eq(value[0] << 8 | value[1], expected[i]);
    }
    png_textp text;
    ck_assert_int_eq(png_get_text(png, info, &text, NULL), 1);
    ck_assert_str_eq(text->key, "ripnerf:depth_scale");
    ck_assert_str_eq(text->text, "4");
    png_destroy_read_struct(&png, &info, NULL);
    fclose(stream);
    free(file.data);
    ck_assert_int_eq(rn_picture_encode_depth_png(&depth, 0, 6, &file.data, &file.size, NULL),
                     RN_ERROR_INVALID);
    ck_assert_int_eq(rn_picture_encode_depth_png(&depth, NAN, 6, &file.data, &file.size, NULL),
                     RN_ERROR_INVALID);
    depth.channels = 3;
    ck_assert_int_eq(rn_picture_encode_depth_png(&depth, 1, 6, &file.data, &file.size, NULL),
                     RN_ERROR_INVALID);
    rn_picture_finish(&depth);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("image files");
    TCase *cases = tcase_create("image files");
    tcase_add_checked_fixture(cases, enter_folder, leave_folder);
    tcase_add_loop_test(cases, png_kinds, 0, 2 * KINDS);
    tcase_add_loop_test(cases, png_truncated_anywhere, 0, KINDS);
    tcase_add_loop_test(cases, png_damaged_anywhere, 0, KINDS);
    tcase_add_test(cases, limits_come_first);
    tcase_add_test(cases, probe_behind_long_chunks);
    tcase_add_test(cases, not_an_image);
    tcase_add_test(cases, jpeg_colours);
    tcase_add_test(cases, jpeg_made_smaller);
    tcase_add_test(cases, jpeg_cmyk_is_refused);
    tcase_add_test(cases, jpeg_truncated_anywhere);
    tcase_add_test(cases, jpeg_odd_but_sound);
    tcase_add_test(cases, jpeg_without_what_is_said_of_it);
    tcase_add_test(cases, encoded_png_is_lossless);
    tcase_add_test(cases, encoded_jpeg);
    tcase_add_test(cases, written_png);
    tcase_add_test(cases, depth_png);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
