// What went wrong in a step, and the rays that did it.
#ifndef RN_ENGINE_TRAIN_INCIDENT_H
#define RN_ENGINE_TRAIN_INCIDENT_H

#include "server/engine/kernels/kernels.h"
#include "server/engine/train/train.h"

#define RN_INCIDENTS_HELD 8 // between two takes

// Owner: whoever has the trainer; `held` is freed.
struct rn_incidents {
    struct rn_incident *held; // RN_INCIDENTS_HELD, made with the first one
    int first, count, noted;
};

// Forward and backward of rays [first, first + n) in a scratch group, of which only the memory is
// used; whether anything was not finite. *ret_group (may be NULL) has its counts.
enum rn_ray_fault rn_try_rays(const struct rn_kernels *kernels, const struct rn_cpu_field *field,
                              const struct rn_march_options *options,
                              const struct rn_march_ray *rays, int first, int n,
                              struct rn_workspace *workspace, const struct rn_group *scratch,
                              struct rn_group *ret_group);
// Records what went wrong in the step whose rays are in place, before anything is put
// right. Without memory for it nothing is recorded.
void rn_trainer_note(struct rn_trainer *trainer, enum rn_incident_kind kind);

#endif
