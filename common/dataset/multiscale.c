// Multi-scale Blender: metadata.json, for each split an object of parallel arrays, image-major
// then scale; poses in OpenGL axes.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/reader.h"

// One split's arrays; `optional` ones may be absent (value NULL).
struct columns {
    struct rn_json file_path, cam2world, width, height, focal, label;
    struct rn_json lossmult, pix2cam; // optional
};

static enum rn_status find_columns(const struct rn_json *split, struct columns *columns,
                                   size_t *ret_count, struct rn_error *err) {
    struct rn_json *const all[] = {&columns->file_path, &columns->cam2world, &columns->width,
                                   &columns->height,    &columns->focal,     &columns->label,
                                   &columns->lossmult,  &columns->pix2cam};
    static const char *const keys[] = {"file_path", "cam2world", "width",    "height",
                                       "focal",     "label",     "lossmult", "pix2cam"};
    size_t count = 0;
    for (size_t i = 0; i < 8; i++) {
        if (i >= 6 && !rn_json_find(split, keys[i], all[i])) continue;
        enum rn_status status =
            rn_json_array(split, keys[i], 0, RN_DATASET_MAX_FRAMES, all[i], err);
        if (status) return status;
        size_t size = json_array_size(all[i]->value);
        if (i == 0) count = size;
        if (size != count)
            return rn_json_error(all[i], RN_ERROR_INVALID, err,
                                 "has %zu elements, file_path has %zu", size, count);
    }
    *ret_count = count;
    return RN_OK;
}

static enum rn_status read_intrinsics(struct rn_reader *reader, const struct columns *columns,
                                      size_t i, struct rn_frame *frame, struct rn_error *err) {
    struct rn_camera *camera = &frame->camera;
    struct rn_json width_at = rn_json_element(&columns->width, i),
                   height_at = rn_json_element(&columns->height, i),
                   focal_at = rn_json_element(&columns->focal, i);
    int width, height;
    enum rn_status status;
    if ((status = rn_json_integer(&width_at, NULL, 1, RN_CAMERA_MAX_SIZE, &width, err)) ||
        (status = rn_json_integer(&height_at, NULL, 1, RN_CAMERA_MAX_SIZE, &height, err)) ||
        (status = rn_json_number(&focal_at, NULL, 1e-6, 1e9, &camera->fx, err)))
        return status;
    if (width != camera->width || height != camera->height)
        return rn_json_error(width != camera->width ? &width_at : &height_at, RN_ERROR_INVALID, err,
                             "%s is %dx%d pixels, the file says %dx%d", frame->path, camera->width,
                             camera->height, width, height);
    camera->fy = camera->fx;
    camera->cx = 0.5 * width;
    camera->cy = 0.5 * height;
    if (!columns->pix2cam.value) return RN_OK;
    struct rn_json pix2cam_at = rn_json_element(&columns->pix2cam, i);
    double pix2cam[3][3];
    if ((status = rn_json_matrix(&pix2cam_at, NULL, 3, 3, &pix2cam[0][0], err))) return status;
    if (fabs(pix2cam[0][0] * camera->fx - 1) <= 1e-3) return RN_OK;
    char where[256];
    rn_json_where(&pix2cam_at, where);
    rn_problems_add(reader->problems, RN_SEVERITY_WARNING, where,
                    "gives the focal length %g, the field focal %g; the latter is used",
                    1 / pix2cam[0][0], camera->fx);
    return RN_OK;
}

// "000_d1" at scale 1 is the view "000".
static void strip_scale(char *name, int scale) {
    char *mark = strrchr(name, '_');
    if (mark && mark != name && mark[1] == 'd' && atoi(mark + 2) == scale) *mark = 0;
}

static enum rn_status read_frame(struct rn_reader *reader, const struct columns *columns, size_t i,
                                 struct rn_frame *frame, struct rn_error *err) {
    struct rn_json file_at = rn_json_element(&columns->file_path, i),
                   pose_at = rn_json_element(&columns->cam2world, i);
    enum rn_status status = rn_reader_image(reader, &file_at, NULL, "", frame, err);
    if (status) return status;
    strip_scale(frame->name, frame->scale);
    frame->loss_weight = ldexp(1, 2 * frame->scale);
    if (columns->lossmult.value) {
        struct rn_json weight_at = rn_json_element(&columns->lossmult, i);
        if ((status = rn_json_number(&weight_at, NULL, 1e-6, 1e9, &frame->loss_weight, err)))
            return status;
    }
    if ((status = read_intrinsics(reader, columns, i, frame, err)) ||
        (status = rn_reader_pose(&pose_at, NULL, frame->camera.world_from_camera, err)))
        return status;
    return rn_reader_check_camera(&pose_at, NULL, &frame->camera, err);
}

// A new view begins where the label does not rise.
static enum rn_status read_split(struct rn_reader *reader, const struct rn_json *object,
                                 enum rn_split split, struct rn_error *err) {
    static const char *const known[] = {"file_path", "cam2world", "width", "height",
                                        "focal",     "label",     "near",  "far",
                                        "lossmult",  "pix2cam",   NULL};
    struct columns columns = {0};
    size_t count = 0;
    enum rn_status status = find_columns(object, &columns, &count, err);
    rn_reader_warn_unknown(reader, object, known);
    int index = -1, previous = RN_DATASET_MAX_SCALE;
    for (size_t i = 0; status == RN_OK && i < count; i++) {
        struct rn_json label_at = rn_json_element(&columns.label, i);
        struct rn_frame frame = {.split = split};
        struct rn_error why;
        status = rn_json_integer(&label_at, NULL, 0, RN_DATASET_MAX_SCALE, &frame.scale, err);
        if (status) return status;
        index += frame.scale <= previous;
        previous = frame.scale;
        frame.index = index;
        status = read_frame(reader, &columns, i, &frame, &why);
        if ((status = rn_reader_add(reader, &frame, status, &why)) && err) *err = why;
    }
    return status;
}

static enum rn_status read_document(struct rn_reader *reader, const struct rn_json *root,
                                    void *context, struct rn_error *err) {
    if (!json_is_object(root->value))
        return rn_json_error(root, RN_ERROR_INVALID, err, "must be an object");
    rn_reader_warn_unknown(reader, root, rn_split_names);
    for (int split = 0; split < RN_SPLIT_COUNT; split++) {
        struct rn_json object;
        if (!rn_json_find(root, rn_split_names[split], &object)) {
            rn_problems_add(reader->problems, RN_SEVERITY_INFO, root->file, "has no %s split",
                            rn_split_names[split]);
            continue;
        }
        enum rn_status status = read_split(reader, &object, (enum rn_split)split, err);
        if (status) return status;
    }
    return RN_OK;
}

static enum rn_status read_multiscale(struct rn_reader *reader, struct rn_error *err) {
    reader->dataset->premultiplied_scales = false; // as the published converter averages
    return rn_reader_json(reader, "metadata.json", false, read_document, NULL, err);
}

const struct rn_format rn_format_multiscale = {
    .name = "multiscale",
    .title = "multi-scale Blender",
    .signs = (const struct rn_sign[]){{"metadata.json", NULL}, {NULL, NULL}},
    .documents = (const char *const[]){"metadata.json", NULL},
    .photo_folders = (const char *const[]){NULL},
    .sphere = RN_BLENDER_SPHERE,
    .read = read_multiscale};
