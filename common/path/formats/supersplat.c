// SuperSplat's camera poses: position, target and field of view along the longer side, in a world
// that is turned by half a turn about z and has y upwards. Found as a list of poses, as {"poses"}
// and in the poseSets of a project's document.
#include <math.h>
#include <string.h>

#include "common/path/formats/parts.h"

static const json_t *poses_of(const json_t *root) {
    const json_t *set = json_array_get(json_object_get(root, "poseSets"), 0);
    const json_t *poses = json_is_array(root) ? root
                          : set               ? json_object_get(set, "poses")
                                              : json_object_get(root, "poses");
    return json_is_array(poses) ? poses : NULL;
}

static bool recognise(const struct rn_path_text *in) {
    const json_t *poses = poses_of(in->root);
    if (!poses) return false;
    return json_object_get(json_array_get(poses, 0), "target") != NULL ||
           (json_array_size(poses) == 0 && !json_is_array(in->root));
}

static double frame_rate(const json_t *root) {
    double rate =
        json_number_value(json_object_get(json_object_get(root, "timeline"), "frameRate"));
    return rate >= 1e-3 && rate <= 1000 ? rate : 30;
}

static enum rn_status read_pose(const struct rn_json *at, size_t index, double rate,
                                const struct rn_path_choices *choices, double ratio,
                                struct rn_path_key *key, struct rn_error *err) {
    static const double up[3] = {0, 1, 0};
    struct rn_json member;
    double position[3], target[3], frame = (double)index * rate,
                                   fov_deg = choices->fov_y_deg > 0 ? choices->fov_y_deg : 65;
    enum rn_status status = rn_json_matrix(at, "position", 0, 3, position, err);
    if (!status) status = rn_json_matrix(at, "target", 0, 3, target, err);
    if (!status && rn_json_find(at, "frame", &member))
        status = rn_json_number(at, "frame", 0, 1e7, &frame, err);
    bool own_fov = rn_json_find(at, "fov", &member);
    if (!status && own_fov) status = rn_json_number(at, "fov", 1e-3, 179.9, &fov_deg, err);
    for (int i = 0; i < 3 && !status; i++)
        key->world_from_camera[i][3] = position[i];
    if (!status) status = rn_path_look_at(at, target, up, key->world_from_camera, err);
    if (status) return status;
    key->time_s = frame / rate;
    key->fov_y_rad = rn_camera_fov_across(fov_deg * M_PI / 180, own_fov ? ratio : 1);
    return RN_OK;
}

static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_json root = rn_json_root(in->root, in->where), poses = root;
    double rate = frame_rate(in->root);
    poses.value = poses_of(in->root);
    enum rn_status status = rn_path_make_keys(path, json_array_size(poses.value), &poses, err);
    path->width = choices->width ? choices->width : 960;
    path->height = choices->height ? choices->height : 540;
    path->fps = choices->fps > 0 ? choices->fps : rate;
    path->interpolation = RN_INTERPOLATE_SPLINE;
    double ratio = fmin(1, (double)path->height / path->width);
    for (size_t i = 0; i < path->key_count && !status; i++) {
        struct rn_json at = rn_json_element(&poses, i);
        status = read_pose(&at, i, rate, choices, ratio, &path->keys[i], err);
    }
    return status;
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    json_t *poses = json_array();
    double ratio = fmax(1, (double)path->width / path->height);
    (void)ret_beside;
    for (size_t i = 0; i < path->key_count; i++) {
        const struct rn_path_key *key = &path->keys[i];
        char name[32];
        double pose[3][4], position[3], target[3];
        memcpy(pose, key->world_from_camera, sizeof pose);
        rn_path_out_of_dataset(space, pose);
        for (int c = 0; c < 3; c++) {
            position[c] = pose[c][3];
            target[c] = pose[c][3] + pose[c][2];
        }
        snprintf(name, sizeof name, "camera_%zu", i);
        json_array_append_new(
            poses, json_pack("{s:s,s:f,s:o,s:o,s:f}", "name", name, "frame",
                             round((key->time_s - path->keys[0].time_s) * path->fps), "position",
                             rn_path_json_three(position), "target", rn_path_json_three(target),
                             "fov", rn_camera_fov_across(key->fov_y_rad, ratio) * 180 / M_PI));
    }
    return rn_path_dump(json_pack("{s:{s:f,s:i},s:[{s:s,s:o}]}", "timeline", "frameRate", path->fps,
                                  "frames", (int)rn_path_frame_count(path), "poseSets", "name",
                                  "set0", "poses", poses),
                        ret_text, err);
}

const struct rn_path_format rn_path_format_supersplat = {
    .name = "supersplat",
    .title = "SuperSplat",
    .file = "supersplat.json",
    .usual = {1, {{-1, 0, 0, 0}, {0, -1, 0, 0}, {0, 0, 1, 0}}},
    .recognise = recognise,
    .read = read,
    .write = write};
