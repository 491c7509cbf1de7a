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
#define NEAREST 8  // of those that look most nearly the same way, whose points are compared

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

// How nearly two cameras look the same way: 1 where they do.
static double along(const struct rn_frame *a, const struct rn_frame *b) {
    double sum = 0;
    for (int i = 0; i < 3; i++)
        sum += a->camera.world_from_camera[i][2] * b->camera.world_from_camera[i][2];
    return sum;
}

// The other measured frames that look most nearly the same way, the nearest first.
static int nearest_of(const struct rn_frame *frames, size_t frame_count, const struct rn_frame *as,
                      const struct rn_frame *ret[NEAREST]) {
    int count = 0;
    for (const struct rn_frame *f = frames; f < frames + frame_count; f++) {
        if (f == as || f->scale != as->scale || !(f->gain[0] > 0)) continue;
        int at = count < NEAREST ? count++ : NEAREST;
        for (; at > 0 && along(ret[at - 1], as) < along(f, as); at--)
            if (at < NEAREST) ret[at] = ret[at - 1];
        if (at < NEAREST) ret[at] = f;
    }
    return count;
}

// Of the points that both show, the median distance of their difference in brightness from the
// median difference, logarithms; NAN where they share too few. of_point: the one photograph's.
static double light_apart(const struct rn_exposures *e, const float *of_point, size_t photo,
                          double *room) {
    size_t count = 0;
    for (size_t i = e->first[photo]; i < e->first[photo + 1]; i++) {
        const struct colour *c = &e->colours[i];
        double apart = (double)((c->log[0] + c->log[1] + c->log[2]) / 3 - of_point[c->point]);
        if (!isnan(apart)) room[count++] = apart;
    }
    if (count < RN_EXPOSURE_SIGHTINGS) return NAN;
    double median = rn_numbers_median(room, count);
    for (size_t i = 0; i < count; i++)
        room[i] = fabs(room[i] - median);
    return rn_numbers_median(room, count);
}

static void compare_light(const struct rn_exposures *e, struct rn_frame *frames,
                          size_t frame_count) {
    size_t points = e->dataset->points.count, stride = frame_count / MOST + 1;
    float *of_point = malloc(points * sizeof *of_point);
    double *room = malloc((e->count + 1) * sizeof *room);
    const struct rn_frame *nearest[NEAREST];
    for (size_t p = 0; p < points && of_point; p++)
        of_point[p] = NAN;
    for (size_t f = 0; f < frame_count && of_point && room; f += stride) {
        size_t photo = (size_t)frames[f].photo;
        if (frames[f].scale != 0 || !(frames[f].gain[0] > 0)) continue;
        int count = nearest_of(frames, frame_count, &frames[f], nearest);
        for (size_t i = e->first[photo]; i < e->first[photo + 1]; i++) {
            const float *log = e->colours[i].log;
            of_point[e->colours[i].point] = (log[0] + log[1] + log[2]) / 3;
        }
        double apart = NAN;
        for (int n = 0; n < count && isnan(apart); n++)
            apart = light_apart(e, of_point, (size_t)nearest[n]->photo, room);
        frames[f].light = isnan(apart) ? 0 : apart;
        for (size_t i = e->first[photo]; i < e->first[photo + 1]; i++)
            of_point[e->colours[i].point] = NAN;
    }
    free(of_point);
    free(room);
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
    compare_light(e, frames, frame_count);
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

double rn_exposure_unrest(const struct rn_frame *frames, size_t frame_count) {
    size_t count = 0, stride = frame_count / MOST + 1;
    double *apart = malloc((frame_count / stride + 1) * sizeof *apart);
    for (size_t f = 0; f < frame_count && apart; f += stride) {
        const struct rn_frame *nearest[NEAREST];
        if (frames[f].gain[0] > 0 && nearest_of(frames, frame_count, &frames[f], nearest) > 0)
            apart[count++] = fabs(brightness(&frames[f]) - brightness(nearest[0]));
    }
    double unrest = most_of(apart, count);
    free(apart);
    return unrest;
}

double rn_light_unrest(const struct rn_frame *frames, size_t frame_count) {
    double *apart = malloc((frame_count + 1) * sizeof *apart);
    size_t count = 0;
    for (size_t f = 0; f < frame_count && apart; f++)
        if (frames[f].light > 0) apart[count++] = frames[f].light;
    double unrest = count > 1 ? exp(rn_numbers_median(apart, count)) - 1 : NAN;
    free(apart);
    return unrest;
}
