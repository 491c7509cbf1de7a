// What the reference's forward leaves for its backward, and what both ask of a sample.
#ifndef RN_ENGINE_REFERENCE_TAPE_H
#define RN_ENGINE_REFERENCE_TAPE_H

#include "server/engine/reference/reference.h"

// Everything one ray's forward leaves for its backward.
struct rn_tape {
    double *storage;
    double **base;                        // [sample * (layers + 1) + layer]: activations
    double **head;                        // the same; one set only with ray shading
    double **base_grad, **head_grad;      // one set each
    double *x, *weights, *after, *colour; // per sample; colour [3]
    double *interval, *reach;             // per sample: in density units; struct placed
    double sums[RN_GEOMETRY];             // ray shading: [_, D(3), F(12)]
    double opacity, depth, rgb[3];
};
// Room for a ray of n samples, all 0. RN_ERROR_NO_MEMORY.
enum rn_status rn_tape_init(const struct rn_reference *reference, int n,
                            struct rn_tape *ret_tape) RN_MUST_CHECK;
void rn_tape_finish(struct rn_tape *tape);
void rn_reference_forward(const struct rn_reference *reference, const struct rn_reference_ray *ray,
                          struct rn_tape *tape);

// x rounded to the nearest fp16 number.
double rn_reference_half(double x);
// A sample's length of optical depth in density units, and how far along the ray it lies in the
// planes' frame.
void rn_reference_extent(const struct rn_reference *reference, const struct rn_reference_ray *ray,
                         double mid, double *ret_interval, double *ret_reach);
// The adjoint of rn_reference_encode: adds to map_grad, and to plane_grad of the voxels.
void rn_reference_encode_backward(struct rn_reference *reference,
                                  const struct rn_reference_ray *ray, double mid,
                                  const double *feature_grad);

#endif
