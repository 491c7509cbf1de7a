// One training step: rays, waves of forward and backward, the update.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/field/volume.h"
#include "server/engine/train/trainer.h"

#define STREAM_RAYS 0x7261797300000000u // random numbers of the ray batch, one stream a step
#define STEP_POWER 0.8                  // of a texel's size: how steps shrink as planes grow

// ---- memory ---------------------------------------------------------------------------------

static size_t slab_numbers(const struct rn_field_config *c, int capacity) {
    return ((size_t)capacity + RN_PACKET_SLACK) * (4 + (size_t)c->channels) * (size_t)c->planes;
}

static float *slab_lay_out(const struct rn_field_config *c, struct rn_slab *slab, float *at) {
    size_t n = (size_t)slab->capacity + RN_PACKET_SLACK;
    for (int p = 0; p < c->planes; p++) {
        slab->u[p] = at;
        slab->v[p] = at + n;
        slab->lx[p] = at + 2 * n;
        slab->ly[p] = at + 3 * n;
        slab->grad[p] = at + 4 * n;
        at += n * (4 + (size_t)c->channels);
    }
    return at;
}

size_t rn_group_numbers(const struct rn_cpu_field *field, int capacity) {
    return slab_numbers(field->config, capacity) + field->base_shape.count +
           field->head_shape.count;
}

float *rn_group_lay_out(const struct rn_cpu_field *field, int capacity, float *at,
                        struct rn_group *group) {
    group->slab.capacity = capacity;
    group->base_grad = slab_lay_out(field->config, &group->slab, at);
    group->head_grad = group->base_grad + field->base_shape.count;
    return group->head_grad + field->head_shape.count;
}

static enum rn_status allocate_groups(struct rn_trainer *t) {
    const struct rn_cpu_field *field = &t->field->cpu;
    int capacity = 2 * rn_engine_workspace(t->engine, 0)->capacity;
    t->group_memory =
        rn_block_create(RN_GROUPS * rn_group_numbers(field, capacity) * sizeof(float));
    if (!t->group_memory) return RN_ERROR_NO_MEMORY;
    float *at = t->group_memory;
    for (int g = 0; g < RN_GROUPS; g++)
        at = rn_group_lay_out(field, capacity, at, &t->groups[g]);
    return RN_OK;
}

// The first row of a band: bands are whole numbers of tiles.
int rn_trainer_band(const struct rn_trainer *t, int band) {
    int base = t->field->config.field.base, unit = t->tiled ? 1 << (t->levels - 1) : base;
    return base / unit * band / t->bands * unit;
}

void rn_trainer_free_step(struct rn_trainer *t) {
    rn_block_destroy(t->grad_pyramid);
    free(t->touched);
    free(t->rays);
    free(t->ray_loss);
    free(t->ray_block);
    rn_block_destroy(t->group_memory);
    rn_block_destroy(t->good);
    t->grad_pyramid = t->group_memory = t->good = NULL;
    t->touched = NULL;
    t->rays = NULL;
    t->ray_loss = NULL;
    t->ray_block = NULL;
}

size_t rn_trainer_moments(const struct rn_field *field) {
    return field->parameters.count + 64;
}

enum rn_status rn_trainer_allocate(struct rn_trainer *t, struct rn_error *err) {
    const struct rn_field_config *c = &t->field->config.field;
    size_t count = rn_trainer_moments(t->field);
    t->levels = t->field->cpu.built_levels;
    size_t pyramid = rn_pyramid_count(c, t->levels) * (size_t)c->planes;
    t->tiled = c->base % (1 << (t->levels - 1)) == 0;
    t->bands = t->tiled ? 4 : 1;
    struct rn_tiling tiling = rn_tiling(c->base, c->channels, t->levels);
    t->tiles = (size_t)tiling.columns * (size_t)tiling.rows;
    if (!t->grad) t->grad = rn_block_create(3 * count * sizeof(float));
    t->grad_pyramid = rn_block_create((pyramid + 64) * sizeof(float));
    t->touched = calloc((size_t)c->planes * t->tiles, 1);
    t->rays = malloc(RN_MAX_RAYS * sizeof *t->rays);
    t->ray_loss = malloc(RN_MAX_RAYS * sizeof *t->ray_loss);
    t->ray_block = malloc(RN_MAX_RAYS * sizeof *t->ray_block);
    if (!t->grad || !t->grad_pyramid || !t->touched || !t->rays || !t->ray_loss || !t->ray_block ||
        allocate_groups(t) != RN_OK)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    t->m = t->grad + count;
    t->v = t->m + count;
    rn_pyramid_lay_out(c, t->levels, t->grad, t->grad_pyramid, t->grad_maps);
    return RN_OK;
}

// ---- rays -----------------------------------------------------------------------------------

void rn_trainer_rays(const struct rn_trainer *t, const struct rn_pixels *pixels,
                     const struct rn_trainer_place *places, int count, double step,
                     struct rn_march_ray *ret_rays) {
    struct rn_ray_place lanes[RN_TRAINER_RAYS] = {{0}};
    for (int i = 0; i < count; i++) {
        const struct rn_trainer_place *p = &places[i];
        if (!p->frame) continue;
        lanes[i] = (struct rn_ray_place){&p->frame->view, p->x, p->y, p->jitter};
        if (!p->part) continue;
        lanes[i].view = &p->frame->fine;
        lanes[i].x = 2 * p->x + (p->part - 1) % 2;
        lanes[i].y = 2 * p->y + (p->part - 1) / 2;
    }
    t->engine->kernels->rays(lanes, count, step, t->field->config.cone_step, ret_rays);
    const float *background =
        t->march.background_variance > 0 ? t->march.background : t->field->config.background;
    for (int i = 0; i < count; i++) {
        const struct rn_trainer_place *p = &places[i];
        if (!p->frame) {
            ret_rays[i].weight = 0;
            continue;
        }
        ret_rays[i].alpha = rn_pixel_over(rn_pixel_at(pixels, p->frame, p->x, p->y), background,
                                          ret_rays[i].target);
    }
}

struct rn_march_ray rn_trainer_ray(const struct rn_trainer *t, const struct rn_pixels *pixels,
                                   const struct rn_pixel_frame *frame, int x, int y, double step,
                                   double jitter) {
    struct rn_trainer_place place = {.frame = frame, .x = x, .y = y, .jitter = (float)jitter};
    struct rn_march_ray ray;
    rn_trainer_rays(t, pixels, &place, 1, step, &ray);
    return ray;
}

// The frame of a scale that holds the scale's i-th pixel.
static const struct rn_pixel_frame *frame_of(const struct rn_pixels *p, int scale, size_t i) {
    int low = p->scale_first[scale];
    int high = scale + 1 < p->scale_count ? p->scale_first[scale + 1] : p->frame_count;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (p->frames[middle].before <= i)
            low = middle;
        else
            high = middle;
    }
    return &p->frames[low];
}

// Uniform in [0, n) from 64 random bits, n < 2^53.
static size_t below(uint64_t wide, size_t n) {
    return (size_t)((double)(wide >> 11) * 0x1p-53 * (double)n);
}

// A pixel drawn uniformly over all scales: to the letter of the paper, dead ones too.
static const struct rn_pixel_frame *draw_pixel(const struct rn_trainer *t, struct rn_rng4 draw,
                                               int *ret_x, int *ret_y) {
    int scale = 0;
    size_t pixel = below((uint64_t)draw.v[0] << 32 | draw.v[1], t->train.pixel_count);
    while (pixel >= t->train.scale_pixels[scale])
        pixel -= t->train.scale_pixels[scale++];
    const struct rn_pixel_frame *frame = frame_of(&t->train, scale, pixel);
    size_t within = pixel - frame->before, width = (size_t)frame->camera.width;
    *ret_x = (int)(within % width);
    *ret_y = (int)(within / width);
    return frame;
}

// A pixel of the scale that ray r's turn falls to, of the blocks that may see the hull: which
// block, and where in it. The rays of a split pixel have one turn.
static void draw_live_pixel(const struct rn_trainer *t, int r, struct rn_trainer_place *ret) {
    uint64_t turn = (t->first_ray + (uint64_t)r) / (uint64_t)rn_pixel_rays(&t->march);
    struct rn_scale_turn from = rn_scale_turn(turn, t->train.scale_count);
    size_t first = t->live_first[from.scale], count = t->live_first[from.scale + 1] - first;
    uint64_t seed = t->field->config.seed;
    if (count == 0) return;
    struct rn_live_pixel pixel =
        t->importance.count > 0
            ? rn_importance_pixel(&t->importance, first, count, seed, from.turn, &ret->weight)
            : rn_live_pixel(seed, from.turn, count);
    ret->x = pixel.x;
    ret->y = pixel.y;
    ret->block = (int32_t)(first + pixel.block);
}

// From a place in a block to that in the block's image. No frame where the block reaches over the
// image's edge.
static void settle(const struct rn_trainer *t, struct rn_trainer_place *place) {
    if (place->block < 0) return;
    const struct rn_live_block *block = &t->live[place->block];
    const struct rn_pixel_frame *frame = &t->train.frames[block->frame];
    place->x += block->x;
    place->y += block->y;
    if (place->x < frame->camera.width && place->y < frame->camera.height) place->frame = frame;
    if (!place->frame || place->part > 1) place->block = -1; // a pixel's error is noted once
}

static struct rn_rng4 draw_of(const struct rn_trainer *t, int r) {
    return rn_rng_draw(t->march.seed, STREAM_RAYS | (uint32_t)r, t->march.counter);
}

// Where ray r of a step starts, but for settle().
static struct rn_trainer_place draw_place(const struct rn_trainer *t, int r) {
    int part = r % rn_pixel_rays(&t->march);
    struct rn_rng4 draw = draw_of(t, r), of_pixel = part ? draw_of(t, r - part) : draw;
    struct rn_trainer_place place = {.jitter = rn_rng_unit(draw.v[2]),
                                     .part = t->march.split ? part + 1 : 0,
                                     .weight = 1,
                                     .block = -1};
    if (t->field->config.favour_finest) {
        draw_live_pixel(t, r - part, &place);
    } else {
        place.frame = draw_pixel(t, of_pixel, &place.x, &place.y);
        place.weight = (float)place.frame->frame->loss_weight;
    }
    return place;
}

const struct rn_pixel_frame *rn_trainer_place(const struct rn_trainer *t, int r, int *ret_x,
                                              int *ret_y) {
    struct rn_trainer_place place = draw_place(t, r);
    settle(t, &place);
    *ret_x = place.x;
    *ret_y = place.y;
    return place.frame;
}

// Rays [begin, end) of a step. All places first: blocks and pixels lie anywhere in memory.
static void draw_rays(struct rn_trainer *t, int begin, int end) {
    struct rn_trainer_place places[32];
    for (; begin < end; begin += 32) {
        int n = end - begin < 32 ? end - begin : 32;
        struct rn_march_ray *rays = t->rays + begin;
        for (int i = 0; i < n; i++) {
            places[i] = draw_place(t, begin + i);
            if (places[i].block >= 0) __builtin_prefetch(&t->live[places[i].block]);
        }
        for (int i = 0; i < n; i++) {
            settle(t, &places[i]);
            if (places[i].frame)
                __builtin_prefetch(
                    rn_pixel_at(&t->train, places[i].frame, places[i].x, places[i].y));
        }
        rn_trainer_rays(t, &t->train, places, n, (double)t->march.step, rays);
        for (int i = 0; i < n; i++) {
            if (rays[i].weight > 0) rays[i].weight = places[i].weight;
            rays[i].id = (uint32_t)(begin + i);
            t->ray_block[begin + i] = places[i].block;
            t->ray_loss[begin + i] = 0;
        }
    }
}

// ---- waves ----------------------------------------------------------------------------------

// The first of `pixels` pixels that is of group g.
static int first_of_group(int pixels, int g) {
    return (int)((int64_t)pixels * g / RN_GROUPS);
}

static void forward_backward(void *context, int index, int thread) {
    struct rn_trainer *t = context;
    struct rn_group *group = &t->groups[index];
    if (group->cursor == group->end) return;
    int pixel = rn_pixel_rays(&t->march);
    int first = first_of_group(t->ray_count / pixel, index) * pixel;
    if (group->cursor == first && group->slab.count == 0) draw_rays(t, first, group->end);
    t->engine->kernels->train(&t->field->cpu, &t->march, t->rays,
                              rn_engine_workspace(t->engine, thread), group);
}

static void scatter_band(void *context, int index, int thread) {
    (void)thread;
    struct rn_trainer *t = context;
    int plane = index / t->bands, band = index % t->bands;
    for (int g = 0; g < RN_GROUPS; g++)
        if (t->groups[g].slab.count > 0)
            t->engine->kernels->scatter(&t->field->cpu, &t->groups[g].slab, plane, t->levels,
                                        rn_trainer_band(t, band), rn_trainer_band(t, band + 1),
                                        t->grad_maps[plane], t->touched + (size_t)plane * t->tiles);
}

struct rn_march_options rn_trainer_march(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    double texels =
        config->grow_to > config->field.base ? (double)config->grow_to / config->field.base : 1;
    struct rn_march_options march = {.step = (float)(config->step * pow(texels, STEP_POWER)),
                                     .stop_depth = (float)-log(config->stop),
                                     .roulette = (float)config->roulette,
                                     .seed = config->seed,
                                     .counter = (uint64_t)t->progress.step};
    rn_effects_march(config, rn_trainer_fraction(t), &march);
    return march;
}

void rn_trainer_take_march(struct rn_trainer *t) {
    bool split = t->march.split;
    t->march = rn_trainer_march(t);
    if (t->march.split == split) return;
    struct rn_evidence evidence = rn_trainer_evidence(t, &t->march);
    rn_effects_turn(&evidence);
}

void rn_trainer_begin_step(struct rn_trainer *t) {
    const struct rn_parameters *p = &t->field->parameters;
    t->stepping = true;
    t->ray_count = t->next_rays;
    t->first_ray = t->progress.rays;
    rn_trainer_take_march(t);
    int pixel = rn_pixel_rays(&t->march), pixels = t->ray_count / pixel;
    if (pixels == 0) pixels = 1;
    t->ray_count = pixels * pixel;
    // About 6 tenths of what has room: it is a mean of many rays, and a fifth more are
    // evaluated than enter the loss.
    int packet = (int)(0.6 * rn_engine_workspace(t->engine, 0)->full * t->ray_count /
                       t->field->config.target_samples);
    for (int g = 0; g < RN_GROUPS; g++) {
        struct rn_group *group = &t->groups[g];
        struct rn_slab slab = group->slab;
        slab.count = 0;
        *group = (struct rn_group){.slab = slab,
                                   .packet = packet > 0 ? packet : 1,
                                   .base_grad = group->base_grad,
                                   .head_grad = group->head_grad,
                                   .ray_loss = t->ray_loss};
        group->cursor = first_of_group(pixels, g) * pixel;
        group->end = first_of_group(pixels, g + 1) * pixel;
        memset(group->base_grad, 0, (p->base_count + p->head_count) * sizeof(float));
    }
}

// The step before the one that comes next, not computed again.
void rn_trainer_redraw(struct rn_trainer *t) {
    t->progress.step--;
    rn_trainer_begin_step(t);
    t->progress.step++;
    t->stepping = false;
    draw_rays(t, 0, t->ray_count);
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
    t->engine->kernels->pull_down(t->grad_maps[plane], t->levels, c->footprint == RN_FOOTPRINT_MIP,
                                  c->channels);
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
    if (t->tiled && t->levels > 1)
        t->engine->kernels->build(maps, t->levels, c->footprint == RN_FOOTPRINT_MIP, c->channels);
}

static void update_band(void *context, int index, int thread) {
    (void)thread;
    const struct update *u = context;
    struct rn_trainer *t = u->trainer;
    const struct rn_field_config *c = &t->field->config.field;
    size_t plane = (size_t)(index / t->bands), base = (size_t)c->base;
    size_t at = plane * base * base * (size_t)c->channels;
    int band = index % t->bands;
    bool sparse = t->field->config.sparse && t->tiled;
    struct rn_plane_update update = {.options = &u->planes,
                                     .maps = t->field->cpu.maps[plane],
                                     .grad_maps = t->grad_maps[plane],
                                     .m = t->m + at,
                                     .v = t->v + at,
                                     .touched = sparse ? t->touched + plane * t->tiles : NULL,
                                     .levels = t->tiled ? t->levels : 1,
                                     .channels = c->channels,
                                     .mip = c->footprint == RN_FOOTPRINT_MIP};
    if (!t->engine->kernels->update(&update, rn_trainer_band(t, band),
                                    rn_trainer_band(t, band + 1)))
        t->wild = true;
}

// Adds the groups' gradients in order into the first; false when anything is not finite.
static bool sum_groups(struct rn_trainer *t, double *ret_loss, double *ret_weight) {
    const struct rn_parameters *p = &t->field->parameters;
    size_t n = p->base_count + p->head_count;
    float *sum = t->grad + p->plane_count;
    double loss = 0, weight = 0, check = 0;
    for (int g = 0; g < RN_GROUPS; g++) {
        const struct rn_group *group = &t->groups[g];
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

double rn_trainer_fraction(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    double fraction = NAN;
    if (config->max_steps > 0) fraction = (double)t->progress.step / (double)config->max_steps;
    if (config->max_seconds > 0)
        fraction =
            fmax(isnan(fraction) ? 0 : fraction, t->progress.train_seconds / config->max_seconds);
    return fraction;
}

// The paper: x 0.6 at 1/2, 3/4, 5/6, 9/10 of the run. Ours: constant, then an exponential decay to
// 1/20, made for the time given; without a limit the rate stays.
static double rate_factor(const struct rn_trainer *t) {
    double f = rn_trainer_fraction(t);
    if (isnan(f)) return 1;
    if (t->field->config.multi_step_rate)
        return pow(0.6, (f >= 0.5) + (f >= 0.75) + (f >= 5.0 / 6) + (f >= 0.9));
    double decay = f < 0.2 ? 0 : fmin(1, (f - 0.2) / 0.8);
    return exp(-3.0 * decay);
}

double rn_trainer_rate(const struct rn_trainer *t) {
    return ldexp(t->field->config.learning_rate * rate_factor(t), -(int)t->progress.rollbacks);
}

float rn_trainer_smoothing(const struct rn_trainer *t) {
    double factor = rn_trainer_rate(t) / t->field->config.learning_rate;
    if ((t->progress.step + 1) % RN_SMOOTH_EVERY != 0) return 0;
    return (float)(t->field->config.smoothing * factor * factor);
}

static void apply(struct rn_trainer *t, double weight) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_parameters *p = &t->field->parameters;
    double n = (double)++t->updates, rate = rn_trainer_rate(t);
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
    if (!t->tiled) rn_pool_run(t->engine->pool, config->field.planes, pull_down_plane, t);
    rn_pool_run(t->engine->pool, config->field.planes * t->bands, update_band, &u);
    size_t at = p->plane_count;
    if (!t->engine->kernels->adamw(&networks, p->base_count + p->head_count, p->values + at,
                                   t->grad + at, t->m + at, t->v + at))
        t->wild = true;
    struct smoothing smoothing = {t, rn_trainer_smoothing(t)};
    if (smoothing.share > 0)
        rn_pool_run(t->engine->pool, config->field.planes, smooth_plane, &smoothing);
    t->field->fresh_levels = t->levels;
    if (t->tiled)
        rn_field_pack(t->field, t->engine);
    else
        rn_field_refresh(t->field, t->engine);
}

static void reject(struct rn_trainer *t) {
    const struct rn_field_config *c = &t->field->config.field;
    t->progress.steps_rejected++;
    memset(t->grad, 0, t->field->parameters.count * sizeof(float));
    memset(t->grad_pyramid, 0, rn_pyramid_count(c, t->levels) * (size_t)c->planes * sizeof(float));
    memset(t->touched, 0, (size_t)c->planes * t->tiles);
}

static void count_step(struct rn_trainer *t) {
    uint64_t samples = 0;
    for (int g = 0; g < RN_GROUPS; g++) {
        samples += t->groups[g].samples;
        for (int l = 0; l < RN_MAX_LEVELS; l++)
            t->progress.level_samples[l] += t->groups[g].level_samples[l];
    }
    t->progress.samples += samples;
    t->progress.rays += (uint64_t)t->ray_count;
    t->window_samples += samples;
    t->window_rays += (uint64_t)t->ray_count;
    if (samples == 0) return;
    double next = (double)t->ray_count * t->field->config.target_samples / (double)samples + 1;
    t->next_rays = next < RN_MIN_RAYS ? RN_MIN_RAYS : next > RN_MAX_RAYS ? RN_MAX_RAYS : (int)next;
}

static void note_losses(struct rn_trainer *t) {
    for (int r = 0; r < t->ray_count && t->importance.count > 0; r++)
        if (t->ray_block[r] >= 0)
            rn_importance_note(&t->importance, (size_t)t->ray_block[r], (double)t->ray_loss[r]);
}

static void finish_step(struct rn_trainer *t) {
    double loss, weight;
    bool finite = sum_groups(t, &loss, &weight);
    if (!finite)
        reject(t);
    else if (weight > 0)
        apply(t, weight);
    if (finite && weight > 0) t->progress.loss = loss / weight;
    note_losses(t);
    count_step(t);
    rn_trainer_guard_step(t, finite);
    t->stepping = false;
    t->field->steps = ++t->progress.step;
}

// Parameters change at the end of a step alone, so that a wave that is cut short can be rendered.
void rn_trainer_run_wave(struct rn_trainer *t) {
    struct rn_engine *engine = t->engine;
    if (!rn_pool_run_some(engine->pool, RN_GROUPS, &t->next_group, forward_backward, t,
                          rn_engine_is_wanted, engine) ||
        !rn_pool_run_some(engine->pool, t->field->config.field.planes * t->bands, &t->next_band,
                          scatter_band, t, rn_engine_is_wanted, engine))
        return;
    t->next_group = t->next_band = 0;
    bool complete = true;
    for (int g = 0; g < RN_GROUPS; g++) {
        t->groups[g].slab.count = 0;
        complete &= t->groups[g].cursor == t->groups[g].end;
    }
    if (complete) finish_step(t);
}
