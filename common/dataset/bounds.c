// Where cameras look: bounds from cameras, and the figures of `validate`.
#include <math.h>

#include "common/dataset/reader.h"

bool rn_bounds_met(const struct rn_bounds *bounds, const double origin[3],
                   const double direction[3]) {
    double along = 0, squared = 0;
    for (int i = 0; i < 3; i++) {
        double offset = bounds->centre[i] - origin[i];
        along += offset * direction[i];
        squared += offset * offset;
    }
    double inside = bounds->radius * bounds->radius - squared;
    return inside >= 0 || (along > 0 && along * along + inside >= 0);
}

bool rn_camera_looks_at(const struct rn_camera *camera, const struct rn_bounds *bounds) {
    double origin[3], axis[3];
    for (int i = 0; i < 3; i++) {
        origin[i] = camera->world_from_camera[i][3];
        axis[i] = camera->world_from_camera[i][2];
    }
    return rn_bounds_met(bounds, origin, axis);
}

double rn_bounds_seen(const struct rn_dataset *dataset, const struct rn_bounds *bounds) {
    enum { GRID = 16 };
    size_t rays = 0, met = 0;
    for (size_t f = 0; f < dataset->frame_count; f++) {
        const struct rn_camera *camera = &dataset->frames[f].camera;
        if (dataset->frames[f].split != RN_SPLIT_TRAIN) continue;
        for (int i = 0; i < GRID * GRID; i++) {
            struct rn_ray ray = rn_camera_ray(camera, (i % GRID + 0.5) / GRID * camera->width,
                                              (i / GRID + 0.5) / GRID * camera->height);
            if (!(ray.radius > 0)) continue; // beyond the lens's fold
            rays++;
            met += rn_bounds_met(bounds, ray.origin, ray.direction);
        }
    }
    return rays ? (double)met / (double)rays : 1;
}

// Solves the symmetric 3x3 system a x = b by Cramer's rule; false when it is singular.
static bool solve3(double a[3][3], const double b[3], double x[3]) {
    double cofactor[3][3], trace = a[0][0] + a[1][1] + a[2][2];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
            cofactor[i][j] = a[i1][j1] * a[i2][j2] - a[i1][j2] * a[i2][j1];
        }
    double det = a[0][0] * cofactor[0][0] + a[0][1] * cofactor[0][1] + a[0][2] * cofactor[0][2];
    if (!(det > 1e-9 * trace * trace * trace)) return false;
    for (int i = 0; i < 3; i++)
        x[i] = (cofactor[i][0] * b[0] + cofactor[i][1] * b[1] + cofactor[i][2] * b[2]) / det;
    return true;
}

// argmin_p sum |(1 - d d^T)(p - o)|^2 over the optical axes (o, d); the mean position plus the
// mean direction when the axes are parallel.
static void nearest_to_axes(const struct rn_dataset *dataset, double centre[3]) {
    double a[3][3] = {{0}}, b[3] = {0}, mean[3] = {0};
    for (size_t f = 0; f < dataset->frame_count; f++) {
        double(*m)[4] = dataset->frames[f].camera.world_from_camera;
        for (int i = 0; i < 3; i++) {
            mean[i] += (m[i][3] + m[i][2]) / (double)dataset->frame_count;
            for (int j = 0; j < 3; j++) {
                double projector = (i == j) - m[i][2] * m[j][2];
                a[i][j] += projector;
                b[i] += projector * m[j][3];
            }
        }
    }
    if (solve3(a, b, centre)) return;
    for (int i = 0; i < 3; i++)
        centre[i] = mean[i];
}

struct rn_bounds rn_bounds_from_cameras(const struct rn_dataset *dataset, double distances) {
    struct rn_bounds bounds = {.radius = 1, .source = RN_BOUNDS_CAMERAS};
    nearest_to_axes(dataset, bounds.centre);
    double sum = 0;
    for (size_t f = 0; f < dataset->frame_count; f++)
        sum += rn_camera_distance(&dataset->frames[f].camera, bounds.centre);
    if (sum > 1e-6) bounds.radius = distances * sum / (double)dataset->frame_count;
    return bounds;
}

static void widen(double value, bool first, double *min, double *max) {
    if (first || value < *min) *min = value;
    if (first || value > *max) *max = value;
}

static void widen_int(int value, bool first, int *min, int *max) {
    if (first || value < *min) *min = value;
    if (first || value > *max) *max = value;
}

void rn_dataset_describe(const struct rn_dataset *dataset, struct rn_dataset_report *ret_report) {
    struct rn_dataset_report report = {.scale_count = dataset->scale_count};
    size_t looking = 0;
    for (int split = 0; split < RN_SPLIT_COUNT; split++)
        report.unusable[split] = dataset->unusable[split];
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        const struct rn_camera *camera = &frame->camera;
        double distance = rn_camera_distance(camera, dataset->bounds.centre);
        double footprint = distance * rn_camera_cone(camera);
        widen(distance, i == 0, &report.camera_distance_min, &report.camera_distance_max);
        widen(footprint, i == 0, &report.footprint_min, &report.footprint_max);
        widen_int(camera->width, i == 0, &report.width_min, &report.width_max);
        widen_int(camera->height, i == 0, &report.height_min, &report.height_max);
        report.usable[frame->split]++;
        report.with_alpha += frame->has_alpha;
        looking += rn_camera_looks_at(camera, &dataset->bounds);
    }
    if (dataset->frame_count)
        report.looking_at_bounds = (double)looking / (double)dataset->frame_count;
    *ret_report = report;
}
