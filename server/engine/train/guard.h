// After every step the parameters are finite. When they are not, or when 16 steps in a row were
// rejected, training returns to the last good parameters (at most 64 updates old) with a fresh
// optimiser at half the rate. After RN_MAX_ROLLBACKS such returns it fails: RN_ERROR_NUMERIC.
#ifndef RN_ENGINE_TRAIN_GUARD_H
#define RN_ENGINE_TRAIN_GUARD_H

#include <stdbool.h>
#include <stdint.h>

#include "common/base/status.h"

#define RN_MAX_ROLLBACKS 3 // one more ends the training

struct rn_trainer;

// Where looking at all numbers, or copying them, was cut short. Owner: whoever has the trainer.
struct rn_guard {
    enum { RN_GUARD_LOOKS, RN_GUARD_SCANS, RN_GUARD_COPIES } stage;
    bool copies;   // once they were found good
    int next;      // chunk
    bool found;    // one that is not finite
    int64_t saved; // the step whose numbers are looked at before they are saved
};

enum rn_status rn_trainer_keep_good(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
bool rn_trainer_all_finite(const struct rn_trainer *trainer); // parameters and moments
void rn_trainer_roll_back(struct rn_trainer *trainer);
// After a step's update, and before its numbers are saved, the optimiser's too. false: cut short,
// as the thread was preempted; call again, before anything else is trained.
bool rn_trainer_guard_step(struct rn_trainer *trainer, bool accepted);
bool rn_trainer_guard_save(struct rn_trainer *trainer);
enum rn_status rn_trainer_guard_check(const struct rn_trainer *trainer,
                                      struct rn_error *err) RN_MUST_CHECK;

#endif
