// From the colours of rays to that of a pixel and its loss (field/loss.h), and back to the rays.
#ifndef RN_ENGINE_CPU_LOSS_H
#define RN_ENGINE_CPU_LOSS_H

#include <math.h>

#include "server/engine/cpu/packet.h"
#include "server/engine/field/loss.h"

RN_LOSS_FUNCTION(loss_of, struct rn_march_ray, float, double)

// Adds the loss of one pixel. False where it is not finite; then it does not count.
static bool pixel_loss(const struct rn_march_options *options, const struct rn_march_ray *ray,
                       const float rgb[3], float opacity, float ret_grad[4],
                       struct rn_group *group) {
    double loss = loss_of(&options->colour, ray, rgb, opacity, ret_grad);
    if (!isfinite(loss)) return false;
    group->loss += (double)ray->weight * loss;
    group->weight += (double)ray->weight;
    if (group->ray_loss) group->ray_loss[ray->id] = (float)loss;
    return true;
}

// The loss of a pixel whose colour and opacity are the mean of `n` rays', of which those that met
// nothing show the background (hit[] is false of them), and dL/d(composited colour), dL/d(opacity)
// of each ray. A ray that is not finite counts as such, and its pixel gets no gradient.
static void rays_loss(const struct rn_march_options *options, const struct rn_march_ray *rays,
                      int n, const bool *hit, const struct ray_sums *sums, float (*rgb)[3],
                      float (*ret_slope)[4], struct rn_group *group) {
    float mean[3] = {0}, opacity = 0, share = 1.0f / (float)n, grad[4];
    int hits = 0;
    for (int r = 0; r < n; hits += hit[r++]) {
        opacity += hit[r] ? sums[r].opacity * share : 0;
        for (int c = 0; c < 3; c++)
            mean[c] += (hit[r] ? rgb[r][c] : options->colour.background[c]) * share;
    }
    if (hits == 0) return;
    bool finite = pixel_loss(options, rays, mean, opacity, grad, group);
    for (int r = 0; r < n; r++) {
        if (!hit[r]) continue;
        if (finite) {
            group->rays_hit++;
            for (int c = 0; c < 4; c++)
                ret_slope[r][c] = grad[c] * share;
            colour_back(&options->colour, ret_slope[r]);
        } else if (!isfinite(rgb[r][0] + rgb[r][1] + rgb[r][2] + sums[r].opacity) || n == 1) {
            if (group->nonfinite_rays < RN_OFFENDERS)
                group->offender[group->nonfinite_rays] = rays[r].id;
            group->nonfinite_rays++;
        }
    }
}

#endif
