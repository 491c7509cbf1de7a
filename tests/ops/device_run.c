#include "tests/ops/device_run.h"

#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "server/engine/scene/device.h"
#include "tests/ops/cuda_emulator/knobs.h"

struct device_run run;

#define MODULE "RIPNERF_CUDA_MODULE" // names it in the environment
static void *emulator;               // the module, where one has been asked to do otherwise
static char *hidden;                 // what named the module; NULL: it does

bool emulate(struct emulation how) {
    __typeof__(rn_emulator_fail) *lose;
    __typeof__(rn_emulator_order) *order;
    __typeof__(rn_emulator_skip) *skip;
    if (!emulator) emulator = dlopen(getenv(MODULE), RTLD_NOW | RTLD_NODELETE);
    *(void **)&lose = emulator ? dlsym(emulator, "rn_emulator_fail") : NULL;
    if (!lose) return false;
    *(void **)&order = dlsym(emulator, "rn_emulator_order");
    *(void **)&skip = dlsym(emulator, "rn_emulator_skip");
    lose(how.error);
    order(how.order, 1);
    skip(how.skips);
    return true;
}

void hide_module(void) {
    hidden = strdup(getenv(MODULE));
    setenv(MODULE, "/nowhere.so", 1);
}

void put_back(void) {
    if (emulator) emulate((struct emulation){0});
    if (hidden) setenv(MODULE, hidden, 1);
    free(hidden);
    hidden = NULL;
}

void make_dataset_sized(const char *scene, int size) {
    struct rn_synth_options synth = {.size = size, .views = 12, .threads = 1, .samples = 4};
    run = (struct device_run){0};
    snprintf(run.folder, sizeof run.folder, "/tmp/ripnerf-device-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(run.folder));
    snprintf(run.path, sizeof run.path, "%s/checkpoint.safetensors", run.folder);
    OK(rn_synthesise(scene, &synth, run.folder, NULL, NULL, &err));
    OK(rn_dataset_read(run.folder, NULL, &run.dataset, &err));
}

void make_dataset_of(const char *scene) {
    make_dataset_sized(scene, 16);
}

void make_dataset(void) {
    make_dataset_of("sphere");
}

void remove_dataset(void) {
    put_back();
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
    config.draw_by_error = false;
    config.field.voxels = false;
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
                                        .kernels = run.kernels,
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

// ---- one step -------------------------------------------------------------------------------

struct one_step take_step(const char *device, const struct rn_train_config *config) {
    struct rn_engine_options options = {.device = device, .threads = 1};
    struct one_step out = {.loss = NAN};
    if (strcmp(device, "cpu") == 0) options.kernels = "generic"; // all of it in fp32
    OK(rn_engine_create(&options, &run.engine, &err));
    OK(rn_trainer_create(run.engine, run.dataset, config, 0, &run.trainer, &err));
    ck_assert(!rn_trainer_field(run.trainer)->on_device == (strcmp(device, "cpu") == 0));
    struct rn_trainer *t = run.trainer;
    if (run.prepare) run.prepare(t);
    OK(rn_trainer_put(t, &err));
    run_to(t->progress.step + 1);
    const struct rn_parameters *p = &t->field->parameters;
    OK(rn_trainer_fetch(t, &err));
    ck_assert_int_eq(t->optimiser.updates, 1);
    out.counts[0] = p->plane_count;
    out.counts[1] = p->base_count;
    out.counts[2] = p->head_count;
    out.m = malloc(p->count * sizeof *out.m);
    memcpy(out.m, t->optimiser.m, p->count * sizeof *out.m);
    size_t side = (size_t)t->field->config.field.occupancy;
    out.cells = t->hull.seen ? side * side * side : 0;
    out.seen = calloc(out.cells + 1, sizeof *out.seen);
    for (size_t i = 0; i < out.cells; i++)
        memcpy(&out.seen[i], &t->hull.seen[i], sizeof *out.seen);
    out.blocks = t->sampler.importance.count;
    out.errors = calloc(out.blocks + 1, sizeof *out.errors);
    if (out.blocks > 0)
        memcpy(out.errors, t->sampler.importance.error, out.blocks * sizeof *out.errors);
    out.loss = run.progress.loss;
    out.samples = run.progress.samples;
    run_end();
    return out;
}

void compare_steps(const struct one_step *here, const struct one_step *there, double bound) {
    static const char *const names[3] = {"planes", "density network", "colour network"};
    size_t noted = 0, apart_cells = 0;
    for (size_t i = 0, at = 0; i < 3; at += here->counts[i++]) {
        double apart = 0, size = 0;
        for (size_t k = at; k < at + here->counts[i]; k++) {
            apart += pow((double)(there->m[k] - here->m[k]), 2);
            size += pow((double)here->m[k], 2);
        }
        printf(", %s %.1e", names[i], sqrt(apart / size));
        ck_assert_double_lt(sqrt(apart / size), bound);
    }
    for (size_t i = 0; i < here->cells; i++) {
        noted += here->seen[i] > 0;
        apart_cells += fabsf(here->seen[i] - there->seen[i]) > 1e-3f ||
                       (here->seen[i] == 0) != (there->seen[i] == 0);
    }
    if (here->cells > 0) printf(", %zu of %zu cells showed another weight", apart_cells, noted);
    printf("\n");
    ck_assert(here->cells == there->cells && (here->cells == 0 || noted > 100));
    ck_assert_uint_le(apart_cells, noted / 50); // a sample at a cell's side may be of either
}

void step_finish(struct one_step *step) {
    free(step->m);
    free(step->seen);
    free(step->errors);
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

void compare_interrupted(const struct rn_train_config *config, int64_t steps) {
    char whole[65], pieces[65];
    run.deterministic = true;
    run_begin("cuda:0", config);
    run_to(steps);
    OK(rn_trainer_save(run.trainer, run.path, &err));
    rn_field_sha256(rn_trainer_field(run.trainer), whole);
    int good_steps = run.trainer->device.good_steps;
    run_end();
    run_begin("cuda:0", config);
    for (bool done = false; !done;) {
        rn_trainer_progress(run.trainer, &run.progress);
        run_to(run.progress.step + 1); // a measurement that is cut short begins anew
        done = run.progress.done;
        OK(rn_trainer_save(run.trainer, run.path, &err));
        rn_field_sha256(rn_trainer_field(run.trainer), pieces);
        if (!done) run_end();
        if (!done) run_begin("cuda:0", NULL);
    }
    ck_assert_str_eq(whole, pieces);
    ck_assert_int_eq(run.trainer->device.good_steps, good_steps);
    run_end();
}

void compare_one_step(const struct rn_train_config *config, const char *what,
                      double samples_apart) {
    struct one_step here = take_step("cpu", config), there = take_step("cuda:0", config);
    printf("%s: loss %.1e apart", what, fabs(there.loss - here.loss) / here.loss);
    ck_assert_double_eq_tol(there.loss, here.loss, 1e-3 * here.loss);
    ck_assert_double_eq_tol((double)there.samples, (double)here.samples,
                            samples_apart * (double)here.samples);
    compare_steps(&here, &there, 4e-2);
    step_finish(&here);
    step_finish(&there);
}
