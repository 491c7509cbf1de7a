// Photographs of more pixels than the time given has rays for, or than memory is to hold.
#include <malloc.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "tests/ops/train_scene.h"

// ---- the scale ------------------------------------------------------------------------------

static int scale_for(int count, int width, int height, int scales,
                     const struct rn_train_config *config) {
    struct rn_frame frames[1000];
    struct rn_dataset d = {.frames = frames, .frame_count = (size_t)count, .scale_count = scales};
    memset(frames, 0, sizeof frames);
    for (int i = 0; i < count; i++)
        frames[i].camera = (struct rn_camera){.width = width, .height = height};
    return rn_train_scale(&d, config);
}

static struct rn_train_config preset(const char *name, double seconds) {
    struct rn_train_config config;
    struct rn_error err;
    ck_assert(rn_preset(name, false, &config, &err) == RN_OK);
    config.max_seconds = seconds;
    return config;
}

// What was measured to be trained best as it is, stays; large photographs become finer with time.
START_TEST(the_scale_follows_the_time) {
    static const struct {
        int count, width, height;
        double seconds;
        int scale;
    } cases[] = {
        {100, 400, 400, 15, 1},      {100, 800, 800, 15, 1},       {100, 800, 800, 60, 1},
        {17, 504, 378, 15, 1},       {43, 270, 480, 15, 1},        {118, 800, 600, 15, 1},
        {43, 1080, 1920, 15, 4},     {43, 1080, 1920, 60, 2},      {43, 1080, 1920, 200, 1},
        {1000, 4000, 3000, 60, 8},   {1000, 4000, 3000, 600, 8},   {1000, 4000, 3000, 3600, 4},
        {1000, 4000, 3000, 7200, 2}, {1000, 4000, 3000, 36000, 1},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct rn_train_config config = preset("standard", cases[i].seconds);
        int scale = scale_for(cases[i].count, cases[i].width, cases[i].height, 1, &config);
        ck_assert_msg(scale == cases[i].scale, "%d of %dx%d in %.0f s: %d, not %d", cases[i].count,
                      cases[i].width, cases[i].height, cases[i].seconds, scale, cases[i].scale);
    }
}
END_TEST

START_TEST(the_scale_can_be_asked_for) {
    struct rn_train_config config = preset("standard", 15);
    ck_assert_int_eq(scale_for(43, 1080, 1920, 3, &config), 1); // coarser scales are there already
    config.effect[RN_EFFECT_DOWNSCALING] = RN_EFFECT_UNWANTED;
    ck_assert_int_eq(scale_for(43, 1080, 1920, 1, &config), 1);
    config.effect[RN_EFFECT_DOWNSCALING] = RN_EFFECT_WANTED;
    ck_assert_int_eq(scale_for(43, 270, 480, 1, &config), 2);
    config = preset("standard", 15);
    config.train_scale = 8;
    ck_assert_int_eq(scale_for(43, 1080, 1920, 1, &config), 8);
    config = preset("standard", 0);
    ck_assert_int_eq(scale_for(43, 1080, 1920, 1, &config), 1); // no limit
    config.max_steps = 1000;                                    // 9 s of two cores
    ck_assert_int_eq(scale_for(43, 1080, 1920, 1, &config), 4);
    config = preset("paper", 15);
    ck_assert_int_eq(scale_for(43, 1080, 1920, 1, &config), 1);
}
END_TEST

static void sha256_after(const struct rn_dataset *d, const struct rn_train_config *config,
                         int threads, const char *keep_in, char ret_sha256[65]) {
    struct rn_engine *engine = engine_with(threads);
    rn_engine_keep_in(engine, keep_in);
    struct rn_trainer *trainer = trainer_for(engine, d, config);
    ck_assert_int_eq(trainer->train.paged.bytes != NULL, keep_in != NULL);
    run_to_end(trainer);
    rn_field_sha256(trainer->field, ret_sha256);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
}

// Made smaller here, photographs are those that an import makes smaller: pixels and cameras.
START_TEST(as_if_imported_smaller) {
    struct rn_error err = {0};
    struct rn_dataset *smaller;
    struct rn_import_options import = {.scales = 1, .threads = 2, .max_size = 24};
    struct rn_train_config config = config_for(dataset);
    char target[128], there[65], here[65];
    snprintf(target, sizeof target, "%s/smaller", folder);
    ck_assert(rn_mkdirs(target, 0755, &err) == RN_OK);
    ck_assert_msg(rn_dataset_import(dataset, "smaller", &import, target, NULL, NULL, NULL, &err) ==
                      RN_OK,
                  "%s", err.text);
    ck_assert_msg(rn_dataset_read(target, NULL, &smaller, &err) == RN_OK, "%s", err.text);
    sha256_after(smaller, &config, 1, NULL, there);
    config.train_scale = 2;
    sha256_after(dataset, &config, 2, NULL, here);
    ck_assert_str_eq(here, there);
    rn_dataset_destroy(&smaller);
}
END_TEST

// A training at a scale that goes on from a checkpoint has the same photographs.
START_TEST(a_resumed_training_keeps_its_scale) {
    struct rn_error err;
    struct rn_train_config config = config_for(dataset);
    struct rn_engine *engine = engine_with(1);
    char path[128];
    config.train_scale = 4;
    struct rn_trainer *trainer = trainer_for(engine, dataset, &config), *resumed;
    snprintf(path, sizeof path, "%s/scale.ck", folder);
    ck_assert_msg(rn_trainer_save(trainer, path, &err) == RN_OK, "%s", err.text);
    ck_assert_msg(rn_trainer_restore(engine, dataset, path, 0, &resumed, &err) == RN_OK, "%s",
                  err.text);
    ck_assert_int_eq(resumed->train.frames[0].camera.width, 12);
    ck_assert_uint_eq(resumed->train.pixel_count, trainer->train.pixel_count);
    ck_assert(memcmp(resumed->train.rgba, trainer->train.rgba, 4 * trainer->train.pixel_count) ==
              0);
    ck_assert(resumed->field->effects[RN_EFFECT_DOWNSCALING].on);
    ck_assert_ptr_nonnull(strstr(rn_trainer_held_out(resumed), "at 1/4 of their size"));
    rn_trainer_destroy(&trainer);
    rn_trainer_destroy(&resumed);
    rn_engine_destroy(&engine);
}
END_TEST

// Masks of photographs that are made smaller: three pixels in a row of 5 by 3, at 2 by 2.
START_TEST(masks_are_made_smaller_too) {
    struct rn_error err = {0};
    struct rn_image photo, mask;
    char photo_path[128], mask_path[128];
    snprintf(photo_path, sizeof photo_path, "%s/photo.png", folder);
    snprintf(mask_path, sizeof mask_path, "%s/mask.png", folder);
    ck_assert(rn_image_init(5, 3, &photo, &err) == RN_OK &&
              rn_image_init(5, 3, &mask, &err) == RN_OK);
    memset(photo.pixels, 255, 4 * 15);
    memset(mask.pixels, 255, 4 * 15);
    memset(mask.pixels + 4 * 4, 0, 3); // the last of the first row
    ck_assert(rn_image_write_png(&photo, photo_path, 1, &err) == RN_OK);
    ck_assert(rn_image_write_png(&mask, mask_path, 1, &err) == RN_OK);
    struct rn_frame frames[2] = {dataset->frames[0], dataset->frames[1]};
    struct rn_dataset masked = *dataset;
    masked.frames = frames;
    masked.frame_count = 2;
    for (int i = 0; i < 2; i++) {
        frames[i].camera = rn_camera_resized(&frames[i].camera, 5, 3);
        frames[i].path = photo_path;
        frames[i].mask_path = i == 0 ? mask_path : NULL;
    }
    struct rn_train_config config = config_for(&masked);
    config.train_scale =
        2; // 5 x 3 become 3 x 2: the last pixel of a row takes a part of the fourth
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *trainer = trainer_for(engine, &masked, &config);
    ck_assert_uint_eq(trainer->train.pixel_count, 12);
    for (size_t i = 0; i < 12; i++)
        ck_assert_int_eq(trainer->train.used[i], i != 2);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
    rn_image_finish(&photo);
    rn_image_finish(&mask);
}
END_TEST

// JPEG photographs are made smaller in part while they are decoded: to means of what they show.
START_TEST(jpegs_are_decoded_smaller) {
    struct rn_error err = {0};
    struct rn_image photo, whole, mean;
    struct rn_frame frames[2] = {dataset->frames[0], dataset->frames[1]};
    struct rn_dataset jpegs = *dataset;
    char path[128];
    uint8_t *bytes;
    size_t size;
    snprintf(path, sizeof path, "%s/photo.jpg", folder);
    ck_assert(rn_image_init(48, 32, &photo, &err) == RN_OK);
    for (int i = 0; i < 4 * 48 * 32; i++)
        photo.pixels[i] = i % 4 == 3 ? 255 : (uint8_t)(60 + (i * 5 + i / 192 * 37) % 131);
    ck_assert(rn_image_encode_jpeg(&photo, 95, &bytes, &size, &err) == RN_OK);
    ck_assert(rn_file_write_atomic(path, bytes, size, &err) == RN_OK);
    ck_assert(rn_image_read(path, NULL, &whole, &err) == RN_OK);
    ck_assert(rn_image_downscale(&whole, 3, 2, RN_DOWNSCALE_PREMULTIPLIED, &mean, &err) == RN_OK);
    jpegs.frames = frames;
    jpegs.frame_count = 2;
    for (int i = 0; i < 2; i++) {
        frames[i].camera = rn_camera_resized(&frames[i].camera, 48, 32);
        frames[i].path = path;
    }
    struct rn_train_config config = config_for(&jpegs);
    config.train_scale = 16; // an eighth while it is decoded, and a half of that
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *trainer = trainer_for(engine, &jpegs, &config);
    ck_assert_uint_eq(trainer->train.pixel_count, 2 * 3 * 2);
    for (size_t i = 0; i < (size_t)4 * 12; i++)
        ck_assert_int_le(abs(trainer->train.rgba[i] - mean.pixels[i % 24]), 2);
    rn_trainer_destroy(&trainer);
    frames[1].camera = rn_camera_resized(&frames[1].camera, 96, 64);
    ck_assert_int_eq(rn_trainer_create(engine, &jpegs, &config, 0, &trainer, &err),
                     RN_ERROR_CORRUPT);
    ck_assert_ptr_nonnull(strstr(err.text, "is 48x32 but the dataset says 96x64"));
    rn_engine_destroy(&engine);
    rn_image_finish(&photo);
    rn_image_finish(&whole);
    rn_image_finish(&mean);
    free(bytes);
}
END_TEST

// ---- on disk --------------------------------------------------------------------------------

#define SIDE 1536 // 9.4 MB a photograph, 20 of which are loaded: 189 MB

// The dataset with photographs that large, all of one picture.
static struct rn_dataset make_large(struct rn_frame *frames, char *path) {
    struct rn_error err = {0};
    struct rn_image image;
    struct rn_dataset large = *dataset;
    ck_assert(rn_image_init(SIDE, SIDE, &image, &err) == RN_OK);
    for (int i = 0; i < SIDE * SIDE; i++) {
        int x = i % SIDE - SIDE / 2, y = i / SIDE - SIDE / 2;
        bool inside = x * x + y * y < SIDE * SIDE / 16;
        const uint8_t rgba[4] = {(uint8_t)(x >> 6 << 4), (uint8_t)(y >> 6 << 4), 128, 255};
        if (inside) memcpy(image.pixels + 4 * i, rgba, 4);
    }
    ck_assert(rn_image_write_png(&image, path, 1, &err) == RN_OK);
    rn_image_finish(&image);
    large.frames = frames;
    for (size_t i = 0; i < large.frame_count; i++) {
        frames[i] = dataset->frames[i];
        frames[i].path = path;
        frames[i].camera = rn_camera_resized(&frames[i].camera, SIDE, SIDE);
    }
    return large;
}

static long peak_kib(void) {
    char line[256];
    long peak = 0;
    FILE *file = fopen("/proc/self/status", "r");
    ck_assert_ptr_nonnull(file);
    while (fgets(line, sizeof line, file))
        if (sscanf(line, "VmHWM: %ld", &peak) == 1) break;
    fclose(file);
    return peak;
}

// 189 MB of pixels of which 16 are to be in memory: the same bytes as if all were, for one thread
// and two, and the process is never as large as they.
START_TEST(more_than_memory_is_to_hold) {
    static struct rn_frame frames[64];
    char path[128], kept[65], kept_by_two[65], in_memory[65];
    ck_assert_uint_le(dataset->frame_count, 64);
    snprintf(path, sizeof path, "%s/large.png", folder);
    struct rn_dataset large = make_large(frames, path);
    struct rn_train_config config = config_for(&large);
    config.max_steps = 4;
    config.train_scale = 1;
    config.pixel_memory = 16;
    sha256_after(&large, &config, 1, folder, kept);
    sha256_after(&large, &config, 2, folder, kept_by_two);
    long with = peak_kib();
    sha256_after(&large, &config, 2, NULL, in_memory);
    long without = peak_kib();
    printf("peak with 16 MiB of pixels in memory: %ld MiB, with all: %ld MiB\n", with >> 10,
           without >> 10);
    ck_assert_str_eq(kept, in_memory);
    ck_assert_str_eq(kept_by_two, in_memory);
    ck_assert_int_lt(with, 160 << 10);
    ck_assert_int_gt(without, 189 << 10);
}
END_TEST

// A number of /proc/self/status, by its line: "RssFile: %ld".
static long status_kib(const char *line_of) {
    char line[256];
    long kib = -1;
    FILE *file = fopen("/proc/self/status", "r");
    ck_assert_ptr_nonnull(file);
    while (fgets(line, sizeof line, file))
        if (sscanf(line, line_of, &kib) == 1) break;
    fclose(file);
    ck_assert_int_ge(kib, 0);
    return kib;
}

static long file_kib(void) {
    return status_kib("RssFile: %ld");
}

#define HELD_MIB 4L

// Of the pixels no more than may be are in memory after a pass over them, but for a photograph
// and its mask.
static void holds_little(const char *pass, long before) {
    long held = file_kib() - before, most = (HELD_MIB << 10) + 5L * SIDE * SIDE / 1024;
    printf("%s: %ld MiB of pixels in memory\n", pass, held >> 10);
    ck_assert_msg(held <= most, "%s leaves %ld KiB of pixels in memory, over %ld", pass, held,
                  most);
}

static struct rn_frame large_frames[64];
static char large_path[128], mask_path[128];

// A training of such photographs, with a mask, of which so much is to be in memory.
static struct rn_trainer *train_on_large(struct rn_engine *engine, struct rn_dataset *large,
                                         long *ret_before) {
    snprintf(large_path, sizeof large_path, "%s/large.png", folder);
    *large = make_large(large_frames, large_path);
    struct rn_image mask;
    struct rn_error err = {0};
    snprintf(mask_path, sizeof mask_path, "%s/mask.png", folder);
    ck_assert(rn_image_init(SIDE, SIDE, &mask, &err) == RN_OK);
    memset(mask.pixels, 255, (size_t)4 * SIDE * SIDE);
    ck_assert(rn_image_write_png(&mask, mask_path, 1, &err) == RN_OK);
    rn_image_finish(&mask);
    for (size_t i = 0; i < large->frame_count; i++)
        large_frames[i].mask_path = mask_path;
    struct rn_train_config config = config_for(large);
    config.train_scale = 1;
    config.pixel_memory = HELD_MIB;
    config.initial_rays = 8192;
    rn_engine_keep_in(engine, folder);
    *ret_before = file_kib();
    struct rn_trainer *trainer = trainer_for(engine, large, &config);
    ck_assert_ptr_nonnull(trainer->train.paged.bytes);
    return trainer;
}

// Whatever looks at all photographs gives their pages back on its way.
START_TEST(passes_give_pages_back) {
    struct rn_error err = {0};
    struct rn_engine *engine = engine_with(1);
    struct rn_dataset large;
    struct rn_point point = {0};
    struct rn_sighting sighting = {0};
    long before;
    bool busy = true;
    struct rn_trainer *t = train_on_large(engine, &large, &before);
    holds_little("creation", before);
    t->field->config.field.space = RN_SPACE_UNBOUNDED; // all blocks are looked at
    ck_assert_ptr_nonnull(t->train.used);
    ck_assert(rn_trainer_list_live(t, &err) == RN_OK);
    t->field->config.field.space = RN_SPACE_BALL;
    holds_little("the list of live blocks", before);
    large.points = (struct rn_points){&point, 1, &sighting, 1, false};
    rn_trainer_carve_sighted(t);
    holds_little("what photographs see through", before);
    rn_trainer_begin_step(t);
    rn_trainer_draw(t, 0, t->step.ray_count);
    t->step.under_way = false;
    holds_little("the rays of a step", before);
    while (busy)
        ck_assert(rn_trainer_seek_outliers(t, &busy, &err) == RN_OK);
    holds_little("outliers", before);
    struct rn_effect_record *poses = &t->field->effects[RN_EFFECT_POSE_REFINEMENT];
    poses->decided = poses->on = true; // all are looked at
    ck_assert(rn_trainer_allocate_poses(t, &err) == RN_OK);
    ck_assert(rn_trainer_refine_poses(t, &busy, &err) == RN_OK);
    holds_little("refined poses", before);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

static bool all_frames(void *context, const struct rn_frame *frame) {
    (void)context;
    (void)frame;
    return true;
}

// Ten photographs and their halves.
START_TEST(scales_give_pages_back) {
    static struct rn_frame frames[20];
    struct rn_error err = {0};
    struct rn_image photo, half;
    struct rn_engine *engine = engine_with(1);
    struct rn_pixels pixels;
    struct rn_pixel_treatment treatment = {.reduced = 1, .memory_bytes = HELD_MIB << 20};
    char half_path[128];
    snprintf(large_path, sizeof large_path, "%s/large.png", folder);
    snprintf(half_path, sizeof half_path, "%s/half.png", folder);
    struct rn_dataset large = make_large(large_frames, large_path);
    ck_assert(rn_image_read(large_path, NULL, &photo, &err) == RN_OK);
    ck_assert(rn_image_downscale(&photo, SIDE / 2, SIDE / 2, RN_DOWNSCALE_PREMULTIPLIED, &half,
                                 &err) == RN_OK);
    ck_assert(rn_image_write_png(&half, half_path, 1, &err) == RN_OK);
    for (int i = 0; i < 20; i++) {
        frames[i] = large_frames[i / 2];
        if (i % 2 == 0) continue;
        frames[i].scale = 1;
        frames[i].path = half_path;
        frames[i].camera = rn_camera_resized(&frames[i].camera, SIDE / 2, SIDE / 2);
    }
    large.frames = frames;
    large.frame_count = 20;
    rn_engine_keep_in(engine, folder);
    long before = file_kib();
    ck_assert_msg(rn_pixels_load(&large, all_frames, NULL, engine, treatment, 0, &pixels, &err) ==
                      RN_OK,
                  "%s", err.text);
    ck_assert(rn_pixels_scale_error(&pixels, 10) < 0.01);
    holds_little("how far scales are from means", before);
    rn_pixels_remake_scales(&pixels, engine);
    holds_little("scales made anew", before);
    rn_pixels_finish(&pixels);
    rn_image_finish(&photo);
    rn_image_finish(&half);
    rn_engine_destroy(&engine);
}
END_TEST

static double own_bytes(void) {
    return (double)status_kib("RssAnon: %ld") * 1024;
}

// What a training is said to need beside its pixels is what it takes at most, in blocks of pixels
// that are drawn by their errors, in planes of two sizes while they grow, and with outliers sought;
// and not much less. Memory that is given back is not taken: see the runner's main().
START_TEST(what_is_said_is_what_is_taken) {
    struct rn_error err = {0};
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = NULL;
    struct rn_progress progress = {0};
    ck_assert_int_eq(mallopt(M_PERTURB, 0), 1);
    ck_assert_int_eq(mallopt(M_MMAP_THRESHOLD, 1 << 20), 1);
    snprintf(large_path, sizeof large_path, "%s/large.png", folder);
    struct rn_dataset large = make_large(large_frames, large_path);
    struct rn_image image; // without alpha all blocks are live
    ck_assert(rn_image_init(SIDE, SIDE, &image, &err) == RN_OK);
    memset(image.pixels, 255, (size_t)4 * SIDE * SIDE);
    ck_assert(rn_image_write_png(&image, large_path, 1, &err) == RN_OK);
    rn_image_finish(&image);
    struct rn_train_config config = config_for(&large);
    config.train_scale = 1;
    config.pixel_memory = HELD_MIB;
    config.draw_by_error = config.favour_finest = true;
    config.field.base = 64;
    config.grow_to = 256;
    config.max_steps = 40;
    config.target_samples = 4096;
    rn_engine_keep_in(engine, folder);
    ck_assert_int_eq(rn_trainer_create(engine, &large, &config, 1 << 20, &t, &err), RN_ERROR_LIMIT);
    const char *needs = strstr(err.text, "needs ");
    ck_assert_ptr_nonnull(needs);
    double said = atof(needs + 6) * (1 << 20), before = own_bytes(), taken = 0;
    ck_assert_msg(rn_trainer_create(engine, &large, &config, (size_t)said + (2 << 20), &t, &err) ==
                      RN_OK,
                  "%s", err.text);
    ck_assert_ptr_nonnull(t->train.paged.bytes);
    ck_assert_uint_gt(t->sampler.importance.count, 400000);
    while (!progress.done) {
        ck_assert_msg(rn_trainer_advance(t, 0, &err) == RN_OK, "%s", err.text);
        rn_trainer_progress(t, &progress);
        taken = fmax(taken, own_bytes() - before);
    }
    ck_assert_int_eq(t->field->config.field.base, 256);
    printf("said %.1f MiB, taken %.1f\n", said / (1 << 20), taken / (1 << 20));
    ck_assert_double_le(taken, said);
    ck_assert_double_gt(taken, 0.6 * said);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// A folder that takes no such file is named.
START_TEST(where_there_is_no_place) {
    static struct rn_frame frames[64];
    struct rn_error err = {0};
    struct rn_trainer *trainer;
    char path[128];
    snprintf(path, sizeof path, "%s/large.png", folder);
    struct rn_dataset large = make_large(frames, path);
    struct rn_train_config config = config_for(&large);
    config.train_scale = 1;
    config.pixel_memory = 16;
    struct rn_engine *engine = engine_with(1);
    rn_engine_keep_in(engine, "/nonexistent");
    ck_assert_int_eq(rn_trainer_create(engine, &large, &config, 0, &trainer, &err), RN_ERROR_IO);
    ck_assert_str_eq(err.where, "/nonexistent");
    rn_engine_destroy(&engine);
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, the_scale_follows_the_time);
    tcase_add_test(tests, the_scale_can_be_asked_for);
    tcase_add_test(tests, as_if_imported_smaller);
    tcase_add_test(tests, a_resumed_training_keeps_its_scale);
    tcase_add_test(tests, masks_are_made_smaller_too);
    tcase_add_test(tests, jpegs_are_decoded_smaller);
    tcase_add_test(tests, more_than_memory_is_to_hold);
    tcase_add_test(tests, passes_give_pages_back);
    tcase_add_test(tests, scales_give_pages_back);
    tcase_add_test(tests, what_is_said_is_what_is_taken);
    tcase_add_test(tests, where_there_is_no_place);
}

int main(void) {
    return run_on_scene("large photographs", add);
}
