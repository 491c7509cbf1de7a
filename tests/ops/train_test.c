// Training as a whole: the same bytes whatever the threads, pauses, checkpoints and resumes; memory
// limits, damaged checkpoints and missing values are refused.
#include <errno.h>
#include <malloc.h>
#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "tests/ops/train_scene.h"

static void hash_of_run(const struct rn_dataset *d, int threads, char hex[65]) {
    struct rn_train_config config = config_for(d);
    struct rn_engine *engine = engine_with(threads);
    struct rn_trainer *trainer = trainer_for(engine, d, &config);
    run_to_end(trainer);
    rn_field_sha256(rn_trainer_field(trainer), hex);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
}

START_TEST(threads_do_not_change_bytes) {
    const struct rn_dataset *sets[2] = {dataset, scaled};
    for (int s = 0; s < 2; s++) {
        char one[65], other[65];
        hash_of_run(sets[s], 1, one);
        for (int threads = 2; threads <= 8; threads += threads == 3 ? 5 : 1) {
            hash_of_run(sets[s], threads, other);
            ck_assert_str_eq(one, other);
        }
    }
}
END_TEST

// Every advance is cut short as soon as may be: renders and validates within steps, now and then
// saves, and resumes three times from files.
static void interrupted_run(const struct rn_dataset *d, char hex[65]) {
    struct rn_error err;
    struct rn_train_config config = config_for(d);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *trainer = trainer_for(engine, d, &config);
    char path[128];
    snprintf(path, sizeof path, "%s/checkpoint.safetensors", folder);
    rn_engine_yield_to(engine, always, NULL);
    for (int i = 0, resumes = 0; !done(trainer); i++) {
        ck_assert(rn_trainer_advance(trainer, 1000, &err) == RN_OK);
        struct rn_render_options options = {.camera = d->frames[0].camera,
                                            .outputs = RN_OUTPUT_RGB | RN_OUTPUT_DEPTH};
        options.camera.world_from_camera[2][3] *= 30; // far away: needs more ripmap levels
        struct rn_render_result result;
        ck_assert(rn_render(engine, rn_trainer_field(trainer), &options, NULL, NULL, &result,
                            &err) == RN_OK);
        rn_render_result_finish(&result);
        bool finished;
        ck_assert(rn_trainer_validate(trainer, 1, &finished, &err) == RN_OK);
        if (i % 29 != 28) continue;
        ck_assert_msg(rn_trainer_save(trainer, path, &err) == RN_OK, "%s", err.text);
        if (resumes++ >= 3) continue;
        rn_trainer_destroy(&trainer);
        ck_assert_msg(rn_trainer_restore(engine, d, path, 0, &trainer, &err) == RN_OK, "%s",
                      err.text);
    }
    rn_field_sha256(rn_trainer_field(trainer), hex);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
}

// A field whose training needs no pyramid, with or without a render that does.
static void hash_of_flat_run(bool far, char hex[65]) {
    struct rn_error err;
    struct rn_train_config config = config_for(dataset);
    config.field.base = 16;
    config.grow_to = 0;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *trainer = trainer_for(engine, dataset, &config);
    ck_assert(rn_trainer_advance(trainer, 1, &err) == RN_OK);
    struct rn_render_options options = {.camera = dataset->frames[0].camera,
                                        .outputs = RN_OUTPUT_RGB};
    for (int i = 0; far && i < 3; i++)
        options.camera.world_from_camera[i][3] *= 30;
    struct rn_render_result result;
    ck_assert(rn_render(engine, rn_trainer_field(trainer), &options, NULL, NULL, &result, &err) ==
              RN_OK);
    rn_render_result_finish(&result);
    run_to_end(trainer);
    rn_field_sha256(rn_trainer_field(trainer), hex);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
}

START_TEST(far_renders_do_not_change_bytes) {
    char near[65], far[65];
    hash_of_flat_run(false, near);
    hash_of_flat_run(true, far);
    ck_assert_str_eq(near, far);
}
END_TEST

START_TEST(interruptions_do_not_change_bytes) {
    const struct rn_dataset *sets[2] = {dataset, scaled};
    for (int s = 0; s < 2; s++) {
        char whole[65], pieces[65];
        hash_of_run(sets[s], 2, whole);
        interrupted_run(sets[s], pieces);
        ck_assert_str_eq(whole, pieces);
    }
}
END_TEST

// A checkpoint holds how rays are drawn: by the errors of step 64 at step 70, by newer ones later.
START_TEST(draws_by_error_resume) {
    struct rn_error err;
    struct rn_train_config config = config_for(scaled);
    config.max_steps = 140;
    config.draw_by_error = true;
    char path[128], hex[3][65];
    snprintf(path, sizeof path, "%s/checkpoint.safetensors", folder);
    for (int i = 0; i < 3; i++) { // whole; in two parts; drawn evenly
        struct rn_engine *engine = engine_with(2);
        config.draw_by_error = i < 2;
        struct rn_trainer *trainer = trainer_for(engine, scaled, &config);
        struct rn_progress p = {.step = 0};
        while (i == 1 && p.step < 70) {
            ck_assert(rn_trainer_advance(trainer, 1, &err) == RN_OK);
            rn_trainer_progress(trainer, &p);
        }
        if (i == 1) {
            ck_assert_int_lt(p.step, 128);
            ck_assert_msg(rn_trainer_save(trainer, path, &err) == RN_OK, "%s", err.text);
            rn_trainer_destroy(&trainer);
            ck_assert_msg(rn_trainer_restore(engine, scaled, path, 0, &trainer, &err) == RN_OK,
                          "%s", err.text);
        }
        run_to_end(trainer);
        float most = 0;
        for (size_t b = 0; b < trainer->sampler.importance.count; b++)
            most = fmaxf(most, trainer->sampler.importance.share[b]);
        ck_assert(i < 2 ? most > 1.1f : most == 0); // errors were noted
        rn_field_sha256(rn_trainer_field(trainer), hex[i]);
        rn_trainer_destroy(&trainer);
        rn_engine_destroy(&engine);
    }
    ck_assert_str_eq(hex[0], hex[1]);
    ck_assert_str_ne(hex[0], hex[2]);
}
END_TEST

// All of space in the field's ball, asked for: cells, bent rays and what draws them together are in
// the checkpoint.
START_TEST(unbounded_space_resumes) {
    struct rn_error err;
    char path[128], hex[2][65];
    snprintf(path, sizeof path, "%s/bent.safetensors", folder);
    for (int i = 0; i < 2; i++) {
        struct rn_train_config config = config_for(dataset);
        config.auto_effects = false;
        config.field.space = RN_SPACE_UNBOUNDED;
        config.cone_step = false;
        config.distortion_loss = 0.02;
        config.occupancy_limit = 0.01;
        struct rn_engine *engine = engine_with(1 + i);
        struct rn_trainer *trainer = trainer_for(engine, dataset, &config);
        const struct rn_field *field = rn_trainer_field(trainer);
        ck_assert(field->bounds.radius != dataset->bounds.radius);
        ck_assert(field->effects[RN_EFFECT_UNBOUNDED].on);
        while (i == 1 && trainer->progress.step < 35)
            ck_assert(rn_trainer_advance(trainer, 1, &err) == RN_OK);
        if (i == 1) {
            double radius = field->bounds.radius;
            ck_assert_msg(rn_trainer_save(trainer, path, &err) == RN_OK, "%s", err.text);
            rn_trainer_destroy(&trainer);
            ck_assert_msg(rn_trainer_restore(engine, dataset, path, 0, &trainer, &err) == RN_OK,
                          "%s", err.text);
            field = rn_trainer_field(trainer);
            ck_assert_double_eq(field->bounds.radius, radius);
            ck_assert(field->effects[RN_EFFECT_UNBOUNDED].on);
        }
        run_to_end(trainer);
        ck_assert(trainer->step.march.distortion_loss > 0);
        rn_field_sha256(rn_trainer_field(trainer), hex[i]);
        rn_trainer_destroy(&trainer);
        rn_engine_destroy(&engine);
    }
    ck_assert_str_eq(hex[0], hex[1]);
}
END_TEST

// Alpha cuts out what is in the ball; without it what lies past the ball is in the photographs.
START_TEST(photographs_call_for_their_space) {
    struct rn_effect_record records[RN_EFFECT_COUNT];
    const struct rn_effect_record *r = &records[RN_EFFECT_UNBOUNDED];
    for (int i = 0; i < 4; i++) {
        struct rn_train_config config = config_for(dataset);
        config.target_samples = 32768; // the preset's
        config.max_seconds = i == 3 ? 120 : 60;
        struct rn_dataset as = *dataset;
        as.frames = calloc(as.frame_count, sizeof *as.frames);
        for (size_t f = 0; f < as.frame_count; f++) {
            as.frames[f] = dataset->frames[f];
            as.frames[f].has_alpha = i == 0;
        }
        as.bounds.source = i == 3 ? RN_BOUNDS_GIVEN : RN_BOUNDS_CAMERAS;
        if (i == 2) as.bounds.source = RN_BOUNDS_LAYOUT;
        if (i > 1) as.bounds.radius *= i == 2 ? 100 : 0.1; // all is in the ball; hardly anything
        struct rn_bounds bounds = rn_effects_prepare(&as, false, &config, records);
        bool on = i == 1 || i == 3;
        ck_assert(r->decided && r->on == on && (r->number > r->threshold) == on);
        ck_assert_ptr_nonnull(strstr(r->reason, i < 2 ? "quarter" : "dataset's ball"));
        ck_assert(config.field.space == (on ? RN_SPACE_UNBOUNDED : RN_SPACE_BALL));
        ck_assert_int_eq(config.target_samples, i == 1 ? 16384 : 32768);
        struct rn_march_options endless = {0}; // of a training without a limit
        rn_effects_march(&config, NAN, &endless);
        ck_assert((config.distortion_loss > 0) == on && (endless.distortion_loss > 0) == on);
        if (i != 1) ck_assert_double_eq(bounds.radius, as.bounds.radius);
        if (i == 1) ck_assert_double_eq(bounds.radius, rn_bounds_from_cameras(&as, 0.5).radius);
        free(as.frames);
    }
}
END_TEST

START_TEST(what_was_asked_for_stays_in_all_of_space) {
    struct rn_train_config config = config_for(dataset);
    struct rn_effect_record records[RN_EFFECT_COUNT];
    config.effect[RN_EFFECT_UNBOUNDED] = RN_EFFECT_WANTED;
    config.step = 0.007;
    config.stop = 0.5;
    config.occupancy_limit = 0.25;
    config.distortion_loss = 0.125;
    config.target_samples = 5000;
    rn_effects_prepare(dataset, false, &config, records);
    ck_assert(config.field.space == RN_SPACE_UNBOUNDED);
    ck_assert_double_eq(config.step, 0.007);
    ck_assert_double_eq(config.stop, 0.5);
    ck_assert_double_eq(config.occupancy_limit, 0.25);
    ck_assert_double_eq(config.distortion_loss, 0.125);
    ck_assert_int_eq(config.target_samples, 5000);
}
END_TEST

START_TEST(a_figure_does_not_depend_on_interruptions) {
    struct rn_train_config config = config_for(scaled);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *trainer = trainer_for(engine, scaled, &config);
    double whole = held_out_psnr(trainer);
    rn_engine_yield_to(engine, always, NULL);
    double pieces = held_out_psnr(trainer);
    ck_assert_double_eq(whole, pieces);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
}
END_TEST

// Saves and ends a training; returns the checkpoint's bytes, to be freed.
static uint8_t *saved_bytes(struct rn_trainer **trainer, const char *path, size_t *ret_size) {
    struct rn_error err;
    uint8_t *bytes;
    ck_assert(rn_trainer_save(*trainer, path, &err) == RN_OK);
    rn_trainer_destroy(trainer);
    ck_assert(rn_file_read(path, 1u << 30, &bytes, ret_size, &err) == RN_OK);
    return bytes;
}

// Before the C library's: while it is set, a disk that does not answer.
static bool seeking_fails;

off_t lseek(int fd, off_t at, int from) {
    if (!seeking_fails) return (off_t)syscall(SYS_lseek, fd, at, from);
    errno = EIO;
    return -1;
}

START_TEST(damaged_checkpoints_are_refused) {
    struct rn_error err;
    struct rn_train_config config = config_for(dataset);
    config.max_steps = 1;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *trainer = trainer_for(engine, dataset, &config);
    run_to_end(trainer);
    char path[128];
    snprintf(path, sizeof path, "%s/damaged.safetensors", folder);
    size_t size;
    uint8_t *bytes = saved_bytes(&trainer, path, &size);
    struct rn_field *field = NULL;
    seeking_fails = true; // which says nothing about the file
    ck_assert(rn_field_load(engine, path, &field, &err) == RN_ERROR_IO);
    seeking_fails = false;
    const size_t lengths[] = {0, 4, 100, size / 2, size - 1};
    for (size_t i = 0; i < sizeof lengths / sizeof *lengths; i++) {
        ck_assert(rn_file_write_atomic(path, bytes, lengths[i], &err) == RN_OK);
        ck_assert(rn_field_load(engine, path, &field, &err) == RN_ERROR_CORRUPT);
        ck_assert_ptr_nonnull(strstr(err.where, "damaged"));
    }
    uint64_t header;
    memcpy(&header, bytes, sizeof header);
    const float nan_value = NAN;
    memcpy(bytes + 8 + header + 400, &nan_value, sizeof nan_value); // a texel
    ck_assert(rn_file_write_atomic(path, bytes, size, &err) == RN_OK);
    ck_assert(rn_field_load(engine, path, &field, &err) == RN_ERROR_CORRUPT);
    ck_assert_ptr_nonnull(strstr(err.text, "non-finite"));
    ck_assert(rn_file_write_atomic(path, "hello", 5, &err) == RN_OK);
    ck_assert(rn_trainer_restore(engine, dataset, path, 0, &trainer, &err) == RN_ERROR_CORRUPT);
    free(bytes);
    rn_engine_destroy(&engine);
}
END_TEST

// A checkpoint of a build that did not know an option goes on without it.
START_TEST(earlier_checkpoints_lack_what_came_later) {
    static const char *const later[] = {"random_background", "smoothing", "split_pixels",
                                        "refine_at_rest"};
    struct rn_error err;
    struct rn_train_config config = config_for(dataset);
    config.max_steps = 2;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *trainer = trainer_for(engine, dataset, &config);
    char path[128];
    snprintf(path, sizeof path, "%s/earlier.safetensors", folder);
    size_t size;
    uint8_t *bytes = saved_bytes(&trainer, path, &size);
    for (size_t i = 0; i < sizeof later / sizeof *later; i++) {
        char *name = memmem(bytes, size, later[i], strlen(later[i]));
        ck_assert_ptr_nonnull(name);
        *name = 'x';
    }
    ck_assert(rn_file_write_atomic(path, bytes, size, &err) == RN_OK);
    ck_assert_msg(rn_trainer_restore(engine, dataset, path, 0, &trainer, &err) == RN_OK, "%s",
                  err.text);
    ck_assert_double_eq(rn_trainer_config(trainer)->random_background, 0);
    ck_assert_double_eq(rn_trainer_config(trainer)->smoothing, 0);
    ck_assert_double_eq(rn_trainer_config(trainer)->split_pixels, 0);
    ck_assert(!rn_trainer_config(trainer)->refine_at_rest);
    rn_trainer_destroy(&trainer);
    free(bytes);
    rn_engine_destroy(&engine);
}
END_TEST

static struct rn_engine *engine_of(const char *kernels) {
    struct rn_error err;
    struct rn_engine *engine;
    struct rn_engine_options options = {.threads = 1, .kernels = kernels};
    ck_assert(rn_engine_create(&options, &engine, &err) == RN_OK);
    return engine;
}

// Whatever set the engine was opened with, a resumed run takes the one that its checkpoint names,
// and is refused where there is none of that name.
START_TEST(a_resumed_run_keeps_its_kernels) {
    struct rn_error err;
    struct rn_train_config config = config_for(dataset);
    struct rn_device_info device;
    config.max_steps = 4;
    char path[128], whole[65], resumed[65];
    snprintf(path, sizeof path, "%s/kernels.safetensors", folder);

    struct rn_engine *engine = engine_of("generic");
    struct rn_trainer *trainer = trainer_for(engine, dataset, &config);
    ck_assert(rn_trainer_advance(trainer, 2, &err) == RN_OK);
    ck_assert(rn_trainer_save(trainer, path, &err) == RN_OK);
    run_to_end(trainer);
    rn_field_sha256(rn_trainer_field(trainer), whole);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);

    engine = engine_of(NULL); // the fastest: another one wherever there is any
    ck_assert_msg(rn_trainer_restore(engine, dataset, path, 0, &trainer, &err) == RN_OK, "%s",
                  err.text);
    rn_engine_describe(engine, &device);
    ck_assert_str_eq(device.kernels, "generic");
    run_to_end(trainer);
    rn_field_sha256(rn_trainer_field(trainer), resumed);
    ck_assert_str_eq(whole, resumed);

    size_t size;
    uint8_t *bytes = saved_bytes(&trainer, path, &size);
    char *name = memmem(bytes, size, "generic", 7);
    ck_assert_ptr_nonnull(name);
    *name = 'x';
    ck_assert(rn_file_write_atomic(path, bytes, size, &err) == RN_OK);
    ck_assert(rn_trainer_restore(engine, dataset, path, 0, &trainer, &err) == RN_ERROR_UNSUPPORTED);
    ck_assert_ptr_nonnull(strstr(err.text, "'xeneric'"));
    free(bytes);
    rn_engine_destroy(&engine);
}
END_TEST

// A clock that is a millisecond later whenever it is asked.
static atomic_llong milliseconds;
static int64_t hasty_ns(void) {
    return atomic_fetch_add(&milliseconds, 1) * 1000000;
}

// A time is a schedule: planes have grown and the rate has fallen by its end, and there it ends.
START_TEST(training_ends_with_its_time) {
    struct rn_error err;
    struct rn_train_config config = config_for(dataset);
    config.max_steps = 0;
    config.max_seconds = 0.5;
    rn_clock_set_source(hasty_ns, NULL);
    struct rn_engine *engine = engine_of("generic");
    struct rn_trainer *trainer = trainer_for(engine, dataset, &config);
    struct rn_progress progress;
    double rate = rn_schedule_rate(&trainer->field->config, &trainer->progress);
    rn_trainer_progress(trainer, &progress);
    ck_assert(progress.train_seconds == 0 && progress.load_seconds > 0); // it begins with a step
    ck_assert_int_eq(rn_trainer_config(trainer)->field.base, 32);
    for (progress.done = false; !progress.done;) {
        ck_assert(rn_trainer_advance(trainer, 1, &err) == RN_OK);
        rn_trainer_progress(trainer, &progress);
    }
    printf("%lld steps in %.3f s\n", (long long)progress.step, progress.train_seconds);
    ck_assert_double_ge(progress.train_seconds, 0.5);
    ck_assert_double_lt(progress.train_seconds, 0.55);
    ck_assert_int_gt(progress.step, 10);
    ck_assert_int_eq(rn_trainer_config(trainer)->field.base, 64);
    ck_assert_double_eq_tol(rn_schedule_rate(&trainer->field->config, &trainer->progress) / rate,
                            exp(-3), 1e-3);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
    rn_clock_set_source(NULL, NULL);
}
END_TEST

// Every part that a preset has beyond the paper is told with what it was measured to gain.
START_TEST(differences_from_the_paper_have_their_gains) {
    static const char *const presets[] = {"draft", "standard"};
    struct rn_error err;
    struct rn_train_config config;
    struct rn_difference items[64];
    for (int i = 0; i < 12; i++) {
        ck_assert(rn_preset(presets[i % 2], i / 2 % 2, &config, &err) == RN_OK);
        config.max_seconds = (double[]){15, 60, 120}[i / 4];
        rn_train_config_suit_time(&config);
        int count = rn_train_config_differences(&config, items, 64);
        ck_assert_int_gt(count, 10);
        ck_assert_int_le(count, 64);
        for (int k = 0; k < count; k++)
            ck_assert_msg(*items[k].measured, "%s: %s", presets[i % 2], items[k].what);
    }
    ck_assert(rn_preset("paper", false, &config, &err) == RN_OK);
    ck_assert_int_eq(rn_train_config_differences(&config, items, 64), 0);
}
END_TEST

// A weight of a network's first layer that is no number shows in the rays' colours.
static void check_nan_is_met(struct rn_trainer *t, size_t weight) {
    struct rn_incident incident;
    float *value = &t->field->parameters.values[t->field->parameters.plane_count + weight];
    float good = *value;
    *value = NAN;
    rn_field_refresh(t->field, t->engine);
    rn_trainer_note(t, RN_INCIDENT_REJECTED);
    ck_assert(rn_trainer_take_incident(t, &incident));
    ck_assert_msg(incident.rays[0].fault == RN_FAULT_COLOUR, "%s: weight %zu is not met",
                  t->engine->kernels->name, weight);
    *value = good;
}

START_TEST(nan_in_a_network_is_met_by_every_kernel_set) {
    struct rn_error err;
    const struct rn_kernels *kernels;
    struct rn_train_config config = config_for(dataset);
    for (int i = 0; (kernels = rn_kernels_available(i)); i++) {
        struct rn_engine_options options = {.threads = 1, .kernels = kernels->name};
        struct rn_engine *engine;
        ck_assert(rn_engine_create(&options, &engine, &err) == RN_OK);
        struct rn_trainer *t = trainer_for(engine, dataset, &config);
        while (t->progress.step < 4)
            ck_assert(rn_trainer_advance(t, 1, &err) == RN_OK);
        check_nan_is_met(t, 0);
        check_nan_is_met(t, t->field->parameters.base_count);
        rn_trainer_destroy(&t);
        rn_engine_destroy(&engine);
    }
}
END_TEST

static size_t peak_bytes(void) {
    struct rusage usage;
    ck_assert_int_eq(getrusage(RUSAGE_SELF, &usage), 0);
    return (size_t)usage.ru_maxrss << 10;
}

// What a limit's error says is what a training takes: most of it, and little more. A test runner
// may have the allocator fill what it hands out (MALLOC_PERTURB_), pages never used among it.
START_TEST(memory_limit_is_said_before_it_is_taken) {
    struct rn_error err;
    ck_assert_int_eq(mallopt(M_PERTURB, 0), 1);
    struct rn_train_config config = config_for(scaled);
    config.field.base = 128;
    config.grow_to = 256;
    config.max_steps = 8;
    struct rn_engine *engine = engine_of("generic");
    struct rn_trainer *trainer = NULL;
    ck_assert(rn_trainer_create(engine, scaled, &config, 1 << 20, &trainer, &err) ==
              RN_ERROR_LIMIT);
    ck_assert_ptr_null(trainer);
    ck_assert_ptr_nonnull(strstr(err.text, "a smaller --base"));
    ck_assert_ptr_nonnull(strstr(err.text, "larger --memory-limit"));
    const char *needs = strstr(err.text, "needs ");
    ck_assert_ptr_nonnull(needs);
    double said = atof(needs + 6) * (1 << 20), before = (double)peak_bytes();
    trainer = trainer_for(engine, scaled, &config);
    run_to_end(trainer);
    double taken = (double)peak_bytes() - before;
    printf("said %.0f, taken %.0f\n", said, taken);
    ck_assert_double_gt(taken, 0.5 * said);
    ck_assert_double_lt(taken, 1.25 * said);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
}
END_TEST

static void add_tests(TCase *tests) {
    tcase_add_test(tests, threads_do_not_change_bytes);
    tcase_add_test(tests, far_renders_do_not_change_bytes);
    tcase_add_test(tests, interruptions_do_not_change_bytes);
    tcase_add_test(tests, draws_by_error_resume);
    tcase_add_test(tests, unbounded_space_resumes);
    tcase_add_test(tests, photographs_call_for_their_space);
    tcase_add_test(tests, what_was_asked_for_stays_in_all_of_space);
    tcase_add_test(tests, a_figure_does_not_depend_on_interruptions);
    tcase_add_test(tests, damaged_checkpoints_are_refused);
    tcase_add_test(tests, earlier_checkpoints_lack_what_came_later);
    tcase_add_test(tests, a_resumed_run_keeps_its_kernels);
    tcase_add_test(tests, training_ends_with_its_time);
    tcase_add_test(tests, differences_from_the_paper_have_their_gains);
    tcase_add_test(tests, nan_in_a_network_is_met_by_every_kernel_set);
    tcase_add_test(tests, memory_limit_is_said_before_it_is_taken);
}

int main(void) {
    return run_on_scene("training", add_tests);
}
