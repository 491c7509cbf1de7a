#include "common/image/cloud.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EDGE 0.03  // relative difference to a neighbour's depth beyond which a pixel is an edge's
#define OPAQUE 200 // of 255

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are written as they lie");

static bool is_surface(const struct rn_picture *depth, int x, int y) {
    static const int next[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
    float own = depth->values[(size_t)y * (size_t)depth->width + (size_t)x];
    if (!(own > 0) || !isfinite(own)) return false;
    for (int i = 0; i < 4; i++) {
        int u = x + next[i][0], v = y + next[i][1];
        if (u < 0 || v < 0 || u >= depth->width || v >= depth->height) continue;
        float other = depth->values[(size_t)v * (size_t)depth->width + (size_t)u];
        if (!(fabsf(other - own) <= (float)EDGE * own)) return false;
    }
    return true;
}

static bool make_room(struct rn_cloud *cloud, size_t more) {
    if (cloud->count + more <= cloud->capacity) return true;
    size_t capacity = 2 * (cloud->count + more);
    struct rn_cloud_point *points = realloc(cloud->points, capacity * sizeof *points);
    if (!points) return false;
    cloud->points = points;
    cloud->capacity = capacity;
    return true;
}

static bool is_within(const double box[2][3], const double p[3]) {
    for (int i = 0; i < 3 && box; i++)
        if (!(p[i] >= box[0][i] && p[i] <= box[1][i])) return false;
    return true;
}

enum rn_status rn_cloud_add(struct rn_cloud *cloud, const struct rn_camera *camera,
                            const struct rn_image *rgb, const struct rn_picture *depth,
                            const struct rn_image *opacity, const double box[2][3],
                            struct rn_error *err) {
    int width = depth->width, height = depth->height;
    if (rgb->width != width || rgb->height != height || camera->width != width ||
        camera->height != height ||
        (opacity && (opacity->width != width || opacity->height != height)))
        return rn_error_set(err, RN_ERROR_INVALID, "cloud", "pictures are of different sizes");
    if (!make_room(cloud, (size_t)width * (size_t)height))
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "cloud", "out of memory");
    for (int i = 0; i < width * height; i++) {
        int x = i % width, y = i / width;
        if (!is_surface(depth, x, y) || (opacity && opacity->pixels[4 * i] < OPAQUE)) continue;
        struct rn_ray ray = rn_camera_ray(camera, x + 0.5, y + 0.5);
        double p[3];
        for (int k = 0; k < 3; k++)
            p[k] = ray.origin[k] + ray.direction[k] * (double)depth->values[i];
        if (!is_within(box, p)) continue;
        struct rn_cloud_point *point = &cloud->points[cloud->count++];
        for (int k = 0; k < 3; k++) {
            point->position[k] = (float)p[k];
            point->colour[k] = rgb->pixels[4 * i + k];
        }
    }
    return RN_OK;
}

enum rn_status rn_cloud_encode_ply(const struct rn_cloud *cloud, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err) {
    enum { POINT = 15 };
    char header[256];
    int length = snprintf(header, sizeof header,
                          "ply\nformat binary_little_endian 1.0\nelement vertex %zu\n"
                          "property float x\nproperty float y\nproperty float z\n"
                          "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                          "end_header\n",
                          cloud->count);
    size_t size = (size_t)length + POINT * cloud->count;
    uint8_t *bytes = malloc(size);
    if (!bytes) return rn_error_set(err, RN_ERROR_NO_MEMORY, "cloud", "out of memory");
    memcpy(bytes, header, (size_t)length);
    uint8_t *at = bytes + length;
    for (size_t i = 0; i < cloud->count; i++, at += POINT) {
        memcpy(at, cloud->points[i].position, 12);
        memcpy(at + 12, cloud->points[i].colour, 3);
    }
    *ret_bytes = bytes;
    *ret_size = size;
    return RN_OK;
}

void rn_cloud_finish(struct rn_cloud *cloud) {
    free(cloud->points);
    *cloud = (struct rn_cloud){0};
}
