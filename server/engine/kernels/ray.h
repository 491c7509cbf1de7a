// From a camera's cone to the ray that is marched. Host and device.
#ifndef RN_ENGINE_RAY_H
#define RN_ENGINE_RAY_H

#include "common/math/camera.h"
#include "server/engine/kernels/kernels.h"

// Where the ray enters the cube [-1, 1]^3, at least 0, within 4 ULP of 1 + distance; false when it
// misses. Components of 0 and denormal ones count as 1e-300: no 0 / 0 on a face.
RN_HD bool rn_enter_cube(const double o[3], const double d[3], double *ret_enter) {
    double enter = 0, leave = 1e300;
    for (int i = 0; i < 3; i++) {
        double direction = fabs(d[i]) < 1e-300 ? copysign(1e-300, d[i]) : d[i];
        double a = (-1 - o[i]) / direction, b = (1 - o[i]) / direction;
        double first = a < b ? a : b, last = a < b ? b : a;
        enter = first > enter ? first : enter;
        leave = last < leave ? last : leave;
    }
    *ret_enter = enter;
    return leave > enter;
}

// Steps a sample spans: the power of two, at most 8, that makes the interval's standard deviation
// (step / sqrt 12) nearest to the cone's across it (radius / 2) at the ball's middle.
RN_HD int rn_sample_stride(double radius, double step) {
    double ratio = radius * 0.5 / (step / sqrt(12.0));
    return ratio < 1.41421356 ? 1 : ratio < 2.82842712 ? 2 : ratio < 5.65685425 ? 4 : 8;
}

// The cone in dataset coordinates as the kernels want it: in the frame where the ball around
// `centre` of `radius` is the unit ball, cut to the ball, starting where it enters the scene's cube
// plus `jitter` in [0, 1) of a sample's interval. With `cone_step` a sample spans as many steps as
// its cone is wide. length <= 0 where it misses. Weight 1, no target.
RN_HD struct rn_march_ray rn_ray_cut(const double centre[3], double radius, bool cone_step,
                                     const struct rn_ray *ray, double step, double jitter) {
    struct rn_march_ray out = {{0, 0, 0}, {0, 0, 0}, 0, 0, 0, 1, {0, 0, 0}, 0, 1, 0};
    double o[3], enter, along = 0, across = 0;
    for (int i = 0; i < 3; i++) {
        o[i] = (ray->origin[i] - centre[i]) / radius;
        along += o[i] * ray->direction[i];
    }
    for (int i = 0; i < 3; i++) {
        double foot = o[i] - along * ray->direction[i]; // the point nearest the centre
        across += foot * foot;
    }
    for (int i = 0; i < 3; i++)
        out.direction[i] = (float)ray->direction[i];
    out.radius = (float)ray->radius;
    if (!(across <= 1) || !(ray->radius > 0) || !rn_enter_cube(o, ray->direction, &enter))
        return out;
    if (cone_step) out.stride = rn_sample_stride(-along * ray->radius, step);
    double near = enter + jitter * step * out.stride, length = sqrt(1 - across) - along - near;
    for (int i = 0; i < 3; i++)
        out.origin[i] = (float)(o[i] + ray->direction[i] * near);
    out.near = (float)near;
    out.length = (float)length;
    return out;
}

// The same through unbounded space, where the ball around `centre` of `radius` is the inner one:
// from RN_SPACE_NEAR before the camera to infinity.
RN_HD struct rn_march_ray rn_ray_cut_unbounded(const double centre[3], double radius,
                                               const struct rn_ray *ray, double step,
                                               double jitter) {
    struct rn_march_ray out = {{0, 0, 0}, {0, 0, 0}, 0, 0, 0, 1, {0, 0, 0}, 0, 1, 0};
    double o[3], along = 0;
    for (int i = 0; i < 3; i++) {
        o[i] = (ray->origin[i] - centre[i]) / radius;
        along += o[i] * ray->direction[i];
    }
    for (int i = 0; i < 3; i++) {
        out.origin[i] = (float)(o[i] - along * ray->direction[i]);
        out.direction[i] = (float)ray->direction[i];
    }
    out.radius = (float)ray->radius;
    out.near = (float)-along;
    out.length = (float)(2 - rn_place_of_distance(along + RN_SPACE_NEAR) - 2 * step * jitter);
    return out;
}

// A camera as the kernels' `rays` wants it, within 2 ULP a number, in the frame where the ball
// around `centre` of `radius` is the unit ball, or in unbounded space the inner one. A camera with
// a lens must outlive the view.
static inline struct rn_view rn_view_init(enum rn_space space, const double centre[3],
                                          double radius, const struct rn_camera *camera) {
    struct rn_view view = {.cx = camera->cx,
                           .cy = camera->cy,
                           .inverse_fx = 1 / camera->fx,
                           .inverse_fy = 1 / camera->fy,
                           .radius = rn_camera_cone(camera),
                           .space = space,
                           .lens = camera->lens ? camera : NULL};
    for (int i = 0; i < 3; i++) {
        view.origin[i] = (camera->world_from_camera[i][3] - centre[i]) / radius;
        for (int j = 0; j < 3; j++)
            view.axes[i][j] = camera->world_from_camera[i][j];
    }
    return view;
}

#endif
