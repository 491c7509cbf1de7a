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
    int width, height;                 // pixels, 1 .. RN_CAMERA_MAX_SIZE
    double fx, fy;                     // focal lengths, pixels, > 0
    double cx, cy;                     // principal point, pixels from the top-left corner
    double world_from_camera[3][4];    // [R | t], R orthonormal, right-handed
};

#define RN_CAMERA_MAX_SIZE 16384

// A cone through one pixel (paper, section 3.1). `direction` is unit. `radius` is the cone's
// cross-section radius per unit of distance along the ray.
struct rn_ray {
    double origin[3];
    double direction[3];
    double radius;
};

// The cone through pixel coordinates (px, py); (0.5, 0.5) is the first pixel's centre.
//
// The pixel's square [px-1/2, px+1/2] x [py-1/2, py+1/2] maps to the plane z = 1 with area
// 1/(fx fy); the released code's cone has the disc of that area, radius sqrt(1/(pi fx fy)), per
// unit of z, used with the Euclidean distance. Errors: a component of the direction 4 ULP of 1,
// the radius 4 ULP.
RN_HD struct rn_ray rn_camera_ray(const struct rn_camera *camera, double px, double py) {
    struct rn_ray ray;
    double x = (px - camera->cx) / camera->fx, y = (py - camera->cy) / camera->fy;
    double inv_norm = 1.0 / sqrt(x * x + y * y + 1.0);
    for (int i = 0; i < 3; i++) {
        const double *row = camera->world_from_camera[i];
        ray.origin[i] = row[3];
        ray.direction[i] = (row[0] * x + row[1] * y + row[2]) * inv_norm;
    }
    ray.radius = 0.56418958354775628695 / sqrt(camera->fx * camera->fy); // 1/sqrt(pi)
    return ray;
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

// Checks sizes, finite values, positive focals and a rigid pose (|R^T R - 1| <= 1e-3 per entry,
// det > 0). `where` prefixes the field in the error. RN_OK or RN_ERROR_INVALID.
enum rn_status rn_camera_check(const struct rn_camera *camera, const char *where,
                               struct rn_error *err) RN_MUST_CHECK;

// Vertical field of view in radians, in (0, pi), and the square-pixel focal length it gives; each
// within 4 ULP.
double rn_camera_fov_y(const struct rn_camera *camera);
double rn_camera_focal_from_fov(double fov_rad, int size_px);

// A camera at `eye` looking at `target`, `up` roughly up. RN_ERROR_INVALID when degenerate.
enum rn_status rn_camera_look_at(const double eye[3], const double target[3], const double up[3],
                                 double world_from_camera[3][4]) RN_MUST_CHECK;

#endif
