// Pictures of a field.
#ifndef RN_ENGINE_RENDER_RENDER_H
#define RN_ENGINE_RENDER_RENDER_H

#include "common/dataset/dataset.h"
#include "common/image/image.h"
#include "common/math/camera.h"
#include "common/settings/optics.h"
#include "common/settings/render.h"
#include "server/engine/scene/engine.h"

enum rn_output {
    RN_OUTPUT_RGB = 1,
    RN_OUTPUT_DEPTH = 2,
    RN_OUTPUT_ALPHA = 4,
    RN_OUTPUT_NORMAL = 8, // this and the next: render/inspect.h
    RN_OUTPUT_COST = 16,
    RN_OUTPUT_LEVEL = 32,
    RN_OUTPUT_FOOTPRINT = 64,
};
#define RN_OUTPUTS_ALL 127

// Effects of the camera, of one picture.
struct rn_shot {
    struct rn_optics optics;
    // Of a shutter: the camera at even instants while it is open, all of one size. Borrowed.
    const struct rn_camera *instants;
    int instant_count;
    // A photograph's exposure: by which the colours, as they are stored, are multiplied; 0: none.
    double gain[3];
};

// All that decides a picture: two requests with equal fields give equal pixels.
struct rn_render_options {
    struct rn_camera camera; // dataset coordinates
    unsigned outputs;        // RN_OUTPUT_* ORed
    float background[3];
    bool straight;                // a pixel's cones are averaged as rn_cones_mean's `straight`
    const struct rn_lpips *lpips; // of evaluations, which tell LPIPS by it; NULL: they do not
    unsigned fit;                 // of evaluations: RN_FIT_* ORed
    struct rn_render_settings settings;
    struct rn_shot shot;             // effects of the camera; 0: none
    struct rn_appearance appearance; // its own renders on the CPU
    // What of the scene is seen, to half a cell of the occupancy grid; NULL: all. Borrowed. Renders
    // on the CPU.
    const struct rn_box *crop;
    // When the pictures must be there (rn_clock_ns); 0: whenever they are. With a time, the
    // tolerance is not the settings' but as small as the time allows, and no two pictures are
    // alike.
    int64_t deadline_ns;
    int64_t first_ns; // with it: when the first picture must be there, or it is given up
};
struct rn_render_stats {
    double render_ms;
    double tolerance;       // that there was time for; the settings' without a deadline
    int cones;              // a side of a pixel
    uint64_t rays, samples; // samples: field evaluations
    // Mean squares over the colour channels: what the lattice's interpolated points are likely to
    // be away from traced ones (traced: 0); of a picture that was rendered smaller, how far four
    // pixels beside each other are from their mean.
    double interpolation, roughness;
    uint64_t nonfinite_rays; // of which something was no finite number, and replaced
    bool on_device;          // by the engine's device; false: by the CPU
};
struct rn_render_result {
    struct rn_picture rgb, depth, alpha; // those asked for; the others are zero
    struct rn_picture normal;            // three channels in [-1, 1], dataset axes
    struct rn_picture cost; // samples: their sum is `stats.samples`, but for a `subsample`
    struct rn_picture level, footprint; // of the ripmap; of a cone, dataset units
    struct rn_render_stats stats;
};
// Renders in tiles. `keep_going` (may be NULL) is polled between tiles; false stops with
// RN_ERROR_CANCELLED. RN_ERROR_LIMIT: a first picture (a quarter of the rays) was not there in
// time. Costs, levels, footprints and normals come from the CPU. Depth is the distance along the
// ray over opacity, dataset units, 0 where nothing was hit. Every value written is finite.
enum rn_status rn_render(struct rn_engine *engine, struct rn_field *field,
                         const struct rn_render_options *options, bool (*keep_going)(void *context),
                         void *context, struct rn_render_result *ret_result,
                         struct rn_error *err) RN_MUST_CHECK;
#define RN_RENDER_TOGETHER 32
// How many pictures like this one the device makes in one call, at most RN_RENDER_TOGETHER: small
// ones do not fill it. 1 without a device, and of those that are made one by one.
int rn_render_fit(struct rn_engine *engine, struct rn_field *field,
                  const struct rn_render_options *options);
// Renders options[0], and those behind it that a device traces with it in one call, up to the first
// that it cannot; *ret_count of the `count`, from 1 on. The same pixels as by rn_render, one after
// the other. Each is told an equal share of the time and of the samples. `keep_going` and errors:
// of rn_render of the first; none is left then.
enum rn_status rn_render_together(struct rn_engine *engine, struct rn_field *field,
                                  const struct rn_render_options *options, int count,
                                  bool (*keep_going)(void *context), void *context,
                                  struct rn_render_result *ret_results, int *ret_count,
                                  struct rn_error *err) RN_MUST_CHECK;
// Cones a side of a pixel that a full picture has.
int rn_render_cones(const struct rn_field *field, const struct rn_camera *camera);
void rn_render_result_finish(struct rn_render_result *result);

// One view against its photograph, composited over the options' background. Of the options, camera,
// outputs and `straight` are not looked at.
struct rn_view_score {
    double psnr, ssim, render_ms;
    double psnr_fitted;      // with what the options fit on one half of the picture, scored on the
                             // other, both ways; else NAN
    double lpips;            // NAN without the network's weights, and of pictures too small for it
    uint64_t nonfinite_rays; // as of a rendering
    bool on_device;          // likewise
};
static inline enum rn_status rn_evaluate_view(struct rn_engine *engine, struct rn_field *field,
                                              const struct rn_frame *frame,
                                              const struct rn_render_options *options,
                                              bool (*keep_going)(void *context), void *context,
                                              struct rn_view_score *ret_score,
                                              struct rn_error *err) RN_MUST_CHECK;

// The same in two parts: a view that is rendered, which `compare` frees.
struct rn_rendered_view {
    struct rn_engine *engine;
    struct rn_field *field;
    const struct rn_frame *frame;
    struct rn_render_options options;
    bool (*keep_going)(void *context);
    void *context;
    struct rn_render_result result;
};
// How a view is rendered for that.
struct rn_render_options rn_view_options(const struct rn_field *field, const struct rn_frame *frame,
                                         const struct rn_render_options *given);
enum rn_status rn_view_render(struct rn_engine *engine, struct rn_field *field,
                              const struct rn_frame *frame, const struct rn_render_options *options,
                              bool (*keep_going)(void *context), void *context,
                              struct rn_rendered_view *ret_view,
                              struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_view_compare(struct rn_rendered_view *view, struct rn_view_score *ret_score,
                               struct rn_error *err) RN_MUST_CHECK;
static inline enum rn_status
rn_evaluate_view(struct rn_engine *engine, struct rn_field *field, const struct rn_frame *frame,
                 const struct rn_render_options *options, bool (*keep_going)(void *context),
                 void *context, struct rn_view_score *ret_score, struct rn_error *err) {
    struct rn_rendered_view view;
    enum rn_status status =
        rn_view_render(engine, field, frame, options, keep_going, context, &view, err);
    return status != RN_OK ? status : rn_view_compare(&view, ret_score, err);
}
// Whether that takes nothing of engine and field - no LPIPS, no camera to be sought -, and so may
// be done by any thread while they render the next one.
bool rn_view_is_apart(const struct rn_rendered_view *view);

// How right depths are where the view's photograph sees sparse points: the median over its
// sightings of |depth - distance of the point| over that distance. A pixel that shows nothing is
// off by 1.
struct rn_depth_score {
    size_t points; // sightings that were looked at
    double median; // NAN where there are none
};
// Of a rendered depth, dataset units. RN_ERROR_NO_MEMORY.
enum rn_status rn_depth_compare(const struct rn_picture *depth, const struct rn_frame *frame,
                                const struct rn_points *points, struct rn_depth_score *ret_score,
                                struct rn_error *err) RN_MUST_CHECK;
// Renders it first, where the photograph sees a point. Options as of rn_evaluate_view.
enum rn_status rn_evaluate_depth(struct rn_engine *engine, struct rn_field *field,
                                 const struct rn_frame *frame, const struct rn_points *points,
                                 const struct rn_render_options *options,
                                 bool (*keep_going)(void *context), void *context,
                                 struct rn_depth_score *ret_score,
                                 struct rn_error *err) RN_MUST_CHECK;

#endif
