#include "common/dataset/triangulate.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/calls.h"
#include "common/dataset/grey.h"
#include "common/dataset/output.h"
#include "common/dataset/patch.h"
#include "common/dataset/reader.h"
#include "common/math/nearest.h"
#include "common/math/vector.h"

#define SIDE 400       // pixels, about: the longest side at which photographs are compared
#define ALL 20000      // corners that are looked for
#define LEAST 32       // of them a photograph,
#define MOST 256       // and at most
#define CORNER 8.0f    // grey levels a pixel, squared: the least of a corner's two gradients
#define COLOURS 200    // the same of their colours
#define NEIGHBOURS 6   // photographs that a corner is looked for in,
#define WITNESSES 2    // those withheld, in which what was found is looked for afterwards,
#define ALONG 0.85     // whose axes have at least this cosine with its own,
#define TOO_NEAR 0.125 // no nearer than this share of the way to the last that could be,
#define BESIDE 1e-6    // none beside another, within this share of the way to it
#define AGREE 3        // of them must show it alike, and those that do most count
#define ALIKE 0.85     // the correlation from which they do, of the mean of these,
#define SEEN 0.7       // and of one
#define DOUBT 0.5      // where the nearest AGREE are all less alike, the others are not asked
#define APART 0.08     // by which it falls to both sides before it rises again, if it does, to less
#define NEAREST 2.0    // times the way to the nearest neighbour: nothing is looked for nearer
#define STEPS 2048     // along a corner's ray, at most

struct corner {
    float x, y; // of the small copy
    float strength;
    uint8_t colour[3];
};

// A photograph, small; without grey where it was not looked at.
struct look {
    const struct rn_frame *frame;
    bool withheld;
    struct rn_camera camera; // of the copy
    int cell;                // pixels of the photograph a side that make one of the copy
    uint8_t *grey;
    struct rn_image colours; // smaller still; without pixels where memory was out
    struct corner *corners;
    int count;
};

// A point, and by which photographs about it was seen, and where.
struct found {
    struct rn_point point;
    struct rn_sighting
        sightings[1 + NEIGHBOURS + WITNESSES]; // the corner's own first; `point` is not set
    int count;
};

struct rn_triangulation {
    const char *name;
    struct look *looks;
    size_t count;
    int most;             // corners of a photograph
    struct found **found; // of each look
    size_t *found_count;
};

void rn_triangulation_destroy(struct rn_triangulation **triangulation) {
    struct rn_triangulation *t = *triangulation;
    if (!t) return;
    for (size_t i = 0; i < t->count; i++) {
        free(t->looks[i].grey);
        free(t->looks[i].corners);
        rn_image_finish(&t->looks[i].colours);
        if (t->found) free(t->found[i]);
    }
    free(t->looks);
    free(t->found);
    free(t->found_count);
    free(t);
    *triangulation = NULL;
}

static bool is_called_for(const struct rn_dataset *dataset) {
    return !dataset->points.sighting_count && !rn_dataset_is_cut_out(dataset);
}

// A number for each view, the same at all scales.
static void number_photographs(struct rn_dataset *dataset) {
    for (size_t i = 0; i < dataset->frame_count; i++) {
        struct rn_frame *frame = &dataset->frames[i];
        bool same = i > 0 && frame[-1].split == frame->split && frame[-1].index == frame->index;
        frame->photo = i == 0 ? 0 : frame[-1].photo + !same;
    }
}

static bool is_withheld(const struct rn_frame *frame, int test_every) {
    return frame->split != RN_SPLIT_TRAIN || (test_every >= 2 && frame->index % test_every == 0);
}

enum rn_status rn_triangulation_create(struct rn_dataset *dataset, int test_every,
                                       struct rn_triangulation **ret_triangulation,
                                       struct rn_error *err) {
    *ret_triangulation = NULL;
    if (!is_called_for(dataset)) return RN_OK;
    struct rn_triangulation *t = calloc(1, sizeof *t);
    size_t usable[2] = {0, 0}, kept[2] = {0, 0}; // trained on, withheld
    for (size_t i = 0; i < dataset->frame_count; i++)
        if (dataset->frames[i].scale == 0) usable[is_withheld(&dataset->frames[i], test_every)]++;
    if (t) {
        size_t most = usable[0] + usable[1] + 1;
        t->name = dataset->name;
        t->looks = calloc(most, sizeof *t->looks);
        t->found = calloc(most, sizeof *t->found);
        t->found_count = calloc(most, sizeof *t->found_count);
    }
    if (!t || !t->looks || !t->found || !t->found_count) {
        rn_triangulation_destroy(&t);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    }
    number_photographs(dataset);
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        bool withheld = is_withheld(frame, test_every);
        size_t stride = (usable[withheld] + RN_TRIANGULATE_PHOTOS - 1) / RN_TRIANGULATE_PHOTOS;
        if (frame->scale == 0 && kept[withheld]++ % stride == 0)
            t->looks[t->count++] = (struct look){.frame = frame, .withheld = withheld};
    }
    double share = (double)ALL / fmax(1, fmin((double)usable[0], RN_TRIANGULATE_PHOTOS));
    t->most = (int)fmin(MOST, fmax(LEAST, share));
    *ret_triangulation = t;
    return RN_OK;
}

// ---- corners ----

// The smaller eigenvalue of the gradients' second moments about a pixel (Shi and Tomasi, CVPR
// 1994), a pixel; the surroundings lie in the picture.
static float corner_strength(const uint8_t *grey, int width, int x, int y) {
    float xx = 0, xy = 0, yy = 0;
    for (int v = y - RN_PATCH_HALF + 1; v < y + RN_PATCH_HALF; v++)
        for (int u = x - RN_PATCH_HALF + 1; u < x + RN_PATCH_HALF; u++) {
            const uint8_t *p = grey + (ptrdiff_t)v * width + u;
            float gx = 0.5f * (float)(p[1] - p[-1]), gy = 0.5f * (float)(p[width] - p[-width]);
            xx += gx * gx;
            xy += gx * gy;
            yy += gy * gy;
        }
    float mean = 0.5f * (xx + yy), off = 0.5f * (xx - yy);
    return (mean - sqrtf(off * off + xy * xy)) /
           (float)((2 * RN_PATCH_HALF - 1) * (2 * RN_PATCH_HALF - 1));
}

// The strongest corner of a tile, `to` being beyond its last pixel; strength CORNER: it has none.
static struct corner find_corner(const struct look *look, const int from[2], const int to[2]) {
    struct corner best = {.strength = CORNER};
    for (int y = from[1]; y < to[1]; y++)
        for (int x = from[0]; x < to[0]; x++) {
            float strength = corner_strength(look->grey, look->camera.width, x, y);
            if (strength > best.strength)
                best = (struct corner){(float)x + 0.5f, (float)y + 0.5f, strength, {0}};
        }
    return best;
}

static int smaller(int a, int b) {
    return a < b ? a : b;
}

// One of each of some `most` tiles that the picture is cut into.
static void find_corners(struct look *look, int most) {
    int width = look->camera.width, height = look->camera.height, edge = RN_PATCH_HALF + 1;
    int tile = (int)ceil(sqrt((double)width * height / most));
    look->corners = malloc(((size_t)(width / tile) + 1) * ((size_t)(height / tile) + 1) *
                           sizeof *look->corners);
    for (int top = edge; look->corners && top < height - edge; top += tile)
        for (int left = edge; left < width - edge; left += tile) {
            const int from[2] = {left, top};
            const int to[2] = {smaller(left + tile, width - edge),
                               smaller(top + tile, height - edge)};
            struct corner best = find_corner(look, from, to);
            if (best.strength > CORNER) look->corners[look->count++] = best;
        }
}

static struct look *look_of(struct rn_triangulation *t, const struct rn_frame *frame) {
    size_t low = 0, high = t->count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (t->looks[middle].frame < frame)
            low = middle + 1;
        else
            high = middle;
    }
    return low < t->count && t->looks[low].frame == frame ? &t->looks[low] : NULL;
}

static void take_colours(struct look *look, const struct rn_image *image) {
    double times = fmax(1, fmax(image->width, image->height) / (double)COLOURS);
    struct rn_error ignored;
    if (rn_image_downscale(image, (int)fmax(1, round(image->width / times)),
                           (int)fmax(1, round(image->height / times)), RN_DOWNSCALE_STRAIGHT,
                           &look->colours, &ignored))
        look->colours.pixels = NULL;
}

void rn_triangulation_look(struct rn_triangulation *t, const struct rn_frame *frame,
                           const struct rn_image *image) {
    struct look *look = t ? look_of(t, frame) : NULL;
    if (!look) return;
    int cell, width, height;
    float *grey = rn_grey(image, SIDE, &cell, &width, &height);
    if (grey) look->grey = malloc((size_t)width * (size_t)height);
    for (int i = 0; look->grey && i < width * height; i++)
        look->grey[i] = (uint8_t)(grey[i] + 0.5f);
    free(grey);
    if (!look->grey) return;
    look->cell = cell;
    look->camera = frame->camera;
    look->camera.width = width * cell; // what is cut off lies at the right and at the bottom
    look->camera.height = height * cell;
    look->camera = rn_camera_resized(&look->camera, width, height);
    take_colours(look, image);
    if (look->withheld) return;
    find_corners(look, t->most);
    for (int i = 0; i < look->count; i++) {
        struct corner *corner = &look->corners[i];
        size_t x = (size_t)(corner->x * (float)cell), y = (size_t)(corner->y * (float)cell);
        memcpy(corner->colour, image->pixels + 4 * (y * (size_t)image->width + x), 3);
    }
}

// ---- what is compared ----

static struct rn_grey_picture picture_of(const struct look *look) {
    return (struct rn_grey_picture){look->grey, look->camera.width, look->camera.height};
}

// The way from a corner's ray to a neighbour's picture: what lies at distance d along the ray is
// drawn where `from` + `ray` / d points to, in camera axes (from: the neighbour's, of the ray's
// origin over d). Beside it the rays a pixel to the right and below.
struct neighbour {
    const struct look *look;
    double from[3], ray[3][3];
};

static void prepare(const struct look *look, const struct corner *corner, const struct look *other,
                    struct neighbour *ret) {
    static const double step[3][2] = {{0, 0}, {1, 0}, {0, 1}};
    ret->look = other;
    for (int k = 0; k < 3; k++) {
        struct rn_ray ray = rn_camera_ray(&look->camera, (double)corner->x + step[k][0],
                                          (double)corner->y + step[k][1]);
        for (int i = 0; i < 3; i++) {
            ret->ray[k][i] = 0;
            for (int j = 0; j < 3; j++)
                ret->ray[k][i] += other->camera.world_from_camera[j][i] * ray.direction[j];
        }
        rn_camera_axes(&other->camera, ray.origin, ret->from);
    }
}

// The correlation with what a neighbour shows of the corner at distance 1 / nearness, and where;
// -1 where it shows nothing.
static float correlate(const struct neighbour *neighbour, const struct rn_patch *patch,
                       double nearness, double ret_at[2]) {
    double places[3][2], right[2], down[2];
    for (int k = 0; k < 3; k++) {
        double p[3];
        for (int i = 0; i < 3; i++)
            p[i] = neighbour->from[i] * nearness + neighbour->ray[k][i];
        if (!rn_camera_project(&neighbour->look->camera, p, places[k])) return -1;
    }
    for (int i = 0; i < 2; i++) {
        right[i] = places[1][i] - places[0][i];
        down[i] = places[2][i] - places[0][i];
        ret_at[i] = places[0][i];
    }
    struct rn_grey_picture picture = picture_of(neighbour->look);
    struct rn_patch other;
    if (!rn_patch_take(&picture, places[0], right, down, &other)) return -1;
    return rn_patch_correlate(patch, &other);
}

// ---- a corner's depth ----

// The mean of the AGREE largest, at most 1; -1 where there are not so many.
static float agreement(const struct neighbour *neighbours, int count, const struct rn_patch *patch,
                       double nearness) {
    float best[AGREE], sum = 0;
    for (int k = 0; k < AGREE; k++)
        best[k] = -1;
    for (int n = 0; n < count; n++) {
        double at[2];
        if (n == AGREE && best[0] < DOUBT) return -1;
        float value = correlate(&neighbours[n], patch, nearness, at);
        for (int k = 0; k < AGREE; k++)
            if (value > best[k]) {
                float less = best[k];
                best[k] = value;
                value = less;
            }
    }
    for (int k = 0; k < AGREE; k++)
        sum += best[k] / AGREE;
    return best[AGREE - 1] > -1 ? sum : -1;
}

// The nearness at which a corner's neighbours agree, and nowhere else as well; NAN where there is
// none. `scores`: room for STEPS.
static double find_nearness(const struct neighbour *neighbours, int count,
                            const struct rn_patch *patch, double most, int steps, float *scores) {
    int best = 0;
    for (int i = 0; i < steps; i++) {
        scores[i] = agreement(neighbours, count, patch, most * i / (steps - 1));
        if (scores[i] > scores[best]) best = i;
    }
    if (!(scores[best] >= ALIKE) || best + 1 >= steps) return NAN;
    int first = best, last = best;
    while (first > 0 && scores[first - 1] > scores[best] - APART)
        first--;
    while (last + 1 < steps && scores[last + 1] > scores[best] - APART)
        last++;
    for (int i = 0; i < steps; i++)
        if ((i < first || i > last) && scores[i] > scores[best] - APART) return NAN;
    double left = best > 0 ? scores[best - 1] : scores[best + 1], right = scores[best + 1];
    double bend = left + right - 2 * scores[best];
    double off = bend < 0 ? 0.5 * (left - right) / bend : 0;
    return most * (best + fmax(-0.5, fmin(0.5, off))) / (steps - 1);
}

static double apart(const struct look *a, const struct look *b) {
    double place[3];
    rn_camera_place(&b->camera, place);
    return rn_camera_distance(&a->camera, place);
}

// Whether one that is kept stands there already: of what it shows, the other shows nothing anew.
static bool is_kept(const struct rn_triangulation *t, const struct rn_nearest *kept,
                    const struct look *other, double reach) {
    for (int i = 0; i < kept->count; i++)
        if (apart(&t->looks[kept->which[i]], other) <= reach) return true;
    return false;
}

// The photographs nearest to one that look the same way, each from a place of its own, withheld or
// not, `most` at most; their number.
static int find_neighbours(const struct rn_triangulation *t, const struct look *look, bool withheld,
                           int most, const struct look **ret) {
    struct rn_nearest nearest = {.most = 2 * most};
    int count = 0;
    for (size_t i = 0; i < t->count; i++) {
        const struct look *other = &t->looks[i];
        double along = 0;
        if (!other->grey || other == look || other->withheld != withheld) continue;
        for (int k = 0; k < 3; k++)
            along += look->camera.world_from_camera[k][2] * other->camera.world_from_camera[k][2];
        double away = apart(look, other);
        if (along >= ALONG && !is_kept(t, &nearest, other, BESIDE * away))
            rn_nearest_offer(&nearest, away, i);
    }
    for (int i = 0; i < nearest.count && count < most; i++)
        if (nearest.apart[i] > TOO_NEAR * nearest.apart[nearest.count - 1])
            ret[count++] = &t->looks[nearest.which[i]];
    return count;
}

// The point of a corner, and where it was seen: placed by `count` others, looked for in
// `witnesses` more behind these. False where there is none, or infinitely far.
static bool place_corner(const struct look *look, const struct corner *corner,
                         const struct look *const *others, int count, int witnesses, float *scores,
                         struct found *ret) {
    static const double right[2] = {1, 0}, down[2] = {0, 1};
    struct neighbour neighbours[NEIGHBOURS + WITNESSES];
    struct rn_grey_picture picture = picture_of(look);
    struct rn_patch patch;
    double at[2] = {(double)corner->x, (double)corner->y};
    struct rn_ray ray = rn_camera_ray(&look->camera, at[0], at[1]);
    if (!(ray.radius > 0) || !rn_patch_take(&picture, at, right, down, &patch) ||
        !rn_patch_normalise(&patch))
        return false;
    for (int n = 0; n < count + witnesses; n++)
        prepare(look, corner, others[n], &neighbours[n]);
    double near = apart(look, others[0]), far = apart(look, others[count - 1]);
    double most = 1 / (NEAREST * near); // a step moves what the farthest sees by a pixel
    int steps = (int)fmin(STEPS, ceil(far * most * look->camera.fx) + 1);
    double nearness = find_nearness(neighbours, count, &patch, most, steps, scores);
    if (!(nearness > 0)) return false;
    *ret = (struct found){.point.error = -1};
    memcpy(ret->point.colour, corner->colour, sizeof corner->colour);
    for (int i = 0; i < 3; i++)
        ret->point.position[i] = ray.origin[i] + ray.direction[i] / nearness;
    for (int n = -1; n < count + witnesses; n++) {
        const struct look *by = n < 0 ? look : others[n];
        if (n >= 0 && !(correlate(&neighbours[n], &patch, nearness, at) >= SEEN)) continue;
        ret->sightings[ret->count++] =
            (struct rn_sighting){.photo = (uint32_t)by->frame->photo,
                                 .x = (float)(at[0] * by->cell / by->frame->camera.width),
                                 .y = (float)(at[1] * by->cell / by->frame->camera.height)};
    }
    return true;
}

static enum rn_status place_corners(void *context, size_t index, struct rn_error *err) {
    struct rn_triangulation *t = context;
    const struct look *look = &t->looks[index], *others[NEIGHBOURS + WITNESSES];
    if (!look->grey || !look->corners) return RN_OK;
    int count = find_neighbours(t, look, false, NEIGHBOURS, others);
    if (count < AGREE) return RN_OK;
    int witnesses = find_neighbours(t, look, true, WITNESSES, others + count);
    float *scores = malloc(STEPS * sizeof *scores);
    struct found *found = t->found[index] = malloc(((size_t)look->count + 1) * sizeof *found);
    if (!scores || !found) {
        free(scores);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, t->name, "out of memory");
    }
    for (int i = 0; i < look->count; i++)
        if (place_corner(look, &look->corners[i], others, count, witnesses, scores,
                         &found[t->found_count[index]]))
            t->found_count[index]++;
    free(scores);
    return RN_OK;
}

// ---- all of them ----

// Every so-manyth stays, so that `count` more are not too many.
static void make_room(struct rn_points *points, size_t count) {
    size_t room = RN_POINTS_MAX - count, stride = (points->count + room - 1) / room, kept = 0;
    for (size_t i = 0; i < points->count; i += stride)
        points->items[kept++] = points->items[i];
    points->count = kept;
}

// Onto the end of the dataset's.
static enum rn_status take_found(const struct rn_triangulation *t, size_t count,
                                 struct rn_points *points, struct rn_error *err) {
    if (!count) return RN_OK;
    make_room(points, count);
    points->found = true;
    struct rn_point *items = realloc(points->items, (points->count + count) * sizeof *items);
    if (items) points->items = items;
    struct rn_sighting *sightings =
        realloc(points->sightings, count * (1 + NEIGHBOURS + WITNESSES) * sizeof *sightings);
    if (sightings) points->sightings = sightings;
    if (!items || !sightings)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, t->name, "out of memory");
    for (size_t i = 0; i < t->count; i++)
        for (size_t k = 0; k < t->found_count[i]; k++) {
            const struct found *found = &t->found[i][k];
            for (int s = 0; s < found->count; s++) {
                struct rn_sighting *sighting = &points->sightings[points->sighting_count++];
                *sighting = found->sightings[s];
                sighting->point = (uint32_t)points->count;
            }
            points->items[points->count++] = found->point;
        }
    return RN_OK;
}

enum rn_status rn_triangulation_solve(struct rn_triangulation *t, int threads,
                                      struct rn_dataset *dataset,
                                      bool (*progress)(void *context, size_t done, size_t total),
                                      void *context, size_t *ret_count, struct rn_error *err) {
    *ret_count = 0;
    if (!t) return RN_OK;
    enum rn_status status =
        rn_output_run(threads, t->count, place_corners, t, progress, context, t->name, err);
    for (size_t i = 0; i < t->count; i++)
        *ret_count += t->found_count[i];
    return status ? status : take_found(t, *ret_count, &dataset->points, err);
}

void rn_triangulation_show(const struct rn_triangulation *t, struct rn_exposures *exposures) {
    for (size_t i = 0; t && i < t->count; i++)
        if (t->looks[i].colours.pixels)
            rn_exposures_look(exposures, t->looks[i].frame, &t->looks[i].colours);
}
