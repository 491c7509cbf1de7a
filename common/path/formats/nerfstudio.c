// nerfstudio's camera_path.json (viewer/render_panel.py writes, cameras/camera_paths.py reads):
// OpenGL axes, vertical fields of view in degrees, coordinates of one training.
#include <math.h>
#include <string.h>

#include "common/path/formats/parts.h"

static bool recognise(const struct rn_path_text *in) {
    return json_is_array(json_object_get(in->root, "camera_path")) ||
           (json_object_get(in->root, "camera_type") &&
            json_is_array(json_object_get(in->root, "keyframes")));
}

static enum rn_status read_camera(const struct rn_json *at, const char *matrix,
                                  struct rn_path_key *key, struct rn_error *err) {
    struct rn_json value;
    double fov_deg;
    enum rn_status status = rn_path_json_pose(at, matrix, key->world_from_camera, err);
    if (!status) status = rn_json_member(at, matrix, &value, err);
    if (!status) status = rn_path_make_exact(&value, key->world_from_camera, err);
    if (!status) status = rn_json_number(at, "fov", 1e-3, 179.9, &fov_deg, err);
    if (status) return status;
    rn_pose_from_opengl(key->world_from_camera);
    key->fov_y_rad = fov_deg * M_PI / 180;
    return RN_OK;
}

static enum rn_status read_motion(const struct rn_json *root, const struct rn_path_choices *choices,
                                  struct rn_path *path, struct rn_error *err) {
    struct rn_json member;
    enum rn_status status = RN_OK;
    path->fps = choices->fps > 0 ? choices->fps : 30;
    if (rn_json_find(root, "render_width", &member))
        status = rn_json_integer(root, "render_width", 1, RN_CAMERA_MAX_SIZE, &path->width, err);
    if (!status && rn_json_find(root, "render_height", &member))
        status = rn_json_integer(root, "render_height", 1, RN_CAMERA_MAX_SIZE, &path->height, err);
    if (!status && choices->fps <= 0 && rn_json_find(root, "fps", &member))
        status = rn_json_number(root, "fps", 1e-3, 1000, &path->fps, err);
    return status;
}

static enum rn_status refuse_other_cameras(const struct rn_json *root, struct rn_error *err) {
    struct rn_json type;
    const char *name = "perspective";
    if (rn_json_find(root, "camera_type", &type) && json_is_string(type.value))
        name = json_string_value(type.value);
    if (strcmp(name, "perspective") == 0) return RN_OK;
    return rn_json_error(&type, RN_ERROR_UNSUPPORTED, err,
                         "is '%.40s'; paths have perspective cameras", name);
}

// Every frame that the viewer wrote, as a key: what lies between needs no knowledge of its splines.
static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_json root = rn_json_root(in->root, in->where), frames;
    enum rn_status status = refuse_other_cameras(&root, err);
    if (!status) status = read_motion(&root, choices, path, err);
    if (!status) status = rn_json_member(&root, "camera_path", &frames, err);
    if (!status) status = rn_path_make_keys(path, json_array_size(frames.value), &frames, err);
    path->interpolation = RN_INTERPOLATE_LINEAR;
    for (size_t i = 0; i < path->key_count && !status; i++) {
        struct rn_json at = rn_json_element(&frames, i);
        path->keys[i].time_s = (double)i / path->fps;
        status = read_camera(&at, "camera_to_world", &path->keys[i], err);
    }
    return status;
}

static json_t *write_camera(const struct rn_path_space *space, const struct rn_camera *camera,
                            const char *matrix) {
    double pose[3][4];
    memcpy(pose, camera->world_from_camera, sizeof pose);
    rn_path_out_of_dataset(space, pose);
    rn_pose_from_opengl(pose); // its own inverse
    double fov_deg = rn_camera_fov_from_focal(camera->fy, camera->height) * 180 / M_PI;
    return json_pack("{s:o,s:f,s:f}", matrix, rn_path_json_flat(pose, 4), "fov", fov_deg, "aspect",
                     (double)camera->width / camera->height);
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    json_t *frames = json_array(), *keys = json_array();
    size_t count = rn_path_frame_count(path);
    (void)ret_beside;
    for (size_t i = 0; i < count; i++) {
        struct rn_camera camera = rn_path_camera(path, i);
        json_array_append_new(frames, write_camera(space, &camera, "camera_to_world"));
    }
    for (size_t i = 0; i < path->key_count; i++) {
        struct rn_camera camera = rn_path_key_camera(path, i);
        json_array_append_new(keys, write_camera(space, &camera, "matrix"));
    }
    return rn_path_dump(
        json_pack("{s:s,s:i,s:i,s:f,s:f,s:b,s:f,s:o,s:o}", "camera_type", "perspective",
                  "render_width", path->width, "render_height", path->height, "fps", path->fps,
                  "seconds", (double)count / path->fps, "is_cycle", (int)path->loop,
                  "smoothness_value", 0.5, "keyframes", keys, "camera_path", frames),
        ret_text, err);
}

const struct rn_path_format rn_path_format_nerfstudio = {
    .name = "nerfstudio",
    .title = "nerfstudio",
    .file = "camera_path.json",
    .needs_space = true,
    .usual = {1, {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
    .recognise = recognise,
    .read = read,
    .write = write};
