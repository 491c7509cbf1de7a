#include "server/engine/train/memory.h"

#include "server/engine/train/photographs.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

int rn_trainer_levels(const struct rn_trainer *t) {
    struct rn_selection s = {t->dataset, &t->field->config, false};
    int levels = 1;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        const struct rn_frame *frame = &t->dataset->frames[f];
        if (!rn_selection_wants(&s, frame)) continue;
        struct rn_camera camera =
            rn_camera_reduced(&frame->camera, rn_train_reduced(&t->field->config));
        int need = rn_levels_for_camera(t->field, &camera, t->field->config.step);
        if (need > levels) levels = need;
    }
    return levels < t->field->config.field.levels ? levels : t->field->config.field.levels;
}

// Once its planes are grown: parameters, their gradients, two moments and the last good ones; a
// pyramid and its gradients; what an update writes apart; what a step's groups keep; a packet a
// thread; rays.
static size_t training_bytes(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_cpu_field *cpu = &t->field->cpu;
    struct rn_train_config grown = *config;
    if (config->grow_to > config->field.base) grown.field.base = config->grow_to;
    size_t side = (size_t)grown.field.base, before = (size_t)config->field.base;
    size_t parameters = t->field->parameters.plane_count / (before * before) * (side * side) +
                        t->field->parameters.base_count + t->field->parameters.head_count;
    size_t pyramid =
        rn_pyramid_count(&grown.field, rn_trainer_levels(t)) * (size_t)grown.field.planes;
    double step = rn_picture_step(t->field);
    int capacity = 2 * rn_workspace_capacity(cpu, step);
    return rn_field_bytes(&grown, 1) + (4 * parameters + 2 * pyramid) * sizeof(float) +
           rn_optimiser_apart_bytes(&grown, parameters, rn_trainer_levels(t)) +
           RN_GROUPS * rn_group_numbers(cpu, capacity) * sizeof(float) +
           (size_t)rn_pool_threads(t->engine->pool) * rn_workspace_size(cpu, step) +
           RN_MAX_RAYS * sizeof(struct rn_march_ray);
}

enum rn_status rn_trainer_check_memory(const struct rn_trainer *t, size_t limit, size_t *ret_left,
                                       struct rn_error *err) {
    *ret_left = 0;
    if (!limit) return RN_OK;
    size_t need = training_bytes(t);
    if (need >= limit)
        return rn_error_set(err, RN_ERROR_LIMIT, t->dataset->name,
                            "training needs %zu MiB besides the pixels and the limit is %zu MiB; "
                            "take a smaller --base, fewer --planes or a smaller --preset, or "
                            "start ripnerfd with a larger --memory-limit",
                            need >> 20, limit >> 20);
    *ret_left = limit - need;
    return RN_OK;
}

static size_t pixel_bytes(const struct rn_trainer *t) {
    struct rn_selection train = {t->dataset, &t->field->config, false}, held = train;
    size_t pixels = 0;
    bool masked = false;
    held.held = true;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        const struct rn_frame *frame = &t->dataset->frames[f];
        struct rn_camera camera =
            rn_camera_reduced(&frame->camera, rn_train_reduced(&t->field->config));
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
