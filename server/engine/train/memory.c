#include "server/engine/train/memory.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

#include "server/engine/train/photographs.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

static struct rn_camera reduced(const struct rn_trainer *t, const struct rn_frame *frame) {
    return rn_camera_reduced(&frame->camera, rn_train_reduced(&t->field->config));
}

int rn_trainer_levels(const struct rn_trainer *t) {
    struct rn_selection s = {t->dataset, &t->field->config, false};
    int levels = 1;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        const struct rn_frame *frame = &t->dataset->frames[f];
        if (!rn_selection_wants(&s, frame)) continue;
        struct rn_camera camera = reduced(t, frame);
        int need = rn_levels_for_camera(t->field, &camera, t->field->config.step);
        if (need > levels) levels = need;
    }
    return levels < t->field->config.field.levels ? levels : t->field->config.field.levels;
}

// What a process takes before it has read anything: its libraries' data, stacks, buffers.
#define OWN_BYTES (4u << 20)
// Of photographs that lie on disk, in memory at the least: with less, each look fetches its page.
#define LEAST_PAGES (8u << 20)

static size_t dataset_bytes(const struct rn_dataset *d) {
    size_t names = 0;
    for (size_t f = 0; f < d->frame_count; f++)
        names += strlen(d->frames[f].path);
    return d->frame_count * sizeof *d->frames + names + d->points.count * sizeof *d->points.items +
           d->points.sighting_count * sizeof *d->points.sightings;
}

// Of blocks of the photographs to train on, live or not: the list of those that are, by what they
// are drawn, whether they are left out; and while it is made or outliers are sought (whichever
// takes more), marks, or what is found of those that a pass looks at.
static size_t block_bytes(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    struct rn_selection s = {t->dataset, config, false};
    size_t blocks = 0, most = 0;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        struct rn_camera camera = reduced(t, &t->dataset->frames[f]);
        size_t of_frame = rn_trainer_blocks(&camera);
        if (!rn_selection_wants(&s, &t->dataset->frames[f])) continue;
        blocks += of_frame;
        if (of_frame > most) most = of_frame;
    }
    size_t bytes = rn_trainer_live_bytes(blocks), briefly = blocks;
    if (config->draw_by_error) bytes += rn_importance_bytes(blocks, t->dataset->scale_count);
    if (config->effect[RN_EFFECT_ROBUST_LOSS] != RN_EFFECT_UNWANTED) {
        size_t sought = rn_outlier_pass_bytes(blocks, most);
        bytes += blocks;
        if (sought > briefly) briefly = sought;
    }
    return bytes + briefly;
}

// Of a step there is room for more, which is not taken before they come; but a ray has a sample or
// two.
static size_t most_rays(const struct rn_train_config *config) {
    size_t rays = (size_t)fmax(config->target_samples, config->initial_rays);
    return rays < RN_MAX_RAYS ? rays : RN_MAX_RAYS;
}

// Once its planes are grown, before when no more than that is taken: parameters, their gradients,
// two moments and the last good ones; a pyramid and its gradients; what an update writes apart;
// what a step's groups keep; a packet a thread; rays; cells of the hull, and what they showed.
static size_t step_bytes(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_cpu_field *cpu = &t->field->cpu;
    struct rn_train_config grown = *config;
    if (config->grow_to > config->field.base) grown.field.base = config->grow_to;
    size_t side = (size_t)grown.field.base, before = (size_t)config->field.base;
    size_t cells = (size_t)config->field.occupancy, n = cells * cells * cells;
    size_t parameters = t->field->parameters.plane_count / (before * before) * (side * side) +
                        rn_parameters_behind(&t->field->parameters);
    size_t pyramid =
        rn_pyramid_count(&grown.field, rn_trainer_levels(t)) * (size_t)grown.field.planes;
    double step = rn_picture_step(t->field);
    int capacity = 2 * rn_workspace_capacity(cpu, step);
    return rn_field_bytes(&grown, 1) + (4 * parameters + 2 * pyramid) * sizeof(float) +
           rn_optimiser_apart_bytes(&grown, parameters, rn_trainer_levels(t)) +
           RN_GROUPS * rn_group_numbers(cpu, capacity) * sizeof(float) +
           (size_t)rn_pool_threads(t->engine->pool) * rn_workspace_size(cpu, step) +
           most_rays(config) *
               (sizeof(struct rn_march_ray) + sizeof(float) + sizeof(int32_t) + sizeof(uint32_t)) +
           n / RN_HULL_WORD * sizeof(uint32_t) + (rn_is_place(cpu) ? n * sizeof(uint32_t) : 0);
}

static size_t decoded_smaller(const struct rn_frame *frame, int most) {
    const char *end = strrchr(frame->path, '.');
    bool jpeg = end && (strcasecmp(end, ".jpg") == 0 || strcasecmp(end, ".jpeg") == 0);
    if (!jpeg || frame->mask_path) return 1;
    return (size_t)rn_image_times_smaller(frame->camera.width, frame->camera.height, most);
}

// While photographs are decoded, before that: one a thread, whole or as small as its decoder makes
// it, what becomes of it, and its mask.
static size_t decoding_bytes(const struct rn_trainer *t) {
    size_t most = 0;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        const struct rn_frame *frame = &t->dataset->frames[f];
        struct rn_camera small = reduced(t, frame);
        size_t w = (size_t)frame->camera.width, h = (size_t)frame->camera.height;
        size_t times = decoded_smaller(frame, rn_train_reduced(&t->field->config));
        size_t bytes = 4 * w * h / (times * times);
        if ((size_t)small.width != w) bytes += 4 * (size_t)small.width * (size_t)small.height;
        if (frame->mask_path) bytes += 2 * w * h;
        if (bytes > most) most = bytes;
    }
    return (size_t)rn_pool_threads(t->engine->pool) * most;
}

static size_t training_bytes(const struct rn_trainer *t) {
    size_t decoding = rn_field_bytes(&t->field->config, 1) + decoding_bytes(t);
    size_t steps = step_bytes(t) + block_bytes(t);
    return OWN_BYTES + dataset_bytes(t->dataset) + (steps > decoding ? steps : decoding);
}

#define LESS_MEMORY "take a smaller --base, fewer --planes or a smaller --preset, or "

enum rn_status rn_trainer_lacks_memory(const struct rn_trainer *t, enum rn_status status,
                                       struct rn_error *err) {
    char where[sizeof err->where];
    if (status != RN_ERROR_NO_MEMORY || !t || !err || strcmp(err->text, "out of memory") != 0)
        return status; // or it is a device's that is out
    snprintf(where, sizeof where, "%s", err->where);
    return rn_error_set(err, status, where,
                        "out of memory; training needs %zu MiB in all: " LESS_MEMORY
                        "let ripnerfd and its runners have more",
                        rn_trainer_bytes(t) >> 20);
}

enum rn_status rn_trainer_check_memory(const struct rn_trainer *t, size_t limit, size_t *ret_left,
                                       struct rn_error *err) {
    *ret_left = 0;
    if (!limit) return RN_OK;
    size_t need = training_bytes(t) + LEAST_PAGES;
    if (need >= limit)
        return rn_error_set(
            err, RN_ERROR_LIMIT, t->dataset->name,
            "training needs %zu MiB besides the pixels and the limit is %zu MiB; " LESS_MEMORY
            "start ripnerfd with a larger --memory-limit",
            need >> 20, limit >> 20);
    *ret_left = limit - need + LEAST_PAGES;
    return RN_OK;
}

static size_t pixel_bytes(const struct rn_trainer *t) {
    struct rn_selection train = {t->dataset, &t->field->config, false}, held = train;
    size_t pixels = 0;
    bool masked = false;
    held.held = true;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        const struct rn_frame *frame = &t->dataset->frames[f];
        struct rn_camera camera = reduced(t, frame);
        size_t n = (size_t)camera.width * (size_t)camera.height;
        masked = masked || frame->mask_path;
        pixels += n * ((size_t)rn_selection_wants(&train, frame) +
                       (size_t)rn_selection_wants(&held, frame));
    }
    size_t bytes = rn_pixels_bytes(pixels, masked),
           most = (size_t)t->field->config.pixel_memory << 20;
    return most && bytes > most && *t->engine->folder ? most : bytes;
}

size_t rn_trainer_bytes(const struct rn_trainer *t) {
    return training_bytes(t) + pixel_bytes(t);
}
