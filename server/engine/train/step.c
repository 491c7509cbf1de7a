// One training step: waves of forward and backward over the groups of its rays, then the update.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/voxels.h"
#include "server/engine/scene/appearance.h"
#include "server/engine/train/guard.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

#define MIN_RAYS 64

// ---- memory ---------------------------------------------------------------------------------

static size_t slab_numbers(const struct rn_field_config *c, int capacity) {
    size_t sample = (4 + (size_t)c->channels) * (size_t)c->planes;
    if (c->voxels) sample += 3 + RN_VOXEL_CHANNELS;
    return ((size_t)capacity + RN_PACKET_SLACK) * sample;
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
    if (!c->voxels) return at;
    for (int k = 0; k < 3; k++, at += n)
        slab->voxel[k] = at;
    slab->voxel_grad = at;
    return at + n * RN_VOXEL_CHANNELS;
}

size_t rn_group_numbers(const struct rn_cpu_field *field, int capacity) {
    return slab_numbers(field->config, capacity) + field->base_shape.count +
           field->head_shape.count + rn_appearance_numbers(field->config);
}

float *rn_group_lay_out(const struct rn_cpu_field *field, int capacity, float *at,
                        struct rn_group *group) {
    group->slab.capacity = capacity;
    group->base_grad = slab_lay_out(field->config, &group->slab, at);
    group->head_grad = group->base_grad + field->base_shape.count;
    group->appearance_grad = group->head_grad + field->head_shape.count;
    return group->appearance_grad + rn_appearance_numbers(field->config);
}

static enum rn_status allocate_groups(struct rn_trainer *t) {
    const struct rn_cpu_field *field = &t->field->cpu;
    int capacity = 2 * rn_engine_workspace(t->engine, 0)->capacity;
    size_t bytes = RN_GROUPS * rn_group_numbers(field, capacity) * sizeof(float);
    t->step.group_memory = rn_block_create(bytes);
    if (!t->step.group_memory) return RN_ERROR_NO_MEMORY;
    rn_block_touch(t->step.group_memory, bytes); // no picture waits for the first step's memory
    float *at = t->step.group_memory;
    for (int g = 0; g < RN_GROUPS; g++)
        at = rn_group_lay_out(field, capacity, at, &t->step.groups[g]);
    return RN_OK;
}

void rn_trainer_free_step(struct rn_trainer *t) {
    rn_optimiser_free(&t->optimiser);
    rn_sampler_free_rays(&t->sampler);
    free(t->step.rays);
    rn_block_destroy(t->step.group_memory);
    t->step.group_memory = NULL;
    t->step.rays = NULL;
}

enum rn_status rn_trainer_allocate(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = rn_optimiser_allocate(t->field, &t->optimiser, err);
    if (status == RN_OK) status = rn_sampler_allocate_rays(&t->sampler, err);
    if (status != RN_OK) return status;
    t->step.rays = malloc(RN_MAX_RAYS * sizeof *t->step.rays);
    if (!t->step.rays || allocate_groups(t) != RN_OK)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    return RN_OK;
}

// ---- waves ----------------------------------------------------------------------------------

int rn_step_first_ray(const struct rn_trainer *t, int group) {
    int pixel = rn_pixel_rays(&t->step.march), pixels = t->step.ray_count / pixel;
    return (int)((int64_t)pixels * group / RN_GROUPS) * pixel;
}

static void forward_backward(void *context, int index, int thread) {
    struct rn_trainer *t = context;
    int own = rn_ranks_share(t, RN_GROUPS).first + index, first = rn_step_first_ray(t, own);
    struct rn_group *group = &t->step.groups[own];
    struct rn_workspace *w = rn_engine_workspace(t->engine, thread);
    if (!rn_group_is_open(group, w)) return;
    if (group->cursor == first) rn_trainer_draw(t, first, group->end);
    do
        t->engine->kernels->train(&t->field->cpu, &t->step.march, t->step.rays, w, group);
    while (rn_group_is_open(group, w) && !rn_pool_is_stopped(t->engine->pool, thread));
}

// Packets of the own groups, until no slab has room or the thread is preempted (false).
static bool fill_slabs(struct rn_trainer *t) {
    struct rn_share own = rn_ranks_share(t, RN_GROUPS);
    const struct rn_workspace *w = rn_engine_workspace(t->engine, 0);
    int next = 0;
    while (next < own.count && !rn_group_is_open(&t->step.groups[own.first + next], w))
        next++;
    if (!rn_pool_run_some(t->engine->pool, own.count, &next, forward_backward, t,
                          rn_engine_is_wanted, t->engine))
        return false;
    bool open = false; // one may have been left half done
    for (int g = own.first; g < own.first + own.count; g++)
        open |= rn_group_is_open(&t->step.groups[g], w);
    return !open;
}

static void scatter_band(void *context, int index, int thread) {
    (void)thread;
    struct rn_trainer *t = context;
    int plane = index / t->optimiser.bands, band = index % t->optimiser.bands;
    for (int g = 0; g < RN_GROUPS; g++)
        if (t->step.groups[g].slab.count > 0)
            t->engine->kernels->scatter(&t->field->cpu, &t->step.groups[g].slab, plane,
                                        t->optimiser.levels, rn_trainer_band(t, band),
                                        rn_trainer_band(t, band + 1), t->optimiser.grad_maps[plane],
                                        t->optimiser.touched + (size_t)plane * t->optimiser.tiles);
}

void rn_trainer_take_march(struct rn_trainer *t) {
    bool split = t->step.march.split;
    t->step.march = rn_schedule_march(t->field, &t->progress);
    if (t->step.march.split == split) return;
    struct rn_evidence evidence = rn_trainer_evidence(t, &t->step.march);
    rn_effects_turn(&evidence);
}

void rn_trainer_begin_step(struct rn_trainer *t) {
    const struct rn_parameters *p = &t->field->parameters;
    t->step.under_way = true;
    t->step.stage = RN_STEP_WAVES;
    t->step.ray_count = t->next_rays;
    t->step.first_ray = t->progress.rays;
    rn_trainer_take_march(t);
    t->step.march.appearances = rn_field_appearances(t->field);
    t->step.march.photographs = t->sampler.ray_photograph;
    int pixel = rn_pixel_rays(&t->step.march), pixels = t->step.ray_count / pixel;
    if (pixels == 0) pixels = 1;
    t->step.ray_count = pixels * pixel;
    // About 6 tenths of what has room: it is a mean of many rays, and a fifth more are
    // evaluated than enter the loss.
    int packet = (int)(0.6 * rn_engine_workspace(t->engine, 0)->full * t->step.ray_count /
                       t->field->config.target_samples);
    for (int g = 0; g < RN_GROUPS; g++) {
        struct rn_group *group = &t->step.groups[g];
        struct rn_slab slab = group->slab;
        slab.count = 0;
        *group = (struct rn_group){.slab = slab,
                                   .packet = packet > 0 ? packet : 1,
                                   .base_grad = group->base_grad,
                                   .head_grad = group->head_grad,
                                   .appearance_grad = group->appearance_grad,
                                   .ray_loss = t->sampler.ray_loss,
                                   .seen = t->hull.seen};
        group->cursor = rn_step_first_ray(t, g);
        group->end = rn_step_first_ray(t, g + 1);
        memset(group->base_grad, 0, rn_parameters_behind(p) * sizeof(float));
    }
}

// The step before the one that comes next, not computed again.
void rn_trainer_redraw(struct rn_trainer *t) {
    t->progress.step--;
    rn_trainer_begin_step(t);
    t->progress.step++;
    t->step.under_way = false;
    rn_trainer_draw(t, 0, t->step.ray_count);
}

static void count_step(struct rn_trainer *t) {
    uint64_t samples = 0;
    for (int g = 0; g < RN_GROUPS; g++) {
        samples += t->step.groups[g].samples;
        for (int l = 0; l < RN_MAX_LEVELS; l++)
            t->progress.level_samples[l] += t->step.groups[g].level_samples[l];
    }
    t->progress.samples += samples;
    t->progress.rays += (uint64_t)t->step.ray_count;
    t->window.samples += samples;
    t->window.rays += (uint64_t)t->step.ray_count;
    if (samples == 0) return;
    double next = (double)t->step.ray_count * t->field->config.target_samples / (double)samples + 1;
    t->next_rays = next < MIN_RAYS ? MIN_RAYS : next > RN_MAX_RAYS ? RN_MAX_RAYS : (int)next;
}

// The update and the guard, either of which may be cut short. Pictures show the new parameters, as
// those of the step after, once all of them are there.
static void finish_step(struct rn_trainer *t) {
    if (t->step.stage == RN_STEP_UPDATE) {
        enum rn_update_end end = rn_trainer_update(t);
        if (end == RN_UPDATE_CUT_SHORT) return;
        rn_trainer_note_losses(t);
        count_step(t);
        t->step.accepted = end == RN_UPDATE_DONE;
        t->field->steps = t->progress.step + 1;
        t->step.stage = RN_STEP_GUARD;
    }
    if (!rn_trainer_guard_step(t, t->step.accepted)) return;
    t->step.under_way = false;
    t->progress.step++;
}

// Parameters change at the end of a step alone, so that a wave that is cut short can be rendered.
void rn_trainer_run_wave(struct rn_trainer *t) {
    struct rn_engine *engine = t->engine;
    if (t->step.stage != RN_STEP_WAVES) {
        finish_step(t);
        return;
    }
    if (!fill_slabs(t)) return;
    rn_ranks_tell_wave(t);
    if (!rn_pool_run_some(engine->pool, rn_grid_count(&t->field->config.field) * t->optimiser.bands,
                          &t->step.next_band, scatter_band, t, rn_engine_is_wanted, engine))
        return;
    t->step.next_band = 0;
    t->ranks.shared = false;
    bool complete = true;
    for (int g = 0; g < RN_GROUPS; g++) {
        t->step.groups[g].slab.count = 0;
        complete &= t->step.groups[g].cursor == t->step.groups[g].end;
    }
    if (!complete) return;
    rn_ranks_tell_step(t);
    t->step.stage = RN_STEP_UPDATE;
    finish_step(t);
}
