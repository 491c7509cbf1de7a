#include "server/engine/scene/device.h"

#include <dlfcn.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/engine/scene/module.h"
#include "server/engine/scene/occupancy.h"

// ---- the module -----------------------------------------------------------------------------

static const struct rn_backend *find_table(void *module, struct rn_error *err) {
    const struct rn_backend *table = module ? dlsym(module, RN_BACKEND_SYMBOL) : NULL;
    const char *why = table ? NULL : dlerror();
    if (!table)
        rn_error_set(err, RN_ERROR_UNSUPPORTED, "device",
                     "the CUDA module is not installed (%s); use --device cpu",
                     why ? why : "no reason given");
    else if (table->version != RN_BACKEND_VERSION)
        rn_error_set(err, RN_ERROR_UNSUPPORTED, "device",
                     "the CUDA module is of another version (%d, not %d); install both from one "
                     "build, or use --device cpu",
                     table->version, RN_BACKEND_VERSION);
    else
        return table;
    return NULL;
}

static enum rn_status open_ordinal(struct rn_engine *e, int ordinal, struct rn_error *err) {
    struct rn_device_about about;
    e->module =
        rn_module_open("RIPNERF_CUDA_MODULE", "ripnerf-cuda.so", "engine/cuda/ripnerf-cuda.so");
    const struct rn_backend *table = find_table(e->module, err);
    enum rn_status status =
        table ? table->open(ordinal, &e->device, &about, err) : RN_ERROR_UNSUPPORTED;
    if (status != RN_OK) {
        rn_engine_close_device(e);
        return status;
    }
    e->backend = table;
    snprintf(e->info.device, sizeof e->info.device, "cuda:%d", ordinal);
    snprintf(e->info.name, sizeof e->info.name, "%s", about.name);
    snprintf(e->device_kernels, sizeof e->device_kernels, "%s", about.kernels);
    return RN_OK;
}

// A device that nobody insists on is used where it computes what the CPU does.
static void check_optional(struct rn_engine *e, const struct rn_device_info *cpu) {
    struct rn_device_agreement found;
    struct rn_error why;
    char gradient[64] = "no room to train";
    if (rn_device_check(e, false, &found, &why) == RN_OK) {
        if (!isnan(found.gradient))
            snprintf(gradient, sizeof gradient, "the loss follows its gradient to %.1f %%",
                     100 * found.gradient);
        snprintf(e->info.checked, sizeof e->info.checked,
                 "%s agrees with the CPU: pixels to %.1e, %s", e->info.device, found.pixels,
                 gradient);
        return;
    }
    rn_engine_close_device(e);
    e->info = *cpu;
    snprintf(e->info.checked, sizeof e->info.checked, "the CPU is used: %.200s", why.text);
}

enum rn_status rn_engine_open_device(struct rn_engine *e, const char *device,
                                     struct rn_error *err) {
    int ordinal = -1, length = 0;
    struct rn_error unused;
    e->device_optional = strcmp(device, "auto") == 0;
    if (e->device_optional) {
        struct rn_device_info cpu = e->info;
        if (open_ordinal(e, 0, &unused) == RN_OK) check_optional(e, &cpu);
        return RN_OK;
    }
    if (sscanf(device, "cuda:%2d%n", &ordinal, &length) != 1 || device[length] || ordinal < 0)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "device",
                            "'%s' is no device; use auto, cpu or cuda:N", device);
    return open_ordinal(e, ordinal, err);
}

void rn_engine_close_device(struct rn_engine *e) {
    if (e->device) e->backend->close(&e->device);
    if (e->module) dlclose(e->module);
    e->backend = NULL;
    e->module = NULL;
}

bool rn_device_trained(const char *kernels) {
    return strncmp(kernels, "sm_", 3) == 0;
}

// ---- memory ---------------------------------------------------------------------------------

// Asks whoever shares the device out for `bytes` of it, or takes what is free; a part is left for
// what the device's runtime needs itself.
static enum rn_status reserve(struct rn_engine *e, size_t bytes, bool patient, size_t *ret_granted,
                              struct rn_error *err) {
    size_t free_bytes = e->backend->free_bytes(e->device);
    struct rn_device_wish wish = {.device = e->info.device,
                                  .bytes = bytes,
                                  .free_bytes = free_bytes - free_bytes / 32,
                                  .patient = patient};
    *ret_granted = e->device_memory_bytes ? e->device_memory_bytes : wish.free_bytes;
    if (free_bytes == 0) *ret_granted = bytes; // the device does not answer: taking it will tell
    if (e->share && free_bytes > 0) return e->share(e->sharer, &wish, ret_granted, err);
    return RN_OK;
}

static void release(struct rn_engine *e) {
    struct rn_device_wish nothing = {.device = e->info.device};
    size_t none;
    struct rn_error unused;
    if (e->share) (void)!e->share(e->sharer, &nothing, &none, &unused);
}

// Memory for a field, before it is taken.
static enum rn_status make_room(struct rn_engine *e, const struct rn_device_scene *scene,
                                const struct rn_device_pixels *pixels,
                                const struct rn_device_training *training, struct rn_error *err) {
    size_t bytes, granted = 0;
    enum rn_status status = e->backend->needs(scene, pixels, training, SIZE_MAX, &bytes, err);
    if (status == RN_OK) status = reserve(e, bytes, pixels || !e->device_optional, &granted, err);
    if (status == RN_OK) status = e->backend->needs(scene, pixels, training, granted, &bytes, err);
    return status;
}

// ---- fields ---------------------------------------------------------------------------------

struct rn_device_scene rn_device_scene_of(const struct rn_field *f, int levels) {
    struct rn_device_scene scene = {.config = f->config,
                                    .radius = f->bounds.radius,
                                    .disparity = f->cpu.disparity,
                                    .solid = f->cpu.solid,
                                    .base_shape = f->cpu.base_shape,
                                    .head_shape = f->cpu.head_shape,
                                    .levels = levels,
                                    .parameter_count =
                                        f->parameters.count - f->parameters.appearance_count,
                                    .parameters = f->parameters.values,
                                    .occupancy = f->occupancy,
                                    .hull = f->hull};
    if (f->fine.words) {
        scene.finer[RN_CELLS_FINE] = &f->fine;
        scene.finer[RN_CELLS_FIRM] = &f->firm;
    }
    memcpy(scene.centre, f->bounds.centre, sizeof scene.centre);
    return scene;
}

// A device gives the colour network harmonics of third degree where the CPU gives it a photograph's
// appearance, 0 in pictures: `copy` is the parameters without what these inputs weigh.
static void leave_out_appearances(const struct rn_field *f, float *copy) {
    const struct rn_parameters *p = &f->parameters;
    size_t width = (size_t)f->cpu.head_shape.out[0];
    memcpy(copy, p->values, (p->count - p->appearance_count) * sizeof *copy);
    memset(copy + p->plane_count + p->base_count + RN_APPEARANCE_AT * width, 0,
           RN_APPEARANCE * width * sizeof *copy);
}

enum rn_status rn_field_put(struct rn_engine *engine, struct rn_field *f, int levels,
                            const struct rn_device_pixels *pixels,
                            const struct rn_device_training *training, struct rn_error *err) {
    if (f->on_device) f->backend->field_destroy(&f->on_device);
    struct rn_device_scene scene = rn_device_scene_of(f, levels);
    const struct rn_backend *backend = engine->backend;
    float *copy = NULL;
    if (f->parameters.appearance_count) {
        if (pixels)
            return rn_error_set(err, RN_ERROR_UNSUPPORTED, "appearance",
                                "a GPU does not train photographs' appearances; use --device cpu, "
                                "or train with --effect appearance=off");
        copy = malloc(scene.parameter_count * sizeof *copy);
        if (!copy) return rn_error_set(err, RN_ERROR_NO_MEMORY, "appearance", "out of memory");
        leave_out_appearances(f, copy);
        scene.parameters = copy;
    }
    enum rn_status status = make_room(engine, &scene, pixels, training, err);
    if (status == RN_OK) status = backend->field_create(engine->device, &scene, &f->on_device, err);
    free(copy);
    if (status == RN_OK && pixels)
        status = backend->train_begin(f->on_device, pixels, training, err);
    if (status != RN_OK) {
        backend->field_destroy(&f->on_device);
        release(engine);
        return status;
    }
    f->backend = backend;
    f->engine = engine;
    f->device_levels = levels;
    f->behind = f->moments_behind = false;
    return RN_OK;
}

enum rn_status rn_field_put_to_render(struct rn_engine *engine, struct rn_field *f,
                                      struct rn_error *err) {
    const struct rn_field_config *c = &f->config.field;
    int levels = c->footprint == RN_FOOTPRINT_POINT ? 1 : c->levels;
    struct rn_error own;
    if (!engine->backend) return RN_OK;
    while (levels > 1 && c->base >> (levels - 1) == 0)
        levels--;
    enum rn_status status = rn_field_put(engine, f, levels, NULL, NULL, &own);
    f->rests = status == RN_ERROR_LIMIT || status == RN_ERROR_NO_MEMORY;
    if (engine->device_optional && status != RN_ERROR_UNAVAILABLE) return RN_OK;
    if (status != RN_OK && err) *err = own;
    return status;
}

enum rn_status rn_field_fetch(struct rn_field *f, const struct rn_device_numbers *training,
                              struct rn_error *err) {
    if (!f->on_device || !(f->behind || (training && f->moments_behind))) return RN_OK;
    struct rn_device_numbers numbers = {.parameters = NULL};
    if (training) numbers = *training;
    numbers.parameters = f->parameters.values;
    numbers.occupancy = f->occupancy;
    enum rn_status status = f->backend->download(f->on_device, &numbers, err);
    if (status != RN_OK) return status;
    f->behind = false;
    if (training) f->moments_behind = false;
    f->fresh_levels = 0;
    f->packed_for = NULL;
    rn_field_refresh_occupancy(f);
    return RN_OK;
}

void rn_field_rest(struct rn_field *f) {
    f->rests = f->rests || f->on_device;
    rn_field_withdraw(f);
}

void rn_field_withdraw(struct rn_field *f) {
    if (!f->on_device) return;
    f->backend->field_destroy(&f->on_device);
    release(f->engine);
}
