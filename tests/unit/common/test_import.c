// Import: sizes, scales, cameras and pixels of the native dataset; what stops it and what does not.
#include <math.h>
#include <signal.h>
#include <sys/resource.h>
#include <unistd.h>

#include "tests/unit/common/dataset_fixture.h"

#define VIEWS 5

static struct rn_import_options options;
static struct rn_dataset *made;

static void setup_source(void) {
    setup();
    for (int i = 0; i < VIEWS; i++) {
        char name[64];
        snprintf(name, sizeof name, "source/train/r_%d.png", i);
        struct rn_image image = noise(32, 24, (uint64_t)i);
        ck_assert_int_eq(rn_image_write_png(&image, in_folder(name), 1, &err), RN_OK);
        rn_image_finish(&image);
    }
    put_transforms("train", FRAME("train/r_0") "," FRAME("train/r_1") "," FRAME(
                                "train/r_2") "," FRAME("train/r_3") "," FRAME("train/r_4"));
    ck_assert_int_eq(
        rename(in_folder("transforms_train.json"), in_folder("source/transforms_train.json")), 0);
    read_ok(in_folder("source"));
    options = (struct rn_import_options){.scales = 1, .threads = 3};
}

static void teardown_source(void) {
    rn_dataset_destroy(&made);
    teardown();
}

static enum rn_status import(const char *target) {
    return rn_dataset_import(dataset, "name \xc3\xa9", &options, in_folder(target), &problems, NULL,
                             NULL, &err);
}

static void import_warned(const char *target) {
    ck_assert_msg(import(target) == RN_OK, "%s: %s", err.where, err.text);
    rn_dataset_destroy(&made);
    enum rn_status status = rn_dataset_read(in_folder(target), &problems, &made, &err);
    ck_assert_msg(status == RN_OK, "%s: %s", err.where, err.text);
}

static void import_ok(const char *target) {
    import_warned(target);
    ck_assert_uint_eq(problems.errors + problems.warnings, 0);
}

static struct rn_image read_image(const char *path) {
    struct rn_image image;
    enum rn_status status = rn_image_read(path, &rn_image_default_limits, &image, &err);
    ck_assert_msg(status == RN_OK, "%s", err.text);
    return image;
}

static void assert_same_pixels(const struct rn_image *a, const struct rn_image *b) {
    ck_assert_int_eq(a->width, b->width);
    ck_assert_int_eq(a->height, b->height);
    ck_assert_mem_eq(a->pixels, b->pixels, (size_t)a->width * (size_t)a->height * 4);
}

START_TEST(as_it_is) {
    import_ok("out");
    ck_assert_str_eq(made->name, "name \xc3\xa9");
    ck_assert_uint_eq(made->frame_count, VIEWS);
    ck_assert_int_eq(made->bounds.source, dataset->bounds.source);
    ck_assert_double_eq(made->bounds.radius, dataset->bounds.radius);
    ck_assert(made->premultiplied_scales);
    for (size_t i = 0; i < VIEWS; i++) {
        const struct rn_frame *from = &dataset->frames[i], *to = &made->frames[i];
        ck_assert_str_eq(to->name, from->name);
        ck_assert_int_eq(to->index, from->index);
        ck_assert(to->has_alpha);
        ck_assert_double_eq(to->loss_weight, 1);
        ck_assert_int_eq(to->camera.width, 32);
        ck_assert_mem_eq(&to->camera.fx, &from->camera.fx, sizeof(double)); // to the last bit
        ck_assert_mem_eq(to->camera.world_from_camera, from->camera.world_from_camera,
                         sizeof from->camera.world_from_camera);
        struct rn_image a = read_image(from->path), b = read_image(to->path);
        assert_same_pixels(&a, &b);
        rn_image_finish(&a);
        rn_image_finish(&b);
    }
}
END_TEST

START_TEST(smaller_and_scaled) {
    options.max_size = 20;
    options.scales = 3;
    import_ok("out");
    static const int widths[] = {20, 10, 5}, heights[] = {15, 8, 4}; // 7.5 and 3.75 rounded
    ck_assert_uint_eq(made->frame_count, 3 * VIEWS);
    ck_assert_int_eq(made->scale_count, 3);
    for (size_t i = 0; i < made->frame_count; i++) {
        const struct rn_frame *frame = &made->frames[i];
        ck_assert_int_eq(frame->camera.width, widths[frame->scale]);
        ck_assert_int_eq(frame->camera.height, heights[frame->scale]);
        ck_assert_double_eq(frame->loss_weight, 1 << (2 * frame->scale));
        double focal = dataset->frames[0].camera.fx;
        ck_assert_double_eq_tol(frame->camera.fx, focal * widths[frame->scale] / 32, 1e-12);
        ck_assert_double_eq_tol(frame->camera.fy, focal * heights[frame->scale] / 24, 1e-12);
        ck_assert_double_eq_tol(frame->camera.cy, 0.5 * heights[frame->scale], 1e-12);
        const struct rn_frame *from = rn_dataset_frame(dataset, RN_SPLIT_TRAIN, frame->index, 0);
        struct rn_image source = read_image(from->path), full, level,
                        stored = read_image(frame->path);
        ck_assert_int_eq(
            rn_image_downscale(&source, 20, 15, RN_DOWNSCALE_PREMULTIPLIED, &full, &err), RN_OK);
        ck_assert_int_eq(rn_image_downscale(&full, widths[frame->scale], heights[frame->scale],
                                            RN_DOWNSCALE_PREMULTIPLIED, &level, &err),
                         RN_OK);
        assert_same_pixels(&stored, &level);
        rn_image_finish(&source);
        rn_image_finish(&full);
        rn_image_finish(&level);
        rn_image_finish(&stored);
    }
}
END_TEST

START_TEST(legacy_scales) {
    options.scales = 4;
    options.downscale = RN_DOWNSCALE_STRAIGHT;
    import_ok("out");
    ck_assert(!made->premultiplied_scales);
    for (int view = 0; view < VIEWS; view++) {
        struct rn_image levels[4];
        struct rn_image full = read_image(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, view, 0)->path);
        ck_assert_int_eq(rn_image_legacy_pyramid(&full, 4, levels, &err), RN_OK);
        for (int scale = 0; scale < 4; scale++) {
            const struct rn_frame *frame = rn_dataset_frame(made, RN_SPLIT_TRAIN, view, scale);
            struct rn_image stored = read_image(frame->path);
            assert_same_pixels(&stored, &levels[scale]);
            rn_image_finish(&stored);
            rn_image_finish(&levels[scale]);
        }
        rn_image_finish(&full);
    }
}
END_TEST

START_TEST(legacy_scales_want_divisible_sizes) {
    options.scales = 5; // 24 / 16
    options.downscale = RN_DOWNSCALE_STRAIGHT;
    ck_assert_int_eq(import("out"), RN_ERROR_INVALID);
    ck_assert(strstr(err.where, "source/train/r_") != NULL);
    ck_assert(access(in_folder("out/dataset.json"), F_OK) != 0);
}
END_TEST

START_TEST(every_nth_training_view) {
    options.test_every = 2;
    import_ok("out");
    ck_assert_int_eq(made->view_count[RN_SPLIT_TEST], 3); // 0, 2, 4
    ck_assert_int_eq(made->view_count[RN_SPLIT_TRAIN], 2);
    ck_assert_str_eq(rn_dataset_frame(made, RN_SPLIT_TEST, 1, 0)->name, "r_2");
    ck_assert_str_eq(rn_dataset_frame(made, RN_SPLIT_TRAIN, 3, 0)->name, "r_3");
    ck_assert_ptr_null(rn_dataset_frame(made, RN_SPLIT_TRAIN, 2, 0));
    // A dataset with a test split keeps it.
    rn_dataset_destroy(&dataset);
    read_ok(in_folder("out"));
    options.test_every = 3;
    import_ok("again");
    ck_assert_int_eq(made->view_count[RN_SPLIT_TEST], 3);
    ck_assert_int_eq(made->view_count[RN_SPLIT_TRAIN], 2);
}
END_TEST

START_TEST(scaled_again) {
    options.scales = 3;
    import_ok("out");
    rn_dataset_destroy(&dataset);
    read_ok(in_folder("out"));
    options.scales = 1; // keeps the three
    options.max_size = 16;
    import_ok("again");
    ck_assert_int_eq(made->scale_count, 3);
    ck_assert_uint_eq(made->frame_count, 3 * VIEWS);
    const struct rn_frame *frame = rn_dataset_frame(made, RN_SPLIT_TRAIN, 4, 2);
    ck_assert_int_eq(frame->camera.width, 4);
    ck_assert_int_eq(frame->camera.height, 3);
    ck_assert_double_eq(frame->loss_weight, 16);
    options.scales = 2; // made anew from the full-size images
    import_ok("anew");
    ck_assert_int_eq(made->scale_count, 2);
    ck_assert_uint_eq(made->frame_count, 2 * VIEWS);
}
END_TEST

// The photographs' own files, of those that are JPEGs and as large as they are wanted.
START_TEST(jpeg_is_kept) {
    uint8_t *sent, *kept;
    size_t sent_size, kept_size;
    struct rn_image image = noise(32, 24, 9);
    ck_assert_int_eq(rn_image_encode_jpeg(&image, 90, &sent, &sent_size, &err), RN_OK);
    rn_image_finish(&image);
    for (int i = 0; i < VIEWS - 1; i++) {
        char name[64];
        snprintf(name, sizeof name, "source/train/r_%d.png", i); // the content decides
        put_bytes(name, sent, sent_size);
    }
    dataset->frames[0].turn = 3;
    options.scales = 2;
    import_ok("out");
    for (size_t i = 0; i < made->frame_count; i++) {
        const struct rn_frame *frame = &made->frames[i];
        bool is_kept = frame->scale == 0 && frame->index > 0 && frame->index < VIEWS - 1;
        ck_assert_str_eq(strrchr(frame->path, '.'), is_kept ? ".jpg" : ".png");
        if (!is_kept) continue;
        ck_assert_int_eq(rn_file_read(frame->path, 1 << 20, &kept, &kept_size, &err), RN_OK);
        ck_assert_uint_eq(kept_size, sent_size);
        ck_assert_mem_eq(kept, sent, sent_size);
        free(kept);
    }
    free(sent);
    struct rn_image turned = read_image(rn_dataset_frame(made, RN_SPLIT_TRAIN, 0, 0)->path),
                    upright = read_image(rn_dataset_frame(made, RN_SPLIT_TRAIN, 1, 0)->path);
    ck_assert_mem_eq(turned.pixels, upright.pixels + 4 * (32 * 24 - 1), 4);
    rn_image_finish(&turned);
    rn_image_finish(&upright);
    options.max_size = 20; // of a smaller size none is
    options.scales = 1;
    import_ok("small");
    ck_assert_str_eq(strrchr(made->frames[1].path, '.'), ".png");
}
END_TEST

// Writes the photographs anew, without alpha: noise of brightness 64 and more within bars, of
// `lone`
// (-1: none) without any, and reads them.
static void put_barred(const int bars[4], int brightest, int lone) {
    for (int i = 0; i < VIEWS; i++) {
        char name[64];
        snprintf(name, sizeof name, "source/train/r_%d.png", i);
        struct rn_image image = noise(32, 24, (uint64_t)i);
        image.has_alpha = false;
        for (int at = 0; at < 32 * 24; at++) {
            int x = at % 32, y = at / 32;
            bool within = x >= bars[0] && y >= bars[1] && x < 32 - bars[2] && y < 24 - bars[3];
            uint8_t *pixel = image.pixels + (size_t)at * 4;
            for (int c = 0; c < 3; c++)
                pixel[c] =
                    (uint8_t)(within || i == lone ? brightest / 4 + pixel[c] * brightest / 340
                                                  : (x + y) % 4);
        }
        ck_assert_int_eq(rn_image_write_png(&image, in_folder(name), 3, &err), RN_OK);
        rn_image_finish(&image);
    }
    rn_dataset_destroy(&dataset);
    read_ok(in_folder("source"));
}

static bool tells(const char *text) {
    for (size_t i = 0; i < problems.count; i++)
        if (strstr(problems.items[i].text, text)) return true;
    return false;
}

// Of cameras, pixels, and where points are seen, which stay where they are in the scene.
START_TEST(black_bars_are_cut_off) {
    put_barred((const int[]){2, 1, 0, 5}, 255, -1);
    struct rn_camera before = dataset->frames[0].camera;
    dataset->points.sightings = calloc(1, sizeof *dataset->points.sightings);
    dataset->points.sightings[0] = (struct rn_sighting){.x = 0.5f, .y = 0.5f};
    dataset->points.sighting_count = 1;
    rn_dataset_cut_bars(dataset, &problems);
    ck_assert(tells("pixels: 2 at the left, 1 at the top, 5 at the bottom"));
    ck_assert_float_eq_tol(dataset->points.sightings[0].x, 14.0f / 30, 1e-6f);
    ck_assert_float_eq_tol(dataset->points.sightings[0].y, 11.0f / 18, 1e-6f);
    dataset->points.sighting_count = 0;
    import_warned("out"); // which finds no more
    for (size_t i = 0; i < VIEWS; i++) {
        const struct rn_camera *camera = &made->frames[i].camera;
        ck_assert(camera->width == 30 && camera->height == 18 && camera->fx == before.fx);
        ck_assert(camera->cx == before.cx - 2 && camera->cy == before.cy - 1);
        struct rn_image from = read_image(dataset->frames[i].path),
                        to = read_image(made->frames[i].path);
        ck_assert(to.width == 30 && to.height == 18);
        for (size_t y = 0; y < 18; y++)
            ck_assert_mem_eq(to.pixels + 4 * 30 * y, from.pixels + 4 * (32 * (y + 1) + 2), 4 * 30);
        rn_image_finish(&from);
        rn_image_finish(&to);
    }
}
END_TEST

static const struct {
    int bars[4], brightest, lone;
} unbarred[] = {{{0, 0, 0, 0}, 255, -1},  // none
                {{2, 1, 0, 5}, 255, 3},   // in all but one
                {{2, 1, 0, 5}, 24, -1},   // what is dark may be no bar
                {{0, 9, 0, 8}, 255, -1}}; // and what has most of a photograph neither

START_TEST(what_is_no_bar_stays) {
    put_barred(unbarred[_i].bars, unbarred[_i].brightest, unbarred[_i].lone);
    import_warned("out");
    ck_assert_int_eq(made->frames[0].camera.width, 32);
    ck_assert_int_eq(made->frames[0].camera.height, 24);
    ck_assert(!tells("black bars"));
}
END_TEST

START_TEST(given_bounds) {
    struct rn_read_options how = {.bounds = {.centre = {1, 2, 3}, .radius = 0.1}};
    rn_dataset_destroy(&dataset);
    ck_assert_int_eq(rn_dataset_read_as(in_folder("source"), &how, NULL, &dataset, &err), RN_OK);
    import_ok("out");
    ck_assert_int_eq(made->bounds.source, RN_BOUNDS_GIVEN);
    ck_assert_double_eq(made->bounds.radius, 0.1);
    ck_assert_double_eq(made->bounds.centre[2], 3);
}
END_TEST

START_TEST(threads_do_not_show) {
    options.scales = 2;
    import_ok("one");
    options.threads = 1;
    import_ok("two");
    uint8_t *a, *b;
    size_t a_size, b_size;
    ck_assert_int_eq(rn_file_read(in_folder("one/dataset.json"), 1 << 20, &a, &a_size, &err),
                     RN_OK);
    ck_assert_int_eq(rn_file_read(in_folder("two/dataset.json"), 1 << 20, &b, &b_size, &err),
                     RN_OK);
    ck_assert_uint_eq(a_size, b_size);
    ck_assert_mem_eq(a, b, a_size);
    free(a);
    free(b);
}
END_TEST

START_TEST(damaged_image_is_left_out) {
    truncate_file("source/train/r_1.png", 1500);
    ck_assert_int_eq(import("out"), RN_OK);
    ck_assert_uint_eq(problems.errors, 1);
    ck_assert_msg(strstr(problems.items[problems.count - 1].where, "r_1.png") != NULL, "%s",
                  problems.items[problems.count - 1].where);
    ck_assert_int_eq(rn_dataset_read(in_folder("out"), &problems, &made, &err), RN_OK);
    ck_assert_uint_eq(made->frame_count, VIEWS - 1);
    ck_assert_ptr_null(rn_dataset_frame(made, RN_SPLIT_TRAIN, 1, 0));
    ck_assert_ptr_null(rn_dataset_frame(dataset, RN_SPLIT_TRAIN, 1, 0));
    ck_assert_int_eq(dataset->unusable[RN_SPLIT_TRAIN], 1);
    ck_assert_int_eq(dataset->view_count[RN_SPLIT_TRAIN], VIEWS - 1);
    for (int i = 0; i < VIEWS; i++) {
        char name[64];
        snprintf(name, sizeof name, "source/train/r_%d.png", i);
        if (i != 1) truncate_file(name, 1500);
    }
    ck_assert_int_eq(import("none"), RN_ERROR_INVALID);
    ck_assert(strstr(err.text, "no usable training view") != NULL);
    ck_assert(access(in_folder("none/dataset.json"), F_OK) != 0);
}
END_TEST

static bool count_to_two(void *context, size_t done, size_t total) {
    size_t *calls = context;
    ck_assert_uint_eq(done, ++*calls);
    ck_assert_uint_eq(total, VIEWS);
    return done < 2;
}

START_TEST(cancelled) {
    size_t calls = 0;
    ck_assert_int_eq(rn_dataset_import(dataset, "n", &options, in_folder("out"), &problems,
                                       count_to_two, &calls, &err),
                     RN_ERROR_CANCELLED);
    ck_assert_uint_eq(calls, 2);
    ck_assert(access(in_folder("out/dataset.json"), F_OK) != 0);
}
END_TEST

// A file-size limit stands in for a full disk.
START_TEST(writes_fail) {
    signal(SIGXFSZ, SIG_IGN);
    struct rlimit limit = {.rlim_cur = 100, .rlim_max = 100};
    ck_assert_int_eq(setrlimit(RLIMIT_FSIZE, &limit), 0);
    enum rn_status status = import("out");
    ck_assert_msg(status == RN_ERROR_NO_SPACE, "%s", rn_status_name(status));
    ck_assert(strstr(err.where, "/out/images/") != NULL);
    ck_assert(access(in_folder("out/dataset.json"), F_OK) != 0);
    ck_assert_uint_eq(problems.errors, 0);
}
END_TEST

START_TEST(target_in_use) {
    put_text("out/file", "x");
    ck_assert_int_eq(import("out"), RN_ERROR_CONFLICT);
    ck_assert_str_eq(err.where, in_folder("out"));
    ck_assert_int_eq(import("out/file"), RN_ERROR_IO);
}
END_TEST

START_TEST(bad_options) {
    struct rn_import_options good = options;
    options.scales = 0;
    ck_assert_int_eq(import("out"), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "scales");
    options.scales = 7; // 24 / 64 rounds to 0
    ck_assert_int_eq(import("out"), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "scales");
    options = good;
    options.max_size = -1;
    ck_assert_int_eq(import("out"), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "max_size");
    options = good;
    options.test_every = 1;
    ck_assert_int_eq(import("out"), RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "split");
    ck_assert(access(in_folder("out"), F_OK) != 0);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("import");
    TCase *tests = tcase_create("import");
    tcase_add_checked_fixture(tests, setup_source, teardown_source);
    tcase_add_test(tests, as_it_is);
    tcase_add_test(tests, smaller_and_scaled);
    tcase_add_test(tests, legacy_scales);
    tcase_add_test(tests, legacy_scales_want_divisible_sizes);
    tcase_add_test(tests, every_nth_training_view);
    tcase_add_test(tests, scaled_again);
    tcase_add_test(tests, jpeg_is_kept);
    tcase_add_test(tests, black_bars_are_cut_off);
    tcase_add_loop_test(tests, what_is_no_bar_stays, 0, (int)(sizeof unbarred / sizeof *unbarred));
    tcase_add_test(tests, given_bounds);
    tcase_add_test(tests, threads_do_not_show);
    tcase_add_test(tests, damaged_image_is_left_out);
    tcase_add_test(tests, cancelled);
    tcase_add_test(tests, writes_fail);
    tcase_add_test(tests, target_in_use);
    tcase_add_test(tests, bad_options);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
