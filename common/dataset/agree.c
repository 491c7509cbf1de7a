// Whether what a capture says of itself agrees: its sparse points with the photographs that saw
// them, one layout in its folder with the next.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/reader.h"

#define SUSPECT_PX 2.0  // a mean error of points above it means that something is misread
#define SAME_POSE 1e-6  // of the scene's radius
#define SAME_FOCAL 1e-6 // relative

// ---- points against photographs ----

const struct rn_frame **rn_frames_by_photo(const struct rn_dataset *dataset, size_t *ret_count) {
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
    const struct rn_frame **frames = rn_frames_by_photo(dataset, &photo_count);
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
        found.p95_px = of[found.points * 95 / 100].sum;
        found.mean_px /= (double)found.points;
        found.said_px /= (double)found.points;
    }
    free(frames);
    free(of);
    *ret_found = found;
    return RN_OK;
}

enum rn_status rn_dataset_reproject_photos(const struct rn_dataset *dataset,
                                           const struct rn_frame *const *frames, size_t count,
                                           double *ret_px) {
    size_t photo_count;
    const struct rn_frame **by_photo = rn_frames_by_photo(dataset, &photo_count);
    struct miss *of = calloc(photo_count + 1, sizeof *of);
    for (size_t i = 0; by_photo && of && i < dataset->points.sighting_count; i++) {
        const struct rn_sighting *sighting = &dataset->points.sightings[i];
        if (sighting->photo >= photo_count || !by_photo[sighting->photo]) continue;
        double miss = miss_px(&by_photo[sighting->photo]->camera,
                              &dataset->points.items[sighting->point], sighting);
        if (isnan(miss)) continue;
        of[sighting->photo].sum += miss;
        of[sighting->photo].count++;
    }
    for (size_t i = 0; by_photo && of && i < count; i++) {
        const struct miss *miss = &of[frames[i]->photo];
        ret_px[i] = miss->count ? miss->sum / (double)miss->count : NAN;
    }
    enum rn_status status = by_photo && of ? RN_OK : RN_ERROR_NO_MEMORY;
    free(by_photo);
    free(of);
    return status;
}

// A model's pixels are those of the photographs that it was made from.
static void tell_said(const struct rn_reader *reader, double said_px, char *text, size_t capacity) {
    double by = reader->resized;
    if (isnan(by))
        snprintf(text, capacity, ", %.4f px as the model says of photographs of its sizes",
                 said_px);
    else if (by > 0 && by != 1)
        snprintf(text, capacity,
                 ", %.4f px as the model says (%.4f px of photographs %.3g times as large)",
                 said_px * by, said_px, 1 / by);
    else
        snprintf(text, capacity, ", %.4f px as the model says", said_px);
}

void rn_reader_tell_reprojection(struct rn_reader *reader) {
    struct rn_reprojection found;
    const struct rn_dataset *dataset = reader->dataset;
    const struct rn_points *points = &dataset->points;
    if (!points->sighting_count || points->found || rn_dataset_reproject(dataset, &found, NULL))
        return;
    bool suspect = found.mean_px > SUSPECT_PX || found.unseen > found.sightings / 10;
    char said[96] = "", unseen[80] = "";
    if (found.said_px >= 0) tell_said(reader, found.said_px, said, sizeof said);
    if (found.unseen)
        snprintf(unseen, sizeof unseen, "; %zu sightings lie where their camera does not see",
                 found.unseen);
    rn_problems_add(reader->problems, suspect ? RN_SEVERITY_WARNING : RN_SEVERITY_INFO,
                    reader->folder,
                    "%zu sparse points, seen %zu times: mean reprojection error %.4f px (median "
                    "%.4f) as the cameras are read%s%s%s",
                    found.points, found.sightings, found.mean_px, found.median_px, said, unseen,
                    suspect ? ": poses, lenses and points do not belong together" : "");
}

// ---- two layouts of one folder ----

// Of the same photograph those that are trained on first.
static int compare_paths(const void *a, const void *b) {
    const struct rn_frame *const *left = a, *const *right = b;
    int order = strcmp((*left)->path, (*right)->path);
    return order ? order : (int)(*left)->split - (int)(*right)->split;
}

static const struct rn_frame **frames_by_path(const struct rn_dataset *dataset) {
    const struct rn_frame **frames = malloc((dataset->frame_count + 1) * sizeof *frames);
    for (size_t i = 0; frames && i < dataset->frame_count; i++)
        frames[i] = &dataset->frames[i];
    if (frames && dataset->frame_count)
        qsort(frames, dataset->frame_count, sizeof *frames, compare_paths);
    return frames;
}

enum rn_status rn_reader_leave_out_shared(struct rn_reader *reader, struct rn_error *err) {
    struct rn_dataset *dataset = reader->dataset;
    const struct rn_frame **frames = frames_by_path(dataset), *trained_on = NULL;
    bool *shared = calloc(dataset->frame_count + 1, sizeof *shared);
    size_t kept = 0, left_out[RN_SPLIT_COUNT] = {0}, of[RN_SPLIT_COUNT] = {0};
    if (!frames || !shared) {
        free(frames);
        free(shared);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, reader->folder, "out of memory");
    }
    for (size_t i = 0; i < dataset->frame_count; i++) {
        if (frames[i]->split == RN_SPLIT_TRAIN)
            trained_on = frames[i];
        else
            shared[frames[i] - dataset->frames] =
                trained_on && strcmp(trained_on->path, frames[i]->path) == 0;
    }
    free(frames);
    for (size_t i = 0; i < dataset->frame_count; i++) {
        struct rn_frame *frame = &dataset->frames[i];
        of[frame->split]++;
        left_out[frame->split] += shared[i];
        if (shared[i])
            rn_frame_finish(frame);
        else
            dataset->frames[kept++] = *frame;
    }
    dataset->frame_count = kept;
    free(shared);
    for (enum rn_split split = 0; split < RN_SPLIT_COUNT; split++)
        if (left_out[split])
            rn_problems_add(reader->problems, RN_SEVERITY_WARNING, reader->folder,
                            "%zu of %zu %s views are photographs that are trained on too: left "
                            "out, as they would say how well these were learnt by heart%s",
                            left_out[split], of[split], rn_split_name(split),
                            split == RN_SPLIT_TEST && left_out[split] == of[split]
                                ? "; --split every:8 tests with each 8th photograph"
                                : "");
    return RN_OK;
}

// A photograph that both layouts have.
struct pair {
    const struct rn_frame *own, *other;
};

static size_t list_pairs(const struct rn_dataset *dataset, const struct rn_dataset *other,
                         const struct rn_frame **of, const struct rn_frame **others,
                         struct pair *pairs) {
    size_t count = 0;
    for (size_t i = 0, j = 0; i < dataset->frame_count && j < other->frame_count;) {
        int order = strcmp(of[i]->path, others[j]->path);
        if (order == 0) pairs[count++] = (struct pair){of[i], others[j]};
        i += order <= 0;
        j += order >= 0;
    }
    return count;
}

// How the coordinates of the other layout lie in ours: to + scale * turn (x - from).
struct placing {
    double turn[3][3], scale, from[3], to[3];
};

static const struct placing as_it_is = {.turn = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, .scale = 1};

// The turn by the first photograph, scale and shift by the cameras' spread about their middle: the
// similarity where there is one, as programs move a scene that they write (applied_transform).
static struct placing place(const struct pair *pairs, size_t count) {
    struct placing p = {.scale = 1};
    double spread[2] = {0, 0};
    for (size_t n = 0; n < count; n++)
        for (int i = 0; i < 3; i++) {
            p.to[i] += pairs[n].own->camera.world_from_camera[i][3] / (double)count;
            p.from[i] += pairs[n].other->camera.world_from_camera[i][3] / (double)count;
        }
    for (size_t n = 0; n < count; n++)
        for (int i = 0; i < 3; i++) {
            spread[0] += pow(pairs[n].own->camera.world_from_camera[i][3] - p.to[i], 2);
            spread[1] += pow(pairs[n].other->camera.world_from_camera[i][3] - p.from[i], 2);
        }
    for (int i = 0; i < 9; i++)
        for (int k = 0; k < 3; k++)
            p.turn[i / 3][i % 3] += pairs[0].own->camera.world_from_camera[i / 3][k] *
                                    pairs[0].other->camera.world_from_camera[i % 3][k];
    if (spread[0] > 0 && spread[1] > 0) p.scale = sqrt(spread[0] / spread[1]);
    return p;
}

static double pose_difference(const struct placing *p, const struct pair *pairs, size_t count,
                              double radius) {
    double worst = 0;
    for (size_t n = 0; n < count; n++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 4; j++) {
                double there = j == 3 ? p->to[i] : 0;
                for (int k = 0; k < 3; k++) {
                    double at = pairs[n].other->camera.world_from_camera[k][j];
                    there += p->turn[i][k] * (j == 3 ? p->scale * (at - p->from[k]) : at);
                }
                double off = fabs(pairs[n].own->camera.world_from_camera[i][j] - there);
                worst = fmax(worst, off / (j == 3 ? radius : 1));
            }
    return worst;
}

// Both values of what differs most between the photographs that both have.
static void tell_difference(struct rn_reader *reader, const struct rn_dataset *other,
                            const struct pair *pairs, size_t count) {
    const struct rn_dataset *dataset = reader->dataset;
    const struct pair *worst = pairs;
    double focal = 0, radius = dataset->bounds.radius;
    char moved[128] = "";
    for (size_t n = 0; n < count; n++) {
        double off = fabs(pairs[n].own->camera.fx - pairs[n].other->camera.fx);
        if (off >= focal) worst = &pairs[n];
        focal = fmax(focal, off);
    }
    double pose = pose_difference(&as_it_is, pairs, count, radius);
    if (pose > SAME_POSE && count >= 3) {
        struct placing placing = place(pairs, count);
        double placed = pose_difference(&placing, pairs, count, radius);
        double trace = placing.turn[0][0] + placing.turn[1][1] + placing.turn[2][2];
        if (placed < pose)
            snprintf(moved, sizeof moved,
                     " once %s is turned by %.1f degrees, scaled by %.6g and shifted",
                     other->format->title, acos(fmax(-1, fmin(1, (trace - 1) / 2))) * 180 / M_PI,
                     placing.scale);
        pose = fmin(pose, placed);
    }
    const struct rn_camera *a = &worst->own->camera, *b = &worst->other->camera;
    bool same = pose <= SAME_POSE && focal <= SAME_FOCAL * a->fx;
    rn_problems_add(
        reader->problems, same ? RN_SEVERITY_INFO : RN_SEVERITY_WARNING, reader->folder,
        "%s and %s have %zu photographs in common: poses differ by up to %.2g of the "
        "scene's radius%s, focal lengths by up to %.6g px (%s: %.6g and %.6g); those of "
        "%s are used",
        dataset->format->title, other->format->title, count, pose, moved, focal, worst->own->name,
        a->fx, b->fx, dataset->format->title);
}

void rn_reader_compare(struct rn_reader *reader, const struct rn_format *format) {
    struct rn_dataset *other = NULL;
    struct rn_read_options options = {.format = format->name};
    if (rn_dataset_read_as(reader->folder, &options, NULL, &other, NULL)) return;
    const struct rn_frame **of = frames_by_path(reader->dataset), **others = frames_by_path(other);
    struct pair *pairs = malloc((reader->dataset->frame_count + 1) * sizeof *pairs);
    size_t count =
        of && others && pairs ? list_pairs(reader->dataset, other, of, others, pairs) : 0;
    if (count) tell_difference(reader, other, pairs, count);
    free(pairs);
    free(of);
    free(others);
    rn_dataset_destroy(&other);
}
