// Density and compositing along one ray (paper, section 3.4; Max 1995).
#ifndef RN_ENGINE_FIELD_VOLUME_H
#define RN_ENGINE_FIELD_VOLUME_H

#include "server/engine/field/real.h"

// Logits are shifted by -1 before the exponential and clamped at +-15, forward and backward: the
// density is finite and its gradient never dies.
#define RN_DENSITY_SHIFT 1
#define RN_DENSITY_CLAMP 15

// Optical depth is density x interval, the interval in units of radius / 1.5 (the published
// scenes' radius is 1.5 dataset units).
#define RN_DENSITY_UNIT 1.5

#define RN_OPAQUE 40 // optical depth that nothing shines through: where a place ends

// exp(clamp(logit - 1, -15, 15)): the truncated exponential. NaN gives exp(-15). Error: within
// 1 + |logit - 1| ULP, the exponential's condition number.
RN_HD rn_real rn_density(rn_real logit) {
    return exp(rn_clamp(logit - RN_DENSITY_SHIFT, -RN_DENSITY_CLAMP, RN_DENSITY_CLAMP));
}

// d density / d logit as the released code has it: the exponential itself, also where clamped.
RN_HD rn_real rn_density_slope(rn_real logit) {
    return rn_density(logit);
}

// Opacity of one interval of optical depth x >= 0: 1 - exp(-x), to full relative accuracy
// (2 ULP).
RN_HD rn_real rn_alpha(rn_real x) {
    return -expm1(-x);
}

// Forward: weights[i] = exp(-S_i) (1 - exp(-x_i)), S_i = sum of x_j, j < i; after[i] =
// exp(-S_{i+1}) is the transmittance behind sample i. Returns S_n (Kahan sum), so that opacity =
// -expm1(-S_n). Errors: a weight 3 ULP times 1 + S_i, S_n 2 ULP; weights and final transmittance
// sum to 1 within 4 ULP.
RN_HD rn_real rn_composite(int n, const rn_real *x, rn_real *weights, rn_real *after) {
    rn_real sum = 0, carry = 0, before = 1;
    for (int i = 0; i < n; i++) {
        rn_real y = x[i] - carry, t = sum + y;
        carry = (t - sum) - y;
        sum = t;
        weights[i] = before * rn_alpha(x[i]);
        before = after[i] = exp(-sum);
    }
    return sum;
}

// Backward: given g_i = dL/dw_i, writes dL/dx_i = T_{i+1} g_i - sum over j > i of w_j g_j. The
// suffix is accumulated from the back (no total-minus-prefix) and nothing is divided by 1 - alpha.
// `grad` may be `g`. Error relative to |T_{i+1} g_i| + sum of |w_j g_j|: float64 1e-13, float 1e-5.
RN_HD void rn_composite_backward(int n, const rn_real *weights, const rn_real *after,
                                 const rn_real *g, rn_real *grad) {
    rn_real suffix = 0;
    for (int i = n - 1; i >= 0; i--) {
        rn_real gi = g[i];
        grad[i] = after[i] * gi - suffix;
        suffix += weights[i] * gi;
    }
}

#endif
