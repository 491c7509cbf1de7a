// Pictures in memory: conversions, compositing, downscaling, the published pyramid.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/image.h"
#include "common/math/rng.h"
#include "tests/support/suite.h"

static struct rn_image filled(int width, int height, const uint8_t rgba[4]) {
    struct rn_image image;
    ck_assert_int_eq(rn_image_init(width, height, &image, NULL), RN_OK);
    for (int i = 0; i < width * height; i++)
        memcpy(image.pixels + 4 * i, rgba, 4);
    return image;
}

static struct rn_image random_image(int width, int height, uint64_t seed) {
    struct rn_image image = filled(width, height, (const uint8_t[4]){0});
    for (int i = 0; i < width * height * 4; i++)
        image.pixels[i] = (uint8_t)rn_rng_draw(seed, 1, (uint64_t)i).v[0];
    return image;
}

static struct rn_image scaled(const struct rn_image *image, int width, int height,
                              enum rn_downscale mode) {
    struct rn_image out;
    ck_assert_int_eq(rn_image_downscale(image, width, height, mode, &out, NULL), RN_OK);
    ck_assert(out.width == width && out.height == height && out.has_alpha == image->has_alpha);
    return out;
}

START_TEST(init_and_finish) {
    struct rn_image image;
    struct rn_picture picture;
    struct rn_error err;
    static const int bad[][2] = {{0, 1}, {1, 0}, {-5, 5}};
    for (int i = 0; i < 3; i++) {
        ck_assert_int_eq(rn_image_init(bad[i][0], bad[i][1], &image, &err), RN_ERROR_INVALID);
        ck_assert_int_eq(rn_picture_init(bad[i][0], bad[i][1], 3, &picture, &err),
                         RN_ERROR_INVALID);
    }
    ck_assert_int_eq(rn_image_init(16385, 1, &image, &err), RN_ERROR_LIMIT);
    ck_assert_int_eq(rn_picture_init(16384, 16384, 1, &picture, &err), RN_ERROR_LIMIT);
    ck_assert_int_eq(rn_picture_init(4, 4, 2, &picture, &err), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_init(16384, 1, &image, &err), RN_OK);
    ck_assert(image.has_alpha && image.pixels[4 * 16384 - 1] == 0);
    rn_image_finish(&image);
    ck_assert_ptr_null(image.pixels);
    rn_image_finish(&image);
}
END_TEST

START_TEST(to_bytes) {
    static const float values[] = {0,         1,        0.5f, 1.5f / 255, 1.49f / 255, -3, 7.5f,
                                   -INFINITY, INFINITY, NAN,  1e-40f,     254.5f / 255};
    static const int expected[] = {0, 255, 128, 2, 1, 0, 255, 0, 0, 0, 0, 255};
    struct rn_picture grey;
    struct rn_image image;
    ck_assert_int_eq(rn_picture_init(12, 1, 1, &grey, NULL), RN_OK);
    memcpy(grey.values, values, sizeof values);
    ck_assert_int_eq(rn_picture_to_image(&grey, &image, NULL), RN_OK);
    ck_assert(!image.has_alpha);
    for (int i = 0; i < 12; i++)
        for (int c = 0; c < 4; c++)
            ck_assert_int_eq(image.pixels[4 * i + c], c == 3 ? 255 : expected[i]);
    rn_image_finish(&image);
    grey.width = 3;
    grey.channels = 4;
    ck_assert_int_eq(rn_picture_to_image(&grey, &image, NULL), RN_OK);
    ck_assert(image.has_alpha);
    for (int i = 0; i < 12; i++)
        ck_assert_int_eq(image.pixels[i], expected[i]);
    rn_image_finish(&image);
    grey.width = 4;
    grey.channels = 3;
    ck_assert_int_eq(rn_picture_to_image(&grey, &image, NULL), RN_OK);
    for (int i = 0; i < 12; i++)
        ck_assert_int_eq(image.pixels[i / 3 * 4 + i % 3], expected[i]);
    ck_assert_int_eq(image.pixels[15], 255);
    rn_image_finish(&image);
    rn_picture_finish(&grey);
}
END_TEST

START_TEST(composite) {
    static const uint8_t pixels[] = {255, 128, 0, 255, 255, 128, 0, 0, 100, 200, 50, 51};
    const float background[3] = {1, 0.5f, 0.25f}, bad[3] = {0, 1.5f, 0}, nan[3] = {NAN, 0, 0};
    struct rn_image image = filled(3, 1, pixels);
    memcpy(image.pixels, pixels, sizeof pixels);
    struct rn_picture picture;
    ck_assert_int_eq(rn_image_composite(&image, background, &picture, NULL), RN_OK);
    ck_assert(picture.width == 3 && picture.height == 1 && picture.channels == 3);
    for (int c = 0; c < 3; c++) {
        ck_assert_float_eq(picture.values[c], (float)pixels[c] / 255.0f);
        ck_assert_float_eq(picture.values[3 + c], background[c]);
        ck_assert_double_eq_tol(picture.values[6 + c],
                                pixels[8 + c] / 255.0 * 0.2 + 0.8 * background[c], 1e-7);
    }
    rn_picture_finish(&picture);
    ck_assert_int_eq(rn_image_composite(&image, bad, &picture, NULL), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_composite(&image, nan, &picture, NULL), RN_ERROR_INVALID);
    rn_image_finish(&image);
}
END_TEST

// Bytes survive the way to floats over any background and back.
START_TEST(bytes_round_trip) {
    struct rn_image image = filled(600, 1, (const uint8_t[4]){0, 0, 0, 255}), back;
    for (int i = 0; i < 600; i++)
        image.pixels[4 * i] = (uint8_t)i;
    struct rn_picture picture;
    ck_assert_int_eq(rn_image_composite(&image, (const float[3]){1, 1, 1}, &picture, NULL), RN_OK);
    ck_assert_int_eq(rn_picture_to_image(&picture, &back, NULL), RN_OK);
    ck_assert_mem_eq(back.pixels, image.pixels, 4 * 600);
    rn_picture_finish(&picture);
    rn_image_finish(&back);
    rn_image_finish(&image);
}
END_TEST

// One half-covered pixel on a white background: right is 1.0 for a white and 0.75 for a mid-grey
// surface; averaging straight colours gives 0.75 and 0.625, a dark fringe.
START_TEST(edge_pixel) {
    static const struct {
        uint8_t surface;
        enum rn_downscale mode;
        double expected;
    } cases[] = {{255, RN_DOWNSCALE_PREMULTIPLIED, 1.0},
                 {255, RN_DOWNSCALE_STRAIGHT, 0.75},
                 {128, RN_DOWNSCALE_PREMULTIPLIED, 0.75},
                 {128, RN_DOWNSCALE_STRAIGHT, 0.625}};
    for (int i = 0; i < 4; i++) {
        uint8_t grey = cases[i].surface;
        struct rn_image image = filled(2, 2, (const uint8_t[4]){0}), edge;
        for (int y = 0; y < 2; y++)
            memcpy(image.pixels + 8 * y, (const uint8_t[4]){grey, grey, grey, 255}, 4);
        edge = scaled(&image, 1, 1, cases[i].mode);
        struct rn_picture picture;
        ck_assert_int_eq(rn_image_composite(&edge, (const float[3]){1, 1, 1}, &picture, NULL),
                         RN_OK);
        ck_assert_double_eq_tol(picture.values[0], cases[i].expected, 0.004);
        rn_picture_finish(&picture);
        rn_image_finish(&edge);
        rn_image_finish(&image);
    }
}
END_TEST

// Colours under alpha 0 never show; nothing visible gives transparent black.
START_TEST(hidden_colours) {
    struct rn_image image = random_image(9, 8, 5), out;
    for (int i = 0; i < 72; i++) {
        uint8_t *pixel = image.pixels + 4 * i;
        pixel[3] = (uint8_t)(i % 3 == 0 ? pixel[3] | 1 : 0);
        if (pixel[3]) memcpy(pixel, (const uint8_t[3]){10, 200, 77}, 3);
    }
    out = scaled(&image, 4, 3, RN_DOWNSCALE_PREMULTIPLIED);
    for (int i = 0; i < 12; i++)
        ck_assert_mem_eq(out.pixels + 4 * i, ((const uint8_t[3]){10, 200, 77}), 3);
    rn_image_finish(&out);
    for (int i = 0; i < 72; i++)
        image.pixels[4 * i + 3] = 0;
    out = scaled(&image, 4, 3, RN_DOWNSCALE_PREMULTIPLIED);
    for (int i = 0; i < 48; i++)
        ck_assert_int_eq(out.pixels[i], 0);
    rn_image_finish(&out);
    rn_image_finish(&image);
}
END_TEST

START_TEST(rounding_and_truncation) {
    struct rn_image image = filled(2, 2, (const uint8_t[4]){100, 0, 255, 255}), out;
    image.pixels[0] = 101;
    image.pixels[4] = 101; // mean 100.5
    image.pixels[1] = 3;   // mean 0.75
    out = scaled(&image, 1, 1, RN_DOWNSCALE_PREMULTIPLIED);
    ck_assert_mem_eq(out.pixels, ((const uint8_t[4]){101, 1, 255, 255}), 4);
    rn_image_finish(&out);
    out = scaled(&image, 1, 1, RN_DOWNSCALE_STRAIGHT);
    ck_assert_mem_eq(out.pixels, ((const uint8_t[4]){100, 0, 255, 255}), 4);
    rn_image_finish(&out);
    rn_image_finish(&image);
}
END_TEST

START_TEST(downscale_sizes) {
    struct rn_image image = filled(13, 7, (const uint8_t[4]){9, 99, 199, 255}), out;
    image.has_alpha = false;
    for (int mode = 0; mode < 2; mode++)
        for (int height = 1; height <= 7; height++)
            for (int width = 1; width <= 13; width++) {
                out = scaled(&image, width, height, (enum rn_downscale)mode);
                for (int i = 0; i < width * height; i++)
                    ck_assert_mem_eq(out.pixels + 4 * i, image.pixels, 4);
                rn_image_finish(&out);
            }
    struct rn_error err;
    static const int bad[][2] = {{0, 1}, {1, 0}, {14, 7}, {13, 8}, {-1, 3}};
    for (int i = 0; i < 5; i++)
        ck_assert_int_eq(rn_image_downscale(&image, bad[i][0], bad[i][1],
                                            RN_DOWNSCALE_PREMULTIPLIED, &out, &err),
                         RN_ERROR_INVALID);
    rn_image_finish(&image);
}
END_TEST

// A third of a pixel goes where it belongs: 3 pixels to 2.
START_TEST(fractional_overlap) {
    struct rn_image image = filled(3, 1, (const uint8_t[4]){0, 0, 0, 255}), out;
    image.pixels[0] = 30;
    image.pixels[4] = 90;
    image.pixels[8] = 240;
    out = scaled(&image, 2, 1, RN_DOWNSCALE_PREMULTIPLIED);
    ck_assert_int_eq(out.pixels[0], 50);  // (30 + 90 / 2) / 1.5
    ck_assert_int_eq(out.pixels[4], 190); // (90 / 2 + 240) / 1.5
    rn_image_finish(&out);
    rn_image_finish(&image);
}
END_TEST

START_TEST(equal_size_copies) {
    struct rn_image image = random_image(5, 4, 3), out;
    for (int mode = 0; mode < 2; mode++) {
        out = scaled(&image, 5, 4, (enum rn_downscale)mode);
        ck_assert_mem_eq(out.pixels, image.pixels, 80);
        rn_image_finish(&out);
    }
    rn_image_finish(&image);
}
END_TEST

// Output of the published converter's arithmetic (numpy, float32) for these bytes. They are chosen
// so that another order of additions, exact integer means and means of the stored bytes all differ.
START_TEST(legacy_pyramid_bits) {
    static const uint8_t source[64] = {
        150, 107, 91,  237, 97,  70,  224, 15,  113, 79,  7,   183, 254, 199, 82,  137,
        216, 79,  108, 234, 50,  237, 173, 111, 201, 104, 91,  156, 236, 182, 171, 158,
        214, 110, 189, 113, 154, 165, 94,  234, 62,  12,  190, 22,  139, 194, 43,  117,
        147, 198, 128, 138, 141, 118, 7,   244, 213, 94,  93,  165, 228, 139, 70,  28};
    static const uint8_t half[16] = {128, 123, 149, 149, 200, 141, 87, 158,
                                     164, 147, 104, 182, 160, 109, 99, 83};
    static const uint8_t quarter[4] = {163, 130, 110, 143};
    struct rn_image image = filled(4, 4, source), levels[3];
    memcpy(image.pixels, source, sizeof source);
    ck_assert_int_eq(rn_image_legacy_pyramid(&image, 3, levels, NULL), RN_OK);
    ck_assert_mem_eq(levels[0].pixels, source, 64);
    ck_assert_mem_eq(levels[1].pixels, half, 16);
    ck_assert_mem_eq(levels[2].pixels, quarter, 4);
    ck_assert(levels[1].width == 2 && levels[2].height == 1 && levels[2].has_alpha);
    for (int i = 0; i < 3; i++)
        rn_image_finish(&levels[i]);
    rn_image_finish(&image);
}
END_TEST

START_TEST(legacy_pyramid_sizes) {
    struct rn_image image = random_image(12, 8, 2), levels[15];
    struct rn_error err;
    ck_assert_int_eq(rn_image_legacy_pyramid(&image, 1, levels, NULL), RN_OK);
    ck_assert_mem_eq(levels[0].pixels, image.pixels, 12 * 8 * 4);
    rn_image_finish(&levels[0]);
    ck_assert_int_eq(rn_image_legacy_pyramid(&image, 3, levels, NULL), RN_OK);
    ck_assert(levels[2].width == 3 && levels[2].height == 2);
    for (int i = 0; i < 3; i++)
        rn_image_finish(&levels[i]);
    ck_assert_int_eq(rn_image_legacy_pyramid(&image, 4, levels, &err), RN_ERROR_INVALID);
    ck_assert_ptr_nonnull(strstr(err.text, "multiples of 8"));
    ck_assert_int_eq(rn_image_legacy_pyramid(&image, 0, levels, &err), RN_ERROR_INVALID);
    ck_assert_int_eq(rn_image_legacy_pyramid(&image, 40, levels, &err), RN_ERROR_INVALID);
    rn_image_finish(&image);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("image");
    TCase *cases = tcase_create("image");
    tcase_add_test(cases, init_and_finish);
    tcase_add_test(cases, to_bytes);
    tcase_add_test(cases, composite);
    tcase_add_test(cases, bytes_round_trip);
    tcase_add_test(cases, edge_pixel);
    tcase_add_test(cases, hidden_colours);
    tcase_add_test(cases, rounding_and_truncation);
    tcase_add_test(cases, downscale_sizes);
    tcase_add_test(cases, fractional_overlap);
    tcase_add_test(cases, equal_size_copies);
    tcase_add_test(cases, legacy_pyramid_bits);
    tcase_add_test(cases, legacy_pyramid_sizes);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
