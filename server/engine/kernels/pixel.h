// From cones to pixels. Host and device.
#ifndef RN_ENGINE_KERNELS_PIXEL_H
#define RN_ENGINE_KERNELS_PIXEL_H

#include <math.h>

#include "common/math/hd.h"
#include "server/engine/kernels/kernels.h"

#define RN_CONES_MOST 16     // cones a side of a pixel
#define RN_CONES_SOLID 0.25f // opacity, of rn_cones_mean's straight colours

// Opacity of a ray that ends at optical depth `stop_depth`, where that is earlier than in training
// (at transmittance `stop`); else one that no ray has.
RN_HD float rn_ended_opacity(float stop_depth, double stop) {
    return stop_depth >= (float)-log(stop) ? 2 : -expm1f(-stop_depth);
}

// Rays that were ended earlier than in training, from opacity `ended` on, show what they have seen,
// and not a share of the background with it: what they did not see is taken to look the same.
RN_HD void rn_close_ended(float ended, const float background[3], struct rn_pixel *p) {
    if (!(p->alpha >= ended)) return;
    for (int c = 0; c < 3; c++)
        p->rgb[c] = background[c] + (p->rgb[c] - background[c]) / p->alpha;
    p->alpha = 1;
}

// As a photograph's pixel that is hardly covered has no colour in its file, and a field's edges are
// wider than a photograph's, a cone's colour counts in full from the opacity RN_CONES_SOLID on.
RN_HD void rn_cones_mean_straight(const struct rn_pixel *cones, int n, const float *background,
                                  struct rn_pixel *pixel) {
    float colour[3] = {0, 0, 0}, scale = 1 / (float)(n * n);
    for (const struct rn_pixel *p = cones; p < cones + n * n; p++)
        for (int c = 0; c < 3; c++) {
            float covered = p->rgb[c] - (1 - p->alpha) * background[c]; // colour times opacity
            colour[c] += fminf(fmaxf(covered / fmaxf(p->alpha, RN_CONES_SOLID), 0), 1) * scale;
        }
    for (int c = 0; c < 3; c++)
        pixel->rgb[c] = colour[c] * pixel->alpha + (1 - pixel->alpha) * background[c];
}

// n^2 cones to one pixel: colour and opacity are means; depth is weighted by opacity. Where
// `straight` is no NULL, it is the background that the cones are over, and their colours are
// averaged without it and without their opacity, as a photograph may have been
// (effects/straight_alpha.c).
RN_HD struct rn_pixel rn_cones_mean(const struct rn_pixel *cones, int n, const float *straight) {
    struct rn_pixel mean = {{0, 0, 0}, 0, 0};
    float scale = 1 / (float)(n * n);
    for (int i = 0; i < n * n; i++) {
        for (int c = 0; c < 3; c++)
            mean.rgb[c] += cones[i].rgb[c] * scale;
        mean.alpha += cones[i].alpha * scale;
        mean.depth += cones[i].depth * (cones[i].alpha * scale);
    }
    mean.depth = mean.alpha > 0 ? mean.depth / mean.alpha : 0;
    if (straight) rn_cones_mean_straight(cones, n, straight, &mean);
    return mean;
}

#endif
