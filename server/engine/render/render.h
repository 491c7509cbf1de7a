// Pictures of a field.
#ifndef RN_ENGINE_RENDER_RENDER_H
#define RN_ENGINE_RENDER_RENDER_H

#include "common/dataset/dataset.h"
#include "common/image/image.h"
#include "common/math/camera.h"
#include "server/engine/scene/engine.h"

enum rn_output { RN_OUTPUT_RGB = 1, RN_OUTPUT_DEPTH = 2, RN_OUTPUT_ALPHA = 4 };

// All that decides a picture: two requests with equal fields give equal pixels.
struct rn_render_options {
    struct rn_camera camera; // dataset coordinates
    unsigned outputs;        // RN_OUTPUT_* ORed
    float background[3];
    double step; // marching step in scene radii; 0 = as trained
    // Early-stop transmittance; 0 = as trained, or the tolerance where that is larger. A ray that
    // ends earlier than in training counts as opaque.
    double stop;
    int subsample; // render every n-th pixel each way and enlarge; 1 = full
    // Cones a side of a pixel, 1, 2, 4, 8 or 16; 0 = as many as make them as narrow as the finest
    // that the field was trained on, where its configuration asks for that, else 1.
    int supersample;
    // A pixel whose four nearest neighbours agree to within this is their mean and is not traced
    // (render/lattice.h): the root mean square distance from that mean of the outputs asked for,
    // at most 0.5. Of pixels of several cones their quarters are meant. 0 = every pixel is traced,
    // and always on a device other than the CPU.
    double tolerance;
};
struct rn_render_stats {
    double render_ms;
    int cones;               // a side of a pixel
    uint64_t rays, samples;  // samples: field evaluations
    uint64_t nonfinite_rays; // of which something was no finite number, and replaced
};
struct rn_render_result {
    struct rn_picture rgb, depth, alpha; // those asked for; the others are zero
    struct rn_render_stats stats;
};
// Renders in tiles. `keep_going` (may be NULL) is polled between tiles; false stops with
// RN_ERROR_CANCELLED. Depth is the distance along the ray over opacity, dataset units, 0 where
// nothing was hit. Every value written is finite.
enum rn_status rn_render(struct rn_engine *engine, struct rn_field *field,
                         const struct rn_render_options *options, bool (*keep_going)(void *context),
                         void *context, struct rn_render_result *ret_result,
                         struct rn_error *err) RN_MUST_CHECK;
void rn_render_result_finish(struct rn_render_result *result);

// One view against its photograph, composited over the options' background. Of the options, camera
// and outputs are not looked at.
struct rn_view_score {
    double psnr, ssim, render_ms;
    uint64_t nonfinite_rays; // as of a rendering
};
enum rn_status rn_evaluate_view(struct rn_engine *engine, struct rn_field *field,
                                const struct rn_frame *frame,
                                const struct rn_render_options *options,
                                bool (*keep_going)(void *context), void *context,
                                struct rn_view_score *ret_score,
                                struct rn_error *err) RN_MUST_CHECK;

#endif
