// A temporary dataset folder for tests, and the files to put into it.
#ifndef RN_TESTS_DATASET_FIXTURE_H
#define RN_TESTS_DATASET_FIXTURE_H

#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/dataset/dataset.h"
#include "common/math/rng.h"
#include "tests/support/suite.h"

static char folder[64];
static struct rn_problems problems;
static struct rn_dataset *dataset;
static struct rn_error err;

static inline void setup(void) {
    strcpy(folder, "/tmp/ripnerf-test-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
}

static inline void teardown(void) {
    rn_dataset_destroy(&dataset);
    rn_problems_finish(&problems);
    ck_assert_int_eq(rn_remove_tree(folder, &err), RN_OK);
}

// Whether a problem of that severity was told that has `text` in it.
static inline bool problems_tell(enum rn_severity severity, const char *text) {
    for (size_t i = 0; i < problems.count; i++)
        if (problems.items[i].severity == severity && strstr(problems.items[i].text, text))
            return true;
    return false;
}

static inline void assert_pose(const struct rn_frame *frame, const double expected[3][4]) {
    for (int i = 0; i < 12; i++)
        ck_assert_double_eq_tol((&frame->camera.world_from_camera[0][0])[i], (&expected[0][0])[i],
                                1e-14);
}

// "folder/name" in one of a few rotating buffers; makes the folders above it.
static inline const char *in_folder(const char *name) {
    static char paths[8][512];
    static int next;
    char *path = paths[next++ % 8];
    snprintf(path, sizeof paths[0], "%s/%s", folder, name);
    char *slash = strrchr(path, '/');
    *slash = 0;
    ck_assert_int_eq(rn_mkdirs(path, 0700, &err), RN_OK);
    *slash = '/';
    return path;
}

static inline void put_bytes(const char *name, const void *bytes, size_t size) {
    FILE *file = fopen(in_folder(name), "wb");
    ck_assert_ptr_nonnull(file);
    ck_assert_uint_eq(fwrite(bytes, 1, size, file), size);
    ck_assert_int_eq(fclose(file), 0);
}

static inline void put_text(const char *name, const char *text) {
    put_bytes(name, text, strlen(text));
}

// Noise, with alpha from 0 to 255.
static inline struct rn_image noise(int width, int height, uint64_t seed) {
    struct rn_image image;
    ck_assert_int_eq(rn_image_init(width, height, &image, &err), RN_OK);
    image.has_alpha = true;
    for (int i = 0; i < width * height * 4; i++)
        image.pixels[i] = (uint8_t)rn_rng_draw(seed, 0, (uint64_t)i).v[0];
    return image;
}

static inline void put_image(const char *name, int width, int height) {
    struct rn_image image = noise(width, height, (uint64_t)width);
    ck_assert_msg(rn_image_write_png(&image, in_folder(name), 1, &err) == RN_OK, "%s", err.text);
    rn_image_finish(&image);
}

// Any kind of PNG that libpng writes, all bytes 0x55.
static inline void put_png(const char *name, int width, int height, int colour_type, int depth,
                           int interlace) {
    FILE *file = fopen(in_folder(name), "wb");
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);
    ck_assert(file && png && info);
    png_init_io(png, file);
    png_set_IHDR(png, info, (png_uint_32)width, (png_uint_32)height, depth, colour_type, interlace,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_color palette[256] = {{1, 2, 3}};
    if (colour_type == PNG_COLOR_TYPE_PALETTE) png_set_PLTE(png, info, palette, 256);
    png_write_info(png, info);
    png_byte *row = malloc((size_t)width * 8);
    memset(row, 0x55, (size_t)width * 8);
    int passes = png_set_interlace_handling(png);
    for (int i = 0; i < passes * height; i++)
        png_write_row(png, row);
    png_write_end(png, info);
    png_destroy_write_struct(&png, &info);
    free(row);
    ck_assert_int_eq(fclose(file), 0);
}

// Cuts a file to `size` bytes.
static inline void truncate_file(const char *name, size_t size) {
    uint8_t *bytes;
    size_t full;
    ck_assert_int_eq(rn_file_read(in_folder(name), 1 << 20, &bytes, &full, &err), RN_OK);
    ck_assert_uint_lt(size, full);
    put_bytes(name, bytes, size);
    free(bytes);
}

#define POSE "[[1,0,0,0.5],[0,1,0,0.25],[0,0,1,4],[0,0,0,1]]" // OpenGL: looks along -z
#define FRAME(file) "{\"file_path\":\"" file "\",\"transform_matrix\":" POSE "}"

static inline void put_transforms(const char *split, const char *frames) {
    char name[64], *text;
    snprintf(name, sizeof name, "transforms_%s.json", split);
    ck_assert(asprintf(&text, "{\"camera_angle_x\":0.9,\"frames\":[%s]}", frames) > 0);
    put_text(name, text);
    free(text);
}

static inline void read_ok(const char *path) {
    enum rn_status status = rn_dataset_read(path, &problems, &dataset, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
}

#endif
