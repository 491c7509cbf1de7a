// The plain float64 reference of the whole field: every forward and every backward, one loop after
// the other, no skipping, no cleverness. What the fast paths are tested against.
#ifndef RN_ENGINE_REFERENCE_REFERENCE_H
#define RN_ENGINE_REFERENCE_REFERENCE_H

#include "common/settings/train.h"
#include "server/engine/field/colour.h"
#include "server/engine/field/mlp.h"
#include "server/engine/field/solid.h"

// Parameters and gradients of a field in float64. Thread-safety: one thread. Owner: the creator.
struct rn_reference {
    struct rn_field_config config;
    struct rn_solid solid;
    struct rn_mlp_shape base_shape, head_shape;
    size_t plane_count;                         // numbers in `planes`: [plane][v][u][channel], then
                                                // the voxels (field/voxels.h)
    size_t map_count;                           // numbers in `maps`: every map of every plane
    double *planes, *base, *head;               // parameters
    double *plane_grad, *base_grad, *head_grad; // dL/d(parameters), accumulated
    double *maps, *map_grad;                    // pyramids: [plane][ly][lx][v][u][channel]
    bool half; // round to fp16 what a half-precision engine stores in it: maps, networks' inputs
               // and hidden activations; a sign near 0 is then the same in both. false at creation
    double distortion_loss; // weight of the distortion loss, 0 at creation
    int pixel_rays; // rays in turn that are one pixel, whose colour is their mean; 1 at creation
};

// One ray in the normalised frame (the scene's ball, in unbounded space the inner one, is the unit
// ball) with its samples.
struct rn_reference_ray {
    double origin[3], direction[3]; // direction unit
    double radius;                  // cone radius per unit distance
    int count;
    const double *mid; // `count` distances of the samples' middles, normalised
    double width;      // of every sample, normalised; in unbounded space half of that in places
    double target[3];
    struct rn_colouring colour;
    double alpha;             // the pixel's own
    double weight;            // area weight
    const double *appearance; // of its photograph, where the field has such; NULL: 0 in all
    double *appearance_grad;  // NULL, or where dL/d(appearance) is added
    bool cut; // it was ended before the end of space: its last sample is not made opaque
};

// All zero parameters. RN_ERROR_INVALID for a bad configuration, RN_ERROR_NO_MEMORY.
enum rn_status rn_reference_create(const struct rn_field_config *config, uint64_t seed,
                                   struct rn_reference **ret_reference,
                                   struct rn_error *err) RN_MUST_CHECK;
void rn_reference_destroy(struct rn_reference **reference);

// Rebuilds `maps` from `planes`: pools along x first, then along y; the other order differs by 4
// ULP of the largest texel at most.
void rn_reference_build(struct rn_reference *reference);
// Draws every texel of `planes` towards its four neighbours: x + share (their sum - 4 x), texels
// whose u + v is even first; beyond the border a texel is its own neighbour. share in [0, 1/4].
void rn_reference_smooth(struct rn_reference *reference, double share);
// The adjoint: adds map_grad to plane_grad and clears map_grad. <A x, y> = <x, A^T y> within 16 ULP
// of sum |x y|.
void rn_reference_pull_down(struct rn_reference *reference);
// Start of map (lx, ly) of a plane in `maps`.
size_t rn_reference_map_offset(const struct rn_reference *reference, int plane, int lx, int ly);

// Levels of a sample on a plane: mean and covariance from the frustum (t, width) of a ray.
void rn_reference_levels(const struct rn_reference *reference, const struct rn_reference_ray *ray,
                         int plane, double mid, double *ret_lx, double *ret_ly);
// Tetra-linear query of one plane (paper, equation of the ripmap query): `channels` features.
// Constant planes give the constant within 4 ULP, at any position and level; values and texels'
// weights are continuous across borders of texels and levels: 8 ULP of the base for one ULP.
void rn_reference_query(const struct rn_reference *reference, int plane, double u, double v,
                        double lx, double ly, double *ret_features);
// Its adjoint, within 16 ULP of sum |x y|: adds the gradient to map_grad.
void rn_reference_query_backward(struct rn_reference *reference, int plane, double u, double v,
                                 double lx, double ly, const double *feature_grad);
// All planes of one sample, and the voxels: rn_feature_count features.
void rn_reference_encode(const struct rn_reference *reference, const struct rn_reference_ray *ray,
                         double mid, double *ret_features);

// The colour of a ray over its background, its opacity and the sum of weight * mid.
// RN_ERROR_NO_MEMORY.
enum rn_status rn_reference_render(const struct rn_reference *reference,
                                   const struct rn_reference_ray *ray, double ret_rgb[3],
                                   double *ret_opacity, double *ret_depth) RN_MUST_CHECK;

// Sum over pixels of weight * sum over channels of [smooth-L1(rgb - target) + background variance *
// (opacity - alpha)^2 / 2], divided by the sum of weights (pixels without samples drop out of
// both): where no error is beyond 1, its mean over random backgrounds. The distortion loss of every
// ray is added times its share of the pixel's weight. What a pixel is compared with is in its first
// ray; `count` is a multiple of pixel_rays. Gradients are added to *_grad, the pyramid's pulled
// down. RN_ERROR_NO_MEMORY.
enum rn_status rn_reference_loss(struct rn_reference *reference,
                                 const struct rn_reference_ray *rays, size_t count,
                                 double *ret_loss) RN_MUST_CHECK;

// One dense AdamW step (Loshchilov & Hutter 2019) on n numbers, decoupled decay; step counts
// from 1. The update's error: 16 ULP against betas of 9/10 and 999/1000, for gradients of 1e-30 to
// 1e30 and steps of 1 to 1e7.
void rn_reference_adamw(size_t n, double *parameter, const double *grad, double *m, double *v,
                        double rate, double decay, double eps, int64_t step);

#endif
