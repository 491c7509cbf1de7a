#include "server/runner/field/incidents.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "common/base/log.h"
#include "proto/incident.h"

#define FILES_MOST 256 // of a scene

_Static_assert(RN_INCIDENT_KEPT <= RN_INCIDENT_RECORD_MOST, "rays and parameters listed");

// A number that the file can hold: what is not finite counts as 0, and is said elsewhere.
static double tame(float value) {
    return isfinite(value) ? (double)value : 0;
}

static void tame3(const float from[3], double to[3]) {
    for (int i = 0; i < 3; i++)
        to[i] = tame(from[i]);
}

static void fill_ray(const struct rn_incident_ray *ray, struct rn_incident_ray_record *ret) {
    *ret = (struct rn_incident_ray_record){.id = ray->id,
                                           .fault = (int)ray->fault,
                                           .split = (int)ray->split,
                                           .index = ray->index,
                                           .scale = ray->scale,
                                           .x = ray->x,
                                           .y = ray->y,
                                           .near = tame(ray->near),
                                           .length = tame(ray->length),
                                           .radius = tame(ray->radius),
                                           .weight = tame(ray->weight),
                                           .stride = ray->stride};
    tame3(ray->origin, ret->origin);
    tame3(ray->direction, ret->direction);
    tame3(ray->target, ret->target);
}

static enum rn_status fill(const struct rn_incident *incident, struct rn_incident_record *ret,
                           struct rn_error *err) {
    rn_message_init(&rn_incident_table, ret);
    ret->rays = calloc(RN_INCIDENT_KEPT, sizeof *ret->rays);
    ret->parameters = calloc(RN_INCIDENT_KEPT, sizeof *ret->parameters);
    if (!ret->rays || !ret->parameters)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "incident", "out of memory");
    ret->kind = (int)incident->kind;
    ret->step = incident->step;
    ret->seed = (int64_t)incident->seed;
    ret->rate = incident->rate;
    ret->nonfinite_rays = (int64_t)incident->nonfinite_rays;
    ret->nonfinite_parameters = (int64_t)incident->nonfinite_parameters;
    ret->march_step = (double)incident->march_step;
    tame3(incident->background, ret->background);
    ret->ray_count = (size_t)incident->ray_count;
    for (int i = 0; i < incident->ray_count; i++)
        fill_ray(&incident->rays[i], &ret->rays[i]);
    ret->parameter_count = (size_t)incident->parameter_count;
    for (int i = 0; i < incident->parameter_count; i++) {
        float value = incident->parameters[i].value;
        ret->parameters[i] = (struct rn_incident_parameter_record){
            (int64_t)incident->parameters[i].index, isnan(value) ? 0
                                                    : value > 0  ? 1
                                                                 : 2};
    }
    return RN_OK;
}

static int count_files(const char *folder) {
    int count = 0;
    DIR *entries = opendir(folder);
    while (entries && readdir(entries))
        count++;
    if (entries) closedir(entries);
    return count;
}

static enum rn_status write_record(struct rn_host *host, const struct rn_incident *incident,
                                   const char *file, struct rn_error *err) {
    struct rn_incident_record record;
    struct rn_device_info device;
    char *json = NULL, folder[PATH_MAX], path[PATH_MAX];
    size_t size = 0;
    snprintf(folder, sizeof folder, "%s/incidents", host->place.scene_folder);
    if (snprintf(path, sizeof path, "%s/%s", host->place.scene_folder, file) >= (int)sizeof path)
        return rn_error_set(err, RN_ERROR_LIMIT, host->place.scene_folder, "the path is too long");
    enum rn_status status = rn_mkdir(folder, 0777, err);
    if (!status && count_files(folder) > FILES_MOST)
        status = rn_error_set(err, RN_ERROR_LIMIT, folder, "is full; remove old records");
    if (status) return status;
    status = fill(incident, &record, err);
    rn_engine_describe(host->engine, &device);
    snprintf(record.kernels, sizeof record.kernels, "%s", device.kernels);
    if (!status) status = rn_encode(&rn_incident_table, &record, &json, &size, err);
    rn_message_finish(&rn_incident_table, &record);
    if (!status) status = rn_file_write_atomic(path, json, size, err);
    free(json);
    return status;
}

void rn_incidents_report(struct rn_host *host, struct rn_trainer *trainer, const char *job) {
    struct rn_incident incident;
    while (rn_trainer_take_incident(trainer, &incident)) {
        struct rn_error err = {0};
        struct rn_wire_incident message = {
            .incident = {.kind = (int)incident.kind,
                         .step = incident.step,
                         .rays = (int64_t)incident.nonfinite_rays,
                         .parameters = (int64_t)incident.nonfinite_parameters}};
        char *file = message.incident.file;
        snprintf(file, sizeof message.incident.file, "incidents/step-%09lld-%s.json",
                 (long long)incident.step, rn_incident_kind_names[incident.kind]);
        if (write_record(host, &incident, file, &err)) {
            rn_log(RN_LOG_WARN, "an incident of step %lld is not kept: %s: %s",
                   (long long)incident.step, err.where, err.text);
            *file = '\0';
        }
        snprintf(message.job, sizeof message.job, "%s", job);
        rn_link_post(&host->link, RN_WIRE_INCIDENT, &message, NULL, 0);
    }
}
