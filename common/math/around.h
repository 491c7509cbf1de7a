// Directions about an axis.
#ifndef RN_COMMON_MATH_AROUND_H
#define RN_COMMON_MATH_AROUND_H

#include <stddef.h>

// Two axes that complete the unit vector `up` to a right-handed frame: a, b, up.
void rn_around_axes(const double up[3], double a[3], double b[3]);

// The circle without the largest gap between neighbours of `angles`, which are in radians -pi .. pi
// and sorted by it: where what is left begins. Returns its length; 2 pi of none.
double rn_around_arc(double *angles, size_t count, double *ret_first);

#endif
