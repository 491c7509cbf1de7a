// What went wrong, for whoever wants to know why: the offending rays of a step, and the parameters
// that were not finite.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

#define PACKET RN_PACKET_RAYS // rays tried together

enum rn_ray_fault rn_try_rays(const struct rn_kernels *kernels, const struct rn_cpu_field *field,
                              const struct rn_march_options *options,
                              const struct rn_march_ray *rays, int first, int n,
                              struct rn_workspace *workspace, const struct rn_group *scratch,
                              struct rn_group *ret_group) {
    struct rn_group group = {.slab = scratch->slab,
                             .cursor = first,
                             .end = first + n,
                             .base_grad = scratch->base_grad,
                             .head_grad = scratch->head_grad};
    size_t count = field->base_shape.count + field->head_shape.count;
    double check = 0;
    struct rn_march_options alone = *options;
    alone.split = false; // each ray is a pixel: any number of them can be tried
    memset(group.base_grad, 0, count * sizeof(float)); // the head's follow
    while (group.cursor < group.end) {
        group.slab.count = 0;
        kernels->train(field, &alone, rays, workspace, &group);
    }
    for (size_t i = 0; i < count; i++)
        check += (double)group.base_grad[i] * 0;
    if (ret_group) *ret_group = group;
    if (group.nonfinite_rays > 0) return RN_FAULT_COLOUR;
    return check == 0 && isfinite(group.loss) ? RN_FAULT_NONE : RN_FAULT_GRADIENT;
}

static void list_ray(struct rn_trainer *t, struct rn_incident *incident, uint32_t id,
                     enum rn_ray_fault fault) {
    if (incident->ray_count == RN_INCIDENT_KEPT || id >= (uint32_t)t->step.ray_count) return;
    const struct rn_march_ray *ray = &t->step.rays[id];
    struct rn_incident_ray *out = &incident->rays[incident->ray_count];
    const struct rn_pixel_frame *frame = rn_trainer_place(t, (int)id, &out->x, &out->y);
    if (!frame) return;
    incident->ray_count++;
    out->id = id;
    out->fault = fault;
    out->split = frame->frame->split;
    out->index = frame->frame->index;
    out->scale = frame->frame->scale;
    memcpy(out->origin, ray->origin, sizeof out->origin);
    memcpy(out->direction, ray->direction, sizeof out->direction);
    memcpy(out->target, ray->target, sizeof out->target);
    out->near = ray->near;
    out->length = ray->length;
    out->radius = ray->radius;
    out->weight = ray->weight;
    out->stride = ray->stride;
}

static void list_offenders(struct rn_trainer *t, struct rn_incident *incident,
                           const struct rn_group *group) {
    for (uint64_t i = 0; i < group->nonfinite_rays && i < RN_OFFENDERS; i++)
        list_ray(t, incident, group->offender[i], RN_FAULT_COLOUR);
}

// Rays that are at fault by themselves, with the parameters as they are now: packet by packet, ray
// by ray where a packet is wrong.
static enum rn_ray_fault try_step_rays(struct rn_trainer *t, int first, int n,
                                       struct rn_group *ret_group) {
    return rn_try_rays(t->engine->kernels, &t->field->cpu, &t->step.march, t->step.rays, first, n,
                       rn_engine_workspace(t->engine, 0), &t->step.groups[0], ret_group);
}

static void search(struct rn_trainer *t, struct rn_incident *incident) {
    struct rn_group group;
    for (int first = 0; first < t->step.ray_count && incident->ray_count < RN_INCIDENT_KEPT;
         first += PACKET) {
        int n = t->step.ray_count - first < PACKET ? t->step.ray_count - first : PACKET;
        enum rn_ray_fault fault = try_step_rays(t, first, n, &group);
        incident->nonfinite_rays += group.nonfinite_rays;
        for (int r = first; r < first + n && fault != RN_FAULT_NONE; r++) {
            enum rn_ray_fault own = try_step_rays(t, r, 1, NULL);
            if (own != RN_FAULT_NONE) list_ray(t, incident, (uint32_t)r, own);
        }
    }
}

static void list_parameters(const struct rn_trainer *t, struct rn_incident *incident) {
    const struct rn_parameters *p = &t->field->parameters;
    for (size_t i = 0; i < p->count; i++) {
        if (isfinite(p->values[i])) continue;
        if (incident->nonfinite_parameters++ >= RN_INCIDENT_KEPT) continue;
        incident->parameters[incident->parameter_count++] =
            (struct rn_incident_parameter){i, p->values[i]};
    }
}

// The step's own finds; else what a search finds; else a few of its rays, evenly spaced.
static void list_rays(struct rn_trainer *t, struct rn_incident *incident) {
    for (int g = 0; g < RN_GROUPS; g++) {
        incident->nonfinite_rays += t->step.groups[g].nonfinite_rays;
        list_offenders(t, incident, &t->step.groups[g]);
    }
    if (incident->ray_count == 0) search(t, incident);
    bool sound = incident->ray_count == 0;
    for (int i = 0; sound && i < RN_INCIDENT_KEPT; i++)
        list_ray(t, incident, (uint32_t)((int64_t)t->step.ray_count * i / RN_INCIDENT_KEPT),
                 RN_FAULT_NONE);
}

void rn_trainer_note(struct rn_trainer *t, enum rn_incident_kind kind) {
    if (t->ranks.exchange && t->ranks.exchange->rank > 0) return; // rank 0 does
    if (!t->incidents.held)
        t->incidents.held = calloc(RN_INCIDENTS_HELD, sizeof *t->incidents.held);
    if (!t->incidents.held || t->incidents.count == RN_INCIDENTS_HELD ||
        t->incidents.noted == RN_INCIDENTS_MOST)
        return;
    t->incidents.noted++;
    if (t->ranks.exchange) rn_trainer_draw(t, 0, t->step.ray_count); // the other ranks' rays too
    int at = (t->incidents.first + t->incidents.count++) % RN_INCIDENTS_HELD;
    struct rn_incident *incident = &t->incidents.held[at];
    *incident = (struct rn_incident){.kind = kind,
                                     .step = (int64_t)t->step.march.counter,
                                     .seed = t->field->config.seed,
                                     .rate = rn_schedule_rate(&t->field->config, &t->progress),
                                     .march_step = t->step.march.step};
    memcpy(incident->background, t->step.march.colour.background, sizeof incident->background);
    if (kind == RN_INCIDENT_ROLLBACK) list_parameters(t, incident);
    list_rays(t, incident);
}

bool rn_trainer_take_incident(struct rn_trainer *t, struct rn_incident *ret_incident) {
    if (t->incidents.count == 0) return false;
    *ret_incident = t->incidents.held[t->incidents.first];
    t->incidents.first = (t->incidents.first + 1) % RN_INCIDENTS_HELD;
    t->incidents.count--;
    return true;
}
