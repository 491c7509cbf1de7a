#include "proto/formats.h"

#include <jansson.h>

#include "common/dataset/dataset.h"
#include "common/dataset/formats.h"
#include "common/path/formats/formats.h"

static json_t *strings_to_json(const char *const *strings) {
    json_t *array = json_array();
    for (; *strings; strings++)
        if (json_array_append_new(array, json_string(*strings)) != 0) {
            json_decref(array);
            return NULL;
        }
    return array;
}

static json_t *signs_to_json(const struct rn_sign *signs) {
    json_t *array = json_array();
    for (; signs->file; signs++)
        if (json_array_append_new(array, json_pack("{s:s s:s*}", "file", signs->file, "member",
                                                   signs->member)) != 0) {
            json_decref(array);
            return NULL;
        }
    return array;
}

static json_t *format_to_json(const struct rn_format *format) {
    return json_pack("{s:s s:s s:o s:o s:o}", "name", format->name, "title", format->title, "signs",
                     signs_to_json(format->signs), "documents", strings_to_json(format->documents),
                     "photo_folders", strings_to_json(format->photo_folders));
}

static json_t *path_format_to_json(const struct rn_path_format *format) {
    return json_pack("{s:s s:s s:s}", "name", format->name, "title", format->title, "file",
                     format->file);
}

// What names that end with NULL are called, for people.
static json_t *titles_to_json(const char *const *names, const char *const *titles) {
    json_t *array = json_array();
    for (; *names; names++, titles++)
        if (json_array_append_new(array,
                                  json_pack("{s:s s:s}", "name", *names, "title", *titles)) != 0) {
            json_decref(array);
            return NULL;
        }
    return array;
}

enum rn_status rn_formats_to_json(char **ret_json, struct rn_error *err) {
    json_t *items = json_array(), *paths = json_array();
    bool complete = items && paths;
    for (size_t i = 0; complete && rn_formats[i]; i++)
        complete = json_array_append_new(items, format_to_json(rn_formats[i])) == 0;
    for (size_t i = 0; complete && rn_path_formats[i]; i++)
        complete = json_array_append_new(paths, path_format_to_json(rn_path_formats[i])) == 0;
    json_t *root = json_pack("{s:o s:o s:o s:o}", "items", items, "paths", paths, "captures",
                             titles_to_json(rn_capture_names, rn_capture_titles), "bounds",
                             titles_to_json(rn_bounds_source_names, rn_bounds_source_titles));
    char *text = complete ? json_dumps(root, JSON_COMPACT) : NULL;
    json_decref(root);
    if (!text) return rn_error_set(err, RN_ERROR_NO_MEMORY, "formats", "memory ran out");
    *ret_json = text;
    return RN_OK;
}
