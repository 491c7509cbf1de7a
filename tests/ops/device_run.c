#include "tests/ops/device_run.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"

struct device_run run;

void make_dataset(void) {
    struct rn_synth_options synth = {.size = 16, .views = 12, .threads = 1, .samples = 4};
    snprintf(run.folder, sizeof run.folder, "/tmp/ripnerf-device-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(run.folder));
    snprintf(run.path, sizeof run.path, "%s/checkpoint.safetensors", run.folder);
    OK(rn_synthesise("sphere", &synth, run.folder, NULL, NULL, &err));
    OK(rn_dataset_read(run.folder, NULL, &run.dataset, &err));
}

void remove_dataset(void) {
    rn_dataset_destroy(&run.dataset);
    OK(rn_remove_tree(run.folder, &err));
}

struct rn_train_config small_config(const char *preset, int64_t steps) {
    struct rn_train_config config;
    OK(rn_preset(preset, false, &config, &err));
    bool grows = config.grow_to > 0;
    config.field.planes = 3;
    config.field.channels = strcmp(preset, "standard") == 0 ? 8 : 4;
    config.field.base = grows ? 8 : 16;
    config.grow_to = grows ? 16 : 0;
    config.field.levels = 2;
    config.field.width = 16;
    config.field.occupancy = 16;
    config.draw_by_error = config.field.voxels = false; // as a device leaves them out
    config.step = 0.1;
    config.target_samples = 1024;
    config.initial_rays = 64;
    config.max_steps = steps;
    config.max_seconds = 0;
    if (strcmp(preset, "standard") == 0) config.split_pixels = 0.5;
    return config;
}

enum rn_status try_engine(const char *device, size_t memory, struct rn_engine **ret_engine,
                          struct rn_error *err) {
    struct rn_engine_options options = {.device = device,
                                        .threads = 1,
                                        .device_memory_bytes = memory,
                                        .deterministic = run.deterministic};
    return rn_engine_create(&options, ret_engine, err);
}

struct rn_engine *engine_on(const char *device) {
    struct rn_engine *engine;
    OK(try_engine(device, 0, &engine, &err));
    return engine;
}

void run_begin(const char *device, const struct rn_train_config *config) {
    run.engine = engine_on(device);
    if (config)
        OK(rn_trainer_create(run.engine, run.dataset, config, 0, &run.trainer, &err));
    else
        OK(rn_trainer_restore(run.engine, run.dataset, run.path, 0, &run.trainer, &err));
}

void run_to(int64_t step) {
    do {
        OK(rn_trainer_advance(run.trainer, 0, &err));
        rn_trainer_progress(run.trainer, &run.progress);
    } while (!run.progress.done && run.progress.step < step);
}

void run_validate(void) {
    for (bool done = false; !done;)
        OK(rn_trainer_validate(run.trainer, 1, &done, &err));
    rn_trainer_progress(run.trainer, &run.progress);
}

void run_end(void) {
    rn_trainer_destroy(&run.trainer);
    rn_engine_destroy(&run.engine);
}

// ---- pictures -------------------------------------------------------------------------------

void picture(const char *device, double away, int supersample, struct rn_render_result *ret) {
    struct rn_engine *engine = engine_on(device);
    struct rn_field *field;
    struct rn_render_options options = {.camera = run.dataset->frames[0].camera,
                                        .outputs =
                                            RN_OUTPUT_RGB | RN_OUTPUT_ALPHA | RN_OUTPUT_DEPTH,
                                        .settings.supersample = supersample};
    for (int i = 0; i < 3; i++)
        options.camera.world_from_camera[i][3] *= away;
    OK(rn_field_load(engine, run.path, &field, &err));
    OK(rn_render(engine, field, &options, NULL, NULL, ret, &err));
    rn_field_destroy(&field);
    rn_engine_destroy(&engine);
}

double difference(const struct rn_picture *a, const struct rn_picture *b) {
    double worst = 0;
    for (int i = 0; i < a->width * a->height * a->channels; i++)
        worst = fmax(worst, fabs((double)(a->values[i] - b->values[i])));
    return worst;
}

double compare_pictures(const char *one, const char *other, double away) {
    struct rn_render_result a, b;
    picture(one, away, 1, &a);
    picture(other, away, 1, &b);
    // A ray is looked at after 8 samples here and after 16 there.
    ck_assert_double_eq_tol((double)a.stats.samples, (double)b.stats.samples,
                            0.02 * (double)a.stats.samples);
    double worst = fmax(difference(&a.rgb, &b.rgb), difference(&a.alpha, &b.alpha));
    worst = fmax(worst, difference(&a.depth, &b.depth) / run.dataset->bounds.radius / 4);
    rn_render_result_finish(&a);
    rn_render_result_finish(&b);
    return worst;
}
