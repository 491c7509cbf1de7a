// A training session: the field that is trained, the photographs, and the state of each part of
// training, whose functions stand in the part's own header.
#ifndef RN_ENGINE_TRAIN_TRAINER_H
#define RN_ENGINE_TRAIN_TRAINER_H

#include "server/engine/effects/effects.h"
#include "server/engine/scene/pixels.h"
#include "server/engine/scene/scene.h"
#include "server/engine/train/device.h"
#include "server/engine/train/guard.h"
#include "server/engine/train/hull.h"
#include "server/engine/train/incident.h"
#include "server/engine/train/optimiser.h"
#include "server/engine/train/outliers.h"
#include "server/engine/train/poses.h"
#include "server/engine/train/ranks.h"
#include "server/engine/train/sampler.h"
#include "server/engine/train/step.h"
#include "server/engine/train/train.h"
#include "server/engine/train/validate.h"

struct rn_trainer {
    struct rn_engine *engine;
    const struct rn_dataset *dataset;
    struct rn_field *field;
    struct rn_pixels train, held; // photographs that are given back later are in both
    int withheld;                 // of those to train on, by what is told of the progress
    bool figure_offered;          // the last one, before these are given back
    char held_out[224];
    struct rn_progress progress;
    struct { // since the rates were last told
        double seconds;
        uint64_t rays, samples;
    } window;
    int next_rays; // of the next step

    struct rn_step step;
    struct rn_sampler sampler;
    struct rn_optimiser optimiser;
    struct rn_guard guard;
    struct rn_hull hull;
    struct rn_poses poses;
    struct rn_outliers outliers;
    struct rn_growth *growth; // NULL when the planes are not growing (grow.h)
    struct rn_device_state device;
    struct rn_ranks ranks;
    struct rn_incidents incidents;
    struct rn_validation validation;
    struct rn_checkpoint_writer *writer; // NULL when none is being written
};

// What effects look at before the step that marches so.
struct rn_evidence rn_trainer_evidence(const struct rn_trainer *trainer,
                                       const struct rn_march_options *march);
// Everything that follows from the pixels and the configuration.
enum rn_status rn_trainer_set_up(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// Before training goes on here, or the host reads what is trained: everything is as new as the
// device's and built for the training's cameras.
enum rn_status rn_trainer_enter(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// Completes the step that the ranks are agreed on: what they all must know of the same step is not
// changed within it.
enum rn_status rn_trainer_agree(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// Completes the step under way; *ret_complete is false where the thread was preempted before.
enum rn_status rn_trainer_complete_step(struct rn_trainer *trainer, bool *ret_complete,
                                        struct rn_error *err) RN_MUST_CHECK;
// Lets the other ranks go, after the step that they are agreed on.
void rn_trainer_end_ranks(struct rn_trainer *trainer);
// Whether the host has something to decide before the next step: view dependence, growth.
bool rn_trainer_turn_due(const struct rn_trainer *trainer);

#endif
