// Which effects a scene calls for, each with its number.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/render/cones.h"
#include "server/engine/train/trainer.h"

#define PROBES 512                 // rays looked at
#define RANGE_THRESHOLD 0.5        // levels: footprints 1.4 times as large
#define ANISOTROPY_THRESHOLD 0.585 // levels: a footprint 1.5 times as long as wide
#define VIEW_THRESHOLD (2.0 / 255) // colour change over directions that counts as noise

static struct rn_effect_record *record(struct rn_trainer *t, enum rn_effect effect,
                                       const char *name) {
    struct rn_effect_record *r = &t->field->effects[effect];
    *r = (struct rn_effect_record){.name = name, .decided = true};
    return r;
}

static void detect_background(struct rn_trainer *t) {
    struct rn_effect_record *r = record(t, RN_EFFECT_BACKGROUND, "background");
    size_t open = 0;
    for (size_t i = 0; i < t->train.pixel_count; i++)
        open += t->train.rgba[4 * i + 3] < 255;
    r->number = (double)open / (double)t->train.pixel_count;
    r->on = r->number > r->threshold;
    snprintf(r->reason, sizeof r->reason, "%.1f %% of the training pixels have alpha below 255",
             100 * r->number);
}

static int compare_doubles(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

// 95th percentile, over random training rays, of the difference of the two axes' levels on the
// plane where it is largest.
static double probe_anisotropy(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_field_config *c = &config->field;
    int base = rn_footprint_base(c);
    if (c->footprint_base == 0 && config->grow_to > base) base = config->grow_to;
    double spread[PROBES];
    for (int i = 0; i < PROBES; i++) {
        struct rn_rng4 draw = rn_rng_draw(config->seed, 0x6566666563747300u, (uint64_t)i);
        const struct rn_pixel_frame *f =
            &t->train.frames[rn_rng_below(draw.v[0], (uint32_t)t->train.frame_count)];
        int x = (int)rn_rng_below(draw.v[1], (uint32_t)f->frame->camera.width);
        int y = (int)rn_rng_below(draw.v[2], (uint32_t)f->frame->camera.height);
        struct rn_march_ray ray = rn_trainer_ray(t, &t->train, f, x, y, config->step, 0);
        double d[3] = {ray.direction[0], ray.direction[1], ray.direction[2]};
        double length = ray.length > 0 ? ray.length : 0;
        double mid = ray.near + length * rn_rng_unit(draw.v[3]);
        struct rn_moments m = rn_frustum_moments(mid, config->step, ray.radius);
        spread[i] = 0;
        for (int p = 0; p < c->planes; p++) {
            double u = rn_projected_variance(t->field->cpu.solid.axis_u[p], d, m.axial, m.radial);
            double v = rn_projected_variance(t->field->cpu.solid.axis_v[p], d, m.axial, m.radial);
            double lu = rn_level_from_variance(u, base, c->levels);
            double lv = rn_level_from_variance(v, base, c->levels);
            spread[i] = fmax(spread[i], fabs(lu - lv));
        }
    }
    qsort(spread, PROBES, sizeof *spread, compare_doubles);
    return spread[PROBES * 95 / 100];
}

// The smallest and the largest radius of a training pixel's cone at the scene's centre.
static void cone_range(const struct rn_trainer *t, double *ret_smallest, double *ret_largest) {
    *ret_smallest = INFINITY;
    *ret_largest = 0;
    for (int f = 0; f < t->train.frame_count; f++) {
        double radius = rn_cone_at_centre(&t->field->bounds, &t->train.frames[f].frame->camera);
        *ret_smallest = fmin(*ret_smallest, fmax(radius, 1e-30));
        *ret_largest = fmax(*ret_largest, radius);
    }
}

void rn_trainer_note_cone(struct rn_trainer *t) {
    double smallest, largest;
    cone_range(t, &smallest, &largest);
    t->field->finest_cone = largest > 0 ? t->march.split ? smallest / 2 : smallest : 0;
}

// Their range in levels.
static double footprint_range(const struct rn_trainer *t) {
    double smallest, largest;
    cone_range(t, &smallest, &largest);
    return largest > 0 ? log2(largest / smallest) : 0;
}

// Where footprints hardly differ, they are measured in texels so wide that all of them are at level
// 0: no pyramid is built or read in training; a camera farther away still gets its levels.
static void anchor_footprints(struct rn_trainer *t) {
    struct rn_field_config *c = &t->field->config.field;
    int base = t->field->config.grow_to > c->base ? t->field->config.grow_to : c->base;
    double top = 0;
    c->footprint_base = base;
    for (int f = 0; f < t->train.frame_count; f++)
        top = fmax(
            top, rn_top_level(t->field, &t->train.frames[f].frame->camera, t->field->config.step));
    if (top > 0) c->footprint_base = (int)(base / exp2(top));
    if (c->footprint_base < 1) c->footprint_base = 1;
}

static void detect_footprints(struct rn_trainer *t) {
    const struct rn_field_config *c = &t->field->config.field;
    double spread = probe_anisotropy(t);
    bool can = c->footprint != RN_FOOTPRINT_POINT && c->levels > 1;
    struct rn_effect_record *pyramid = record(t, RN_EFFECT_SCALE_PYRAMID, "scale-pyramid");
    pyramid->number = footprint_range(t);
    pyramid->threshold = RANGE_THRESHOLD;
    bool asked = !t->field->config.auto_effects || t->field->config.footprint_given;
    pyramid->on = can && (asked || pyramid->number > pyramid->threshold);
    snprintf(
        pyramid->reason, sizeof pyramid->reason,
        "footprints at the scene's centre differ by a factor of %.2f over the training cameras%s",
        exp2(pyramid->number), can ? "" : "; the field samples points");
    struct rn_effect_record *anisotropy = record(t, RN_EFFECT_ANISOTROPY, "anisotropy");
    anisotropy->number = spread;
    anisotropy->threshold = ANISOTROPY_THRESHOLD;
    anisotropy->on = pyramid->on && c->footprint == RN_FOOTPRINT_RIP &&
                     (spread > ANISOTROPY_THRESHOLD || !t->field->config.auto_effects ||
                      t->field->config.footprint_given);
    snprintf(anisotropy->reason, sizeof anisotropy->reason,
             "95 %% of footprints are at most %.2f times as long as wide%s", exp2(spread),
             c->footprint != RN_FOOTPRINT_RIP ? "; the field's footprint is isotropic"
             : pyramid->on                    ? ""
                                              : "; without a scale pyramid it has no use");
}

static void detect_view_dependence(struct rn_trainer *t) {
    struct rn_effect_record *r = record(t, RN_EFFECT_VIEW_DEPENDENCE, "view-dependence");
    r->threshold = VIEW_THRESHOLD;
    r->on = t->field->config.field.view_dependence;
    r->decided = !t->field->config.auto_effects;
    r->number = NAN;
    snprintf(r->reason, sizeof r->reason, "%s",
             r->decided ? "as asked for" : "on until measured on the field after its warm-up");
}

// Switches off what the data does not call for, before anything is allocated for it.
void rn_trainer_detect_effects(struct rn_trainer *t) {
    struct rn_train_config *config = &t->field->config;
    detect_background(t);
    rn_trainer_note_cone(t);
    detect_footprints(t);
    detect_view_dependence(t);
    if (!t->field->effects[RN_EFFECT_BACKGROUND].on) {
        config->carve = false;
        config->random_background = 0;
        memset(config->background, 0, sizeof config->background);
    }
    bool anisotropy = t->field->effects[RN_EFFECT_ANISOTROPY].on;
    // Photographs of several scales say as much; their frames would take four times as long.
    bool scales = t->field->effects[RN_EFFECT_SCALE_PYRAMID].number > RANGE_THRESHOLD;
    if (config->auto_effects && scales) config->split_pixels = 0;
    bool may_switch = config->auto_effects && !config->footprint_given;
    if (may_switch && config->field.footprint == RN_FOOTPRINT_RIP && !anisotropy)
        config->field.footprint = RN_FOOTPRINT_MIP;
    if (may_switch && !t->field->effects[RN_EFFECT_SCALE_PYRAMID].on &&
        config->field.footprint != RN_FOOTPRINT_POINT)
        anchor_footprints(t);
}

// RMS change of the colours of training rays when another camera's direction is put into the
// colour network in place of their own.
static double direction_change(struct rn_trainer *t) {
    struct rn_march_options options = rn_trainer_march(t);
    double sum = 0;
    int hits = 0;
    for (int i = 0; i < PROBES; i++) {
        struct rn_rng4 draw = rn_rng_draw(t->field->config.seed, 0x76696577u, (uint64_t)i);
        const struct rn_pixel_frame *f =
            &t->train.frames[rn_rng_below(draw.v[0], (uint32_t)t->train.frame_count)];
        const struct rn_pixel_frame *g =
            &t->train.frames[rn_rng_below(draw.v[3], (uint32_t)t->train.frame_count)];
        int x = (int)rn_rng_below(draw.v[1], (uint32_t)f->frame->camera.width);
        int y = (int)rn_rng_below(draw.v[2], (uint32_t)f->frame->camera.height);
        struct rn_march_ray ray = rn_trainer_ray(t, &t->train, f, x, y, (double)options.step, 0);
        float look[3];
        for (int k = 0; k < 3; k++)
            look[k] = (float)g->frame->camera.world_from_camera[k][2];
        struct rn_pixel own, other;
        struct rn_workspace *w = rn_engine_workspace(t->engine, 0);
        options.look = NULL;
        t->engine->kernels->render(&t->field->cpu, &options, &ray, 1, w, &own);
        if (own.alpha < 0.5f) continue;
        options.look = look;
        t->engine->kernels->render(&t->field->cpu, &options, &ray, 1, w, &other);
        for (int k = 0; k < 3; k++)
            sum += pow(fmin(fmax(own.rgb[k], 0), 1) - fmin(fmax(other.rgb[k], 0), 1), 2) / 3;
        hits++;
    }
    return hits > 0 ? sqrt(sum / hits) : 0;
}

void rn_trainer_decide_view_dependence(struct rn_trainer *t) {
    struct rn_effect_record *r = &t->field->effects[RN_EFFECT_VIEW_DEPENDENCE];
    if (r->decided) return;
    r->decided = true;
    r->number = direction_change(t);
    r->on = r->number > r->threshold;
    snprintf(r->reason, sizeof r->reason,
             "another camera's direction changes the colours by %.2f/255 RMS (noise: %.0f/255)",
             255 * r->number, 255 * r->threshold);
    t->field->config.field.view_dependence = r->on;
}
