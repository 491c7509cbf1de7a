// Conical frustums as 3D Gaussians (paper, section 3.1; mip-NeRF, equation 7).
#ifndef RN_ENGINE_FIELD_FRUSTUM_H
#define RN_ENGINE_FIELD_FRUSTUM_H

#include "server/engine/field/real.h"

// Mean distance along the axis, variance along it, variance across it.
struct rn_moments {
    rn_real mean, axial, radial;
};

// Moments of a uniform cone of `radius` per unit distance, cut at t -+ half; ratio = half / t, in
// [0, 1]. Mean - t, the variance along the axis and the one across it; with h = half, q = ratio^2:
//   mean   = t (1 + 2q / (3 + q))
//   axial  = 3/5 h^2 (5 - 2q + q^2) / (3 + q)^2
//   radial = 3/20 radius^2 t^2 (5 + 10q + q^2) / (3 + q)
// Every term is positive: no cancellation. The width is carried, never recovered from end points.
// One function a type: numbers of it, or vectors that hold a sample a lane. Constants are of type
// NUMBER. Error: float within 8 ULP for t of 1e-6 to 1e7 and a width of 1e-7 t to 2 t, contracted
// or not (tests/numerics/proofs/frustum.gappa, frustum_fma.gappa).
#define RN_FRUSTUM_FUNCTION(NAME, TYPE, NUMBER)                                                    \
    RN_HD void NAME(TYPE t, TYPE ratio, NUMBER half, NUMBER radius, TYPE *ret_shift,               \
                    TYPE *ret_axial, TYPE *ret_radial) {                                           \
        TYPE q = ratio * ratio, s = (NUMBER)1 / (q + (NUMBER)3);                                   \
        TYPE hs = half * s, rt = radius * t;                                                       \
        *ret_shift = t * ((NUMBER)2 * q * s);                                                      \
        *ret_axial = ((NUMBER)3 / 5 * hs) * hs * (q * (q - (NUMBER)2) + (NUMBER)5);                \
        *ret_radial = rt * rt * ((NUMBER)3 / 20 * s) * (q * (q + (NUMBER)10) + (NUMBER)5);         \
    }
RN_FRUSTUM_FUNCTION(rn_frustum_wide, rn_wide, rn_wide)

// The same of a cone cut at mid -+ width/2. mid > 0 and 0 <= width <= 2 mid; mid = 0 is the
// degenerate point. Error: float64 within 1 ULP (80-bit inside, frustum_wide.gappa).
RN_HD struct rn_moments rn_frustum_moments(rn_real mid, rn_real width, rn_real radius) {
    rn_wide m = mid, h = (rn_wide)width * (rn_wide)0.5, shift, axial, radial;
    rn_frustum_wide(m, m > 0 ? h / m : 0, h, radius, &shift, &axial, &radial);
    struct rn_moments out = {(rn_real)(m + shift), (rn_real)axial, (rn_real)radial};
    return out;
}

#endif
