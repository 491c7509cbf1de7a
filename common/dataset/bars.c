// Black bars along the edges of all photographs: what a film of another shape was filled up with,
// and rows by which a decoder's blocks of 16 are more than the picture.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/dataset/reader.h"

#define LOOKED_AT 8     // photographs, evenly among all, until one has none: each is decoded for it
#define LEAST 3         // of them that must tell
#define BLACK 4.0       // of 255, the brightest channel's mean along a line, at most,
#define SPECK 24        // and how bright one of its pixels may be
#define LIT 24.0        // the mean of the line beside a bar, at least, in most of the photographs
#define MOST_SHARE 0.67 // of a side, that both its bars take

enum side { LEFT, TOP, RIGHT, BOTTOM, SIDES };
static const char *const side_names[SIDES] = {"left", "top", "right", "bottom"};

// Mean of the brightest channel along the line that is `depth` pixels from a side; `speck`: the
// brightest of them.
static double line_of(const struct rn_image *image, enum side side, int depth, int *ret_speck) {
    bool across = side == TOP || side == BOTTOM;
    int length = across ? image->width : image->height;
    int at =
        side == LEFT || side == TOP ? depth : (across ? image->height : image->width) - 1 - depth;
    long sum = 0;
    *ret_speck = 0;
    for (int i = 0; i < length; i++) {
        size_t x = (size_t)(across ? i : at), y = (size_t)(across ? at : i);
        const uint8_t *pixel = image->pixels + 4 * (y * (size_t)image->width + x);
        int most = pixel[0] > pixel[1] ? pixel[0] : pixel[1];
        most = most > pixel[2] ? most : pixel[2];
        *ret_speck = *ret_speck > most ? *ret_speck : most;
        sum += most;
    }
    return (double)sum / length;
}

// Of a photograph: how wide its bar on a side is, and whether what is beside that is lit.
static int bar_of(const struct rn_image *image, enum side side, int most, bool *ret_lit) {
    int width = 0, speck;
    double mean = 0;
    while (width < most && (mean = line_of(image, side, width, &speck)) <= BLACK && speck <= SPECK)
        width++;
    *ret_lit = width < most && mean >= LIT;
    return width;
}

struct seen {
    int count, width[SIDES], lit[SIDES]; // photographs; the narrowest; of how many beside a bar
};

static void look(struct seen *seen, const struct rn_image *image) {
    for (enum side side = 0; side < SIDES; side++) {
        bool lit;
        int across = side == TOP || side == BOTTOM ? image->height : image->width;
        int width = bar_of(image, side, across / 2, &lit);
        if (seen->count == 0 || width < seen->width[side]) seen->width[side] = width;
        seen->lit[side] += lit;
    }
    seen->count++;
}

// Whether all that were seen may have a bar on some side.
static bool may_have_any(const struct seen *seen) {
    int sum = 0;
    for (enum side side = 0; side < SIDES; side++)
        sum += seen->width[side];
    return seen->count == 0 || sum > 0;
}

// Photographs without a mask or an alpha channel, all of one size and scale: else none is looked
// at.
static bool are_alike(const struct rn_dataset *dataset) {
    const struct rn_frame *first = dataset->frames;
    for (size_t f = 0; f < dataset->frame_count; f++) {
        const struct rn_frame *frame = &dataset->frames[f];
        if (frame->has_alpha || frame->mask_path || frame->scale > 0 ||
            frame->camera.width != first->camera.width ||
            frame->camera.height != first->camera.height)
            return false;
    }
    return dataset->frame_count >= LEAST;
}

// A bar counts where it is one in all and ends at something in most.
static bool settle(struct seen *seen, const struct rn_camera *camera) {
    for (enum side side = 0; side < SIDES; side++)
        if (2 * seen->lit[side] <= seen->count) seen->width[side] = 0;
    int across = seen->width[LEFT] + seen->width[RIGHT];
    int down = seen->width[TOP] + seen->width[BOTTOM];
    return seen->count >= LEAST && across + down > 0 && across < MOST_SHARE * camera->width &&
           down < MOST_SHARE * camera->height;
}

static void tell(const struct seen *seen, const struct rn_dataset *dataset,
                 struct rn_problems *problems) {
    char text[96] = "";
    for (enum side side = 0; side < SIDES; side++)
        if (seen->width[side] > 0)
            snprintf(text + strlen(text), sizeof text - strlen(text), "%s%d at the %s",
                     *text ? ", " : "", seen->width[side], side_names[side]);
    rn_problems_add(problems, RN_SEVERITY_INFO, dataset->name,
                    "black bars along the photographs' edges are cut off (pixels: %s), as %d of "
                    "them have them",
                    text, seen->count);
}

static void cut(struct rn_dataset *dataset, const int width[SIDES]) {
    const struct rn_camera before = dataset->frames[0].camera;
    int across = before.width - width[LEFT] - width[RIGHT];
    int down = before.height - width[TOP] - width[BOTTOM];
    for (size_t f = 0; f < dataset->frame_count; f++) {
        struct rn_frame *frame = &dataset->frames[f];
        for (enum side side = 0; side < SIDES; side++)
            frame->bars[side] += width[side]; // beside what was cut off before
        frame->camera.width = across;
        frame->camera.height = down;
        frame->camera.cx -= width[LEFT];
        frame->camera.cy -= width[TOP];
    }
    struct rn_points *points = &dataset->points;
    for (size_t i = 0; i < points->sighting_count; i++) {
        struct rn_sighting *s = &points->sightings[i];
        s->x = (float)((s->x * before.width - width[LEFT]) / across);
        s->y = (float)((s->y * before.height - width[TOP]) / down);
    }
}

static bool find(struct seen *seen, const struct rn_dataset *dataset) {
    if (!are_alike(dataset)) return false;
    size_t step = 1 + (dataset->frame_count - 1) / LOOKED_AT;
    for (size_t f = 0; f < dataset->frame_count && may_have_any(seen); f += step) {
        struct rn_image image;
        if (rn_frame_decode(&dataset->frames[f], NULL, &image, NULL)) continue; // told later
        look(seen, &image);
        rn_image_finish(&image);
    }
    return settle(seen, &dataset->frames[0].camera);
}

bool rn_dataset_has_bars(const struct rn_dataset *dataset) {
    struct seen seen = {0};
    return find(&seen, dataset);
}

void rn_dataset_cut_bars(struct rn_dataset *dataset, struct rn_problems *problems) {
    struct seen seen = {0};
    if (!find(&seen, dataset)) return;
    tell(&seen, dataset, problems);
    cut(dataset, seen.width);
}
