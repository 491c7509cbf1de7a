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
    struct rn_camera camera;
};
extern const struct rn_table rn_dataset_camera_table;

// Where to begin to look at a scene.
struct rn_scene_start {
    struct rn_camera camera;
    double up[3];
};
extern const struct rn_table rn_scene_start_table;

#endif
