// The photographs of a training: loaded as its effects want them, and where their cameras are.
#ifndef RN_ENGINE_TRAIN_PHOTOGRAPHS_H
#define RN_ENGINE_TRAIN_PHOTOGRAPHS_H

#include "server/engine/effects/effects.h"

struct rn_trainer;

// Times that photographs are made smaller.
int rn_train_reduced(const struct rn_train_config *config);
// Those to train on and those held out; `records` are of the effects, as far as they are known.
// RN_ERROR_LIMIT beyond `limit` bytes (0: no limit), else as rn_pixels_load.
enum rn_status rn_trainer_load_photographs(struct rn_trainer *trainer,
                                           const struct rn_effect_record *records, size_t limit,
                                           struct rn_error *err) RN_MUST_CHECK;
// Where the photographs' cameras are, after they have moved.
void rn_trainer_place_cameras(struct rn_trainer *trainer);
// Which effects the photographs call for, and what these make of them.
void rn_trainer_detect_effects(struct rn_trainer *trainer);

#endif
