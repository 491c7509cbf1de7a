#include "common/path/path.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/dataset/json.h"
#include "common/path/motion.h"

#define MAX_TIME_S 86400.0
#define MAX_FPS 1000.0
#define DEFAULT_FPS 30.0

static const char *const interpolations[] = {"spline", "linear", "circle"};
static const char *const lenses[] = {"pinhole", "equirectangular"};

// What a key says of effects of the camera; the others are none.
static enum rn_status read_optics(const struct rn_json *object, struct rn_optics *optics,
                                  struct rn_error *err) {
    struct rn_error inner = {0};
    enum rn_status status = RN_OK;
    for (size_t i = 0; i < RN_OPTICS_SETTINGS && !status; i++) {
        const struct rn_setting *row = &rn_optics_settings.rows[i];
        struct rn_json member;
        double value, low = row->flags & RN_SETTING_OR_ZERO ? 0 : row->min;
        if (!rn_json_find(object, row->name, &member)) continue;
        status = rn_json_number(object, row->name, low, row->max, &value, err);
        if (!status) rn_setting_put_number(row, value, optics);
    }
    if (!status && (status = rn_optics_check(optics, &inner)))
        return rn_json_error(object, status, err, "%s %s", inner.where, inner.text);
    return status;
}

static void put_optics(json_t *object, const struct rn_optics *optics) {
    for (size_t i = 0; object && i < RN_OPTICS_SETTINGS; i++) {
        double value = rn_setting_number(&rn_optics_settings.rows[i], optics);
        if (value != 0)
            json_object_set_new(object, rn_optics_settings.rows[i].name, json_real(value));
    }
}

static enum rn_status refuse_unknown_of_key(const struct rn_json *object, struct rn_error *err) {
    enum { OWN = 3 };
    const char *known[OWN + RN_OPTICS_SETTINGS + 1] = {"time", "world_from_camera", "fov_y_deg"};
    for (size_t i = 0; i < RN_OPTICS_SETTINGS; i++)
        known[OWN + i] = rn_optics_settings.rows[i].name;
    return rn_json_refuse_unknown(object, known, err);
}

static enum rn_status read_key(const struct rn_json *object, bool opengl,
                               struct rn_path_key *ret_key, struct rn_error *err) {
    struct rn_camera camera = {.width = 1, .height = 1, .fx = 1, .fy = 1};
    struct rn_json pose;
    double fov_y_deg, time_s;
    enum rn_status status;
    if ((status = refuse_unknown_of_key(object, err)) ||
        (status = read_optics(object, &ret_key->optics, err)) ||
        (status = rn_json_number(object, "time", 0, MAX_TIME_S, &time_s, err)) ||
        (status = rn_json_number(object, "fov_y_deg", 1e-3, 179.9, &fov_y_deg, err)) ||
        (status = rn_json_matrix(object, "world_from_camera", 3, 4, &camera.world_from_camera[0][0],
                                 err)) ||
        (status = rn_json_member(object, "world_from_camera", &pose, err)))
        return status;
    if (opengl) rn_pose_from_opengl(camera.world_from_camera);
    struct rn_error inner;
    if ((status = rn_camera_check(&camera, "", &inner)))
        return rn_json_error(&pose, status, err, "%s", inner.text);
    ret_key->time_s = time_s;
    ret_key->fov_y_rad = fov_y_deg * M_PI / 180;
    for (int i = 0; i < 12; i++)
        ret_key->world_from_camera[i / 4][i % 4] = camera.world_from_camera[i / 4][i % 4];
    return RN_OK;
}

static enum rn_status read_keys(const struct rn_json *object, struct rn_path *path,
                                struct rn_error *err) {
    struct rn_json keys;
    int opengl;
    enum rn_status status;
    if ((status = rn_json_choice(object, "axes", rn_axes_names, 2, &opengl, err)) ||
        (status = rn_json_array(object, "keys", 1, RN_PATH_MAX_KEYS, &keys, err)))
        return status;
    size_t count = json_array_size(keys.value);
    path->keys = calloc(count, sizeof *path->keys);
    if (!path->keys) return rn_json_error(&keys, RN_ERROR_NO_MEMORY, err, "out of memory");
    path->key_count = count;
    for (size_t i = 0; i < count; i++) {
        struct rn_json at = rn_json_element(&keys, i), time;
        if ((status = read_key(&at, opengl, &path->keys[i], err)) ||
            (status = rn_json_member(&at, "time", &time, err)))
            return status;
        if (i && path->keys[i].time_s <= path->keys[i - 1].time_s)
            return rn_json_error(&time, RN_ERROR_INVALID, err,
                                 "is not later than the key before it (%g s)",
                                 path->keys[i - 1].time_s);
    }
    return RN_OK;
}

// Duration in frames, before anything is rounded.
static double span_frames(const struct rn_path *path) {
    double span_s = path->keys[path->key_count - 1].time_s - path->keys[0].time_s;
    if (path->loop && path->key_count > 1) span_s += span_s / (double)(path->key_count - 1);
    return span_s * path->fps;
}

// What has a default and is absent keeps it.
static enum rn_status read_motion(const struct rn_json *object, struct rn_path *path,
                                  struct rn_error *err) {
    int interpolation = RN_INTERPOLATE_SPLINE, lens = 0;
    struct rn_json member;
    enum rn_status status = RN_OK;
    path->fps = DEFAULT_FPS;
    path->loop = false;
    if (rn_json_find(object, "fps", &member))
        status = rn_json_number(object, "fps", 1e-3, MAX_FPS, &path->fps, err);
    if (!status && rn_json_find(object, "interpolation", &member))
        status = rn_json_choice(object, "interpolation", interpolations, 3, &interpolation, err);
    if (!status && rn_json_find(object, "loop", &member))
        status = rn_json_boolean(object, "loop", &path->loop, err);
    if (!status && rn_json_find(object, "tension", &member))
        status = rn_json_number(object, "tension", 0, 1, &path->tension, err);
    if (!status && rn_json_find(object, "constant_speed", &member))
        status = rn_json_boolean(object, "constant_speed", &path->constant_speed, err);
    if (!status && rn_json_find(object, "lens", &member))
        status = rn_json_choice(object, "lens", lenses, 2, &lens, err);
    path->interpolation = (enum rn_interpolation)interpolation;
    path->lens = lens ? RN_LENS_EQUIRECTANGULAR : RN_LENS_PINHOLE;
    return status;
}

static enum rn_status read_path(const struct rn_json *object, struct rn_path *path,
                                struct rn_error *err) {
    static const char *const known[] = {
        "axes", "fps",  "interpolation", "loop",           "width", "height",
        "lens", "keys", "tension",       "constant_speed", NULL};
    struct rn_json keys;
    enum rn_status status;
    if ((status = rn_json_refuse_unknown(object, known, err)) ||
        (status = read_motion(object, path, err)) ||
        (status = rn_json_integer(object, "width", 1, RN_CAMERA_MAX_SIZE, &path->width, err)) ||
        (status = rn_json_integer(object, "height", 1, RN_CAMERA_MAX_SIZE, &path->height, err)) ||
        (status = read_keys(object, path, err)) ||
        (status = rn_json_member(object, "keys", &keys, err)))
        return status;
    if (span_frames(path) >= RN_PATH_MAX_FRAMES)
        return rn_json_error(&keys, RN_ERROR_LIMIT, err,
                             "make a path of %.0f frames at %g fps; the limit is %d",
                             span_frames(path), path->fps, RN_PATH_MAX_FRAMES);
    if ((status = rn_path_prepare(path))) return rn_json_error(&keys, status, err, "out of memory");
    return RN_OK;
}

static enum rn_status check_key(const struct rn_path *path, size_t i, const char *where,
                                struct rn_error *err) {
    char at[256];
    struct rn_camera camera = rn_path_key_camera(path, i);
    double fov_y_deg = path->keys[i].fov_y_rad * 180 / M_PI, time_s = path->keys[i].time_s;
    snprintf(at, sizeof at, "%.200s#/path/keys/%zu", where, i);
    if (!(time_s >= 0 && time_s <= MAX_TIME_S))
        return rn_error_set(err, RN_ERROR_INVALID, at, "has a time of %g s; 0 to %g are possible",
                            time_s, MAX_TIME_S);
    if (!(fov_y_deg >= 1e-3 && fov_y_deg <= 179.9))
        return rn_error_set(err, RN_ERROR_INVALID, at,
                            "has a field of view of %g degrees; 0.001 to 179.9 are possible",
                            fov_y_deg);
    return rn_camera_check(&camera, at, err);
}

enum rn_status rn_path_check(struct rn_path *path, const char *where, struct rn_error *err) {
    for (size_t i = 0; i < path->key_count; i++) {
        enum rn_status status = check_key(path, i, where, err);
        if (status) return status;
    }
    if (!(path->fps >= 1e-3 && path->fps <= MAX_FPS))
        return rn_error_set(err, RN_ERROR_INVALID, where, "has %g frames a second", path->fps);
    if (span_frames(path) >= RN_PATH_MAX_FRAMES)
        return rn_error_set(err, RN_ERROR_LIMIT, where,
                            "makes %.0f frames at %g fps; the limit is %d", span_frames(path),
                            path->fps, RN_PATH_MAX_FRAMES);
    if (rn_path_prepare(path)) return rn_error_set(err, RN_ERROR_NO_MEMORY, where, "no memory");
    return RN_OK;
}

json_t *rn_path_json(const struct rn_path *path) {
    json_t *keys = json_array();
    for (size_t i = 0; i < path->key_count; i++) {
        const struct rn_path_key *key = &path->keys[i];
        json_t *pose = json_array();
        for (int r = 0; r < 3; r++) {
            const double *row = key->world_from_camera[r];
            json_array_append_new(pose, json_pack("[f,f,f,f]", row[0], row[1], row[2], row[3]));
        }
        json_t *object = json_pack("{s:f,s:o,s:f}", "time", key->time_s, "world_from_camera", pose,
                                   "fov_y_deg", key->fov_y_rad * 180 / M_PI);
        put_optics(object, &key->optics);
        json_array_append_new(keys, object);
    }
    json_t *object =
        json_pack("{s:s,s:f,s:s,s:b,s:i,s:i,s:o}", "axes", "opencv", "fps", path->fps,
                  "interpolation", interpolations[path->interpolation], "loop", (int)path->loop,
                  "width", path->width, "height", path->height, "keys", keys);
    if (object && path->tension > 0)
        json_object_set_new(object, "tension", json_real(path->tension));
    if (object && path->lens) json_object_set_new(object, "lens", json_string(lenses[1]));
    if (object && path->constant_speed) json_object_set_new(object, "constant_speed", json_true());
    return object;
}

enum rn_status rn_path_read(const struct rn_json *object, struct rn_path **ret_path,
                            struct rn_error *err) {
    struct rn_path *path = calloc(1, sizeof *path);
    if (!path) return rn_json_error(object, RN_ERROR_NO_MEMORY, err, "out of memory");
    enum rn_status status = read_path(object, path, err);
    if (status == RN_OK)
        *ret_path = path;
    else
        rn_path_destroy(&path);
    return status;
}

// The document's only member, `key`.
static enum rn_status parse(const char *json, size_t size_bytes, const char *where, const char *key,
                            json_t **ret_root, struct rn_json *at, struct rn_json *ret_member,
                            struct rn_error *err) {
    if (size_bytes > RN_PATH_MAX_BYTES)
        return rn_error_set(err, RN_ERROR_LIMIT, where, "has %zu bytes; the limit is %u",
                            size_bytes, RN_PATH_MAX_BYTES);
    json_t *root = NULL;
    enum rn_status status = rn_json_parse(json, size_bytes, where, &root, err);
    if (status) return status;
    const char *const known[] = {key, NULL};
    *at = rn_json_root(root, where);
    if ((status = rn_json_refuse_unknown(at, known, err)) ||
        (status = rn_json_member(at, key, ret_member, err))) {
        json_decref(root);
        return status;
    }
    *ret_root = root;
    return RN_OK;
}

enum rn_status rn_path_parse(const char *json, size_t size_bytes, const char *where,
                             struct rn_path **ret_path, struct rn_error *err) {
    json_t *root = NULL;
    struct rn_json at, object;
    enum rn_status status = parse(json, size_bytes, where, "path", &root, &at, &object, err);
    if (status) return status;
    status = rn_path_read(&object, ret_path, err);
    json_decref(root);
    return status;
}

enum rn_status rn_camera_parse(const char *json, size_t size_bytes, const char *where,
                               struct rn_camera *ret_camera, struct rn_error *err) {
    json_t *root = NULL;
    struct rn_json at, object;
    enum rn_status status = parse(json, size_bytes, where, "camera", &root, &at, &object, err);
    if (status) return status;
    status = rn_json_camera(&object, ret_camera, err);
    json_decref(root);
    return status;
}

void rn_path_destroy(struct rn_path **path) {
    if (!*path) return;
    free((*path)->keys);
    free((*path)->travelled);
    free(*path);
    *path = NULL;
}

size_t rn_path_frame_count(const struct rn_path *path) {
    size_t frames = (size_t)floor(span_frames(path) + 1e-6);
    if (!path->loop) return frames + 1;
    return frames ? frames : 1;
}
