// Balls as a camera sees them: the box of pixels that a ball's image lies in.
#ifndef RN_COMMON_MATH_BALL_H
#define RN_COMMON_MATH_BALL_H

#include "common/math/camera.h"

// A camera made ready. Immutable; no longer than the camera.
struct rn_ball_viewer {
    const struct rn_camera *camera;
    struct rn_lens_terms terms; // where the camera has a lens
    double edge;                // size of the flat points that the picture shows, at most
    double gain;                // a bent point moves at most as far, for an angle that a direction
                                // does (where flat is the plane: for what the flat point does)
};
struct rn_ball_viewer rn_ball_viewer_init(const struct rn_camera *camera);

enum rn_ball_image {
    RN_BALL_UNSEEN, // behind the camera, or off what a lens sees
    RN_BALL_AROUND, // so near that it may lie anywhere
    RN_BALL_BOX     // within the box, which may reach off the picture
};
struct rn_ball_box {
    double x0, y0, x1, y1; // pixels
};

// Not of a pinhole; `p` is the centre in camera axes.
enum rn_ball_image rn_ball_through_lens(const struct rn_ball_viewer *viewer, const double p[3],
                                        double radius, struct rn_ball_box *ret_box);

// The ball lies around a point (dataset units). A pixel is added to all sides of the box.
static inline enum rn_ball_image rn_ball_image(const struct rn_ball_viewer *viewer,
                                               const double centre[3], double radius,
                                               struct rn_ball_box *ret_box) {
    const struct rn_camera *c = viewer->camera;
    double p[3];
    rn_camera_axes(c, centre, p);
    if (c->lens != RN_LENS_PINHOLE) return rn_ball_through_lens(viewer, p, radius, ret_box);
    double nearest = p[2] - radius;
    if (p[2] + radius <= 0) return RN_BALL_UNSEEN;
    if (nearest <= radius) return RN_BALL_AROUND;
    double at[2] = {0, 0};
    (void)rn_camera_project(c, p, at);
    // A ball's image reaches at most f r sqrt(1 + tan^2) / nearest from its centre's image.
    double slope = sqrt(1 + (p[0] * p[0] + p[1] * p[1]) / (p[2] * p[2]));
    double rx = c->fx * radius * slope / nearest + 1, ry = c->fy * radius * slope / nearest + 1;
    *ret_box = (struct rn_ball_box){at[0] - rx, at[1] - ry, at[0] + rx, at[1] + ry};
    return RN_BALL_BOX;
}

#endif
