// NeRF-synthetic: transforms_{train,val,test}.json. The image's size comes from its header;
// focal = W/2 / tan(camera_angle_x / 2); poses in OpenGL axes.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "common/dataset/intrinsics.h"

#define MAX_ANGLE 3.1

struct document {
    struct rn_json root;
    double angle_x;    // radians
    int width, height; // as the file says, or those of its first image; 0 = not known yet
    bool stated;       // the file gives width and height
    bool more;         // and intrinsics beyond camera_angle_x
};

static enum rn_status read_frame(struct rn_reader *reader, struct document *document,
                                 const struct rn_json *object, struct rn_frame *frame,
                                 struct rn_error *err) {
    enum rn_status status = rn_reader_image(reader, object, "file_path", ".png", frame, err);
    if (status) return status;
    struct rn_camera *camera = &frame->camera;
    bool differs =
        document->width && (camera->width != document->width || camera->height != document->height);
    if (differs && document->stated)
        return rn_json_error(object, RN_ERROR_INVALID, err,
                             "%s is %dx%d pixels, the file says %dx%d", frame->path, camera->width,
                             camera->height, document->width, document->height);
    if (differs) {
        char where[256];
        rn_json_where(object, where);
        rn_problems_add(reader->problems, RN_SEVERITY_WARNING, where,
                        "%s is %dx%d pixels, the first image %dx%d; camera_angle_x is taken to "
                        "hold for both",
                        frame->path, camera->width, camera->height, document->width,
                        document->height);
    }
    if (!document->width) {
        document->width = camera->width;
        document->height = camera->height;
    }
    if (document->more || rn_intrinsics_given(object)) {
        struct rn_intrinsics from = {
            .root = document->root, .frame = *object, .frame_wins = true, .plain_polynomial = true};
        if ((status = rn_intrinsics_read(reader, &from, frame, err))) return status;
    } else {
        camera->fx = camera->fy = rn_camera_focal_from_fov(document->angle_x, camera->width);
        camera->cx = 0.5 * camera->width;
        camera->cy = 0.5 * camera->height;
    }
    status = rn_reader_pose(object, "transform_matrix", camera->world_from_camera, err);
    return status ? status : rn_reader_check_camera(object, "transform_matrix", camera, err);
}

static enum rn_status read_frames(struct rn_reader *reader, struct document *document,
                                  enum rn_split split, struct rn_error *err) {
    static const char *const own[] = {"file_path", "transform_matrix", "rotation", NULL};
    struct rn_json frames;
    enum rn_status status =
        rn_json_array(&document->root, "frames", 0, RN_DATASET_MAX_FRAMES, &frames, err);
    if (status == RN_OK && json_array_size(frames.value) == 0) {
        char where[256];
        rn_json_where(&frames, where);
        rn_problems_add(reader->problems,
                        split == RN_SPLIT_TRAIN ? RN_SEVERITY_ERROR : RN_SEVERITY_WARNING, where,
                        "has no views");
    }
    for (size_t i = 0; status == RN_OK && i < json_array_size(frames.value); i++) {
        struct rn_json object = rn_json_element(&frames, i);
        struct rn_frame frame = {.split = split, .index = (int)i, .loss_weight = 1};
        struct rn_error why;
        status = read_frame(reader, document, &object, &frame, &why);
        if ((status = rn_reader_add(reader, &frame, status, &why)) && err) *err = why;
        rn_intrinsics_warn_unknown(reader, &object, own);
    }
    return status;
}

static enum rn_status read_document(struct rn_reader *reader, const struct rn_json *root,
                                    void *context, struct rn_error *err) {
    static const char *const own[] = {"frames", NULL};
    struct document document = {.root = *root, .more = rn_intrinsics_given(root)};
    enum rn_status status = RN_OK;
    if (!document.more)
        status = rn_json_number(root, "camera_angle_x", 1e-4, MAX_ANGLE, &document.angle_x, err);
    if (status) return status;
    struct rn_json width, height;
    document.stated =
        !document.more && (rn_json_find(root, "w", &width) || rn_json_find(root, "h", &height));
    if (document.stated &&
        ((status = rn_json_integer(root, "w", 1, RN_CAMERA_MAX_SIZE, &document.width, err)) ||
         (status = rn_json_integer(root, "h", 1, RN_CAMERA_MAX_SIZE, &document.height, err))))
        return status;
    rn_intrinsics_warn_unknown(reader, root, own);
    return read_frames(reader, &document, *(enum rn_split *)context, err);
}

static enum rn_status read_split(struct rn_reader *reader, enum rn_split split,
                                 struct rn_error *err) {
    char name[32];
    snprintf(name, sizeof name, "transforms_%s.json", rn_split_name(split));
    char *path = rn_reader_path(reader, name);
    if (!path) return rn_error_set(err, RN_ERROR_NO_MEMORY, reader->folder, "out of memory");
    bool there = access(path, F_OK) == 0;
    if (!there)
        rn_problems_add(reader->problems, RN_SEVERITY_INFO, path, "is not there: no %s split",
                        rn_split_name(split));
    free(path);
    return there ? rn_reader_json(reader, name, false, read_document, &split, err) : RN_OK;
}

static enum rn_status read_blender(struct rn_reader *reader, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (int split = 0; split < RN_SPLIT_COUNT && status == RN_OK; split++)
        status = read_split(reader, (enum rn_split)split, err);
    return status;
}

#define TRAIN "transforms_train.json"
#define VAL "transforms_val.json"
#define TEST "transforms_test.json"
const struct rn_format rn_format_blender = {
    .name = "blender",
    .title = "NeRF-synthetic",
    .signs = (const struct rn_sign[]){{TRAIN, NULL}, {VAL, NULL}, {TEST, NULL}, {NULL, NULL}},
    .documents = (const char *const[]){TRAIN, VAL, TEST, NULL},
    .photo_folders = (const char *const[]){NULL},
    .sphere = RN_BLENDER_SPHERE,
    .read = read_blender};
