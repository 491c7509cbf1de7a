// The loss of a pixel: from what is seen of it to how far that is from its photograph, and back.
#ifndef RN_ENGINE_FIELD_LOSS_H
#define RN_ENGINE_FIELD_LOSS_H

#include "server/engine/field/colour.h"

// The loss of a pixel of that colour and opacity, without its weight: smooth L1, beta 1. Writes the
// gradient with the weight: dL/d(rgb), and dL/d(opacity) but for what comes through rgb.
//
// Over random backgrounds both are the mean: a channel's error is then that over the mean
// background, less (opacity - alpha) times the background's deviation from it, so that half its
// square is on average half the first's square and half the variance times (opacity - alpha)^2.
//
// One function a set of types: RAY, with what the photograph shows (`target`, `alpha`) and the area
// `weight`; NUMBER, of colours and gradients; LOSS, of the sum.
#define RN_LOSS_FUNCTION(NAME, RAY, NUMBER, LOSS)                                                  \
    RN_HD LOSS NAME(const struct rn_colouring *colouring, const RAY *ray, const NUMBER rgb[3],     \
                    NUMBER opacity, NUMBER ret_grad[4]) {                                          \
        NUMBER excess = opacity - ray->alpha;                                                      \
        NUMBER spread = 3 * (NUMBER)colouring->background_variance;                                \
        LOSS loss = (LOSS)0.5 * (LOSS)spread * (LOSS)excess * (LOSS)excess;                        \
        for (int c = 0; c < 3; c++) {                                                              \
            NUMBER d = rgb[c] - ray->target[c], size = d < 0 ? -d : d;                             \
            loss += size < 1 ? (LOSS)0.5 * (LOSS)d * (LOSS)d : (LOSS)size - (LOSS)0.5;             \
            ret_grad[c] = ray->weight * (d < -1 ? -1 : d > 1 ? 1 : d);                             \
        }                                                                                          \
        ret_grad[3] = ray->weight * spread * excess;                                               \
        return loss;                                                                               \
    }

#endif
