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
// all are 0. One function a type, numbers or vectors that hold a sample a lane: LENGTHS as struct
// rn_contraction of it, CONSTANT(x) is one of it, MAX(NaN, x) is x.
#define RN_CONTRACTION_FUNCTION(WHERE, NAME, LENGTHS, TYPE, CONSTANT, MAX)                         \
    WHERE LENGTHS NAME(TYPE r) {                                                                   \
        TYPE inverse = CONSTANT(1) / MAX(r, CONSTANT(1)), half = CONSTANT(0.5) * inverse;          \
        TYPE across = half * (CONSTANT(2) - inverse);                                              \
        LENGTHS c = {across, across, half * inverse};                                              \
        return c;                                                                                  \
    }
RN_CONTRACTION_FUNCTION(RN_HD, rn_contraction_at, struct rn_contraction, rn_real, (rn_real), rn_max)

// The Jacobian times an axis at a point in direction `towards` (unit) from the centre. The variance
// along the axis of a Gaussian there, once contracted, is that of the Gaussian as it was along
// this. Error: 4 ULP of the axis' length times `across`.
RN_HD void rn_contracted_axis(const struct rn_contraction *c, const rn_real towards[3],
                              const rn_real axis[3], rn_real ret[3]) {
    rn_real along = rn_dot3(axis, towards) * (c->along - c->across);
    for (int i = 0; i < 3; i++)
        ret[i] = c->across * axis[i] + along * towards[i];
}

// In fp32, numbers or vectors. VARIANCE: along a plane's axis of a Gaussian in direction d whose
// variances before the contraction are `axial` and `radial`, at a point towards `towards`: along
// the Jacobian times the axis. BALL_LEVEL: of the isotropic footprint (footprint.h), the ball with
// the Gaussian's cross-section whose volume is drawn together as it is (Barron et al. 2023,
// Zip-NeRF).
#define RN_CONTRACTED_FUNCTIONS(WHERE, VARIANCE, BALL_LEVEL, LENGTHS, TYPE, CONSTANT, MAX, CLAMP,  \
                                LOG2)                                                              \
    WHERE TYPE VARIANCE(const LENGTHS *lengths, const TYPE towards[3], TYPE axial, TYPE radial,    \
                        const float axis[3], const float d[3]) {                                   \
        TYPE dot = CONSTANT(0), y[3], along = CONSTANT(0), across = CONSTANT(0);                   \
        for (int i = 0; i < 3; i++)                                                                \
            dot += axis[i] * towards[i];                                                           \
        dot *= lengths->along - lengths->across;                                                   \
        for (int i = 0; i < 3; i++) {                                                              \
            y[i] = axis[i] * lengths->across + dot * towards[i];                                   \
            along += y[i] * d[i];                                                                  \
        }                                                                                          \
        for (int i = 0; i < 3; i++) {                                                              \
            int j = (i + 1) % 3, k = (i + 2) % 3;                                                  \
            TYPE c = y[j] * d[k] - y[k] * d[j];                                                    \
            across += c * c;                                                                       \
        }                                                                                          \
        return axial * (along * along) + radial * across;                                          \
    }                                                                                              \
    WHERE TYPE BALL_LEVEL(const LENGTHS *lengths, TYPE radius, int size, int levels) {             \
        TYPE shrunk = 2.0f * LOG2(lengths->across) + LOG2(lengths->along);                         \
        TYPE level = LOG2(MAX(radius * (float)size, CONSTANT(1e-30f))) + shrunk * (1.0f / 3);      \
        return CLAMP(level, 0.0f, (float)(levels - 1));                                            \
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
#define RN_PLACE_FUNCTION(WHERE, NAME, NUMBER, ABS, COPYSIGN)                                      \
    WHERE NUMBER NAME(NUMBER s) {                                                                  \
        NUMBER size = ABS(s);                                                                      \
        return size <= 1 ? s : COPYSIGN(2 - 1 / size, s);                                          \
    }
RN_PLACE_FUNCTION(RN_HD, rn_place_of_distance, rn_real, fabs, copysign)

// Its inverse. |place| < 2; infinite at 2 and beyond. Error: 2 ULP times 1 / (2 - |place|).
RN_HD rn_real rn_distance_of_place(rn_real place) {
    rn_real size = fabs(place);
    return size <= 1 ? place : copysign(size < 2 ? 1 / (2 - size) : (rn_real)INFINITY, place);
}

// The same in fp32, numbers or vectors, where CHOOSE(condition, x, y): a place within 1e-6 of the
// end is taken for that.
#define RN_DISTANCE_FUNCTION(WHERE, NAME, TYPE, CONSTANT, MAX, ABS, CHOOSE)                        \
    WHERE TYPE NAME(TYPE place) {                                                                  \
        TYPE size = ABS(place), far = CONSTANT(1) / MAX(CONSTANT(2) - size, CONSTANT(1e-6f));      \
        return CHOOSE(size <= 1, place, CHOOSE(place < 0, -far, far));                             \
    }

// How far a ray may come in the unit ball while its place changes by 2 h, in units of h and
// squared; `squares`: the square of its distance b from the centre. Along the radius h at most;
// across it 2 h b, as `across` <= 1 / r of lengths, of which the ray has b / r across the radius,
// stretched by distance^2 <= r^2. Both are reached, the second far away.
RN_HD float rn_squared_pace(float squares) {
    return 1 + 4 * squares;
}

// d distance / d place: max(1, distance^2).
RN_HD rn_real rn_stretch_at(rn_real s) {
    return s * s > 1 ? s * s : 1;
}

#endif
