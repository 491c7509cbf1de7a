// What a GPU does in a second: a training's step by stage beside its ceiling, pictures, memory, the
// time until a scene is loaded.
//
//   cuda DATASET [preset=paper] [steps=1000] [size=800] [device=cuda:0] [deterministic=0]
//        [planes=] [base=] [channels=] [levels=] [width=] [occupancy=] [samples=] [step=] [grow=]
//        [rounds=5] [sparse=] [on_chip=0] [tiles=1]
//
// `steps` are trained before anything is measured. Ceilings are those of
// server/engine/cuda/README.md for the paper's configuration, scaled with the samples of a step. No
// test: a tool to measure with.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "server/engine/engine.h"
#include "server/engine/train/trainer.h"

#define A_ROUND 4      // steps by stage, and pictures
#define MOST_ROUNDS 25 // of steps as the product takes them too; the quickest counts

static const double counted_samples = 273e3;
// Milliseconds at the ceiling on an H200 and on an A100; whether it grows with the samples.
static const struct {
    const char *name;
    double ms[2];
    bool per_sample;
} ceilings[] = {
    {"forward", {0.124, 0.213}, true},        {"head backward", {0.127, 0.298}, true},
    {"head gradient", {0.128, 0.300}, true},  {"base backward", {0.117, 0.275}, true},
    {"base gradient", {0.083, 0.194}, true},  {"scatter", {0.040, 0.095}, true},
    {"update planes", {0.313, 0.736}, false}, {"update networks", {0.010, 0.025}, false}};

struct bench {
    const char *dataset_path, *preset, *device;
    int64_t steps;
    int size, deterministic, on_chip, tiles, rounds;
    struct rn_train_config config;
    struct rn_dataset *dataset;
    struct rn_engine *engine;
    struct rn_trainer *trainer;
};

static void check(enum rn_status status, const struct rn_error *err) {
    if (status == RN_OK) return;
    fprintf(stderr, "cuda: %s: %s\n", err->where, err->text);
    exit(1);
}

static bool set_option(struct bench *b, const char *name, const char *value) {
    struct rn_field_config *f = &b->config.field;
    const struct {
        const char *name;
        int *number;
    } table[] = {{"planes", &f->planes},
                 {"base", &f->base},
                 {"channels", &f->channels},
                 {"levels", &f->levels},
                 {"width", &f->width},
                 {"occupancy", &f->occupancy},
                 {"size", &b->size},
                 {"rounds", &b->rounds},
                 {"grow", &b->config.grow_to},
                 {"samples", &b->config.target_samples},
                 {"deterministic", &b->deterministic},
                 {"on_chip", &b->on_chip},
                 {"tiles", &b->tiles}};
    for (size_t i = 0; i < sizeof table / sizeof *table; i++)
        if (strcmp(name, table[i].name) == 0) {
            *table[i].number = atoi(value);
            return true;
        }
    if (strcmp(name, "device") == 0)
        b->device = value;
    else if (strcmp(name, "steps") == 0)
        b->steps = atoll(value);
    else if (strcmp(name, "step") == 0)
        b->config.step = atof(value);
    else if (strcmp(name, "sparse") == 0)
        b->config.sparse = atoi(value) != 0;
    else
        return strcmp(name, "preset") == 0;
    return true;
}

// ---- training -------------------------------------------------------------------------------

static struct rn_progress advance(struct bench *b, int64_t steps) {
    struct rn_progress p;
    struct rn_error err;
    rn_trainer_progress(b->trainer, &p);
    for (int64_t end = p.step + steps; p.step < end;) {
        check(rn_trainer_advance(b->trainer, 0, &err), &err);
        rn_trainer_progress(b->trainer, &p);
    }
    return p;
}

static bool is_counted(const struct rn_field_config *c) {
    return c->planes == 10 && c->base == 512 && c->channels == 16 && c->width == 128;
}

static double ceiling_of(const char *stage, int gpu, double samples) {
    for (size_t i = 0; i < sizeof ceilings / sizeof *ceilings; i++)
        if (strcmp(stage, ceilings[i].name) == 0)
            return ceilings[i].ms[gpu] * (ceilings[i].per_sample ? samples / counted_samples : 1);
    return NAN;
}

// Medians over the rounds' steps, the occupancy's measurement left out.
static int compare(const void *a, const void *b) {
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static void print_stages(struct bench *b, double samples, int gpu) {
    static float ms[RN_DEVICE_STAGES][A_ROUND * MOST_ROUNDS];
    struct rn_device_stage stages[RN_DEVICE_STAGES];
    struct rn_error err;
    int count = 0, timed = A_ROUND * b->rounds;
    double sum = 0, ceiling_sum = 0;
    for (int i = 0; i < timed; i++) {
        check(rn_trainer_time_device(b->trainer, stages, &count, &err), &err);
        for (int s = 0; s < count; s++)
            ms[s][i] = stages[s].ms;
    }
    printf("%-16s %9s %9s %6s\n", "stage", "ms", "ceiling", "share");
    for (int s = 0; s < count; s++) {
        bool counted = is_counted(&b->config.field);
        double ceiling = counted ? ceiling_of(stages[s].name, gpu, samples) : NAN;
        qsort(ms[s], (size_t)timed, sizeof ms[s][0], compare);
        double median = (double)ms[s][timed / 2];
        sum += median;
        ceiling_sum += isnan(ceiling) ? 0 : ceiling;
        printf("%-16s %9.4f %9.4f %6.2f\n", stages[s].name, median, ceiling, ceiling / median);
    }
    printf("%-16s %9.4f %9.4f %6.2f\n", "in series", sum, ceiling_sum, ceiling_sum / sum);
}

static void measure_training(struct bench *b, const char *name) {
    struct rn_progress before = advance(b, b->steps), after = before;
    int gpu = strstr(name, "A100") != NULL;
    double best = INFINITY;
    for (int i = 0; i < b->rounds; i++) {
        before = advance(b, 0);
        int64_t begin = rn_clock_ns();
        after = advance(b, b->steps < 160 ? b->steps : 160);
        double ms = (double)(rn_clock_ns() - begin) * 1e-6 / (double)(after.step - before.step);
        best = fmin(best, ms);
    }
    double samples = (double)(after.samples - before.samples) / (double)(after.step - before.step);
    printf("step: %.4f ms, %.0f samples, %.0f rays, %.1f Msamples/s; ceilings of %s\n", best,
           samples, (double)(after.rays - before.rays) / (double)(after.step - before.step),
           samples / best * 1e-3, gpu ? "an A100" : "an H200");
    print_stages(b, samples, gpu);
}

// ---- pictures -------------------------------------------------------------------------------

static void measure_frame(struct bench *b, struct rn_field *field, const char *what, double step,
                          double stop, int subsample) {
    struct rn_render_options options = {
        .outputs = RN_OUTPUT_RGB,
        .settings = {.step = step, .stop = stop, .subsample = subsample},
        .background = {1, 1, 1}};
    struct rn_error err;
    double best = INFINITY, samples = 0;
    int frames = A_ROUND * b->rounds;
    for (int i = 0; i < frames; i++) {
        struct rn_render_result result;
        const struct rn_frame *frame =
            &b->dataset->frames[(size_t)i * b->dataset->frame_count / (size_t)frames];
        options.camera = rn_camera_resized(&frame->camera, b->size, b->size);
        check(rn_render(b->engine, field, &options, NULL, NULL, &result, &err), &err);
        best = fmin(best, result.stats.render_ms);
        samples += (double)result.stats.samples / frames;
        rn_render_result_finish(&result);
    }
    printf("frame %dx%d, %s: %.2f ms, %.0f a second, %.2f M samples\n", b->size, b->size, what,
           best, 1e3 / best, samples * 1e-6);
}

static void measure_rendering(struct bench *b) {
    char path[] = "/tmp/ripnerf-bench-XXXXXX";
    struct rn_error err = {0};
    struct rn_field *field;
    double step = b->config.step;
    int file = mkstemp(path);
    if (file < 0) exit(1);
    close(file);
    check(rn_trainer_save(b->trainer, path, &err), &err);
    rn_trainer_destroy(&b->trainer);
    int64_t begin = rn_clock_ns();
    check(rn_field_load(b->engine, path, &field, &err), &err);
    printf("loaded in %.0f ms\n", (double)(rn_clock_ns() - begin) * 1e-6);
    measure_frame(b, field, "full quality", 0, 0, 1);
    measure_frame(b, field, "twice the step", 2 * step, 1e-2, 1);
    measure_frame(b, field, "every second pixel", 0, 0, 2);
    rn_field_destroy(&field);
    unlink(path);
}

// ---- main -----------------------------------------------------------------------------------

static void read_options(struct bench *b, int argc, char **argv) {
    struct rn_error err = {0};
    b->dataset_path = argv[1];
    for (int i = 2; i < argc; i++)
        if (strncmp(argv[i], "preset=", 7) == 0) b->preset = argv[i] + 7;
    check(rn_dataset_read(b->dataset_path, NULL, &b->dataset, &err), &err);
    check(rn_preset(b->preset, b->dataset->scale_count > 1, &b->config, &err), &err);
    for (int i = 2; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        if (value) *value++ = 0;
        if (value && set_option(b, argv[i], value)) continue;
        fprintf(stderr, "cuda: no option '%s'\n", argv[i]);
        exit(2);
    }
    if (b->rounds < 1 || b->rounds > MOST_ROUNDS) {
        fprintf(stderr, "cuda: rounds must be 1 to %d\n", MOST_ROUNDS);
        exit(2);
    }
    b->config.max_steps = 0; // planes at their final size, a constant rate
    b->config.max_seconds = 0;
}

int main(int argc, char **argv) {
    struct bench b = {
        .preset = "paper", .device = "cuda:0", .steps = 1000, .size = 800, .rounds = 5};
    struct rn_error err = {0};
    struct rn_device_info info;
    if (argc < 2) {
        fprintf(stderr, "usage: cuda DATASET [name=value ...]\n");
        return 2;
    }
    setvbuf(stdout, NULL, _IOLBF, 0);
    read_options(&b, argc, argv);
    struct rn_engine_options options = {.device = b.device,
                                        .deterministic = b.deterministic != 0,
                                        .last_on_chip = b.on_chip != 0,
                                        .two_tiles = b.tiles == 2};
    check(rn_engine_create(&options, &b.engine, &err), &err);
    rn_engine_describe(b.engine, &info);
    printf("%s, %s, preset %s%s\n", info.name, info.kernels, b.preset,
           b.deterministic ? ", deterministic" : "");
    check(rn_trainer_create(b.engine, b.dataset, &b.config, 0, &b.trainer, &err), &err);
    if (!b.trainer->field->on_device) {
        fprintf(stderr, "cuda: %s is no GPU\n", info.device);
        return 1;
    }
    printf("memory: %.0f MB of the device's in training\n",
           (double)b.engine->backend->used_bytes(b.engine->device) * 1e-6);
    measure_training(&b, info.name);
    measure_rendering(&b);
    rn_engine_destroy(&b.engine);
    rn_dataset_destroy(&b.dataset);
    return 0;
}
