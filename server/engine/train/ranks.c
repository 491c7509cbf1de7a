#include "server/engine/train/ranks.h"

#include <stdlib.h>
#include <string.h>

#include "server/engine/field/voxels.h"
#include "server/engine/train/trainer.h"

static bool is_alone(const struct rn_trainer *t) {
    return t->ranks.exchange == NULL;
}

static struct rn_share share_of(const struct rn_exchange *x, int rank, int count) {
    int first = (int)((int64_t)count * rank / x->ranks);
    return (struct rn_share){first, (int)((int64_t)count * (rank + 1) / x->ranks) - first};
}

struct rn_share rn_ranks_share(const struct rn_trainer *t, int count) {
    if (is_alone(t)) return (struct rn_share){0, count};
    return share_of(t->ranks.exchange, t->ranks.exchange->rank, count);
}

// Room for `bytes` that are told; a training that cannot go on ends on all ranks.
static uint8_t *room_for(struct rn_trainer *t, size_t bytes) {
    struct rn_ranks *ranks = &t->ranks;
    if (ranks->bytes < bytes) {
        rn_block_destroy(ranks->memory);
        ranks->memory = rn_block_create(bytes + bytes / 2);
        ranks->bytes = bytes + bytes / 2;
        if (!ranks->memory) ranks->exchange->abandon();
    }
    return (uint8_t *)ranks->memory;
}

void rn_ranks_free(struct rn_trainer *t) {
    rn_block_destroy(t->ranks.memory);
    t->ranks.memory = NULL;
    t->ranks.bytes = 0;
}

// ---- orders ---------------------------------------------------------------------------------

// What of rank 0's training does not follow from its parameters: clock and held-out figures, and
// the limits that they may have moved.
struct order {
    enum rn_rank_order order;
    double train_seconds, psnr, gained_psnr, gained_seconds, max_seconds;
    int64_t psnr_step, max_steps;
    bool plateau;
};

static void give(struct rn_trainer *t, enum rn_rank_order kind) {
    const struct rn_progress *p = &t->progress;
    struct order order;
    memset(&order, 0, sizeof order); // its padding is sent too
    order.order = kind;
    order.train_seconds = p->train_seconds;
    order.psnr = p->psnr;
    order.psnr_step = p->psnr_step;
    order.gained_psnr = p->gained_psnr;
    order.gained_seconds = p->gained_seconds;
    order.plateau = p->plateau;
    order.max_steps = t->field->config.max_steps;
    order.max_seconds = t->field->config.max_seconds;
    t->ranks.exchange->broadcast(&order, sizeof order);
}

void rn_ranks_begin_step(struct rn_trainer *t) {
    if (is_alone(t) || t->ranks.agreed || t->ranks.exchange->rank > 0) return;
    t->ranks.agreed = true;
    give(t, RN_RANK_STEPS);
}

// The clock moves between steps alone, so that it is the same on all ranks within one.
void rn_ranks_end_step(struct rn_trainer *t, bool complete, double seconds) {
    if (complete) t->ranks.agreed = false;
    if (is_alone(t))
        t->progress.train_seconds += seconds;
    else
        t->ranks.seconds += seconds;
    if (is_alone(t) || t->ranks.agreed) return;
    t->progress.train_seconds += t->ranks.seconds;
    t->ranks.seconds = 0;
}

void rn_ranks_begin_save(struct rn_trainer *t) {
    if (is_alone(t)) return;
    if (t->ranks.exchange->rank == 0) give(t, RN_RANK_SAVES);
    rn_ranks_tell_seen(t);
}

void rn_ranks_end(struct rn_trainer *t) {
    if (is_alone(t) || !t->ranks.follows || t->ranks.exchange->rank > 0) return;
    give(t, RN_RANK_ENDS);
    t->ranks.follows = false;
}

void rn_trainer_dismiss(const struct rn_exchange *exchange) {
    struct order order;
    memset(&order, 0, sizeof order);
    order.order = RN_RANK_ENDS;
    exchange->broadcast(&order, sizeof order);
}

enum rn_rank_order rn_ranks_hear(struct rn_trainer *t) {
    struct rn_progress *p = &t->progress;
    struct order order;
    t->ranks.exchange->broadcast(&order, sizeof order);
    p->train_seconds = order.train_seconds;
    p->psnr = order.psnr;
    p->psnr_step = order.psnr_step;
    p->gained_psnr = order.gained_psnr;
    p->gained_seconds = order.gained_seconds;
    p->plateau = order.plateau;
    t->field->config.max_steps = order.max_steps;
    t->field->config.max_seconds = order.max_seconds;
    t->ranks.agreed = order.order == RN_RANK_STEPS;
    return order.order;
}

// ---- waves ----------------------------------------------------------------------------------

// How far a group has come.
struct reach {
    int32_t cursor, samples;
};

// Numbers of a sample: levels go along where there are any.
static size_t numbers_of(const struct rn_trainer *t) {
    const struct rn_field_config *c = &t->field->config.field;
    size_t plane = (t->optimiser.levels > 1 ? 4 : 2) + (size_t)c->channels;
    return (size_t)c->planes * plane + (c->voxels ? 3 + RN_VOXEL_CHANNELS : 0);
}

// Copies `count` numbers to what is told or from it; the next number of it.
static float *copy_numbers(float *array, float *told, size_t count, bool to_slab) {
    if (to_slab)
        memcpy(array, told, count * sizeof *told);
    else
        memcpy(told, array, count * sizeof *told);
    return told + count;
}

// Copies between a slab and what is told of it; the next number.
static float *copy_slab(const struct rn_trainer *t, const struct rn_slab *slab, float *told,
                        bool to_slab) {
    size_t n = (size_t)slab->count, channels = (size_t)t->field->config.field.channels;
    for (int p = 0; p < t->field->config.field.planes; p++) {
        bool leveled = t->optimiser.levels > 1;
        float *const arrays[] = {slab->u[p], slab->v[p], slab->grad[p], slab->lx[p], slab->ly[p]};
        const size_t counts[] = {n, n, n * channels, leveled ? n : 0, leveled ? n : 0};
        for (int i = 0; i < 5; i++)
            told = copy_numbers(arrays[i], told, counts[i], to_slab);
    }
    if (!t->field->config.field.voxels) return told;
    for (int k = 0; k < 3; k++)
        told = copy_numbers(slab->voxel[k], told, n, to_slab);
    return copy_numbers(slab->voxel_grad, told, n * RN_VOXEL_CHANNELS, to_slab);
}

static bool is_own(const struct rn_trainer *t, int group) {
    struct rn_share own = rn_ranks_share(t, RN_GROUPS);
    return group >= own.first && group < own.first + own.count;
}

static void tell_reach(struct rn_trainer *t) {
    const struct rn_exchange *x = t->ranks.exchange;
    struct reach reach[RN_GROUPS];
    size_t sizes[RN_MAX_RANKS];
    for (int g = 0; g < RN_GROUPS; g++)
        reach[g] = (struct reach){t->step.groups[g].cursor, t->step.groups[g].slab.count};
    for (int r = 0; r < x->ranks; r++)
        sizes[r] = (size_t)share_of(x, r, RN_GROUPS).count * sizeof *reach;
    x->gather(reach, sizes);
    for (int g = 0; g < RN_GROUPS; g++) {
        t->step.groups[g].cursor = reach[g].cursor;
        t->step.groups[g].slab.count = reach[g].samples;
    }
}

static void tell_slabs(struct rn_trainer *t) {
    const struct rn_exchange *x = t->ranks.exchange;
    size_t sizes[RN_MAX_RANKS] = {0}, all = 0;
    size_t sample = numbers_of(t) * sizeof(float);
    for (int r = 0; r < x->ranks; r++) {
        struct rn_share share = share_of(x, r, RN_GROUPS);
        for (int g = share.first; g < share.first + share.count; g++)
            sizes[r] += (size_t)t->step.groups[g].slab.count * sample;
        all += sizes[r];
    }
    float *told = (float *)room_for(t, all), *at = told;
    for (int g = 0; g < RN_GROUPS; g++) {
        const struct rn_slab *slab = &t->step.groups[g].slab;
        if (is_own(t, g)) copy_slab(t, slab, at, false);
        at += (size_t)slab->count * sample / sizeof *at;
    }
    x->gather(told, sizes);
    at = told;
    for (int g = 0; g < RN_GROUPS; g++) {
        const struct rn_slab *slab = &t->step.groups[g].slab;
        if (!is_own(t, g)) copy_slab(t, slab, at, true);
        at += (size_t)slab->count * sample / sizeof *at;
    }
}

void rn_ranks_tell_wave(struct rn_trainer *t) {
    if (is_alone(t) || t->ranks.shared) return;
    tell_reach(t);
    tell_slabs(t);
    t->ranks.shared = true;
}

// ---- steps ----------------------------------------------------------------------------------

static size_t network_bytes(const struct rn_trainer *t) {
    const struct rn_parameters *p = &t->field->parameters;
    return rn_parameters_behind(p) * sizeof(float);
}

// A group's sums: everything of it but what is this process's own.
static void take_sums(struct rn_group *group, const struct rn_group *told, const void *gradient,
                      size_t bytes) {
    struct rn_group own = *group;
    *group = *told;
    group->slab = own.slab;
    group->base_grad = own.base_grad;
    group->head_grad = own.head_grad;
    group->appearance_grad = own.appearance_grad;
    group->seen = own.seen;
    group->ray_loss = own.ray_loss;
    memcpy(group->base_grad, gradient, bytes); // the others follow
}

// What addresses this process alone knows goes to nobody.
static struct rn_group without_addresses(const struct rn_group *group) {
    struct rn_group told = *group;
    memset(&told.slab, 0, sizeof told.slab);
    told.base_grad = told.head_grad = told.appearance_grad = told.ray_loss = NULL;
    told.seen = NULL;
    return told;
}

static void tell_sums(struct rn_trainer *t) {
    const struct rn_exchange *x = t->ranks.exchange;
    size_t gradient = network_bytes(t), one = sizeof(struct rn_group) + gradient;
    size_t sizes[RN_MAX_RANKS];
    uint8_t *told = room_for(t, RN_GROUPS * one);
    for (int r = 0; r < x->ranks; r++)
        sizes[r] = (size_t)share_of(x, r, RN_GROUPS).count * one;
    for (int g = 0; g < RN_GROUPS; g++) {
        const struct rn_group *group = &t->step.groups[g];
        if (!is_own(t, g)) continue;
        struct rn_group sums = without_addresses(group);
        memcpy(told + (size_t)g * one, &sums, sizeof sums);
        memcpy(told + (size_t)g * one + sizeof sums, group->base_grad, gradient);
    }
    x->gather(told, sizes);
    for (int g = 0; g < RN_GROUPS; g++) {
        struct rn_group sums;
        const uint8_t *at = told + (size_t)g * one;
        if (is_own(t, g)) continue;
        memcpy(&sums, at, sizeof sums);
        take_sums(&t->step.groups[g], &sums, at + sizeof sums, gradient);
    }
}

// How large the rays' errors were, and of which blocks, where rays are drawn by that.
static void tell_losses(struct rn_trainer *t) {
    const struct rn_exchange *x = t->ranks.exchange;
    size_t sizes[RN_MAX_RANKS];
    if (t->sampler.importance.count == 0) return;
    for (int r = 0; r < x->ranks; r++) {
        struct rn_share share = share_of(x, r, RN_GROUPS);
        int first = rn_step_first_ray(t, share.first);
        sizes[r] =
            (size_t)(rn_step_first_ray(t, share.first + share.count) - first) * sizeof(float);
    }
    x->gather(t->sampler.ray_loss, sizes);
    x->gather(t->sampler.ray_block, sizes);
}

void rn_ranks_tell_step(struct rn_trainer *t) {
    if (is_alone(t)) return;
    tell_sums(t);
    tell_losses(t);
}

// ---- occupancy ------------------------------------------------------------------------------

void rn_ranks_tell_cells(struct rn_trainer *t, size_t first, size_t stride, size_t count,
                         size_t chunk) {
    const struct rn_exchange *x = t->ranks.exchange;
    size_t sizes[RN_MAX_RANKS], at = 0;
    if (is_alone(t)) return;
    float *told = (float *)room_for(t, count * sizeof *told);
    int chunks = (int)((count + chunk - 1) / chunk);
    for (int r = 0; r < x->ranks; r++) {
        struct rn_share share = share_of(x, r, chunks);
        size_t end = (size_t)(share.first + share.count) * chunk;
        if (end > count) end = count;
        sizes[r] = (end - at) * sizeof *told;
        at = end;
    }
    size_t word = 0;
    for (size_t i = 0; i < count; i++)
        told[i] = t->field->occupancy[rn_hull_cell(t, first + i * stride, &word)];
    x->gather(told, sizes);
    word = 0;
    for (size_t i = 0; i < count; i++)
        t->field->occupancy[rn_hull_cell(t, first + i * stride, &word)] = told[i];
}

void rn_ranks_tell_seen(struct rn_trainer *t) {
    size_t side = (size_t)t->field->config.field.occupancy;
    if (is_alone(t) || !t->hull.seen) return;
    t->ranks.exchange->maxima(t->hull.seen, side * side * side);
}
