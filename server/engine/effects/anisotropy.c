// Anisotropy: where footprints are much longer than wide, each axis of a plane has a level of its
// own (a ripmap); elsewhere both have the same (a mipmap).
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/numbers.h"
#include "common/math/rng.h"
#include "server/engine/effects/effects.h"
#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"

#define STREAM 0x6566666563747300u
#define THRESHOLD 0.585 // levels: a footprint 1.5 times as long as wide

// How the space around a sample is drawn.
struct bent {
    bool is_bent;
    struct rn_contraction lengths;
    double towards[3]; // from the centre
};

// A sample of unbounded space, so many places behind the ray's near end.
static struct rn_moments bent_sample(const struct rn_march_ray *ray, double place, double width,
                                     struct bent *ret) {
    double s = rn_distance_of_place(2 - (double)ray->length + place), r = 0;
    double t = (double)ray->near + s, across = t * (double)ray->radius;
    width *= 2 * rn_stretch_at(s);
    for (int i = 0; i < 3; i++) {
        ret->towards[i] = (double)ray->origin[i] + (double)ray->direction[i] * s;
        r += ret->towards[i] * ret->towards[i];
    }
    r = sqrt(r);
    for (int i = 0; i < 3 && r > 0; i++)
        ret->towards[i] /= r;
    ret->lengths = rn_contraction_at(r);
    ret->is_bent = true;
    return (struct rn_moments){t, width * width / 12, across * across / 4};
}

static void drawn_axis(const struct bent *bent, const double axis[3], double ret[3]) {
    if (bent->is_bent)
        rn_contracted_axis(&bent->lengths, bent->towards, axis, ret);
    else
        memcpy(ret, axis, 3 * sizeof *ret);
}

// The difference of both axes' levels, on the plane where it is largest, of a sample somewhere on a
// ray: as long as the march makes it, whose samples span several steps where cones are wide.
static double spread_of(const struct rn_evidence *e, const struct rn_march_ray *ray, double along) {
    const struct rn_train_config *config = &e->field->config;
    const struct rn_field_config *c = &config->field;
    int base = rn_footprint_base(c);
    if (c->footprint_base == 0 && config->grow_to > base) base = config->grow_to;
    double d[3] = {ray->direction[0], ray->direction[1], ray->direction[2]}, spread = 0;
    double length = ray->length > 0 ? ray->length : 0, width = config->step * ray->stride;
    struct bent bent = {.is_bent = false};
    struct rn_moments m;
    if (c->space == RN_SPACE_UNBOUNDED)
        m = bent_sample(ray, length * along, width, &bent);
    else
        m = rn_frustum_moments(ray->near + length * along, width, ray->radius);
    for (int p = 0; p < c->planes; p++) {
        const struct rn_solid *solid = &e->field->cpu.solid;
        double au[3], av[3];
        drawn_axis(&bent, solid->axis_u[p], au);
        drawn_axis(&bent, solid->axis_v[p], av);
        double u = rn_projected_variance(au, d, m.axial, m.radial);
        double v = rn_projected_variance(av, d, m.axial, m.radial);
        double lu = rn_level_from_variance(u, base, c->levels);
        double lv = rn_level_from_variance(v, base, c->levels);
        spread = fmax(spread, fabs(lu - lv));
    }
    return spread;
}

// Its 95th percentile over random training rays.
static double probe(const struct rn_evidence *e) {
    double spread[RN_EVIDENCE_PROBES];
    for (int i = 0; i < RN_EVIDENCE_PROBES; i++) {
        struct rn_probe p = rn_evidence_probe(e, STREAM, i);
        struct rn_march_ray ray = rn_evidence_ray(e, &p, e->field->config.step);
        spread[i] = spread_of(e, &ray, rn_rng_unit(p.random[3]));
    }
    rn_numbers_sort(spread, RN_EVIDENCE_PROBES);
    return spread[RN_EVIDENCE_PROBES * 95 / 100];
}

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    const struct rn_train_config *config = &e->field->config;
    bool pyramid = e->field->effects[RN_EFFECT_SCALE_PYRAMID].on;
    bool rip = config->field.footprint == RN_FOOTPRINT_RIP;
    bool asked = !config->auto_effects || config->footprint_given;
    r->number = probe(e);
    r->threshold = THRESHOLD;
    r->on = rn_effect_choose(config, RN_EFFECT_ANISOTROPY, pyramid && rip,
                             asked || r->number > r->threshold);
    snprintf(r->reason, sizeof r->reason,
             "95 %% of footprints are at most %.2f times as long as wide%s", exp2(r->number),
             !rip      ? "; the field's footprint is isotropic"
             : pyramid ? ""
                       : "; without a scale pyramid it has no use");
}

static void settle(const struct rn_evidence *e) {
    struct rn_train_config *config = &e->field->config;
    bool asked = !config->auto_effects || config->footprint_given;
    if (config->effect[RN_EFFECT_ANISOTROPY] == RN_EFFECT_AUTO && asked) return;
    if (config->field.footprint != RN_FOOTPRINT_RIP || e->field->effects[RN_EFFECT_ANISOTROPY].on)
        return;
    config->field.footprint = RN_FOOTPRINT_MIP;
}

const struct rn_effect_row rn_effect_anisotropy = {
    .unit = {" times as long as wide", 0, "as long as wide"},
    .optional = true,
    .detect = detect,
    .settle = settle,
};
