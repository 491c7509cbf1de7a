// The field's headers as one number type computes them. Compiled twice: as it stands (float64)
// and with RN_REAL=float.
#include "tests/numerics/subject.h"

#include <stddef.h>

#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/field/ripmap.h"
#include "server/engine/field/sh.h"
#include "server/engine/field/space.h"
#include "server/engine/field/volume.h"

static double nearest(double x) {
    return (double)(rn_real)x;
}

static void give(double ret[3], rn_real mean, rn_real axial, rn_real radial) {
    ret[0] = (double)mean;
    ret[1] = (double)axial;
    ret[2] = (double)radial;
}

static void moments(double mid, double width, double radius, double ret[3]) {
    struct rn_moments m = rn_frustum_moments((rn_real)mid, (rn_real)width, (rn_real)radius);
    give(ret, m.mean, m.axial, m.radial);
}

// Differences of powers of the end points (the paper's appendix).
static void moments_powers(double mid, double width, double radius, double ret[3]) {
    rn_real h = (rn_real)width / 2, a = (rn_real)mid - h, b = (rn_real)mid + h;
    rn_real d3 = b * b * b - a * a * a, d4 = b * b * b * b - a * a * a * a;
    rn_real d5 = b * b * b * b * b - a * a * a * a * a, r = (rn_real)radius;
    rn_real mean = (rn_real)0.75 * d4 / d3, square = (rn_real)0.6 * d5 / d3;
    give(ret, mean, square - mean * mean, r * r * (rn_real)0.25 * square);
}

// mip-NeRF's equation 7, middle and half width recovered from the end points.
static void moments_mipnerf(double mid, double width, double radius, double ret[3]) {
    rn_real half = (rn_real)width / 2, a = (rn_real)mid - half, b = (rn_real)mid + half;
    rn_real m = (a + b) / 2, h = (b - a) / 2, r = (rn_real)radius;
    rn_real m2 = m * m, h2 = h * h, s = 3 * m2 + h2, c = (rn_real)4 / 15;
    give(ret, m + 2 * m * h2 / s, h2 / 3 - c * (h2 * h2 * (12 * m2 - h2) / (s * s)),
         r * r * (m2 / 4 + (rn_real)5 / 12 * h2 - c * h2 * h2 / s));
}

static double variance(const double axis[3], const double d[3], double axial, double radial) {
    rn_real x[3] = {(rn_real)axis[0], (rn_real)axis[1], (rn_real)axis[2]};
    rn_real y[3] = {(rn_real)d[0], (rn_real)d[1], (rn_real)d[2]};
    return (double)rn_projected_variance(x, y, (rn_real)axial, (rn_real)radial);
}

static double level(double v, int size, int levels) {
    return (double)rn_level_from_variance((rn_real)v, size, levels);
}

static double ball_level(double ball, int size, int levels) {
    return (double)rn_level_from_ball((rn_real)ball * (rn_real)size, levels);
}

static int taps(int size, int i, int *ret_first, double weight[3]) {
    rn_real own[3] = {0, 0, 0};
    int count = rn_rip_taps(size, i, ret_first, own);
    give(weight, own[0], own[1], own[2]);
    return count;
}

static void lerp(double p, int size, int *ret_low, int *ret_high, double *ret_fraction) {
    struct rn_lerp at = rn_rip_lerp((rn_real)p, size);
    *ret_low = at.low;
    *ret_high = at.high;
    *ret_fraction = (double)at.fraction;
}

static double density(double logit) {
    return (double)rn_density((rn_real)logit);
}

static double alpha(double x) {
    return (double)rn_alpha((rn_real)x);
}

static void narrow(int n, const double *from, rn_real *to) {
    for (int i = 0; i < n; i++)
        to[i] = (rn_real)from[i];
}

static void widen(int n, const rn_real *from, double *to) {
    for (int i = 0; i < n; i++)
        to[i] = (double)from[i];
}

static double composite(int n, const double *x, double *weights, double *after) {
    rn_real own_x[SUBJECT_MAX_SAMPLES], w[SUBJECT_MAX_SAMPLES], t[SUBJECT_MAX_SAMPLES];
    narrow(n, x, own_x);
    rn_real sum = rn_composite(n, own_x, w, t);
    widen(n, w, weights);
    widen(n, t, after);
    return (double)sum;
}

static void composite_backward(int n, const double *weights, const double *after, const double *g,
                               double *grad) {
    rn_real w[SUBJECT_MAX_SAMPLES], t[SUBJECT_MAX_SAMPLES], own[SUBJECT_MAX_SAMPLES];
    narrow(n, weights, w);
    narrow(n, after, t);
    narrow(n, g, own);
    rn_composite_backward(n, w, t, own, own);
    widen(n, own, grad);
}

static void contraction(double r, double ret[3]) {
    struct rn_contraction c = rn_contraction_at((rn_real)r);
    give(ret, c.scale, c.across, c.along);
}

static double distance_of_place(double place) {
    return rn_distance_of_place((rn_real)place);
}

static void harmonics(const double d[3], double ret[16]) {
    rn_real own[3], out[RN_SH_COUNT];
    narrow(3, d, own);
    rn_sh_encode(own, out);
    widen(RN_SH_COUNT, out, ret);
}

#ifndef SUBJECT
#define SUBJECT subject_float64
#define SUBJECT_NAME "float64"
#endif

extern const struct subject SUBJECT;
const struct subject SUBJECT = {SUBJECT_NAME,
                                sizeof(rn_real) == 4 ? 24 : 53,
                                false,
                                false,
                                nearest,
                                moments,
                                moments_powers,
                                moments_mipnerf,
                                variance,
                                level,
                                ball_level,
                                taps,
                                lerp,
                                density,
                                alpha,
                                composite,
                                composite_backward,
                                contraction,
                                distance_of_place,
                                harmonics,
                                NULL,
                                NULL,
                                NULL,
                                NULL,
                                NULL,
                                NULL,
                                NULL,
                                NULL};
