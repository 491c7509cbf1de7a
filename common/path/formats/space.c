// Where a file's coordinates lie beside the dataset's.
#include <string.h>

#include "common/path/formats/parts.h"

enum rn_status rn_path_space_read(const char *text, size_t size, const char *where,
                                  struct rn_path_space *ret_space, struct rn_error *err) {
    json_t *root = NULL;
    struct rn_path_space space = rn_path_space_same;
    enum rn_status status = rn_json_parse(text, size, where, &root, err);
    if (status) return status;
    struct rn_json at = rn_json_root(root, where), transform;
    status = rn_json_number(&at, "scale", 1e-12, 1e12, &space.scale, err);
    if (!status) status = rn_json_matrix(&at, "transform", 3, 4, &space.transform[0][0], err);
    if (!status) status = rn_json_member(&at, "transform", &transform, err);
    if (!status) status = rn_path_make_exact(&transform, space.transform, err);
    json_decref(root);
    if (!status) *ret_space = space;
    return status;
}

// p_file = s T p_original and p_dataset = a A p_original: p_file = (s / a) (T A^-1) p_dataset.
static enum rn_status undo_applied(const struct rn_json *root, struct rn_path_space *space,
                                   struct rn_error *err) {
    struct rn_json member;
    double applied[3][4], scale = 1, before[3][4];
    enum rn_status status = RN_OK;
    if (rn_json_find(root, "applied_scale", &member))
        status = rn_json_number(root, "applied_scale", 1e-12, 1e12, &scale, err);
    space->scale /= scale;
    if (status || !rn_json_find(root, "applied_transform", &member)) return status;
    status = rn_path_json_pose(root, "applied_transform", applied, err);
    if (!status) status = rn_path_make_exact(&member, applied, err);
    if (status) return status;
    memcpy(before, space->transform, sizeof before);
    for (int i = 0; i < 3; i++) {
        for (int c = 0; c < 3; c++)
            space->transform[i][c] = before[i][0] * applied[c][0] + before[i][1] * applied[c][1] +
                                     before[i][2] * applied[c][2];
        for (int c = 0; c < 3; c++)
            space->transform[i][3] -= space->transform[i][c] * applied[c][3];
    }
    return RN_OK;
}

// instant-ngp scales, moves, then turns the axes: x, y, z of its space are y, z, x of the dataset.
static enum rn_status take_offset(const struct rn_json *root, struct rn_path_space *space,
                                  struct rn_error *err) {
    struct rn_json member;
    double offset[3] = {0.5, 0.5, 0.5};
    enum rn_status status = RN_OK;
    if (rn_json_find(root, "scale", &member))
        status = rn_json_number(root, "scale", 1e-12, 1e12, &space->scale, err);
    if (!status && rn_json_find(root, "offset", &member)) {
        if (json_is_array(member.value))
            status = rn_json_matrix(root, "offset", 0, 3, offset, err);
        else if (!(status = rn_json_number(root, "offset", -1e12, 1e12, &offset[0], err)))
            offset[1] = offset[2] = offset[0];
    }
    for (int i = 0; i < 3; i++)
        space->transform[i][3] = offset[(i + 1) % 3] / space->scale;
    return status;
}

enum rn_status rn_path_space_of_dataset(const struct rn_path_format *format, const char *text,
                                        size_t size, const char *where, struct rn_path_space *space,
                                        struct rn_error *err) {
    json_t *root = NULL;
    enum rn_status status = rn_json_parse(text, size, where, &root, err);
    if (status) return status;
    struct rn_json at = rn_json_root(root, where);
    if (format->needs_space)
        status = undo_applied(&at, space, err);
    else if (strcmp(format->name, "instant-ngp") == 0)
        status = take_offset(&at, space, err);
    else
        status =
            rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                         "moves no coordinates of %s, which are the dataset's own", format->title);
    json_decref(root);
    return status;
}

static bool is_word(const struct rn_path_text *text, const char *word) {
    return text->size == strlen(word) && memcmp(text->text, word, text->size) == 0;
}

enum rn_status rn_path_space_find(const struct rn_path_format *format,
                                  const struct rn_path_text *space,
                                  const struct rn_path_text *dataset,
                                  struct rn_path_space *ret_space, bool *ret_given,
                                  struct rn_error *err) {
    enum rn_status status = RN_OK;
    *ret_given = space->text || dataset->text;
    *ret_space = space->text ? rn_path_space_same : format->usual;
    if (space->text && !is_word(space, "dataset"))
        status = rn_path_space_read(space->text, space->size, space->where, ret_space, err);
    if (status || !dataset->text) return status;
    return rn_path_space_of_dataset(format, dataset->text, dataset->size, dataset->where, ret_space,
                                    err);
}
