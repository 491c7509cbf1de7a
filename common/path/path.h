// The native camera file and camera path file (JSON; schema in proto/).
//
// Camera: {"camera": {"world_from_camera": [[4],[4],[4]], "axes": "opencv"|"opengl",
//   "width", "height", and "fov_y_deg" or "fx","fy","cx","cy"}}.
// Path: {"path": {"axes": "opencv"|"opengl", "fps", "interpolation": "spline"|"linear",
//   "loop": bool, "width", "height", "keys": [{"time", "world_from_camera", "fov_y_deg"}]}}; absent
//   are fps 30, interpolation "spline", loop false.
#ifndef RN_COMMON_PATH_PATH_H
#define RN_COMMON_PATH_PATH_H

#include <stddef.h>

#include "common/base/status.h"
#include "common/math/camera.h"

struct rn_json;

enum rn_interpolation { RN_INTERPOLATE_SPLINE, RN_INTERPOLATE_LINEAR };

struct rn_path_key {
    double time_s;
    double world_from_camera[3][4]; // OpenCV axes
    double fov_y_rad;
};

// Thread-safety: immutable once parsed. Owner: the caller; rn_path_destroy.
struct rn_path {
    struct rn_path_key *keys; // times strictly increasing
    size_t key_count;         // >= 1
    double fps;
    enum rn_interpolation interpolation;
    bool loop; // the last key returns to the first; not to be written twice
    int width, height;
};

#define RN_PATH_MAX_FRAMES 100000
#define RN_PATH_MAX_BYTES (8u << 20)

// `json` holds size_bytes of UTF-8; `where` names it in errors ("file#/path/keys/3/time").
enum rn_status rn_path_parse(const char *json, size_t size_bytes, const char *where,
                             struct rn_path **ret_path, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_camera_parse(const char *json, size_t size_bytes, const char *where,
                               struct rn_camera *ret_camera, struct rn_error *err) RN_MUST_CHECK;
// The same of what stands within a document: a camera path's object (common/dataset/json.h).
enum rn_status rn_path_read(const struct rn_json *object, struct rn_path **ret_path,
                            struct rn_error *err) RN_MUST_CHECK;
void rn_path_destroy(struct rn_path **path);

// Frame i is at the first key's time + i / fps. Frames of the path: floor(duration * fps) + 1; a
// loop has no last one, and its duration includes the way back, of the keys' mean spacing.
size_t rn_path_frame_count(const struct rn_path *path);
// The camera of frame i: positions by Catmull-Rom (centripetal) or linearly, rotations by
// squad/slerp on unit quaternions, field of view like a position.
struct rn_camera rn_path_camera(const struct rn_path *path, size_t frame);

#endif
