#include "common/math/ball.h"

#include <stdbool.h>

#define STEPS 512
#define SIDE 64 // points of a picture's edge, a side

// How far flat points go for an angle of a direction: dq / dtheta and |q| / sin theta, whichever is
// more. 1 where flat is the plane.
static double stretch(const struct rn_lens_terms *t, double r) {
    double angle = t->omega * r, sinc = angle > 0 ? sin(angle) / angle : 1;
    if (!(t->omega > 0)) return 1;
    double square = pow(r * sinc, 2) + pow(t->c * cos(angle), 2);
    return fmax(square / t->c, sqrt(square) / fmax(sinc, 1e-9));
}

// The size of the flat points that the picture's edge shows, at most; the fold where a part of the
// edge lies beyond.
static double find_edge(const struct rn_camera *c, const struct rn_lens_terms *t) {
    double edge = 0;
    for (int i = 0; i < 4 * SIDE; i++) {
        double along = (double)(i / 4) / (SIDE - 1), q[2];
        double px = i % 4 == 0 ? 0 : i % 4 == 1 ? c->width : along * c->width;
        double py = i % 4 == 2 ? 0 : i % 4 == 3 ? c->height : along * c->height;
        struct rn_bent bent;
        if (!rn_lens_unbend(t, c->lens_fold, (px - c->cx) / c->fx, (py - c->cy) / c->fy, q, &bent))
            return c->lens_fold;
        edge = fmax(edge, hypot(q[0], q[1]));
    }
    return fmin(1.01 * edge, c->lens_fold);
}

struct rn_ball_viewer rn_ball_viewer_init(const struct rn_camera *camera) {
    struct rn_ball_viewer v = {.camera = camera, .gain = 1};
    if (camera->lens == RN_LENS_PINHOLE || camera->lens == RN_LENS_EQUIRECTANGULAR) return v;
    v.terms = rn_lens_terms(camera->lens, camera->lens_k);
    v.edge = find_edge(camera, &v.terms);
    struct rn_lens_terms radial = v.terms;
    radial.p1 = radial.p2 = radial.prism[0] = radial.prism[1] = 0;
    double p = hypot(v.terms.p1, v.terms.p2), prism = hypot(v.terms.prism[0], v.terms.prism[1]);
    for (int i = 0; i <= STEPS; i++) {
        double r = v.edge * i / STEPS;
        struct rn_bent at = rn_lens_bend(&radial, r, 0);
        double bending = fmax(fabs(at.xx), fabs(at.yy)) + (6 * p + 2 * prism) * r;
        v.gain = fmax(v.gain, 1.02 * bending * stretch(&v.terms, r)); // 2 %: between two steps
    }
    return v;
}

// Longitude and latitude; across the seam and around a pole every column.
static enum rn_ball_image on_sphere(const struct rn_camera *c, const double p[3], double angle,
                                    struct rn_ball_box *ret_box) {
    const double pi = 3.14159265358979323846;
    double longitude = atan2(p[0], p[2]), latitude = atan2(p[1], hypot(p[0], p[2])), wide = 2 * pi;
    if (fabs(latitude) + angle < pi / 2) wide = asin(sin(angle) / cos(latitude));
    if (fabs(longitude) + wide > pi) longitude = 0, wide = pi;
    double x = longitude * c->fx + c->cx, rx = wide * c->fx + 1;
    double y = latitude * c->fy + c->cy, ry = angle * c->fy + 1;
    *ret_box = (struct rn_ball_box){x - rx, y - ry, x + rx, y + ry};
    return RN_BALL_BOX;
}

enum rn_ball_image rn_ball_through_lens(const struct rn_ball_viewer *v, const double p[3],
                                        double radius, struct rn_ball_box *ret_box) {
    const struct rn_camera *c = v->camera;
    const struct rn_lens_terms *t = &v->terms;
    bool plane = t->omega == 0 && c->lens != RN_LENS_EQUIRECTANGULAR;
    double distance = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), q[2] = {0, 0};
    double nearest = plane ? p[2] - radius : distance - radius;
    if (plane && p[2] + radius <= 0) return RN_BALL_UNSEEN;
    if (nearest <= radius) return RN_BALL_AROUND;
    double reach = plane ? radius * (distance / p[2]) / nearest : asin(radius / distance);
    if (c->lens == RN_LENS_EQUIRECTANGULAR) return on_sphere(c, p, reach, ret_box);
    // Beyond the edge, the nearest point of the edge stands for the centre: what the picture shows
    // of the ball is no farther from it than twice the reach, in the plane no farther than that.
    if (p[2] < 0 && hypot(p[0], p[1]) <= radius) return RN_BALL_AROUND; // where angles meet
    (void)rn_lens_flatten(t, c->lens_fold, p, q);
    double size = hypot(q[0], q[1]);
    if (!(size < v->edge)) {
        double inwards = reach;
        if (!plane) inwards *= 2 * fmax(stretch(t, v->edge), stretch(t, size));
        if (size - inwards > v->edge) return RN_BALL_UNSEEN;
        if (!plane) reach *= 2;
        q[0] *= v->edge / size, q[1] *= v->edge / size;
    }
    struct rn_bent at = rn_lens_bend(t, q[0], q[1]);
    double x = at.x * c->fx + c->cx, rx = c->fx * v->gain * reach + 1;
    double y = at.y * c->fy + c->cy, ry = c->fy * v->gain * reach + 1;
    *ret_box = (struct rn_ball_box){x - rx, y - ry, x + rx, y + ry};
    return RN_BALL_BOX;
}
