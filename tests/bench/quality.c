// Quality over seconds: trains on a dataset and prints held-out and test PSNR with their times.
//
//   quality DATASET [preset=standard] [time=60] [steps=0] [seed=1] [threads=0] [kernels=auto]
//           [test=0] [split=test|train] [any training setting by its name: planes=3 width=64 ...]
//           [device=auto|cpu|cuda|cuda:N] [deterministic=0] [memory=BYTES] [every=5] [goals=DB,DB]
//           [out=PREFIX] [save=CHECKPOINT] [resume=CHECKPOINT] [wall=SECONDS] [cones=both|own|one]
//           [fit=exposure|pose|appearance] [an effect by its name: robust-loss=auto|on|off ...]
//
// clock=cpu with threads=1 counts CPU seconds, for comparisons on a machine that is not idle.
// A device that is named trains and renders everything or the program fails; memory= is what it may
// take of it. goals= evaluates the test views every `every` seconds, one cone a pixel, and says
// when their mean over scales reached each. wall= ends the program after so many seconds of its own
// with exit code 75, and what was trained saved: resume= goes on there, with that training's
// settings. every=0 evaluates nothing on the way. cones= says how many a pixel of a test view has:
// the scene's own number, one, or both. fit=exposure also scores each test view's halves with a
// gain and an offset fitted on the other, fit=pose with its camera too,
// fit=appearance with its appearance (where the scene has such). One line per held-out
// evaluation, one line per test scale. No test: a tool to measure with.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "common/base/clock.h"
#include "server/engine/engine.h"

#define UNFINISHED 75 // the exit code of a training that another call goes on with
#define GOALS 4

struct run {
    const char *preset, *out, *save, *resume;
    double every, begin, wall, goals[GOALS]; // seconds; dB from low to high
    int goal_count, test, cones; // of a pixel: 0 the scene's own number and one, 1 that, 2 one
    unsigned fit;
    enum rn_split split; // that `test` looks at
    struct rn_engine_options options;
    struct rn_train_config config;
    const struct rn_dataset *dataset;
    struct rn_engine *engine;
};

// The process's CPU time: what one thread would take on an idle machine, however busy this one is.
static int64_t cpu_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static double wall_seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void die(const struct rn_error *err) {
    fprintf(stderr, "quality: %s: %s\n", err->where, err->text);
    exit(1);
}

// Short names for some of the table's.
static const char *setting_name(const char *name) {
    static const char *const names[][2] = {
        {"grow", "grow_to"},          {"fbase", "footprint_base"}, {"samples", "target_samples"},
        {"rays", "initial_rays"},     {"time", "max_seconds"},     {"steps", "max_steps"},
        {"rate", "learning_rate"},    {"decay", "weight_decay"},   {"until", "until_psnr"},
        {"auto", "auto_effects"},     {"cone", "cone_step"},       {"finest", "favour_finest"},
        {"by_error", "draw_by_error"}};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (strcmp(name, names[i][0]) == 0) return names[i][1];
    return name;
}

// A setting of the training by its name in the table; `base` is that at the first step. Numbers
// are taken as they are, within range or not: rn_trainer_create checks them.
static bool set_setting(struct rn_train_config *config, const char *name, const char *value) {
    const struct rn_setting *row = rn_settings_find(&rn_train_settings, setting_name(name));
    union rn_setting_value parsed;
    if (!row) return false;
    if (rn_setting_parse(row, value, &parsed, NULL) == RN_OK)
        rn_setting_put(row, &parsed, config);
    else if (row->type == RN_SETTING_CHOICE || row->choices)
        return false;
    else
        rn_setting_put_number(row, atof(value), config);
    if (strcmp(name, "time") == 0) rn_train_config_suit_time(config);
    if (strcmp(name, "steps") == 0) config->max_seconds = 0;
    return true;
}

static void set_goals(struct run *run, const char *values) {
    for (char *end; run->goal_count < GOALS; values = end + 1) {
        run->goals[run->goal_count++] = strtod(values, &end);
        if (*end != ',') break;
    }
}

// An effect by its name: auto, on or off.
static bool set_effect(struct rn_train_config *config, const char *name, const char *value) {
    for (int e = 0; e < RN_EFFECT_COUNT; e++)
        for (int c = 0; c < 3 && strcmp(name, rn_effect_name((enum rn_effect)e)) == 0; c++)
            if (strcmp(value, rn_effect_choice_names[c]) == 0) {
                config->effect[e] = (enum rn_effect_choice)c;
                return true;
            }
    return false;
}

static bool set_option(struct run *run, const char *name, const char *value) {
    if (strcmp(name, "preset") == 0)
        return true;
    else if (strcmp(name, "threads") == 0)
        run->options.threads = atoi(value);
    else if (strcmp(name, "device") == 0)
        run->options.device = strcmp(value, "cuda") == 0 ? "cuda:0" : value;
    else if (strcmp(name, "deterministic") == 0)
        run->options.deterministic = atoi(value) != 0;
    else if (strcmp(name, "memory") == 0)
        run->options.device_memory_bytes = (size_t)atof(value);
    else if (strcmp(name, "goals") == 0)
        set_goals(run, value);
    else if (strcmp(name, "wall") == 0)
        run->wall = atof(value);
    else if (strcmp(name, "resume") == 0)
        run->resume = value;
    else if (strcmp(name, "test") == 0)
        run->test = atoi(value);
    else if (strcmp(name, "cones") == 0)
        run->cones = strcmp(value, "own") == 0 ? 1 : strcmp(value, "one") == 0 ? 2 : 0;
    else if (strcmp(name, "fit") == 0)
        run->fit = RN_FIT_EXPOSURE | (strcmp(value, "pose") == 0         ? RN_FIT_POSE
                                      : strcmp(value, "appearance") == 0 ? RN_FIT_APPEARANCE
                                                                         : 0);
    else if (strcmp(name, "every") == 0)
        run->every = atof(value);
    else if (strcmp(name, "clock") == 0)
        rn_clock_set_source(strcmp(value, "cpu") == 0 ? cpu_ns : NULL, NULL);
    else if (strcmp(name, "split") == 0)
        run->split = strcmp(value, "train") == 0 ? RN_SPLIT_TRAIN : RN_SPLIT_TEST;
    else if (strcmp(name, "kernels") == 0)
        run->options.kernels = value;
    else if (strcmp(name, "out") == 0)
        run->out = value;
    else if (strcmp(name, "save") == 0)
        run->save = value;
    else
        return set_effect(&run->config, name, value) || set_setting(&run->config, name, value);
    return true;
}

static void write_view(const struct run *run, struct rn_field *field,
                       const struct rn_frame *frame) {
    struct rn_error err;
    struct rn_render_options options = {.camera = frame->camera, .outputs = RN_OUTPUT_RGB};
    memcpy(options.background, run->config.background, sizeof options.background);
    struct rn_render_result result;
    struct rn_image image;
    char path[512];
    snprintf(path, sizeof path, "%s%s_%d.png", run->out, frame->name, frame->scale);
    if (rn_render(run->engine, field, &options, NULL, NULL, &result, &err) != RN_OK ||
        rn_picture_to_image(&result.rgb, &image, &err) != RN_OK ||
        rn_image_write_png(&image, path, 3, &err) != RN_OK)
        die(&err);
    rn_image_finish(&image);
    rn_render_result_finish(&result);
}

// Whether a device was asked for by its name.
static bool insists(const struct run *run) {
    return run->options.device && strncmp(run->options.device, "cuda", 4) == 0;
}

// Means over the views of a scale.
struct score {
    double psnr, ssim, ms, fitted;
    int views;
};

static struct score score_of(const struct run *run, struct rn_field *field, int scale,
                             int supersample) {
    struct rn_render_options options = {.settings = {.supersample = supersample},
                                        .fit = supersample ? 0 : run->fit};
    const struct rn_dataset *dataset = run->dataset;
    struct score sum = {0};
    struct rn_error err;
    int views = 0, seen = 0;
    memcpy(options.background, run->config.background, sizeof options.background);
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *f = &dataset->frames[i];
        views += f->split == run->split && f->scale == 0;
    }
    int stride = run->test < views ? views / run->test : 1;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *f = &dataset->frames[i];
        if (f->split != run->split || f->scale != scale || seen++ % stride) continue;
        struct rn_view_score s;
        if (rn_evaluate_view(run->engine, field, f, &options, NULL, NULL, &s, &err) != RN_OK)
            die(&err);
        if (insists(run) && !s.on_device) {
            fprintf(stderr, "quality: %s: was rendered on the CPU, not on %s\n", f->name,
                    run->options.device);
            exit(1);
        }
        if (run->out) write_view(run, field, f);
        sum.psnr += s.psnr;
        sum.ssim += s.ssim;
        sum.ms += s.render_ms;
        sum.fitted += s.psnr_fitted;
        sum.views++;
    }
    return (struct score){sum.psnr / sum.views, sum.ssim / sum.views, sum.ms / sum.views,
                          sum.fitted / sum.views, sum.views};
}

// `supersample`: as of a rendering.
static void test(const struct run *run, struct rn_field *field, int supersample) {
    const char *cones = supersample == 1 ? " one cone a pixel," : "";
    double total = 0;
    for (int scale = 0; scale < run->dataset->scale_count; scale++) {
        struct score s = score_of(run, field, scale, supersample);
        printf("test%s scale %d: psnr %.2f ssim %.4f views %d render_ms %.1f\n", cones, scale,
               s.psnr, s.ssim, s.views, s.ms);
        if (run->fit && !supersample) printf("test fitted: psnr %.2f\n", s.fitted);
        total += s.psnr;
    }
    printf("test%s mean over scales: %.2f\n", cones, total / run->dataset->scale_count);
}

// Says which goals the test views have reached since the last look.
static void look_at_goals(struct run *run, struct rn_trainer *trainer) {
    struct rn_progress p;
    double total = 0;
    if (run->goal_count == 0) return;
    rn_trainer_progress(trainer, &p);
    for (int scale = 0; scale < run->dataset->scale_count; scale++)
        total += score_of(run, rn_trainer_field(trainer), scale, 1).psnr;
    double mean = total / run->dataset->scale_count;
    printf("goals: %.2f dB after %.2f s, %lld steps\n", mean, p.train_seconds, (long long)p.step);
    for (; run->goal_count > 0 && mean >= run->goals[0]; run->goal_count--) {
        printf("goal %.2f dB reached after %.2f s, %lld steps\n", run->goals[0], p.train_seconds,
               (long long)p.step);
        memmove(run->goals, run->goals + 1, (GOALS - 1) * sizeof *run->goals);
    }
}

static void report(struct rn_trainer *trainer) {
    struct rn_progress p;
    rn_trainer_progress(trainer, &p);
    printf(
        "step %6lld  %6.2f s  psnr %.2f  loss %.6f  %.2f Msamples/s  %.0f krays/s  rays/step %.0f  "
        "levels %.2f  between steps %.2f s\n",
        (long long)p.step, p.train_seconds, p.psnr_step == p.step ? p.psnr : NAN, p.loss,
        p.samples_per_second * 1e-6, p.rays_per_second * 1e-3,
        (double)p.rays / (double)(p.step ? p.step : 1),
        p.samples ? 1 - (double)p.level_samples[0] / (double)p.samples : 0, p.turn_seconds);
    fflush(stdout);
}

// Trains until it is done or `wall` is over; whether it is done.
static bool train(struct run *run, struct rn_trainer *trainer) {
    struct rn_progress p;
    struct rn_error err;
    rn_trainer_progress(trainer, &p);
    double next = run->every;
    while (run->resume && run->every > 0 && next <= p.train_seconds)
        next += run->every;
    while (!p.done) {
        if (rn_trainer_advance(trainer, 50, &err) != RN_OK) die(&err);
        rn_trainer_progress(trainer, &p);
        if (!p.done && run->wall > 0 && wall_seconds() >= run->begin + run->wall) break;
        if (run->every <= 0 || (!p.done && p.train_seconds < next)) continue;
        bool done = rn_trainer_figure(trainer) == RN_FIGURE_NONE;
        while (!done)
            if (rn_trainer_validate(trainer, 1000, &done, &err) != RN_OK) die(&err);
        report(trainer);
        look_at_goals(run, trainer);
        next += run->every;
    }
    if (run->save && rn_trainer_save(trainer, run->save, &err) != RN_OK) die(&err);
    if (!p.done) printf("unfinished after %lld steps\n", (long long)p.step);
    return p.done;
}

static void describe(const struct rn_field *field) {
    struct rn_field_info info;
    char hash[65];
    rn_field_describe(field, &info);
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        printf("effect %s: %s (%s)\n", info.effects[i].name, info.effects[i].on ? "on" : "off",
               info.effects[i].reason);
    rn_field_sha256(field, hash);
    printf("trained with %s\n", info.kernels);
    printf("parameters %.16s\n", hash);
}

static struct rn_trainer *begin(struct run *run) {
    struct rn_trainer *trainer;
    struct rn_error err = {0};
    enum rn_status status = rn_engine_create(&run->options, &run->engine, &err);
    if (status == RN_OK && run->resume)
        status = rn_trainer_restore(run->engine, run->dataset, run->resume, 0, &trainer, &err);
    else if (status == RN_OK)
        status = rn_trainer_create(run->engine, run->dataset, &run->config, 0, &trainer, &err);
    if (status != RN_OK) die(&err);
    run->config = *rn_trainer_config(trainer);
    return trainer;
}

static void read_options(struct run *run, int argc, char **argv) {
    struct rn_error err = {0};
    for (int i = 2; i < argc; i++)
        if (strncmp(argv[i], "preset=", 7) == 0) run->preset = argv[i] + 7;
    if (rn_preset(run->preset, run->dataset->scale_count > 1, &run->config, &err) != RN_OK)
        die(&err);
    for (int i = 2; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        if (value) *value++ = 0;
        if (value && set_option(run, argv[i], value)) continue;
        fprintf(stderr, "quality: no option '%s'\n", argv[i]);
        exit(2);
    }
    if (run->goal_count > 0 && run->test == 0) {
        fprintf(stderr, "quality: goals= needs test=, the number of test views\n");
        exit(2);
    }
}

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct run run = {
        .preset = "standard", .every = 5, .begin = wall_seconds(), .split = RN_SPLIT_TEST};
    struct rn_dataset *dataset;
    if (argc < 2) {
        fprintf(stderr, "usage: quality DATASET [name=value ...]\n");
        return 2;
    }
    if (rn_dataset_read(argv[1], NULL, &dataset, &err) != RN_OK) die(&err);
    run.dataset = dataset;
    read_options(&run, argc, argv);
    struct rn_trainer *trainer = begin(&run);
    bool done = train(&run, trainer);
    struct rn_field *field = rn_trainer_finish(&trainer);
    if (done) describe(field);
    for (int cones = 0; cones < 2 && run.test > 0 && done; cones++)
        if (run.cones == 0 || run.cones == cones + 1) test(&run, field, cones);
    rn_field_destroy(&field);
    rn_engine_destroy(&run.engine);
    rn_dataset_destroy(&dataset);
    return done ? 0 : UNFINISHED;
}
