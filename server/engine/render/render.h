// Pictures of a field.
#ifndef RN_ENGINE_RENDER_RENDER_H
#define RN_ENGINE_RENDER_RENDER_H

#include "common/dataset/dataset.h"
#include "common/image/image.h"
#include "common/math/camera.h"
#include "common/settings/render.h"
#include "server/engine/scene/engine.h"

enum rn_output { RN_OUTPUT_RGB = 1, RN_OUTPUT_DEPTH = 2, RN_OUTPUT_ALPHA = 4 };

// All that decides a picture: two requests with equal fields give equal pixels.
struct rn_render_options {
    struct rn_camera camera; // dataset coordinates
    unsigned outputs;        // RN_OUTPUT_* ORed
    float background[3];
    bool straight; // a pixel's cones are averaged as rn_cones_mean's `straight`
    struct rn_render_settings settings;
    // When the pictures must be there (rn_clock_ns); 0: whenever they are. With a time, the
    // tolerance is not the settings' but as small as the time allows, and no two pictures are
    // alike.
    int64_t deadline_ns;
    int64_t first_ns; // with it: when the first picture must be there, or it is given up
};
struct rn_render_stats {
    double render_ms;
    double tolerance;        // that there was time for; the settings' without a deadline
    int cones;               // a side of a pixel
    uint64_t rays, samples;  // samples: field evaluations
    uint64_t nonfinite_rays; // of which something was no finite number, and replaced
};
struct rn_render_result {
    struct rn_picture rgb, depth, alpha; // those asked for; the others are zero
    struct rn_render_stats stats;
};
// Renders in tiles. `keep_going` (may be NULL) is polled between tiles; false stops with
// RN_ERROR_CANCELLED. RN_ERROR_LIMIT: a first picture (a quarter of the rays; on a device
// other than the CPU all of them) was not there in time. Depth is the distance along the ray
// over opacity, dataset units, 0 where nothing was hit. Every value written is finite.
enum rn_status rn_render(struct rn_engine *engine, struct rn_field *field,
                         const struct rn_render_options *options, bool (*keep_going)(void *context),
                         void *context, struct rn_render_result *ret_result,
                         struct rn_error *err) RN_MUST_CHECK;
// Cones a side of a pixel that a full picture has.
int rn_render_cones(const struct rn_field *field, const struct rn_camera *camera);
void rn_render_result_finish(struct rn_render_result *result);

// One view against its photograph, composited over the options' background. Of the options, camera,
// outputs and `straight` are not looked at.
struct rn_view_score {
    double psnr, ssim, render_ms;
    double psnr_fitted; // of a scene whose exposures were made even: a gain and an offset a channel
                        // are fitted on one half of the picture and scored on the other, both ways;
                        // else NAN
    uint64_t nonfinite_rays; // as of a rendering
};
enum rn_status rn_evaluate_view(struct rn_engine *engine, struct rn_field *field,
                                const struct rn_frame *frame,
                                const struct rn_render_options *options,
                                bool (*keep_going)(void *context), void *context,
                                struct rn_view_score *ret_score,
                                struct rn_error *err) RN_MUST_CHECK;

#endif
