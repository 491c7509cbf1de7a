// What readers and writers of paths share. Within common/path/formats only.
#ifndef RN_COMMON_PATH_FORMATS_PARTS_H
#define RN_COMMON_PATH_FORMATS_PARTS_H

#include "common/dataset/json.h"
#include "common/path/formats/formats.h"

// Room for `count` keys, 1 .. RN_PATH_MAX_KEYS, all zero; `at` is where they stand.
enum rn_status rn_path_make_keys(struct rn_path *path, size_t count, const struct rn_json *at,
                                 struct rn_error *err) RN_MUST_CHECK;
// As rn_json_matrix of 3 or 4 rows of 4, or of 12 or 16 numbers in a row (also in a string of
// JSON).
enum rn_status rn_path_json_pose(const struct rn_json *object, const char *key, double ret[3][4],
                                 struct rn_error *err) RN_MUST_CHECK;
// Makes a rotation exact that was written with few digits; RN_ERROR_INVALID at `at` when the
// columns are no rotation, or are mirrored.
enum rn_status rn_path_make_exact(const struct rn_json *at, double pose[3][4],
                                  struct rn_error *err) RN_MUST_CHECK;
// A camera at `position` that looks at `target` with `up` upwards: the rotation of the pose.
enum rn_status rn_path_look_at(const struct rn_json *at, const double target[3], const double up[3],
                               double pose[3][4], struct rn_error *err) RN_MUST_CHECK;
// From the file's coordinates to the dataset's, and back.
void rn_path_into_dataset(const struct rn_path_space *space, double pose[3][4]);
void rn_path_out_of_dataset(const struct rn_path_space *space, double pose[3][4]);
// Numbers of JSON as strings' contents; an array of 3 x 4 or of rows x 4 with a last row 0 0 0 1.
json_t *rn_path_json_rows(double pose[3][4], int rows);
json_t *rn_path_json_flat(double pose[3][4], int rows);
json_t *rn_path_json_three(const double values[3]);
// malloc'd text of a document, whose reference is taken; NULL document or text: no memory.
enum rn_status rn_path_dump(json_t *root, char **ret_text, struct rn_error *err) RN_MUST_CHECK;

#endif
