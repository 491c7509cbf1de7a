// View dependence: where colours change with the direction they are seen from, the colour network
// sees the direction. Measured on the field itself after a warm-up.
#include <math.h>
#include <stdio.h>

#include "common/math/rng.h"
#include "server/engine/effects/effects.h"

#define STREAM 0x76696577u
#define THRESHOLD (2.0 / 255) // colour change over directions that counts as noise
#define WARM_UP 0.3           // of the schedule
#define WARM_UP_STEPS 2000    // at most

static void detect(const struct rn_evidence *e, struct rn_effect_record *r) {
    r->threshold = THRESHOLD;
    struct rn_train_config *config = &e->field->config;
    bool given = config->effect[RN_EFFECT_VIEW_DEPENDENCE] != RN_EFFECT_AUTO;
    r->on =
        rn_effect_choose(config, RN_EFFECT_VIEW_DEPENDENCE, true, config->field.view_dependence);
    bool needed = config->field.appearances > 0; // by whose network colours change with it
    r->on |= needed;
    r->decided = needed || given || !config->auto_effects;
    r->number = NAN;
    snprintf(r->reason, sizeof r->reason, "%s",
             needed       ? "on, as photographs have appearances of their own"
             : r->decided ? "as asked for"
                          : "on until measured on the field after its warm-up");
    config->field.view_dependence = r->on;
}

static bool is_due(const struct rn_evidence *e) {
    return e->step >= WARM_UP_STEPS || e->done >= WARM_UP;
}

// RMS change of the colours of training rays when another camera's direction is put into the
// colour network in place of their own.
static double direction_change(const struct rn_evidence *e) {
    const struct rn_kernels *kernels = e->engine->kernels;
    struct rn_workspace *workspace = rn_engine_workspace(e->engine, 0);
    struct rn_march_options own = e->march, other = e->march;
    double sum = 0;
    int hits = 0;
    for (int i = 0; i < RN_EVIDENCE_PROBES; i++) {
        struct rn_probe p = rn_evidence_probe(e, STREAM, i);
        const struct rn_pixels *photographs = e->photographs;
        const struct rn_pixel_frame *g =
            &photographs->frames[rn_rng_below(p.random[3], (uint32_t)photographs->frame_count)];
        struct rn_march_ray ray = rn_evidence_ray(e, &p, (double)own.step);
        struct rn_pixel as_seen, from_there;
        float look[3];
        const struct rn_disparity *space = &e->field->cpu.disparity;
        double axis[3], turned[3];
        for (int k = 0; k < 3; k++)
            axis[k] = turned[k] = g->camera.world_from_camera[k][2];
        if (space->on) rn_disparity_turn(space, axis, turned);
        for (int k = 0; k < 3; k++)
            look[k] = (float)turned[k];
        kernels->render(&e->field->cpu, &own, &ray, 1, workspace, &as_seen);
        if (as_seen.alpha < 0.5f) continue;
        other.look = look;
        kernels->render(&e->field->cpu, &other, &ray, 1, workspace, &from_there);
        for (int k = 0; k < 3; k++)
            sum +=
                pow(fmin(fmax(as_seen.rgb[k], 0), 1) - fmin(fmax(from_there.rgb[k], 0), 1), 2) / 3;
        hits++;
    }
    return hits > 0 ? sqrt(sum / hits) : 0;
}

static void decide(const struct rn_evidence *e, struct rn_effect_record *r) {
    r->number = direction_change(e);
    r->on = r->number > r->threshold;
    snprintf(r->reason, sizeof r->reason,
             "another camera's direction changes the colours by %.2f/255 RMS", 255 * r->number);
    e->field->config.field.view_dependence = r->on;
}

const struct rn_effect_row rn_effect_view_dependence = {
    .unit = {"/255", 255},
    .optional = true,
    .optional_when_off = true,
    .detect = detect,
    .is_due = is_due,
    .decide = decide,
};
