// Quality over seconds: trains on a dataset and prints held-out and test PSNR with their times.
//
//   quality DATASET [preset=standard] [time=60] [steps=0] [seed=1] [threads=0] [kernels=auto]
//           [test=0] [split=test|train] [any training setting by its name: planes=3 width=64 ...]
//           [every=5] [out=PREFIX] [save=CHECKPOINT]
//
// clock=cpu with threads=1 counts CPU seconds, for comparisons on a machine that is not idle.
// One line per held-out evaluation, one line per test scale. No test: a tool to measure with.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "common/base/clock.h"
#include "server/engine/engine.h"

struct run {
    const char *dataset, *preset, *kernels, *out, *save;
    double every;
    int threads, test;
    enum rn_split split; // that `test` looks at
    struct rn_train_config config;
};

// The process's CPU time: what one thread would take on an idle machine, however busy this one is.
static int64_t cpu_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
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

static bool set_option(struct run *run, const char *name, const char *value) {
    if (strcmp(name, "preset") == 0)
        return true;
    else if (strcmp(name, "threads") == 0)
        run->threads = atoi(value);
    else if (strcmp(name, "test") == 0)
        run->test = atoi(value);
    else if (strcmp(name, "every") == 0)
        run->every = atof(value);
    else if (strcmp(name, "clock") == 0)
        rn_clock_set_source(strcmp(value, "cpu") == 0 ? cpu_ns : NULL, NULL);
    else if (strcmp(name, "split") == 0)
        run->split = strcmp(value, "train") == 0 ? RN_SPLIT_TRAIN : RN_SPLIT_TEST;
    else if (strcmp(name, "kernels") == 0)
        run->kernels = value;
    else if (strcmp(name, "out") == 0)
        run->out = value;
    else if (strcmp(name, "save") == 0)
        run->save = value;
    else
        return set_setting(&run->config, name, value);
    return true;
}

static void write_view(struct run *run, struct rn_engine *engine, struct rn_field *field,
                       const struct rn_frame *frame) {
    struct rn_error err;
    struct rn_render_options options = {.camera = frame->camera, .outputs = RN_OUTPUT_RGB};
    memcpy(options.background, run->config.background, sizeof options.background);
    struct rn_render_result result;
    struct rn_image image;
    char path[512];
    snprintf(path, sizeof path, "%s%s_%d.png", run->out, frame->name, frame->scale);
    if (rn_render(engine, field, &options, NULL, NULL, &result, &err) != RN_OK ||
        rn_picture_to_image(&result.rgb, &image, &err) != RN_OK ||
        rn_image_write_png(&image, path, 3, &err) != RN_OK)
        die(&err);
    rn_image_finish(&image);
    rn_render_result_finish(&result);
}

// `supersample`: as of a rendering.
static void test(struct run *run, struct rn_engine *engine, struct rn_field *field,
                 const struct rn_dataset *dataset, int supersample) {
    struct rn_render_options options = {.settings = {.supersample = supersample}};
    memcpy(options.background, run->config.background, sizeof options.background);
    struct rn_error err;
    int views = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *f = &dataset->frames[i];
        views += f->split == run->split && f->scale == 0;
    }
    int stride = run->test < views ? views / run->test : 1;
    double total = 0;
    for (int scale = 0; scale < dataset->scale_count; scale++) {
        double psnr = 0, ssim = 0, ms = 0;
        int n = 0, seen = 0;
        for (size_t i = 0; i < dataset->frame_count; i++) {
            const struct rn_frame *f = &dataset->frames[i];
            if (f->split != run->split || f->scale != scale || seen++ % stride) continue;
            struct rn_view_score s;
            if (rn_evaluate_view(engine, field, f, &options, NULL, NULL, &s, &err) != RN_OK)
                die(&err);
            if (run->out && n < 4) write_view(run, engine, field, f);
            psnr += s.psnr;
            ssim += s.ssim;
            ms += s.render_ms;
            n++;
        }
        printf("test%s scale %d: psnr %.2f ssim %.4f views %d render_ms %.1f\n",
               supersample == 1 ? " one cone a pixel," : "", scale, psnr / n, ssim / n, n, ms / n);
        total += psnr / n;
    }
    printf("test%s mean over scales: %.2f\n", supersample == 1 ? " one cone a pixel," : "",
           total / dataset->scale_count);
}

static void report(struct rn_trainer *trainer) {
    struct rn_progress p;
    rn_trainer_progress(trainer, &p);
    printf(
        "step %6lld  %6.2f s  psnr %.2f  loss %.6f  %.2f Msamples/s  %.0f krays/s  rays/step %.0f  "
        "levels %.2f\n",
        (long long)p.step, p.train_seconds, p.psnr, p.loss, p.samples_per_second * 1e-6,
        p.rays_per_second * 1e-3, (double)p.rays / (double)(p.step ? p.step : 1),
        p.samples ? 1 - (double)p.level_samples[0] / (double)p.samples : 0);
    fflush(stdout);
}

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct run run = {.preset = "standard", .every = 5, .split = RN_SPLIT_TEST};
    if (argc < 2) {
        fprintf(stderr, "usage: quality DATASET [name=value ...]\n");
        return 2;
    }
    struct rn_dataset *dataset;
    if (rn_dataset_read(argv[1], NULL, &dataset, &err) != RN_OK) die(&err);
    for (int i = 2; i < argc; i++)
        if (strncmp(argv[i], "preset=", 7) == 0) run.preset = argv[i] + 7;
    if (rn_preset(run.preset, dataset->scale_count > 1, &run.config, &err) != RN_OK) die(&err);
    for (int i = 2; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        if (value) *value++ = 0;
        if (!value || !set_option(&run, argv[i], value)) {
            fprintf(stderr, "quality: no option '%s'\n", argv[i]);
            return 2;
        }
    }
    struct rn_engine *engine;
    struct rn_trainer *trainer;
    struct rn_engine_options options = {.threads = run.threads, .kernels = run.kernels};
    if (rn_engine_create(&options, &engine, &err) != RN_OK) die(&err);
    if (rn_trainer_create(engine, dataset, &run.config, 0, &trainer, &err) != RN_OK) die(&err);
    run.config = *rn_trainer_config(trainer);
    double next = run.every;
    for (;;) {
        struct rn_progress p;
        if (rn_trainer_advance(trainer, 50, &err) != RN_OK) die(&err);
        rn_trainer_progress(trainer, &p);
        if (!p.done && p.train_seconds < next) continue;
        bool done = false;
        while (!done)
            if (rn_trainer_validate(trainer, 1000, &done, &err) != RN_OK) die(&err);
        report(trainer);
        next += run.every;
        rn_trainer_progress(trainer, &p);
        if (p.done) break;
    }
    if (run.save && rn_trainer_save(trainer, run.save, &err) != RN_OK) die(&err);
    struct rn_field_info info;
    rn_field_describe(rn_trainer_field(trainer), &info);
    for (int i = 0; i < RN_EFFECT_COUNT; i++)
        printf("effect %s: %s (%s)\n", info.effects[i].name, info.effects[i].on ? "on" : "off",
               info.effects[i].reason);
    char hash[65];
    rn_field_sha256(rn_trainer_field(trainer), hash);
    printf("parameters %.16s\n", hash);
    struct rn_field *field = rn_trainer_finish(&trainer);
    for (int cones = 0; cones < 2 && run.test > 0; cones++)
        test(&run, engine, field, dataset, cones);
    rn_field_destroy(&field);
    rn_engine_destroy(&engine);
    rn_dataset_destroy(&dataset);
    return 0;
}
