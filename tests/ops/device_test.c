// The engine with a device, against itself without one: training, growth, effects, evaluation,
// checkpoints, pictures; and what happens when the device cannot or no longer will. The device is
// emulated (RIPNERF_CUDA_MODULE names the module); on a machine with a GPU give the real one.
#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/engine/engine.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/train/trainer.h"
#include "tests/support/suite.h"

static char folder[64], path[128];
static struct rn_dataset *dataset;

static void make_dataset(void) {
    struct rn_synth_options synth = {.size = 16, .views = 12, .threads = 1, .samples = 4};
    snprintf(folder, sizeof folder, "/tmp/ripnerf-device-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/checkpoint.safetensors", folder);
    OK(rn_synthesise("sphere", &synth, folder, NULL, NULL, &err));
    OK(rn_dataset_read(folder, NULL, &dataset, &err));
}

static void remove_dataset(void) {
    rn_dataset_destroy(&dataset);
    OK(rn_remove_tree(folder, &err));
}

// A preset, so small that an emulator trains it in seconds; no rays drawn by error, as on devices.
static struct rn_train_config small_config(const char *preset, int64_t steps) {
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
    config.step = 0.1;
    config.target_samples = 1024;
    config.initial_rays = 64;
    config.max_steps = steps;
    config.max_seconds = 0;
    if (strcmp(preset, "standard") == 0) config.split_pixels = 0.5;
    return config;
}

static bool deterministic;

static enum rn_status try_engine(const char *device, size_t memory, struct rn_engine **ret_engine,
                                 struct rn_error *err) {
    struct rn_engine_options options = {.device = device,
                                        .threads = 1,
                                        .device_memory_bytes = memory,
                                        .deterministic = deterministic};
    return rn_engine_create(&options, ret_engine, err);
}

static struct rn_engine *engine_on(const char *device) {
    struct rn_engine *engine;
    OK(try_engine(device, 0, &engine, &err));
    return engine;
}

// One engine and trainer at a time; `config` NULL restores from the checkpoint.
static struct {
    struct rn_engine *engine;
    struct rn_trainer *trainer;
    struct rn_progress progress;
} run;

static void begin(const char *device, const struct rn_train_config *config) {
    run.engine = engine_on(device);
    if (config)
        OK(rn_trainer_create(run.engine, dataset, config, 0, &run.trainer, &err));
    else
        OK(rn_trainer_restore(run.engine, dataset, path, 0, &run.trainer, &err));
}

static void advance_to(int64_t step) {
    do {
        OK(rn_trainer_advance(run.trainer, 0, &err));
        rn_trainer_progress(run.trainer, &run.progress);
    } while (!run.progress.done && run.progress.step < step);
}

static void validate(void) {
    for (bool done = false; !done;)
        OK(rn_trainer_validate(run.trainer, 1, &done, &err));
    rn_trainer_progress(run.trainer, &run.progress);
}

static void end(void) {
    rn_trainer_destroy(&run.trainer);
    rn_engine_destroy(&run.engine);
}

// The whole of a run; what is known of its field at the end.
static struct rn_field_info train(const char *device, const struct rn_train_config *config) {
    struct rn_field_info info;
    begin(device, config);
    advance_to(INT64_MAX);
    ck_assert(run.trainer->step.march.background_variance == 0); // random backgrounds have ended
    validate();
    OK(rn_trainer_save(run.trainer, path, &err));
    rn_field_describe(rn_trainer_field(run.trainer), &info);
    ck_assert_int_eq(rn_trainer_field(run.trainer)->on_device != NULL, strcmp(device, "cpu") != 0);
    end();
    return info;
}

// ---- pictures -------------------------------------------------------------------------------

static void picture(const char *device, double away, int supersample,
                    struct rn_render_result *ret) {
    struct rn_engine *engine = engine_on(device);
    struct rn_field *field;
    struct rn_render_options options = {.camera = dataset->frames[0].camera,
                                        .outputs =
                                            RN_OUTPUT_RGB | RN_OUTPUT_ALPHA | RN_OUTPUT_DEPTH,
                                        .settings.supersample = supersample};
    for (int i = 0; i < 3; i++)
        options.camera.world_from_camera[i][3] *= away;
    OK(rn_field_load(engine, path, &field, &err));
    OK(rn_render(engine, field, &options, NULL, NULL, ret, &err));
    rn_field_destroy(&field);
    rn_engine_destroy(&engine);
}

static double difference(const struct rn_picture *a, const struct rn_picture *b) {
    double worst = 0;
    for (int i = 0; i < a->width * a->height * a->channels; i++)
        worst = fmax(worst, fabs((double)(a->values[i] - b->values[i])));
    return worst;
}

// Largest difference of two devices' pictures of the checkpoint.
static double compare_pictures(const char *one, const char *other, double away) {
    struct rn_render_result a, b;
    picture(one, away, 1, &a);
    picture(other, away, 1, &b);
    // A ray is looked at after 8 samples here and after 16 there.
    ck_assert_double_eq_tol((double)a.stats.samples, (double)b.stats.samples,
                            0.02 * (double)a.stats.samples);
    double worst = fmax(difference(&a.rgb, &b.rgb), difference(&a.alpha, &b.alpha));
    worst = fmax(worst, difference(&a.depth, &b.depth) / dataset->bounds.radius / 4);
    rn_render_result_finish(&a);
    rn_render_result_finish(&b);
    return worst;
}

// ---- training -------------------------------------------------------------------------------

// fp16 maps and activations: three hundredths of the loss, half of that with more channels or lower
// rates; a quarter of a decibel.
static void check_preset(const char *preset) {
    struct rn_train_config config = small_config(preset, 24);
    config.roulette = 0; // each draws its own lots
    struct rn_field_info there = train("cuda:0", &config);
    struct rn_progress progress = run.progress;
    double apart = compare_pictures("cpu", "cuda:0", 1);
    struct rn_field_info here = train("cpu", &config);
    const struct rn_effect_record *view = &there.effects[RN_EFFECT_VIEW_DEPENDENCE];
    printf("%s after 24 steps: loss %.5f and %.5f, held out %.2f and %.2f dB, view dependence "
           "%.4f and %.4f, pictures %.1e apart\n",
           preset, progress.loss, run.progress.loss, there.psnr, here.psnr, view->number,
           here.effects[RN_EFFECT_VIEW_DEPENDENCE].number, apart);
    ck_assert_int_eq(there.steps, 24);
    ck_assert_int_eq(there.config.field.base, 16);
    ck_assert(there.config.field.view_dependence == here.config.field.view_dependence);
    ck_assert(view->decided && view->on == here.effects[RN_EFFECT_VIEW_DEPENDENCE].on);
    ck_assert(memcmp(there.kernels, "sm_", 3) == 0);
    ck_assert_str_ne(here.kernels, there.kernels);
    ck_assert_uint_eq(progress.steps_rejected + progress.rollbacks + progress.nonfinite_rays, 0);
    ck_assert_double_eq_tol((double)progress.samples, (double)run.progress.samples,
                            0.05 * (double)run.progress.samples);
    ck_assert_double_lt(apart, 5e-3);
    double bound = strcmp(preset, "draft") == 0 ? 0.03 : 0.015;
    ck_assert_double_eq_tol(progress.loss, run.progress.loss, bound * run.progress.loss);
    ck_assert_double_eq_tol(there.psnr, here.psnr, 0.25);
}

START_TEST(draft_trains) {
    check_preset("draft");
}
END_TEST
START_TEST(standard_trains) {
    check_preset("standard");
}
END_TEST
START_TEST(paper_trains) {
    check_preset("paper");
}
END_TEST

// ---- one step -------------------------------------------------------------------------------

// What one step of the paper's networks leaves of the planes' and networks' gradients.
struct one_step {
    float *m;
    size_t counts[3]; // planes, density network, colour network
    double loss;
    uint64_t samples;
};

static struct one_step take_step(const char *device, const struct rn_train_config *config) {
    struct rn_engine_options options = {.device = device, .threads = 1};
    struct one_step out = {.loss = NAN};
    if (strcmp(device, "cpu") == 0) options.kernels = "generic"; // all of it in fp32
    OK(rn_engine_create(&options, &run.engine, &err));
    OK(rn_trainer_create(run.engine, dataset, config, 0, &run.trainer, &err));
    advance_to(1);
    struct rn_trainer *t = run.trainer;
    const struct rn_parameters *p = &t->field->parameters;
    OK(rn_field_fetch(t->field, t->optimiser.m, t->optimiser.v, &err));
    ck_assert_int_eq(t->optimiser.updates, 1);
    out.counts[0] = p->plane_count;
    out.counts[1] = p->base_count;
    out.counts[2] = p->head_count;
    out.m = malloc(p->count * sizeof *out.m);
    memcpy(out.m, t->optimiser.m, p->count * sizeof *out.m);
    out.loss = run.progress.loss;
    out.samples = run.progress.samples;
    end();
    return out;
}

// A step of the paper's configuration beside the CPU's, the same rays of the same field; the device
// rounds maps, features and activations to fp16. The planes have 64 texels a side, or
// RIPNERF_DEVICE_BASE: with the paper's 512 the emulator takes most of a minute, and 2 GB.
START_TEST(a_step_is_the_cpus) {
    static const char *const names[3] = {"planes", "density network", "colour network"};
    const char *base = getenv("RIPNERF_DEVICE_BASE");
    struct rn_train_config config;
    OK(rn_preset("paper", false, &config, &err));
    config.field.base = base ? atoi(base) : 64;
    config.field.levels = 4;
    config.field.occupancy = 32;
    config.step = 0.05;
    config.target_samples = 4096;
    config.initial_rays = 200;
    config.max_steps = 1;
    config.max_seconds = 0;
    struct one_step here = take_step("cpu", &config), there = take_step("cuda:0", &config);
    printf("10 planes of %d^2: loss %.1e apart", config.field.base,
           fabs(there.loss - here.loss) / here.loss);
    ck_assert_double_eq_tol(there.loss, here.loss, 1e-3 * here.loss);
    ck_assert_double_eq_tol((double)there.samples, (double)here.samples,
                            1e-3 * (double)here.samples);
    for (size_t i = 0, at = 0; i < 3; at += here.counts[i++]) {
        double apart = 0, size = 0;
        for (size_t k = at; k < at + here.counts[i]; k++) {
            apart += pow((double)(there.m[k] - here.m[k]), 2);
            size += pow((double)here.m[k], 2);
        }
        printf(", %s %.1e", names[i], sqrt(apart / size));
        ck_assert_double_lt(sqrt(apart / size), 4e-2);
    }
    printf("\n");
    free(here.m);
    free(there.m);
}
END_TEST

// Each device goes on from the other's checkpoint; `show` names who did it last.
START_TEST(goes_on_anywhere) {
    const char *const devices[3] = {"cuda:0", "cpu", "cuda:0"};
    struct rn_train_config config = small_config("standard", 30);
    begin("cuda:0", &config);
    for (int i = 0; i < 3; i++) {
        int64_t until = 16 + 7 * i;
        if (i > 0) begin(devices[i], NULL);
        advance_to(until);
        ck_assert_int_ge(run.progress.step, until);
        OK(rn_trainer_save(run.trainer, path, &err));
        struct rn_field_info info;
        rn_field_describe(rn_trainer_field(run.trainer), &info);
        ck_assert_int_eq(memcmp(info.kernels, "sm_", 3) == 0, i != 1);
        end();
    }
    ck_assert_int_eq(run.progress.step, 30);
}
END_TEST

// In the deterministic mode a run that was interrupted again and again ends as one that was not.
START_TEST(resumes_to_the_same_bytes) {
    struct rn_train_config config = small_config("draft", 30);
    char whole[65], pieces[65];
    int good_steps;
    deterministic = true;
    begin("cuda:0", &config);
    advance_to(30);
    OK(rn_trainer_save(run.trainer, path, &err));
    rn_field_sha256(rn_trainer_field(run.trainer), whole);
    good_steps = run.trainer->device.good_steps;
    end();
    begin("cuda:0", &config);
    for (bool done = false; !done;) {
        advance_to(0);
        done = run.progress.done;
        OK(rn_trainer_save(run.trainer, path, &err));
        rn_field_sha256(rn_trainer_field(run.trainer), pieces);
        if (!done) end();
        if (!done) begin("cuda:0", NULL);
    }
    ck_assert_str_eq(whole, pieces);
    ck_assert_int_eq(run.trainer->device.good_steps, good_steps);
    end();
}
END_TEST

// A device traces every pixel whatever the tolerance; rays that end earlier are opaque there too.
static void check_dial(struct rn_render_options options, const struct rn_render_result *full) {
    struct rn_render_result quick;
    options.settings.tolerance = 0.1;
    options.settings.stop = rn_trainer_field(run.trainer)->config.stop;
    OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &quick, &err));
    ck_assert(difference(&full->rgb, &quick.rgb) == 0);
    ck_assert_uint_eq(full->stats.rays, quick.stats.rays);
    rn_render_result_finish(&quick);
    int opaque = 0;
    options.settings.stop = 0.5;
    options.outputs = RN_OUTPUT_ALPHA;
    OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &quick, &err));
    for (int i = 0; i < quick.alpha.width * quick.alpha.height; i++) {
        opaque += quick.alpha.values[i] == 1;
        ck_assert(quick.alpha.values[i] == 1 || quick.alpha.values[i] < 0.5f);
    }
    ck_assert_int_gt(opaque, 0);
    rn_render_result_finish(&quick);
}

// A field at rest has finer cells, and of these firm ones; pictures read them there as on the CPU.
START_TEST(reads_the_cells_of_a_field_at_rest) {
    struct rn_train_config config = small_config("draft", 20);
    struct rn_render_options options = {
        .camera = dataset->frames[0].camera, .outputs = RN_OUTPUT_RGB, .settings.supersample = 1};
    begin("cuda:0", &config);
    advance_to(20);
    struct rn_field *field = rn_trainer_finish(&run.trainer);
    int cells = field->config.field.occupancy;
    for (int i = 0; i < cells * cells * cells; i++) // few enough cells to be refined: a slab
        if ((i / cells / cells + 1) / 2 != cells / 4) field->occupancy[i] = 0;
    rn_field_refresh_occupancy(field);
    rn_field_refine_occupancy(field, run.engine);
    ck_assert_ptr_nonnull(field->fine.words);
    size_t bricks = (size_t)field->fine.cells / RN_BRICK, words = bricks * bricks * bricks * 16;
    memset(field->fine.words, 0, words / 2 * sizeof(uint32_t)); // far fewer than are occupied
    OK(rn_field_put_to_render(run.engine, field, &err));
    struct rn_render_result there[2], here[2], coarse;
    for (int i = 0; i < 2; i++) { // of rays that end early the firm ones
        options.settings.stop = i ? 0.1 : 0;
        OK(rn_render(run.engine, field, &options, NULL, NULL, &there[i], &err));
    }
    rn_field_withdraw(field);
    for (int i = 0; i < 2; i++) {
        options.settings.stop = i ? 0.1 : 0;
        OK(rn_render(run.engine, field, &options, NULL, NULL, &here[i], &err));
    }
    options.settings.stop = 0;
    rn_field_refresh_occupancy(field);
    OK(rn_render(run.engine, field, &options, NULL, NULL, &coarse, &err));
    printf("at rest: %llu samples for %llu, firm ones %llu\n",
           (unsigned long long)there[0].stats.samples, (unsigned long long)coarse.stats.samples,
           (unsigned long long)there[1].stats.samples);
    ck_assert_uint_lt(there[0].stats.samples, coarse.stats.samples * 3 / 4);
    ck_assert_uint_lt(there[1].stats.samples, there[0].stats.samples);
    for (int i = 0; i < 2; i++) {
        // A ray is looked at after 8 samples here and after 16 there.
        ck_assert_uint_ge(there[i].stats.samples, here[i].stats.samples);
        ck_assert_uint_le(there[i].stats.samples, here[i].stats.samples + 8 * here[i].stats.rays);
        ck_assert_double_lt(difference(&there[i].rgb, &here[i].rgb), 5e-3);
        rn_render_result_finish(&there[i]);
        rn_render_result_finish(&here[i]);
    }
    rn_render_result_finish(&coarse);
    rn_field_destroy(&field);
    rn_engine_destroy(&run.engine);
}
END_TEST

// What is rendered in the middle of a training is the field as it is there, also where a camera
// wants levels that the device lacks; and a finished training's field renders on.
START_TEST(renders_while_it_trains) {
    struct rn_train_config config = small_config("draft", 30);
    config.field.levels = 4;
    struct rn_render_options options = {
        .camera = dataset->frames[0].camera, .outputs = RN_OUTPUT_RGB, .settings.supersample = 1};
    begin("cuda:0", &config);
    for (int i = 0; i < 2; i++) {
        struct rn_render_result near, cones, far, after;
        advance_to(16 * (i + 1));
        OK(rn_render(run.engine, rn_trainer_field(run.trainer), &options, NULL, NULL, &near, &err));
        check_dial(options, &near);
        struct rn_render_options away = options, split = options;
        split.settings.supersample = 2;
        OK(rn_render(run.engine, rn_trainer_field(run.trainer), &split, NULL, NULL, &cones, &err));
        for (int k = 0; k < 3; k++)
            away.camera.world_from_camera[k][3] *= 6;
        OK(rn_render(run.engine, rn_trainer_field(run.trainer), &away, NULL, NULL, &far, &err));
        OK(rn_trainer_save(run.trainer, path, &err));
        picture("cpu", 1, 1, &after);
        ck_assert_double_lt(difference(&near.rgb, &after.rgb), 5e-3);
        rn_render_result_finish(&after);
        picture("cpu", 1, 2, &after);
        ck_assert_double_lt(difference(&cones.rgb, &after.rgb), 5e-3);
        ck_assert_double_gt(difference(&cones.rgb, &near.rgb), 5e-3);
        rn_render_result_finish(&after);
        picture("cpu", 6, 1, &after);
        ck_assert(difference(&far.rgb, &after.rgb) == 0); // the CPU's, both
        rn_render_result_finish(&after);
        rn_render_result_finish(&near);
        rn_render_result_finish(&cones);
        rn_render_result_finish(&far);
    }
    struct rn_field *field = rn_trainer_finish(&run.trainer);
    ck_assert_ptr_nonnull(field->on_device);
    struct rn_render_result last;
    OK(rn_render(run.engine, field, &options, NULL, NULL, &last, &err));
    rn_render_result_finish(&last);
    rn_field_destroy(&field);
    rn_engine_destroy(&run.engine);
}
END_TEST

static bool always(void *context) {
    (void)context;
    return true;
}

// Training goes on there though a render is wanted at every moment of the planes' growth.
START_TEST(grows_there_in_parts) {
    struct rn_train_config config = small_config("draft", 20);
    begin("cuda:0", &config);
    rn_engine_yield_to(run.engine, always, NULL);
    do {
        OK(rn_trainer_advance(run.trainer, 1000, &err));
        ck_assert_ptr_nonnull(rn_trainer_field(run.trainer)->on_device);
        rn_trainer_progress(run.trainer, &run.progress);
    } while (!run.progress.done);
    ck_assert_int_eq(rn_trainer_field(run.trainer)->config.field.base, 16);
    end();
}
END_TEST

static bool never(void *context) {
    ++*(int *)context;
    return false;
}

START_TEST(stops_when_asked) {
    struct rn_train_config config = small_config("paper", 16);
    struct rn_render_options options = {.camera = dataset->frames[0].camera,
                                        .outputs = RN_OUTPUT_RGB};
    struct rn_render_result result;
    struct rn_error said;
    int asked = 0;
    begin("cuda:0", &config);
    ck_assert(rn_render(run.engine, rn_trainer_field(run.trainer), &options, never, &asked, &result,
                        &said) == RN_ERROR_CANCELLED);
    ck_assert_int_eq(asked, 1);
    end();
}
END_TEST

// ---- what goes wrong ------------------------------------------------------------------------

// A rate at which nothing stays within fp16: steps are rejected while the gradients' scale is
// lowered, then training goes back to what was saved, at half the rate.
START_TEST(diverges_and_goes_back) {
    struct rn_train_config config = small_config("draft", 100000);
    struct rn_incident incident;
    config.learning_rate = 10;
    config.plane_rate = 1000;
    begin("cuda:0", &config);
    do
        advance_to(0);
    while (run.progress.rollbacks == 0 && run.progress.step < 200);
    ck_assert_uint_eq(run.progress.rollbacks, 1);
    ck_assert_uint_ge(run.progress.steps_rejected, 40);
    ck_assert(rn_trainer_take_incident(run.trainer, &incident));
    ck_assert(incident.kind == RN_INCIDENT_ROLLBACK);
    ck_assert_int_eq(incident.step, run.progress.step - 1);
    ck_assert_int_gt(incident.ray_count, 0);
    ck_assert(!rn_trainer_take_incident(run.trainer, &incident));
    struct rn_field *field = rn_trainer_field(run.trainer), *fresh;
    OK(rn_field_create(&field->config, &field->bounds, &fresh, &err));
    rn_field_randomise(fresh, config.seed);
    size_t bytes = field->parameters.count * sizeof(float);
    ck_assert(memcmp(field->parameters.values, fresh->parameters.values, bytes) == 0);
    rn_field_destroy(&fresh);
    advance_to(run.progress.step + 16);
    ck_assert_uint_eq(run.progress.rollbacks, 1);
    end();
}
END_TEST

// From now on every call of the emulated device fails; 0 ends it. NULL where the device is real.
typedef void fail_device(int error);
static fail_device *find_knob(void) {
    void *module = dlopen(getenv("RIPNERF_CUDA_MODULE"), RTLD_NOW | RTLD_NOLOAD);
    fail_device *knob;
    *(void **)&knob = module ? dlsym(module, "rn_emulator_fail") : NULL;
    return knob;
}

START_TEST(a_lost_device_is_said) {
    struct rn_train_config config = small_config("paper", 16);
    struct rn_error said;
    bool done;
    begin("cuda:0", &config);
    find_knob()(700);
    ck_assert(rn_trainer_advance(run.trainer, 1, &said) == RN_ERROR_UNAVAILABLE);
    ck_assert(rn_trainer_validate(run.trainer, 1, &done, &said) == RN_ERROR_UNAVAILABLE);
    ck_assert(rn_trainer_save(run.trainer, path, &said) == RN_ERROR_UNAVAILABLE);
    find_knob()(0);
    end();
}
END_TEST

START_TEST(what_is_not_there_is_said) {
    struct rn_error said;
    struct rn_engine *engine = NULL;
    const char *const devices[] = {"cuda", "cuda:1", "gpu", "cuda:0x", "cuda:-1"};
    for (int i = 0; i < 5; i++) {
        ck_assert(try_engine(devices[i], 0, &engine, &said) == RN_ERROR_UNSUPPORTED);
        ck_assert_str_eq(said.where, "device");
        ck_assert_ptr_nonnull(strstr(said.text, "cpu"));
    }
    setenv("RIPNERF_CUDA_MODULE", "/nowhere.so", 1);
    ck_assert(try_engine("cuda:0", 0, &engine, &said) == RN_ERROR_UNSUPPORTED);
    ck_assert_ptr_nonnull(strstr(said.text, "not installed"));
    ck_assert_ptr_nonnull(strstr(said.text, "--device cpu"));
}
END_TEST

static const char *device_of(const struct rn_engine *engine) {
    static struct rn_device_info info;
    rn_engine_describe(engine, &info);
    return info.device;
}

// `auto` takes the device, and the CPU for a field that the kernels cannot hold.
START_TEST(auto_takes_what_there_is) {
    struct rn_train_config config = small_config("standard", 4);
    config.field.width = 144;
    begin("cpu", &config);
    advance_to(4);
    ck_assert_str_eq(device_of(run.engine), "cpu");
    OK(rn_trainer_save(run.trainer, path, &err));
    end();
    ck_assert(compare_pictures("cpu", "auto", 1) == 0);
    struct rn_engine *engine = engine_on("cuda:0");
    struct rn_trainer *trainer;
    struct rn_error said;
    ck_assert(rn_trainer_restore(engine, dataset, path, 0, &trainer, &said) ==
              RN_ERROR_UNSUPPORTED);
    ck_assert_str_eq(said.where, "width");
    rn_engine_destroy(&engine);
    begin("auto", NULL);
    ck_assert_ptr_null(rn_trainer_field(run.trainer)->on_device);
    end();
    struct rn_engine_options named = {.device = "auto", .kernels = "generic", .threads = 1};
    OK(rn_engine_create(&named, &engine, &err));
    ck_assert_str_eq(device_of(engine), "cpu");
    rn_engine_destroy(&engine);
    config = small_config("standard", 4);
    config.draw_by_error = true;
    for (int shading = 0; shading <= RN_SHADING_RAY; shading++) {
        config.field.shading = (enum rn_shading)shading;
        begin("auto", &config);
        ck_assert_str_eq(device_of(run.engine), "cuda:0");
        ck_assert_ptr_nonnull(rn_trainer_field(run.trainer)->on_device);
        const struct rn_train_config *own = rn_trainer_config(run.trainer);
        ck_assert(own->roulette == 1 && own->split_pixels == config.split_pixels);
        ck_assert(!own->draw_by_error);
        end();
    }
    setenv("RIPNERF_CUDA_MODULE", "/nowhere.so", 1);
    begin("auto", &config);
    ck_assert_str_eq(device_of(run.engine), "cpu");
    ck_assert(rn_trainer_config(run.trainer)->roulette == 1);
    ck_assert(rn_trainer_config(run.trainer)->draw_by_error);
    end();
}
END_TEST

static bool takes_the_device(void) {
    struct rn_engine *engine = engine_on("auto");
    struct rn_device_info info;
    rn_engine_describe(engine, &info);
    printf("%s\n", info.checked);
    bool takes = strcmp(info.device, "cuda:0") == 0;
    ck_assert_ptr_nonnull(strstr(info.checked, takes ? "agrees with the CPU" : "the CPU is used"));
    rn_engine_destroy(&engine);
    return takes;
}

// A device whose kernels do otherwise than the CPU's is not taken by `auto`, which says so. _i:
// which of them does nothing; every one of them counts.
START_TEST(auto_takes_what_agrees) {
    static const char *const kernels[] = {"none",          "shape->render",  "shape->train",
                                          "shape->shade",  "scatter",        "base_backward",
                                          "rn_gradient",   "update_network", "rn_order",
                                          "sums_backward", "rn_place",       "update_planes"};
    setenv("RIPNERF_EMULATOR_SKIPS", kernels[_i], 1);
    ck_assert_int_eq(takes_the_device(), _i == 0);
}
END_TEST

// A budget too small for the planes as they will be is refused before anything is trained.
START_TEST(memory_is_counted_first) {
    struct rn_train_config config = small_config("standard", 16);
    struct rn_engine *engine;
    struct rn_trainer *trainer;
    struct rn_error said;
    config.grow_to = 1024;
    OK(try_engine("cuda:0", (size_t)64 << 20, &engine, &err));
    ck_assert(rn_trainer_create(engine, dataset, &config, 0, &trainer, &said) == RN_ERROR_LIMIT);
    ck_assert_ptr_nonnull(strstr(said.text, "MiB"));
    ck_assert_ptr_nonnull(strstr(said.text, "would fit"));
    printf("%s\n", said.text);
    rn_engine_destroy(&engine);
}
END_TEST

static void add(Suite *suite, const char *name, const TTest *test) {
    TCase *tests = tcase_create(name);
    tcase_add_unchecked_fixture(tests, make_dataset, remove_dataset);
    tcase_set_timeout(tests, getenv("RIPNERF_DEVICE_BASE") ? 590 : 120);
    tcase_add_test(tests, test);
    suite_add_tcase(suite, tests);
}

static bool has_device(void) {
    struct rn_error said;
    struct rn_engine *engine;
    if (try_engine("cuda:0", 0, &engine, &said) != RN_OK) {
        printf("%s\n", said.text);
        return false;
    }
    rn_engine_destroy(&engine);
    return true;
}

// In a process of its own: the module is loaded with the first device.
static bool is_emulated(void) {
    return has_device() && find_knob() != NULL;
}

int main(void) {
    setvbuf(stdout, NULL, _IOLBF, 0);
    if (!holds_in_a_child(has_device)) return 77; // skipped
    Suite *suite = suite_create("device");
    add(suite, "draft", draft_trains);
    add(suite, "standard", standard_trains);
    add(suite, "paper", paper_trains);
    add(suite, "step", a_step_is_the_cpus);
    add(suite, "anywhere", goes_on_anywhere);
    add(suite, "bytes", resumes_to_the_same_bytes);
    add(suite, "renders", renders_while_it_trains);
    add(suite, "rest", reads_the_cells_of_a_field_at_rest);
    add(suite, "grows", grows_there_in_parts);
    add(suite, "stops", stops_when_asked);
    add(suite, "diverges", diverges_and_goes_back);
    bool emulated = holds_in_a_child(is_emulated);
    if (emulated) add(suite, "lost", a_lost_device_is_said);
    add(suite, "said", what_is_not_there_is_said);
    add(suite, "auto", auto_takes_what_there_is);
    if (emulated) {
        TCase *agrees = tcase_create("agrees");
        tcase_set_timeout(agrees, 60);
        tcase_add_loop_test(agrees, auto_takes_what_agrees, 0, 12);
        suite_add_tcase(suite, agrees);
    }
    add(suite, "memory", memory_is_counted_first);
    return run_suite(suite);
}
