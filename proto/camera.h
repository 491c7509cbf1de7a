// GET /v1/datasets/{id}/cameras: cameras as the API writes them.
#ifndef RN_PROTO_CAMERA_H
#define RN_PROTO_CAMERA_H

#include "common/math/camera.h"
#include "proto/codec.h"

struct rn_dataset_camera {
    int split; // rn_split_names
    int64_t index;
    char name[256];
    int64_t scale;
    char *camera; // JSON, owned
};
extern const struct rn_table rn_dataset_camera_table;

// A camera as JSON in OpenCV axes with fx, fy, cx, cy and the lens; malloc'd. RN_ERROR_NO_MEMORY.
enum rn_status rn_camera_json(const struct rn_camera *camera, char **ret_json,
                              struct rn_error *err) RN_MUST_CHECK;

#endif
