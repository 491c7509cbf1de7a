// A transforms.json as a path: its frames in the file's order, OpenGL axes, the dataset's own
// coordinates.
#include <math.h>
#include <string.h>

#include "common/path/formats/parts.h"

static bool recognise(const struct rn_path_text *in) {
    const json_t *frames = json_object_get(in->root, "frames");
    return json_is_array(frames) &&
           (json_object_get(json_array_get(frames, 0), "transform_matrix") != NULL ||
            (json_array_size(frames) == 0 && !json_object_get(in->root, "format")));
}

// A number of the frame, else of the whole file; false: neither has it.
static bool find_number(const struct rn_json *root, const struct rn_json *frame, const char *key,
                        double *ret) {
    struct rn_json member;
    if (!rn_json_find(frame, key, &member) && !rn_json_find(root, key, &member)) return false;
    *ret = json_number_value(member.value);
    return *ret > 0;
}

static enum rn_status find_fov(const struct rn_json *root, const struct rn_json *frame,
                               double fallback_deg, double *ret_fov_rad, struct rn_error *err) {
    double focal, height = 0, width = 0, angle;
    bool sized = find_number(root, frame, "h", &height) && find_number(root, frame, "w", &width);
    if (sized &&
        (find_number(root, frame, "fl_y", &focal) || find_number(root, frame, "fl_x", &focal)))
        *ret_fov_rad = rn_camera_fov_from_focal(focal, height);
    else if (find_number(root, frame, "camera_angle_y", &angle))
        *ret_fov_rad = angle;
    else if (find_number(root, frame, "camera_angle_x", &angle)) // square where no size is said
        *ret_fov_rad = rn_camera_fov_across(angle, sized ? height / width : 1);
    else if (fallback_deg > 0)
        *ret_fov_rad = fallback_deg * M_PI / 180;
    else
        return rn_json_error(frame, RN_ERROR_INVALID, err,
                             "has no field of view: neither fl_x with w and h, nor camera_angle_x");
    return RN_OK;
}

static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_json root = rn_json_root(in->root, in->where), frames, matrix;
    double size[2] = {0};
    enum rn_status status = rn_json_member(&root, "frames", &frames, err);
    if (!status) status = rn_path_make_keys(path, json_array_size(frames.value), &frames, err);
    path->fps = choices->fps > 0 ? choices->fps : 30;
    path->interpolation = RN_INTERPOLATE_LINEAR;
    for (size_t i = 0; i < path->key_count && !status; i++) {
        struct rn_json at = rn_json_element(&frames, i);
        struct rn_path_key *key = &path->keys[i];
        key->time_s = (double)i / path->fps;
        status = rn_path_json_pose(&at, "transform_matrix", key->world_from_camera, err);
        if (!status) status = rn_json_member(&at, "transform_matrix", &matrix, err);
        if (!status) status = rn_path_make_exact(&matrix, key->world_from_camera, err);
        if (!status) status = find_fov(&root, &at, choices->fov_y_deg, &key->fov_y_rad, err);
        rn_pose_from_opengl(key->world_from_camera);
        if (!status && i == 0 && find_number(&root, &at, "w", &size[0]) &&
            find_number(&root, &at, "h", &size[1]) && size[0] <= RN_CAMERA_MAX_SIZE &&
            size[1] <= RN_CAMERA_MAX_SIZE) {
            path->width = (int)size[0];
            path->height = (int)size[1];
        }
    }
    return status;
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    json_t *frames = json_array();
    size_t count = rn_path_frame_count(path);
    (void)ret_beside;
    for (size_t i = 0; i < count; i++) {
        char name[32];
        struct rn_camera camera = rn_path_camera(path, i);
        rn_path_out_of_dataset(space, camera.world_from_camera);
        rn_pose_from_opengl(camera.world_from_camera);
        snprintf(name, sizeof name, "frames/%05zu.png", i);
        json_array_append_new(frames, json_pack("{s:s,s:f,s:f,s:o}", "file_path", name, "fl_x",
                                                camera.fx, "fl_y", camera.fy, "transform_matrix",
                                                rn_path_json_rows(camera.world_from_camera, 4)));
    }
    return rn_path_dump(json_pack("{s:s,s:i,s:i,s:f,s:f,s:o}", "camera_model", "PINHOLE", "w",
                                  path->width, "h", path->height, "cx", 0.5 * path->width, "cy",
                                  0.5 * path->height, "frames", frames),
                        ret_text, err);
}

const struct rn_path_format rn_path_format_transforms = {
    .name = "transforms",
    .title = "transforms.json",
    .file = "transforms.json",
    .usual = {1, {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
    .recognise = recognise,
    .read = read,
    .write = write};
