// What alpha channels say before everything is decoded, by some of a capture's photographs: whether
// they cut anything out, and how far from a point it reaches.
#include <math.h>
#include <stdlib.h>

#include "common/dataset/reader.h"
#include "common/math/numbers.h"

#define LOOKED_AT 8 // photographs, evenly among those with an alpha channel: each is decoded for it
#define SIDE 32     // of a photograph's pixels, in each direction, whose rays are followed
#define OPAQUE 128  // alpha, from which on a pixel shows what is cut out
#define WITHIN 0.98 // of those pixels' rays pass within a photograph's reach
#define MOST (6. / 7) // of the photographs have no longer one: of eight, all but one

// How near the ray through a pixel's middle passes the point, dataset units.
static double passes_by(const struct rn_camera *camera, int x, int y, const double point[3]) {
    struct rn_ray ray = rn_camera_ray(camera, x + 0.5, y + 0.5);
    double along = 0, squares = 0;
    for (int i = 0; i < 3; i++) {
        double offset = point[i] - ray.origin[i];
        along += offset * ray.direction[i];
        squares += offset * offset;
    }
    return sqrt(fmax(0, squares - along * along));
}

// The distance from the point within which what is opaque is seen; NAN where nothing is.
static double reach_of(const struct rn_camera *camera, const struct rn_image *image,
                       const double point[3]) {
    double passed[SIDE * SIDE];
    int across = 1 + (image->width - 1) / SIDE, down = 1 + (image->height - 1) / SIDE;
    size_t count = 0;
    for (int y = down / 2; y < image->height; y += down)
        for (int x = across / 2; x < image->width; x += across)
            if (image->pixels[4 * ((size_t)y * (size_t)image->width + (size_t)x) + 3] >= OPAQUE)
                passed[count++] = passes_by(camera, x, y, point);
    return count ? rn_numbers_quantile(passed, count, WITHIN) : NAN;
}

static bool is_transparent_anywhere(const struct rn_image *image) {
    size_t count = (size_t)image->width * (size_t)image->height;
    for (size_t i = 0; i < count; i++)
        if (image->pixels[4 * i + 3] < 255) return true;
    return false;
}

// Steps from one photograph with an alpha channel that is looked at to the next.
static size_t stride(const struct rn_dataset *dataset) {
    size_t count = 0;
    for (size_t f = 0; f < dataset->frame_count; f++)
        count += dataset->frames[f].has_alpha;
    return 1 + (count - (count > 0)) / LOOKED_AT;
}

void rn_reader_settle_alpha(struct rn_reader *reader) {
    struct rn_dataset *dataset = reader->dataset;
    size_t step = stride(dataset), with = 0;
    for (size_t f = 0; f < dataset->frame_count; f++) {
        const struct rn_frame *frame = &dataset->frames[f];
        struct rn_image image;
        if (!frame->has_alpha || with++ % step) continue;
        if (rn_frame_decode(frame, NULL, &image, NULL)) return; // which is told when all are
        bool cuts = is_transparent_anywhere(&image);
        rn_image_finish(&image);
        if (cuts) return;
    }
    for (size_t f = 0; f < dataset->frame_count; f++)
        dataset->frames[f].has_alpha = false;
    if (with)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, reader->folder,
                        "%zu photographs have an alpha channel that is opaque everywhere, as far "
                        "as %zu of them say: they are taken for photographs without one",
                        with, 1 + (with - 1) / step);
}

double rn_outline_reach(const struct rn_dataset *dataset, const double point[3]) {
    double reaches[LOOKED_AT];
    size_t step = stride(dataset), with = 0, count = 0;
    for (size_t f = 0; f < dataset->frame_count; f++) {
        const struct rn_frame *frame = &dataset->frames[f];
        struct rn_image image;
        if (!frame->has_alpha || with++ % step) continue;
        if (rn_frame_decode(frame, NULL, &image, NULL)) continue;
        double reach = reach_of(&frame->camera, &image, point);
        rn_image_finish(&image);
        if (!isnan(reach)) reaches[count++] = reach;
    }
    return rn_numbers_quantile(reaches, count, MOST);
}
