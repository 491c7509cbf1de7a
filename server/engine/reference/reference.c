#include "server/engine/reference/reference.h"

#include <math.h>
#include <stdlib.h>

#include "server/engine/field/voxels.h"

enum rn_status rn_reference_create(const struct rn_field_config *config, uint64_t seed,
                                   struct rn_reference **ret_reference, struct rn_error *err) {
    struct rn_reference *ref = calloc(1, sizeof *ref);
    if (!ref) return rn_error_set(err, RN_ERROR_NO_MEMORY, "reference", "out of memory");
    ref->config = *config;
    ref->pixel_rays = 1;
    enum rn_status status =
        rn_solid_init(config->planes, config->orientation, seed, &ref->solid, err);
    if (status != RN_OK) goto fail;
    ref->base_shape =
        rn_mlp_shape(rn_feature_count(config), config->width, config->base_layers, RN_GEOMETRY);
    ref->head_shape =
        rn_mlp_shape(RN_HEAD_INPUTS, config->width, config->head_layers, RN_HEAD_OUTPUTS);
    ref->plane_count = (size_t)rn_grid_count(config) * rn_grid_numbers(config);
    ref->map_count = rn_reference_map_offset(ref, config->planes, 0, 0);
    size_t total =
        2 * (ref->plane_count + ref->map_count + ref->base_shape.count + ref->head_shape.count);
    double *block = calloc(total, sizeof *block);
    if (!block) {
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "reference", "out of memory");
        goto fail;
    }
    ref->planes = block;
    ref->plane_grad = ref->planes + ref->plane_count;
    ref->maps = ref->plane_grad + ref->plane_count;
    ref->map_grad = ref->maps + ref->map_count;
    ref->base = ref->map_grad + ref->map_count;
    ref->base_grad = ref->base + ref->base_shape.count;
    ref->head = ref->base_grad + ref->base_shape.count;
    ref->head_grad = ref->head + ref->head_shape.count;
    *ret_reference = ref;
    return RN_OK;
fail:
    rn_reference_destroy(&ref);
    return status;
}

void rn_reference_destroy(struct rn_reference **reference) {
    if (!*reference) return;
    free((*reference)->planes);
    free(*reference);
    *reference = NULL;
}

void rn_reference_adamw(size_t n, double *parameter, const double *grad, double *m, double *v,
                        double rate, double decay, double eps, int64_t step) {
    // log1p: 1 - 0.999 as float64 has it is 4 ULP from 0.001.
    double c1 = -expm1((double)step * log1p(-0.1)), c2 = -expm1((double)step * log1p(-0.001));
    for (size_t i = 0; i < n; i++) {
        m[i] = 0.9 * m[i] + 0.1 * grad[i];
        v[i] = 0.999 * v[i] + 0.001 * grad[i] * grad[i];
        parameter[i] -= rate * (decay * parameter[i] + (m[i] / c1) / (sqrt(v[i] / c2) + eps));
    }
}
