// The dataset.json that import writes.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/points.h"
#include "common/dataset/reader.h"
#include "common/math/vector.h"

// Both or neither.
static enum rn_status read_depths(const struct rn_json *object, struct rn_frame *frame,
                                  struct rn_error *err) {
    struct rn_json near, far;
    if (!rn_json_find(object, "near", &near) && !rn_json_find(object, "far", &far)) return RN_OK;
    enum rn_status status = rn_json_number(object, "near", 1e-12, 1e12, &frame->near, err);
    return status ? status : rn_json_number(object, "far", frame->near, 1e12, &frame->far, err);
}

static enum rn_status read_mask(struct rn_reader *reader, const struct rn_json *object,
                                struct rn_frame *frame, struct rn_error *err) {
    struct rn_json at;
    struct rn_frame mask = {0};
    if (!rn_json_find(object, "mask", &at)) return RN_OK;
    enum rn_status status = rn_reader_image(reader, object, "mask", "", &mask, err);
    if (status) return status;
    frame->mask_path = mask.path;
    free(mask.name);
    return RN_OK;
}

static enum rn_status read_gain(const struct rn_json *object, struct rn_frame *frame,
                                struct rn_error *err) {
    struct rn_json at;
    if (!rn_json_find(object, "gain", &at)) return RN_OK;
    enum rn_status status = rn_json_matrix(object, "gain", 0, 3, frame->gain, err);
    for (int c = 0; c < 3 && status == RN_OK; c++)
        if (!(frame->gain[c] > 1e-3 && frame->gain[c] < 1e3))
            status = rn_json_error(&at, RN_ERROR_INVALID, err, "must be three factors near 1");
    return status;
}

static enum rn_status read_light(const struct rn_json *object, struct rn_frame *frame,
                                 struct rn_error *err) {
    struct rn_json at;
    if (!rn_json_find(object, "light", &at)) return RN_OK;
    return rn_json_number(object, "light", 0, 10, &frame->light, err);
}

static enum rn_status read_points(struct rn_reader *reader, const struct rn_json *root,
                                  struct rn_error *err) {
    struct rn_json at;
    char *path;
    if (!rn_json_find(root, "points", &at)) return RN_OK;
    static const char *const files[] = {RN_POINTS_DOCUMENT};
    int only;
    enum rn_status status = rn_json_choice(root, "points", files, 1, &only, err);
    if (status || (status = rn_reader_document(reader, RN_POINTS_DOCUMENT, &path, err)))
        return status;
    status = rn_points_read(path, &reader->dataset->points, err);
    free(path);
    if (status || !rn_json_find(root, "points_found", &at)) return status;
    return rn_json_boolean(root, "points_found", &reader->dataset->points.found, err);
}

static enum rn_status read_frame(struct rn_reader *reader, const struct rn_json *object,
                                 struct rn_frame *frame, struct rn_error *err) {
    static const char *const known[] = {"name",        "file",   "split", "index", "scale",
                                        "loss_weight", "camera", "near",  "far",   "mask",
                                        "photo",       "gain",   "light", NULL};
    struct rn_json camera_at, photo_at;
    struct rn_camera camera;
    const char *name;
    int split;
    enum rn_status status;
    if ((status = rn_json_choice(object, "split", rn_split_names, RN_SPLIT_COUNT, &split, err)))
        return status;
    frame->split = (enum rn_split)split;
    if ((status = rn_json_refuse_unknown(object, known, err)) ||
        (status = rn_json_integer(object, "index", 0, RN_DATASET_MAX_FRAMES, &frame->index, err)) ||
        (status = rn_json_integer(object, "scale", 0, RN_DATASET_MAX_SCALE, &frame->scale, err)) ||
        (status = rn_json_number(object, "loss_weight", 1e-6, 1e9, &frame->loss_weight, err)) ||
        (status = rn_json_member(object, "camera", &camera_at, err)) ||
        (status = rn_json_camera(&camera_at, &camera, err)) ||
        (status = rn_json_text(object, "name", RN_FILE_NAME_MAX, &name, err)) ||
        (status = rn_reader_image(reader, object, "file", "", frame, err)))
        return status;
    if ((status = read_depths(object, frame, err)) ||
        (status = read_mask(reader, object, frame, err)) ||
        (status = read_gain(object, frame, err)) || (status = read_light(object, frame, err)) ||
        (rn_json_find(object, "photo", &photo_at) &&
         (status =
              rn_json_integer(object, "photo", 0, RN_DATASET_MAX_FRAMES, &frame->photo, err)))) {
        rn_frame_finish(frame);
        return status;
    }
    if (camera.width != frame->camera.width || camera.height != frame->camera.height)
        return rn_json_error(&camera_at, RN_ERROR_INVALID, err, "says %dx%d pixels, %s is %dx%d",
                             camera.width, camera.height, frame->path, frame->camera.width,
                             frame->camera.height);
    frame->camera = camera;
    free(frame->name);
    frame->name = strdup(name);
    return frame->name ? RN_OK : rn_json_error(object, RN_ERROR_NO_MEMORY, err, "out of memory");
}

static enum rn_status read_frames(struct rn_reader *reader, const struct rn_json *root,
                                  struct rn_error *err) {
    struct rn_json frames;
    enum rn_status status = rn_json_array(root, "frames", 0, RN_DATASET_MAX_FRAMES, &frames, err);
    for (size_t i = 0; status == RN_OK && i < json_array_size(frames.value); i++) {
        struct rn_json object = rn_json_element(&frames, i);
        struct rn_frame frame = {0};
        struct rn_error why;
        status = read_frame(reader, &object, &frame, &why);
        if ((status = rn_reader_add(reader, &frame, status, &why)) && err) *err = why;
    }
    return status;
}

static enum rn_status read_bounds(const struct rn_json *root, struct rn_bounds *bounds,
                                  struct rn_error *err) {
    static const char *const known[] = {"centre", "radius", "source", NULL};
    struct rn_json object;
    int source;
    enum rn_status status;
    if ((status = rn_json_member(root, "bounds", &object, err)) ||
        (status = rn_json_refuse_unknown(&object, known, err)) ||
        (status = rn_json_matrix(&object, "centre", 0, 3, bounds->centre, err)) ||
        (status = rn_json_number(&object, "radius", RN_BOUNDS_LEAST, RN_BOUNDS_MOST,
                                 &bounds->radius, err)) ||
        (status = rn_json_choice(&object, "source", rn_bounds_source_names, RN_BOUNDS_SOURCES,
                                 &source, err)))
        return status;
    bounds->source = (enum rn_bounds_source)source;
    return RN_OK;
}

static enum rn_status read_crop(const struct rn_json *lie, struct rn_lie *ret,
                                struct rn_error *err) {
    static const char *const known[] = {"low", "high", NULL};
    struct rn_json object;
    ret->cropped = rn_json_find(lie, "crop", &object);
    if (!ret->cropped) return RN_OK;
    enum rn_status status;
    if ((status = rn_json_refuse_unknown(&object, known, err)) ||
        (status = rn_json_matrix(&object, "low", 0, 3, ret->crop.low, err)))
        return status;
    return rn_json_matrix(&object, "high", 0, 3, ret->crop.high, err);
}

// Datasets of before the similarity was kept have none.
static enum rn_status read_lie(const struct rn_json *root, struct rn_lie *lie,
                               struct rn_error *err) {
    static const char *const known[] = {"kind", "up", "up_given", "crop", NULL};
    struct rn_json object;
    int kind;
    enum rn_status status;
    if (!rn_json_find(root, "lie", &object)) return RN_OK;
    if ((status = rn_json_refuse_unknown(&object, known, err)) ||
        (status =
             rn_json_choice(&object, "kind", rn_capture_names, RN_CAPTURE_KINDS, &kind, err)) ||
        (status = rn_json_matrix(&object, "up", 0, 3, lie->up, err)) ||
        (status = rn_json_boolean(&object, "up_given", &lie->up_given, err)) ||
        (status = read_crop(&object, lie, err)))
        return status;
    lie->kind = (enum rn_capture_kind)kind;
    if (!(fabs(rn_dot(lie->up, lie->up) - 1) < 1e-6))
        return rn_json_error(&object, RN_ERROR_INVALID, err,
                             "has an \"up\" of another length than 1");
    lie->known = true;
    return RN_OK;
}

static enum rn_status read_source(const struct rn_json *root, struct rn_dataset *dataset,
                                  struct rn_error *err) {
    static const char *const known[] = {"layout", "downscale", NULL};
    struct rn_json object;
    const char *layout;
    int downscale;
    enum rn_status status;
    if ((status = rn_json_member(root, "source", &object, err)) ||
        (status = rn_json_refuse_unknown(&object, known, err)) ||
        (status = rn_json_text(&object, "layout", RN_FORMAT_NAME_MAX, &layout, err)) ||
        (status = rn_json_choice(&object, "downscale", rn_downscale_names, 2, &downscale, err)))
        return status;
    dataset->premultiplied_scales = downscale == RN_DOWNSCALE_PREMULTIPLIED;
    return RN_OK;
}

// The colour of the backdrop that an import cut the photographs out of.
static enum rn_status read_backdrop(const struct rn_json *root, struct rn_dataset *dataset,
                                    struct rn_error *err) {
    struct rn_json at;
    struct rn_backdrop backdrop = {.known = true};
    double colour[3];
    if (!rn_json_find(root, "backdrop", &at)) return RN_OK;
    enum rn_status status = rn_json_matrix(root, "backdrop", 0, 3, colour, err);
    for (int c = 0; c < 3 && status == RN_OK; c++) {
        backdrop.colour[c] = (uint8_t)fmin(255, fmax(0, colour[c]));
        if (backdrop.colour[c] != colour[c])
            status = rn_json_error(&at, RN_ERROR_INVALID, err, "must be three of 0 to 255");
    }
    for (size_t f = 0; f < dataset->frame_count && status == RN_OK; f++)
        dataset->frames[f].backdrop = backdrop;
    return status;
}

static enum rn_status read_document(struct rn_reader *reader, const struct rn_json *root,
                                    void *context, struct rn_error *err) {
    static const char *const known[] = {"format", "version",  "name",   "source",
                                        "bounds", "lie",      "points", "points_found",
                                        "frames", "backdrop", NULL};
    static const char *const formats[] = {RN_NATIVE_FORMAT};
    struct rn_dataset *dataset = reader->dataset;
    const char *name;
    int ignored;
    enum rn_status status;
    if ((status = rn_json_choice(root, "format", formats, 1, &ignored, err)) ||
        (status = rn_json_integer(root, "version", RN_NATIVE_VERSION, RN_NATIVE_VERSION, &ignored,
                                  err)) ||
        (status = rn_json_refuse_unknown(root, known, err)) ||
        (status = rn_json_text(root, "name", RN_FILE_NAME_MAX, &name, err)) ||
        (status = read_source(root, dataset, err)) ||
        (status = read_bounds(root, &dataset->bounds, err)) ||
        (status = read_lie(root, &dataset->lie, err)) || (status = read_points(reader, root, err)))
        return status;
    free(dataset->name);
    dataset->name = strdup(name);
    if (!dataset->name) return rn_json_error(root, RN_ERROR_NO_MEMORY, err, "out of memory");
    status = read_frames(reader, root, err);
    return status ? status : read_backdrop(root, dataset, err);
}

static enum rn_status read_native(struct rn_reader *reader, struct rn_error *err) {
    return rn_reader_json(reader, RN_NATIVE_DOCUMENT, false, read_document, NULL, err);
}

const struct rn_format rn_format_native = {
    .name = "native",
    .title = "ripnerf",
    .signs = (const struct rn_sign[]){{RN_NATIVE_DOCUMENT, NULL}, {NULL, NULL}},
    .documents = (const char *const[]){RN_NATIVE_DOCUMENT, RN_POINTS_DOCUMENT, NULL},
    .photo_folders = (const char *const[]){NULL},
    .read = read_native};
