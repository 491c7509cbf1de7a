#include "common/dataset/json.h"

const char *const rn_axes_names[2] = {"opencv", "opengl"};

void rn_pose_from_opengl(double world_from_camera[3][4]) {
    for (int i = 0; i < 3; i++) {
        world_from_camera[i][1] = -world_from_camera[i][1];
        world_from_camera[i][2] = -world_from_camera[i][2];
    }
}

static enum rn_status get_intrinsics(const struct rn_json *object, struct rn_camera *camera,
                                     struct rn_error *err) {
    enum rn_status status;
    struct rn_json fov, other;
    const double huge = 1e9;
    if (!rn_json_find(object, "fov_y_deg", &fov)) {
        if ((status = rn_json_number(object, "fx", 1e-9, huge, &camera->fx, err)) ||
            (status = rn_json_number(object, "fy", 1e-9, huge, &camera->fy, err)) ||
            (status = rn_json_number(object, "cx", -huge, huge, &camera->cx, err)))
            return status;
        return rn_json_number(object, "cy", -huge, huge, &camera->cy, err);
    }
    if (camera->lens != RN_LENS_PINHOLE)
        return rn_json_error(&fov, RN_ERROR_INVALID, err,
                             "goes with a pinhole; a %s camera is given by fx, fy, cx, cy",
                             rn_lens_names[camera->lens]);
    static const char *const keys[] = {"fx", "fy", "cx", "cy"};
    for (size_t i = 0; i < 4; i++)
        if (rn_json_find(object, keys[i], &other))
            return rn_json_error(&other, RN_ERROR_INVALID, err,
                                 "stands beside fov_y_deg; give only one of the two");
    double fov_y_deg;
    if ((status = rn_json_number(object, "fov_y_deg", 1e-3, 179.9, &fov_y_deg, err))) return status;
    camera->fx = camera->fy = rn_camera_focal_from_fov(fov_y_deg * M_PI / 180, camera->height);
    camera->cx = 0.5 * camera->width;
    camera->cy = 0.5 * camera->height;
    return RN_OK;
}

// {"model": a lens, and of its parameters by name those that are not 0}.
static enum rn_status get_lens(const struct rn_json *object, struct rn_camera *camera,
                               struct rn_error *err) {
    struct rn_json lens, parameter;
    const char *known[RN_LENS_PARAMETERS + 2] = {"model"};
    int index;
    enum rn_status status;
    if (!rn_json_find(object, "lens", &lens)) return RN_OK;
    if ((status = rn_json_choice(&lens, "model", rn_lens_names, RN_LENS_COUNT, &index, err)))
        return status;
    const struct rn_lens_model *model = &rn_lens_models[index];
    camera->lens = (enum rn_lens)index;
    for (int i = 0; i < model->count && status == RN_OK; i++) {
        const char *name = known[i + 1] = model->parameters[i];
        if (rn_json_find(&lens, name, &parameter))
            status =
                rn_json_number(&lens, name, -model->most, model->most, &camera->lens_k[i], err);
    }
    return status ? status : rn_json_refuse_unknown(&lens, known, err);
}

enum rn_status rn_json_camera(const struct rn_json *object, struct rn_camera *ret_camera,
                              struct rn_error *err) {
    static const char *const known[] = {"world_from_camera",
                                        "axes",
                                        "width",
                                        "height",
                                        "fov_y_deg",
                                        "fx",
                                        "fy",
                                        "cx",
                                        "cy",
                                        "lens",
                                        NULL};
    struct rn_camera camera = {.lens = RN_LENS_PINHOLE};
    int opengl;
    enum rn_status status;
    if ((status = rn_json_refuse_unknown(object, known, err)) ||
        (status = rn_json_matrix(object, "world_from_camera", 3, 4, &camera.world_from_camera[0][0],
                                 err)) ||
        (status = rn_json_choice(object, "axes", rn_axes_names, 2, &opengl, err)) ||
        (status = rn_json_integer(object, "width", 1, RN_CAMERA_MAX_SIZE, &camera.width, err)) ||
        (status = rn_json_integer(object, "height", 1, RN_CAMERA_MAX_SIZE, &camera.height, err)) ||
        (status = get_lens(object, &camera, err)) ||
        (status = get_intrinsics(object, &camera, err)))
        return status;
    if (opengl) rn_pose_from_opengl(camera.world_from_camera);
    struct rn_json pose;
    struct rn_error inner;
    if ((status = rn_json_member(object, "world_from_camera", &pose, err))) return status;
    if ((status = rn_camera_check(&camera, "", &inner)))
        return rn_json_error(&pose, status, err, "%s", inner.text);
    *ret_camera = camera;
    return RN_OK;
}

static json_t *json_from_lens(const struct rn_camera *camera) {
    const struct rn_lens_model *model = &rn_lens_models[camera->lens];
    json_t *lens = json_pack("{s:s}", "model", rn_lens_names[camera->lens]);
    for (int i = 0; lens && i < model->count; i++)
        if (json_object_set_new(lens, model->parameters[i], json_real(camera->lens_k[i]))) {
            json_decref(lens);
            lens = NULL;
        }
    return lens;
}

json_t *rn_json_from_camera(const struct rn_camera *camera) {
    const double(*m)[4] = camera->world_from_camera;
    json_t *lens = camera->lens ? json_from_lens(camera) : NULL;
    if (camera->lens && !lens) return NULL;
    return json_pack("{s:[[ffff][ffff][ffff]] s:s s:i s:i s:f s:f s:f s:f s:o*}",
                     "world_from_camera", m[0][0], m[0][1], m[0][2], m[0][3], m[1][0], m[1][1],
                     m[1][2], m[1][3], m[2][0], m[2][1], m[2][2], m[2][3], "axes", rn_axes_names[0],
                     "width", camera->width, "height", camera->height, "fx", camera->fx, "fy",
                     camera->fy, "cx", camera->cx, "cy", camera->cy, "lens", lens);
}
