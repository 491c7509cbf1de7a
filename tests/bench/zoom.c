// Zoom sweep: how a field trained on photographs of a procedural scene looks from 2x nearer to 16x
// farther, also between the scales it was trained on, for each footprint with one cone a pixel, and
// for mip with as many as the engine takes by itself.
//
//   zoom SCENE DATASET [time=20] [steps=0] [preset=standard] [seed=1] [threads=0] [size=96]
//        [frames=5]
//
// SCENE is sphere, fence or nested, DATASET a folder of its photographs (ripnerf synth, perhaps
// imported with several scales). At every zoom a camera moves by a third of a pixel a frame.
// Columns: PSNR against the same field at 64 rays a pixel, PSNR against the truth, flicker (the
// mean absolute difference of successive frames over that of the truth: 1 is right, more is
// shimmer, less is blur), and milliseconds a frame. No test: a tool to measure with.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/metrics.h"
#include "tests/bench/footprints.h"

#define ZOOMS 11
#define NEAREST 0.5
#define RAYS_A_SIDE 8
#define TRUTH_SAMPLES 64
#define PIXELS_A_FRAME 0.37 // of motion at the scene's rim
#define MIN_SIZE 8
#define MAX_FRAMES 64

static const struct variant {
    const char *name;
    enum rn_footprint footprint;
    int supersample; // as of a rendering
} variants[] = {{"rip", RN_FOOTPRINT_RIP, 1},
                {"mip", RN_FOOTPRINT_MIP, 1},
                {"point", RN_FOOTPRINT_POINT, 1},
                {"mip, cones as needed", RN_FOOTPRINT_MIP, 0}};
#define VARIANTS (int)(sizeof variants / sizeof *variants)

struct sweep {
    const char *scene;
    struct bench_training training;
    int size, frames;
    double distance, focal, radius; // of the training cameras at full size; of the scene
};

struct score {
    double psnr_rays, psnr_truth, flicker, ms;
};

// ---- pictures -------------------------------------------------------------------------------

// Frame `i` of the camera's motion at `zoom` times the training distance, cut to the scene.
static struct rn_camera camera_at(const struct sweep *s, double zoom, int i) {
    double distance = zoom * s->distance, focal = s->focal, angle, across, z = 0.35;
    double rim = focal * s->radius / sqrt(distance * distance - s->radius * s->radius);
    int size = (int)ceil(2.2 * rim);
    size = size > s->size ? s->size : size < MIN_SIZE ? MIN_SIZE : size;
    angle = 0.7 + i * PIXELS_A_FRAME * distance / (focal * s->radius);
    across = distance * sqrt(1 - z * z);
    double eye[3] = {across * cos(angle), across * sin(angle), distance * z};
    double *centre = s->training.dataset->bounds.centre;
    for (int k = 0; k < 3; k++)
        eye[k] += centre[k];
    struct rn_camera camera = {.lens = RN_LENS_PINHOLE,
                               .width = size,
                               .height = size,
                               .fx = focal,
                               .fy = focal,
                               .cx = 0.5 * size,
                               .cy = 0.5 * size};
    if (rn_camera_look_at(eye, centre, (const double[3]){0, 0, 1}, camera.world_from_camera) !=
        RN_OK)
        abort();
    return camera;
}

static struct rn_picture render(const struct sweep *s, struct rn_field *field,
                                const struct rn_camera *camera, int supersample, double *ret_ms) {
    struct rn_error err;
    struct rn_render_result result;
    struct rn_render_options options = {.camera = *camera,
                                        .outputs = RN_OUTPUT_RGB,
                                        .background = {1, 1, 1},
                                        .settings.supersample = supersample};
    if (rn_render(s->training.engine, field, &options, NULL, NULL, &result, &err) != RN_OK)
        bench_die(&err);
    if (ret_ms) *ret_ms += result.stats.render_ms;
    bench_clamp(&result.rgb);
    return result.rgb;
}

// The field at RAYS_A_SIDE^2 narrow rays a pixel.
static struct rn_picture render_rays(const struct sweep *s, struct rn_field *field,
                                     const struct rn_camera *camera) {
    struct rn_error err;
    struct rn_camera fine =
        rn_camera_resized(camera, camera->width * RAYS_A_SIDE, camera->height * RAYS_A_SIDE);
    struct rn_picture rays = render(s, field, &fine, 1, NULL), out;
    if (rn_picture_init(camera->width, camera->height, 3, &out, &err) != RN_OK) bench_die(&err);
    memset(out.values, 0, (size_t)out.width * (size_t)out.height * 3 * sizeof *out.values);
    for (int y = 0; y < rays.height; y++)
        for (int x = 0; x < rays.width; x++)
            for (int c = 0; c < 3; c++)
                out.values[((size_t)(y / RAYS_A_SIDE) * out.width + x / RAYS_A_SIDE) * 3 + c] +=
                    rays.values[((size_t)y * rays.width + x) * 3 + c] / (RAYS_A_SIDE * RAYS_A_SIDE);
    rn_picture_finish(&rays);
    return out;
}

static struct rn_picture truth_at(const struct sweep *s, const struct rn_camera *camera) {
    struct rn_error err;
    struct rn_picture rgba, out;
    if (rn_synth_render(s->scene, camera, TRUTH_SAMPLES, &rgba, &err) != RN_OK ||
        rn_picture_init(camera->width, camera->height, 3, &out, &err) != RN_OK)
        bench_die(&err);
    for (size_t i = 0; i < (size_t)out.width * (size_t)out.height; i++)
        for (size_t c = 0; c < 3; c++) {
            float alpha = rgba.values[4 * i + 3];
            out.values[3 * i + c] = rgba.values[4 * i + c] * alpha + (1 - alpha);
        }
    rn_picture_finish(&rgba);
    return out;
}

static double psnr(const struct rn_picture *a, const struct rn_picture *b) {
    double value = NAN;
    if (rn_psnr(a, b, &value) != RN_OK) abort();
    return value;
}

// ---- sweep ----------------------------------------------------------------------------------

static struct score score_at(const struct sweep *s, struct rn_field *field, int supersample,
                             double zoom) {
    struct score score = {0};
    struct rn_picture last = {0}, last_truth = {0};
    double moved = 0, moved_truth = 0;
    for (int i = 0; i < s->frames; i++) {
        struct rn_camera camera = camera_at(s, zoom, i);
        struct rn_picture picture = render(s, field, &camera, supersample, &score.ms),
                          truth = truth_at(s, &camera);
        score.psnr_truth += psnr(&picture, &truth) / s->frames;
        if (i == 0) {
            struct rn_picture rays = render_rays(s, field, &camera);
            score.psnr_rays = psnr(&picture, &rays);
            rn_picture_finish(&rays);
        } else {
            moved += bench_difference(&picture, &last);
            moved_truth += bench_difference(&truth, &last_truth);
        }
        rn_picture_finish(&last);
        rn_picture_finish(&last_truth);
        last = picture;
        last_truth = truth;
    }
    rn_picture_finish(&last);
    rn_picture_finish(&last_truth);
    score.flicker = moved / moved_truth;
    score.ms /= s->frames;
    return score;
}

static void sweep_footprint(struct sweep *s, enum rn_footprint footprint,
                            struct score ret_scores[VARIANTS][ZOOMS]) {
    struct rn_progress progress;
    struct rn_field *field = bench_train(&s->training, footprint, false, &progress);
    fprintf(stderr, "zoom: %s: %lld steps in %.1f s, loss %.5f\n", rn_footprint_names[footprint],
            (long long)progress.step, progress.train_seconds, progress.loss);
    for (int v = 0; v < VARIANTS; v++)
        for (int i = 0; i < ZOOMS && variants[v].footprint == footprint; i++)
            ret_scores[v][i] =
                score_at(s, field, variants[v].supersample, NEAREST * pow(2, 0.5 * i));
    rn_field_destroy(&field);
}

static void print_table(const struct sweep *s, struct score scores[VARIANTS][ZOOMS]) {
    printf("%-14s", "");
    for (int v = 0; v < VARIANTS; v++)
        printf("  %-32s", variants[v].name);
    printf("\n%-7s%7s", "zoom", "pixels");
    for (int v = 0; v < VARIANTS; v++)
        printf("  %8s%8s%8s%8s", "64 rays", "truth", "flicker", "ms");
    for (int i = 0; i < ZOOMS; i++) {
        double zoom = NEAREST * pow(2, 0.5 * i);
        printf("\n%-7.2f%7d", zoom, camera_at(s, zoom, 0).width);
        for (int v = 0; v < VARIANTS; v++)
            printf("  %8.2f%8.2f%8.2f%8.1f", scores[v][i].psnr_rays, scores[v][i].psnr_truth,
                   scores[v][i].flicker, scores[v][i].ms);
    }
    putchar('\n');
}

// Distance and focal length of the training cameras, at their full size.
static void find_cameras(struct sweep *s) {
    double distance = 0, focal = 0;
    int n = 0;
    for (size_t i = 0; i < s->training.dataset->frame_count; i++) {
        const struct rn_frame *frame = &s->training.dataset->frames[i];
        if (frame->split != RN_SPLIT_TRAIN || frame->scale != 0) continue;
        double square = 0;
        for (int k = 0; k < 3; k++) {
            double d =
                frame->camera.world_from_camera[k][3] - s->training.dataset->bounds.centre[k];
            square += d * d;
        }
        distance += sqrt(square);
        focal += frame->camera.fx;
        n++;
    }
    s->distance = distance / n;
    s->focal = focal / n;
    s->radius = s->training.dataset->bounds.radius;
}

static bool set_option(struct sweep *s, const char *name, const char *value) {
    if (bench_set_option(&s->training, name, value)) return true;
    if (strcmp(name, "size") == 0)
        s->size = atoi(value);
    else if (strcmp(name, "frames") == 0)
        s->frames = atoi(value);
    else
        return false;
    return s->size >= MIN_SIZE && s->size <= 1024 && s->frames >= 2 && s->frames <= MAX_FRAMES;
}

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct sweep s = {
        .training = {.preset = "standard", .seconds = 20, .seed = 1}, .size = 96, .frames = 5};
    if (argc < 3) {
        fprintf(stderr, "usage: zoom SCENE DATASET [name=value ...]\n");
        return 2;
    }
    s.scene = argv[1];
    for (int i = 3; i < argc; i++) {
        char *value = strchr(argv[i], '=');
        if (value) *value++ = 0;
        if (!value || !set_option(&s, argv[i], value)) {
            fprintf(stderr, "zoom: no option '%s', or its value is out of range\n", argv[i]);
            return 2;
        }
    }
    struct rn_engine_options options = {.threads = s.training.threads};
    struct score scores[VARIANTS][ZOOMS];
    if (rn_dataset_read(argv[2], NULL, &s.training.dataset, &err) != RN_OK) bench_die(&err);
    if (rn_engine_create(&options, &s.training.engine, &err) != RN_OK) bench_die(&err);
    find_cameras(&s);
    for (int f = RN_FOOTPRINT_RIP; f <= RN_FOOTPRINT_POINT; f++)
        sweep_footprint(&s, (enum rn_footprint)f, scores);
    print_table(&s, scores);
    rn_engine_destroy(&s.training.engine);
    rn_dataset_destroy(&s.training.dataset);
    return 0;
}
