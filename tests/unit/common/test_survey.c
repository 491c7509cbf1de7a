// What a look at all photographs finds: each fault planted in a capture without any.
#include <math.h>

#include "common/dataset/photos.h"
#include "common/settings/train.h"
#include "tests/unit/common/dataset_fixture.h"

#define VIEWS 24
#define SIZE 64

static struct rn_findings found;
static char *document;
static bool again;    // the seventh is taken where the sixth was
static int along = 1; // places from each photograph to the next, around the ring

// Photographs from a ring of 270 degrees, 30 degrees above the horizon; the pattern moves along.
static const struct rn_import_options as_is = {.scales = 1};

static void put_ring(void) {
    document = strdup("{\"camera_angle_x\":0.7,\"frames\":[");
    for (int i = 0; i < VIEWS; i++) {
        double a = 1.5 * M_PI * (again && i == 6 ? 5 : i * along % VIEWS) / (VIEWS - 1), up = 0.5,
               flat = sqrt(0.75);
        const double out[3] = {flat * cos(a), flat * sin(a), up};
        const double right[3] = {-sin(a), cos(a), 0};
        char *next;
        ck_assert(
            asprintf(&next,
                     "%s%s{\"file_path\":\"train/r_%d\",\"transform_matrix\":[[%g,%.17g,%.17g,"
                     "%.17g],[%.17g,%.17g,%.17g,%.17g],[%g,%.17g,%.17g,%.17g],[0,0,0,1]]}",
                     document, i ? "," : "", i, right[0], -up * cos(a), out[0], 4 * out[0],
                     right[1], -up * sin(a), out[1], 4 * out[1], 0.0, flat, up, 4 * up) > 0);
        free(document);
        document = next;
    }
}

// Noise that is blurred over `blur` pixels, by `seed`.
static void put_photo(int i, int blur, uint64_t seed) {
    char name[32];
    struct rn_image image = noise(SIZE, SIZE, seed);
    snprintf(name, sizeof name, "train/r_%d.png", i);
    image.has_alpha = false;
    for (int y = 0; y < SIZE; y++)
        for (int x = 0; x < SIZE; x++) {
            uint8_t *to = image.pixels + 4 * (y * SIZE + x);
            const uint8_t *from = image.pixels + 4 * (y / blur * blur * SIZE + x / blur * blur);
            for (int c = 0; c < 3; c++)
                to[c] = (uint8_t)(128 + (from[c] - 128) * cos(0.2 * x) * cos(0.15 * y));
            to[3] = 255;
        }
    ck_assert_int_eq(rn_image_write_png(&image, in_folder(name), 1, &err), RN_OK);
    rn_image_finish(&image);
}

static void look(void) {
    struct rn_survey *survey = NULL;
    ck_assert_int_eq(rn_survey_create(dataset, &survey, &err), RN_OK);
    ck_assert_int_eq(rn_dataset_check_images(dataset, 2, &problems, survey, NULL, NULL, &err),
                     RN_OK);
    ck_assert_int_eq(rn_survey_conclude(survey, dataset, &as_is, &problems, &found, &err), RN_OK);
    rn_survey_destroy(&survey);
}

static void read_ring(void) {
    char *whole;
    ck_assert(asprintf(&whole, "%s]}", document) > 0);
    put_text("transforms_train.json", whole);
    free(whole);
    free(document);
    read_ok(folder);
}

static void survey(void) {
    read_ring();
    look();
}

static void put_photos(void) {
    for (int i = 0; i < VIEWS; i++)
        put_photo(i, 1, (uint64_t)i + 1);
}

// Squares of colours that all photographs show in the same places, `gain` as bright.
static void put_squares(int i, double gain) {
    char name[32];
    struct rn_image image = noise(SIZE, SIZE, 1);
    snprintf(name, sizeof name, "train/r_%d.png", i);
    image.has_alpha = false;
    for (int at = 0; at < SIZE * SIZE; at++)
        for (int c = 0; c < 4; c++) {
            int square = at % SIZE / 8 + at / SIZE / 8 * 8;
            double value = 60 + 100 * fabs(sin(square * 0.7 + 2 * c));
            image.pixels[4 * at + c] = c == 3 ? 255 : (uint8_t)(value * gain);
        }
    ck_assert_int_eq(rn_image_write_png(&image, in_folder(name), 1, &err), RN_OK);
    rn_image_finish(&image);
}

// A sparse point in the middle of each square of every photograph.
static void put_points(void) {
    struct rn_points *points = &dataset->points;
    points->count = 64;
    points->items = calloc(points->count, sizeof *points->items);
    points->sightings = calloc(VIEWS * points->count, sizeof *points->sightings);
    for (uint32_t photo = 0; photo < VIEWS; photo++) {
        dataset->frames[photo].photo = (int)photo;
        for (uint32_t i = 0; i < points->count; i++)
            points->sightings[points->sighting_count++] = (struct rn_sighting){
                i, photo, ((float)(i % 8) + 0.5f) / 8, ((float)(i / 8) + 0.5f) / 8};
    }
}

static bool tells(const char *text) {
    for (size_t i = 0; i < problems.count; i++)
        if (strstr(problems.items[i].text, text)) return true;
    return false;
}

START_TEST(nothing_is_wrong) {
    put_ring();
    put_photos();
    survey();
    ck_assert_double_eq(found.blurred, 0);
    ck_assert_double_eq(found.duplicates, 0);
    ck_assert_double_eq(found.looking_away, 0);
    ck_assert_double_eq_tol(found.azimuth_gap_deg, 90, 1e-3);
    ck_assert_double_eq_tol(found.elevation_min_deg, 30, 1e-3);
    ck_assert_double_eq_tol(found.elevation_max_deg, 30, 1e-3);
    ck_assert(isnan(found.reprojection_px) && isnan(found.exposure_spread));
    ck_assert_double_gt(found.train_bytes, 4 * VIEWS * SIZE * SIZE);
    ck_assert_uint_eq(problems.errors, 0);
}
END_TEST

// What an import by `kept` costs to train on: photographs of one scale are made smaller where there
// are more pixels than the time has rays for, and of several, more than may lie in memory are on
// disk.
START_TEST(cost) {
    const struct rn_setting *most = rn_settings_find(&rn_train_settings, "pixel_memory");
    put_ring();
    put_photos();
    survey();
    for (size_t i = 0; i < dataset->frame_count; i++)
        dataset->frames[i].camera.width = dataset->frames[i].camera.height = 8192;
    double pixels = VIEWS * 8192.0 * 8192, field = 330e6;
    struct rn_training_cost whole = rn_training_cost(dataset, &as_is);
    ck_assert_int_eq(whole.views[RN_SPLIT_TRAIN], VIEWS);
    ck_assert_int_eq(whole.views[RN_SPLIT_TEST], 0);
    ck_assert(whole.width == 8192 && whole.height == 8192 && whole.scales == 1);
    ck_assert_int_eq(whole.reduced, 8); // to 25 megapixels for 60 s
    ck_assert_double_eq_tol(whole.bytes, field + 4 * pixels / 64, 1);
    ck_assert_double_gt(whole.load_seconds, 1);
    ck_assert_double_eq(whole.seconds, 60);
    struct rn_import_options kept = {.scales = 2, .test_every = 4};
    struct rn_training_cost scales = rn_training_cost(dataset, &kept);
    ck_assert_int_eq(scales.views[RN_SPLIT_TEST], VIEWS / 4);
    ck_assert(scales.reduced == 1 && scales.scales == 2);
    ck_assert_double_eq_tol(scales.bytes, field + most->standard * 1048576, 1);
    kept = (struct rn_import_options){.scales = 1, .max_size = 512};
    struct rn_training_cost small = rn_training_cost(dataset, &kept);
    ck_assert(small.width == 512 && small.reduced == 1);
    ck_assert_double_eq_tol(small.bytes, field + 4.0 * VIEWS * 512 * 512, 1);
    ck_assert_double_eq_tol(small.load_seconds, whole.load_seconds / 256, 1e-6);
}
END_TEST

START_TEST(blur) {
    put_ring();
    put_photos();
    put_photo(7, 8, 8);
    survey();
    ck_assert_double_eq(found.blurred, 1);
    ck_assert(tells("the same camera took before and after: r_7"));
    ck_assert(!tells("is not judged"));
}
END_TEST

// A side of what is turned around is soft, and names lead across: only r_2, blurred among sharp
// ones of its place, is told, where their order says it of many.
START_TEST(names_in_no_order) {
    along = 7;
    put_ring();
    for (int i = 0; i < VIEWS; i++)
        put_photo(i, i * along % VIEWS < 10 || i == 2 ? 8 : 1, (uint64_t)i + 1);
    survey();
    along = 1;
    ck_assert_double_eq(found.blurred, 2);
    ck_assert(tells("before and after: r_2"));
}
END_TEST

// Every third photograph is of another camera, whose pictures are softer, and r_7 is blurred. Which
// camera it was is known; not known of any; of each another; known of one alone.
START_TEST(cameras_that_are_soft) {
    static const int blurred[] = {1, 9, 0, 0}, unjudged[] = {0, 0, VIEWS, VIEWS};
    put_ring();
    for (int i = 0; i < VIEWS; i++)
        put_photo(i, i % 3 == 2 || i == 7 ? 8 : 1, (uint64_t)i + 1);
    read_ring();
    for (int i = 0; i < VIEWS; i++) {
        const int keys[] = {1 + (i % 3 == 2), 0, 1 + i, i == 0};
        dataset->frames[i].camera_key = (uint32_t)keys[_i];
    }
    look();
    char words[64];
    snprintf(words, sizeof words, "whether %d of the photographs are sharp is not", unjudged[_i]);
    ck_assert_double_eq(found.blurred, blurred[_i]);
    ck_assert_int_eq(tells("took before and after: r_7"), _i == 0);
    ck_assert_int_eq(tells(words), unjudged[_i] > 0);
}
END_TEST

START_TEST(duplicates) {
    again = _i == 0;
    put_ring();
    put_photos();
    put_photo(6, 1, 6); // the same picture as r_5
    survey();
    ck_assert_double_eq(found.duplicates, _i == 0);
    ck_assert(tells(_i ? "have different poses: r_5 and r_6" : "from the same place: r_5 and r_6"));
}
END_TEST

// Test views that are copies of training views are told; one that shows something else is none.
START_TEST(tests_of_what_is_learnt_by_heart) {
    char *tested, name[32], told[96];
    put_ring();
    put_photos();
    ck_assert(asprintf(&tested, "%s]}", document) > 0);
    for (char *at = tested; (at = strstr(at, "train/"));)
        memcpy(at, "tests/", 6);
    put_text("transforms_test.json", tested);
    free(tested);
    for (int i = 0; i < VIEWS; i++) {
        snprintf(name, sizeof name, "train/r_%d.png", i);
        const char *from = in_folder(name);
        snprintf(name, sizeof name, "tests/r_%d.png", i);
        ck_assert_int_eq(link(from, in_folder(name)), 0);
    }
    ck_assert_int_eq(remove(in_folder("train/r_3.png")), 0); // of two links
    put_photo(3, 1, 99);
    survey();
    snprintf(told, sizeof told, "%d test views are copies of training views", VIEWS - 1);
    ck_assert(tells(told));
    ck_assert(tells("--split every:8"));
}
END_TEST

START_TEST(cameras_that_look_away) {
    put_ring();
    char *next;
    ck_assert(asprintf(&next,
                       "%s,{\"file_path\":\"train/r_24\",\"transform_matrix\":"
                       "[[1,0,0,4],[0,1,0,0],[0,0,1,9],[0,0,0,1]]}",
                       document) > 0);
    free(document);
    document = next;
    put_photos();
    put_photo(VIEWS, 1, 99);
    read_ring();
    if (_i) dataset->lie.kind = _i == 1 ? RN_CAPTURE_ROOM : RN_CAPTURE_DRONE; // which hold it all
    look();
    ck_assert_double_eq(found.looking_away, 1);
    ck_assert_int_eq(tells("1 of 25 cameras look away from the bounds: r_24"), _i == 0);
}
END_TEST

// What cameras tell before any picture is looked at, and a training's memory at the size that is
// asked.
START_TEST(not_looked_at) {
    struct rn_import_options kept = {
        .scales = 1, .max_size = _i ? SIZE / 2 : 0, .test_every = _i ? 2 : 0};
    struct rn_survey *survey = NULL;
    put_ring();
    put_photos();
    read_ring();
    ck_assert_int_eq(rn_survey_create(dataset, &survey, &err), RN_OK);
    ck_assert_int_eq(rn_survey_conclude(survey, dataset, &kept, &problems, &found, &err), RN_OK);
    ck_assert_double_eq_tol(found.azimuth_gap_deg, 90, 1e-3);
    ck_assert_double_eq(found.looking_away, 0);
    ck_assert(isnan(found.blurred) && isnan(found.duplicates) && isnan(found.exposure_spread));
    double bytes = found.train_bytes - 330e6;
    ck_assert_double_eq_tol(bytes, 4.0 * VIEWS * SIZE * SIZE / (_i ? 8 : 1), 1);
    rn_survey_destroy(&survey);
}
END_TEST

// Angles have no signs: half of the cameras are moved by so much of the ring's height, all by that.
START_TEST(heights) {
    static const struct {
        double half, all;
        const char *words;
    } cases[] = {{0, 0, "around, 30 degrees above the horizon"},
                 {0, -4, "around, 30 degrees below the horizon"},
                 {-4, 0, "around, 30 degrees below to 30 above the horizon"},
                 {-2, -2, "around, 0 to 30 degrees below the horizon"},
                 {-1, 0, "around, 16 to 30 degrees above the horizon"}};
    put_ring();
    put_photos();
    read_ring();
    for (int i = 0; i < VIEWS; i++)
        dataset->frames[i].camera.world_from_camera[2][3] +=
            cases[_i].all + (i % 2 ? cases[_i].half : 0);
    look();
    ck_assert(tells(cases[_i].words));
}
END_TEST

// Exposures that follow the camera around, and those by chance, which training makes even.
START_TEST(exposures) {
    put_ring();
    for (int i = 0; i < VIEWS; i++)
        put_squares(i, exp(0.2 * (_i ? sin(1e3 * i * i) : sin(1.5 * M_PI * i / (VIEWS - 1)))));
    read_ring();
    put_points();
    look();
    ck_assert_double_gt(found.exposure_spread, 0.15);
    ck_assert(tells("exposures of 90 % of the photographs differ by"));
    ck_assert_int_eq(tells("training makes them even (effect exposure)"), _i);
}
END_TEST

// What cameras call for: nothing, a lens, space to infinity, planes over disparity, or one of
// these.
START_TEST(effects) {
    put_ring();
    put_photos();
    read_ring();
    for (int i = 0; i < VIEWS; i++) {
        struct rn_frame *frame = &dataset->frames[i];
        if (_i == 1) {
            frame->camera.lens = RN_LENS_POLYNOMIAL;
            frame->camera.lens_k[0] = 0.1;
        }
        if (_i < 3) continue;
        double eye[3] = {0.1 * i, 0, 4}, target[3] = {0.1 * i, 0, 0};
        ck_assert_int_eq(rn_camera_look_at(eye, target, (const double[3]){0, 1, 0},
                                           frame->camera.world_from_camera),
                         RN_OK);
        frame->near = _i == 3 ? 2 : 0;
        frame->far = _i == 3 ? 9 : 0;
    }
    if (_i >= 2) dataset->bounds.source = RN_BOUNDS_CAMERAS;
    look();
    ck_assert_int_eq(tells("training follows it (effect distortion)"), _i == 1);
    ck_assert_int_eq(tells("contracts space to infinity (effect unbounded)"),
                     _i % 2 == 0 && _i > 0);
    ck_assert_int_eq(tells("between near and far (effect forward-facing)"), _i >= 3);
    ck_assert_int_eq(tells("where an import finds these"), _i == 4);
}
END_TEST

// One line for all that is not there.
START_TEST(missing) {
    put_ring();
    put_photos();
    for (int i = 4; i < VIEWS; i++) {
        char name[32];
        snprintf(name, sizeof name, "train/r_%d.png", i);
        ck_assert_int_eq(remove(in_folder(name)), 0);
    }
    survey();
    ck_assert_uint_eq(problems.errors, 1);
    ck_assert_int_eq(dataset->unusable[RN_SPLIT_TRAIN], 20);
    ck_assert(tells("r_4.png, which does not exist; neither do 19 others"));
    ck_assert(tells("the last at"));
}
END_TEST

// Blur and what is the same are seen without poses too; one that is damaged is left out.
START_TEST(photographs_without_poses) {
    struct rn_photos photos = {0};
    put_photos();
    put_photo(7, 4, 8);
    put_photo(12, 1, 12); // as the one before it
    put_text("train/r_3.png", "no picture");
    ck_assert_int_eq(rn_photos_read(folder, NULL, &problems, &photos, &err), RN_OK);
    put_text("train/r_5.png", "\x89PNG\r\n\x1a\n");
    ck_assert_int_eq(rn_photos_check(&photos, "ring", 2, &problems, NULL, NULL, &found, &err),
                     RN_OK);
    ck_assert_uint_eq(photos.count, VIEWS - 2);
    ck_assert_uint_eq(problems.errors, 2);
    ck_assert(found.blurred == 1 && found.duplicates == 1);
    ck_assert(isnan(found.looking_away) && isnan(found.train_bytes));
    ck_assert(tells("took before and after: train/r_7.png"));
    ck_assert(tells("nearly the same: train/r_11.png and train/r_12.png"));
    rn_photos_finish(&photos);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("survey");
    TCase *tests = tcase_create("survey");
    tcase_add_checked_fixture(tests, setup, teardown);
    tcase_add_test(tests, nothing_is_wrong);
    tcase_add_test(tests, cost);
    tcase_add_test(tests, blur);
    tcase_add_test(tests, names_in_no_order);
    tcase_add_loop_test(tests, cameras_that_are_soft, 0, 4);
    tcase_add_loop_test(tests, duplicates, 0, 2);
    tcase_add_test(tests, tests_of_what_is_learnt_by_heart);
    tcase_add_loop_test(tests, cameras_that_look_away, 0, 3);
    tcase_add_loop_test(tests, heights, 0, 5);
    tcase_add_loop_test(tests, not_looked_at, 0, 2);
    tcase_add_loop_test(tests, exposures, 0, 2);
    tcase_add_loop_test(tests, effects, 0, 5);
    tcase_add_test(tests, missing);
    tcase_add_test(tests, photographs_without_poses);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
