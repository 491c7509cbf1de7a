// Vectors of three numbers, float64. Rotations of cameras, which must stay orthonormal, have forms
// of their own (common/math/camera.c).
#ifndef RN_COMMON_MATH_VECTOR_H
#define RN_COMMON_MATH_VECTOR_H

#include <math.h>
#include <stdbool.h>

static inline double rn_dot(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Between two places, squared, and as it is.
static inline double rn_square_apart(const double a[3], const double b[3]) {
    double squares = 0;
    for (int i = 0; i < 3; i++)
        squares += (a[i] - b[i]) * (a[i] - b[i]);
    return squares;
}

static inline double rn_apart(const double a[3], const double b[3]) {
    return sqrt(rn_square_apart(a, b));
}

// ret: none of the others.
static inline void rn_cross(const double a[3], const double b[3], double ret[3]) {
    ret[0] = a[1] * b[2] - a[2] * b[1];
    ret[1] = a[2] * b[0] - a[0] * b[2];
    ret[2] = a[0] * b[1] - a[1] * b[0];
}

// That it had a length to speak of; else what is left means nothing.
static inline bool rn_make_unit(double v[3]) {
    double length = sqrt(rn_dot(v, v));
    for (int i = 0; i < 3; i++)
        v[i] /= length;
    return length > 1e-9;
}

#endif
