// Photographs of a wall that stands across the axes of cameras whose places are known, in memory.
#ifndef RN_TESTS_WALL_H
#define RN_TESTS_WALL_H

#include <math.h>
#include <stdlib.h>

#include "common/dataset/dataset.h"
#include "common/math/rng.h"

#define WALL_AWAY 5.0  // dataset units from all cameras
#define WALL_GRAIN 0.1 // and so wide are its spots, whose brightness is drawn

static inline double wall_spot(int x, int y) {
    return rn_rng_draw(1, (uint64_t)(x + 1000), (uint64_t)(y + 1000)).v[0] % 256;
}

static inline double wall_level(double x, double y) {
    int left = (int)floor(x), top = (int)floor(y);
    double u = x - left, v = y - top;
    return (1 - v) * ((1 - u) * wall_spot(left, top) + u * wall_spot(left + 1, top)) +
           v * ((1 - u) * wall_spot(left, top + 1) + u * wall_spot(left + 1, top + 1));
}

static inline struct rn_image wall_photograph(const struct rn_camera *camera) {
    struct rn_image image;
    if (rn_image_init(camera->width, camera->height, &image, NULL)) abort();
    for (int i = 0; i < camera->width * camera->height; i++) {
        struct rn_ray ray =
            rn_camera_ray(camera, i % camera->width + 0.5, (double)(i / camera->width) + 0.5);
        double t = (WALL_AWAY - ray.origin[2]) / ray.direction[2] / WALL_GRAIN;
        uint8_t *pixel = image.pixels + 4 * i;
        pixel[0] = pixel[1] = pixel[2] =
            (uint8_t)wall_level(ray.origin[0] / WALL_GRAIN + t * ray.direction[0],
                                ray.origin[1] / WALL_GRAIN + t * ray.direction[1]);
        pixel[3] = 255;
    }
    return image;
}

// `count` photographs, `each` of them from a place, three places a row and 0.3 apart.
static inline struct rn_dataset wall_dataset(size_t count, size_t each, int width, int height) {
    struct rn_dataset wall = {
        .name = "wall", .frames = calloc(count, sizeof *wall.frames), .frame_count = count};
    if (!wall.frames) abort();
    for (size_t i = 0; i < count; i++) {
        struct rn_camera *camera = &wall.frames[i].camera;
        *camera = (struct rn_camera){.width = width,
                                     .height = height,
                                     .fx = width,
                                     .fy = width,
                                     .cx = 0.5 * width,
                                     .cy = 0.5 * height};
        for (int k = 0; k < 3; k++)
            camera->world_from_camera[k][k] = 1;
        camera->world_from_camera[0][3] = 0.3 * (double)(i / each % 3);
        camera->world_from_camera[1][3] = 0.3 * (double)(i / each / 3);
        wall.frames[i].index = (int)i;
    }
    return wall;
}

static inline void wall_finish(struct rn_dataset *wall) {
    free(wall->frames);
    free(wall->points.items);
    free(wall->points.sightings);
}

#endif
