#include "common/dataset/synth_capture.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/base/buf.h"
#include "common/base/file.h"
#include "common/math/rng.h"
#include "common/math/rotation.h"

#define POINTS 4000 // that are sought; the sky has none
#define STREAM 4    // of the random numbers by which
#define SAME 1e-4   // of a distance: nothing else hides the point
#define MOST_BYTES (1u << 30)

// A photograph's sightings, as COLMAP's "X Y POINT3D_ID ".
struct sightings {
    struct rn_buf text;
    int count;
};

struct capture {
    const struct rn_synth_scene *scene;
    const struct rn_synth_shot *shots;
    int count;
    struct sightings *seen; // [count]
    struct rn_buf points;
};

// Where a photograph has the point; false where it does not see it.
static bool sight(const struct capture *capture, int photo, const double point[3], double at[2]) {
    const struct rn_camera *camera = &capture->shots[photo].camera;
    double axes[3], rgb[3], distance, away = 0;
    struct ray ray;
    rn_camera_axes(camera, point, axes);
    if (!rn_camera_project(camera, axes, at) || at[0] < 0 || at[1] < 0 || at[0] > camera->width ||
        at[1] > camera->height || !rn_synth_ray(camera, at[0], at[1], &ray) ||
        !rn_synth_trace(capture->scene, &ray, rgb, &distance))
        return false;
    for (int i = 0; i < 3; i++)
        away += axes[i] * axes[i];
    return fabs(distance - sqrt(away)) < SAME * distance;
}

// What lies in a random direction from a random photograph; false where it is the sky.
static bool seek(const struct capture *capture, int i, double point[3], double rgb[3]) {
    struct rn_rng4 draw = rn_rng_draw(STREAM, 0, (uint64_t)i);
    const struct rn_camera *camera =
        &capture->shots[rn_rng_below(draw.v[0], (uint32_t)capture->count)].camera;
    double distance;
    struct ray ray;
    if (!rn_synth_ray(camera, (double)rn_rng_unit(draw.v[1]) * camera->width,
                      (double)rn_rng_unit(draw.v[2]) * camera->height, &ray) ||
        !rn_synth_trace(capture->scene, &ray, rgb, &distance) || isinf(distance))
        return false;
    struct vec at = ray_at(&ray, distance);
    point[0] = at.x, point[1] = at.y, point[2] = at.z;
    return true;
}

// A point that two photographs or more see, with its track.
static void add_point(struct capture *capture, int id) {
    double point[3], rgb[3], at[2];
    int sightings = 0;
    if (!seek(capture, id, point, rgb)) return;
    for (int p = 0; p < capture->count; p++)
        sightings += sight(capture, p, point, at);
    if (sightings < 2) return;
    rn_buf_printf(&capture->points, "%d %.17g %.17g %.17g %.0f %.0f %.0f 0", id + 1, point[0],
                  point[1], point[2], 255 * rgb[0], 255 * rgb[1], 255 * rgb[2]);
    for (int p = 0; p < capture->count; p++) {
        if (!sight(capture, p, point, at)) continue;
        struct sightings *seen = &capture->seen[p];
        rn_buf_printf(&seen->text, "%.9g %.9g %d ", at[0], at[1], id + 1);
        rn_buf_printf(&capture->points, " %d %d", p + 1, seen->count++);
    }
    rn_buf_printf(&capture->points, "\n");
}

static enum rn_status write_text(const char *target, const char *name, struct rn_buf *text,
                                 struct rn_error *err) {
    char *path;
    enum rn_status status = rn_buf_status(text, name, err);
    if (status) return status;
    if (asprintf(&path, "%s/sparse/0/%s.txt", target, name) < 0)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, target, "out of memory");
    status =
        rn_file_write_atomic(path, text->data ? (const char *)text->data : "", text->size, err);
    free(path);
    return status;
}

static void print_camera(const struct rn_camera *camera, struct rn_buf *text) {
    rn_buf_printf(text, "1 OPENCV %d %d %.17g %.17g %.17g %.17g", camera->width, camera->height,
                  camera->fx, camera->fy, camera->cx, camera->cy);
    for (int i = 0; i < RN_SYNTH_LENS; i++)
        rn_buf_printf(text, " %.17g", camera->lens_k[i]);
    rn_buf_printf(text, "\n");
}

static void print_images(const struct capture *capture, struct rn_buf *text) {
    for (int p = 0; p < capture->count; p++) {
        double view[3][4], q[4];
        rn_pose_invert(capture->shots[p].camera.world_from_camera, view);
        rn_rotation_to_quaternion((const double(*)[4])view, q);
        rn_buf_printf(text, "%d %.17g %.17g %.17g %.17g %.17g %.17g %.17g 1 " RN_SYNTH_PHOTO "\n",
                      p + 1, q[0], q[1], q[2], q[3], view[0][3], view[1][3], view[2][3], p);
        const struct rn_buf *seen = &capture->seen[p].text;
        rn_buf_append(text, seen->data, seen->size);
        rn_buf_printf(text, "\n");
        if (seen->failed) text->failed = true;
    }
}

static enum rn_status write_model(struct capture *capture, const char *target,
                                  struct rn_error *err) {
    struct rn_buf cameras, images;
    rn_buf_init(&cameras, MOST_BYTES);
    rn_buf_init(&images, MOST_BYTES);
    print_camera(&capture->shots[0].camera, &cameras);
    print_images(capture, &images);
    enum rn_status status = write_text(target, "cameras", &cameras, err);
    if (status == RN_OK) status = write_text(target, "images", &images, err);
    if (status == RN_OK) status = write_text(target, "points3D", &capture->points, err);
    rn_buf_finish(&cameras);
    rn_buf_finish(&images);
    return status;
}

enum rn_status rn_synth_write_capture(const struct rn_synth_scene *scene,
                                      const struct rn_synth_shot *shots, int count,
                                      const char *target, struct rn_error *err) {
    struct capture capture = {.scene = scene, .shots = shots, .count = count};
    capture.seen = calloc((size_t)count, sizeof *capture.seen);
    if (!capture.seen) return rn_error_set(err, RN_ERROR_NO_MEMORY, target, "out of memory");
    rn_buf_init(&capture.points, MOST_BYTES);
    for (int p = 0; p < count; p++)
        rn_buf_init(&capture.seen[p].text, MOST_BYTES);
    for (int i = 0; i < POINTS; i++)
        add_point(&capture, i);
    enum rn_status status = write_model(&capture, target, err);
    for (int p = 0; p < count; p++)
        rn_buf_finish(&capture.seen[p].text);
    rn_buf_finish(&capture.points);
    free(capture.seen);
    return status;
}
