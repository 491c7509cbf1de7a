// instant-ngp's base_cam.json (src/camera_path.cu): quaternions x, y, z, w and positions in its own
// space, where the dataset is scaled by 0.33, moved by 0.5 and its axes turned y, z, x.
#include <math.h>
#include <string.h>

#include "common/math/rotation.h"
#include "common/path/formats/parts.h"

#define SCALE 0.33
#define OFFSET (0.5 / SCALE)

static bool recognise(const struct rn_path_text *in) {
    const json_t *path = json_object_get(in->root, "path");
    return json_is_array(path) &&
           (json_array_size(path) == 0 || (json_object_get(json_array_get(path, 0), "R") != NULL &&
                                           json_object_get(json_array_get(path, 0), "T") != NULL));
}

static enum rn_status read_key(const struct rn_json *at, double seconds, double index,
                               struct rn_path_key *key, struct rn_error *err) {
    double q[4], t[3], fov_deg, time = index;
    struct rn_json rotation, member;
    enum rn_status status = rn_json_matrix(at, "R", 0, 4, q, err);
    if (!status) status = rn_json_matrix(at, "T", 0, 3, t, err);
    if (!status) status = rn_json_number(at, "fov", 1e-3, 179.9, &fov_deg, err);
    if (!status) status = rn_json_member(at, "R", &rotation, err);
    if (!status &&
        !rn_rotation_from_quaternion((double[]){q[3], q[0], q[1], q[2]}, key->world_from_camera))
        status = rn_json_error(&rotation, RN_ERROR_INVALID, err,
                               "is a quaternion of length 0: no rotation");
    if (!status && rn_json_find(at, "timestamp", &member))
        status = rn_json_number(at, "timestamp", 0, 86400, &time, err);
    if (status) return status;
    for (int i = 0; i < 3; i++)
        key->world_from_camera[i][3] = t[i];
    key->time_s = time * seconds;
    key->fov_y_rad = fov_deg * M_PI / 180;
    return RN_OK;
}

// Seconds that a unit of the keys' times lasts: 1 for each key where they have none.
static enum rn_status seconds_of(const struct rn_json *root, const struct rn_path_choices *choices,
                                 const struct rn_json *keys, double *ret_seconds,
                                 struct rn_error *err) {
    struct rn_json member, last = rn_json_element(keys, json_array_size(keys->value) - 1);
    *ret_seconds = choices->seconds > 0 ? choices->seconds : 1;
    bool timed = json_object_get(last.value, "timestamp") != NULL;
    if (!timed || !rn_json_find(root, "duration_seconds", &member)) return RN_OK;
    double end = json_number_value(json_object_get(last.value, "timestamp"));
    enum rn_status status = rn_json_number(root, "duration_seconds", 1e-3, 86400, ret_seconds, err);
    if (!status && end > 0) *ret_seconds /= end;
    return status;
}

static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_json root = rn_json_root(in->root, in->where), keys, member;
    double seconds = 1;
    enum rn_status status = rn_json_member(&root, "path", &keys, err);
    if (!status) status = rn_path_make_keys(path, json_array_size(keys.value), &keys, err);
    if (!status) status = seconds_of(&root, choices, &keys, &seconds, err);
    if (!status && rn_json_find(&root, "loop", &member))
        status = rn_json_boolean(&root, "loop", &path->loop, err);
    path->fps = choices->fps;
    path->interpolation = RN_INTERPOLATE_SPLINE;
    for (size_t i = 0; i < path->key_count && !status; i++) {
        struct rn_json at = rn_json_element(&keys, i);
        status = read_key(&at, seconds, (double)i, &path->keys[i], err);
    }
    return status;
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    json_t *keys = json_array();
    double begin = path->keys[0].time_s, span = path->keys[path->key_count - 1].time_s - begin;
    (void)ret_beside;
    for (size_t i = 0; i < path->key_count; i++) {
        const struct rn_path_key *key = &path->keys[i];
        double pose[3][4], q[4];
        memcpy(pose, key->world_from_camera, sizeof pose);
        rn_path_out_of_dataset(space, pose);
        rn_rotation_to_quaternion((const double(*)[4])pose, q);
        json_array_append_new(
            keys, json_pack("{s:[f,f,f,f],s:[f,f,f],s:f,s:f,s:f,s:f,s:f}", "R", q[1], q[2], q[3],
                            q[0], "T", pose[0][3], pose[1][3], pose[2][3], "slice", 0.0, "scale",
                            1.5, "fov", key->fov_y_rad * 180 / M_PI, "aperture_size", 0.0,
                            "timestamp", span > 0 ? (key->time_s - begin) / span : 0));
    }
    return rn_path_dump(json_pack("{s:b,s:f,s:f,s:i,s:o}", "loop", (int)path->loop, "time", 0.0,
                                  "duration_seconds", span > 0 ? span : 1.0, "spline_order", 3,
                                  "path", keys),
                        ret_text, err);
}

const struct rn_path_format rn_path_format_ngp = {
    .name = "instant-ngp",
    .title = "instant-ngp",
    .file = "base_cam.json",
    .usual = {SCALE, {{0, 1, 0, OFFSET}, {0, 0, 1, OFFSET}, {1, 0, 0, OFFSET}}},
    .recognise = recognise,
    .read = read,
    .write = write};
