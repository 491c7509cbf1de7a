// Small fields and rays with known random parameters, for the checks of the reference.
#ifndef RN_TESTS_UNIT_ENGINE_FIELD_SAMPLES_H
#define RN_TESTS_UNIT_ENGINE_FIELD_SAMPLES_H

#include <check.h>
#include <math.h>
#include <stdlib.h>

#include "common/math/rng.h"
#include "server/engine/reference/reference.h"

// Uniform in [-1, 1) from a stream and a counter.
static inline double sample_number(uint64_t stream, uint64_t i) {
    return 2.0 * rn_rng_unit(rn_rng_draw(17, stream, i).v[0]) - 1;
}

static inline struct rn_field_config sample_config(void) {
    struct rn_field_config config = {.planes = 3,
                                     .orientation = RN_ORIENTATION_PLATONIC,
                                     .base = 8,
                                     .channels = 4,
                                     .levels = 3,
                                     .footprint = RN_FOOTPRINT_RIP,
                                     .shading = RN_SHADING_SAMPLE,
                                     .width = 16,
                                     .base_layers = 1,
                                     .head_layers = 2,
                                     .view_dependence = true,
                                     .occupancy = 16};
    return config;
}

// A field with random parameters, its pyramid built. Owned by the caller.
static inline struct rn_reference *sample_field(const struct rn_field_config *config) {
    struct rn_reference *ref = NULL;
    struct rn_error err;
    ck_assert_int_eq(rn_reference_create(config, 1, &ref, &err), RN_OK);
    for (size_t i = 0; i < ref->plane_count; i++)
        ref->planes[i] = sample_number(1, i);
    for (size_t i = 0; i < ref->base_shape.count; i++)
        ref->base[i] = 0.4 * sample_number(2, i);
    for (size_t i = 0; i < ref->head_shape.count; i++)
        ref->head[i] = 0.4 * sample_number(3, i);
    rn_reference_build(ref);
    return ref;
}

#endif
