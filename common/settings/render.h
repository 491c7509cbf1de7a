// How a picture is rendered: what a request for a single picture, a camera path or an evaluation
// may choose, down to the kernels.
#ifndef RN_COMMON_SETTINGS_RENDER_H
#define RN_COMMON_SETTINGS_RENDER_H

#include "common/settings/setting.h"

// Plain values. Of each, 0 is what the scene calls for.
struct rn_render_settings {
    double step; // marching step in scene radii; 0 = as trained, in places half of that
    // Early-stop transmittance; 0 = as trained, or the tolerance where that is larger. A ray that
    // ends earlier than in training counts as opaque. From 0.08 on, rays pass over thin haze
    // (engine/scene/occupancy.h).
    double stop;
    int subsample; // render every n-th pixel each way and enlarge; 0 = 1 = all of them
    // Cones a side of a pixel, 1, 2, 4, 8 or 16; 0 = as many as make them as narrow as the finest
    // that the field was trained on, where its configuration asks for that, else 1.
    int supersample;
    // A pixel whose four nearest neighbours agree to within this is their mean and is not traced
    // (render/lattice.h): the root mean square distance from that mean of the outputs asked for,
    // at most 0.5. Of pixels of several cones their quarters are meant. 0 = every pixel is traced.
    // Above 0.1 the CPU, not a GPU, reads the nearest level of a plane's pyramid alone.
    double tolerance;
    // A budget, which stands instead of all of the above and is resolved to them before a picture
    // is rendered (common/settings/curve.h); the renderer does not look at it. One of: milliseconds
    // a picture; dB; a place on the scene's curve, 0 the cheapest point and 100 the full picture.
    double within_ms, render_psnr, quality;
};

// The one table: a row for every member.
#define RN_RENDER_SETTINGS 8
extern const struct rn_settings rn_render_settings;

// Where the rows of a budget begin: those behind are a budget's.
#define RN_RENDER_BUDGET 5

#endif
