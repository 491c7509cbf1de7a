#include "server/engine/device.h"

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

// The CUDA runtime does not survive being unloaded.
#define MODULE_FLAGS (RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE)

// ---- the module -----------------------------------------------------------------------------

// `name` beside the running program.
static void beside_program(const char *name, char *ret, size_t size) {
    char program[1024];
    ssize_t n = readlink("/proc/self/exe", program, sizeof program - 1);
    program[n > 0 ? n : 0] = 0;
    char *slash = strrchr(program, '/');
    if (slash) *slash = 0;
    snprintf(ret, size, "%s/%s", program, name);
}

static void *open_module(void) {
    char path[2048];
    const char *given = getenv("RIPNERF_CUDA_MODULE");
    if (given) return dlopen(given, MODULE_FLAGS);
    void *module = dlopen(RN_MODULE_FOLDER "/ripnerf-cuda.so", MODULE_FLAGS);
    beside_program("engine/cuda/ripnerf-cuda.so", path, sizeof path);
    if (!module && access(path, R_OK) == 0) module = dlopen(path, MODULE_FLAGS);
    return module;
}

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

static enum rn_status open_ordinal(struct rn_engine *e, int ordinal, size_t budget_bytes,
                                   struct rn_error *err) {
    struct rn_device_about about;
    e->module = open_module();
    const struct rn_backend *table = find_table(e->module, err);
    enum rn_status status =
        table ? table->open(ordinal, budget_bytes, &e->device, &about, err) : RN_ERROR_UNSUPPORTED;
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

enum rn_status rn_engine_open_device(struct rn_engine *e, const char *device, size_t budget_bytes,
                                     struct rn_error *err) {
    int ordinal = -1, length = 0;
    struct rn_error unused;
    e->device_optional = strcmp(device, "auto") == 0;
    if (e->device_optional) {
        (void)!open_ordinal(e, 0, budget_bytes, &unused);
        return RN_OK;
    }
    if (sscanf(device, "cuda:%2d%n", &ordinal, &length) != 1 || device[length] || ordinal < 0)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "device",
                            "'%s' is no device; use auto, cpu or cuda:N", device);
    return open_ordinal(e, ordinal, budget_bytes, err);
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

void rn_device_adapt(struct rn_train_config *config) {
    config->roulette = 0;
}

// ---- fields ---------------------------------------------------------------------------------

enum rn_status rn_field_put(struct rn_engine *engine, struct rn_field *f, int levels,
                            struct rn_error *err) {
    rn_field_withdraw(f);
    struct rn_device_scene scene = {.config = f->config,
                                    .radius = f->bounds.radius,
                                    .solid = f->cpu.solid,
                                    .base_shape = f->cpu.base_shape,
                                    .head_shape = f->cpu.head_shape,
                                    .levels = levels,
                                    .parameter_count = f->parameters.count,
                                    .parameters = f->parameters.values,
                                    .occupancy = f->occupancy,
                                    .hull = f->hull};
    memcpy(scene.centre, f->bounds.centre, sizeof scene.centre);
    enum rn_status status =
        engine->backend->field_create(engine->device, &scene, &f->on_device, err);
    if (status != RN_OK) return status;
    f->backend = engine->backend;
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
    while (levels > 1 && c->base % (1 << (levels - 1)) != 0)
        levels--;
    enum rn_status status = rn_field_put(engine, f, levels, &own);
    if (engine->device_optional && status != RN_ERROR_UNAVAILABLE) return RN_OK;
    if (status != RN_OK && err) *err = own;
    return status;
}

enum rn_status rn_field_fetch(struct rn_field *f, float *m, float *v, struct rn_error *err) {
    if (!f->on_device || !(f->behind || (m && f->moments_behind))) return RN_OK;
    enum rn_status status =
        f->backend->download(f->on_device, f->parameters.values, m, v, f->occupancy, err);
    if (status != RN_OK) return status;
    f->behind = false;
    if (m) f->moments_behind = false;
    f->fresh_levels = 0;
    f->packed_for = NULL;
    rn_field_refresh_occupancy(f);
    return RN_OK;
}

void rn_field_withdraw(struct rn_field *f) {
    if (f->on_device) f->backend->field_destroy(&f->on_device);
}
