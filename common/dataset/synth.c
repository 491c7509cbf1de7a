// Synthetic datasets: cameras around a scene, supersampled pictures, in one of two layouts.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/dataset/output.h"
#include "common/dataset/reader.h"
#include "common/dataset/synth_capture.h"

#define DEFAULT_SAMPLES 64
#define MAX_SAMPLES 4096
#define MAX_SIZE 4096
#define MAX_VIEWS 10000
#define MAX_STOPS 4
#define MAX_BLUR 1
#define PNG_LEVEL 6
#define CAPTURE_TEST 8 // every so manieth photograph of a capture tests

static enum rn_status check_scene(const char *name, int samples,
                                  const struct rn_synth_scene **ret_scene, int *ret_side,
                                  struct rn_error *err) {
    const struct rn_synth_scene *scene = rn_synth_find(name);
    if (!scene) {
        char names[128];
        rn_synth_names(names, sizeof names);
        return rn_error_set(err, RN_ERROR_INVALID, "scene",
                            "no synthetic scene \"%.40s\"; there are %s", name, names);
    }
    if (samples == 0) samples = DEFAULT_SAMPLES;
    int side = (int)lround(sqrt(samples > 0 ? samples : 0));
    if (side < 1 || samples > MAX_SAMPLES || side * side != samples)
        return rn_error_set(err, RN_ERROR_INVALID, "samples",
                            "%d is not a square number from 1 to %d", samples, MAX_SAMPLES);
    *ret_scene = scene;
    *ret_side = side;
    return RN_OK;
}

enum rn_status rn_synth_render(const char *scene, const struct rn_camera *camera, int samples,
                               struct rn_picture *ret_rgba, struct rn_error *err) {
    const struct rn_synth_scene *found = NULL;
    struct rn_synth_shot shot = {.camera = *camera};
    struct rn_picture picture;
    int side = 0;
    enum rn_status status;
    if ((status = check_scene(scene, samples, &found, &side, err)) ||
        (status = rn_camera_check(&shot.camera, "camera", err)) ||
        (status = rn_picture_init(camera->width, camera->height, 4, &picture, err)))
        return status;
    rn_synth_shoot(found, &shot, side, &picture);
    *ret_rgba = picture;
    return RN_OK;
}

enum rn_status rn_synth_depth(const char *scene, const struct rn_camera *camera,
                              struct rn_picture *ret_depth, struct rn_error *err) {
    const struct rn_synth_scene *found = NULL;
    struct rn_camera checked = *camera;
    struct rn_picture picture;
    int side = 0;
    enum rn_status status;
    if ((status = check_scene(scene, 1, &found, &side, err)) ||
        (status = rn_camera_check(&checked, "camera", err)) ||
        (status = rn_picture_init(camera->width, camera->height, 1, &picture, err)))
        return status;
    float *value = picture.values;
    for (int y = 0; y < camera->height; y++)
        for (int x = 0; x < camera->width; x++, value++) {
            struct ray ray;
            double rgb[3], distance;
            bool hit = rn_synth_ray(&checked, x + 0.5, y + 0.5, &ray) &&
                       rn_synth_trace(found, &ray, rgb, &distance);
            *value = hit ? (float)distance : INFINITY;
        }
    *ret_depth = picture;
    return RN_OK;
}

struct synth {
    const struct rn_synth_scene *scene;
    const struct rn_synth_options *options;
    int side;
    const char *target;
    int count[RN_SPLIT_COUNT];
};

static size_t total_views(const struct synth *synth) {
    return (size_t)(synth->count[0] + synth->count[1] + synth->count[2]);
}

// Of `total` photographs of a capture, those that are withheld by every:8.
static int withheld(int total) {
    return (total + CAPTURE_TEST - 1) / CAPTURE_TEST;
}

// The split of a view, and its index there.
static enum rn_split split_of(const struct synth *synth, int view, int *ret_index) {
    int split = 0;
    if (synth->options->capture) {
        bool test = view % CAPTURE_TEST == 0;
        *ret_index = test ? view / CAPTURE_TEST : view - withheld(view);
        return test ? RN_SPLIT_TEST : RN_SPLIT_TRAIN;
    }
    while (view >= synth->count[split])
        view -= synth->count[split++];
    *ret_index = view;
    return (enum rn_split)split;
}

static enum rn_status shot_of(const struct synth *synth, enum rn_split split, int index,
                              struct rn_synth_shot *ret_shot) {
    return rn_synth_place_shot(synth->scene, synth->options, split, index, synth->count[split],
                               ret_shot);
}

static enum rn_status write_view(const struct synth *synth, const struct rn_picture *picture,
                                 int view, struct rn_error *err) {
    struct rn_image image;
    int index;
    enum rn_split split = split_of(synth, view, &index);
    char *path;
    int length =
        synth->options->capture
            ? asprintf(&path, "%s/images/" RN_SYNTH_PHOTO, synth->target, view)
            : asprintf(&path, "%s/%s/r_%d.png", synth->target, rn_split_name(split), index);
    if (length < 0) return rn_error_set(err, RN_ERROR_NO_MEMORY, synth->target, "out of memory");
    enum rn_status status = rn_picture_to_image(picture, &image, err);
    if (status == RN_OK) {
        image.has_alpha = !synth->scene->sky; // a place fills its photographs
        status = rn_output_png(&image, path, PNG_LEVEL, err);
        rn_image_finish(&image);
    }
    free(path);
    return status;
}

// What numpy.load reads: float32, a row a line of pixels.
static enum rn_status write_npy(const struct rn_picture *picture, const char *path,
                                struct rn_error *err) {
    enum { HEADER = 128 };
    size_t size = (size_t)picture->width * (size_t)picture->height * sizeof(float);
    char *bytes = malloc(HEADER + size);
    if (!bytes) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    memcpy(bytes, "\x93NUMPY\1\0\x76\0", 10); // version 1.0; 118 bytes of text follow
    int used = snprintf(bytes + 10, HEADER - 10,
                        "{'descr': '<f4', 'fortran_order': False, 'shape': (%d, %d), }",
                        picture->height, picture->width);
    memset(bytes + 10 + used, ' ', (size_t)(HEADER - 11 - used));
    bytes[HEADER - 1] = '\n';
    memcpy(bytes + HEADER, picture->values, size);
    enum rn_status status = rn_output_file(path, bytes, HEADER + size, err);
    free(bytes);
    return status;
}

static enum rn_status write_depth(const struct synth *synth, const struct rn_camera *camera,
                                  int index, struct rn_error *err) {
    struct rn_picture depth;
    char *path;
    enum rn_status status = rn_synth_depth(synth->scene->name, camera, &depth, err);
    if (status) return status;
    if (asprintf(&path, "%s/test/r_%d_depth.npy", synth->target, index) < 0) {
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, synth->target, "out of memory");
    } else {
        status = write_npy(&depth, path, err);
        free(path);
    }
    rn_picture_finish(&depth);
    return status;
}

static enum rn_status make_view(void *context, size_t view, struct rn_error *err) {
    const struct synth *synth = context;
    int index, size = synth->options->size;
    enum rn_split split = split_of(synth, (int)view, &index);
    struct rn_synth_shot shot;
    struct rn_picture picture;
    enum rn_status status = shot_of(synth, split, index, &shot);
    if (status) return rn_error_set(err, status, synth->target, "degenerate camera");
    if ((status = rn_picture_init(size, size, 4, &picture, err))) return status;
    rn_synth_shoot(synth->scene, &shot, synth->side, &picture);
    status = write_view(synth, &picture, (int)view, err);
    rn_picture_finish(&picture);
    if (status == RN_OK && split == RN_SPLIT_TEST && !synth->options->capture)
        status = write_depth(synth, &shot.camera, index, err);
    return status;
}

static json_t *frame_to_json(const struct synth *synth, enum rn_split split, int index) {
    struct rn_synth_shot shot;
    char file[64];
    snprintf(file, sizeof file, "./%s/r_%d", rn_split_name(split), index);
    if (shot_of(synth, split, index, &shot)) return NULL;
    double(*m)[4] = shot.camera.world_from_camera; // to OpenGL axes: columns 1 and 2 negated
    return json_pack("{s:s s:[[ffff][ffff][ffff][ffff]]}", "file_path", file, "transform_matrix",
                     m[0][0], -m[0][1], -m[0][2], m[0][3], m[1][0], -m[1][1], -m[1][2], m[1][3],
                     m[2][0], -m[2][1], -m[2][2], m[2][3], 0.0, 0.0, 0.0, 1.0);
}

// The lens, as nerfstudio and instant-ngp say it, and with it the camera's whole inside.
static bool add_lens(const struct synth *synth, json_t *root) {
    struct rn_synth_shot shot;
    if (shot_of(synth, RN_SPLIT_TRAIN, 0, &shot)) return false;
    const struct rn_camera *camera = &shot.camera;
    if (camera->lens == RN_LENS_PINHOLE) return true;
    json_t *inside = json_pack("{s:s s:f s:f s:f s:f s:i s:i}", "camera_model", "OPENCV", "fl_x",
                               camera->fx, "fl_y", camera->fy, "cx", camera->cx, "cy", camera->cy,
                               "w", camera->width, "h", camera->height);
    bool good = inside && !json_object_update(root, inside);
    for (int i = 0; i < RN_SYNTH_LENS && good; i++)
        good = !json_object_set_new(root, rn_lens_models[RN_LENS_OPENCV].parameters[i],
                                    json_real(camera->lens_k[i]));
    json_decref(inside);
    return good;
}

static char *transforms_text(const struct synth *synth, enum rn_split split) {
    json_t *frames = json_array(), *root;
    int count = synth->count[split];
    for (int i = 0; i < count; i++)
        if (json_array_append_new(frames, frame_to_json(synth, split, i))) {
            json_decref(frames);
            return NULL;
        }
    root = json_pack("{s:f s:o}", "camera_angle_x", synth->scene->angle_x, "frames", frames);
    char *text = root && add_lens(synth, root)
                     ? json_dumps(root, JSON_INDENT(1) | JSON_REAL_PRECISION(17))
                     : NULL;
    json_decref(root);
    return text;
}

static enum rn_status write_transforms(const struct synth *synth, enum rn_split split,
                                       struct rn_error *err) {
    char *text = transforms_text(synth, split), *path = NULL;
    enum rn_status status;
    if (!text || asprintf(&path, "%s/transforms_%s.json", synth->target, rn_split_name(split)) < 0)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, synth->target, "out of memory");
    else
        status = rn_file_write_atomic(path, text, strlen(text), err);
    if (text) free(path);
    free(text);
    return status;
}

static enum rn_status make_folder(const struct synth *synth, const char *name,
                                  struct rn_error *err) {
    char *path;
    if (asprintf(&path, "%s/%s", synth->target, name) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, synth->target, "out of memory");
    enum rn_status status = rn_mkdirs(path, 0777, err);
    free(path);
    return status;
}

static enum rn_status make_folders(const struct synth *synth, struct rn_error *err) {
    enum rn_status status = RN_OK;
    if (synth->options->capture) {
        status = make_folder(synth, "images", err);
        return status ? status : make_folder(synth, "sparse/0", err);
    }
    for (int split = 0; split < RN_SPLIT_COUNT && status == RN_OK; split++)
        status = make_folder(synth, rn_split_name((enum rn_split)split), err);
    return status;
}

static enum rn_status write_capture(const struct synth *synth, struct rn_error *err) {
    int count = (int)total_views(synth);
    struct rn_synth_shot *shots = calloc((size_t)count, sizeof *shots);
    enum rn_status status = RN_OK;
    if (!shots) return rn_error_set(err, RN_ERROR_NO_MEMORY, synth->target, "out of memory");
    for (int view = 0; view < count && status == RN_OK; view++) {
        int index;
        enum rn_split split = split_of(synth, view, &index);
        status = shot_of(synth, split, index, &shots[view]);
    }
    if (status == RN_OK)
        status = rn_synth_write_capture(synth->scene, shots, count, synth->target, err);
    free(shots);
    return status;
}

static enum rn_status write_cameras(const struct synth *synth, struct rn_error *err) {
    enum rn_status status = RN_OK;
    if (synth->options->capture) return write_capture(synth, err);
    for (int split = 0; split < RN_SPLIT_COUNT && status == RN_OK; split++)
        status = write_transforms(synth, (enum rn_split)split, err);
    return status;
}

static bool within(double value, double most) {
    return value >= 0 && value <= most;
}

static enum rn_status check_options(const struct rn_synth_scene *scene,
                                    const struct rn_synth_options *options, struct rn_error *err) {
    if (options->size < 1 || options->size > MAX_SIZE)
        return rn_error_set(err, RN_ERROR_INVALID, "size", "must be 1 to %d pixels", MAX_SIZE);
    if (options->views < 1 || options->views > MAX_VIEWS)
        return rn_error_set(err, RN_ERROR_INVALID, "views", "must be 1 to %d", MAX_VIEWS);
    if (!within(options->exposure, MAX_STOPS))
        return rn_error_set(err, RN_ERROR_INVALID, "exposure", "must be 0 to %d stops", MAX_STOPS);
    if (!within(options->aperture, MAX_BLUR) || !within(options->shutter, MAX_BLUR))
        return rn_error_set(err, RN_ERROR_INVALID,
                            within(options->aperture, MAX_BLUR) ? "shutter" : "aperture",
                            "must be 0 to %d of the scene's units", MAX_BLUR);
    if (options->movers < 0 || options->movers > RN_SYNTH_MOVERS)
        return rn_error_set(err, RN_ERROR_INVALID, "movers", "must be 0 to %d", RN_SYNTH_MOVERS);
    if (options->movers > 0 && !(scene->roam_low.x < scene->roam_high.x))
        return rn_error_set(err, RN_ERROR_INVALID, "movers",
                            "nobody can stand about in \"%s\"; there is room in place and window",
                            scene->name);
    return RN_OK;
}

// That the cameras can be: of a lens that folds the picture over, none.
static enum rn_status check_camera(const struct synth *synth, struct rn_error *err) {
    struct rn_synth_shot shot;
    double margin[3];
    if (shot_of(synth, RN_SPLIT_TEST, 0, &shot))
        return rn_error_set(err, RN_ERROR_INVALID, "lens",
                            "its parameters are too large for a lens of this kind");
    int size = synth->options->size;
    if (shot.camera.lens != RN_LENS_PINHOLE &&
        rn_camera_look(&shot.camera, -0.5 * size / shot.camera.fx, -0.5 * size / shot.camera.fy,
                       margin) <= 0)
        return rn_error_set(err, RN_ERROR_INVALID, "lens",
                            "it folds the picture's corners over; make its parameters smaller");
    return RN_OK;
}

// What was made before it failed, in a folder that was empty.
static void take_back(const char *target, bool was_there) {
    static const char *const names[] = {"images",
                                        "sparse",
                                        "train",
                                        "val",
                                        "test",
                                        "transforms_train.json",
                                        "transforms_val.json",
                                        "transforms_test.json"};
    char *path;
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        if (asprintf(&path, "%s/%s", target, names[i]) < 0) continue;
        (void)!rn_remove_tree(path, NULL);
        free(path);
    }
    if (!was_there) (void)rmdir(target);
}

enum rn_status rn_synthesise(const char *scene, const struct rn_synth_options *options,
                             const char *target,
                             bool (*progress)(void *context, size_t done, size_t total),
                             void *context, struct rn_error *err) {
    int others = options->views / 4 > 8 ? options->views / 4 : 8;
    struct synth synth = {
        .options = options, .target = target, .count = {options->views, others, others}};
    enum rn_status status;
    if ((status = check_scene(scene, options->samples, &synth.scene, &synth.side, err)) ||
        (status = check_options(synth.scene, options, err)))
        return status;
    if (options->capture) {
        synth.count[RN_SPLIT_VAL] = 0;
        synth.count[RN_SPLIT_TEST] = (options->views + CAPTURE_TEST - 2) / (CAPTURE_TEST - 1);
    }
    bool was_there = access(target, F_OK) == 0;
    if ((status = check_camera(&synth, err)) || (status = rn_output_check_new(target, err)))
        return status;
    if ((status = make_folders(&synth, err)) ||
        (status = rn_output_run(options->threads, total_views(&synth), make_view, &synth, progress,
                                context, target, err)) ||
        (status = rn_output_sync(target, err)) || (status = write_cameras(&synth, err)))
        take_back(target, was_there);
    return status;
}
