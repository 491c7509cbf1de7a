// The space that a field's unit ball stands for: the scene's ball as it is, or all of space, drawn
// into it (Barron et al. 2022, Mip-NeRF 360, section 2).
#ifndef RN_ENGINE_FIELD_SPACE_H
#define RN_ENGINE_FIELD_SPACE_H

#include "server/engine/field/real.h"

// What a contraction does to lengths at a point: the Jacobian is across (1 - u u^T) + along u u^T,
// u the point's direction from the centre.
struct rn_contraction {
    rn_real scale;         // of the point itself: y = scale x
    rn_real across, along; // of lengths across u and along it
};

// At a distance r >= 0 from the centre, in radii of the inner ball: y = x / 2 where r <= 1, else
// (2 - 1/r) x / (2 r), so that |y| < 1. across = (2r - 1) / (2 r^2), along = 1 / (2 r^2):
// continuous at r = 1. Error: 4 ULP of each for r up to 1e12 (r up to 1e15 in float64); at infinity
// all are 0.
RN_HD struct rn_contraction rn_contraction_at(rn_real r) {
    struct rn_contraction c = {(rn_real)0.5, (rn_real)0.5, (rn_real)0.5};
    if (r > 1) {
        rn_real inverse = 1 / r;
        c.scale = c.across = (rn_real)0.5 * inverse * (2 - inverse);
        c.along = (rn_real)0.5 * inverse * inverse;
    }
    return c;
}

// The Jacobian times an axis at a point in direction `towards` (unit) from the centre. The variance
// along the axis of a Gaussian there, once contracted, is that of the Gaussian as it was along
// this. Error: 4 ULP of the axis' length times `across`.
RN_HD void rn_contracted_axis(const struct rn_contraction *c, const rn_real towards[3],
                              const rn_real axis[3], rn_real ret[3]) {
    rn_real along = rn_dot3(axis, towards) * (c->along - c->across);
    for (int i = 0; i < 3; i++)
        ret[i] = c->across * axis[i] + along * towards[i];
}

// The inverse of |x| -> |y|: the distance that lies at `y` in [0, 1); infinite at 1 and beyond.
// Error: 2 ULP times 1 / (1 - y), its condition number.
RN_HD rn_real rn_uncontracted(rn_real y) {
    rn_real size = 2 * y;
    return size <= 1 ? size : y < 1 ? 1 / (2 - size) : (rn_real)INFINITY;
}

// Nothing is looked for nearer to a camera, in radii of the inner ball.
#define RN_SPACE_NEAR 0.1

// Steps along a ray through unbounded space are even in `place`, measured from the point of the ray
// nearest to the centre: up to a distance of 1 on both sides place and distance are the same,
// beyond place = 2 - 1 / distance. So they grow as contracted lengths shrink, and (-2, 2) is the
// whole line.
RN_HD rn_real rn_place_of_distance(rn_real s) {
    rn_real size = fabs(s);
    return size <= 1 ? s : copysign(2 - 1 / size, s);
}

// Its inverse. |place| < 2; infinite at 2 and beyond. Error: 2 ULP times 1 / (2 - |place|).
RN_HD rn_real rn_distance_of_place(rn_real place) {
    rn_real size = fabs(place);
    return size <= 1 ? place : copysign(size < 2 ? 1 / (2 - size) : (rn_real)INFINITY, place);
}

// d distance / d place: max(1, distance^2).
RN_HD rn_real rn_stretch_at(rn_real s) {
    return s * s > 1 ? s * s : 1;
}

#endif
