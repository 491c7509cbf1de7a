#include "server/engine/bench/scene.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/base/file.h"

#define SCENE "sphere"
#define DISTANCE 4.0
#define FOV_RAD 0.69
#define RADIUS 1.5

enum rn_status rn_bench_camera(int index, int count, struct rn_camera *ret_camera) {
    static const double up[3] = {0, 0, 1}, target[3] = {0, 0, 0};
    double z = 0.9 * (index + 0.5) / count, azimuth = index * M_PI * (3 - sqrt(5));
    double across = DISTANCE * sqrt(1 - z * z);
    double eye[3] = {across * cos(azimuth), across * sin(azimuth), DISTANCE * z};
    struct rn_camera camera = {.lens = RN_LENS_PINHOLE,
                               .width = RN_BENCH_SIZE,
                               .height = RN_BENCH_SIZE,
                               .cx = 0.5 * RN_BENCH_SIZE,
                               .cy = 0.5 * RN_BENCH_SIZE};
    camera.fx = camera.fy = rn_camera_focal_from_fov(FOV_RAD, RN_BENCH_SIZE);
    enum rn_status status = rn_camera_look_at(eye, target, up, camera.world_from_camera);
    if (status == RN_OK) *ret_camera = camera;
    return status;
}

struct making {
    struct rn_bench_scene *scene;
    enum rn_status status[RN_BENCH_VIEWS];
    struct rn_error err[RN_BENCH_VIEWS];
};

// One sample a pixel: the picture serves to be trained on, not to be looked at.
static void make_view(void *context, int index, int thread) {
    (void)thread;
    struct making *making = context;
    struct rn_frame *frame = &making->scene->frames[index];
    struct rn_error *err = &making->err[index];
    struct rn_picture picture = {0};
    struct rn_image image = {0};
    enum rn_status status = rn_synth_render(SCENE, &frame->camera, 1, &picture, err);
    if (status == RN_OK) status = rn_picture_to_image(&picture, &image, err);
    image.has_alpha = true;
    if (status == RN_OK) status = rn_image_write_png(&image, frame->path, 1, err);
    rn_picture_finish(&picture);
    rn_image_finish(&image);
    making->status[index] = status;
}

static enum rn_status make_views(struct rn_pool *pool, struct rn_bench_scene *scene,
                                 struct rn_error *err) {
    struct making *making = calloc(1, sizeof *making);
    if (!making) return rn_error_set(err, RN_ERROR_NO_MEMORY, "bench", "out of memory");
    making->scene = scene;
    rn_pool_run(pool, RN_BENCH_VIEWS, make_view, making);
    enum rn_status status = RN_OK;
    for (int i = 0; i < RN_BENCH_VIEWS && status == RN_OK; i++) {
        status = making->status[i];
        if (status != RN_OK) *err = making->err[i];
    }
    free(making);
    return status;
}

enum rn_status rn_bench_scene_init(struct rn_pool *pool, struct rn_bench_scene *scene,
                                   struct rn_error *err) {
    static char name[] = "r";
    const char *parent = getenv("TMPDIR");
    *scene = (struct rn_bench_scene){.dataset = {.name = name,
                                                 .frames = scene->frames,
                                                 .frame_count = RN_BENCH_VIEWS,
                                                 .view_count = {RN_BENCH_VIEWS},
                                                 .scale_count = 1,
                                                 .bounds = {.radius = RADIUS}}};
    int size = snprintf(scene->folder, sizeof scene->folder, "%s/ripnerf-bench-XXXXXX",
                        parent && *parent ? parent : "/tmp");
    if (size >= (int)sizeof scene->folder)
        return rn_error_set(err, RN_ERROR_INVALID, "TMPDIR", "is too long a name");
    if (!mkdtemp(scene->folder)) {
        enum rn_status status = rn_error_from_errno(err, errno, scene->folder, "make a folder");
        scene->folder[0] = '\0';
        return status;
    }
    for (int i = 0; i < RN_BENCH_VIEWS; i++) {
        snprintf(scene->paths[i], sizeof scene->paths[i], "%s/%d.png", scene->folder, i);
        scene->frames[i] = (struct rn_frame){
            .name = name, .path = scene->paths[i], .index = i, .loss_weight = 1, .has_alpha = true};
        if (rn_bench_camera(i, RN_BENCH_VIEWS, &scene->frames[i].camera) != RN_OK)
            return rn_error_set(err, RN_ERROR_INVALID, "bench", "degenerate camera");
    }
    return make_views(pool, scene, err);
}

void rn_bench_scene_finish(struct rn_bench_scene *scene) {
    struct rn_error err;
    if (*scene->folder && rn_remove_tree(scene->folder, &err) != RN_OK)
        fprintf(stderr, "%s: %s\n", err.where, err.text);
    scene->folder[0] = '\0';
}
