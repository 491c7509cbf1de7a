// The engine with a device, against itself without one: training, growth, effects, evaluation,
// checkpoints, pictures; and what happens when the device cannot or no longer will. The device is
// emulated (RIPNERF_CUDA_MODULE names the module); on a machine with a GPU give the real one.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/engine/scene/device.h"
#include "tests/ops/device_run.h"

// The whole of a run; what is known of its field at the end.
static struct rn_field_info train(const char *device, const struct rn_train_config *config) {
    struct rn_field_info info;
    run_begin(device, config);
    run_to(INT64_MAX);
    ck_assert(run.trainer->step.march.colour.background_variance ==
              0); // random backgrounds have ended
    run_validate();
    OK(rn_trainer_save(run.trainer, run.path, &err));
    rn_field_describe(rn_trainer_field(run.trainer), &info);
    ck_assert_int_eq(rn_trainer_field(run.trainer)->on_device != NULL, strcmp(device, "cpu") != 0);
    run_end();
    return info;
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

// A step of the paper's configuration beside the CPU's, the same rays of the same field; the device
// rounds maps, features and activations to fp16. The planes have 64 texels a side, or
// RIPNERF_DEVICE_BASE: with the paper's 512 the emulator takes most of a minute, and 2 GB.
static void check_step(bool mip) {
    const char *base = getenv("RIPNERF_DEVICE_BASE");
    struct rn_train_config config;
    OK(rn_preset("paper", false, &config, &err));
    config.field.base = base ? atoi(base) : 64;
    config.field.levels = 4;
    config.field.footprint = mip ? RN_FOOTPRINT_MIP : RN_FOOTPRINT_RIP;
    config.field.mean_level = mip;
    config.field.occupancy = 32;
    config.step = 0.05;
    config.target_samples = 4096;
    config.initial_rays = 200;
    config.max_steps = 1;
    config.max_seconds = 0;
    char what[40];
    snprintf(what, sizeof what, "10 planes of %d^2", config.field.base);
    compare_one_step(&config, what, 1e-3);
}

START_TEST(a_step_is_the_cpus) {
    check_step(false);
}
END_TEST
// A mip, whose level is the mean of both axes'.
START_TEST(a_step_of_a_mip_is_the_cpus) {
    check_step(true);
}
END_TEST

// Planes whose levels do not halve evenly: a step, and what pictures show of its training.
START_TEST(uneven_planes_train) {
    struct rn_train_config config = small_config("standard", 1);
    config.field.base = 21;
    config.field.levels = 3;
    config.grow_to = 0;
    config.initial_rays = 200;
    config.roulette = config.split_pixels = 0;
    struct one_step here = take_step("cpu", &config), there = take_step("cuda:0", &config);
    ck_assert_double_eq_tol(there.loss, here.loss, 1e-3 * here.loss);
    printf("planes of 21^2: loss %.1e apart", fabs(there.loss - here.loss) / here.loss);
    compare_steps(&here, &there, 4e-2);
    config.max_steps = 24;
    struct rn_field_info on_device = train("cuda:0", &config);
    double apart = compare_pictures("cpu", "cuda:0", 1);
    struct rn_field_info on_cpu = train("cpu", &config);
    printf("after 24 steps held out %.2f and %.2f dB, pictures %.1e apart\n", on_device.psnr,
           on_cpu.psnr, apart);
    ck_assert_double_lt(apart, 5e-3);
    ck_assert_double_eq_tol(on_device.psnr, on_cpu.psnr, 0.25);
    step_finish(&here);
    step_finish(&there);
}
END_TEST

// Each device goes on from the other's checkpoint; `show` names who did it last.
START_TEST(goes_on_anywhere) {
    const char *const devices[3] = {"cuda:0", "cpu", "cuda:0"};
    struct rn_train_config config = small_config("standard", 30);
    run_begin("cuda:0", &config);
    for (int i = 0; i < 3; i++) {
        int64_t until = 16 + 7 * i;
        if (i > 0) run_begin(devices[i], NULL);
        run_to(until);
        ck_assert_int_ge(run.progress.step, until);
        OK(rn_trainer_save(run.trainer, run.path, &err));
        struct rn_field_info info;
        rn_field_describe(rn_trainer_field(run.trainer), &info);
        ck_assert_int_eq(memcmp(info.kernels, "sm_", 3) == 0, i != 1);
        run_end();
    }
    ck_assert_int_eq(run.progress.step, 30);
}
END_TEST

START_TEST(resumes_to_the_same_bytes) {
    struct rn_train_config config = small_config("draft", 30);
    compare_interrupted(&config, 30);
}
END_TEST

static bool always(void *context) {
    (void)context;
    return true;
}

// Training goes on there though a render is wanted at every moment of the planes' growth.
START_TEST(grows_there_in_parts) {
    struct rn_train_config config = small_config("draft", 20);
    run_begin("cuda:0", &config);
    rn_engine_yield_to(run.engine, always, NULL);
    do {
        OK(rn_trainer_advance(run.trainer, 1000, &err));
        ck_assert_ptr_nonnull(rn_trainer_field(run.trainer)->on_device);
        rn_trainer_progress(run.trainer, &run.progress);
    } while (!run.progress.done);
    ck_assert_int_eq(rn_trainer_field(run.trainer)->config.field.base, 16);
    run_end();
}
END_TEST

static bool never(void *context) {
    ++*(int *)context;
    return false;
}

START_TEST(stops_when_asked) {
    struct rn_train_config config = small_config("paper", 16);
    struct rn_render_options options = {.camera = run.dataset->frames[0].camera,
                                        .outputs = RN_OUTPUT_RGB};
    struct rn_render_result result;
    struct rn_error said;
    int asked = 0;
    run_begin("cuda:0", &config);
    ck_assert(rn_render(run.engine, rn_trainer_field(run.trainer), &options, never, &asked, &result,
                        &said) == RN_ERROR_CANCELLED);
    ck_assert_int_eq(asked, 1);
    run_end();
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
    run_begin("cuda:0", &config);
    do
        run_to(0);
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
    run_to(run.progress.step + 16);
    ck_assert_uint_eq(run.progress.rollbacks, 1);
    run_end();
}
END_TEST

START_TEST(a_lost_device_is_said) {
    struct rn_train_config config = small_config("paper", 16);
    struct rn_error said;
    bool done;
    run_begin("cuda:0", &config);
    emulate((struct emulation){.error = 700});
    ck_assert(rn_trainer_advance(run.trainer, 1, &said) == RN_ERROR_UNAVAILABLE);
    ck_assert(rn_trainer_validate(run.trainer, 1, &done, &said) == RN_ERROR_UNAVAILABLE);
    ck_assert(rn_trainer_save(run.trainer, run.path, &said) == RN_ERROR_UNAVAILABLE);
    emulate((struct emulation){0});
    run_end();
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
    hide_module();
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

// A field that the kernels cannot hold, trained on the CPU: `auto` leaves it there, and a device
// that is named says why it does not take it.
static void check_left_out(const struct rn_train_config *config, const char *where) {
    run_begin("cpu", config);
    run_to(4);
    ck_assert_str_eq(device_of(run.engine), "cpu");
    OK(rn_trainer_save(run.trainer, run.path, &err));
    run_end();
    ck_assert(compare_pictures("cpu", "auto", 1) == 0);
    struct rn_engine *engine = engine_on("cuda:0");
    struct rn_trainer *trainer;
    struct rn_error said;
    ck_assert(rn_trainer_restore(engine, run.dataset, run.path, 0, &trainer, &said) ==
              RN_ERROR_UNSUPPORTED);
    ck_assert_str_eq(said.where, where);
    rn_engine_destroy(&engine);
    run_begin("auto", NULL);
    ck_assert_ptr_null(rn_trainer_field(run.trainer)->on_device);
    run_end();
}

// `auto` takes the device, and the CPU for a field that the kernels cannot hold.
START_TEST(auto_takes_what_there_is) {
    struct rn_train_config config = small_config("standard", 4);
    config.field.width = 144;
    check_left_out(&config, "width");
    struct rn_engine *engine;
    struct rn_engine_options named = {.device = "auto", .kernels = "generic", .threads = 1};
    OK(rn_engine_create(&named, &engine, &err));
    ck_assert_str_eq(device_of(engine), "cpu");
    rn_engine_destroy(&engine);
    config = small_config("standard", 4);
    config.draw_by_error = config.field.voxels = true;
    for (int shading = 0; shading <= RN_SHADING_RAY; shading++) {
        config.field.shading = (enum rn_shading)shading;
        run_begin("auto", &config);
        ck_assert_str_eq(device_of(run.engine), "cuda:0");
        ck_assert_ptr_nonnull(rn_trainer_field(run.trainer)->on_device);
        const struct rn_train_config *own = rn_trainer_config(run.trainer);
        ck_assert(own->roulette == 1 && own->split_pixels == config.split_pixels);
        ck_assert(own->draw_by_error && own->field.voxels);
        run_end();
    }
    hide_module();
    run_begin("auto", &config);
    ck_assert_str_eq(device_of(run.engine), "cpu");
    ck_assert(rn_trainer_config(run.trainer)->roulette == 1);
    ck_assert(rn_trainer_config(run.trainer)->draw_by_error);
    run_end();
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
    static const char *const kernels[] = {NULL,
                                          "shape->render",
                                          "shape->train",
                                          "shape->shade",
                                          "scatter",
                                          "base_backward",
                                          "rn_gradient",
                                          "update_network",
                                          "rn_order",
                                          "sums_backward",
                                          "rn_place",
                                          "update_planes",
                                          "head_backward",
                                          "update_voxels",
                                          "scatter_voxels"};
    emulate((struct emulation){.skips = kernels[_i]});
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
    ck_assert(rn_trainer_create(engine, run.dataset, &config, 0, &trainer, &said) ==
              RN_ERROR_LIMIT);
    ck_assert_ptr_nonnull(strstr(said.text, "MiB"));
    ck_assert_ptr_nonnull(strstr(said.text, "would fit"));
    printf("%s\n", said.text);
    rn_engine_destroy(&engine);
}
END_TEST

void device_add_with(Suite *suite, const char *name, const TTest *test, void (*make)(void)) {
    TCase *tests = tcase_create(name);
    tcase_add_unchecked_fixture(tests, make, remove_dataset);
    tcase_set_timeout(tests, getenv("RIPNERF_DEVICE_BASE") ? 590 : 120);
    tcase_add_test(tests, test);
    suite_add_tcase(suite, tests);
}

void device_add(Suite *suite, const char *name, const TTest *test) {
    device_add_with(suite, name, test, make_dataset);
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
    return has_device() && emulate((struct emulation){0});
}

int main(void) {
    setvbuf(stdout, NULL, _IOLBF, 0);
    if (!holds_in_a_child(has_device)) return 77; // skipped
    Suite *suite = suite_create("device");
    device_add(suite, "draft", draft_trains);
    device_add(suite, "standard", standard_trains);
    device_add(suite, "paper", paper_trains);
    device_add(suite, "uneven", uneven_planes_train);
    device_add(suite, "step", a_step_is_the_cpus);
    device_add(suite, "mip step", a_step_of_a_mip_is_the_cpus);
    device_add(suite, "anywhere", goes_on_anywhere);
    device_add(suite, "bytes", resumes_to_the_same_bytes);
    device_add_pictures(suite);
    device_add_places(suite);
    device_add_captures(suite);
    device_add(suite, "grows", grows_there_in_parts);
    device_add(suite, "stops", stops_when_asked);
    device_add(suite, "diverges", diverges_and_goes_back);
    bool emulated = holds_in_a_child(is_emulated);
    if (emulated) device_add(suite, "lost", a_lost_device_is_said);
    device_add(suite, "said", what_is_not_there_is_said);
    device_add(suite, "auto", auto_takes_what_there_is);
    if (emulated) {
        TCase *agrees = tcase_create("agrees");
        tcase_add_unchecked_fixture(agrees, NULL, put_back);
        tcase_set_timeout(agrees, 60);
        tcase_add_loop_test(agrees, auto_takes_what_agrees, 0, 15);
        suite_add_tcase(suite, agrees);
    }
    device_add(suite, "memory", memory_is_counted_first);
    return run_suite(suite);
}
