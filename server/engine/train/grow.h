// Planes that grow while they train.
#ifndef RN_ENGINE_TRAIN_GROW_H
#define RN_ENGINE_TRAIN_GROW_H

#include "common/base/status.h"

struct rn_trainer;

// Whether the planes should be larger by now.
bool rn_trainer_grows(const struct rn_trainer *trainer);
// Makes the planes as large as they should be by now, or a part of it where the thread is
// preempted: then `growth` is there, no step may be taken, and it is to be called again.
// RN_ERROR_NO_MEMORY.
enum rn_status rn_trainer_grow(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_drop_growth(struct rn_trainer *trainer); // the one under way

#endif
