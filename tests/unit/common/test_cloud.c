// Depths out of PNGs, and points out of depths.
#include <math.h>
#include <stdlib.h>

#include "common/image/cloud.h"
#include "tests/support/suite.h"

#define WIDTH 8
#define HEIGHT 6

static struct rn_camera camera;
static float values[WIDTH * HEIGHT];
static uint8_t colours[4 * WIDTH * HEIGHT], opacities[4 * WIDTH * HEIGHT];
static const struct rn_picture depth = {
    .width = WIDTH, .height = HEIGHT, .channels = 1, .values = values};
static const struct rn_image rgb = {.width = WIDTH, .height = HEIGHT, .pixels = colours};
static const struct rn_image opacity = {.width = WIDTH, .height = HEIGHT, .pixels = opacities};
static struct rn_cloud cloud;
static struct rn_error err;

// Looks along z from (1, 2, 3) at a wall at z = 8, whose colours are where they are seen.
static void setup(void) {
    camera = (struct rn_camera){.width = WIDTH,
                                .height = HEIGHT,
                                .fx = 10,
                                .fy = 10,
                                .cx = WIDTH / 2.0,
                                .cy = HEIGHT / 2.0};
    for (int i = 0; i < 3; i++) {
        camera.world_from_camera[i][i] = 1;
        camera.world_from_camera[i][3] = i + 1;
    }
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        double x = (i % WIDTH + 0.5 - camera.cx) / 10, y = (i / WIDTH + 0.5 - camera.cy) / 10;
        values[i] = (float)(5 * sqrt(x * x + y * y + 1));
        colours[4 * i] = (uint8_t)(i % WIDTH);
        colours[4 * i + 1] = (uint8_t)(i / WIDTH);
        colours[4 * i + 2] = 7;
        opacities[4 * i] = 255;
    }
    cloud = (struct rn_cloud){0};
}

static void teardown(void) {
    rn_cloud_finish(&cloud);
}

static void add(const double box[2][3]) {
    ck_assert_int_eq(rn_cloud_add(&cloud, &camera, &rgb, &depth, &opacity, box, &err), RN_OK);
}

START_TEST(wall) {
    add(NULL);
    ck_assert_uint_eq(cloud.count, WIDTH * HEIGHT);
    for (size_t i = 0; i < cloud.count; i++) {
        const struct rn_cloud_point *p = &cloud.points[i];
        ck_assert_float_eq_tol(p->position[0], (float)(1 + 0.5 * (p->colour[0] + 0.5 - 4)), 1e-5f);
        ck_assert_float_eq_tol(p->position[1], (float)(2 + 0.5 * (p->colour[1] + 0.5 - 3)), 1e-5f);
        ck_assert_float_eq_tol(p->position[2], 8, 1e-5f);
        ck_assert_uint_eq(p->colour[2], 7);
    }
}
END_TEST

// A pixel nearer than its neighbours goes with them; one that shows nothing, or only infinity, too.
START_TEST(edges) {
    static const float others[] = {4, 0, INFINITY, NAN};
    values[2 * WIDTH + 3] = others[_i];
    add(NULL);
    ck_assert_uint_eq(cloud.count, WIDTH * HEIGHT - 5);
}
END_TEST

START_TEST(transparent) {
    opacities[4 * 11] = 100;
    add(NULL);
    ck_assert_uint_eq(cloud.count, WIDTH * HEIGHT - 1);
}
END_TEST

START_TEST(cropped) {
    const double box[2][3] = {{1, -100, 7}, {100, 2, 9}}; // the right half's upper half
    add(box);
    ck_assert_uint_eq(cloud.count, WIDTH * HEIGHT / 4);
    const double behind[2][3] = {{-100, -100, 8.1}, {100, 100, 9}};
    add(behind);
    ck_assert_uint_eq(cloud.count, WIDTH * HEIGHT / 4);
}
END_TEST

START_TEST(other_sizes) {
    camera.width++;
    ck_assert_int_eq(rn_cloud_add(&cloud, &camera, &rgb, &depth, NULL, NULL, &err),
                     RN_ERROR_INVALID);
}
END_TEST

START_TEST(ply) {
    uint8_t *bytes;
    size_t size;
    add(NULL);
    ck_assert_int_eq(rn_cloud_encode_ply(&cloud, &bytes, &size, &err), RN_OK);
    const char *body = strstr((char *)bytes, "end_header\n") + strlen("end_header\n");
    float position[3];
    ck_assert_ptr_nonnull(strstr((char *)bytes, "element vertex 48\n"));
    ck_assert_uint_eq(size - (size_t)(body - (char *)bytes), 15 * cloud.count);
    memcpy(position, body + 15 * 9, sizeof position);
    ck_assert_float_eq(position[0], cloud.points[9].position[0]);
    ck_assert_uint_eq((uint8_t)body[15 * 9 + 13], cloud.points[9].colour[1]);
    free(bytes);
}
END_TEST

START_TEST(depths_of_a_png) {
    struct rn_picture back;
    uint8_t *bytes;
    size_t size;
    values[0] = 20; // the scale is 10
    values[1] = 0;
    ck_assert_int_eq(rn_picture_encode_depth_png(&depth, 10, 1, &bytes, &size, &err), RN_OK);
    ck_assert_int_eq(rn_picture_decode_depth_png(bytes, size, &back, &err), RN_OK);
    ck_assert_int_eq(back.width, WIDTH);
    ck_assert_int_eq(back.height, HEIGHT);
    ck_assert(isinf(back.values[0]) && back.values[1] == 0);
    for (int i = 2; i < WIDTH * HEIGHT; i++)
        ck_assert_float_eq_tol(back.values[i], values[i], 10.0f / 131070 + 1e-6f);
    rn_picture_finish(&back);
    for (size_t cut = 0; cut + 20 < size; cut += 7)
        ck_assert_int_eq(rn_picture_decode_depth_png(bytes, cut, &back, &err), RN_ERROR_CORRUPT);
    free(bytes);
    ck_assert_int_eq(rn_image_encode_png(&rgb, 1, &bytes, &size, &err), RN_OK);
    ck_assert_int_eq(rn_picture_decode_depth_png(bytes, size, &back, &err), RN_ERROR_CORRUPT);
    ck_assert_msg(strstr(err.text, "no depth picture") != NULL, "%s", err.text);
    free(bytes);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("cloud");
    TCase *tests = tcase_create("cloud");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_test(tests, wall);
    tcase_add_loop_test(tests, edges, 0, 4);
    tcase_add_test(tests, transparent);
    tcase_add_test(tests, cropped);
    tcase_add_test(tests, other_sizes);
    tcase_add_test(tests, ply);
    tcase_add_test(tests, depths_of_a_png);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
