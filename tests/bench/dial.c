// The renderer's dial: what accuracy costs in time, on a trained scene.
//
//   dial CHECKPOINT DATASET [split=test] [every=10] [rounds=7] [threads=0] [background=1]
//        [kernels=auto] [SETTING ...]
//
// A SETTING is a comma list of step=, stop=, subsample=, supersample=, tolerance= (engine.h), or
// `full`; without any, a table of them. Every `every`-th view of the split is rendered with each
// setting in turn, `rounds` times over, so that a busy machine slows all of them alike. A line a
// setting: mean PSNR against the photographs, rays a pixel, samples a frame, and the median over
// the views of the least milliseconds, of the clock and of one thread's CPU. No test: a tool to
// measure with.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "common/image/image.h"
#include "common/image/metrics.h"
#include "server/engine/engine.h"

#define MAX_SETTINGS 32
#define MAX_VIEWS 64

struct setting {
    const char *name;
    struct rn_render_options options;
    double psnr, rays, samples, ms[MAX_VIEWS], cpu_ms[MAX_VIEWS];
};

struct dial {
    struct rn_dataset *dataset;
    struct rn_engine *engine;
    struct rn_field *field;
    int split, every, rounds, threads;
    const char *kernels;
    float background;
    struct setting settings[MAX_SETTINGS];
    int count;
};

static const char *const usual[] = {
    "full",           "step=0.0075",    "step=0.01,stop=0.05",      "subsample=2",
    "tolerance=0.01", "tolerance=0.02", "tolerance=0.03",           "tolerance=0.04",
    "tolerance=0.06", "tolerance=0.1",  "tolerance=0.03,stop=0.05", "tolerance=0.03,step=0.0075"};

static void die(const struct rn_error *err) {
    fprintf(stderr, "dial: %s: %s\n", err->where, err->text);
    exit(1);
}

// The process's CPU time: what one thread would take on an idle machine, however busy this one is.
static double cpu_ms(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec * 1e3 + (double)t.tv_nsec * 1e-6;
}

static bool add_setting(struct dial *dial, const char *text) {
    struct setting *s = &dial->settings[dial->count];
    char copy[128], *rest = NULL;
    if (dial->count == MAX_SETTINGS || strlen(text) >= sizeof copy) return false;
    memset(s, 0, sizeof *s);
    s->name = text;
    strcpy(copy, text);
    for (char *name = strtok_r(copy, ",", &rest); name; name = strtok_r(NULL, ",", &rest)) {
        char *value = strchr(name, '=');
        if (value) *value++ = 0;
        if (strcmp(name, "full") == 0) continue;
        if (!value) return false;
        const struct rn_setting *row = rn_settings_find(&rn_render_settings, name);
        union rn_setting_value parsed;
        if (!row || rn_setting_parse(row, value, &parsed, NULL) != RN_OK) return false;
        rn_setting_put(row, &parsed, &s->options.settings);
    }
    dial->count++;
    return true;
}

static bool set_option(struct dial *dial, const char *text) {
    static const char *const splits[] = {"train", "val", "test"};
    const char *value = strchr(text, '=');
    if (!value) return false;
    size_t size = (size_t)(++value - text);
    if (strncmp(text, "split=", size) == 0) {
        for (int i = 0; i < 3; i++)
            if (strcmp(splits[i], value) == 0) dial->split = i;
    } else if (strncmp(text, "every=", size) == 0) {
        dial->every = atoi(value);
    } else if (strncmp(text, "rounds=", size) == 0) {
        dial->rounds = atoi(value);
    } else if (strncmp(text, "threads=", size) == 0) {
        dial->threads = atoi(value);
    } else if (strncmp(text, "kernels=", size) == 0) {
        dial->kernels = value;
    } else if (strncmp(text, "background=", size) == 0) {
        dial->background = (float)atof(value);
    } else {
        return false;
    }
    return dial->every >= 1 && dial->rounds >= 1;
}

static void measure(const struct dial *dial, struct setting *setting, const struct rn_frame *frame,
                    const struct rn_picture *truth, int view, bool first) {
    struct rn_error err;
    struct rn_render_result result;
    struct rn_render_options options = setting->options;
    options.camera = frame->camera;
    options.outputs = RN_OUTPUT_RGB;
    for (int c = 0; c < 3; c++)
        options.background[c] = dial->background;
    double began = cpu_ms(), psnr = NAN;
    if (rn_render(dial->engine, dial->field, &options, NULL, NULL, &result, &err) != RN_OK)
        die(&err);
    double spent = cpu_ms() - began;
    if (first) {
        for (size_t i = 0; i < (size_t)truth->width * (size_t)truth->height * 3; i++)
            result.rgb.values[i] = fminf(fmaxf(result.rgb.values[i], 0), 1);
        if (rn_psnr(&result.rgb, truth, &psnr) != RN_OK) abort();
        setting->psnr += psnr;
        setting->rays += (double)result.stats.rays / (truth->width * (double)truth->height);
        setting->samples += (double)result.stats.samples;
        setting->ms[view] = setting->cpu_ms[view] = INFINITY;
    }
    setting->ms[view] = fmin(setting->ms[view], result.stats.render_ms);
    setting->cpu_ms[view] = fmin(setting->cpu_ms[view], spent);
    rn_render_result_finish(&result);
}

static int measure_view(struct dial *dial, const struct rn_frame *frame, int view) {
    struct rn_error err;
    struct rn_image photograph;
    struct rn_picture truth;
    float background[3] = {dial->background, dial->background, dial->background};
    if (rn_image_read(frame->path, &rn_image_default_limits, &photograph, &err) != RN_OK ||
        rn_image_composite(&photograph, background, &truth, &err) != RN_OK)
        die(&err);
    for (int round = 0; round < dial->rounds; round++)
        for (int i = 0; i < dial->count; i++)
            measure(dial, &dial->settings[i], frame, &truth, view, round == 0);
    rn_image_finish(&photograph);
    rn_picture_finish(&truth);
    return view + 1;
}

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *values, int count) {
    qsort(values, (size_t)count, sizeof *values, ascending);
    return values[count / 2];
}

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct dial dial = {.split = RN_SPLIT_TEST, .every = 10, .rounds = 7, .background = 1};
    if (argc < 3) {
        fprintf(stderr, "usage: dial CHECKPOINT DATASET [name=value ...] [SETTING ...]\n");
        return 2;
    }
    for (int i = 3; i < argc; i++)
        if (!set_option(&dial, argv[i]) && !add_setting(&dial, argv[i])) {
            fprintf(stderr, "dial: no setting '%s', or its value is out of range\n", argv[i]);
            return 2;
        }
    for (size_t i = 0, none = dial.count == 0; none && i < sizeof usual / sizeof *usual; i++)
        add_setting(&dial, usual[i]);
    struct rn_engine_options options = {.threads = dial.threads, .kernels = dial.kernels};
    if (rn_dataset_read(argv[2], NULL, &dial.dataset, &err) != RN_OK) die(&err);
    if (rn_engine_create(&options, &dial.engine, &err) != RN_OK) die(&err);
    if (rn_field_load(dial.engine, argv[1], &dial.field, &err) != RN_OK) die(&err);
    int seen = 0, views = 0;
    for (size_t i = 0; i < dial.dataset->frame_count && views < MAX_VIEWS; i++) {
        const struct rn_frame *frame = &dial.dataset->frames[i];
        if (frame->split == (enum rn_split)dial.split && frame->scale == 0 &&
            seen++ % dial.every == 0)
            views = measure_view(&dial, frame, views);
    }
    printf("%-32s%8s%8s%10s%8s%8s\n", "", "dB", "rays", "samples", "ms", "cpu ms");
    for (int i = 0; i < dial.count && views > 0; i++) {
        struct setting *s = &dial.settings[i];
        printf("%-32s%8.2f%8.3f%10.0f%8.1f%8.1f\n", s->name, s->psnr / views, s->rays / views,
               s->samples / views, median(s->ms, views), median(s->cpu_ms, views));
    }
    rn_field_destroy(&dial.field);
    rn_engine_destroy(&dial.engine);
    rn_dataset_destroy(&dial.dataset);
    return 0;
}
