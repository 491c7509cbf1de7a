// An incident's rays again, forward and backward, on every kernel set: with the scene's parameters
// as they are, and with the recorded non-finite ones in their places.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/doctor/cases.h"
#include "server/engine/train/trainer.h"

struct replay {
    const struct rn_incident *incident;
    struct rn_engine *engine;
    struct rn_field *field;
    struct rn_march_options march;
    struct rn_group scratch;
    struct rn_march_ray rays[RN_INCIDENT_KEPT];
};

static void set_rays(struct replay *replay) {
    for (int i = 0; i < replay->incident->ray_count; i++) {
        const struct rn_incident_ray *from = &replay->incident->rays[i];
        struct rn_march_ray *ray = &replay->rays[i];
        *ray = (struct rn_march_ray){.near = from->near,
                                     .length = from->length,
                                     .radius = from->radius,
                                     .weight = from->weight,
                                     .stride = from->stride,
                                     .id = from->id};
        memcpy(ray->origin, from->origin, sizeof ray->origin);
        memcpy(ray->direction, from->direction, sizeof ray->direction);
        memcpy(ray->target, from->target, sizeof ray->target);
    }
}

// Rays that are not as expected: sound, or wild where they were recorded as wild.
static int count_wrong(struct replay *replay, bool wild) {
    int wrong = 0;
    rn_field_refresh(replay->field, replay->engine);
    for (int i = 0; i < replay->incident->ray_count; i++) {
        enum rn_ray_fault fault =
            rn_try_rays(replay->engine->kernels, &replay->field->cpu, &replay->march, replay->rays,
                        i, 1, rn_engine_workspace(replay->engine, 0), &replay->scratch, NULL);
        bool expected = wild && replay->incident->rays[i].fault != RN_FAULT_NONE;
        wrong += (fault != RN_FAULT_NONE) != expected;
    }
    return wrong;
}

// Puts the recorded parameters in; called again, takes them out. An index beyond the field's is
// not this scene's.
static bool swap_parameters(struct replay *replay, float saved[RN_INCIDENT_KEPT]) {
    const struct rn_parameters *p = &replay->field->parameters;
    for (int i = 0; i < replay->incident->parameter_count; i++) {
        uint64_t at = replay->incident->parameters[i].index;
        if (at >= p->count) return false;
        float now = p->values[at];
        p->values[at] = saved[i];
        saved[i] = now;
    }
    return true;
}

static enum rn_status check_set(struct replay *replay, const struct rn_kernels *kernels,
                                struct rn_doctor_result *result, struct rn_error *err) {
    const struct rn_incident *incident = replay->incident;
    float saved[RN_INCIDENT_KEPT];
    replay->engine->kernels = kernels;
    struct rn_doctor_case *c = rn_doctor_open(result, "replayed rays, the parameters as they are",
                                              kernels->name, 0, "non-finite rays");
    rn_doctor_see(c, count_wrong(replay, false), "%d rays of step %lld", incident->ray_count,
                  (long long)incident->step);
    rn_doctor_close(result, c);
    if (incident->parameter_count == 0) return RN_OK;
    for (int i = 0; i < incident->parameter_count; i++)
        saved[i] = incident->parameters[i].value;
    if (!swap_parameters(replay, saved))
        return rn_error_set(err, RN_ERROR_INVALID, "#/parameters",
                            "the incident is of a scene with more parameters");
    c = rn_doctor_open(result, "replayed rays that do not repeat the incident", kernels->name, NAN,
                       "rays");
    rn_doctor_see(c, count_wrong(replay, true), "%d of %llu recorded parameters put back",
                  incident->parameter_count, (unsigned long long)incident->nonfinite_parameters);
    rn_doctor_close(result, c);
    swap_parameters(replay, saved);
    return RN_OK;
}

enum rn_status rn_doctor_replay(const struct rn_incident *incident, struct rn_engine *engine,
                                struct rn_field *field, struct rn_doctor_result *result,
                                struct rn_error *err) {
    struct replay replay = {.incident = incident, .engine = engine, .field = field};
    const struct rn_kernels *kernels;
    replay.march = rn_effects_march_trained(field);
    replay.march.step = incident->march_step;
    replay.march.seed = incident->seed;
    replay.march.counter = (uint64_t)incident->step;
    memcpy(replay.march.colour.background, incident->background, sizeof incident->background);
    set_rays(&replay);
    enum rn_status status = rn_field_need_levels(field, field->config.field.levels, err);
    if (status == RN_OK) status = rn_engine_prepare(engine, field, err);
    if (status != RN_OK) return status;
    int capacity = 2 * rn_engine_workspace(engine, 0)->capacity;
    float *memory = calloc(rn_group_numbers(&field->cpu, capacity), sizeof *memory);
    if (!memory) return rn_error_set(err, RN_ERROR_NO_MEMORY, "replay", "out of memory");
    rn_group_lay_out(&field->cpu, capacity, memory, &replay.scratch);
    for (int i = 0; status == RN_OK && (kernels = rn_kernels_available(i)); i++)
        status = check_set(&replay, kernels, result, err);
    free(memory);
    return status;
}
