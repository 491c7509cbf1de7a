// One training step: waves of forward and backward over the groups of its rays, then the update.
// What is cut short for a render goes on at each group's next packet, or at the next band.
#ifndef RN_ENGINE_TRAIN_STEP_H
#define RN_ENGINE_TRAIN_STEP_H

#include "server/engine/kernels/kernels.h"

struct rn_trainer;

// The step under way, or the one done last. Owner: whoever has the trainer.
struct rn_step {
    bool under_way;
    enum { RN_STEP_WAVES, RN_STEP_UPDATE, RN_STEP_GUARD } stage;
    bool accepted;  // once it was updated
    int next_chunk; // of the occupancy's cells, before the step
    int next_band;
    int ray_count;
    uint64_t first_ray; // rays of all steps before
    struct rn_march_ray *rays;
    struct rn_march_options march;
    struct rn_group groups[RN_GROUPS];
    float *group_memory;
};

// The memory of steps and of the optimiser, `grad` too unless it is there. RN_ERROR_NO_MEMORY.
enum rn_status rn_trainer_allocate(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_free_step(struct rn_trainer *trainer);  // that, but grad
void rn_trainer_take_march(struct rn_trainer *trainer); // for the step that begins
void rn_trainer_begin_step(struct rn_trainer *trainer);
int rn_step_first_ray(const struct rn_trainer *trainer, int group); // of the step under way
// Puts the rays of the step that was done last in place, for an incident's record.
void rn_trainer_redraw(struct rn_trainer *trainer);
void rn_trainer_run_wave(struct rn_trainer *trainer); // clears under_way when the step is complete

// One group's slab and gradients in a block of rn_group_numbers; the next free place is returned.
size_t rn_group_numbers(const struct rn_cpu_field *field, int capacity);
float *rn_group_lay_out(const struct rn_cpu_field *field, int capacity, float *memory,
                        struct rn_group *ret_group);

#endif
