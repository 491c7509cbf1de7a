// Lenses: how a camera's picture departs from a pinhole's. Host and device.
//
// A lens takes the direction (X, Y, Z) in camera axes to a flat point q, and q to a bent one q',
// which lies at the pixel (fx x' + cx, fy y' + cy). Flat is
//   the plane:   q = (X, Y) / Z
//   an angle:    q = (X, Y) / r * atan2(omega c r, Z) / omega, r^2 = X^2 + Y^2
//                (fisheye: omega = c = 1; fov: c = 2 tan(omega / 2) / omega)
//   the sphere:  longitude and latitude, radians
// and bent is, with s = |q|^2,
//   q' = q (N(s) / D(s) + 2 p . q) + (p + prism) s,  p = (p2, p1)
// Sources: OpenCV's calib3d (rational model; fisheye), COLMAP's sensor/models.h (thin prism, FOV),
// nerfstudio's camera_utils (polynomial), Devernay and Faugeras 2001 (FOV).
#ifndef RN_COMMON_MATH_LENS_H
#define RN_COMMON_MATH_LENS_H

#include <math.h>
#include <stdbool.h>

#include "common/math/hd.h"

#define RN_LENS_PARAMETERS 12 // the most that a lens has

enum rn_lens {
    RN_LENS_PINHOLE,
    RN_LENS_OPENCV,             // rational radial and tangential (OpenCV's, COLMAP's FULL_OPENCV)
    RN_LENS_POLYNOMIAL,         // radial to r^8 and tangential (nerfstudio's)
    RN_LENS_FISHEYE,            // a polynomial of the angle from the axis (OpenCV's)
    RN_LENS_FOV,                // one angle (Devernay and Faugeras 2001)
    RN_LENS_THIN_PRISM_FISHEYE, // COLMAP's
    RN_LENS_EQUIRECTANGULAR,    // longitude and latitude; fx and fy are pixels a radian
    RN_LENS_COUNT
};

// What its parameters are called in files, in the order in which they are kept.
struct rn_lens_model {
    int count;
    double most; // of a parameter's size
    const char *parameters[RN_LENS_PARAMETERS];
};
extern const struct rn_lens_model rn_lens_models[RN_LENS_COUNT];
extern const char *const rn_lens_names[RN_LENS_COUNT]; // as files have them

// A lens as the formulas above have it. A plain value.
struct rn_lens_terms {
    enum rn_lens lens;
    double above[4], below[3]; // N = 1 + above[0] s + ..., D = 1 + below[0] s + ...
    double p1, p2, prism[2];
    double omega, c; // omega 0: the plane
};

RN_HD struct rn_lens_terms rn_lens_terms(enum rn_lens lens, const double *k) {
    struct rn_lens_terms t = {lens, {0, 0, 0, 0}, {0, 0, 0}, 0, 0, {0, 0}, 0, 1};
    bool prism = lens == RN_LENS_THIN_PRISM_FISHEYE;
    if (lens == RN_LENS_OPENCV || prism) { // k1 k2 p1 p2 k3, then k4 k5 k6 or k4 sx1 sy1
        t.above[0] = k[0], t.above[1] = k[1], t.above[2] = k[4];
        t.p1 = k[2], t.p2 = k[3];
        if (prism)
            t.above[3] = k[5], t.prism[0] = k[6], t.prism[1] = k[7];
        else
            t.below[0] = k[5], t.below[1] = k[6], t.below[2] = k[7];
    }
    if (lens == RN_LENS_POLYNOMIAL || lens == RN_LENS_FISHEYE)
        for (int i = 0; i < 4; i++)
            t.above[i] = k[i];
    if (lens == RN_LENS_POLYNOMIAL) t.p1 = k[4], t.p2 = k[5];
    if (lens == RN_LENS_FISHEYE || prism) t.omega = 1;
    if (lens == RN_LENS_FOV && fabs(k[0]) > 1e-150) { // below, it is the pinhole to the last bit
        t.omega = fabs(k[0]);
        t.c = 2 * tan(t.omega / 2) / t.omega;
    }
    return t;
}

// A bent point and its derivatives: xy is that of x' by v.
struct rn_bent {
    double x, y, xx, xy, yx, yy;
};

RN_HD struct rn_bent rn_lens_bend(const struct rn_lens_terms *t, double u, double v) {
    const double *a = t->above, *b = t->below;
    double s = u * u + v * v;
    double n = 1 + s * (a[0] + s * (a[1] + s * (a[2] + s * a[3])));
    double dn = a[0] + s * (2 * a[1] + s * (3 * a[2] + s * (4 * a[3])));
    double d = 1 + s * (b[0] + s * (b[1] + s * b[2]));
    double dd = b[0] + s * (2 * b[1] + s * (3 * b[2]));
    double g = n / d, dg = 2 * (dn - g * dd) / d;
    double even = 2 * (t->p2 * u + t->p1 * v), odd = 2 * (t->p1 * u + t->p2 * v);
    struct rn_bent out;
    out.x = u * (g + even) + (t->p2 + t->prism[0]) * s;
    out.y = v * (g + even) + (t->p1 + t->prism[1]) * s;
    out.xx = g + u * u * dg + even + (4 * t->p2 + 2 * t->prism[0]) * u;
    out.xy = u * v * dg + odd + 2 * t->prism[0] * v;
    out.yx = u * v * dg + odd + 2 * t->prism[1] * u;
    out.yy = g + v * v * dg + even + (4 * t->p1 + 2 * t->prism[1]) * v;
    return out;
}

// The flat point inside the fold that bends to (x, y), by Newton's method with halved steps; its
// derivatives too. False where there is none: the pixel lies beyond the fold. Inside, the
// derivative is positive definite, so that there is at most one and every step leads down to it.
RN_HD bool rn_lens_unbend(const struct rn_lens_terms *t, double fold, double x, double y,
                          double q[2], struct rn_bent *ret) {
    double size = sqrt(x * x + y * y), scale = size < 0.5 * fold ? 1 : 0.5 * fold / size;
    double u = scale * x, v = scale * y;
    struct rn_bent at = rn_lens_bend(t, u, v);
    double ex = at.x - x, ey = at.y - y, error = ex * ex + ey * ey;
    for (int i = 0, done = 0; i < 100 && error > 0 && !done; i++) {
        double det = at.xx * at.yy - at.xy * at.yx, part = 1;
        double du = (at.yy * ex - at.xy * ey) / det, dv = (at.xx * ey - at.yx * ex) / det;
        for (done = 1; part > 1e-12; part *= 0.5) {
            double nu = u - part * du, nv = v - part * dv;
            struct rn_bent next = rn_lens_bend(t, nu, nv);
            double nx = next.x - x, ny = next.y - y, less = nx * nx + ny * ny;
            if (!(nu * nu + nv * nv < fold * fold) || !(less < error)) continue;
            // The error is squared by each whole step: after 2^-30 comes 2^-60.
            done = part == 1 && du * du + dv * dv <= 0x1p-60 * (nu * nu + nv * nv);
            u = nu, v = nv, at = next, ex = nx, ey = ny, error = less;
            break;
        }
    }
    q[0] = u, q[1] = v;
    *ret = at;
    return error <= 0x1p-80 * (1 + size * size);
}

// The direction of a flat point, of any length; returns the area of the unit sphere that an area of
// flat points takes, or of the plane Z = 1 where flat is the plane: pinholes' cones are measured
// there. 0 where the flat point lies outside.
RN_HD double rn_lens_look(const struct rn_lens_terms *t, const double q[2], double ret[3]) {
    if (t->lens == RN_LENS_EQUIRECTANGULAR) {
        double ring = cos(q[1]);
        ret[0] = sin(q[0]) * ring;
        ret[1] = sin(q[1]);
        ret[2] = cos(q[0]) * ring;
        return fabs(q[0]) <= 3.14159265358979323846 && ring > 0 ? ring : 0;
    }
    double angle = t->omega * sqrt(q[0] * q[0] + q[1] * q[1]);
    double sinc = angle > 0 ? sin(angle) / angle : 1;
    ret[0] = q[0] * sinc;
    ret[1] = q[1] * sinc;
    ret[2] = t->omega > 0 ? t->c * cos(angle) : 1;
    if (!(t->omega > 0)) return 1;
    double square = ret[0] * ret[0] + ret[1] * ret[1] + ret[2] * ret[2];
    return t->c * sinc / (square * sqrt(square));
}

// The flat point of a direction of any length; false where the lens sees none.
RN_HD bool rn_lens_flatten(const struct rn_lens_terms *t, double fold, const double p[3],
                           double ret[2]) {
    double r = sqrt(p[0] * p[0] + p[1] * p[1]);
    if (t->lens == RN_LENS_EQUIRECTANGULAR) {
        ret[0] = atan2(p[0], p[2]);
        ret[1] = atan2(p[1], sqrt(p[0] * p[0] + p[2] * p[2]));
        return r > 0 || p[2] != 0;
    }
    if (!(p[2] > 0) && !(t->omega > 0 && r > 0)) return false;
    double per = 1 / p[2]; // where r = 0 any will do
    if (t->omega > 0 && r > 0) per = atan2(t->omega * t->c * r, p[2]) / (t->omega * r);
    ret[0] = p[0] * per;
    ret[1] = p[1] * per;
    return ret[0] * ret[0] + ret[1] * ret[1] < fold * fold;
}

// The size of the flat points up to which bending is one to one, the derivative positive definite
// in every direction: the least radius where min(g, (r g)') falls to 6 |p| r + 2 |prism| r, for a
// tangential part takes no more from it (Weyl). At most what the lens can see: 1e4 in the plane.
double rn_lens_fold(enum rn_lens lens, const double *k);

#endif
