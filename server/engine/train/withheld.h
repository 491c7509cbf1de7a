// Which photographs are trained on and which tell the progress.
//
// Validation views tell it, or test views where there are none: those are never trained on. Where
// there are neither, one of eight training views is withheld, but not to the end: after a share of
// the schedule (setting give_back) these are trained on too, and the last figure is of before. A
// user who drops a folder has all of its photographs in the scene so, and an honest figure of the
// way there.
#ifndef RN_ENGINE_TRAIN_WITHHELD_H
#define RN_ENGINE_TRAIN_WITHHELD_H

#include <stdbool.h>

#include "common/base/status.h"
#include "common/dataset/dataset.h"
#include "common/settings/train.h"

struct rn_trainer;

// The photographs to train on at some time, or those that tell the progress.
struct rn_selection {
    const struct rn_dataset *dataset;
    const struct rn_train_config *config;
    bool held;
};
bool rn_selection_wants(void *selection, const struct rn_frame *frame);

// After photographs are loaded: how many are withheld, and the sentence of rn_trainer_held_out.
void rn_trainer_note_withheld(struct rn_trainer *trainer);
// Whether any photographs are withheld so far that are to be trained on later; whether a
// photograph is one of these.
bool rn_trainer_withholds_any(const struct rn_trainer *trainer);
bool rn_trainer_withholds(const struct rn_trainer *trainer, const struct rn_frame *frame);
// Between steps: whether they are to be given back now, and doing so. RN_ERROR_NO_MEMORY.
bool rn_trainer_gives_back(const struct rn_trainer *trainer);
enum rn_status rn_trainer_give_back(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;

#endif
