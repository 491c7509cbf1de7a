// The number type of the field's mathematics: float64 in the reference, float where a device
// instantiates the same headers (#define RN_REAL float before the first include).
#ifndef RN_ENGINE_FIELD_REAL_H
#define RN_ENGINE_FIELD_REAL_H

#include <math.h>

#include "common/math/hd.h"

#ifndef RN_REAL
#define RN_REAL double
#define RN_WIDE long double // where a formula is worth being right to the last bit
#endif
#ifndef RN_WIDE
#define RN_WIDE RN_REAL
#endif

typedef RN_REAL rn_real;
typedef RN_WIDE rn_wide;

RN_HD rn_real rn_clamp(rn_real x, rn_real low, rn_real high) {
    return x > low ? (x < high ? x : high) : low; // NaN gives low
}

RN_HD rn_real rn_min(rn_real a, rn_real b) {
    return a < b ? a : b;
}
RN_HD rn_real rn_max(rn_real a, rn_real b) {
    return a > b ? a : b; // NaN gives b
}

// a b - c d without cancellation (Kahan; error at most 1.5 ULP of the result).
RN_HD rn_real rn_difference_of_products(rn_real a, rn_real b, rn_real c, rn_real d) {
    rn_real cd = c * d;
    rn_real error = fma(-c, d, cd);
    return fma(a, b, -cd) + error;
}

// a . b with the rounding of every product and sum carried along (Ogita, Rump & Oishi 2005, Dot2):
// error at most 1 ULP of the result plus 8 u^2 |a||b|, u the unit roundoff.
RN_HD rn_real rn_dot3(const rn_real a[3], const rn_real b[3]) {
    rn_real sum = a[0] * b[0], error = fma(a[0], b[0], -sum);
    for (int i = 1; i < 3; i++) {
        rn_real product = a[i] * b[i], next = sum + product, part = next - sum;
        error += fma(a[i], b[i], -product) + ((sum - (next - part)) + (product - part));
        sum = next;
    }
    return sum + error;
}

#endif
