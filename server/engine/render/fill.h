// From the points that were traced to the pictures asked for.
#ifndef RN_ENGINE_RENDER_FILL_H
#define RN_ENGINE_RENDER_FILL_H

#include "server/engine/render/lattice.h"

// Plain; all pointers are the caller's and live for the call.
struct rn_filling {
    const struct rn_lattice *lattice;
    int points;            // of it, a side of a pixel: 1 or 2
    const float *straight; // as rn_cones_mean
    const struct rn_render_options *options;
    double radius; // of the scene, dataset units: of depth
};
// Makes the pictures that the options ask for, over the engine's threads, and of the stats the
// count of pixels that are not finite and were replaced, and the roughness. Of a picture that was
// rendered smaller (subsample), colour and opacity are interpolated by Catmull-Rom splines on both
// axes, of 16 pixels, kept in [0, 1]; depth is the nearest one's. On failure what was made is in
// `ret_result`, to be finished.
enum rn_status rn_fill_pictures(struct rn_engine *engine, const struct rn_filling *filling,
                                struct rn_render_result *ret_result,
                                struct rn_error *err) RN_MUST_CHECK;

#endif
