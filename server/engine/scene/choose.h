// Which kernel set is the quickest here, by measurement. Inside the engine only.
#ifndef RN_ENGINE_CHOOSE_H
#define RN_ENGINE_CHOOSE_H

#include "server/engine/scene/scene.h"

// Seconds of one thread for `rows` samples forward and backward through the networks that `config`
// describes (with ray shading one row in 32 goes through the colour network): the least of several
// calls in `seconds`, at least two. 1 to 4096 rows. INFINITY without memory. `parts`, when not
// NULL, gets the least of forward and backward each.
double rn_choose_time(const struct rn_kernels *kernels, const struct rn_field_config *config,
                      int rows, double seconds, double *ret_parts);

// The set that is quickest with these networks.
const struct rn_kernels *rn_choose_kernels(const struct rn_field_config *config);

#endif
