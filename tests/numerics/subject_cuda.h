// What the GPU's kernels make of a plane, run by the emulator of tests/ops: its maps in fp16, the
// fetch and its adjoint.
#ifndef RN_TESTS_NUMERICS_SUBJECT_CUDA_H
#define RN_TESTS_NUMERICS_SUBJECT_CUDA_H

#include "server/engine/kernels/kernels.h"

#ifdef __cplusplus
extern "C" {
#endif

// One plane and the gradients of its maps. One thread.
struct cuda_plane;

// `texels`: [v][u][channel], copied. The base is a multiple of 8 and of 2^(levels - 1).
struct cuda_plane *cuda_plane_create(const struct rn_field_config *config, const float *texels);
void cuda_plane_destroy(struct cuda_plane **plane);
// Maps a side, and one number of a map as it is stored; whether there is such a map.
int cuda_plane_levels(const struct cuda_plane *plane);
bool cuda_plane_has(const struct cuda_plane *plane, int lx, int ly);
double cuda_plane_texel(const struct cuda_plane *plane, int lx, int ly, int x, int y, int channel);

// Where a query looks, and at which levels.
struct cuda_query {
    float u, v, lx, ly;
};
// `channels` numbers of a query, before they are rounded to a feature's fp16.
void cuda_plane_fetch(const struct cuda_plane *plane, const struct cuda_query *query, float *ret);
// Adds the adjoint of n queries, one after the other along a ray, with grad[n][channels]. In fixed
// point (the deterministic mode), or else in fp16.
void cuda_plane_scatter(struct cuda_plane *plane, int n, const struct cuda_query *queries,
                        const float *grad, bool fixed);
double cuda_plane_gradient(const struct cuda_plane *plane, int lx, int ly, int x, int y,
                           int channel, bool fixed);
// Whether the optimiser will look at the block that a texel of the base lies in.
bool cuda_plane_is_touched(const struct cuda_plane *plane, int x, int y);
// What is rounded to a feature.
double cuda_feature(float sum);
// What the host makes of a pixel's fp16 number where the processor has no instruction for it.
float cuda_number_of_half(uint32_t half);

#ifdef __cplusplus
}
#endif

#endif
