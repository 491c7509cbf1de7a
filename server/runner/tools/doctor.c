#include "server/runner/tools/doctor.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/file.h"
#include "proto/doctor.h"
#include "proto/incident.h"

#define CAMERAS_BYTES (256u << 20)
#define REPLAY_BYTES (1u << 20)

static void say(const char *what) {
    fprintf(stderr, "doctor: %s\n", what);
}

// Decodes a file; errors name it.
static enum rn_status read_message(const char *path, size_t most, const struct rn_table *table,
                                   void *ret_message, struct rn_error *err) {
    uint8_t *bytes;
    size_t size;
    enum rn_status status = rn_file_read(path, most, &bytes, &size, err);
    if (status) return status;
    status = rn_decode(table, (const char *)bytes, size, ret_message, NULL, err);
    free(bytes);
    if (!status) return status;
    char pointer[sizeof err->where];
    memcpy(pointer, err->where, sizeof pointer);
    snprintf(err->where, sizeof err->where, "%.150s%.100s", path, pointer);
    return status;
}

// ---- cameras --------------------------------------------------------------------------------

static enum rn_status read_cameras(const char *path, struct rn_camera **ret_cameras,
                                   size_t *ret_count, struct rn_error *err) {
    struct rn_camera_list_record list;
    enum rn_status status = read_message(path, CAMERAS_BYTES, &rn_camera_list_table, &list, err);
    if (status) return status;
    struct rn_camera *cameras = calloc(list.item_count + 1, sizeof *cameras);
    if (!cameras) status = rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    for (size_t i = 0; i < list.item_count && !status; i++)
        cameras[i] = list.items[i].camera;
    *ret_count = list.item_count;
    rn_message_finish(&rn_camera_list_table, &list);
    if (status)
        free(cameras);
    else
        *ret_cameras = cameras;
    return status;
}

// ---- the incident ---------------------------------------------------------------------------

static void narrow3(const double from[3], float to[3]) {
    for (int i = 0; i < 3; i++)
        to[i] = (float)from[i];
}

static void take_ray(const struct rn_incident_ray_record *record, struct rn_incident_ray *ret) {
    *ret = (struct rn_incident_ray){.id = (uint32_t)record->id,
                                    .fault = (enum rn_ray_fault)record->fault,
                                    .split = (enum rn_split)record->split,
                                    .index = (int)record->index,
                                    .scale = (int)record->scale,
                                    .x = (int)record->x,
                                    .y = (int)record->y,
                                    .near = (float)record->near,
                                    .length = (float)record->length,
                                    .radius = (float)record->radius,
                                    .weight = (float)record->weight,
                                    .stride = (int)record->stride};
    narrow3(record->origin, ret->origin);
    narrow3(record->direction, ret->direction);
    narrow3(record->target, ret->target);
}

enum rn_status rn_incident_read(const char *path, struct rn_incident *ret, struct rn_error *err) {
    static const float wild[] = {NAN, INFINITY, -INFINITY};
    struct rn_incident_record record;
    enum rn_status status = read_message(path, REPLAY_BYTES, &rn_incident_table, &record, err);
    if (status) return status;
    *ret = (struct rn_incident){.kind = (enum rn_incident_kind)record.kind,
                                .step = record.step,
                                .seed = (uint64_t)record.seed,
                                .rate = record.rate,
                                .nonfinite_rays = (uint64_t)record.nonfinite_rays,
                                .nonfinite_parameters = (uint64_t)record.nonfinite_parameters,
                                .march_step = (float)record.march_step,
                                .ray_count = (int)record.ray_count,
                                .parameter_count = (int)record.parameter_count};
    narrow3(record.background, ret->background);
    for (size_t i = 0; i < record.ray_count; i++)
        take_ray(&record.rays[i], &ret->rays[i]);
    for (size_t i = 0; i < record.parameter_count; i++)
        ret->parameters[i] = (struct rn_incident_parameter){(uint64_t)record.parameters[i].index,
                                                            wild[record.parameters[i].value]};
    rn_message_finish(&rn_incident_table, &record);
    return RN_OK;
}

// ---- the report -----------------------------------------------------------------------------

enum rn_status rn_doctor_result_json(const struct rn_doctor_result *result, char **ret_json,
                                     struct rn_error *err) {
    struct rn_doctor_record record;
    rn_message_init(&rn_doctor_table, &record);
    record.cases = calloc((size_t)result->case_count + 1, sizeof *record.cases);
    if (!record.cases) return rn_error_set(err, RN_ERROR_NO_MEMORY, "doctor", "out of memory");
    record.case_count = (size_t)result->case_count;
    record.passed = result->passed;
    record.seed = (int64_t)result->seed;
    snprintf(record.kernels, sizeof record.kernels, "%s", result->kernels);
    for (int i = 0; i < result->case_count; i++) {
        const struct rn_doctor_case *from = &result->cases[i];
        struct rn_doctor_case_record *to = &record.cases[i];
        *to = (struct rn_doctor_case_record){.worst = from->skipped ? NAN : from->worst,
                                             .bound = from->bound,
                                             .passed = from->passed,
                                             .skipped = from->skipped};
        snprintf(to->name, sizeof to->name, "%s", from->name);
        snprintf(to->kernels, sizeof to->kernels, "%s", from->kernels);
        snprintf(to->unit, sizeof to->unit, "%s", from->unit);
        snprintf(to->where, sizeof to->where, "%s", from->where);
    }
    enum rn_status status = rn_encode(&rn_doctor_table, &record, ret_json, NULL, err);
    rn_message_finish(&rn_doctor_table, &record);
    return status;
}

static enum rn_status examine(const struct rn_runner_doctor *options,
                              struct rn_doctor_result *result, struct rn_error *err) {
    static struct rn_incident incident;
    struct rn_doctor_options own = {.seed = options->seed, .checkpoint = options->checkpoint};
    struct rn_camera *cameras = NULL;
    enum rn_status status = RN_OK;
    if (options->cameras) status = read_cameras(options->cameras, &cameras, &own.camera_count, err);
    if (!status && options->replay) {
        status = rn_incident_read(options->replay, &incident, err);
        own.incident = &incident;
    }
    own.cameras = cameras;
    if (!status) status = rn_doctor_run(&own, say, result, err);
    free(cameras);
    return status;
}

int rn_runner_doctor(const struct rn_runner_doctor *options) {
    static struct rn_doctor_result result;
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status = examine(options, &result, &err);
    if (!status) status = rn_doctor_result_json(&result, &json, &err);
    if (status) {
        fprintf(stderr, "ripnerf-runner: %s: %s\n", err.where, err.text);
        return status == RN_ERROR_INVALID ? 4 : status == RN_ERROR_NOT_FOUND ? 3 : 1; // as ripnerf
    }
    bool written = puts(json) >= 0 && fflush(stdout) == 0;
    free(json);
    return written && result.passed ? 0 : 1;
}
