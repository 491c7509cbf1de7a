// The native camera file and camera path file (JSON; schema in proto/).
//
// Camera: {"camera": {"world_from_camera": [[4],[4],[4]], "axes": "opencv"|"opengl",
//   "width", "height", and "fov_y_deg" or "fx","fy","cx","cy"}}.
// Path: {"path": {"axes": "opencv"|"opengl", "fps", "interpolation": "spline"|"linear",
//   "loop": bool, "width", "height", "keys": [{"time", "world_from_camera", "fov_y_deg"}]}}; absent
//   are fps 30, interpolation "spline", loop false. "interpolation" may be "circle" too: about the
//   point that the keys look at. "tension" 0 .. 1 straightens a spline (0); "constant_speed"
//   (false) lets the camera travel equal distances in equal times instead of meeting its keys'
//   times. "lens" may be "equirectangular": all directions around. A key may have the effects of
//   common/settings/optics.h by their names ("aperture", "focus", ...), which go over from key to
//   key as the field of view does.
#ifndef RN_COMMON_PATH_PATH_H
#define RN_COMMON_PATH_PATH_H

#include <stddef.h>

#include "common/base/status.h"
#include "common/math/camera.h"
#include "common/settings/optics.h"

struct rn_json;

enum rn_interpolation { RN_INTERPOLATE_SPLINE, RN_INTERPOLATE_LINEAR, RN_INTERPOLATE_CIRCLE };

struct rn_path_key {
    double time_s;
    double world_from_camera[3][4]; // OpenCV axes
    double fov_y_rad;
    struct rn_optics optics;
};

// Thread-safety: immutable once parsed. Owner: the caller; rn_path_destroy.
struct rn_path {
    struct rn_path_key *keys; // times strictly increasing
    size_t key_count;         // >= 1
    double fps;
    enum rn_interpolation interpolation;
    double tension;      // of a spline: 0 as Catmull and Rom, 1 straight lines
    bool constant_speed; // equal distances in equal times
    bool loop;           // the last key returns to the first; not to be written twice
    int width, height;
    enum rn_lens lens; // pinhole or equirectangular
    // Made of the rest by rn_path_check: the point that the keys look at, where there is one, and
    // the distance travelled at even parts of each stretch between keys, travelled_count in all.
    bool has_centre;
    double centre[3];
    double *travelled; // owned
    size_t travelled_count;
};

#define RN_PATH_MAX_KEYS 10000
#define RN_PATH_MAX_FRAMES 100000
#define RN_PATH_MAX_IMPORT (32u << 20) // bytes of another program's file
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
// Checks what another reader put together, times apart, and makes ready what rn_path_camera needs;
// errors are at "where#/path/...". RN_ERROR_INVALID, RN_ERROR_LIMIT, RN_ERROR_NO_MEMORY.
enum rn_status rn_path_check(struct rn_path *path, const char *where,
                             struct rn_error *err) RN_MUST_CHECK;
// The object within {"path": ...}, a new reference; NULL: no memory.
struct json_t *rn_path_json(const struct rn_path *path);

// Frame i is at the first key's time + i / fps. Frames of the path: floor(duration * fps) + 1; a
// loop has no last one, and its duration includes the way back, of the keys' mean spacing.
size_t rn_path_frame_count(const struct rn_path *path);
// The camera of frame i, or in between (before the first and behind the last one of a path that is
// no loop: theirs): positions by Catmull-Rom (centripetal) or linearly, rotations by
// squad/slerp on unit quaternions, field of view like a position.
struct rn_camera rn_path_camera(const struct rn_path *path, double frame);
// The effects of the camera there: linearly between keys.
struct rn_optics rn_path_optics(const struct rn_path *path, double frame);
// The camera of a key.
struct rn_camera rn_path_key_camera(const struct rn_path *path, size_t key);

#endif
