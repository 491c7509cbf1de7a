// A place with known truth: how good what was trained on its photographs is by distance, how far
// depths are off, and how it looks from pixels a quarter to eight times as wide as the
// photographs', for each footprint after the same time.
//
//   place SCENE DATASET [time=20] [steps=0] [preset=standard] [seed=1] [threads=0] [views=6]
//         [frames=4] [clock=cpu]
//
// SCENE is place or window, DATASET a folder of its photographs (ripnerf synth). PSNR and the
// median of |depth - truth| / truth on test views, over the pixels whose truth lies within BANDS,
// and in the sky. At every zoom a camera moves sideways by a third of a pixel, as the middle of its
// picture sees it, a frame: PSNR against the truth, and flicker as zoom has it (1 is right, more is
// shimmer, less is blur). No test: a tool to measure with.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "common/base/clock.h"
#include "common/image/metrics.h"
#include "common/math/numbers.h"
#include "tests/bench/footprints.h"

#define TRUTH_SAMPLES 16
#define MOTION 0.37 // pixels a frame
#define ZOOMS 6
#define BAND_COUNT 4
#define DEPTHS_MOST 4000000

static const double BANDS[BAND_COUNT] = {4, 12, 1e30, INFINITY}; // to this distance; the sky
static const char *const BAND_NAMES[BAND_COUNT] = {"to 4", "to 12", "beyond", "sky"};
static const double WIDTHS[ZOOMS] = {0.25, 0.5, 1, 2, 4, 8}; // of a pixel, beside the photographs'

struct tool {
    const char *scene;
    struct bench_training training;
    int views, frames;
};

// Sums over pixels of a band, and their depths' errors.
struct band {
    double squares;
    size_t count, depth_count;
    double *depths;
};

static int64_t cpu_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

// ---- pictures -------------------------------------------------------------------------------

static struct rn_render_result render(const struct tool *t, struct rn_field *field,
                                      const struct rn_camera *camera) {
    struct rn_error err;
    struct rn_render_result result;
    struct rn_render_options options = {.camera = *camera,
                                        .outputs = RN_OUTPUT_RGB | RN_OUTPUT_DEPTH};
    if (rn_render(t->training.engine, field, &options, NULL, NULL, &result, &err) != RN_OK)
        bench_die(&err);
    bench_clamp(&result.rgb);
    return result;
}

// Without alpha: a place has a sky.
static struct rn_picture truth_of(const struct tool *t, const struct rn_camera *camera) {
    struct rn_error err;
    struct rn_picture rgba, out;
    if (rn_synth_render(t->scene, camera, TRUTH_SAMPLES, &rgba, &err) != RN_OK ||
        rn_picture_init(camera->width, camera->height, 3, &out, &err) != RN_OK)
        bench_die(&err);
    for (size_t i = 0; i < (size_t)out.width * (size_t)out.height; i++)
        memcpy(out.values + 3 * i, rgba.values + 4 * i, 3 * sizeof *out.values);
    rn_picture_finish(&rgba);
    return out;
}

// ---- by distance ----------------------------------------------------------------------------

static void add_view(const struct tool *t, struct rn_field *field, const struct rn_camera *camera,
                     struct band bands[BAND_COUNT]) {
    struct rn_error err;
    struct rn_picture depth, truth = truth_of(t, camera);
    struct rn_render_result result = render(t, field, camera);
    if (rn_synth_depth(t->scene, camera, &depth, &err) != RN_OK) bench_die(&err);
    for (size_t i = 0; i < (size_t)depth.width * (size_t)depth.height; i++) {
        double distance = (double)depth.values[i];
        int b = 0;
        while (distance > BANDS[b])
            b++;
        for (size_t c = 3 * i; c < 3 * i + 3; c++)
            bands[b].squares += pow((double)result.rgb.values[c] - (double)truth.values[c], 2) / 3;
        bands[b].count++;
        if (isfinite(distance) && bands[b].depth_count < DEPTHS_MOST)
            bands[b].depths[bands[b].depth_count++] =
                fabs((double)result.depth.values[i] - distance) / distance;
    }
    rn_picture_finish(&depth);
    rn_picture_finish(&truth);
    rn_render_result_finish(&result);
}

static void tell_bands(const struct tool *t, struct rn_field *field) {
    struct band bands[BAND_COUNT] = {{0}};
    int seen = 0, all = t->training.dataset->view_count[RN_SPLIT_TEST], stride = all / t->views;
    for (int b = 0; b < BAND_COUNT; b++)
        if (!(bands[b].depths = malloc(DEPTHS_MOST * sizeof(double)))) abort();
    for (size_t i = 0; i < t->training.dataset->frame_count; i++) {
        const struct rn_frame *f = &t->training.dataset->frames[i];
        if (f->split == RN_SPLIT_TEST && f->scale == 0 && seen++ % (stride ? stride : 1) == 0)
            add_view(t, field, &f->camera, bands);
    }
    for (int b = 0; b < BAND_COUNT; b++) {
        struct band *band = &bands[b];
        printf("  %-7s %5.1f %% of pixels  %6.2f dB", BAND_NAMES[b],
               100.0 * (double)band->count /
                   (double)(bands[0].count + bands[1].count + bands[2].count + bands[3].count),
               -10 * log10(band->squares / (double)band->count));
        if (band->depth_count > 0)
            printf("  depth off by %.2f %%",
                   100 * rn_numbers_median(band->depths, band->depth_count));
        putchar('\n');
        free(band->depths);
    }
}

// ---- zoom -----------------------------------------------------------------------------------

// A test view with pixels so many times as wide, moved to its right by `i` frames.
static struct rn_camera camera_at(const struct rn_camera *taken, double width, double middle,
                                  int i) {
    struct rn_camera c = *taken;
    if (width > 1) {
        c = rn_camera_resized(&c, (int)(c.width / width), (int)(c.height / width));
    } else {
        c.fx /= width;
        c.fy /= width;
    }
    double across = MOTION * i * middle / c.fx;
    for (int k = 0; k < 3; k++)
        c.world_from_camera[k][3] += across * c.world_from_camera[k][0];
    return c;
}

static void tell_zoom(const struct tool *t, struct rn_field *field, const struct rn_camera *taken,
                      double width) {
    struct rn_error err;
    struct rn_picture depth, last = {0}, last_truth = {0};
    double psnr = 0, moved = 0, moved_truth = 0, ms = 0;
    if (rn_synth_depth(t->scene, taken, &depth, &err) != RN_OK) bench_die(&err);
    double middle =
        (double)depth
            .values[(size_t)(depth.height / 2) * (size_t)depth.width + (size_t)depth.width / 2];
    rn_picture_finish(&depth);
    if (!isfinite(middle)) middle = BANDS[1];
    for (int i = 0; i < t->frames; i++) {
        struct rn_camera camera = camera_at(taken, width, middle, i);
        struct rn_render_result result = render(t, field, &camera);
        struct rn_picture truth = truth_of(t, &camera);
        double now = NAN;
        if (rn_psnr(&result.rgb, &truth, &now) != RN_OK) abort();
        psnr += now / t->frames;
        ms += result.stats.render_ms / t->frames;
        if (i > 0) {
            moved += bench_difference(&result.rgb, &last);
            moved_truth += bench_difference(&truth, &last_truth);
        }
        rn_picture_finish(&last);
        rn_picture_finish(&last_truth);
        rn_picture_finish(&result.depth);
        last = result.rgb;
        last_truth = truth;
    }
    rn_picture_finish(&last);
    rn_picture_finish(&last_truth);
    printf("  pixels %4.2f times as wide  %6.2f dB  flicker %.2f  %.0f ms\n", width, psnr,
           moved / moved_truth, ms);
}

// ---- training -------------------------------------------------------------------------------

static void measure(const struct tool *t, enum rn_footprint footprint) {
    struct rn_progress p;
    struct rn_field *field = bench_train(&t->training, footprint, true, &p);
    printf("%s: %lld steps in %.1f s, %.1f samples a ray, %.0f %% of them at level 0\n",
           rn_footprint_names[footprint], (long long)p.step, p.train_seconds,
           (double)p.samples / (double)p.rays,
           100.0 * (double)p.level_samples[0] / (double)p.samples);
    tell_bands(t, field);
    const struct rn_camera *taken = NULL;
    for (size_t i = 0; i < t->training.dataset->frame_count && !taken; i++)
        if (t->training.dataset->frames[i].split == RN_SPLIT_TEST)
            taken = &t->training.dataset->frames[i].camera;
    for (int z = 0; z < ZOOMS && taken; z++)
        tell_zoom(t, field, taken, WIDTHS[z]);
    fflush(stdout);
    rn_field_destroy(&field);
}

static bool set_option(struct tool *t, const char *name, const char *value) {
    if (bench_set_option(&t->training, name, value)) return true;
    if (strcmp(name, "views") == 0)
        t->views = atoi(value) > 0 ? atoi(value) : 1;
    else if (strcmp(name, "frames") == 0)
        t->frames = atoi(value) > 1 ? atoi(value) : 2;
    else if (strcmp(name, "clock") == 0)
        rn_clock_set_source(strcmp(value, "cpu") == 0 ? cpu_ns : NULL, NULL);
    else
        return false;
    return true;
}

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct tool t = {
        .training = {.preset = "standard", .seconds = 20, .seed = 1}, .views = 6, .frames = 4};
    if (argc < 3) {
        fprintf(stderr, "usage: place SCENE DATASET [name=value ...]\n");
        return 2;
    }
    t.scene = argv[1];
    for (int i = 3; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        if (value) *value++ = 0;
        if (value && set_option(&t, argv[i], value)) continue;
        fprintf(stderr, "place: no option '%s'\n", argv[i]);
        return 2;
    }
    struct rn_engine_options options = {.device = "cpu", .threads = t.training.threads};
    if (rn_dataset_read(argv[2], NULL, &t.training.dataset, &err) != RN_OK ||
        rn_engine_create(&options, &t.training.engine, &err) != RN_OK)
        bench_die(&err);
    const enum rn_footprint footprints[] = {RN_FOOTPRINT_RIP, RN_FOOTPRINT_MIP, RN_FOOTPRINT_POINT};
    for (int i = 0; i < 3; i++)
        measure(&t, footprints[i]);
    rn_engine_destroy(&t.training.engine);
    rn_dataset_destroy(&t.training.dataset);
    return 0;
}
