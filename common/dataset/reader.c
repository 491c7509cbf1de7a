#include "common/dataset/reader.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

char *rn_reader_path(const struct rn_reader *reader, const char *name) {
    while (name[0] == '.' && name[1] == '/')
        name += 2;
    char *path;
    return asprintf(&path, "%s/%s", reader->folder, name) < 0 ? NULL : path;
}

enum rn_status rn_reader_document(struct rn_reader *reader, const char *name, char **ret_path,
                                  struct rn_error *err) {
    struct rn_dataset *dataset = reader->dataset;
    size_t count = dataset->document_count;
    char **grown = realloc(dataset->documents, (count + 1) * sizeof *grown);
    char *path = rn_reader_path(reader, name);
    if (grown) {
        dataset->documents = grown;
        if ((grown[count] = strdup(name)) != NULL) dataset->document_count++;
    }
    if (path && dataset->document_count > count) {
        *ret_path = path;
        return RN_OK;
    }
    free(path);
    return rn_error_set(err, RN_ERROR_NO_MEMORY, reader->folder, "out of memory");
}

enum rn_status rn_reader_json(struct rn_reader *reader, const char *name, bool comments,
                              rn_reader_root read, void *context, struct rn_error *err) {
    char *path;
    json_t *root = NULL;
    enum rn_status status = rn_reader_document(reader, name, &path, err);
    if (status) return status;
    status = rn_json_parse_file(path, comments, &root, err);
    if (status == RN_OK) {
        struct rn_json at = rn_json_root(root, path);
        status = read(reader, &at, context, err);
        json_decref(root);
    }
    free(path);
    return status;
}

// What is wrong with a file name from a dataset's JSON, or NULL.
static const char *name_fault(const char *name) {
    if (name[0] == '/') return "is an absolute path; name files relative to the dataset's folder";
    for (const char *c = name; *c; c++)
        if ((unsigned char)*c < 0x20 || *c == 0x7f) return "holds a control character";
    for (const char *part = name; part; part = strchr(part, '/')) {
        part += *part == '/';
        if (part[0] == '.' && part[1] == '.' && (part[2] == '/' || !part[2]))
            return "leaves the dataset's folder with \"..\"";
    }
    size_t length = strlen(name);
    return length == 0 || name[length - 1] == '/' ? "names no file" : NULL;
}

static bool has_image_extension(const char *name) {
    const char *dot = strrchr(name, '.');
    return dot &&
           (!strcasecmp(dot, ".png") || !strcasecmp(dot, ".jpg") || !strcasecmp(dot, ".jpeg"));
}

// The file's name without folder and extension, malloc'd.
static char *base_name(const char *path) {
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    size_t length = has_image_extension(name) ? (size_t)(strrchr(name, '.') - name) : strlen(name);
    return strndup(name, length);
}

static enum rn_status probe(const struct rn_json *at, const char *path,
                            struct rn_image_info *ret_info, struct rn_error *err) {
    struct stat info;
    if (stat(path, &info) != 0)
        return rn_json_error(at, RN_ERROR_NOT_FOUND, err, "names %s, which does not exist", path);
    if (!S_ISREG(info.st_mode))
        return rn_json_error(at, RN_ERROR_INVALID, err, "names %s, which is no regular file", path);
    struct rn_error inner;
    enum rn_status status = rn_image_probe(path, &rn_image_default_limits, ret_info, &inner);
    if (status) return rn_json_error(at, status, err, "names %s: %s", path, inner.text);
    return RN_OK;
}

// Said once: it is no fault, and as a rule all images are alike.
static void tell_deep(struct rn_reader *reader, const struct rn_json *at, int bit_depth) {
    char where[256];
    if (bit_depth <= 8 || reader->told_deep) return;
    reader->told_deep = true;
    rn_json_where(at, where);
    rn_problems_add(reader->problems, RN_SEVERITY_INFO, where,
                    "names an image of %d bits a channel; it is rounded to 8, as others are",
                    bit_depth);
}

enum rn_status rn_reader_image(struct rn_reader *reader, const struct rn_json *object,
                               const char *key, const char *extension, struct rn_frame *frame,
                               struct rn_error *err) {
    struct rn_json at;
    const char *text;
    enum rn_status status = rn_json_text(object, key, RN_FILE_NAME_MAX, &text, err);
    if (status || (status = rn_json_member(object, key, &at, err))) return status;
    const char *fault = name_fault(text);
    if (fault) return rn_json_error(&at, RN_ERROR_INVALID, err, "\"%.200s\" %s", text, fault);
    char file[RN_FILE_NAME_MAX + 8];
    snprintf(file, sizeof file, "%s%s", text, has_image_extension(text) ? "" : extension);
    frame->name = base_name(text);
    frame->path = rn_reader_path(reader, file);
    struct rn_image_info info;
    if (!frame->name || !frame->path)
        status = rn_json_error(&at, RN_ERROR_NO_MEMORY, err, "out of memory");
    else
        status = probe(&at, frame->path, &info, err);
    if (status) {
        rn_frame_finish(frame);
        return status;
    }
    tell_deep(reader, &at, info.bit_depth);
    frame->has_alpha = info.has_alpha;
    frame->camera.width = info.width;
    frame->camera.height = info.height;
    return RN_OK;
}

enum rn_status rn_reader_pose(const struct rn_json *object, const char *key, double pose[3][4],
                              struct rn_error *err) {
    double m[4][4];
    struct rn_json at;
    enum rn_status status = rn_json_matrix(object, key, 4, 4, &m[0][0], err);
    if (status || (status = rn_json_member(object, key, &at, err))) return status;
    struct rn_json last = rn_json_element(&at, 3);
    for (int i = 0; i < 4; i++)
        if (m[3][i] < (i == 3) - 1e-6 || m[3][i] > (i == 3) + 1e-6)
            return rn_json_error(&last, RN_ERROR_INVALID, err,
                                 "is not 0 0 0 1: the matrix is no rigid pose");
    memcpy(pose, m, 12 * sizeof(double));
    rn_pose_from_opengl(pose);
    return RN_OK;
}

enum rn_status rn_reader_check_camera(const struct rn_json *object, const char *key,
                                      const struct rn_camera *camera, struct rn_error *err) {
    struct rn_json at;
    struct rn_error inner;
    enum rn_status status = rn_json_member(object, key, &at, err);
    if (!status && (status = rn_camera_check(camera, "", &inner)))
        return rn_json_error(&at, status, err, "%s", inner.text);
    return status;
}

static enum rn_status append(struct rn_reader *reader, const struct rn_frame *frame,
                             struct rn_error *err) {
    struct rn_dataset *dataset = reader->dataset;
    if (dataset->frame_count >= RN_DATASET_MAX_FRAMES)
        return rn_error_set(err, RN_ERROR_LIMIT, reader->folder, "has more than %d images",
                            RN_DATASET_MAX_FRAMES);
    if (dataset->frame_count == reader->capacity) {
        size_t capacity = reader->capacity ? 2 * reader->capacity : 64;
        struct rn_frame *frames = realloc(dataset->frames, capacity * sizeof *frames);
        if (!frames) return rn_error_set(err, RN_ERROR_NO_MEMORY, reader->folder, "out of memory");
        dataset->frames = frames;
        reader->capacity = capacity;
    }
    dataset->frames[dataset->frame_count++] = *frame;
    return RN_OK;
}

enum rn_status rn_reader_add(struct rn_reader *reader, struct rn_frame *frame,
                             enum rn_status status, struct rn_error *err) {
    if (status == RN_OK && (status = append(reader, frame, err)) == RN_OK) return RN_OK;
    enum rn_split split = frame->split;
    rn_frame_finish(frame);
    if (status == RN_ERROR_NO_MEMORY || reader->dataset->frame_count >= RN_DATASET_MAX_FRAMES)
        return status;
    rn_problems_add(reader->problems, RN_SEVERITY_ERROR, err->where, "%s", err->text);
    reader->dataset->unusable[split]++;
    return RN_OK;
}

void rn_reader_warn_unknown(struct rn_reader *reader, const struct rn_json *object,
                            const char *const *known) {
    const char *key;
    json_t *value;
    json_object_foreach((json_t *)object->value, key, value) {
        size_t i = 0;
        while (known[i] && strcmp(known[i], key) != 0)
            i++;
        if (known[i] || json_object_get(reader->reported, key)) continue;
        struct rn_json at = {value, object->file, object, key, 0};
        char where[256];
        rn_json_where(&at, where);
        rn_problems_add(
            reader->problems, RN_SEVERITY_WARNING, where,
            "is not a field of this layout; it is ignored, here and wherever it recurs");
        if (json_object_set_new(reader->reported, key, json_true()) != 0) return;
    }
}
