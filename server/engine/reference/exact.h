// Single rays in float64 over a field as the kernels hold it: fp32 parameters and maps, the
// samples that a march found. What a fast path is held against where a whole reference of the
// field would be too large.
#ifndef RN_ENGINE_REFERENCE_EXACT_H
#define RN_ENGINE_REFERENCE_EXACT_H

#include "server/engine/kernels/kernels.h"

// The tetra-linear query of one plane (paper, section 3.3) at (u, v) and levels (lx, ly):
// `channels` numbers.
void rn_exact_fetch(const struct rn_cpu_field *field, int plane, const double uv[2],
                    const double l[2], double *ret);
// The trilinear query of the voxels beside the planes: RN_VOXEL_CHANNELS numbers.
void rn_exact_voxels(const struct rn_cpu_field *field, const double x[3], double *ret);
// Features of the sample `s` behind the ray's origin, `width` long (normalised): rn_feature_count.
// *ret_level (may be NULL) is the largest level on any axis of any plane.
void rn_exact_features(const struct rn_cpu_field *field, const struct rn_march_ray *ray,
                       double width, double s, double *ret_features, double *ret_level);

// The networks of a field in float64, and room for one sample. Thread-safety: one thread. Owner:
// the creator. The field must outlive it.
struct rn_exact;
enum rn_status rn_exact_create(const struct rn_cpu_field *field, struct rn_exact **ret_exact,
                               struct rn_error *err) RN_MUST_CHECK;
void rn_exact_destroy(struct rn_exact **exact);

struct rn_exact_pixel {
    double rgb[3], alpha, level; // level: the largest of any sample
};
// Colour over the options' background and opacity of a ray with samples at march indices k[0..n),
// without early stop.
void rn_exact_render(struct rn_exact *exact, const struct rn_march_options *options,
                     const struct rn_march_ray *ray, const uint16_t *k, int n,
                     struct rn_exact_pixel *ret_pixel);

#endif
