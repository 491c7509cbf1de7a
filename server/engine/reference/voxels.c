#include "server/engine/reference/voxels.h"

#include "server/engine/field/ripmap.h"

void rn_voxel_corners(const struct rn_field_config *config, const double x[3],
                      struct rn_voxel_corner ret_corners[8]) {
    int side = rn_voxel_side(config);
    for (int k = 0; k < 8; k++) {
        size_t voxel = 0;
        double weight = 1;
        for (int i = 2; i >= 0; i--) {
            struct rn_lerp at = rn_rip_lerp(x[i], side);
            bool next = k >> i & 1;
            voxel = voxel * (size_t)side + (size_t)(next ? at.high : at.low);
            weight *= next ? at.fraction : 1 - at.fraction;
        }
        ret_corners[k] = (struct rn_voxel_corner){voxel * RN_VOXEL_CHANNELS, weight};
    }
}

void rn_voxels_fetch(const struct rn_field_config *config, const double *voxels, const double x[3],
                     double *ret_features) {
    struct rn_voxel_corner corners[8];
    rn_voxel_corners(config, x, corners);
    for (int c = 0; c < RN_VOXEL_CHANNELS; c++) {
        ret_features[c] = 0;
        for (int k = 0; k < 8; k++)
            ret_features[c] += corners[k].weight * voxels[corners[k].offset + (size_t)c];
    }
}

void rn_voxels_fetch_backward(const struct rn_field_config *config, double *grad, const double x[3],
                              const double *feature_grad) {
    struct rn_voxel_corner corners[8];
    rn_voxel_corners(config, x, corners);
    for (int k = 0; k < 8; k++)
        for (int c = 0; c < RN_VOXEL_CHANNELS; c++)
            grad[corners[k].offset + (size_t)c] += corners[k].weight * feature_grad[c];
}
