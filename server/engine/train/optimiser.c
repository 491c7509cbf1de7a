// The update at a step's end: gradients of all groups, AdamW, smoothing.
#include "server/engine/train/optimiser.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

// ---- memory ---------------------------------------------------------------------------------

size_t rn_optimiser_moments(const struct rn_field *field) {
    return field->parameters.count + 64;
}

enum rn_status rn_optimiser_allocate(const struct rn_field *field, struct rn_optimiser *o,
                                     struct rn_error *err) {
    const struct rn_field_config *c = &field->config.field;
    size_t count = rn_optimiser_moments(field);
    o->levels = field->cpu.built_levels;
    size_t pyramid = rn_pyramid_count(c, o->levels) * (size_t)c->planes;
    o->tiled = c->base % (1 << (o->levels - 1)) == 0;
    o->bands = o->tiled ? 4 : 1;
    struct rn_tiling tiling = rn_tiling(c->base, c->channels, o->levels);
    o->tiles = (size_t)tiling.columns * (size_t)tiling.rows;
    if (!o->grad) o->grad = rn_block_create(3 * count * sizeof(float));
    o->grad_pyramid = rn_block_create((pyramid + 64) * sizeof(float));
    o->touched = calloc((size_t)c->planes * o->tiles, 1);
    if (!o->grad || !o->grad_pyramid || !o->touched)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    o->m = o->grad + count;
    o->v = o->m + count;
    rn_pyramid_lay_out(c, o->levels, o->grad, o->grad_pyramid, o->grad_maps);
    return RN_OK;
}

void rn_optimiser_free(struct rn_optimiser *o) {
    rn_block_destroy(o->grad_pyramid);
    free(o->touched);
    rn_block_destroy(o->good);
    o->grad_pyramid = o->good = NULL;
    o->touched = NULL;
}

int rn_trainer_band(const struct rn_trainer *t, int band) {
    const struct rn_optimiser *o = &t->optimiser;
    int base = t->field->config.field.base, unit = o->tiled ? 1 << (o->levels - 1) : base;
    return base / unit * band / o->bands * unit;
}

// ---- update ---------------------------------------------------------------------------------

struct update {
    struct rn_trainer *trainer;
    struct rn_adamw planes;
};

static void pull_down_plane(void *context, int plane, int thread) {
    (void)thread;
    struct rn_trainer *t = context;
    const struct rn_field_config *c = &t->field->config.field;
    t->engine->kernels->pull_down(t->optimiser.grad_maps[plane], t->optimiser.levels,
                                  c->footprint == RN_FOOTPRINT_MIP, c->channels);
}

struct smoothing {
    struct rn_trainer *trainer;
    float share;
};

static void smooth_plane(void *context, int plane, int thread) {
    (void)thread;
    const struct smoothing *s = context;
    struct rn_trainer *t = s->trainer;
    const struct rn_field_config *c = &t->field->config.field;
    struct rn_map(*maps)[RN_MAX_LEVELS] = t->field->cpu.maps[plane];
    t->engine->kernels->smooth(maps[0][0].texels, c->base, c->channels, s->share);
    if (t->optimiser.tiled && t->optimiser.levels > 1)
        t->engine->kernels->build(maps, t->optimiser.levels, c->footprint == RN_FOOTPRINT_MIP,
                                  c->channels);
}

static void update_band(void *context, int index, int thread) {
    (void)thread;
    const struct update *u = context;
    struct rn_trainer *t = u->trainer;
    const struct rn_field_config *c = &t->field->config.field;
    size_t plane = (size_t)(index / t->optimiser.bands), base = (size_t)c->base;
    size_t at = plane * base * base * (size_t)c->channels;
    int band = index % t->optimiser.bands;
    bool sparse = t->field->config.sparse && t->optimiser.tiled;
    struct rn_plane_update update = {
        .options = &u->planes,
        .maps = t->field->cpu.maps[plane],
        .grad_maps = t->optimiser.grad_maps[plane],
        .m = t->optimiser.m + at,
        .v = t->optimiser.v + at,
        .touched = sparse ? t->optimiser.touched + plane * t->optimiser.tiles : NULL,
        .levels = t->optimiser.tiled ? t->optimiser.levels : 1,
        .channels = c->channels,
        .mip = c->footprint == RN_FOOTPRINT_MIP};
    if (!t->engine->kernels->update(&update, rn_trainer_band(t, band),
                                    rn_trainer_band(t, band + 1)))
        t->optimiser.wild = true;
}

// Adds the groups' gradients in order into the first; false when anything is not finite.
static bool sum_groups(struct rn_trainer *t, double *ret_loss, double *ret_weight) {
    const struct rn_parameters *p = &t->field->parameters;
    size_t n = p->base_count + p->head_count;
    float *sum = t->optimiser.grad + p->plane_count;
    double loss = 0, weight = 0, check = 0;
    for (int g = 0; g < RN_GROUPS; g++) {
        const struct rn_group *group = &t->step.groups[g];
        loss += group->loss;
        weight += group->weight;
        t->progress.nonfinite_rays += group->nonfinite_rays;
        for (size_t i = 0; i < n; i++)
            sum[i] += group->base_grad[i];
    }
    for (size_t i = 0; i < n; i++)
        check += (double)sum[i] * 0;
    *ret_loss = loss;
    *ret_weight = weight;
    return check == 0 && isfinite(loss);
}

static void apply(struct rn_trainer *t, double weight) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_parameters *p = &t->field->parameters;
    double n = (double)++t->optimiser.updates,
           rate = rn_schedule_rate(&t->field->config, &t->progress);
    struct rn_adamw networks = {.scale = (float)(1 / weight),
                                .rate = (float)rate,
                                .decay = (float)config->weight_decay,
                                .eps = (float)config->adam_eps,
                                .correction1 = (float)-expm1(n * log(0.9)),
                                .keep = (float)config->beta2,
                                .fresh = (float)(1 - config->beta2),
                                .correction2 = (float)-expm1(n * log(config->beta2))};
    struct update u = {t, networks};
    u.planes.rate = (float)(rate * config->plane_rate);
    if (config->sparse) u.planes.decay = 0; // what is visited more often would decay more
    if (!t->optimiser.tiled) rn_pool_run(t->engine->pool, config->field.planes, pull_down_plane, t);
    rn_pool_run(t->engine->pool, config->field.planes * t->optimiser.bands, update_band, &u);
    size_t at = p->plane_count;
    if (!t->engine->kernels->adamw(&networks, p->base_count + p->head_count, p->values + at,
                                   t->optimiser.grad + at, t->optimiser.m + at,
                                   t->optimiser.v + at))
        t->optimiser.wild = true;
    struct smoothing smoothing = {t, rn_schedule_smoothing(&t->field->config, &t->progress)};
    if (smoothing.share > 0)
        rn_pool_run(t->engine->pool, config->field.planes, smooth_plane, &smoothing);
    t->field->fresh_levels = t->optimiser.levels;
    if (t->optimiser.tiled)
        rn_field_pack(t->field, t->engine);
    else
        rn_field_refresh(t->field, t->engine);
}

static void reject(struct rn_trainer *t) {
    const struct rn_field_config *c = &t->field->config.field;
    t->progress.steps_rejected++;
    memset(t->optimiser.grad, 0, t->field->parameters.count * sizeof(float));
    memset(t->optimiser.grad_pyramid, 0,
           rn_pyramid_count(c, t->optimiser.levels) * (size_t)c->planes * sizeof(float));
    memset(t->optimiser.touched, 0, (size_t)c->planes * t->optimiser.tiles);
}

bool rn_trainer_update(struct rn_trainer *t) {
    double loss, weight;
    bool finite = sum_groups(t, &loss, &weight);
    if (!finite)
        reject(t);
    else if (weight > 0)
        apply(t, weight);
    if (finite && weight > 0) t->progress.loss = loss / weight;
    return finite;
}
