// A dense grid of voxels beside the planes: what two places share on every plane, and no place
// alone, tells them apart. It is looked up trilinearly at the middle of a sample, and has no
// levels: a voxel is five times as wide as a texel or more. (A low-resolution grid beside planes:
// Reiser et al. 2023, MERF.)
//
// It has as many numbers as a plane and lies behind the last one: [z][y][x][channel], then zeros.
#ifndef RN_ENGINE_FIELD_VOXELS_H
#define RN_ENGINE_FIELD_VOXELS_H

#include <stdbool.h>
#include <stddef.h>

#include "common/settings/train.h"

#define RN_VOXEL_CHANNELS 4

// Numbers of one plane's base grid, and of the voxel grid.
static inline size_t rn_grid_numbers(const struct rn_field_config *config) {
    return (size_t)config->base * (size_t)config->base * (size_t)config->channels;
}

// The planes, and the voxel grid where there is one.
static inline int rn_grid_count(const struct rn_field_config *config) {
    return config->planes + (config->voxels ? 1 : 0);
}

// Voxels a side.
static inline int rn_voxel_side(const struct rn_field_config *config) {
    size_t room = rn_grid_numbers(config) / RN_VOXEL_CHANNELS, n = 1;
    while ((n + 1) * (n + 1) * (n + 1) <= room)
        n++;
    return (int)n;
}

// Features of a sample: those of each plane, then the voxels'.
static inline int rn_feature_count(const struct rn_field_config *config) {
    return config->planes * config->channels + (config->voxels ? RN_VOXEL_CHANNELS : 0);
}

#endif
