// Devices and fields: the engine's outermost functions.
#include "server/engine/scene/engine.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/sha256.h"
#include "common/base/threads.h"
#include "server/engine/scene/choose.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/scene.h"

// ---- device ---------------------------------------------------------------------------------

// The set that is quickest with the standard networks.
static const struct rn_kernels *fastest_kernels(void) {
    struct rn_train_config config;
    struct rn_error err;
    if (rn_preset("standard", false, &config, &err) != RN_OK) return rn_kernels_available(0);
    return rn_choose_kernels(&config.field);
}

static void cpu_name(char *ret, size_t size) {
    snprintf(ret, size, "CPU");
    FILE *f = fopen("/proc/cpuinfo", "re");
    if (!f) return;
    char line[256];
    while (fgets(line, sizeof line, f)) {
        char *colon = strchr(line, ':');
        if (strncmp(line, "model name", 10) != 0 || !colon) continue;
        line[strcspn(line, "\n")] = 0;
        snprintf(ret, size, "%s", colon + 2);
        break;
    }
    fclose(f);
}

// The names of the sets that this machine can run.
static void list_kernels(const char *separator, char *ret, size_t size) {
    const struct rn_kernels *k;
    *ret = 0;
    for (int i = 0; (k = rn_kernels_available(i)); i++) {
        size_t used = strlen(ret);
        snprintf(ret + used, size - used, "%s%s", i ? separator : "", k->name);
    }
}

static void fill_info(struct rn_engine *e) {
    snprintf(e->info.device, sizeof e->info.device, "cpu");
    cpu_name(e->info.name, sizeof e->info.name);
    list_kernels(",", e->info.available, sizeof e->info.available);
    e->info.threads = rn_pool_threads(e->pool);
}

enum rn_status rn_engine_create(const struct rn_engine_options *options,
                                struct rn_engine **ret_engine, struct rn_error *err) {
    const char *device = options->device ? options->device : "auto";
    const char *kernels = options->kernels ? options->kernels : "auto";
    if (options->threads < 0 || options->threads > 1024)
        return rn_error_set(err, RN_ERROR_INVALID, "threads", "must be 0 to 1024");
    const struct rn_kernels *chosen =
        strcmp(kernels, "auto") == 0 ? fastest_kernels() : rn_kernels_find(kernels);
    if (!chosen) {
        char names[128];
        list_kernels(", ", names, sizeof names);
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "kernels",
                            "this machine has no kernel set '%s', but %s", kernels, names);
    }
    struct rn_engine *e = calloc(1, sizeof *e);
    if (!e) return rn_error_set(err, RN_ERROR_NO_MEMORY, "engine", "out of memory");
    e->kernels = chosen;
    enum rn_status status =
        rn_pool_create(options->threads ? options->threads : rn_usable_cores(), &e->pool, err);
    if (status != RN_OK) {
        free(e);
        return status;
    }
    fill_info(e);
    e->deterministic = options->deterministic;
    e->last_on_chip = options->last_on_chip;
    e->two_tiles = options->two_tiles;
    e->device_memory_bytes = options->device_memory_bytes;
    bool named = strcmp(kernels, "auto") != 0; // a kernel set of the CPU's
    if (strcmp(device, "cpu") != 0 && !(named && strcmp(device, "auto") == 0))
        status = rn_engine_open_device(e, device, err);
    if (status != RN_OK) {
        rn_engine_destroy(&e);
        return status;
    }
    *ret_engine = e;
    return RN_OK;
}

void rn_engine_destroy(struct rn_engine **engine) {
    if (!*engine) return;
    rn_engine_close_device(*engine);
    rn_pool_destroy(&(*engine)->pool);
    rn_block_destroy((*engine)->workspaces);
    free(*engine);
    *engine = NULL;
}

void rn_engine_keep_in(struct rn_engine *engine, const char *folder) {
    bool fits = folder && strlen(folder) < sizeof engine->folder;
    snprintf(engine->folder, sizeof engine->folder, "%s", fits ? folder : "");
}

void rn_engine_watch(struct rn_engine *engine, bool (*keep_going)(void *context), void *context) {
    engine->keep_going = keep_going;
    engine->watcher = context;
}

void rn_engine_yield_to(struct rn_engine *engine, bool (*wanted)(void *context), void *context) {
    engine->wanted = wanted;
    engine->wanter = context;
}

void rn_engine_share(struct rn_engine *engine,
                     enum rn_status (*share)(void *context, const struct rn_device_wish *wish,
                                             size_t *ret_granted, struct rn_error *err),
                     void *context) {
    engine->share = share;
    engine->sharer = context;
}

bool rn_engine_is_wanted(void *engine) {
    struct rn_engine *e = engine;
    return e->wanted && e->wanted(e->wanter);
}

void rn_engine_describe(const struct rn_engine *engine, struct rn_device_info *ret_info) {
    *ret_info = engine->info;
    snprintf(ret_info->kernels, sizeof ret_info->kernels, "%s",
             engine->backend ? engine->device_kernels : engine->kernels->name);
}

// ---- fields ---------------------------------------------------------------------------------

void rn_field_describe(const struct rn_field *field, struct rn_field_info *ret) {
    *ret = (struct rn_field_info){.config = field->config,
                                  .bounds = field->bounds,
                                  .finest_cone = field->finest_cone,
                                  .steps = field->steps,
                                  .train_seconds = field->train_seconds,
                                  .psnr = field->psnr,
                                  .parameter_count = field->parameters.count,
                                  .viewing = field->viewing};
    ret->memory_bytes = rn_field_bytes(&field->config, field->pyramid_levels);
    memcpy(ret->effects, field->effects, sizeof ret->effects);
    snprintf(ret->kernels, sizeof ret->kernels, "%s", field->kernels);
}

void rn_field_sha256(const struct rn_field *field, char ret_hex[65]) {
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    rn_sha256_update(&hash, field->parameters.values, field->parameters.count * sizeof(float));
    rn_sha256_final_hex(&hash, ret_hex);
}
