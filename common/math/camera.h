// Cameras. Convention everywhere inside: world-from-camera poses, OpenCV camera axes (x right,
// y down, z forward), pixel (0,0) is the top-left corner, pixel centres at +0.5, right-handed
// world in dataset units. Readers convert once; nothing else knows another convention.
#ifndef RN_COMMON_MATH_CAMERA_H
#define RN_COMMON_MATH_CAMERA_H

#include <math.h>

#include "common/base/status.h"
#include "common/math/hd.h"
#include "common/math/lens.h"

// A plain value. Thread-safety: immutable once filled.
struct rn_camera {
    enum rn_lens lens;
    double lens_k[RN_LENS_PARAMETERS]; // as rn_lens_models names them, 0 where it has fewer
    double lens_fold;                  // rn_lens_fold of them; rn_camera_check fills it in
    int width, height;                 // pixels, 1 .. RN_CAMERA_MAX_SIZE
    double fx, fy;                     // focal lengths, pixels, 1 / RN_CAMERA_MAX_PX ..
    double cx, cy;                     // principal point, pixels from the top-left corner
    double world_from_camera[3][4];    // [R | t], R orthonormal, right-handed; |t_i| <=
                                       // RN_CAMERA_MAX_AWAY
};

#define RN_CAMERA_MAX_SIZE 16384
#define RN_CAMERA_MAX_PX 1e9 // of a focal length, and of the principal point on either side
// Of a coordinate of a camera's place: the Earth in micrometres. Beyond, their squares and sums end
// to be numbers long before the coordinates do, and nothing of a scene's detail is left of them.
#define RN_CAMERA_MAX_AWAY 1e12

// A cone through one pixel (paper, section 3.1). `direction` is unit. `radius` is the cone's
// cross-section radius per unit of distance along the ray.
struct rn_ray {
    double origin[3];
    double direction[3];
    double radius;
};

// A direction in camera axes, turned into the world's and made one long: the one text of it, for
// numbers and for vectors that hold a camera a lane. COLUMNS of the pose; ROOT: its square root.
#define RN_CAMERA_TURN_FUNCTION(NAME, TYPE, COLUMNS, ROOT)                                         \
    RN_HD void NAME(const TYPE pose[3][COLUMNS], TYPE x, TYPE y, TYPE z, TYPE ret[3]) {            \
        TYPE inverse_norm = 1.0 / ROOT(x * x + y * y + z * z);                                     \
        for (int i = 0; i < 3; i++)                                                                \
            ret[i] = (pose[i][0] * x + pose[i][1] * y + pose[i][2] * z) * inverse_norm;            \
    }
RN_CAMERA_TURN_FUNCTION(rn_camera_turn, double, 4, sqrt)

// Where a lens that is no pinhole's looks from the bent point (x, y): a direction in camera axes,
// of any length. Returns the area of directions that an area of bent points takes (rn_lens_look), 0
// beyond the lens's fold.
RN_HD double rn_camera_look(const struct rn_camera *camera, double x, double y, double ret[3]) {
    struct rn_lens_terms terms = rn_lens_terms(camera->lens, camera->lens_k);
    struct rn_bent bent;
    double q[2];
    if (!rn_lens_unbend(&terms, camera->lens_fold, x, y, q, &bent)) return 0;
    return rn_lens_look(&terms, q, ret) / (bent.xx * bent.yy - bent.xy * bent.yx);
}

// The radius of a pixel's cone where a lens does not change it, per unit of distance.
RN_HD double rn_camera_cone(const struct rn_camera *camera) {
    return 0.56418958354775628695 / sqrt(camera->fx * camera->fy); // 1/sqrt(pi)
}

// The widest of a picture's cones: at its corners and in between.
double rn_camera_widest_cone(const struct rn_camera *camera);

// The cone through pixel coordinates (px, py); (0.5, 0.5) is the first pixel's centre. Radius 0:
// the lens sees nothing there.
//
// The pixel's square [px-1/2, px+1/2] x [py-1/2, py+1/2] maps to the plane z = 1 with area
// 1/(fx fy); the released code's cone has the disc of that area, radius sqrt(1/(pi fx fy)), per
// unit of z, used with the Euclidean distance. A lens's cone follows the area at its own pixel: on
// that plane, or on the unit sphere where the lens goes by angles. Errors: a component of the
// direction 4 ULP of 1, the radius 4 ULP; of lenses as tests/numerics/lens.c has them.
RN_HD struct rn_ray rn_camera_ray(const struct rn_camera *camera, double px, double py) {
    struct rn_ray ray;
    double x = (px - camera->cx) / camera->fx, y = (py - camera->cy) / camera->fy;
    ray.radius = rn_camera_cone(camera);
    if (camera->lens == RN_LENS_PINHOLE) {
        rn_camera_turn(camera->world_from_camera, x, y, 1.0, ray.direction);
    } else {
        double look[3] = {0, 0, 1};
        ray.radius *= sqrt(rn_camera_look(camera, x, y, look));
        rn_camera_turn(camera->world_from_camera, look[0], look[1], look[2], ray.direction);
    }
    for (int i = 0; i < 3; i++)
        ray.origin[i] = camera->world_from_camera[i][3];
    return ray;
}

// Where the camera stands, and how far a point of the world is from there.
RN_HD void rn_camera_place(const struct rn_camera *camera, double ret[3]) {
    for (int i = 0; i < 3; i++)
        ret[i] = camera->world_from_camera[i][3];
}

RN_HD double rn_camera_distance(const struct rn_camera *camera, const double point[3]) {
    double squares = 0;
    for (int i = 0; i < 3; i++) {
        double d = camera->world_from_camera[i][3] - point[i];
        squares += d * d;
    }
    return sqrt(squares);
}

// A point of the world in camera axes.
RN_HD void rn_camera_axes(const struct rn_camera *camera, const double point[3], double ret[3]) {
    for (int i = 0; i < 3; i++) {
        ret[i] = 0;
        for (int j = 0; j < 3; j++)
            ret[i] +=
                camera->world_from_camera[j][i] * (point[j] - camera->world_from_camera[j][3]);
    }
}

// The pixel coordinates of a point in camera axes: the inverse of rn_camera_ray. False where the
// camera sees no such direction, behind it or beyond the lens's fold; it may lie off the picture.
RN_HD bool rn_camera_project(const struct rn_camera *camera, const double p[3], double ret[2]) {
    double x = p[0] / p[2], y = p[1] / p[2];
    if (camera->lens == RN_LENS_PINHOLE) {
        if (!(p[2] > 0)) return false;
    } else {
        struct rn_lens_terms terms = rn_lens_terms(camera->lens, camera->lens_k);
        double q[2];
        if (!rn_lens_flatten(&terms, camera->lens_fold, p, q)) return false;
        struct rn_bent bent = rn_lens_bend(&terms, q[0], q[1]);
        x = bent.x, y = bent.y;
    }
    ret[0] = x * camera->fx + camera->cx;
    ret[1] = y * camera->fy + camera->cy;
    return true;
}

// The camera without its lens: straight lines are straight.
RN_HD struct rn_camera rn_camera_without_lens(const struct rn_camera *camera) {
    struct rn_camera out = *camera;
    out.lens = RN_LENS_PINHOLE;
    for (int i = 0; i < RN_LENS_PARAMETERS; i++)
        out.lens_k[i] = 0;
    out.lens_fold = 0;
    return out;
}

// The camera of the same view at another image size: intrinsics scale with the image.
RN_HD struct rn_camera rn_camera_resized(const struct rn_camera *camera, int width, int height) {
    struct rn_camera out = *camera;
    double sx = (double)width / camera->width, sy = (double)height / camera->height;
    out.width = width;
    out.height = height;
    out.fx *= sx;
    out.cx *= sx;
    out.fy *= sy;
    out.cy *= sy;
    return out;
}

// The camera as a picture of another shape: the field of view from top to bottom and the shape of a
// pixel stay, the sides show more or less. rn_camera_resized where the shapes are the same.
struct rn_camera rn_camera_reframed(const struct rn_camera *camera, int width, int height);

// Fills in the lens's fold, and checks sizes, the lens's parameters, focal lengths, principal point
// and a rigid pose (|R^T R - 1| <= 1e-3 per entry, det > 0) within RN_CAMERA_MAX_AWAY. `where`
// prefixes the field in the error. RN_OK or RN_ERROR_INVALID.
enum rn_status rn_camera_check(struct rn_camera *camera, const char *where,
                               struct rn_error *err) RN_MUST_CHECK;

// Field of view along a side of an image, in radians, in (0, pi), and the focal length in pixels;
// each within 4 ULP.
double rn_camera_fov_from_focal(double focal_px, double size_px);
double rn_camera_focal_from_fov(double fov_rad, double size_px);
// The field of view along the other side, which is `ratio` times as long.
double rn_camera_fov_across(double fov_rad, double ratio);

// A camera at `eye` looking at `target`, `up` roughly up. RN_ERROR_INVALID when degenerate.
enum rn_status rn_camera_look_at(const double eye[3], const double target[3], const double up[3],
                                 double world_from_camera[3][4]) RN_MUST_CHECK;

#endif
