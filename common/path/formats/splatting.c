// The cameras.json that 3D Gaussian splatting writes beside its model: camera-to-world rotations in
// OpenCV axes, positions, focal lengths in pixels; in the dataset's own coordinates.
#include <math.h>
#include <string.h>

#include "common/path/formats/parts.h"

static bool recognise(const struct rn_path_text *in) {
    const json_t *first = json_array_get(in->root, 0);
    return json_is_array(in->root) && json_object_get(first, "rotation") &&
           json_object_get(first, "position");
}

static enum rn_status read_camera(const struct rn_json *at, struct rn_path *path, size_t i,
                                  struct rn_error *err) {
    struct rn_path_key *key = &path->keys[i];
    struct rn_json member;
    double rotation[9], position[3], focal;
    int width, height;
    enum rn_status status = rn_json_matrix(at, "rotation", 3, 3, rotation, err);
    if (!status) status = rn_json_matrix(at, "position", 0, 3, position, err);
    if (!status) status = rn_json_number(at, "fy", 1e-6, 1e9, &focal, err);
    if (!status) status = rn_json_integer(at, "width", 1, RN_CAMERA_MAX_SIZE, &width, err);
    if (!status) status = rn_json_integer(at, "height", 1, RN_CAMERA_MAX_SIZE, &height, err);
    if (!status) status = rn_json_member(at, "rotation", &member, err);
    if (status) return status;
    for (int r = 0; r < 3; r++) {
        memcpy(key->world_from_camera[r], rotation + 3 * r, 3 * sizeof *rotation);
        key->world_from_camera[r][3] = position[r];
    }
    key->time_s = (double)i / path->fps;
    key->fov_y_rad = rn_camera_fov_from_focal(focal, (double)height);
    if (i == 0) {
        path->width = width;
        path->height = height;
    }
    return rn_path_make_exact(&member, key->world_from_camera, err);
}

static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_json root = rn_json_root(in->root, in->where);
    enum rn_status status = rn_path_make_keys(path, json_array_size(root.value), &root, err);
    path->fps = choices->fps > 0 ? choices->fps : 30;
    path->interpolation = RN_INTERPOLATE_LINEAR;
    for (size_t i = 0; i < path->key_count && !status; i++) {
        struct rn_json at = rn_json_element(&root, i);
        status = read_camera(&at, path, i, err);
    }
    return status;
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    json_t *cameras = json_array();
    size_t count = rn_path_frame_count(path);
    (void)ret_beside;
    for (size_t i = 0; i < count; i++) {
        char name[32];
        struct rn_camera camera = rn_path_camera(path, i);
        double(*pose)[4] = camera.world_from_camera;
        rn_path_out_of_dataset(space, pose);
        snprintf(name, sizeof name, "%05zu", i);
        json_t *rotation = json_array();
        for (int r = 0; r < 3; r++)
            json_array_append_new(rotation, rn_path_json_three(pose[r]));
        json_array_append_new(cameras, json_pack("{s:i,s:s,s:i,s:i,s:[f,f,f],s:o,s:f,s:f}", "id",
                                                 (int)i, "img_name", name, "width", camera.width,
                                                 "height", camera.height, "position", pose[0][3],
                                                 pose[1][3], pose[2][3], "rotation", rotation, "fy",
                                                 camera.fy, "fx", camera.fx));
    }
    return rn_path_dump(cameras, ret_text, err);
}

const struct rn_path_format rn_path_format_splatting = {
    .name = "3dgs",
    .title = "3D Gaussian splatting",
    .file = "cameras.json",
    .usual = {1, {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
    .recognise = recognise,
    .read = read,
    .write = write};
