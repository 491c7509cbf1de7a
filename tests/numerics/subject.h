// What the numerics cases examine: the field's mathematics as one number type or one kernel set
// computes it. Numbers travel as float64, which holds every float; inputs must be numbers of the
// subject's type.
#ifndef RN_TESTS_NUMERICS_SUBJECT_H
#define RN_TESTS_NUMERICS_SUBJECT_H

#include <stdbool.h>
#include <stdint.h>

struct rn_occupancy_bits;
struct rn_march_ray;
struct rn_ray;
struct rn_cpu_field;
struct rn_disparity;

// A constant table of functions; those that a subject lacks are NULL. Thread-safety: all; `cuda`
// one thread.
struct subject {
    const char *name; // "float64", "float32", the kernel set's, or "cuda": the GPU's, emulated
    int digits;       // bits of its significand: 53 or 24
    bool fast;        // a kernel set, or the GPU's: functions marked * are NULL
    bool device;      // the machine's own approximate logarithm, root and quotient
    double (*nearest)(double x);
    // mean, axial, radial; then the forms that lose digits: from end points by t^5 (the paper's
    // appendix) and mip-NeRF's stable form with its subtraction.
    void (*moments)(double mid, double width, double radius, double ret[3]);
    void (*moments_powers)(double mid, double width, double radius, double ret[3]);
    void (*moments_mipnerf)(double mid, double width, double radius, double ret[3]);
    double (*variance)(const double axis[3], const double d[3], double axial, double radial);
    double (*level)(double variance, int size, int levels);
    double (*ball_level)(double ball, int size, int levels); // *
    int (*taps)(int size, int i, int *ret_first, double weight[3]);
    void (*lerp)(double p, int size, int *ret_low, int *ret_high, double *ret_fraction);
    double (*density)(double logit);
    double (*alpha)(double x);
    // `n` up to SUBJECT_MAX_SAMPLES.
    double (*composite)(int n, const double *x, double *weights, double *after);
    void (*composite_backward)(int n, const double *weights, const double *after, const double *g,
                               double *grad);
    // Unbounded space: scale, across and along at a distance from the centre; where a place is.
    void (*contraction)(double r, double ret[3]);
    double (*distance_of_place)(double place);
    // Spherical harmonics of a direction.
    void (*harmonics)(const double d[3], double ret[16]);
    // Kernel sets only: weights where the ray ends once its optical depth exceeds `stop_depth`.
    void (*composite_stopped)(int n, const double *x, double stop_depth, double *weights);
    // Kernel sets only: features of n <= SUBJECT_QUERIES positions and levels on plane 0, each
    // `channels` numbers; arrays have room for SUBJECT_QUERIES + 16.
    void (*query)(const struct rn_cpu_field *field, int n, const float *u, const float *v,
                  const float *lx, const float *ly, float *ret_features);
    // Kernel sets only: features of n <= SUBJECT_QUERIES places in the voxels, RN_VOXEL_CHANNELS
    // each; arrays have the same room.
    void (*voxels)(const struct rn_cpu_field *field, int n, float *const place[3],
                   float *ret_features);
    // Kernel sets only: rn_march_ray_from in the unit ball, without jitter and cone steps.
    void (*cut)(const struct rn_ray *ray, double step, struct rn_march_ray *ret);
    // Kernel sets only: rn_ray_cut_forward without jitter, and the gradient of `factor` times the
    // distortion loss of up to SUBJECT_MAX_SAMPLES samples `width` long at `places`.
    void (*cut_forward)(const struct rn_disparity *box, const struct rn_ray *ray, double step,
                        struct rn_march_ray *ret);
    void (*distortion)(int n, const double *weights, const double *places, double width,
                       double factor, double *grad);
    // Kernel sets only: the march indices of samples in occupied cells, at most `room`; room + 1
    // where a march in rounds finds others.
    int (*march)(const struct rn_occupancy_bits *grid, const struct rn_march_ray *ray, float step,
                 uint16_t *ret_k, int room);
    // Kernel sets only: the cell that is told what a sample there showed, `s` behind the origin.
    int (*cell)(const struct rn_cpu_field *field, const struct rn_march_ray *ray, double s);
};

#define SUBJECT_MAX_SAMPLES 4096
#define SUBJECT_QUERIES 64

// float64, float32, then the kernel sets this machine can run, then the GPU's kernels where the
// emulator was built; NULL past the end.
const struct subject *subject_at(int i);
// Whose optimiser is examined: the kernel sets, then likewise. Only `name` and `adamw` are sure.
struct rn_kernels;
const struct rn_kernels *optimiser_at(int i);

#endif
