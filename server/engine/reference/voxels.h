// The trilinear query of a voxel grid in float64 (field/voxels.h).
#ifndef RN_ENGINE_REFERENCE_VOXELS_H
#define RN_ENGINE_REFERENCE_VOXELS_H

#include "server/engine/field/voxels.h"

// One of the eight voxels around a place: its first number in the grid, and its weight.
struct rn_voxel_corner {
    size_t offset;
    double weight;
};
// x: in the planes' frame.
void rn_voxel_corners(const struct rn_field_config *config, const double x[3],
                      struct rn_voxel_corner ret_corners[8]);
// RN_VOXEL_CHANNELS features of the grid at `voxels`; and the adjoint, which adds to `grad`.
void rn_voxels_fetch(const struct rn_field_config *config, const double *voxels, const double x[3],
                     double *ret_features);
void rn_voxels_fetch_backward(const struct rn_field_config *config, double *grad, const double x[3],
                              const double *feature_grad);

#endif
