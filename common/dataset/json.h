// Strict reading of JSON files: every getter checks type and range, and an error says where it
// stands as "file#/json/pointer".
#ifndef RN_COMMON_DATASET_JSON_H
#define RN_COMMON_DATASET_JSON_H

#include <jansson.h>
#include <stddef.h>

#include "common/base/status.h"
#include "common/math/camera.h"

#define RN_JSON_MAX_BYTES ((size_t)64 << 20)

// A value and where it stands. Thread-safety: immutable. Lives no longer than its parent and the
// document; owns nothing.
struct rn_json {
    const json_t *value;
    const char *file;
    const struct rn_json *parent; // NULL for the document's root
    const char *key;              // NULL for an array's element
    size_t index;
};

// Parses a document; the caller json_decref's it. Duplicate keys are refused. The words NaN and
// Infinity, which some writers emit, become values that no getter accepts, so that the error
// names the field. RN_ERROR_INVALID ("where:line"), RN_ERROR_LIMIT, RN_ERROR_NO_MEMORY.
enum rn_status rn_json_parse(const char *json, size_t size_bytes, const char *where,
                             json_t **ret_root, struct rn_error *err) RN_MUST_CHECK;
// As rn_json_parse, of a file of at most RN_JSON_MAX_BYTES; `comments`: // and /* */, which some
// programs write, are blanks. Also rn_file_read's statuses.
enum rn_status rn_json_parse_file(const char *path, bool comments, json_t **ret_root,
                                  struct rn_error *err) RN_MUST_CHECK;

struct rn_json rn_json_root(const json_t *root, const char *file);
// Element `index` of an array (in range).
struct rn_json rn_json_element(const struct rn_json *array, size_t index);
// "file#/frames/3/file_path"; a long file name loses its head, never the pointer its tail.
void rn_json_where(const struct rn_json *at, char where[256]);
// Fills *err with the value's place; returns `status`.
enum rn_status rn_json_error(const struct rn_json *at, enum rn_status status, struct rn_error *err,
                             const char *fmt, ...) RN_PRINTF(4, 5);

// Whether `object` is an object with that key, and then its value.
bool rn_json_find(const struct rn_json *object, const char *key, struct rn_json *ret_member);
// The getters want member `key` of an object, or with a NULL key the value itself:
// RN_ERROR_INVALID when it is missing, of another type or out of its range (bounds inclusive,
// numbers finite).
enum rn_status rn_json_member(const struct rn_json *object, const char *key,
                              struct rn_json *ret_member, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_json_array(const struct rn_json *object, const char *key, size_t min, size_t max,
                             struct rn_json *ret_array, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_json_number(const struct rn_json *object, const char *key, double min, double max,
                              double *ret_value, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_json_integer(const struct rn_json *object, const char *key, int min, int max,
                               int *ret_value, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_json_boolean(const struct rn_json *object, const char *key, bool *ret_value,
                               struct rn_error *err) RN_MUST_CHECK;
// *ret_text belongs to the document.
enum rn_status rn_json_text(const struct rn_json *object, const char *key, size_t max_bytes,
                            const char **ret_text, struct rn_error *err) RN_MUST_CHECK;
// One of `count` names; its index.
enum rn_status rn_json_choice(const struct rn_json *object, const char *key,
                              const char *const *names, int count, int *ret_index,
                              struct rn_error *err) RN_MUST_CHECK;
// rows x columns finite numbers, row-major; with rows = 0 a flat array of `columns`.
enum rn_status rn_json_matrix(const struct rn_json *object, const char *key, size_t rows,
                              size_t columns, double *ret_values,
                              struct rn_error *err) RN_MUST_CHECK;
// RN_ERROR_INVALID at the first member that is not among the NULL-terminated `known`.
enum rn_status rn_json_refuse_unknown(const struct rn_json *object, const char *const *known,
                                      struct rn_error *err) RN_MUST_CHECK;

// The native camera object: {"world_from_camera": 3x4, "axes": "opencv"|"opengl", "width",
// "height", and "fov_y_deg" or "fx", "fy", "cx", "cy"}, with "lens": {"model", parameters by name}
// where it is no pinhole; nothing else.
enum rn_status rn_json_camera(const struct rn_json *object, struct rn_camera *ret_camera,
                              struct rn_error *err) RN_MUST_CHECK;
// A new reference, OpenCV axes and fx, fy, cx, cy, the lens; NULL when memory is out.
json_t *rn_json_from_camera(const struct rn_camera *camera);
// From camera axes x right, y up, z backwards to x right, y down, z forward: columns 1, 2 negated.
void rn_pose_from_opengl(double world_from_camera[3][4]);
extern const char *const rn_axes_names[2]; // "opencv", "opengl"

#endif
