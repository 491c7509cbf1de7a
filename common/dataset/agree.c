// Whether what a capture says of itself agrees: its sparse points with the photographs that saw
// them, its cameras with one another, one layout in its folder with the next.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/reader.h"

#define SUSPECT_PX 2.0  // a mean error of points above it means that something is misread
#define SAME_POSE 1e-6  // of the scene's radius
#define SAME_FOCAL 1e-6 // relative
#define FORWARD 0.9     // length of the mean view direction of a forward-facing capture
#define CONVERGENT 0.25 // of the distance, by which axes miss the point that they are nearest to

// ---- points against photographs ----

// Frames of full size by photograph, malloc'd; NULL when memory is out.
static const struct rn_frame **frames_by_photo(const struct rn_dataset *dataset,
                                               size_t *ret_count) {
    size_t count = 0;
    for (size_t i = 0; i < dataset->frame_count; i++)
        if ((size_t)dataset->frames[i].photo >= count) count = (size_t)dataset->frames[i].photo + 1;
    const struct rn_frame **frames = calloc(count + 1, sizeof *frames);
    for (size_t i = 0; frames && i < dataset->frame_count; i++)
        if (dataset->frames[i].scale == 0) frames[dataset->frames[i].photo] = &dataset->frames[i];
    *ret_count = count;
    return frames;
}

// Pixels between where a photograph saw a point and where its camera sees it; NAN where it does
// not.
static double miss_px(const struct rn_camera *camera, const struct rn_point *point,
                      const struct rn_sighting *sighting) {
    double axes[3], pixel[2];
    rn_camera_axes(camera, point->position, axes);
    if (!rn_camera_project(camera, axes, pixel)) return NAN;
    return hypot(pixel[0] - (double)sighting->x * camera->width,
                 pixel[1] - (double)sighting->y * camera->height);
}

// Of one point, over the photographs that saw it.
struct miss {
    double sum;
    size_t count;
};

static int compare_misses(const void *a, const void *b) {
    double left = ((const struct miss *)a)->sum, right = ((const struct miss *)b)->sum;
    return (left > right) - (left < right);
}

enum rn_status rn_dataset_reproject(const struct rn_dataset *dataset,
                                    struct rn_reprojection *ret_found, struct rn_error *err) {
    const struct rn_points *points = &dataset->points;
    size_t photo_count;
    const struct rn_frame **frames = frames_by_photo(dataset, &photo_count);
    struct miss *of = calloc(points->count + 1, sizeof *of);
    if (!frames || !of) {
        free(frames);
        free(of);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    }
    struct rn_reprojection found = {0};
    for (size_t i = 0; i < points->sighting_count; i++) {
        const struct rn_sighting *sighting = &points->sightings[i];
        const struct rn_frame *frame =
            sighting->photo < photo_count ? frames[sighting->photo] : NULL;
        if (!frame) continue;
        double miss = miss_px(&frame->camera, &points->items[sighting->point], sighting);
        found.unseen += isnan(miss);
        if (isnan(miss)) continue;
        of[sighting->point].sum += miss;
        of[sighting->point].count++;
        found.sightings++;
    }
    for (size_t i = 0; i < points->count; i++) {
        if (!of[i].count) continue;
        double mean = of[i].sum / (double)of[i].count;
        found.mean_px += mean;
        found.said_px += (double)points->items[i].error;
        of[found.points++].sum = mean; // at or before i
    }
    if (found.points) {
        qsort(of, found.points, sizeof *of, compare_misses);
        found.median_px = of[found.points / 2].sum;
        found.mean_px /= (double)found.points;
        found.said_px /= (double)found.points;
    }
    free(frames);
    free(of);
    *ret_found = found;
    return RN_OK;
}

static void tell_reprojection(struct rn_reader *reader) {
    struct rn_reprojection found;
    const struct rn_dataset *dataset = reader->dataset;
    if (!dataset->points.sighting_count || rn_dataset_reproject(dataset, &found, NULL)) return;
    bool suspect = found.mean_px > SUSPECT_PX || found.unseen > found.sightings / 10;
    rn_problems_add(
        reader->problems, suspect ? RN_SEVERITY_WARNING : RN_SEVERITY_INFO, reader->folder,
        "%zu sparse points, seen %zu times: mean reprojection error %.4f px (median "
        "%.4f) as the cameras are read, %.4f px as the model says; %zu sightings lie "
        "where their camera does not see%s",
        found.points, found.sightings, found.mean_px, found.median_px, found.said_px, found.unseen,
        suspect ? ": poses, lenses and points do not belong together" : "");
}

// ---- how the photographs were taken ----

static int compare_numbers(const void *a, const void *b) {
    double left = *(const double *)a, right = *(const double *)b;
    return (left > right) - (left < right);
}

// How far the axis passes the point, in parts of the distance; infinite when it is behind.
static double axis_miss(const struct rn_camera *camera, const double point[3]) {
    double along = 0, squared = 0;
    for (int i = 0; i < 3; i++) {
        double offset = point[i] - camera->world_from_camera[i][3];
        along += offset * camera->world_from_camera[i][2];
        squared += offset * offset;
    }
    if (!(along > 0)) return INFINITY;
    return sqrt(fmax(0, 1 - along * along / squared));
}

void rn_dataset_capture(const struct rn_dataset *dataset, struct rn_capture *ret_capture) {
    struct rn_bounds nearest = rn_bounds_from_cameras(dataset, 1);
    struct rn_capture capture = {.kind = RN_CAPTURE_AROUND};
    double mean[3] = {0}, *misses = malloc((dataset->frame_count + 1) * sizeof *misses);
    for (size_t f = 0; f < dataset->frame_count; f++) {
        const struct rn_camera *camera = &dataset->frames[f].camera;
        for (int i = 0; i < 3; i++)
            mean[i] += camera->world_from_camera[i][2] / (double)dataset->frame_count;
        if (misses) misses[f] = axis_miss(camera, nearest.centre);
    }
    capture.alignment = sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]);
    capture.miss = INFINITY;
    if (misses && dataset->frame_count) {
        qsort(misses, dataset->frame_count, sizeof *misses, compare_numbers);
        capture.miss = misses[dataset->frame_count / 2];
    }
    free(misses);
    memcpy(capture.centre, nearest.centre, sizeof capture.centre);
    if (capture.alignment >= FORWARD)
        capture.kind = RN_CAPTURE_FORWARD;
    else if (capture.miss <= CONVERGENT)
        capture.kind = RN_CAPTURE_OBJECT;
    *ret_capture = capture;
}

static void tell_capture(struct rn_reader *reader) {
    static const char *const kinds[] = {"photographs of something turned around",
                                        "forward-facing photographs",
                                        "photographs of the surroundings"};
    struct rn_capture capture;
    rn_dataset_capture(reader->dataset, &capture);
    rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                    "%s: the mean view direction has length %.2f (%.2g and more is "
                    "forward-facing), half of the axes pass (%.4g, %.4g, %.4g) within %.0f %% of "
                    "the distance (%.0f %% and less is turned around)",
                    kinds[capture.kind], capture.alignment, FORWARD, capture.centre[0],
                    capture.centre[1], capture.centre[2], 100 * fmin(capture.miss, 9.99),
                    100 * CONVERGENT);
}

void rn_reader_tell_agreement(struct rn_reader *reader) {
    tell_reprojection(reader);
    if (!(reader->dataset->format->sphere > 0) && reader->dataset->bounds.source != RN_BOUNDS_GIVEN)
        tell_capture(reader);
}

// ---- two layouts of one folder ----

static int compare_paths(const void *a, const void *b) {
    const struct rn_frame *const *left = a, *const *right = b;
    return strcmp((*left)->path, (*right)->path);
}

static const struct rn_frame **frames_by_path(const struct rn_dataset *dataset) {
    const struct rn_frame **frames = malloc((dataset->frame_count + 1) * sizeof *frames);
    for (size_t i = 0; frames && i < dataset->frame_count; i++)
        frames[i] = &dataset->frames[i];
    if (frames && dataset->frame_count)
        qsort(frames, dataset->frame_count, sizeof *frames, compare_paths);
    return frames;
}

static double pose_difference(const struct rn_camera *a, const struct rn_camera *b, double radius) {
    double worst = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++)
            worst = fmax(worst, fabs(a->world_from_camera[i][j] - b->world_from_camera[i][j]) /
                                    (j == 3 ? radius : 1));
    return worst;
}

// Both values of what differs most between the photographs that both have.
static void tell_difference(struct rn_reader *reader, const struct rn_dataset *other,
                            const struct rn_frame **of, const struct rn_frame **others) {
    const struct rn_dataset *dataset = reader->dataset;
    const struct rn_frame *worst = NULL, *worst_other = NULL;
    double pose = 0, focal = 0;
    size_t common = 0;
    for (size_t i = 0, j = 0; i < dataset->frame_count && j < other->frame_count;) {
        int order = strcmp(of[i]->path, others[j]->path);
        if (order == 0) {
            double off = fabs(of[i]->camera.fx - others[j]->camera.fx);
            pose = fmax(
                pose, pose_difference(&of[i]->camera, &others[j]->camera, dataset->bounds.radius));
            if (off >= focal) worst = of[i], worst_other = others[j];
            focal = fmax(focal, off);
            common++;
        }
        i += order <= 0;
        j += order >= 0;
    }
    if (!worst) return;
    bool same = pose <= SAME_POSE && focal <= SAME_FOCAL * worst->camera.fx;
    rn_problems_add(reader->problems, same ? RN_SEVERITY_INFO : RN_SEVERITY_WARNING, reader->folder,
                    "%s and %s have %zu photographs in common: poses differ by up to %.2g of the "
                    "scene's radius, focal lengths by up to %.6g px (%s: %.6g and %.6g); those of "
                    "%s are used",
                    dataset->format->title, other->format->title, common, pose, focal, worst->name,
                    worst->camera.fx, worst_other->camera.fx, dataset->format->title);
}

void rn_reader_compare(struct rn_reader *reader, const struct rn_format *format) {
    struct rn_dataset *other = NULL;
    struct rn_read_options options = {.format = format->name};
    if (rn_dataset_read_as(reader->folder, &options, NULL, &other, NULL)) return;
    const struct rn_frame **of = frames_by_path(reader->dataset), **others = frames_by_path(other);
    if (of && others) tell_difference(reader, other, of, others);
    free(of);
    free(others);
    rn_dataset_destroy(&other);
}
