// What a checkpoint holds of a training, and writing it (train.h).
#ifndef RN_ENGINE_TRAIN_SAVING_H
#define RN_ENGINE_TRAIN_SAVING_H

#include "server/engine/checkpoint/checkpoint.h"

struct rn_trainer;

// Borrowed from the trainer, until the next step.
struct rn_arrays rn_trainer_arrays(struct rn_trainer *trainer);
void rn_trainer_take_counters(struct rn_trainer *trainer, const struct rn_counters *counters);

#endif
