// The update at a step's end: gradients of all groups, AdamW, smoothing.
#include "server/engine/train/optimiser.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/voxels.h"
#include "server/engine/scene/appearance.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

// ---- memory ---------------------------------------------------------------------------------

size_t rn_optimiser_moments(const struct rn_field *field) {
    return field->parameters.count + 64;
}

static bool is_apart(const struct rn_train_config *config, bool tiled) {
    return tiled && !config->sparse && config->smoothing == 0;
}

size_t rn_optimiser_apart_bytes(const struct rn_train_config *config, size_t parameters,
                                int levels) {
    bool tiled = config->field.base % (1 << (levels - 1)) == 0;
    size_t pyramid = rn_pyramid_count(&config->field, levels) * (size_t)config->field.planes;
    return is_apart(config, tiled) ? (parameters + pyramid) * sizeof(float) : 0;
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
    if (c->voxels) tiling = rn_tiling(c->base, c->channels, 1); // at least as many
    o->tiles = (size_t)tiling.columns * (size_t)tiling.rows;
    if (!o->grad) o->grad = rn_block_create(3 * count * sizeof(float));
    o->grad_pyramid = rn_block_create((pyramid + 64) * sizeof(float));
    o->touched = calloc((size_t)rn_grid_count(c) * o->tiles, 1);
    if (!o->grad || !o->grad_pyramid || !o->touched)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    o->m = o->grad + count;
    o->v = o->m + count;
    if (is_apart(&field->config, o->tiled)) { // without memory for it: in place
        o->apart = rn_block_create(count * sizeof(float));
        o->apart_pyramid = rn_block_create(pyramid * sizeof(float));
        o->apart_maps = calloc(RN_MAX_PLANES, sizeof *o->apart_maps);
        o->apart_levels = o->apart_pyramid ? o->levels : 1;
        // All of it is written by the first step, for which no picture should wait.
        rn_block_touch(o->grad, 3 * count * sizeof(float));
        rn_block_touch(o->grad_pyramid, pyramid * sizeof(float));
        if (o->apart) rn_block_touch(o->apart, count * sizeof(float));
        if (o->apart_pyramid) rn_block_touch(o->apart_pyramid, pyramid * sizeof(float));
    }
    rn_pyramid_lay_out(c, o->levels, o->grad, o->grad_pyramid, o->grad_maps);
    return RN_OK;
}

void rn_optimiser_free(struct rn_optimiser *o) {
    rn_block_destroy(o->grad_pyramid);
    free(o->touched);
    rn_block_destroy(o->good);
    rn_block_destroy(o->apart);
    rn_block_destroy(o->apart_pyramid);
    free(o->apart_maps);
    o->grad_pyramid = o->good = o->apart = o->apart_pyramid = NULL;
    o->touched = NULL;
    o->apart_maps = NULL;
    o->update.under_way = false;
}

// The first row of a part of a plane; parts are whole tiles.
static int first_row(const struct rn_trainer *t, int part, int parts) {
    const struct rn_optimiser *o = &t->optimiser;
    int base = t->field->config.field.base, unit = o->tiled ? 1 << (o->levels - 1) : base;
    return base / unit * part / parts * unit;
}

int rn_trainer_band(const struct rn_trainer *t, int band) {
    return first_row(t, band, t->optimiser.bands);
}

// ---- update ---------------------------------------------------------------------------------

#define APART_PARTS 16 // of a plane: one takes a few milliseconds

static int parts_of(const struct rn_trainer *t) {
    return t->optimiser.apart ? APART_PARTS : t->optimiser.bands;
}

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
    bool odd; // voxels: of one colour of a chessboard, then of the other
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

// As far towards the mean of its neighbours as a texel goes: they are six, not four.
static void smooth_slice(void *context, int z, int thread) {
    (void)thread;
    const struct smoothing *s = context;
    const struct rn_field_config *c = &s->trainer->field->config.field;
    float *voxels = s->trainer->field->cpu.maps[c->planes][0][0].texels;
    s->trainer->engine->kernels->smooth_voxels(voxels, rn_voxel_side(c), z, s->odd,
                                               s->share * (4.0f / 6));
}

static void smooth_all(struct rn_trainer *t, float share) {
    const struct rn_field_config *c = &t->field->config.field;
    struct smoothing smoothing = {t, share, false};
    rn_pool_run(t->engine->pool, c->planes, smooth_plane, &smoothing);
    for (int odd = 0; odd < 2 && c->voxels; odd++) {
        smoothing.odd = odd;
        rn_pool_run(t->engine->pool, rn_voxel_side(c), smooth_slice, &smoothing);
    }
}

static void update_part(void *context, int index, int thread) {
    (void)thread;
    struct rn_trainer *t = context;
    const struct rn_field_config *c = &t->field->config.field;
    int parts = parts_of(t), part = index % parts;
    size_t plane = (size_t)(index / parts), base = (size_t)c->base;
    size_t at = plane * base * base * (size_t)c->channels;
    bool sparse = t->field->config.sparse && t->optimiser.tiled;
    struct rn_plane_update update = {
        .options = &t->optimiser.update.planes,
        .maps = t->field->cpu.maps[plane],
        .to = t->optimiser.apart ? t->optimiser.apart_maps[plane] : NULL,
        .grad_maps = t->optimiser.grad_maps[plane],
        .m = t->optimiser.m + at,
        .v = t->optimiser.v + at,
        .touched = sparse ? t->optimiser.touched + plane * t->optimiser.tiles : NULL,
        .levels = t->optimiser.tiled && (int)plane < c->planes ? t->optimiser.levels : 1,
        .channels = c->channels,
        .mip = c->footprint == RN_FOOTPRINT_MIP};
    if (!t->engine->kernels->update(&update, first_row(t, part, parts),
                                    first_row(t, part + 1, parts)))
        t->optimiser.wild = true;
}

// Adds the groups' gradients in order into the first; false when anything is not finite.
static bool sum_groups(struct rn_trainer *t, double *ret_loss, double *ret_weight) {
    const struct rn_parameters *p = &t->field->parameters;
    size_t n = rn_parameters_behind(p);
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

static void begin(struct rn_trainer *t, double loss, double weight) {
    const struct rn_train_config *config = &t->field->config;
    struct rn_optimiser *o = &t->optimiser;
    double n = (double)++o->updates, rate = rn_schedule_rate(&t->field->config, &t->progress);
    o->update.networks = (struct rn_adamw){.scale = (float)(1 / weight),
                                           .rate = (float)rate,
                                           .decay = (float)config->weight_decay,
                                           .eps = (float)config->adam_eps,
                                           .correction1 = (float)-expm1(n * log(0.9)),
                                           .keep = (float)config->beta2,
                                           .fresh = (float)(1 - config->beta2),
                                           .correction2 = (float)-expm1(n * log(config->beta2))};
    o->update.planes = o->update.networks;
    o->update.planes.rate = (float)(rate * config->plane_rate);
    if (config->sparse) o->update.planes.decay = 0; // what is visited more often would decay more
    o->update.loss = loss / weight;
    o->update.next = 0;
    o->update.under_way = true;
}

// Room apart for as many levels as the field has: a picture in between may have built more.
static void make_room_apart(struct rn_trainer *t) {
    struct rn_optimiser *o = &t->optimiser;
    const struct rn_field_config *c = &t->field->config.field;
    int levels = t->field->pyramid_levels;
    if (!o->apart || o->update.next > 0) return;
    if (o->apart_levels < levels) {
        rn_block_destroy(o->apart_pyramid);
        o->apart_pyramid =
            rn_block_create(rn_pyramid_count(c, levels) * (size_t)c->planes * sizeof(float));
        o->apart_levels = levels;
    }
    if (o->apart_maps && (o->apart_pyramid || o->apart_levels == 1)) {
        rn_pyramid_lay_out(c, o->apart_levels, o->apart, o->apart_pyramid, o->apart_maps);
        return;
    }
    rn_block_destroy(o->apart); // no memory: in place, from now on
    o->apart = NULL;
}

static void take_apart(struct rn_trainer *t) {
    const struct rn_parameters *p = &t->field->parameters;
    struct rn_optimiser *o = &t->optimiser;
    memcpy(o->apart + p->plane_count, p->values + p->plane_count,
           rn_parameters_behind(p) * sizeof(float));
    rn_field_exchange(t->field, &o->apart, &o->apart_pyramid, &o->apart_levels);
    t->field->cpu.built_levels = o->levels;
}

// false: cut short.
static bool update_planes(struct rn_trainer *t) {
    struct rn_optimiser *o = &t->optimiser;
    struct rn_pool *pool = t->engine->pool;
    int planes = t->field->config.field.planes, grids = rn_grid_count(&t->field->config.field);
    make_room_apart(t);
    if (!o->apart) {
        if (!o->tiled) rn_pool_run(pool, planes, pull_down_plane, t);
        rn_pool_run(pool, grids * parts_of(t), update_part, t);
        return true;
    }
    if (!rn_pool_run_some(pool, grids * parts_of(t), &o->update.next, update_part, t,
                          rn_engine_is_wanted, t->engine))
        return false;
    take_apart(t);
    return true;
}

// What follows the planes, all of it within a few milliseconds.
static void update_rest(struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_parameters *p = &t->field->parameters;
    size_t at = p->plane_count;
    if (!t->engine->kernels->adamw(&t->optimiser.update.networks, rn_parameters_behind(p),
                                   p->values + at, t->optimiser.grad + at, t->optimiser.m + at,
                                   t->optimiser.v + at))
        t->optimiser.wild = true;
    rn_field_centre_appearances(t->field);
    float share = rn_schedule_smoothing(config, &t->progress);
    if (share > 0) smooth_all(t, share);
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
    memset(t->optimiser.touched, 0, (size_t)rn_grid_count(c) * t->optimiser.tiles);
}

enum rn_update_end rn_trainer_update(struct rn_trainer *t) {
    double loss, weight;
    if (!t->optimiser.update.under_way) {
        if (!sum_groups(t, &loss, &weight)) {
            reject(t);
            return RN_UPDATE_REJECTED;
        }
        if (!(weight > 0)) return RN_UPDATE_DONE;
        begin(t, loss, weight);
    }
    if (!update_planes(t)) return RN_UPDATE_CUT_SHORT;
    update_rest(t);
    t->optimiser.update.under_way = false;
    t->progress.loss = t->optimiser.update.loss;
    return RN_UPDATE_DONE;
}
