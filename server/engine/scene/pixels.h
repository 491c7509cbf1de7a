// Decoded photographs, at the scale that is trained on: 8-bit RGBA, one block, in memory or, where
// they are more than may lie there, on disk.
#ifndef RN_ENGINE_SCENE_PIXELS_H
#define RN_ENGINE_SCENE_PIXELS_H

#include <math.h>

#include "server/engine/scene/paged.h"
#include "server/engine/scene/scene.h"

struct rn_pixel_frame {
    const struct rn_frame *frame;
    struct rn_view view;     // of `camera`; the trainer's to fill in
    struct rn_view fine;     // of `parts`, likewise
    size_t offset;           // of its first pixel in `rgba`, in pixels
    size_t before;           // pixels of the frames of the same scale before this one
    struct rn_camera camera; // the frame's, of the size that is kept, without a lens that makes no
                             // difference
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
    uint8_t *rgba;         // straight alpha
    uint8_t *used;         // a byte a pixel: 0 where a mask leaves it out; NULL: all are used
    struct rn_paged paged; // that both lie in; none: they are blocks of memory
    size_t held_bytes;     // of its pages in memory at most
};

// How photographs are loaded.
struct rn_pixel_treatment {
    bool even;     // they are brought to one exposure by their gains
    bool unmasked; // masks are not looked at
    bool cut_out;  // masks become their alpha channels: transparent where they leave out, and used
    int reduced;   // times that they are made smaller: 1, 2, ...
    // Beyond so many they lie in the engine's folder (rn_engine_keep_in), where it has one, and so
    // many are in memory of those that do; 0 = no limit. Others have taken some of them.
    size_t memory_bytes, taken_bytes;
};
// Chooses frames by `wanted` (called once a frame of the dataset, in order) and decodes them in
// parallel on the engine's threads. RN_ERROR_CANCELLED when the engine's watcher says so;
// RN_ERROR_LIMIT when the pixels and what masks leave out must lie in memory and exceed limit_bytes
// (0 = none); errors of a file name it.
enum rn_status rn_pixels_load(const struct rn_dataset *dataset,
                              bool (*wanted)(void *context, const struct rn_frame *frame),
                              void *context, struct rn_engine *engine,
                              struct rn_pixel_treatment treatment, size_t limit_bytes,
                              struct rn_pixels *ret_pixels, struct rn_error *err) RN_MUST_CHECK;
void rn_pixels_finish(struct rn_pixels *pixels);

// A camera of photographs that are made so many times smaller: sides are rounded, 1 at least.
// Colours are means over their area, weighted by opacity; what a mask leaves out in part is left
// out.
static inline struct rn_camera rn_camera_reduced(const struct rn_camera *camera, int reduced) {
    int width = (camera->width + reduced / 2) / reduced,
        height = (camera->height + reduced / 2) / reduced;
    if (reduced <= 1) return *camera;
    return rn_camera_resized(camera, width > 0 ? width : 1, height > 0 ? height : 1);
}
// Bytes of memory that so many pixels take.
static inline size_t rn_pixels_bytes(size_t pixels, bool masked) {
    return pixels * (masked ? 5 : 4);
}
// For whoever looks at many of them, in between: of those on disk no more are in memory than may
// be.
static inline void rn_pixels_let_go(const struct rn_pixels *pixels) {
    rn_paged_hold_at_most(&pixels->paged, pixels->held_bytes);
}

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

// Pixel (x, y) of a frame.
static inline const uint8_t *rn_pixel_at(const struct rn_pixels *pixels,
                                         const struct rn_pixel_frame *frame, int x, int y) {
    return pixels->rgba + 4 * (frame->offset + (size_t)y * (size_t)frame->camera.width + (size_t)x);
}

// Soon to be looked at.
static inline void rn_pixels_expect(const struct rn_pixels *pixels,
                                    const struct rn_pixel_frame *frame, int x, int y) {
    const uint8_t *pixel = rn_pixel_at(pixels, frame, x, y);
    if (pixels->paged.bytes)
        rn_paged_expect(pixel);
    else
        __builtin_prefetch(pixel);
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
