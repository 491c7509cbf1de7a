// Stages against float64, on recorded inputs. Each returns the largest difference over the largest
// magnitude of the reference (gradients of bf16 products: the same of norms), INFINITY when
// something is missing or not finite.
#ifndef RN_ENGINE_BENCH_CHECK_H
#define RN_ENGINE_BENCH_CHECK_H

#include "server/engine/bench/stages.h"

// Rays of pixels, projected back: relative to the picture's size.
double rn_bench_check_rays(const struct rn_bench_recording *recording);
// The share of wrong march indices, against testing every index of every ray.
double rn_bench_check_march(const struct rn_bench_recording *recording);
// Each runs its stage on a packet and looks at the outcome. Encode comes before forward, forward
// before composite.
double rn_bench_check_encode(const struct rn_bench_recording *recording,
                             const struct rn_bench_packet *packet);
double rn_bench_check_forward(const struct rn_bench_recording *recording,
                              const struct rn_bench_packet *packet);
double rn_bench_check_composite(const struct rn_bench_recording *recording,
                                const struct rn_bench_packet *packet);
// Needs the packet as `train` left it: before the others.
double rn_bench_check_backward(const struct rn_bench_recording *recording,
                               const struct rn_bench_packet *packet);
// The scatter is the fetch's adjoint: gradient times feature, summed over samples, is gradient
// times parameter, summed over texels. Leaves the gradients in place.
double rn_bench_check_scatter(const struct rn_bench_recording *recording);
// The update of the first plane with the gradients that the scatter left, which it leaves again.
double rn_bench_check_optimiser(const struct rn_bench_recording *recording);
// Pulling down is the adjoint of building. Overwrites the gradients.
double rn_bench_check_pyramid(const struct rn_bench_recording *recording);
double rn_bench_check_occupancy(const struct rn_bench_recording *recording);

#endif
