// Conical frustums as 3D Gaussians (paper, section 3.1; mip-NeRF, equation 7).
#ifndef RN_ENGINE_FIELD_FRUSTUM_H
#define RN_ENGINE_FIELD_FRUSTUM_H

#include "server/engine/field/real.h"

// Mean distance along the axis, variance along it, variance across it.
struct rn_moments {
    rn_real mean, axial, radial;
};

// Moments of a uniform cone of `radius` per unit distance, cut at mid -+ width/2.
//
// With h = width/2 and q = (h/mid)^2, in [0, 1]:
//   mean   = mid (1 + 2q / (3 + q))
//   axial  = 3/5 h^2 (5 - 2q + q^2) / (3 + q)^2
//   radial = 3/20 radius^2 mid^2 (5 + 10q + q^2) / (3 + q)
// Every term is positive: no cancellation. The width is carried, never recovered from end points.
// mid > 0 and 0 <= width <= 2 mid; mid = 0 is the degenerate point. Error: float64 within 1 ULP
// (80-bit inside); float within 8 ULP (tests/numerics/proofs/frustum.gappa).
RN_HD struct rn_moments rn_frustum_moments(rn_real mid, rn_real width, rn_real radius) {
    rn_wide m = mid, h = (rn_wide)width * (rn_wide)0.5, r = radius;
    rn_wide ratio = m > 0 ? h / m : 0;
    rn_wide q = ratio * ratio, s = 1 / (3 + q);
    struct rn_moments out;
    out.mean = (rn_real)(m + m * (2 * q * s));
    out.axial = (rn_real)(((rn_wide)3 / 5 * (h * s)) * (h * s) * (5 + q * (q - 2)));
    out.radial = (rn_real)((r * m) * (r * m) * ((rn_wide)3 / 20 * s) * (5 + q * (10 + q)));
    return out;
}

#endif
