// Gains of photographs from the colours of shared points: known ones are found again.
#include <math.h>
#include <string.h>

#include "common/dataset/exposure.h"
#include "tests/unit/common/dataset_fixture.h"

enum { PHOTOS = 6, POINTS = 120, SIDE = 64 };

static struct rn_frame frames[PHOTOS];
static struct rn_dataset capture;

static double true_gain(int photo, int channel) {
    return exp(0.25 * sin(photo * 1.7 + channel));
}

static double true_colour(int point, int channel) {
    return 60 + 110 * fabs(sin(point * 0.7 + 2 * channel));
}

// Every point is seen by every photograph, in a place of its own; a tenth show something else.
static void make_capture(void) {
    capture = (struct rn_dataset){.name = (char *)"made", .frames = frames, .frame_count = PHOTOS};
    capture.points.items = calloc(POINTS, sizeof *capture.points.items);
    capture.points.sightings = calloc(PHOTOS * POINTS, sizeof *capture.points.sightings);
    capture.points.count = POINTS;
    for (uint32_t photo = 0; photo < PHOTOS; photo++) {
        frames[photo] = (struct rn_frame){.photo = (int)photo};
        for (uint32_t point = 0; point < POINTS; point++)
            capture.points.sightings[capture.points.sighting_count++] =
                (struct rn_sighting){point, photo, ((float)(point % 12 * 5) + 2.5f) / SIDE,
                                     ((float)(point / 12 * 5) + 2.5f) / SIDE};
    }
}

static struct rn_image photograph(int photo) {
    struct rn_image image;
    ck_assert_int_eq(rn_image_init(SIDE, SIDE, &image, &err), RN_OK);
    memset(image.pixels, 255, 4 * SIDE * SIDE);
    for (int point = 0; point < POINTS; point++)
        for (int i = 0; i < 25; i++) {
            int x = point % 12 * 5 + i % 5, y = point / 12 * 5 + i / 5;
            for (int c = 0; c < 3; c++) {
                double value = true_colour(point, c) * true_gain(photo, c);
                if ((point + photo) % 10 == 0) value = 30 + (point * 7 + photo * 31) % 150;
                image.pixels[4 * (y * SIDE + x) + c] = (uint8_t)fmin(255, value + 0.5);
            }
        }
    return image;
}

START_TEST(known_gains_are_found) {
    struct rn_exposures *exposures;
    make_capture();
    ck_assert_int_eq(rn_exposures_create(&capture, &exposures, &err), RN_OK);
    for (int photo = PHOTOS - 1; photo >= 0; photo--) {
        struct rn_image image = photograph(photo);
        rn_exposures_look(exposures, &frames[photo], &image);
        rn_image_finish(&image);
    }
    rn_exposures_solve(exposures, frames, PHOTOS);
    for (int c = 0; c < 3; c++) {
        double mean = 0;
        for (int photo = 0; photo < PHOTOS; photo++)
            mean += log(true_gain(photo, c)) / PHOTOS;
        for (int photo = 0; photo < PHOTOS; photo++)
            ck_assert_double_eq_tol(log(frames[photo].gain[c]), log(true_gain(photo, c)) - mean,
                                    0.03);
    }
    ck_assert_double_gt(rn_exposure_spread(frames, PHOTOS), 0.1);
    rn_exposures_destroy(&exposures);
    free(capture.points.items);
    free(capture.points.sightings);
}
END_TEST

START_TEST(photographs_that_are_not_seen_are_not_measured) {
    struct rn_exposures *exposures;
    make_capture();
    ck_assert_int_eq(rn_exposures_create(&capture, &exposures, &err), RN_OK);
    for (int photo = 0; photo < 2; photo++) {
        struct rn_image image = photograph(0);
        rn_exposures_look(exposures, &frames[photo], &image);
        rn_image_finish(&image);
    }
    rn_exposures_solve(exposures, frames, PHOTOS);
    ck_assert_double_eq_tol(frames[0].gain[0], 1, 1e-6);
    ck_assert_double_eq(frames[2].gain[0], 0);
    ck_assert_double_lt(rn_exposure_spread(frames, PHOTOS), 1e-6);
    rn_exposures_destroy(&exposures);
    capture.points.sighting_count = 0;
    ck_assert_int_eq(rn_exposures_create(&capture, &exposures, &err), RN_OK);
    ck_assert_ptr_null(exposures);
    ck_assert(isnan(rn_exposure_spread(frames, 1)));
    free(capture.points.items);
    free(capture.points.sightings);
}
END_TEST

// A shadow that moves from photograph to photograph: over points by chance, whatever the gains.
START_TEST(light_that_moves_is_told_from_exposures) {
    for (int moves = 0; moves <= 1; moves++) {
        struct rn_exposures *exposures;
        make_capture();
        ck_assert_int_eq(rn_exposures_create(&capture, &exposures, &err), RN_OK);
        for (int photo = 0; photo < PHOTOS; photo++) {
            struct rn_image image = photograph(photo);
            for (int i = 0; i < 4 * SIDE * SIDE; i++) {
                int point = i / 4 % SIDE / 5 + i / 4 / SIDE / 5 * 12;
                if (moves && i % 4 < 3 && sin(point * 1.3 + photo * 2.1) > 0)
                    image.pixels[i] = (uint8_t)(image.pixels[i] * 0.7 + 0.5);
            }
            rn_exposures_look(exposures, &frames[photo], &image);
            rn_image_finish(&image);
        }
        rn_exposures_solve(exposures, frames, PHOTOS);
        double light = rn_light_unrest(frames, PHOTOS);
        if (moves)
            ck_assert_double_gt(light, RN_LIGHT_UNREST);
        else
            ck_assert_double_lt(light, 0.02);
        rn_exposures_destroy(&exposures);
        free(capture.points.items);
        free(capture.points.sightings);
    }
    ck_assert(isnan(rn_light_unrest(frames, 1)));
}
END_TEST

// Cameras all around, in no order; brightness by the camera's place, or by chance.
START_TEST(what_follows_the_camera_around_is_no_unrest) {
    enum { CAMERAS = 40 };
    struct rn_frame ring[CAMERAS];
    memset(ring, 0, sizeof ring);
    for (int by_chance = 0; by_chance <= 1; by_chance++) {
        for (int i = 0; i < CAMERAS; i++) {
            double angle = 2 * M_PI * (i * 7 % CAMERAS) / CAMERAS;
            double gain = exp(0.2 * (by_chance ? sin(1e3 * i * i) : sin(angle)));
            ring[i].camera.world_from_camera[0][2] = cos(angle);
            ring[i].camera.world_from_camera[1][2] = sin(angle);
            for (int c = 0; c < 3; c++)
                ring[i].gain[c] = gain;
        }
        ck_assert_double_gt(rn_exposure_spread(ring, CAMERAS), 0.15);
        double unrest = rn_exposure_unrest(ring, CAMERAS);
        // Neighbours on the ring: 0.2 * 2 pi / CAMERAS = 3.1 % at most.
        if (by_chance)
            ck_assert_double_gt(unrest, 0.2);
        else
            ck_assert_double_lt(unrest, 0.033);
    }
    ck_assert(isnan(rn_exposure_unrest(ring, 1)));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("exposure");
    TCase *tests = tcase_create("exposure");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_test(tests, known_gains_are_found);
    tcase_add_test(tests, light_that_moves_is_told_from_exposures);
    tcase_add_test(tests, photographs_that_are_not_seen_are_not_measured);
    tcase_add_test(tests, what_follows_the_camera_around_is_no_unrest);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
