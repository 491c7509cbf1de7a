// Image quality. Sums in float64.
#ifndef RN_COMMON_IMAGE_METRICS_H
#define RN_COMMON_IMAGE_METRICS_H

#include "common/image/image.h"

// Both functions want pictures of equal size and channel count, values in [0,1], and return
// RN_ERROR_INVALID otherwise.

// 10 log10(1 / MSE) in dB over all pixels and channels; +INFINITY for identical pictures. Error at
// most 5e-16 (width * channels + height) dB and 2 ULP: row sums, then their sum.
enum rn_status rn_psnr(const struct rn_picture *a, const struct rn_picture *b,
                       double *ret_db) RN_MUST_CHECK;

// Mean structural similarity: 11x11 Gaussian window, sigma 1.5, K1 0.01, K2 0.03, data range 1,
// per channel, averaged over the positions where the window fits; a picture smaller than the
// window uses the largest odd window that fits. Wang et al. 2004. Exactly 1 for identical pictures
// and exactly symmetric. Error at most 5e-11: rounding of the second moments, 2e-14, times the
// condition number 1 / C2 = 1111, in numerator and denominator. RN_ERROR_NO_MEMORY.
enum rn_status rn_ssim(const struct rn_picture *a, const struct rn_picture *b,
                       double *ret_ssim) RN_MUST_CHECK;

#endif
