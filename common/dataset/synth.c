// Synthetic datasets: cameras around a scene, supersampled pictures, NeRF-synthetic layout.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/dataset/output.h"
#include "common/dataset/reader.h"
#include "common/dataset/synth_scenes.h"
#include "common/math/rng.h"

#define DEFAULT_SAMPLES 64
#define MAX_SAMPLES 4096
#define MAX_SIZE 4096
#define MAX_VIEWS 10000
#define PNG_LEVEL 6

// False beyond the lens's fold.
static bool pixel_ray(const struct rn_camera *camera, double px, double py, struct ray *ret) {
    struct rn_ray cone = rn_camera_ray(camera, px, py);
    *ret = (struct ray){{cone.origin[0], cone.origin[1], cone.origin[2]},
                        {cone.direction[0], cone.direction[1], cone.direction[2]},
                        {0}};
    return cone.radius > 0;
}

// Sample s of a pixel on the lamp's disc: an additive recurrence over radius and angle, so that the
// samples of a pixel cover the lamp evenly.
static void place_on_lamp(int s, uint64_t pixel, double lamp[2]) {
    struct rn_rng4 offset = rn_rng_draw(1, pixel, 0);
    double radius = fmod((double)rn_rng_unit(offset.v[0]) + s * 0.7548776662466927, 1);
    double angle = 2 * M_PI * fmod((double)rn_rng_unit(offset.v[1]) + s * 0.5698402909980532, 1);
    lamp[0] = sqrt(radius) * cos(angle);
    lamp[1] = sqrt(radius) * sin(angle);
}

// The mean over one pixel: `side` x `side` strata with one jittered ray each.
static void render_pixel(const struct rn_synth_scene *scene, const struct rn_camera *camera, int x,
                         int y, int side, float rgba[4]) {
    double sum[3] = {0};
    int hits = 0, samples = side * side;
    uint64_t stream = (uint64_t)y * (uint64_t)camera->width + (uint64_t)x;
    struct rn_rng4 jitter = {{0}};
    for (int s = 0; s < samples; s++) {
        if (s % 2 == 0) jitter = rn_rng_draw(0, stream, (uint64_t)s / 2);
        double u = (s % side + (double)rn_rng_unit(jitter.v[s % 2 * 2])) / side;
        double v = ((double)(s / side) + (double)rn_rng_unit(jitter.v[s % 2 * 2 + 1])) / side;
        struct ray ray;
        if (!pixel_ray(camera, x + u, y + v, &ray)) continue;
        if (scene->lamp > 0) place_on_lamp(s, stream, ray.lamp);
        double rgb[3], distance;
        if (!rn_synth_trace(scene, &ray, rgb, &distance)) continue;
        hits++;
        for (int i = 0; i < 3; i++)
            sum[i] += rgb[i];
    }
    for (int i = 0; i < 3; i++)
        rgba[i] = hits ? (float)(sum[i] / hits) : 0;
    rgba[3] = (float)hits / (float)samples;
}

// Whether no ray of the pixel can meet the scene's sphere: the centre ray stays away from it by
// more than the pixel's diagonal.
static bool pixel_is_empty(const struct rn_synth_scene *scene, const struct rn_camera *camera,
                           int x, int y) {
    if (camera->lens != RN_LENS_PINHOLE) return false;
    struct rn_ray cone = rn_camera_ray(camera, x + 0.5, y + 0.5);
    double along = 0, squared = 0;
    for (int i = 0; i < 3; i++) {
        along -= cone.origin[i] * cone.direction[i];
        squared += cone.origin[i] * cone.origin[i];
    }
    double distance = sqrt(squared), half_diagonal = 0.7072 * 1.7725 * cone.radius;
    double reach = scene->radius + half_diagonal * distance;
    return along > 0 && squared - along * along > reach * reach;
}

static void render(const struct rn_synth_scene *scene, const struct rn_camera *camera, int side,
                   struct rn_picture *picture) {
    for (int y = 0; y < camera->height; y++)
        for (int x = 0; x < camera->width; x++) {
            float *rgba = picture->values + 4 * ((size_t)y * (size_t)camera->width + (size_t)x);
            if (pixel_is_empty(scene, camera, x, y))
                memset(rgba, 0, 4 * sizeof *rgba);
            else
                render_pixel(scene, camera, x, y, side, rgba);
        }
}

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
    struct rn_camera checked = *camera;
    struct rn_picture picture;
    int side = 0;
    enum rn_status status;
    if ((status = check_scene(scene, samples, &found, &side, err)) ||
        (status = rn_camera_check(&checked, "camera", err)) ||
        (status = rn_picture_init(camera->width, camera->height, 4, &picture, err)))
        return status;
    render(found, &checked, side, &picture);
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
            bool hit = pixel_ray(&checked, x + 0.5, y + 0.5, &ray) &&
                       rn_synth_trace(found, &ray, rgb, &distance);
            *value = hit ? (float)distance : INFINITY;
        }
    *ret_depth = picture;
    return RN_OK;
}

static enum rn_status place_camera(const struct rn_synth_scene *scene, enum rn_split split,
                                   int index, int count, int size, struct rn_camera *ret_camera) {
    static const double up[3] = {0, 0, 1};
    double eye[3], target[3];
    struct rn_camera camera = {.lens = RN_LENS_PINHOLE, .width = size, .height = size};
    camera.fx = camera.fy = rn_camera_focal_from_fov(scene->angle_x, size);
    camera.cx = camera.cy = 0.5 * size;
    scene->stand(split, index, count, eye, target);
    enum rn_status status = rn_camera_look_at(eye, target, up, camera.world_from_camera);
    if (status == RN_OK) *ret_camera = camera;
    return status;
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

static enum rn_status write_view(const struct synth *synth, const struct rn_picture *picture,
                                 enum rn_split split, int index, struct rn_error *err) {
    struct rn_image image;
    char *path;
    if (asprintf(&path, "%s/%s/r_%d.png", synth->target, rn_split_name(split), index) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, synth->target, "out of memory");
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
    int index = (int)view, split = 0, size = synth->options->size;
    while (index >= synth->count[split])
        index -= synth->count[split++];
    struct rn_camera camera;
    struct rn_picture picture;
    enum rn_status status =
        place_camera(synth->scene, (enum rn_split)split, index, synth->count[split], size, &camera);
    if (status) return rn_error_set(err, status, synth->target, "degenerate camera");
    if ((status = rn_picture_init(size, size, 4, &picture, err))) return status;
    render(synth->scene, &camera, synth->side, &picture);
    status = write_view(synth, &picture, (enum rn_split)split, index, err);
    rn_picture_finish(&picture);
    if (status == RN_OK && split == RN_SPLIT_TEST) status = write_depth(synth, &camera, index, err);
    return status;
}

static json_t *frame_to_json(const struct synth *synth, enum rn_split split, int index) {
    struct rn_camera camera;
    int count = synth->count[split], size = synth->options->size;
    char file[64];
    snprintf(file, sizeof file, "./%s/r_%d", rn_split_name(split), index);
    if (place_camera(synth->scene, split, index, count, size, &camera)) return NULL;
    double(*m)[4] = camera.world_from_camera; // to OpenGL axes: columns 1 and 2 negated
    return json_pack("{s:s s:[[ffff][ffff][ffff][ffff]]}", "file_path", file, "transform_matrix",
                     m[0][0], -m[0][1], -m[0][2], m[0][3], m[1][0], -m[1][1], -m[1][2], m[1][3],
                     m[2][0], -m[2][1], -m[2][2], m[2][3], 0.0, 0.0, 0.0, 1.0);
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
    char *text = root ? json_dumps(root, JSON_INDENT(1) | JSON_REAL_PRECISION(17)) : NULL;
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

static enum rn_status make_folder(const struct synth *synth, enum rn_split split,
                                  struct rn_error *err) {
    char *path;
    if (asprintf(&path, "%s/%s", synth->target, rn_split_name(split)) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, synth->target, "out of memory");
    enum rn_status status = rn_mkdirs(path, 0777, err);
    free(path);
    return status;
}

static enum rn_status check_options(const struct rn_synth_options *options, struct rn_error *err) {
    if (options->size < 1 || options->size > MAX_SIZE)
        return rn_error_set(err, RN_ERROR_INVALID, "size", "must be 1 to %d pixels", MAX_SIZE);
    if (options->views < 1 || options->views > MAX_VIEWS)
        return rn_error_set(err, RN_ERROR_INVALID, "views", "must be 1 to %d", MAX_VIEWS);
    return RN_OK;
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
        (status = check_options(options, err)) || (status = rn_output_check_new(target, err)))
        return status;
    for (int split = 0; split < RN_SPLIT_COUNT; split++)
        if ((status = make_folder(&synth, (enum rn_split)split, err))) return status;
    if ((status = rn_output_run(options->threads, total_views(&synth), make_view, &synth, progress,
                                context, target, err)) ||
        (status = rn_output_sync(target, err)))
        return status;
    for (int split = 0; split < RN_SPLIT_COUNT; split++)
        if ((status = write_transforms(&synth, (enum rn_split)split, err))) return status;
    return RN_OK;
}
