#include "common/dataset/reader.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/names.h"
#include "common/dataset/photos.h"

#define SHAPE_TOLERANCE 0.01 // of the ratio of width to height

char *rn_reader_path(const struct rn_reader *reader, const char *name) {
    while (name[0] == '.' && name[1] == '/')
        name += 2;
    size_t size = strlen(reader->folder);
    while (size > 1 && reader->folder[size - 1] == '/')
        size--;
    char *path;
    return asprintf(&path, "%.*s/%s", (int)size, reader->folder, name) < 0 ? NULL : path;
}

enum rn_status rn_reader_document(struct rn_reader *reader, const char *name, char **ret_path,
                                  struct rn_error *err) {
    struct rn_dataset *dataset = reader->dataset;
    size_t count = dataset->document_count;
    char *path = rn_reader_path(reader, name), **grown = NULL;
    bool kept = false;
    for (size_t i = 0; i < count && !kept; i++)
        kept = strcmp(dataset->documents[i], name) == 0;
    if (!kept) grown = realloc(dataset->documents, (count + 1) * sizeof *grown);
    if (grown) {
        dataset->documents = grown;
        kept = (grown[count] = strdup(name)) != NULL;
        dataset->document_count += kept;
    }
    if (path && kept) {
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

const char *const rn_photo_folders[] = {"images", "images_2", "images_4", "images_8", NULL};
static const char *const extensions[] = {".png",  ".jpg",  ".jpeg", ".jfif", ".webp", ".tif",
                                         ".tiff", ".heic", ".heif", ".avif", ".exr",  NULL};

bool rn_reader_is_photo(const char *name) {
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && extensions[i]; i++)
        if (strcasecmp(dot, extensions[i]) == 0) return true;
    return false;
}

// The file's name without folder and extension, malloc'd.
static char *base_name(const char *path) {
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    size_t length = rn_reader_is_photo(name) ? (size_t)(strrchr(name, '.') - name) : strlen(name);
    return strndup(name, length);
}

bool rn_reader_has(const struct rn_reader *reader, const char *file) {
    char *path = rn_reader_path(reader, file);
    bool there = path && access(path, F_OK) == 0;
    free(path);
    return there;
}

// Whether "NAME.ext" or "NAME.EXT" is there, which is then *ret_file.
static bool has_either_case(const struct rn_reader *reader, const char *stem, size_t size,
                            const char *extension, char ret_file[RN_FILE_NAME_MAX]) {
    char file[RN_FILE_NAME_MAX];
    for (int upper = 0; upper < 2; upper++) {
        snprintf(file, sizeof file, "%.*s%s", (int)size, stem, extension);
        for (char *c = file + size; size < sizeof file && *c; c++)
            *c = (char)(upper ? toupper((unsigned char)*c) : tolower((unsigned char)*c));
        if (!rn_reader_has(reader, file)) continue;
        snprintf(ret_file, RN_FILE_NAME_MAX, "%s", file);
        return true;
    }
    return false;
}

// The file that the name stands for: as it is written where that is there, else with its extension
// in another case or, where it has none of an image, with `extension`; with RN_ANY_EXTENSION, one
// by which the file is there, else ".png".
static bool put_extension(const struct rn_reader *reader, const char *name, const char *extension,
                          char file[RN_FILE_NAME_MAX]) {
    bool any = strcmp(extension, RN_ANY_EXTENSION) == 0, whole = rn_reader_is_photo(name);
    const char *dot = whole ? strrchr(name, '.') : name + strlen(name), *wanted = extension;
    if (whole || any) wanted = whole ? dot : extensions[0];
    snprintf(file, RN_FILE_NAME_MAX, "%s", name);
    if (strrchr(name, '.') > strrchr(name, '/') && rn_reader_has(reader, file)) return true;
    snprintf(file, RN_FILE_NAME_MAX, "%.*s%s", (int)(dot - name), name, wanted);
    bool found = has_either_case(reader, name, (size_t)(dot - name), wanted, file);
    for (size_t i = 0; any && !whole && !found && extensions[i]; i++)
        found = has_either_case(reader, name, (size_t)(dot - name), extensions[i], file);
    return found;
}

// A photograph of full size that is not there, among those made smaller.
static bool find_smaller(struct rn_reader *reader, const char *where, const char *name,
                         const char *extension, char file[RN_FILE_NAME_MAX]) {
    size_t size = strlen(rn_photo_folders[0]);
    char other[RN_FILE_NAME_MAX + 16], there[RN_FILE_NAME_MAX];
    if (strncmp(name, rn_photo_folders[0], size) != 0 || name[size] != '/') return false;
    for (const char *const *folder = rn_photo_folders + 1; *folder; folder++) {
        snprintf(other, sizeof other, "%s%s", *folder, name + size);
        if (strlen(other) >= RN_FILE_NAME_MAX || !put_extension(reader, other, extension, there))
            continue;
        if (rn_reader_says(reader, "smaller"))
            rn_problems_add(reader->problems, RN_SEVERITY_INFO, where,
                            "\"%.150s\" is not there; %.150s is taken, and so are others of that "
                            "folder",
                            name, there);
        strcpy(file, there);
        return true;
    }
    return false;
}

// Where a path's part within the dataset's folder may begin: behind its last "..", and behind the
// root of another machine. *ret_fault: why the path does not stand for itself, or NULL.
static const char *inner_part(const char *name, const char **ret_fault) {
    const char *inner = name;
    bool drive = isalpha((unsigned char)name[0]) && name[1] == ':';
    *ret_fault = NULL;
    if (name[0] == '/' || drive) {
        *ret_fault = "is an absolute path; name files relative to the dataset's folder";
        inner = name + (drive ? 2 : 0);
        inner += strspn(inner, "/");
    }
    for (const char *part = name; part; part = strchr(part, '/')) {
        part += *part == '/';
        if (part[0] != '.' || part[1] != '.' || (part[2] != '/' && part[2])) continue;
        *ret_fault = "leaves the dataset's folder with \"..\"";
        inner = part + 2 + (part[2] == '/');
    }
    return inner;
}

static enum rn_status check_characters(const char *name, const char *where, struct rn_error *err) {
    size_t length = strlen(name);
    const char *fault = length == 0 || name[length - 1] == '/' ? "names no file" : NULL;
    if (length >= RN_FILE_NAME_MAX - 8) fault = "is too long";
    for (const char *c = name; *c; c++)
        if ((unsigned char)*c < 0x20 || *c == 0x7f) fault = "holds a control character";
    if (!fault) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, where, "\"%.200s\" %s", name, fault);
}

// The file by the longest end of its path, from `end` on, that is there.
static bool find_by_end(struct rn_reader *reader, const char *where, const char *named,
                        const char *end, const char *extension, char file[RN_FILE_NAME_MAX]) {
    for (; end && *end; end = strchr(end, '/')) {
        end += strspn(end, "/");
        if (!*end || !put_extension(reader, end, extension, file)) continue;
        if (!reader->told_moved)
            rn_problems_add(reader->problems, RN_SEVERITY_INFO, where,
                            "\"%.200s\" is not in the folder; %.200s, found by its name, is "
                            "taken, and so are others that are named so",
                            named, file);
        reader->told_moved = true;
        return true;
    }
    return false;
}

// The file, relative to the folder, that a document calls `named`. One that is not there, or lies
// outside, as paths of another machine do, is looked for by the longest end of its path.
static enum rn_status locate(struct rn_reader *reader, const char *where, const char *named,
                             const char *extension, char file[RN_FILE_NAME_MAX],
                             struct rn_error *err) {
    char name[RN_FILE_NAME_MAX];
    const char *fault;
    enum rn_status status = check_characters(named, where, err);
    if (status) return status;
    strcpy(name, named);
    for (char *c = name; *c; c++)
        if (*c == '\\') *c = '/';
    const char *inner = inner_part(name, &fault);
    if (!fault) {
        const char *plain = name;
        while (plain[0] == '.' && plain[1] == '/')
            plain += 2;
        if (!put_extension(reader, plain, extension, file) &&
            !find_smaller(reader, where, plain, extension, file) &&
            !find_by_end(reader, where, named, strchr(plain, '/'), extension, file))
            (void)put_extension(reader, plain, extension, file);
        return RN_OK;
    }
    if (find_by_end(reader, where, named, inner, extension, file)) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, where, "\"%.200s\" %s", named, fault);
}

bool rn_reader_leads_nowhere(const char *path) {
    struct stat info;
    return stat(path, &info) != 0 && lstat(path, &info) == 0 && S_ISLNK(info.st_mode);
}

static enum rn_status probe(const char *where, const char *path, struct rn_image_info *ret_info,
                            struct rn_error *err) {
    struct stat info;
    if (stat(path, &info) != 0)
        return rn_error_set(err, RN_ERROR_NOT_FOUND, where, "names %s, which does not exist%s",
                            path, rn_reader_leads_nowhere(path) ? ": " RN_LEADS_NOWHERE : "");
    if (!S_ISREG(info.st_mode))
        return rn_error_set(err, RN_ERROR_INVALID, where, "names %s, which is no regular file",
                            path);
    struct rn_error inner;
    enum rn_status status = rn_image_probe(path, &rn_image_default_limits, ret_info, &inner);
    if (status) return rn_error_set(err, status, where, "names %s: %s", path, inner.text);
    return RN_OK;
}

// Said once each: it is no fault, and as a rule all images are alike.
static void tell_kind(struct rn_reader *reader, const char *where,
                      const struct rn_image_info *info) {
    if (info->linear && rn_reader_says(reader, "linear"))
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, where,
                        "names an image of linear light; it is clamped to 0 to 1, put through "
                        "sRGB's curve and rounded to 8 bits, as others are");
    else if (!info->linear && info->bit_depth > 8 && rn_reader_says(reader, "deep"))
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, where,
                        "names an image of %d bits a channel; it is rounded to 8, as others are",
                        info->bit_depth);
}

// What the file's EXIF says of the camera, or that of the photograph which the file is a copy of.
static void take_exif(const struct rn_reader *reader, const struct rn_image_info *own,
                      struct rn_frame *frame) {
    const struct rn_photos *taken = reader->options ? reader->options->taken : NULL;
    const struct rn_image_info *info = own;
    for (size_t i = 0; taken && i < taken->count && info == own; i++)
        if (rn_photo_is_at(&taken->items[i], frame->path)) info = &taken->items[i].info;
    frame->camera_key = info->camera_key;
    frame->located = info->located;
    memcpy(frame->located_at, info->located_at, sizeof info->located_at);
}

enum rn_status rn_reader_photo(struct rn_reader *reader, const char *where, const char *named,
                               const char *extension, struct rn_frame *frame,
                               struct rn_error *err) {
    char file[RN_FILE_NAME_MAX];
    struct rn_image_info info;
    enum rn_status status = locate(reader, where, named, extension, file, err);
    if (status) return status;
    frame->name = base_name(file);
    frame->path = rn_reader_path(reader, file);
    if (!frame->name || !frame->path)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, where, "out of memory");
    else
        status = probe(where, frame->path, &info, err);
    if (status) {
        rn_frame_finish(frame);
        return status;
    }
    tell_kind(reader, where, &info);
    frame->held = info.orientation;
    take_exif(reader, &info, frame);
    frame->has_alpha = info.has_alpha;
    frame->camera.width = info.width;
    frame->camera.height = info.height;
    return RN_OK;
}

// A member that names a file, and where it stands.
static enum rn_status file_member(const struct rn_json *object, const char *key,
                                  const char **ret_text, char ret_where[256],
                                  struct rn_error *err) {
    struct rn_json at;
    enum rn_status status = rn_json_text(object, key, RN_FILE_NAME_MAX - 1, ret_text, err);
    if (status == RN_OK) status = rn_json_member(object, key, &at, err);
    if (status == RN_OK) rn_json_where(&at, ret_where);
    return status;
}

enum rn_status rn_reader_locate(struct rn_reader *reader, const struct rn_json *object,
                                const char *key, char file[RN_FILE_NAME_MAX],
                                struct rn_error *err) {
    const char *text;
    char where[256];
    enum rn_status status = file_member(object, key, &text, where, err);
    return status ? status : locate(reader, where, text, "", file, err);
}

enum rn_status rn_reader_image(struct rn_reader *reader, const struct rn_json *object,
                               const char *key, const char *extension, struct rn_frame *frame,
                               struct rn_error *err) {
    const char *text;
    char where[256];
    enum rn_status status = file_member(object, key, &text, where, err);
    return status ? status : rn_reader_photo(reader, where, text, extension, frame, err);
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
                                      struct rn_camera *camera, struct rn_error *err) {
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
    reader->dataset->unusable[split]++;
    if (status == RN_ERROR_NOT_FOUND) {
        if (!reader->missing_count++) reader->missing = *err;
        reader->last_missing = *err;
        return RN_OK;
    }
    bool same =
        strcmp(reader->fault.where, err->where) == 0 && strcmp(reader->fault.text, err->text) == 0;
    reader->fault = *err;
    if (!same) rn_problems_add(reader->problems, RN_SEVERITY_ERROR, err->where, "%s", err->text);
    return RN_OK;
}

void rn_reader_tell_missing(struct rn_reader *reader) {
    size_t others = reader->missing_count - 1;
    enum rn_severity severity = reader->missing_is_usual ? RN_SEVERITY_WARNING : RN_SEVERITY_ERROR;
    if (reader->missing_count == 1)
        rn_problems_add(reader->problems, severity, reader->missing.where, "%s",
                        reader->missing.text);
    else if (reader->missing_count)
        rn_problems_add(reader->problems, severity, reader->missing.where,
                        "%.180s; neither do %zu others that are named, the last at %.120s",
                        reader->missing.text, others, reader->last_missing.where);
}

// Poses belong to the pixels that their finder saw. Nearly all of them see the pixels as stored,
// whatever EXIF says of how the camera was held; one that turned the picture upright says so by
// width and height.
static void settle_orientation(struct rn_reader *reader, const char *where, double width,
                               double height, struct rn_frame *frame) {
    struct rn_camera *camera = &frame->camera;
    double stored = fabs(camera->width / width * height / camera->height - 1);
    double upright = fabs(camera->height / width * height / camera->width - 1);
    bool turn = frame->held >= 5 && stored > SHAPE_TOLERANCE && upright <= SHAPE_TOLERANCE;
    if (frame->held > 1 && rn_reader_says(reader, turn ? "turned" : "held"))
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, where,
                        turn
                            ? "says %gx%g pixels, %s has %dx%d of them and an EXIF orientation of "
                              "%d: it is turned upright, and so are others like it"
                            : "says %gx%g pixels, as %s has (%dx%d), whose EXIF orientation is %d: "
                              "its pixels are taken as they are stored, as the poses' finder saw "
                              "them, and so are others' like it",
                        width, height, frame->path, camera->width, camera->height, frame->held);
    if (turn) {
        int stored_width = camera->width;
        camera->width = camera->height;
        camera->height = stored_width;
    }
    frame->turn = turn ? frame->held : 1;
}

enum rn_status rn_reader_fit(struct rn_reader *reader, const char *where, double width,
                             double height, struct rn_frame *frame, struct rn_error *err) {
    settle_orientation(reader, where, width, height, frame);
    struct rn_camera *camera = &frame->camera;
    double across = camera->width / width, down = camera->height / height;
    if (!(fabs(across / down - 1) <= SHAPE_TOLERANCE))
        return rn_error_set(err, RN_ERROR_INVALID, where, "says %gx%g pixels, %s is %dx%d", width,
                            height, frame->path, camera->width, camera->height);
    reader->resized = reader->resized == 0 || reader->resized == across ? across : NAN;
    camera->fx *= across;
    camera->cx *= across;
    camera->fy *= down;
    camera->cy *= down;
    if ((across != 1 || down != 1) && rn_reader_says(reader, "size"))
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, where,
                        "says %gx%g pixels, %s is %dx%d; focal lengths and principal point are "
                        "scaled to the image's size, here and wherever sizes differ",
                        width, height, frame->path, camera->width, camera->height);
    return RN_OK;
}

bool rn_reader_says(struct rn_reader *reader, const char *what) {
    if (json_object_get(reader->reported, what)) return false;
    return json_object_set_new(reader->reported, what, json_true()) == 0;
}

void rn_reader_warn_unknown(struct rn_reader *reader, const struct rn_json *object,
                            const char *const *known) {
    const char *key;
    json_t *value;
    json_object_foreach((json_t *)object->value, key, value) {
        if (rn_name_index(known, key) >= 0 || !rn_reader_says(reader, key)) continue;
        struct rn_json at = {value, object->file, object, key, 0};
        char where[256];
        rn_json_where(&at, where);
        rn_problems_add(
            reader->problems, RN_SEVERITY_WARNING, where,
            "is not a field of this layout; it is ignored, here and wherever it recurs");
    }
}
