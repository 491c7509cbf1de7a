// Decoded photographs, kept compactly: 8-bit RGBA, one block.
#ifndef RN_ENGINE_SCENE_PIXELS_H
#define RN_ENGINE_SCENE_PIXELS_H

#include <math.h>

#include "server/engine/scene/scene.h"

struct rn_pixel_frame {
    const struct rn_frame *frame;
    struct rn_view view;     // of `camera`; the trainer's to fill in
    struct rn_view fine;     // of `parts`, likewise
    size_t offset;           // of its first pixel in `rgba`, in pixels
    size_t before;           // pixels of the frames of the same scale before this one
    struct rn_camera camera; // the frame's, without a lens that makes no difference
    struct rn_camera parts;  // of 2 x 2 cones a pixel; the trainer's to fill in
};

// Frames ordered by scale. Thread-safety: immutable once loaded. Owner: rn_pixels_finish.
struct rn_pixels {
    struct rn_pixel_frame *frames;
    int frame_count;
    int scale_count;
    int scale_first[16];     // first frame of each scale
    size_t scale_pixels[16]; // pixels of each scale
    size_t pixel_count;
    uint8_t *rgba; // straight alpha
    uint8_t *used; // a byte a pixel: 0 where a mask leaves it out; NULL: all are used
};

// With `even`, photographs are brought to one exposure by their gains. Chooses frames by `wanted`
// (called once a frame of the dataset, in order) and decodes them in parallel on the engine's
// threads. RN_ERROR_CANCELLED when the engine's watcher says so; RN_ERROR_LIMIT when the pixels and
// what masks leave out exceed limit_bytes (0 = none); errors of a file name it.
enum rn_status rn_pixels_load(const struct rn_dataset *dataset,
                              bool (*wanted)(void *context, const struct rn_frame *frame),
                              void *context, struct rn_engine *engine, bool even,
                              size_t limit_bytes, struct rn_pixels *ret_pixels,
                              struct rn_error *err) RN_MUST_CHECK;
void rn_pixels_finish(struct rn_pixels *pixels);

// Pixels of coarser scales as means over the finest photograph of their view, colours weighted by
// opacity. How far the photographs are from it, over white where they are partly transparent: RMS
// over the channels of `frames` frames of the coarsest scale, in [0, 1].
double rn_pixels_scale_error(const struct rn_pixels *pixels, int frames);
// Puts these means in their place.
void rn_pixels_remake_scales(struct rn_pixels *pixels, struct rn_engine *engine);

// Whether no mask leaves pixel (x, y) of a frame out.
static inline bool rn_pixel_is_used(const struct rn_pixels *pixels,
                                    const struct rn_pixel_frame *frame, int x, int y) {
    return !pixels->used ||
           pixels->used[frame->offset + (size_t)y * (size_t)frame->camera.width + (size_t)x];
}
// How many pixels of a frame are.
size_t rn_pixels_used(const struct rn_pixels *pixels, const struct rn_pixel_frame *frame);

// What a mask leaves out of a frame: 0 into `used`, a byte a pixel, where it is black, else 1.
// RN_ERROR_CORRUPT for a mask of another size, rn_image_read's statuses.
enum rn_status rn_mask_read(const struct rn_frame *frame, uint8_t *used,
                            struct rn_error *err) RN_MUST_CHECK;

// Pixel (x, y) of a frame.
static inline const uint8_t *rn_pixel_at(const struct rn_pixels *pixels,
                                         const struct rn_pixel_frame *frame, int x, int y) {
    return pixels->rgba + 4 * (frame->offset + (size_t)y * (size_t)frame->camera.width + (size_t)x);
}

// A pixel over a background, in [0, 1]; returns its alpha.
static inline float rn_pixel_over(const uint8_t rgba[4], const float background[3], float rgb[3]) {
    float alpha = (float)rgba[3] * (1 / 255.0f);
    for (int c = 0; c < 3; c++)
        rgb[c] = (float)rgba[c] * (1 / 255.0f) * alpha + (1 - alpha) * background[c];
    return alpha;
}

// Adds the squared errors of a rendered pixel's channels, clamped to [0, 1], to `sum`.
static inline void rn_pixel_add_error(const struct rn_pixels *pixels,
                                      const struct rn_pixel_frame *frame, int x, int y,
                                      const float background[3], const float rendered[3],
                                      double *sum) {
    float target[3];
    (void)rn_pixel_over(rn_pixel_at(pixels, frame, x, y), background, target);
    for (int c = 0; c < 3; c++) {
        double d = fmin(fmax((double)rendered[c], 0), 1) - (double)target[c];
        *sum += d * d;
    }
}

#endif
