#include "server/engine/bench/bench.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/engine/bench/machine.h"
#include "server/engine/bench/scene.h"
#include "server/engine/bench/stages.h"
#include "server/engine/engine.h"

// Shares of the time given; the rest is the scene's.
#define SHARE_SETTLE 0.3 // training before it is timed, so that the occupancy settles
#define SHARE_TRAIN 0.2
#define SHARE_FRAME 0.05
#define SHARE_MACHINE 0.15
#define SHARE_STAGES 0.2
#define FRAME_SECONDS 3.0 // that a frame may take even when little time is given

struct run {
    const struct rn_bench_options *options;
    struct rn_bench_result *result;
    struct rn_engine *engine;
    struct rn_bench_scene scene;
    struct rn_trainer *trainer;
    void (*progress)(const char *what);
};

static void say(const struct run *run, const char *what) {
    if (run->progress) run->progress(what);
}

static enum rn_status create_trainer(struct run *run, struct rn_error *err) {
    struct rn_train_config config;
    const char *preset = run->options->preset ? run->options->preset : "standard";
    enum rn_status status = rn_preset(preset, false, &config, err);
    if (status != RN_OK) return status;
    config.max_steps = 0;
    config.max_seconds = 1e6;
    snprintf(run->result->preset, sizeof run->result->preset, "%s", preset);
    return rn_trainer_create(run->engine, &run->scene.dataset, &config, 0, &run->trainer, err);
}

// Whole steps for `seconds` of training.
static enum rn_status advance(struct run *run, double seconds, struct rn_progress *ret_before,
                              struct rn_progress *ret_after, struct rn_error *err) {
    rn_trainer_progress(run->trainer, ret_before);
    do {
        enum rn_status status = rn_trainer_advance(run->trainer, 1, err);
        if (status != RN_OK) return status;
        rn_trainer_progress(run->trainer, ret_after);
    } while (run->trainer->step.under_way ||
             ret_after->train_seconds - ret_before->train_seconds < seconds);
    return RN_OK;
}

static enum rn_status train(struct run *run, struct rn_error *err) {
    struct rn_progress before, after;
    double seconds = run->options->seconds;
    enum rn_status status = advance(run, seconds * SHARE_SETTLE, &before, &after, err);
    if (status == RN_OK) status = advance(run, seconds * SHARE_TRAIN, &before, &after, err);
    if (status != RN_OK) return status;
    double steps = (double)(after.step - before.step);
    double spent = after.train_seconds - before.train_seconds;
    double samples = (double)(after.samples - before.samples);
    run->result->step.ms = spent * 1e3 / steps;
    run->result->step.samples = samples / steps;
    run->result->step.rays = (double)(after.rays - before.rays) / steps;
    run->result->step.samples_per_second_per_core = samples / spent / run->result->threads;
    return RN_OK;
}

// One frame; *ret_ms and the samples of a frame of that size.
static enum rn_status render_once(struct run *run, const struct rn_camera *camera, double *ret_ms,
                                  double *ret_samples, struct rn_error *err) {
    struct rn_render_options options = {
        .camera = *camera, .outputs = RN_OUTPUT_RGB, .background = {1, 1, 1}};
    struct rn_render_result result;
    enum rn_status status =
        rn_render(run->engine, run->trainer->field, &options, NULL, NULL, &result, err);
    if (status != RN_OK) return status;
    *ret_ms = result.stats.render_ms;
    *ret_samples = (double)result.stats.samples;
    rn_render_result_finish(&result);
    return RN_OK;
}

// The middle of a camera's picture.
static struct rn_camera middle_of(struct rn_camera camera, int size) {
    camera.width = camera.height = size;
    camera.cx = camera.cy = 0.5 * size;
    return camera;
}

// The best of several frames; the middle of one where a small part says that a whole one takes
// longer than FRAME_SECONDS or its share of the time given.
static enum rn_status render_frame(struct run *run, struct rn_error *err) {
    double least = INFINITY, ms = 0, samples = 0, seconds = run->options->seconds;
    struct rn_camera camera;
    enum rn_status status = rn_bench_camera(3, 7, &camera);
    int size = RN_BENCH_SIZE / 8;
    camera = middle_of(camera, size);
    if (status == RN_OK) status = render_once(run, &camera, &ms, &samples, err);
    double limit_ms = 1e3 * fmax(FRAME_SECONDS, SHARE_FRAME * seconds);
    for (; size < RN_BENCH_SIZE && 4 * ms < limit_ms; size *= 2)
        ms *= 4;
    camera = middle_of(camera, size);
    int64_t begin = rn_clock_ns();
    for (int i = 0; status == RN_OK &&
                    (i < 1 || (double)(rn_clock_ns() - begin) * 1e-9 < SHARE_FRAME * seconds);
         i++) {
        status = render_once(run, &camera, &ms, &samples, err);
        least = fmin(least, ms);
    }
    run->result->frame.ms = least;
    run->result->frame.samples = samples;
    run->result->frame.width = run->result->frame.height = size;
    return status;
}

static enum rn_status measure_stages(struct run *run, struct rn_error *err) {
    struct rn_bench_recording recording;
    enum rn_status status = rn_engine_prepare(run->engine, run->trainer->field, err);
    if (status == RN_OK) status = rn_bench_record(run->trainer, &recording, err);
    if (status != RN_OK) return status;
    rn_bench_stages(&recording, &run->result->machine, run->options->seconds * SHARE_STAGES,
                    run->result);
    rn_bench_recording_finish(&recording);
    return RN_OK;
}

static enum rn_status run_all(struct run *run, struct rn_error *err) {
    say(run, "photographs of a procedural scene");
    enum rn_status status = rn_bench_scene_init(run->engine->pool, &run->scene, err);
    if (status == RN_OK) status = create_trainer(run, err);
    if (status != RN_OK) return status;
    say(run, "training");
    if ((status = train(run, err)) != RN_OK) return status;
    say(run, "a frame");
    if ((status = render_frame(run, err)) != RN_OK) return status;
    say(run, "the machine");
    rn_bench_machine_measure(run->engine->kernels->name, run->options->seconds * SHARE_MACHINE,
                             &run->result->machine);
    say(run, "each stage");
    return measure_stages(run, err);
}

enum rn_status rn_bench_run(const struct rn_bench_options *options,
                            void (*progress)(const char *what), struct rn_bench_result *ret_result,
                            struct rn_error *err) {
    struct rn_bench_result result = {0};
    struct run run = {.options = options, .result = &result, .progress = progress};
    struct rn_engine_options engine = {
        .device = "cpu", .kernels = options->kernels, .threads = options->threads};
    struct rn_device_info info;
    if (!(options->seconds >= 0.5 && options->seconds <= 3600))
        return rn_error_set(err, RN_ERROR_INVALID, "seconds", "must be 0.5 to 3600");
    if (getloadavg(&result.machine.load, 1) != 1) result.machine.load = NAN;
    enum rn_status status = rn_engine_create(&engine, &run.engine, err);
    if (status != RN_OK) return status;
    rn_engine_describe(run.engine, &info);
    result.threads = info.threads;
    snprintf(result.kernels, sizeof result.kernels, "%s", info.kernels);
    snprintf(result.machine.cpu, sizeof result.machine.cpu, "%s", info.name);
    status = run_all(&run, err);
    rn_trainer_destroy(&run.trainer);
    rn_bench_scene_finish(&run.scene);
    rn_engine_destroy(&run.engine);
    if (status == RN_OK) *ret_result = result;
    return status;
}
