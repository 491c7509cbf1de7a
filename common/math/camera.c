#include "common/math/camera.h"

#include <stdio.h>

#include "common/math/rotation.h"

#define MAX_POSE_ERROR 1e-3

struct rn_camera rn_camera_reframed(const struct rn_camera *camera, int width, int height) {
    struct rn_camera out = *camera;
    double s = (double)height / camera->height;
    out.width = width;
    out.height = height;
    out.fx *= s;
    out.fy *= s;
    out.cx = 0.5 * width + s * (camera->cx - 0.5 * camera->width);
    out.cy *= s;
    return out;
}

double rn_camera_widest_cone(const struct rn_camera *camera) {
    enum { GRID = 16 };
    double widest = rn_camera_cone(camera);
    for (int i = 0; camera->lens && i < (GRID + 1) * (GRID + 1); i++) {
        double x = i % (GRID + 1) * (camera->width / (double)GRID);
        double y = i / (GRID + 1) * (camera->height / (double)GRID);
        widest = fmax(widest, rn_camera_ray(camera, x, y).radius);
    }
    return widest;
}

static enum rn_status bad(const char *where, const char *field, const char *text,
                          struct rn_error *err) {
    char path[256];
    bool prefixed = where && where[0];
    snprintf(path, sizeof path, "%s%s%s", prefixed ? where : "", prefixed ? "/" : "", field);
    return rn_error_set(err, RN_ERROR_INVALID, path, "%s", text);
}

static enum rn_status check_pose(const struct rn_camera *camera, const char *where,
                                 struct rn_error *err) {
    const double(*pose)[4] = camera->world_from_camera;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++)
            if (!isfinite(pose[i][j]))
                return bad(where, "world_from_camera", "the pose has a non-finite number", err);
    for (int i = 0; i < 3; i++)
        if (!(fabs(pose[i][3]) <= RN_CAMERA_MAX_AWAY))
            return bad(where, "world_from_camera",
                       "the camera's place is beyond 1e12: correct the pose, or take all poses' "
                       "common distance from the origin off them",
                       err);
    if (!(rn_rotation_skew(pose) <= MAX_POSE_ERROR))
        return bad(where, "world_from_camera",
                   "the pose's 3x3 part is not a rotation (its columns are not orthonormal to "
                   "1e-3): remove scale and shear",
                   err);
    if (!(rn_rotation_determinant(pose) > 0))
        return bad(where, "world_from_camera",
                   "the pose is mirrored (negative determinant): flip one axis", err);
    return RN_OK;
}

static enum rn_status check_lens(const struct rn_camera *camera, const char *where,
                                 struct rn_error *err) {
    if ((int)camera->lens < 0 || camera->lens >= RN_LENS_COUNT)
        return bad(where, "lens", "no such lens", err);
    const struct rn_lens_model *model = &rn_lens_models[camera->lens];
    for (int i = 0; i < RN_LENS_PARAMETERS; i++) {
        if (i < model->count && fabs(camera->lens_k[i]) <= model->most) continue;
        if (i >= model->count && camera->lens_k[i] == 0) continue;
        char field[32] = "lens";
        if (i < model->count) snprintf(field, sizeof field, "lens/%s", model->parameters[i]);
        return bad(where, field,
                   i < model->count ? "the parameter is not finite or out of range"
                                    : "the lens has fewer parameters",
                   err);
    }
    return RN_OK;
}

static bool is_focal(double pixels) {
    return pixels >= 1 / RN_CAMERA_MAX_PX && pixels <= RN_CAMERA_MAX_PX;
}

enum rn_status rn_camera_check(struct rn_camera *camera, const char *where, struct rn_error *err) {
    if (camera->width < 1 || camera->width > RN_CAMERA_MAX_SIZE)
        return bad(where, "width", "the image width must be 1 to 16384 pixels", err);
    if (camera->height < 1 || camera->height > RN_CAMERA_MAX_SIZE)
        return bad(where, "height", "the image height must be 1 to 16384 pixels", err);
    if (!is_focal(camera->fx))
        return bad(where, "fx", "the focal length must be 1e-9 to 1e9 pixels", err);
    if (!is_focal(camera->fy))
        return bad(where, "fy", "the focal length must be 1e-9 to 1e9 pixels", err);
    if (!(fabs(camera->cx) <= RN_CAMERA_MAX_PX))
        return bad(where, "cx", "the principal point must be within 1e9 pixels", err);
    if (!(fabs(camera->cy) <= RN_CAMERA_MAX_PX))
        return bad(where, "cy", "the principal point must be within 1e9 pixels", err);
    enum rn_status status = check_lens(camera, where, err);
    camera->lens_fold = status || !camera->lens ? 0 : rn_lens_fold(camera->lens, camera->lens_k);
    return status ? status : check_pose(camera, where, err);
}

double rn_camera_fov_from_focal(double focal_px, double size_px) {
    return 2 * atan(size_px / (2 * focal_px));
}

double rn_camera_focal_from_fov(double fov_rad, double size_px) {
    return size_px / (2 * tan(fov_rad / 2));
}

double rn_camera_fov_across(double fov_rad, double ratio) {
    return 2 * atan(tan(0.5 * fov_rad) * ratio);
}

// a b - c d with one rounding error of each product cancelled (Kahan).
static double difference_of_products(double a, double b, double c, double d) {
    double cd = c * d;
    return fma(a, b, -cd) - fma(c, d, -cd);
}

static void cross(const double a[3], const double b[3], double ret[3]) {
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        ret[i] = difference_of_products(a[j], b[k], a[k], b[j]);
    }
}

// Scales v to unit length and returns its former length, 0 when v is zero or not finite.
static double normalise(double v[3]) {
    double largest = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
    if (!(largest > 0)) return 0;
    for (int i = 0; i < 3; i++)
        v[i] /= largest;
    double norm = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!isfinite(norm)) return 0;
    for (int i = 0; i < 3; i++)
        v[i] /= norm;
    return norm * largest;
}

enum rn_status rn_camera_look_at(const double eye[3], const double target[3], const double up[3],
                                 double world_from_camera[3][4]) {
    double forward[3], right[3], down[3], unit_up[3] = {up[0], up[1], up[2]};
    for (int i = 0; i < 3; i++)
        forward[i] = target[i] - eye[i];
    if (normalise(forward) == 0 || normalise(unit_up) == 0) return RN_ERROR_INVALID;
    cross(forward, unit_up, right);
    if (!(normalise(right) > 1e-9)) return RN_ERROR_INVALID;
    cross(forward, right, down);
    for (int i = 0; i < 3; i++) {
        world_from_camera[i][0] = right[i];
        world_from_camera[i][1] = down[i];
        world_from_camera[i][2] = forward[i];
        world_from_camera[i][3] = eye[i];
    }
    return RN_OK;
}
