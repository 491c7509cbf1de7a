#include "common/path/formats/parts.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rotation.h"
#include "common/math/vector.h"

#define MAX_SKEW 0.01 // of a rotation that was written with few digits

enum rn_status rn_path_make_keys(struct rn_path *path, size_t count, const struct rn_json *at,
                                 struct rn_error *err) {
    if (count == 0) return rn_json_error(at, RN_ERROR_INVALID, err, "has no cameras");
    if (count > RN_PATH_MAX_KEYS)
        return rn_json_error(at, RN_ERROR_LIMIT, err, "has %zu cameras; a path has %d at most",
                             count, RN_PATH_MAX_KEYS);
    path->keys = calloc(count, sizeof *path->keys);
    if (!path->keys) return rn_json_error(at, RN_ERROR_NO_MEMORY, err, "no memory");
    path->key_count = count;
    return RN_OK;
}

static enum rn_status read_rows(const struct rn_json *value, double ret[3][4],
                                struct rn_error *err) {
    double values[16];
    size_t count = json_array_size(value->value);
    bool nested = json_is_array(json_array_get(value->value, 0));
    if (nested ? count != 3 && count != 4 : count != 12 && count != 16)
        return rn_json_error(value, RN_ERROR_INVALID, err,
                             "must be 3 or 4 rows of 4 numbers, or 12 or 16 numbers");
    enum rn_status status =
        rn_json_matrix(value, NULL, nested ? count : 0, nested ? 4 : count, values, err);
    if (!status) memcpy(ret, values, sizeof(double[3][4]));
    return status;
}

enum rn_status rn_path_json_pose(const struct rn_json *object, const char *key, double ret[3][4],
                                 struct rn_error *err) {
    struct rn_json value;
    enum rn_status status = rn_json_member(object, key, &value, err);
    if (!status && !json_is_array(value.value))
        status = rn_json_error(&value, RN_ERROR_INVALID, err, "must be a matrix");
    if (!status) status = read_rows(&value, ret, err);
    return status;
}

static double column_dot(double m[3][4], int a, int b) {
    return m[0][a] * m[0][b] + m[1][a] * m[1][b] + m[2][a] * m[2][b];
}

enum rn_status rn_path_make_exact(const struct rn_json *at, double pose[3][4],
                                  struct rn_error *err) {
    double skew = rn_rotation_skew((const double(*)[4])pose);
    if (!(skew <= MAX_SKEW))
        return rn_json_error(at, RN_ERROR_INVALID, err, "holds no rotation (off by %.2g)", skew);
    if (rn_rotation_determinant((const double(*)[4])pose) < 0)
        return rn_json_error(at, RN_ERROR_INVALID, err, "is mirrored (determinant -1)");
    for (int c = 0; c < 3; c++) { // Gram and Schmidt
        for (int b = 0; b < c; b++) {
            double along = column_dot(pose, b, c);
            for (int i = 0; i < 3; i++)
                pose[i][c] -= along * pose[i][b];
        }
        double length = sqrt(column_dot(pose, c, c));
        for (int i = 0; i < 3; i++)
            pose[i][c] /= length;
    }
    return RN_OK;
}

enum rn_status rn_path_look_at(const struct rn_json *at, const double target[3], const double up[3],
                               double pose[3][4], struct rn_error *err) {
    double forward[3], right[3], down[3];
    for (int i = 0; i < 3; i++)
        forward[i] = target[i] - pose[i][3];
    bool sound = rn_make_unit(forward);
    rn_cross(forward, up, right);
    if (sound && !rn_make_unit(right)) { // straight up or down: any heading
        const double side[3] = {fabs(up[0]) < 0.9, fabs(up[0]) >= 0.9, 0};
        rn_cross(forward, side, right);
        sound = rn_make_unit(right);
    }
    if (!sound)
        return rn_json_error(at, RN_ERROR_INVALID, err, "has its target where the camera stands");
    rn_cross(forward, right, down);
    for (int i = 0; i < 3; i++) {
        pose[i][0] = right[i];
        pose[i][1] = down[i];
        pose[i][2] = forward[i];
    }
    return RN_OK;
}

void rn_path_into_dataset(const struct rn_path_space *space, double pose[3][4]) {
    const double(*t)[4] = space->transform;
    double in[3][4];
    memcpy(in, pose, sizeof in);
    for (int i = 0; i < 3; i++)
        in[i][3] = in[i][3] / space->scale - t[i][3];
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < 4; c++)
            pose[i][c] = t[0][i] * in[0][c] + t[1][i] * in[1][c] + t[2][i] * in[2][c];
}

void rn_path_out_of_dataset(const struct rn_path_space *space, double pose[3][4]) {
    const double(*t)[4] = space->transform;
    double in[3][4];
    memcpy(in, pose, sizeof in);
    for (int i = 0; i < 3; i++)
        for (int c = 0; c < 4; c++)
            pose[i][c] = t[i][0] * in[0][c] + t[i][1] * in[1][c] + t[i][2] * in[2][c];
    for (int i = 0; i < 3; i++)
        pose[i][3] = space->scale * (pose[i][3] + t[i][3]);
}

json_t *rn_path_json_three(const double values[3]) {
    return json_pack("[f,f,f]", values[0], values[1], values[2]);
}

static const double last_row[4] = {0, 0, 0, 1};

json_t *rn_path_json_rows(double pose[3][4], int rows) {
    json_t *array = json_array();
    for (int i = 0; i < rows; i++) {
        const double *row = i < 3 ? pose[i] : last_row;
        json_array_append_new(array, json_pack("[f,f,f,f]", row[0], row[1], row[2], row[3]));
    }
    return array;
}

json_t *rn_path_json_flat(double pose[3][4], int rows) {
    json_t *array = json_array();
    for (int i = 0; i < rows; i++)
        for (int c = 0; c < 4; c++)
            json_array_append_new(array, json_real(i < 3 ? pose[i][c] : last_row[c]));
    return array;
}

enum rn_status rn_path_dump(json_t *root, char **ret_text, struct rn_error *err) {
    char *text = root ? json_dumps(root, JSON_INDENT(1) | JSON_REAL_PRECISION(15)) : NULL;
    json_decref(root);
    if (!text) return rn_error_set(err, RN_ERROR_NO_MEMORY, "the camera path", "no memory");
    *ret_text = text;
    return RN_OK;
}
