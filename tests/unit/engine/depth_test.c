// Depths against sparse points: the median of known errors.
#include <math.h>

#include "server/engine/engine.h"
#include "tests/support/suite.h"

#define WIDTH 8
#define HEIGHT 4

static struct rn_point items[5];
static struct rn_sighting sightings[8];
static float values[WIDTH * HEIGHT];
static struct rn_frame frame;
static struct rn_points points;
static const struct rn_picture depth = {
    .width = WIDTH, .height = HEIGHT, .channels = 1, .values = values};

// Points at distances of 1 to 5 before a camera at (1, 2, 3); photograph 7 sees point i at pixel
// (i, i % 4), where the depth is off by 0, 10 %, 20 %, ...
static void setup(void) {
    frame = (struct rn_frame){.photo = 7, .path = (char *)"photograph"};
    for (int i = 0; i < 3; i++) {
        frame.camera.world_from_camera[i][i] = 1;
        frame.camera.world_from_camera[i][3] = i + 1;
    }
    for (int i = 0; i < 5; i++) {
        double far = i + 1;
        items[i] = (struct rn_point){.position = {1 + 0.6 * far, 2, 3 + 0.8 * far}};
        sightings[i] = (struct rn_sighting){.point = (uint32_t)i,
                                            .photo = 7,
                                            .x = ((float)i + 0.5f) / WIDTH,
                                            .y = ((float)(i % 4) + 0.5f) / HEIGHT};
        values[i % 4 * WIDTH + i] = (float)(far * (1 + 0.1 * (i % 2 ? -i : i)));
    }
    points =
        (struct rn_points){.items = items, .count = 5, .sightings = sightings, .sighting_count = 5};
}

static struct rn_depth_score compare(void) {
    struct rn_depth_score score;
    struct rn_error err;
    ck_assert_int_eq(rn_depth_compare(&depth, &frame, &points, &score, &err), RN_OK);
    return score;
}

START_TEST(median_of_the_errors) {
    ck_assert_uint_eq(compare().points, 5);
    ck_assert_double_eq_tol(compare().median, 0.2, 1e-6);
    points.sighting_count = 4;
    ck_assert_double_eq_tol(compare().median, 0.15, 1e-6);
    points.sighting_count = 0;
    ck_assert_uint_eq(compare().points, 0);
    ck_assert(isnan(compare().median));
}
END_TEST

START_TEST(what_shows_nothing_is_off_by_all_of_it) {
    for (int i = 0; i < WIDTH * HEIGHT; i++)
        values[i] = 0;
    ck_assert_double_eq_tol(compare().median, 1, 1e-6);
}
END_TEST

// Of another photograph, of no point, outside of the picture.
START_TEST(sightings_that_do_not_count) {
    sightings[5] = (struct rn_sighting){.point = 4, .photo = 6, .x = 0.5f, .y = 0.5f};
    sightings[6] = (struct rn_sighting){.point = 5, .photo = 7, .x = 0.5f, .y = 0.5f};
    sightings[7] = (struct rn_sighting){.point = 4, .photo = 7, .x = 1.5f, .y = NAN};
    points.sighting_count = 8;
    ck_assert_uint_eq(compare().points, 5);
    ck_assert_double_eq_tol(compare().median, 0.2, 1e-6);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("depth");
    TCase *tests = tcase_create("depth");
    tcase_add_checked_fixture(tests, setup, NULL);
    tcase_add_test(tests, median_of_the_errors);
    tcase_add_test(tests, what_shows_nothing_is_off_by_all_of_it);
    tcase_add_test(tests, sightings_that_do_not_count);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
