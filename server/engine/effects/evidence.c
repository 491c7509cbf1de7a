// What several effects measure.
#include <math.h>

#include "common/math/rng.h"
#include "server/engine/effects/effects.h"

struct rn_probe rn_evidence_probe(const struct rn_evidence *e, uint64_t stream, int i) {
    struct rn_rng4 draw = rn_rng_draw(e->field->config.seed, stream, (uint64_t)i);
    const struct rn_pixels *p = e->photographs;
    struct rn_probe probe = {.frame =
                                 &p->frames[rn_rng_below(draw.v[0], (uint32_t)p->frame_count)]};
    probe.x = (int)rn_rng_below(draw.v[1], (uint32_t)probe.frame->camera.width);
    probe.y = (int)rn_rng_below(draw.v[2], (uint32_t)probe.frame->camera.height);
    for (int k = 0; k < 4; k++)
        probe.random[k] = draw.v[k];
    return probe;
}

struct rn_march_ray rn_evidence_ray(const struct rn_evidence *e, const struct rn_probe *probe,
                                    double step) {
    struct rn_ray_place place = {&probe->frame->view, probe->x, probe->y, 0};
    struct rn_march_ray ray;
    e->engine->kernels->rays(&place, 1, step, e->field->config.cone_step, &ray);
    return ray;
}

void rn_evidence_cones(const struct rn_evidence *e, double *ret_smallest, double *ret_largest) {
    *ret_smallest = INFINITY;
    *ret_largest = 0;
    for (int f = 0; f < e->photographs->frame_count; f++) {
        double radius = rn_cone_at_centre(e->field, &e->photographs->frames[f].camera);
        *ret_smallest = fmin(*ret_smallest, fmax(radius, 1e-30));
        *ret_largest = fmax(*ret_largest, radius);
    }
}
