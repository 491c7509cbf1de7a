// The disparity box of a forward-facing capture, which the planes cover there in place of the
// scene's ball. Host and device.
//
// The cube [-1, 1]^3 is then what the cameras see between two depths, in the disparity of a
// reference camera (normalised device coordinates: Mildenhall et al. 2020, appendix C). With (x, y,
// z) in that camera's frame the cube's coordinates are
//     q = scale * (x / z, y / z, 1 / z) + shift,
// a projective map: straight lines stay straight, a cone stays a cone, and along every line 1 / z
// is linear. A pixel is about as wide everywhere in it, and depth is told apart as disparity tells
// it apart.
#ifndef RN_ENGINE_FIELD_DISPARITY_H
#define RN_ENGINE_FIELD_DISPARITY_H

#include <stdbool.h>

#include "server/engine/field/real.h"

// Plain value. Where the planes cover the ball, all of it is 0.
struct rn_disparity {
    bool on;
    double unit;       // of x, y and z: the radius of the scene's ball, dataset units
    double origin[3];  // of the reference camera, dataset units
    double axes[3][3]; // its right, down and forward: axes[i][j] is component i of axis j
    double scale[3];   // scale[0] == scale[1] > 0: pixels are square; scale[2] < 0: far is +1
    double shift[3];   // of x / z, y / z, 1 / z
    double half[3];    // the box within the cube that is sampled: |q[i]| <= half[i] <= 1
    double near, far;  // its depths z, 0 < near < far
};

// A direction of dataset coordinates in the reference camera's frame.
RN_HD void rn_disparity_turn(const struct rn_disparity *space, const double d[3], double ret[3]) {
    for (int j = 0; j < 3; j++)
        ret[j] = space->axes[0][j] * d[0] + space->axes[1][j] * d[1] + space->axes[2][j] * d[2];
}

// A point of dataset coordinates in that frame.
RN_HD void rn_disparity_seen(const struct rn_disparity *space, const double p[3], double ret[3]) {
    double d[3];
    for (int i = 0; i < 3; i++)
        d[i] = (p[i] - space->origin[i]) / space->unit;
    rn_disparity_turn(space, d, ret);
}

// From the reference camera's frame, z > 0, to the cube: within 3 ULP of |scale * u| + |shift| a
// coordinate, u = x / z, y / z, 1 / z.
RN_HD void rn_disparity_map(const struct rn_disparity *space, const double p[3], double ret[3]) {
    ret[0] = space->scale[0] * (p[0] / p[2]) + space->shift[0];
    ret[1] = space->scale[1] * (p[1] / p[2]) + space->shift[1];
    ret[2] = space->scale[2] / p[2] + space->shift[2];
}

// And back.
RN_HD void rn_disparity_unmap(const struct rn_disparity *space, const double q[3], double ret[3]) {
    ret[2] = space->scale[2] / (q[2] - space->shift[2]);
    ret[0] = ret[2] * ((q[0] - space->shift[0]) / space->scale[0]);
    ret[1] = ret[2] * ((q[1] - space->shift[1]) / space->scale[1]);
}

#endif
