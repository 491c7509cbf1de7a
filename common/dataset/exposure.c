#include "common/dataset/exposure.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/numbers.h"

#define ROUNDS 30
#define DARK 16    // of 255: below it noise and black level decide
#define BRIGHT 240 // above it highlights are cut
#define NEAR 0.02  // differences of logarithms below it weigh as if they were it
#define PRIOR 150  // weight of "no difference", as three exact sightings
#define MOST 2000  // photographs compared with all

// A colour that a photograph shows of a point: logarithms; NAN where it is unusable.
struct colour {
    float log[3];
    uint32_t point, photo;
};

struct rn_exposures {
    const struct rn_dataset *dataset;
    struct colour *colours; // of each sighting, by photograph
    uint32_t *source;       // the sighting that each is of
    size_t count;
    size_t *first; // of a photograph's colours; photo_count + 1 of them
    size_t photo_count;
};

void rn_exposures_destroy(struct rn_exposures **exposures) {
    struct rn_exposures *e = *exposures;
    if (!e) return;
    free(e->colours);
    free(e->source);
    free(e->first);
    free(e);
    *exposures = NULL;
}

// Counting sort of the sightings by photograph.
static void sort(struct rn_exposures *e) {
    const struct rn_points *points = &e->dataset->points;
    for (size_t i = 0; i < e->count; i++)
        e->first[points->sightings[i].photo + 1]++;
    for (size_t p = 0; p < e->photo_count; p++)
        e->first[p + 1] += e->first[p];
    for (size_t i = e->count; i-- > 0;) { // backwards: `first` ends as where each begins
        const struct rn_sighting *sighting = &points->sightings[i];
        size_t at = --e->first[sighting->photo + 1];
        e->colours[at] = (struct colour){{NAN, NAN, NAN}, sighting->point, sighting->photo};
        e->source[at] = (uint32_t)i;
    }
    memmove(e->first, e->first + 1, e->photo_count * sizeof *e->first);
    e->first[e->photo_count] = e->count;
}

enum rn_status rn_exposures_create(const struct rn_dataset *dataset,
                                   struct rn_exposures **ret_exposures, struct rn_error *err) {
    const struct rn_points *points = &dataset->points;
    *ret_exposures = NULL;
    if (!points->sighting_count) return RN_OK;
    struct rn_exposures *e = calloc(1, sizeof *e);
    if (e) {
        e->dataset = dataset;
        e->count = points->sighting_count;
        for (size_t i = 0; i < e->count; i++)
            if (points->sightings[i].photo >= e->photo_count)
                e->photo_count = (size_t)points->sightings[i].photo + 1;
        e->colours = malloc(e->count * sizeof *e->colours);
        e->source = malloc(e->count * sizeof *e->source);
        e->first = calloc(e->photo_count + 2, sizeof *e->first);
    }
    if (!e || !e->colours || !e->source || !e->first) {
        rn_exposures_destroy(&e);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, dataset->name, "out of memory");
    }
    sort(e);
    *ret_exposures = e;
    return RN_OK;
}

// The mean of 3 x 3 pixels; false where one of them is dark, cut or see-through.
static bool mean_colour(const struct rn_image *image, int x, int y, double mean[3]) {
    memset(mean, 0, 3 * sizeof *mean);
    for (int dy = -1; dy <= 1; dy++)
        for (int dx = -1; dx <= 1; dx++) {
            const uint8_t *p =
                image->pixels + 4 * ((size_t)(y + dy) * (size_t)image->width + (size_t)(x + dx));
            for (int c = 0; c < 3; c++) {
                if (p[c] < DARK || p[c] > BRIGHT || p[3] < 255) return false;
                mean[c] += p[c] / 9.0;
            }
        }
    return true;
}

void rn_exposures_look(struct rn_exposures *e, const struct rn_frame *frame,
                       const struct rn_image *image) {
    if (!e || (size_t)frame->photo >= e->photo_count || frame->scale != 0) return;
    for (size_t i = e->first[frame->photo]; i < e->first[frame->photo + 1]; i++) {
        const struct rn_sighting *sighting = &e->dataset->points.sightings[e->source[i]];
        int x = (int)floorf(sighting->x * (float)image->width);
        int y = (int)floorf(sighting->y * (float)image->height);
        double mean[3];
        if (x < 1 || y < 1 || x + 1 >= image->width || y + 1 >= image->height ||
            !mean_colour(image, x, y, mean))
            continue;
        for (int c = 0; c < 3; c++)
            e->colours[i].log[c] = (float)log(mean[c]);
    }
}

// Weighted means of what is left of the colours when the other side's part is taken off.
struct side {
    double *value, *sum, *weight; // of each photograph, or each point
    size_t count;
    double prior;
};

static void take_means(struct side *side) {
    for (size_t i = 0; i < side->count; i++) {
        side->value[i] = side->weight[i] > 0 ? side->sum[i] / (side->weight[i] + side->prior) : 0;
        side->sum[i] = side->weight[i] = 0;
    }
}

static void solve_channel(const struct rn_exposures *e, int c, struct side *photos,
                          struct side *points) {
    memset(photos->value, 0, photos->count * sizeof *photos->value);
    for (int round = 0; round < 2 * ROUNDS; round++) {
        struct side *side = round % 2 ? photos : points;
        for (size_t i = 0; i < e->count; i++) {
            const struct colour *colour = &e->colours[i];
            if (isnan(colour->log[c])) continue;
            double photo = photos->value[colour->photo], point = points->value[colour->point];
            double apart = round ? (double)colour->log[c] - photo - point : 1;
            double weight = 1 / fmax(fabs(apart), NEAR);
            size_t at = round % 2 ? colour->photo : colour->point;
            side->sum[at] += weight * ((double)colour->log[c] - (round % 2 ? point : photo));
            side->weight[at] += weight;
        }
        take_means(side);
    }
}

static size_t usable(const struct rn_exposures *e, size_t photo) {
    size_t count = 0;
    for (size_t i = e->first[photo]; photo < e->photo_count && i < e->first[photo + 1]; i++)
        count += !isnan(e->colours[i].log[0]);
    return count;
}

// The solution of a channel into the frames that were measured.
static void give(const struct rn_exposures *e, int c, const double *photos, struct rn_frame *frames,
                 size_t frame_count) {
    double mean = 0;
    size_t measured = 0;
    for (size_t f = 0; f < frame_count; f++) {
        size_t photo = (size_t)frames[f].photo;
        bool is = photo < e->photo_count && usable(e, photo) >= RN_EXPOSURE_SIGHTINGS;
        frames[f].gain[c] = is ? photos[photo] : NAN;
        if (is) mean += photos[photo];
        measured += is;
    }
    for (size_t f = 0; f < frame_count; f++)
        frames[f].gain[c] = isnan(frames[f].gain[c])
                                ? 0
                                : exp(frames[f].gain[c] - mean / (double)(measured ? measured : 1));
}

void rn_exposures_solve(struct rn_exposures *e, struct rn_frame *frames, size_t frame_count) {
    if (!e) return;
    size_t photos = e->photo_count, points = e->dataset->points.count;
    double *block = calloc(3 * (photos + points) + 1, sizeof *block);
    if (!block) return; // not measured, then
    struct side photo = {block, block + photos, block + 2 * photos, photos, PRIOR};
    double *rest = block + 3 * photos;
    struct side point = {rest, rest + points, rest + 2 * points, points, 0};
    for (int c = 0; c < 3; c++) {
        solve_channel(e, c, &photo, &point);
        give(e, c, photo.value, frames, frame_count);
    }
    free(block);
}

// Logarithm of a frame's mean gain; it was measured.
static double brightness(const struct rn_frame *frame) {
    return log(frame->gain[0] * frame->gain[1] * frame->gain[2]) / 3;
}

// The factor, less 1, within which 90 % of the values lie; NAN of fewer than two.
static double most_of(double *apart, size_t count) {
    rn_numbers_sort(apart, count);
    return count > 1 ? exp(apart[count * 9 / 10]) - 1 : NAN;
}

double rn_exposure_spread(const struct rn_frame *frames, size_t frame_count) {
    double *apart = malloc((frame_count + 1) * sizeof *apart);
    size_t count = 0;
    for (size_t f = 0; f < frame_count && apart; f++)
        if (frames[f].gain[0] > 0) apart[count++] = fabs(brightness(&frames[f]));
    double spread = most_of(apart, count);
    free(apart);
    return spread;
}

// Of the same scale, and another photograph; NULL where there is none.
static const struct rn_frame *looks_the_same_way(const struct rn_frame *frames, size_t frame_count,
                                                 const struct rn_frame *as) {
    const struct rn_frame *best = NULL;
    double most = -2;
    for (const struct rn_frame *f = frames; f < frames + frame_count; f++) {
        double along = 0;
        if (f == as || f->scale != as->scale || !(f->gain[0] > 0)) continue;
        for (int i = 0; i < 3; i++)
            along += f->camera.world_from_camera[i][2] * as->camera.world_from_camera[i][2];
        if (along <= most) continue;
        most = along;
        best = f;
    }
    return best;
}

double rn_exposure_unrest(const struct rn_frame *frames, size_t frame_count) {
    size_t count = 0, stride = frame_count / MOST + 1;
    double *apart = malloc((frame_count / stride + 1) * sizeof *apart);
    for (size_t f = 0; f < frame_count && apart; f += stride) {
        const struct rn_frame *other = looks_the_same_way(frames, frame_count, &frames[f]);
        if (frames[f].gain[0] > 0 && other)
            apart[count++] = fabs(brightness(&frames[f]) - brightness(other));
    }
    double unrest = most_of(apart, count);
    free(apart);
    return unrest;
}
