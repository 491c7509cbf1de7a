// From a camera's cone to the ray that is marched. Host and device.
#ifndef RN_ENGINE_KERNELS_RAY_H
#define RN_ENGINE_KERNELS_RAY_H

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

// What a ray that was cut to the box of a forward-facing space was before: all of it follows from
// the line in the cube, within 2^-20 (the view's components, eye and slant of the largest of 1,
// near depth and slant) for directions at most 80 degrees off the reference camera's.
struct rn_forward_ray {
    double view[3]; // its direction in the reference camera's frame: what the colour network sees
    double slant;   // distance per unit of depth z
    double eye;     // z of the camera
};

RN_HD struct rn_forward_ray rn_forward_ray(const struct rn_disparity *space,
                                           const struct rn_march_ray *ray) {
    double origin = (double)ray->origin[2] - space->shift[2], u[2];
    double endless = -origin / (double)ray->direction[2]; // where 1 / z is 0
    for (int i = 0; i < 2; i++)
        u[i] = ((double)ray->origin[i] + (double)ray->direction[i] * endless - space->shift[i]) /
               space->scale[i];
    double slant = sqrt(u[0] * u[0] + u[1] * u[1] + 1);
    struct rn_forward_ray out = {{u[0] / slant, u[1] / slant, 1 / slant},
                                 slant,
                                 space->scale[2] / origin - (double)ray->near / slant};
    return out;
}

// What a march needs of it: 1 / z = (rise s + from) inverse at marched distance s; the camera's
// `eye` and `slant`; the cone's radius in the cube over 1 - eye / z.
struct rn_forward_line {
    float rise, from, inverse, eye, slant, wide;
};
RN_HD struct rn_forward_line rn_forward_line(const struct rn_disparity *space,
                                             const struct rn_march_ray *ray,
                                             const struct rn_forward_ray *was) {
    struct rn_forward_line line = {ray->direction[2],
                                   ray->origin[2] - (float)space->shift[2],
                                   (float)(1 / space->scale[2]),
                                   (float)was->eye,
                                   (float)was->slant,
                                   ray->radius * (float)was->slant * (float)space->scale[0]};
    return line;
}
// Distance from the camera, and the cone's radius in the cube, at marched distance `s`: numbers, or
// vectors that hold a sample a lane.
#define RN_FORWARD_FUNCTION(WHERE, NAME, TYPE)                                                     \
    WHERE void NAME(const struct rn_forward_line *line, TYPE s, TYPE *ret_distance,                \
                    TYPE *ret_width) {                                                             \
        TYPE disparity = (line->rise * s + line->from) * line->inverse;                            \
        *ret_distance = (1.0f / disparity - line->eye) * line->slant;                              \
        *ret_width = (1.0f - line->eye * disparity) * line->wide;                                  \
    }

#define RN_FORWARD_LEAST 1e-3 // of a direction, along the reference camera's axis: others miss

// The cone, in the reference camera's frame, as the kernels want it in a forward-facing space: cut
// to its box. In 1 / z the ray is base + slope / z; it starts where it enters the box in front of
// the camera, plus `jitter` of a sample's interval, and goes away from it: direction -slope.
RN_HD struct rn_march_ray rn_ray_cut_forward(const struct rn_disparity *space,
                                             const struct rn_ray *ray, double step, double jitter) {
    struct rn_march_ray out = {{0, 0, 0}, {0, 0, 0}, 0, 0, 0, 1, {0, 0, 0}, 0, 1, 0};
    const double *o = ray->origin, *d = ray->direction;
    double low = 1 / space->far, high = 1 / space->near, norm = 0, base[3], slope[3];
    out.radius = (float)ray->radius;
    if (!(d[2] > RN_FORWARD_LEAST)) return out;
    for (int i = 0; i < 3; i++) {
        double along = d[i] / d[2]; // of x / z and y / z, at infinity
        base[i] = i < 2 ? space->scale[i] * along + space->shift[i] : space->shift[i];
        slope[i] = space->scale[i] * (i < 2 ? o[i] - o[2] * along : 1);
        norm += slope[i] * slope[i];
    }
    if (o[2] > 0 && 1 / o[2] < high) high = 1 / o[2]; // nothing behind the camera
    for (int i = 0; i < 2; i++) {
        double s = fabs(slope[i]) < 1e-300 ? copysign(1e-300, slope[i]) : slope[i];
        double a = (-space->half[i] - base[i]) / s, b = (space->half[i] - base[i]) / s;
        low = fmax(low, a < b ? a : b);
        high = fmin(high, a < b ? b : a);
    }
    if (!(high > low)) return out;
    norm = sqrt(norm);
    double begin = high - jitter * step / norm;
    for (int i = 0; i < 3; i++) {
        out.origin[i] = (float)(base[i] + slope[i] * begin);
        out.direction[i] = (float)(-slope[i] / norm);
    }
    out.near = (float)((1 / begin - o[2]) / d[2]);
    out.length = (float)((begin - low) * norm);
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
                           .lens = camera->lens ? camera : NULL,
                           .space = space};
    for (int i = 0; i < 3; i++) {
        view.origin[i] = (camera->world_from_camera[i][3] - centre[i]) / radius;
        for (int j = 0; j < 3; j++)
            view.axes[i][j] = camera->world_from_camera[i][j];
    }
    return view;
}

// The same in a forward-facing space.
static inline struct rn_view rn_view_forward(const struct rn_disparity *space,
                                             const struct rn_camera *camera) {
    struct rn_view view = rn_view_init(RN_SPACE_BALL, space->origin, space->unit, camera),
                   out = view;
    rn_disparity_turn(space, view.origin, out.origin);
    for (int j = 0; j < 3; j++) {
        double axis[3] = {view.axes[0][j], view.axes[1][j], view.axes[2][j]}, turned[3];
        rn_disparity_turn(space, axis, turned);
        for (int i = 0; i < 3; i++)
            out.axes[i][j] = turned[i];
    }
    out.disparity = *space;
    return out;
}

#endif
