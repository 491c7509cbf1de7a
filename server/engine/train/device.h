// Training on a device: the host keeps the schedule and the counters, the device does the steps.
#ifndef RN_ENGINE_TRAIN_DEVICE_H
#define RN_ENGINE_TRAIN_DEVICE_H

#include "server/engine/kernels/backend.h"
#include "server/engine/scene/pixels.h"

struct rn_trainer;

// What only a device's training has (cuda/README.md), as last read.
struct rn_device_state {
    float gradient_scale;              // 0 at the start
    int good_steps;                    // since it was last changed
    float gradient_size;               // for the roulette (kernels/backend.h)
    struct rn_device_progress counted; // its counters
};

// The field and what training needs to the engine's device, in place of what is there; nothing
// where there is no device, or one that may be done without cannot train this field. The levels
// and counts of the field's copy start anew.
enum rn_status rn_trainer_put(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// What is trained from there: parameters, moments, what cells showed, errors of blocks.
enum rn_status rn_trainer_fetch(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// How many of the held-out frames from `first` on go there in one call, all their pixels: 0 when
// already the first one's are too many.
int rn_trainer_validate_together(const struct rn_trainer *trainer, int first);
// Adds the squared errors of `rows` rows of `count` held-out frames, one number a frame, rendered
// there in one call. More than one are whole and go together.
enum rn_status rn_trainer_validate_rows(struct rn_trainer *trainer, int first, int count, int row,
                                        int rows, double *ret_squares,
                                        struct rn_error *err) RN_MUST_CHECK;
// A few steps there. As on the CPU, training goes back to its last good parameters, here those of
// the last save or growth, when no step could be taken 40 times in a row; a rejected step by itself
// is how the gradients' scale is found, and told as no incident.
enum rn_status rn_trainer_run_device(struct rn_trainer *trainer,
                                     struct rn_error *err) RN_MUST_CHECK;
// One step there, timed; of a field that is there and has nothing to decide on the host.
enum rn_status rn_trainer_time_device(struct rn_trainer *trainer,
                                      struct rn_device_stage ret_stages[RN_DEVICE_STAGES],
                                      int *ret_count, struct rn_error *err) RN_MUST_CHECK;

#endif
