// What the daemon says about itself.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/settings/effects.h"
#include "proto/event.h"
#include "proto/formats.h"
#include "proto/openapi.h"
#include "server/api/app.h"

void rn_get_health(void *context, struct rn_request *request, struct rn_reply *reply) {
    rn_reply_text(reply, 200, "application/json", "{\"status\":\"ok\"}");
}

void rn_get_ready(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    const char *folder = rn_store_folder(app->store);
    struct rn_control_stats stats;
    struct statvfs disk;
    rn_control_stats(app->control, &stats);
    if (statvfs(folder, &disk) != 0 || access(folder, W_OK) != 0 || disk.f_bavail == 0)
        rn_reply_problem(reply, RN_PROBLEM_UNAVAILABLE, "%.200s cannot be written", folder);
    else if (stats.can_start && !stats.probed)
        rn_reply_problem(reply, RN_PROBLEM_UNAVAILABLE, "the device is being examined");
    else if (!stats.can_start)
        rn_reply_problem(reply, RN_PROBLEM_UNAVAILABLE, "no runner can be started; see the log");
    else
        rn_get_health(context, request, reply);
}

static void split_kernels(const char *list, struct rn_info *info) {
    while (*list != '\0' && info->available_kernel_count < 16) {
        size_t size = strcspn(list, ",");
        if (size > 0 && size < sizeof info->available_kernels[0])
            memcpy(info->available_kernels[info->available_kernel_count++], list, size);
        list += size + (list[size] == ',');
    }
}

void rn_get_info(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_runner_device device;
    struct rn_info info;
    struct rn_error err = {0};
    char *json = NULL;
    rn_control_device(app->control, &device);
    rn_message_init(&rn_info_table, &info);
    snprintf(info.version, sizeof info.version, "%s", RN_VERSION);
    snprintf(info.device, sizeof info.device, "%s", device.device);
    snprintf(info.device_name, sizeof info.device_name, "%s", device.name);
    snprintf(info.kernels, sizeof info.kernels, "%s", device.kernels);
    split_kernels(device.available, &info);
    if (rn_control_spreads(app->control)) snprintf(info.executor, sizeof info.executor, "slurm");
    info.threads = device.threads;
    info.films = device.films;
    info.uptime_s = (double)(rn_clock_ns() - app->start_ns) * 1e-9;
    info.memory_limit_bytes = app->memory_limit_bytes;
    info.limits = (struct rn_limits_record){
        .max_body_bytes = RN_MAX_BODY,
        .max_upload_bytes = app->max_upload_bytes,
        .max_upload_entries = app->max_upload_entries,
        .max_queued_jobs = app->max_queued,
        .max_training_jobs = app->training_slots,
        .max_render_pixels = RN_MAX_RENDER_PIXELS,
        .max_scenes_loaded = app->max_loaded,
    };
    const struct rn_caller *caller = rn_request_caller(request);
    size_t roots = rn_caller_is_link(caller) ? 0 : app->root_count;
    rn_api_describe_caller(app, caller, &info.you);
    for (; info.effect_count < RN_EFFECT_COUNT; info.effect_count++)
        snprintf(info.effects[info.effect_count], sizeof *info.effects, "%s",
                 rn_effect_name((enum rn_effect)info.effect_count));
    enum rn_status status = rn_encode_strings(app->roots, roots, &info.roots, &err);
    if (status == RN_OK) status = rn_encode(&rn_info_table, &info, &json, NULL, &err);
    rn_message_finish(&rn_info_table, &info);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_get_formats(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status = rn_formats_to_json(&json, &err);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_get_openapi(void *context, struct rn_request *request, struct rn_reply *reply) {
    rn_reply_text(reply, 200, "application/json", rn_openapi_json);
}
