// transforms.json, as instant-ngp and nerfstudio write and read it: one document with intrinsics,
// for all frames or by frame, and camera-to-world poses in OpenGL axes.
//
// The two differ in what k3 and k4 mean, in whose intrinsics hold where a file gives both the
// file's and the frame's, and in photographs that are missing, without which instant-ngp goes on.
// Poses stay in the file's own coordinates: aabb_scale, scale, offset and applied_transform say how
// another program places the scene. Nerfstudio's sparse points (ply_file_path) lie in the same.
#include <stdlib.h>
#include <string.h>

#include "common/dataset/intrinsics.h"
#include "common/dataset/ply.h"

#define DOCUMENT "transforms.json"

struct transforms {
    struct rn_intrinsics intrinsics;
    struct rn_json frames;
    size_t *order;  // of the frames by file_path
    json_t *listed; // splits by the file's lists of paths
    size_t left_out;
};

static const char *const list_names[RN_SPLIT_COUNT] = {"train_filenames", "val_filenames",
                                                       "test_filenames"};

static const char *const of_root[] = {"frames",
                                      "aabb_scale",
                                      "scale",
                                      "offset",
                                      "aabb",
                                      "render_aabb",
                                      "up",
                                      "n_frames",
                                      "sharpness_discard_threshold",
                                      "applied_transform",
                                      "applied_scale",
                                      "orientation_override",
                                      "fisheye_crop_radius",
                                      "train_filenames",
                                      "val_filenames",
                                      "test_filenames",
                                      "ply_file_path",
                                      "integer_depth_scale",
                                      "enable_depth_loading",
                                      "depth_unit_scale_factor",
                                      NULL};
static const char *const of_frame[] = {
    "file_path",  "transform_matrix", "sharpness", "colmap_im_id",
    "depth_path", "depth_file_path",  "mask_path", NULL};

// Of Windows' paths.
static void turn_slashes(json_t *text) {
    const char *from = json_string_value(text);
    char *path = from && strchr(from, '\\') ? strdup(from) : NULL;
    for (char *c = path; c && *c; c++)
        if (*c == '\\') *c = '/';
    if (path) (void)json_string_set(text, path);
    free(path);
}

static void turn_all_slashes(const struct transforms *transforms) {
    size_t i;
    json_t *frame, *text;
    json_array_foreach((json_t *)transforms->frames.value, i, frame)
        turn_slashes(json_object_get(frame, "file_path"));
    for (int split = 0; split < RN_SPLIT_COUNT; split++)
        json_array_foreach(json_object_get(transforms->intrinsics.root.value, list_names[split]), i,
                           text) turn_slashes(text);
}

static const char *without_dot(const char *path) {
    while (path[0] == '.' && path[1] == '/')
        path += 2;
    return path;
}

static const char *file_path(const struct rn_json *frames, size_t index) {
    const json_t *frame = json_array_get(frames->value, index);
    const char *text = json_string_value(json_object_get(frame, "file_path"));
    return text ? without_dot(text) : "";
}

static int compare_paths(const void *left, const void *right, void *context) {
    size_t a = *(const size_t *)left, b = *(const size_t *)right;
    int order = strcmp(file_path(context, a), file_path(context, b));
    return order ? order : (a > b) - (a < b);
}

// ---- splits by lists of file names ----

#define SEEN 8 // added to a path's split once a frame has it

static enum rn_status read_list(struct rn_reader *reader, const struct rn_json *root, int split,
                                json_t *listed, struct rn_error *err) {
    struct rn_json list;
    if (!rn_json_find(root, list_names[split], &list)) return RN_OK;
    if (!json_is_array(list.value))
        return rn_json_error(&list, RN_ERROR_INVALID, err, "must be a list of file names");
    for (size_t i = 0; i < json_array_size(list.value); i++) {
        struct rn_json element = rn_json_element(&list, i);
        const char *text = json_string_value(element.value);
        if (!text) return rn_json_error(&element, RN_ERROR_INVALID, err, "must be a file name");
        const json_t *other = json_object_get(listed, without_dot(text));
        char where[256];
        rn_json_where(&element, where);
        if (other && json_integer_value(other) != split && rn_reader_says(reader, "listed twice"))
            rn_problems_add(reader->problems, RN_SEVERITY_WARNING, where,
                            "\"%.100s\" is in %s too; what is in several lists belongs to test "
                            "before val before train",
                            text, list_names[json_integer_value(other)]);
        if (json_object_set_new(listed, without_dot(text), json_integer(split)) != 0)
            return rn_error_set(err, RN_ERROR_NO_MEMORY, root->file, "out of memory");
    }
    return RN_OK;
}

// The frame's split by the file's lists; RN_SPLIT_COUNT where there are lists and none has it.
static int split_of(const struct transforms *transforms, const char *path) {
    if (!json_object_size(transforms->listed)) return RN_SPLIT_TRAIN;
    json_t *listed = json_object_get(transforms->listed, path);
    if (!listed) return RN_SPLIT_COUNT;
    json_int_t split = json_integer_value(listed) % SEEN;
    (void)json_integer_set(listed, split + SEEN);
    return (int)split;
}

static void tell_lists(struct rn_reader *reader, const struct transforms *transforms) {
    const char *file = transforms->intrinsics.root.file, *path, *first = NULL;
    json_t *split;
    size_t unknown = 0;
    json_object_foreach(transforms->listed, path,
                        split) if (json_integer_value(split) < SEEN && !unknown++) first = path;
    if (unknown)
        rn_problems_add(
            reader->problems, RN_SEVERITY_WARNING, file,
            "%zu names in its lists of file names are no frame's, such as \"%.100s\" in "
            "%s",
            unknown, first,
            list_names[json_integer_value(json_object_get(transforms->listed, first))]);
    if (transforms->left_out)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, file,
                        "%zu frames are in none of its lists of file names and are left out",
                        transforms->left_out);
}

// ---- frames ----

static enum rn_status read_mask(struct rn_reader *reader, const struct rn_json *object,
                                struct rn_frame *frame, struct rn_error *err) {
    struct rn_json at;
    struct rn_frame mask = {0};
    if (!rn_json_find(object, "mask_path", &at)) return RN_OK;
    enum rn_status status = rn_reader_image(reader, object, "mask_path", "", &mask, err);
    if (status == RN_ERROR_NOT_FOUND) status = RN_ERROR_INVALID; // no photograph that is missing
    if (status) return status;
    frame->mask_path = mask.path;
    free(mask.name);
    return RN_OK;
}

static enum rn_status read_frame(struct rn_reader *reader, const struct transforms *transforms,
                                 struct rn_frame *frame, struct rn_error *err) {
    const struct rn_json *object = &transforms->intrinsics.frame;
    enum rn_status status =
        rn_reader_image(reader, object, "file_path", RN_ANY_EXTENSION, frame, err);
    if (status || (status = read_mask(reader, object, frame, err))) return status;
    if ((status = rn_intrinsics_read(reader, &transforms->intrinsics, frame, err)) ||
        (status = rn_reader_pose(object, "transform_matrix", frame->camera.world_from_camera, err)))
        return status;
    return rn_reader_check_camera(object, "transform_matrix", &frame->camera, err);
}

static enum rn_status read_frames(struct rn_reader *reader, struct transforms *transforms,
                                  struct rn_error *err) {
    int next[RN_SPLIT_COUNT] = {0};
    size_t count = json_array_size(transforms->frames.value);
    for (size_t i = 0; i < count; i++) {
        size_t at = transforms->order[i];
        int split = split_of(transforms, file_path(&transforms->frames, at));
        if (split == RN_SPLIT_COUNT) {
            transforms->left_out++;
            continue;
        }
        transforms->intrinsics.frame = rn_json_element(&transforms->frames, at);
        struct rn_frame frame = {
            .split = (enum rn_split)split, .index = next[split], .loss_weight = 1};
        struct rn_error why;
        enum rn_status status = read_frame(reader, transforms, &frame, &why);
        next[split] += !(status == RN_ERROR_NOT_FOUND && reader->missing_is_usual);
        if ((status = rn_reader_add(reader, &frame, status, &why))) {
            if (err) *err = why;
            return status;
        }
        rn_intrinsics_warn_unknown(reader, &transforms->intrinsics.frame, of_frame);
    }
    return RN_OK;
}

// The sparse points, in the frames' coordinates; without the file, the rest is read all the same.
static enum rn_status read_points(struct rn_reader *reader, const struct rn_json *root,
                                  struct rn_error *err) {
    struct rn_json at;
    char file[RN_FILE_NAME_MAX], where[256], *path;
    if (!rn_json_find(root, "ply_file_path", &at)) return RN_OK;
    rn_json_where(&at, where);
    enum rn_status status = rn_reader_locate(reader, root, "ply_file_path", file, err);
    if (status) return status;
    if (!rn_reader_has(reader, file)) {
        rn_problems_add(reader->problems, RN_SEVERITY_WARNING, where,
                        "names %.150s, which does not exist; there are no sparse points", file);
        return RN_OK;
    }
    if ((status = rn_reader_document(reader, file, &path, err))) return status;
    status = rn_ply_read(path, &reader->dataset->points, err);
    free(path);
    return status;
}

// A circle outside of which nerfstudio leaves a fisheye's pixels out.
static void tell_crop(struct rn_reader *reader, const struct rn_json *root) {
    struct rn_json at;
    char where[256];
    if (!rn_json_find(root, "fisheye_crop_radius", &at)) return;
    rn_json_where(&at, where);
    rn_problems_add(reader->problems, RN_SEVERITY_WARNING, where,
                    "is not followed: pixels outside of the circle are trained on too; give masks "
                    "that are black there to leave them out");
}

static enum rn_status sort_frames(struct transforms *transforms, struct rn_error *err) {
    size_t count = json_array_size(transforms->frames.value);
    transforms->order = malloc(count * sizeof *transforms->order);
    transforms->listed = json_object();
    if (!transforms->order || !transforms->listed)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, transforms->frames.file, "out of memory");
    for (size_t i = 0; i < count; i++)
        transforms->order[i] = i;
    qsort_r(transforms->order, count, sizeof *transforms->order, compare_paths,
            &transforms->frames);
    return RN_OK;
}

static enum rn_status read_document(struct rn_reader *reader, const struct rn_json *root,
                                    void *context, struct rn_error *err) {
    struct transforms *transforms = context;
    transforms->intrinsics.root = *root;
    enum rn_status status =
        rn_json_array(root, "frames", 1, RN_DATASET_MAX_FRAMES, &transforms->frames, err);
    if (status) return status;
    turn_all_slashes(transforms);
    rn_intrinsics_warn_unknown(reader, root, of_root);
    tell_crop(reader, root);
    status = sort_frames(transforms, err);
    for (int split = 0; split < RN_SPLIT_COUNT && status == RN_OK; split++)
        status = read_list(reader, root, split, transforms->listed, err);
    if (status == RN_OK) status = read_frames(reader, transforms, err);
    if (status == RN_OK) tell_lists(reader, transforms);
    if (status == RN_OK) status = read_points(reader, root, err);
    json_decref(transforms->listed);
    free(transforms->order);
    return status;
}

static enum rn_status read_ngp(struct rn_reader *reader, struct rn_error *err) {
    struct transforms transforms = {.intrinsics = {.frame_wins = true}};
    reader->missing_is_usual = reader->dynamic_masks = true;
    return rn_reader_json(reader, DOCUMENT, true, read_document, &transforms, err);
}

static enum rn_status read_nerfstudio(struct rn_reader *reader, struct rn_error *err) {
    struct transforms transforms = {.intrinsics = {.plain_polynomial = true}};
    return rn_reader_json(reader, DOCUMENT, true, read_document, &transforms, err);
}

const struct rn_format rn_format_ngp = {
    .name = "instant-ngp",
    .title = "instant-ngp",
    .signs = (const struct rn_sign[]){{DOCUMENT, "aabb_scale"}, {NULL, NULL}},
    .documents = (const char *const[]){DOCUMENT, NULL},
    .photo_folders = (const char *const[]){NULL},
    .read = read_ngp};

const struct rn_format rn_format_nerfstudio = {
    .name = "nerfstudio",
    .title = "nerfstudio",
    .signs = (const struct rn_sign[]){{DOCUMENT, NULL}, {NULL, NULL}},
    .documents = (const char *const[]){DOCUMENT, NULL},
    .photo_folders = (const char *const[]){NULL},
    .read = read_nerfstudio};
