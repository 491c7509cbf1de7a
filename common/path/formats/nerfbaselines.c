// nerfbaselines' trajectories, "nerfbaselines-v1": camera-to-world in OpenCV axes, intrinsics in
// pixels of image_size, a camera for every frame.
#include <math.h>
#include <string.h>

#include "common/path/formats/parts.h"

static bool recognise(const struct rn_path_text *in) {
    const char *format = json_string_value(json_object_get(in->root, "format"));
    return format && strncmp(format, "nerfbaselines", 13) == 0;
}

static enum rn_status read_frame(const struct rn_json *at, int height, struct rn_path_key *key,
                                 struct rn_error *err) {
    struct rn_json pose;
    double intrinsics[4];
    enum rn_status status = rn_path_json_pose(at, "pose", key->world_from_camera, err);
    if (!status) status = rn_json_member(at, "pose", &pose, err);
    if (!status) status = rn_path_make_exact(&pose, key->world_from_camera, err);
    if (!status) status = rn_json_matrix(at, "intrinsics", 0, 4, intrinsics, err);
    if (!status && !(intrinsics[1] > 0))
        status = rn_json_error(at, RN_ERROR_INVALID, err, "has a focal length of 0 or less");
    if (!status) key->fov_y_rad = rn_camera_fov_from_focal(intrinsics[1], height);
    return status;
}

static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_json root = rn_json_root(in->root, in->where), frames, member;
    double size[2] = {0};
    enum rn_status status = rn_json_matrix(&root, "image_size", 0, 2, size, err);
    if (!status && !(size[0] >= 1 && size[1] >= 1 && size[0] <= RN_CAMERA_MAX_SIZE &&
                     size[1] <= RN_CAMERA_MAX_SIZE))
        status = rn_json_error(&root, RN_ERROR_INVALID, err, "has no sensible image_size");
    if (status) return status;
    path->width = (int)size[0];
    path->height = (int)size[1];
    path->fps = choices->fps > 0 ? choices->fps : 30;
    path->interpolation = RN_INTERPOLATE_LINEAR;
    if (choices->fps <= 0 && rn_json_find(&root, "fps", &member))
        status = rn_json_number(&root, "fps", 1e-3, 1000, &path->fps, err);
    if (!status) status = rn_json_member(&root, "frames", &frames, err);
    if (!status) status = rn_path_make_keys(path, json_array_size(frames.value), &frames, err);
    for (size_t i = 0; i < path->key_count && !status; i++) {
        struct rn_json at = rn_json_element(&frames, i);
        path->keys[i].time_s = (double)i / path->fps;
        status = read_frame(&at, path->height, &path->keys[i], err);
    }
    return status;
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    json_t *frames = json_array();
    size_t count = rn_path_frame_count(path);
    (void)ret_beside;
    for (size_t i = 0; i < count; i++) {
        struct rn_camera camera = rn_path_camera(path, i);
        rn_path_out_of_dataset(space, camera.world_from_camera);
        json_array_append_new(frames, json_pack("{s:o,s:[f,f,f,f],s:[]}", "pose",
                                                rn_path_json_flat(camera.world_from_camera, 3),
                                                "intrinsics", camera.fx, camera.fy, camera.cx,
                                                camera.cy, "appearance_weights"));
    }
    return rn_path_dump(json_pack("{s:s,s:s,s:[i,i],s:f,s:o}", "format", "nerfbaselines-v1",
                                  "camera_model", "pinhole", "image_size", path->width,
                                  path->height, "fps", path->fps, "frames", frames),
                        ret_text, err);
}

const struct rn_path_format rn_path_format_nerfbaselines = {
    .name = "nerfbaselines",
    .title = "nerfbaselines",
    .file = "trajectory.json",
    .usual = {1, {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
    .recognise = recognise,
    .read = read,
    .write = write};
