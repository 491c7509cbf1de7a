// The daemon's own: {"path": {...}}, proto/path.schema.json; or what stands there alone, as in a
// job's camera_path.
#include <stdlib.h>
#include <string.h>

#include "common/path/formats/parts.h"

static bool stands_alone(const struct rn_path_text *in) {
    return json_is_array(json_object_get(in->root, "keys"));
}

static bool recognise(const struct rn_path_text *in) {
    return json_is_object(json_object_get(in->root, "path")) || stands_alone(in);
}

static enum rn_status read(const struct rn_path_text *in, const struct rn_path_choices *choices,
                           struct rn_path *path, struct rn_error *err) {
    struct rn_path *found = NULL;
    const struct rn_json root = rn_json_root(in->root, in->where);
    enum rn_status status = stands_alone(in)
                                ? rn_path_read(&root, &found, err)
                                : rn_path_parse(in->text, in->size, in->where, &found, err);
    if (status) return status;
    (void)choices;
    *path = *found;
    free(found);
    return RN_OK;
}

static enum rn_status write(const struct rn_path *path, const struct rn_path_space *space,
                            char **ret_text, char **ret_beside, struct rn_error *err) {
    json_t *document = rn_path_json(path);
    (void)space; // always the dataset's coordinates
    (void)ret_beside;
    return rn_path_dump(document ? json_pack("{s:o}", "path", document) : NULL, ret_text, err);
}

const struct rn_path_format rn_path_format_native = {
    .name = "ripnerf",
    .title = "ripnerf",
    .file = "path.json",
    .usual = {1, {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}},
    .recognise = recognise,
    .read = read,
    .write = write};
