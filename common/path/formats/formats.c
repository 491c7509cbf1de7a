#include "common/path/formats/formats.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/path/formats/parts.h"

#define FORMATS(ROW)                                                                               \
    ROW(native)                                                                                    \
    ROW(nerfstudio)                                                                                \
    ROW(ngp) ROW(nerfbaselines) ROW(transforms) ROW(colmap) ROW(supersplat) ROW(splatting)
#define DECLARE(name) extern const struct rn_path_format rn_path_format_##name;
#define ADDRESS(name) &rn_path_format_##name,

FORMATS(DECLARE)
const struct rn_path_format *const rn_path_formats[] = {FORMATS(ADDRESS) NULL};

#define SAME                                                                                       \
    {                                                                                              \
        1, {                                                                                       \
            {1, 0, 0, 0}, {0, 1, 0, 0}, {                                                          \
                0, 0, 1, 0                                                                         \
            }                                                                                      \
        }                                                                                          \
    }
const struct rn_path_space rn_path_space_same = SAME;

const struct rn_path_format *rn_path_format_find(const char *name) {
    for (size_t i = 0; rn_path_formats[i]; i++)
        if (strcmp(rn_path_formats[i]->name, name) == 0) return rn_path_formats[i];
    return NULL;
}

void rn_path_format_names(const char *between, char *text, size_t capacity) {
    size_t used = 0;
    for (size_t i = 0; rn_path_formats[i] && used < capacity; i++)
        used += (size_t)snprintf(text + used, capacity - used, "%s%s", i ? between : "",
                                 rn_path_formats[i]->name);
}

// ---- importing --------------------------------------------------------------------------------

static enum rn_status recognise(const struct rn_path_text *in,
                                const struct rn_path_format **ret_format, struct rn_error *err) {
    char names[200];
    for (size_t i = 0; rn_path_formats[i]; i++)
        if (rn_path_formats[i]->recognise(in)) {
            *ret_format = rn_path_formats[i];
            return RN_OK;
        }
    rn_path_format_names(", ", names, sizeof names);
    return rn_error_set(err, RN_ERROR_INVALID, in->where,
                        "is no camera path that is known; read are %s", names);
}

static enum rn_status check_format(const struct rn_path_text *in,
                                   const struct rn_path_format *format, struct rn_error *err) {
    const struct rn_path_format *found = NULL;
    if (format->recognise(in)) return RN_OK;
    if (recognise(in, &found, NULL) == RN_OK)
        return rn_error_set(err, RN_ERROR_INVALID, in->where, "is a path of %s, not of %s",
                            found->title, format->title);
    return rn_error_set(err, RN_ERROR_INVALID, in->where, "is no %s", format->title);
}

static enum rn_status find_space(const struct rn_path_format *format,
                                 const struct rn_path_choices *choices, const char *where,
                                 const struct rn_path_space **ret_space, struct rn_error *err) {
    *ret_space = choices->space ? choices->space : &format->usual;
    if (choices->space || !format->needs_space) return RN_OK;
    return rn_error_set(err, RN_ERROR_UNSUPPORTED, where,
                        "has coordinates of one training, which moved and scaled the dataset: give "
                        "its dataparser_transforms.json, or say that they are the dataset's own");
}

static enum rn_status check_times(const struct rn_path *path, const char *where,
                                  struct rn_error *err) {
    for (size_t i = 1; i < path->key_count; i++)
        if (!(path->keys[i].time_s > path->keys[i - 1].time_s))
            return rn_error_set(err, RN_ERROR_INVALID, where,
                                "key %zu, at %g s, is not later than the one before it (%g s)", i,
                                path->keys[i].time_s, path->keys[i - 1].time_s);
    return RN_OK;
}

// What readers leave open: the frames' size and rate.
static enum rn_status settle(const struct rn_path_choices *choices, const char *where,
                             struct rn_path *path, struct rn_error *err) {
    if (choices->width) {
        path->width = choices->width;
        path->height = choices->height;
    }
    if (!path->width) {
        path->width = 960;
        path->height = 540;
    }
    if (!(path->fps > 0)) path->fps = choices->fps > 0 ? choices->fps : 30;
    enum rn_status status = check_times(path, where, err);
    return status ? status : rn_path_check(path, where, err);
}

static enum rn_status read_path(const struct rn_path_text *in, const struct rn_path_format *format,
                                const struct rn_path_choices *choices, struct rn_path *path,
                                struct rn_error *err) {
    const struct rn_path_space *space;
    struct rn_path_choices settled = *choices;
    enum rn_status status = find_space(format, choices, in->where, &space, err);
    if (status) return status;
    settled.space = space;
    status = format->read(in, &settled, path, err);
    for (size_t i = 0; i < path->key_count && !status; i++)
        rn_path_into_dataset(space, path->keys[i].world_from_camera);
    return status ? status : settle(choices, in->where, path, err);
}

static bool is_json(const char *text, size_t size) {
    size_t i = 0;
    while (i < size && strchr(" \t\r\n", text[i]))
        i++;
    return i < size && strchr("{[", text[i]);
}

enum rn_status rn_path_import(struct rn_path_text *in, const struct rn_path_format *format,
                              const struct rn_path_choices *choices, struct rn_path **ret_path,
                              const struct rn_path_format **ret_format, struct rn_error *err) {
    enum rn_status status = RN_OK;
    if (in->size > RN_PATH_MAX_IMPORT)
        return rn_error_set(err, RN_ERROR_LIMIT, in->where, "has %zu bytes; the limit is %u",
                            in->size, RN_PATH_MAX_IMPORT);
    in->root = NULL;
    if (is_json(in->text, in->size))
        status = rn_json_parse(in->text, in->size, in->where, &in->root, err);
    if (!status) status = format ? check_format(in, format, err) : recognise(in, &format, err);
    struct rn_path *path = status ? NULL : calloc(1, sizeof *path);
    if (!status && !path) status = rn_error_set(err, RN_ERROR_NO_MEMORY, in->where, "no memory");
    if (!status) status = read_path(in, format, choices, path, err);
    json_decref(in->root);
    in->root = NULL;
    if (status) {
        rn_path_destroy(&path);
        return status;
    }
    *ret_path = path;
    if (ret_format) *ret_format = format;
    return RN_OK;
}

enum rn_status rn_path_recognise(struct rn_path_text *in, const struct rn_path_format **ret_format,
                                 struct rn_error *err) {
    enum rn_status status = RN_OK;
    in->root = NULL;
    if (is_json(in->text, in->size))
        status = rn_json_parse(in->text, in->size, in->where, &in->root, err);
    if (!status) status = recognise(in, ret_format, err);
    json_decref(in->root);
    in->root = NULL;
    return status;
}

enum rn_status rn_path_object_text(const struct rn_path *path, char **ret_json,
                                   struct rn_error *err) {
    return rn_path_dump(rn_path_json(path), ret_json, err);
}

enum rn_status rn_path_export(const struct rn_path *path, const struct rn_path_format *format,
                              const struct rn_path_space *space, char **ret_text, char **ret_beside,
                              struct rn_error *err) {
    char *beside = NULL;
    enum rn_status status =
        format->write(path, space ? space : &format->usual, ret_text, &beside, err);
    if (!status) *ret_beside = beside;
    return status;
}
