// Whether a camera that was moved on purpose is found again by what it photographed.
//
//   pose CHECKPOINT DATASET [split=test] [every=1] [turn=DEGREES] [shift=SHARE] [seed=1] [steps=6]
//
// Each photograph's camera is turned and shifted at random, the shift as a share of its distance
// from the bounds' centre, and then sought by Gauss-Newton with Levenberg's damping on the left
// half of the picture, from an eighth of its size to half of it: rotation, position, a gain and an
// offset; derivatives by central differences of half a pixel, Huber's weights. Scored on the right
// half, with the gain and the offset of the left: as the dataset has the camera, as it was moved,
// as it was found, and as it is found from where the dataset has it. No test: a tool to measure
// with.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/image/image.h"
#include "common/math/rng.h"
#include "server/engine/engine.h"
#include "server/engine/scene/pose.h"

enum { ROTATION = RN_POSE_TURN, POSITION = RN_POSE_SHIFT, UNKNOWNS = RN_POSE_FOCAL };
#define HUBER 0.1
#define COARSEST 8
#define FINEST 2

struct half {
    struct rn_picture picture;
    double gain, offset;
};

struct sought {
    struct rn_engine *engine;
    struct rn_field *field;
    struct rn_camera camera; // of the dataset
    double distance;         // from the bounds' centre
    const struct rn_image *photograph;
    int steps;
};

static void die(const struct rn_error *err) {
    fprintf(stderr, "pose: %s: %s\n", err->where, err->text);
    exit(1);
}

// Turned about the camera's own axes by the vector's length, and shifted along them.
static struct rn_camera moved(const struct rn_camera *from, const double by[UNKNOWNS],
                              double distance) {
    double all[RN_POSE_UNKNOWNS] = {0};
    memcpy(all, by, UNKNOWNS * sizeof *by);
    return rn_pose_move(from, all, distance);
}

// The left or the right half of the camera's picture, `scale` times smaller.
static struct rn_picture render(const struct sought *sought, const struct rn_camera *from,
                                int scale, bool right) {
    struct rn_error err;
    struct rn_render_result result;
    struct rn_render_options options = {.camera = *from, .outputs = RN_OUTPUT_RGB};
    struct rn_camera *camera = &options.camera;
    int width = from->width / scale, middle = width / 2;
    double across = (double)width / from->width,
           down = (double)(from->height / scale) / from->height;
    camera->width = right ? width - middle : middle;
    camera->height = from->height / scale;
    camera->fx *= across;
    camera->cx = camera->cx * across - (right ? middle : 0);
    camera->fy *= down;
    camera->cy *= down;
    if (rn_render(sought->engine, sought->field, &options, NULL, NULL, &result, &err) != RN_OK)
        die(&err);
    struct rn_picture picture = result.rgb;
    result.rgb = (struct rn_picture){0};
    rn_render_result_finish(&result);
    return picture;
}

static struct rn_picture truth(const struct sought *sought, int scale, bool right) {
    struct rn_error err;
    struct rn_image small;
    struct rn_picture whole, half;
    const struct rn_image *photograph = sought->photograph;
    static const float black[3] = {0, 0, 0};
    int width = photograph->width / scale, height = photograph->height / scale, middle = width / 2;
    if (rn_image_downscale(photograph, width, height, RN_DOWNSCALE_PREMULTIPLIED, &small, &err) ||
        rn_image_composite(&small, black, &whole, &err) ||
        rn_picture_init(right ? width - middle : middle, height, 3, &half, &err))
        die(&err);
    for (int y = 0; y < height; y++)
        memcpy(half.values + (size_t)y * (size_t)half.width * 3,
               whole.values + ((size_t)y * (size_t)width + (size_t)(right ? middle : 0)) * 3,
               (size_t)half.width * 3 * sizeof(float));
    rn_image_finish(&small);
    rn_picture_finish(&whole);
    return half;
}

static size_t count_of(const struct rn_picture *picture) {
    return (size_t)picture->width * (size_t)picture->height * 3;
}

// truth = gain * picture + offset, by least squares.
static void fit_exposure(const struct rn_picture *of, struct half *half) {
    double x = 0, y = 0, xx = 0, xy = 0, n = (double)count_of(of);
    for (size_t i = 0; i < count_of(of); i++) {
        double a = (double)half->picture.values[i], b = (double)of->values[i];
        x += a;
        y += b;
        xx += a * a;
        xy += a * b;
    }
    double spread = xx - x * x / n;
    half->gain = spread > 1e-9 ? (xy - x * y / n) / spread : 1;
    half->offset = (y - half->gain * x) / n;
}

static double residual(const struct rn_picture *of, const struct half *half, size_t i) {
    return (double)of->values[i] - half->gain * (double)half->picture.values[i] - half->offset;
}

static double cost_of(const struct rn_picture *of, const struct half *half) {
    double sum = 0;
    for (size_t i = 0; i < count_of(of); i++) {
        double r = fabs(residual(of, half, i));
        sum += r < HUBER ? 0.5 * r * r : HUBER * (r - 0.5 * HUBER);
    }
    return sum;
}

// Gaussian elimination with pivots of a symmetric matrix; false where it has no inverse.
static bool solve(double a[UNKNOWNS][UNKNOWNS + 1], double x[UNKNOWNS]) {
    for (int i = 0; i < UNKNOWNS; i++) {
        int pivot = i;
        for (int k = i; k < UNKNOWNS; k++)
            if (fabs(a[k][i]) > fabs(a[pivot][i])) pivot = k;
        if (!(fabs(a[pivot][i]) > 1e-30)) return false;
        for (int j = 0; j <= UNKNOWNS; j++) {
            double kept = a[i][j];
            a[i][j] = a[pivot][j];
            a[pivot][j] = kept;
        }
        for (int k = i + 1; k < UNKNOWNS; k++)
            for (int j = UNKNOWNS; j >= i; j--)
                a[k][j] -= a[k][i] / a[i][i] * a[i][j];
    }
    for (int i = UNKNOWNS - 1; i >= 0; i--) {
        x[i] = a[i][UNKNOWNS];
        for (int j = i + 1; j < UNKNOWNS; j++)
            x[i] -= a[i][j] * x[j];
        x[i] /= a[i][i];
    }
    return true;
}

// The normal equations about `camera`.
static void gather(const struct sought *sought, const struct rn_camera *camera, int scale,
                   const struct rn_picture *of, const struct half *half,
                   double equations[UNKNOWNS][UNKNOWNS + 1]) {
    struct rn_picture sides[UNKNOWNS][2];
    double step = 0.5 * scale / camera->fx;
    memset(equations, 0, UNKNOWNS * sizeof *equations);
    for (int k = 0; k < UNKNOWNS; k++)
        for (int side = 0; side < 2; side++) {
            double by[UNKNOWNS] = {0};
            by[k] = side ? step : -step;
            struct rn_camera next = moved(camera, by, sought->distance);
            sides[k][side] = render(sought, &next, scale, false);
        }
    for (size_t i = 0; i < count_of(of); i++) {
        double r = residual(of, half, i), weight = fabs(r) < HUBER ? 1 : HUBER / fabs(r);
        double slope[UNKNOWNS];
        for (int k = 0; k < UNKNOWNS; k++)
            slope[k] =
                half->gain * (double)(sides[k][1].values[i] - sides[k][0].values[i]) / (2 * step);
        for (int k = 0; k < UNKNOWNS; k++) {
            for (int j = 0; j < UNKNOWNS; j++)
                equations[k][j] += weight * slope[k] * slope[j];
            equations[k][UNKNOWNS] += weight * slope[k] * r;
        }
    }
    for (int k = 0; k < UNKNOWNS; k++)
        for (int side = 0; side < 2; side++)
            rn_picture_finish(&sides[k][side]);
}

static struct half look(const struct sought *sought, const struct rn_camera *camera, int scale,
                        const struct rn_picture *of) {
    struct half half = {.picture = render(sought, camera, scale, false)};
    fit_exposure(of, &half);
    return half;
}

static struct rn_camera seek_at(const struct sought *sought, struct rn_camera camera, int scale) {
    struct rn_picture of = truth(sought, scale, false);
    struct half half = look(sought, &camera, scale, &of);
    double damping = 1e-3, equations[UNKNOWNS][UNKNOWNS + 1], by[UNKNOWNS];
    for (int step = 0; step < sought->steps; step++) {
        gather(sought, &camera, scale, &of, &half, equations);
        for (int k = 0; k < UNKNOWNS; k++)
            equations[k][k] *= 1 + damping;
        if (!solve(equations, by)) break;
        struct rn_camera next = moved(&camera, by, sought->distance);
        struct half better = look(sought, &next, scale, &of);
        bool good = cost_of(&of, &better) < cost_of(&of, &half);
        rn_picture_finish(good ? &half.picture : &better.picture);
        if (good) half = better;
        if (good) camera = next;
        damping *= good ? 0.3 : 10;
    }
    rn_picture_finish(&half.picture);
    rn_picture_finish(&of);
    return camera;
}

static struct rn_camera seek(const struct sought *sought, struct rn_camera camera) {
    for (int scale = COARSEST; scale >= FINEST; scale /= 2)
        camera = seek_at(sought, camera, scale);
    return camera;
}

// PSNR of the right half at full size.
static double score(const struct sought *sought, const struct rn_camera *camera) {
    struct rn_picture left = truth(sought, 1, false), right = truth(sought, 1, true);
    struct half half = look(sought, camera, 1, &left);
    rn_picture_finish(&half.picture);
    half.picture = render(sought, camera, 1, true);
    double sum = 0, n = (double)count_of(&right);
    for (size_t i = 0; i < count_of(&right); i++)
        sum += pow(residual(&right, &half, i), 2);
    rn_picture_finish(&half.picture);
    rn_picture_finish(&left);
    rn_picture_finish(&right);
    return -10 * log10(sum / n);
}

static void differ(const struct rn_camera *a, const struct rn_camera *b, double distance,
                   double *ret_degrees, double *ret_share) {
    double trace = 0, squared = 0;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            trace += a->world_from_camera[i][j] * b->world_from_camera[i][j];
        squared += pow(a->world_from_camera[i][3] - b->world_from_camera[i][3], 2);
    }
    *ret_degrees = acos(fmax(-1, fmin(1, (trace - 1) / 2))) * 180 / M_PI;
    *ret_share = sqrt(squared) / distance;
}

// Of a given length, in a random direction.
static void draw(uint64_t seed, uint64_t view, int first, double length, double by[UNKNOWNS]) {
    double size = 0;
    for (int i = 0; i < 3; i++) {
        uint32_t bits = rn_rng_draw(seed, view, (uint64_t)(first + i)).v[0];
        by[first + i] = bits / 2147483648.0 - 1;
        size += by[first + i] * by[first + i];
    }
    for (int i = 0; i < 3; i++)
        by[first + i] *= length / sqrt(size);
}

struct options {
    double turn, shift;
    int split, every, steps;
    uint64_t seed;
};

static void read_options(struct options *options, int argc, char **argv) {
    static const char *const splits[] = {"train", "val", "test"};
    for (int i = 3; i < argc; i++) {
        if (strncmp(argv[i], "turn=", 5) == 0) options->turn = atof(argv[i] + 5);
        if (strncmp(argv[i], "shift=", 6) == 0) options->shift = atof(argv[i] + 6);
        if (strncmp(argv[i], "every=", 6) == 0) options->every = atoi(argv[i] + 6);
        if (strncmp(argv[i], "steps=", 6) == 0) options->steps = atoi(argv[i] + 6);
        if (strncmp(argv[i], "seed=", 5) == 0) options->seed = strtoull(argv[i] + 5, NULL, 10);
        for (int k = 0; k < 3; k++)
            if (strncmp(argv[i], "split=", 6) == 0 && strcmp(argv[i] + 6, splits[k]) == 0)
                options->split = k;
    }
}

// A line a view: off by, then PSNR.
static void measure(struct sought *sought, const struct options *options, uint64_t view,
                    const char *name, double sums[8]) {
    double by[UNKNOWNS], values[8];
    draw(options->seed, view, ROTATION, options->turn * M_PI / 180, by);
    draw(options->seed, view, POSITION, options->shift, by);
    struct rn_camera lost = moved(&sought->camera, by, sought->distance);
    struct rn_camera found = seek(sought, lost), kept = seek(sought, sought->camera);
    differ(&found, &sought->camera, sought->distance, &values[0], &values[1]);
    differ(&kept, &sought->camera, sought->distance, &values[2], &values[3]);
    values[4] = score(sought, &sought->camera);
    values[5] = score(sought, &lost);
    values[6] = score(sought, &found);
    values[7] = score(sought, &kept);
    printf(
        "%s: found to %.3f deg, %.4f; from the dataset's own it goes %.3f deg, %.4f; dB as given "
        "%.2f, moved %.2f, found %.2f, from its own %.2f\n",
        name, values[0], values[1], values[2], values[3], values[4], values[5], values[6],
        values[7]);
    for (int i = 0; i < 8; i++)
        sums[i] += values[i];
}

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct options options = {
        .turn = 1, .shift = 0.01, .split = RN_SPLIT_TEST, .every = 1, .steps = 6, .seed = 1};
    struct rn_engine_options engine = {.threads = 1};
    struct sought sought = {0};
    struct rn_dataset *dataset;
    if (argc < 3) {
        fprintf(stderr, "usage: pose CHECKPOINT DATASET [name=value ...]\n");
        return 2;
    }
    setlinebuf(stdout);
    read_options(&options, argc, argv);
    sought.steps = options.steps;
    if (rn_dataset_read(argv[2], NULL, &dataset, &err) != RN_OK ||
        rn_engine_create(&engine, &sought.engine, &err) != RN_OK ||
        rn_field_load(sought.engine, argv[1], &sought.field, &err) != RN_OK)
        die(&err);
    double sums[8] = {0};
    uint64_t seen = 0, views = 0;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        struct rn_image photograph;
        double squared = 0;
        if (frame->split != (enum rn_split)options.split || frame->scale ||
            seen++ % (uint64_t)options.every)
            continue;
        if (rn_image_read(frame->path, NULL, &photograph, &err) != RN_OK) die(&err);
        for (int k = 0; k < 3; k++)
            squared += pow(frame->camera.world_from_camera[k][3] - dataset->bounds.centre[k], 2);
        sought.camera = frame->camera;
        sought.distance = sqrt(squared);
        sought.photograph = &photograph;
        measure(&sought, &options, views++, frame->name, sums);
        rn_image_finish(&photograph);
    }
    double n = (double)(views ? views : 1);
    printf("%llu views, turned by %g deg and shifted by %g: found to %.3f deg, %.4f; from the "
           "dataset's own %.3f deg, %.4f; dB as given %.2f, moved %.2f, found %.2f, from its own "
           "%.2f\n",
           (unsigned long long)views, options.turn, options.shift, sums[0] / n, sums[1] / n,
           sums[2] / n, sums[3] / n, sums[4] / n, sums[5] / n, sums[6] / n, sums[7] / n);
    rn_field_destroy(&sought.field);
    rn_engine_destroy(&sought.engine);
    rn_dataset_destroy(&dataset);
    return 0;
}
