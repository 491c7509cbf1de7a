// transforms.json, as instant-ngp and nerfstudio write and read it: one document with intrinsics,
// for all frames or by frame, and camera-to-world poses in OpenGL axes.
//
// The two differ in what k3 and k4 mean, in whose intrinsics hold where a file gives both the
// file's and the frame's, and in photographs that are missing, without which instant-ngp goes on.
// Poses stay in the file's own coordinates: aabb_scale, scale, offset and applied_transform say how
// another program places the scene.
#include <stdlib.h>
#include <string.h>

#include "common/dataset/intrinsics.h"

#define DOCUMENT "transforms.json"

struct transforms {
    struct rn_intrinsics intrinsics;
    struct rn_json frames;
    size_t *order; // of the frames by file_path
    size_t left_out;
};

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

static bool is_listed(const json_t *list, const char *path) {
    for (size_t i = 0; i < json_array_size(list); i++) {
        const char *text = json_string_value(json_array_get(list, i));
        if (text && strcmp(without_dot(text), path) == 0) return true;
    }
    return false;
}

// The frame's split by the file's lists; RN_SPLIT_COUNT where there are lists and none has it.
static int split_of(const struct rn_json *root, const char *path) {
    static const char *const keys[] = {"train_filenames", "val_filenames", "test_filenames"};
    bool listed = false;
    for (int split = 0; split < RN_SPLIT_COUNT; split++) {
        const json_t *list = json_object_get(root->value, keys[split]);
        listed = listed || json_array_size(list) > 0;
        if (is_listed(list, path)) return split;
    }
    return listed ? RN_SPLIT_COUNT : RN_SPLIT_TRAIN;
}

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
        int split = split_of(&transforms->intrinsics.root, file_path(&transforms->frames, at));
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

static enum rn_status read_document(struct rn_reader *reader, const struct rn_json *root,
                                    void *context, struct rn_error *err) {
    struct transforms *transforms = context;
    transforms->intrinsics.root = *root;
    enum rn_status status =
        rn_json_array(root, "frames", 1, RN_DATASET_MAX_FRAMES, &transforms->frames, err);
    if (status) return status;
    rn_intrinsics_warn_unknown(reader, root, of_root);
    size_t count = json_array_size(transforms->frames.value);
    transforms->order = malloc(count * sizeof *transforms->order);
    if (!transforms->order)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, root->file, "out of memory");
    for (size_t i = 0; i < count; i++)
        transforms->order[i] = i;
    qsort_r(transforms->order, count, sizeof *transforms->order, compare_paths,
            &transforms->frames);
    status = read_frames(reader, transforms, err);
    if (status == RN_OK && transforms->left_out)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, root->file,
                        "%zu frames are in none of its lists of file names and are left out",
                        transforms->left_out);
    free(transforms->order);
    return status;
}

static enum rn_status read_ngp(struct rn_reader *reader, struct rn_error *err) {
    struct transforms transforms = {.intrinsics = {.frame_wins = true}};
    reader->missing_is_usual = true;
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
