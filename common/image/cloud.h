// Points out of rendered depths.
#ifndef RN_COMMON_IMAGE_CLOUD_H
#define RN_COMMON_IMAGE_CLOUD_H

#include "common/image/image.h"
#include "common/math/camera.h"

struct rn_cloud_point {
    float position[3]; // dataset units
    uint8_t colour[3];
};
// Zero-initialise; rn_cloud_finish.
struct rn_cloud {
    struct rn_cloud_point *points;
    size_t count, capacity;
};

// Adds what a camera sees: a point for every pixel whose depth (distance along the ray, dataset
// units) is finite, above 0, and within 3 % of its four neighbours', since in between depths are
// the mean of what lies before and behind; and that is opaque (`opacity`, grey; NULL: all are) and
// within `box` (low, then high corner; NULL: anywhere). RN_ERROR_INVALID where sizes differ,
// RN_ERROR_NO_MEMORY.
enum rn_status rn_cloud_add(struct rn_cloud *cloud, const struct rn_camera *camera,
                            const struct rn_image *rgb, const struct rn_picture *depth,
                            const struct rn_image *opacity, const double box[2][3],
                            struct rn_error *err) RN_MUST_CHECK;
// Binary PLY, little endian: x y z as float, red green blue as uchar. malloc'd.
enum rn_status rn_cloud_encode_ply(const struct rn_cloud *cloud, uint8_t **ret_bytes,
                                   size_t *ret_size, struct rn_error *err) RN_MUST_CHECK;
void rn_cloud_finish(struct rn_cloud *cloud);

#endif
