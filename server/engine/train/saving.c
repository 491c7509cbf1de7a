#include "server/engine/train/saving.h"

#include "server/engine/scene/device.h"
#include "server/engine/train/trainer.h"

struct rn_arrays rn_trainer_arrays(struct rn_trainer *t) {
    return (struct rn_arrays){.field = t->field,
                              .m = t->optimiser.m,
                              .v = t->optimiser.v,
                              .seen = t->hull.seen,
                              .block_count = t->sampler.importance.count,
                              .block_error = t->sampler.importance.error,
                              .block_share = t->sampler.importance.share,
                              .pose_count = t->poses.moves ? (size_t)t->train.frame_count : 0,
                              .poses = t->poses.moves ? t->poses.moves[0] : NULL,
                              .outlier_count = t->outliers.out ? t->outliers.count : 0,
                              .outliers = t->outliers.out};
}

static struct rn_counters counters_of(const struct rn_trainer *t) {
    return (struct rn_counters){.progress = t->progress,
                                .updates = t->optimiser.updates,
                                .next_rays = t->next_rays,
                                .gradient_scale = t->device.gradient_scale,
                                .good_steps = t->device.good_steps,
                                .gradient_size = t->device.gradient_size,
                                .pose_turns = t->poses.turns,
                                .outlier_turns = t->outliers.turns};
}

void rn_trainer_take_counters(struct rn_trainer *t, const struct rn_counters *from) {
    t->progress = from->progress;
    t->optimiser.updates = from->updates;
    t->next_rays = from->next_rays;
    t->device.gradient_scale = from->gradient_scale;
    t->device.good_steps = from->good_steps;
    t->device.gradient_size = from->gradient_size;
    t->poses.turns = from->pose_turns;
    t->outliers.turns = from->outlier_turns;
}

enum rn_status rn_trainer_save_begin(struct rn_trainer *t, enum rn_save_part part, const char *path,
                                     bool *ret_begun, struct rn_error *err) {
    bool complete = false;
    *ret_begun = false;
    enum rn_status status = rn_trainer_enter(t, err);
    if (status == RN_OK) status = rn_trainer_complete_step(t, &complete, err);
    if (status != RN_OK || !complete) return status;
    uint64_t rollbacks = t->progress.rollbacks;
    rn_ranks_begin_save(t);
    while (!rn_trainer_guard_save(t))
        if (!t->ranks.exchange) return RN_OK;
    if (status == RN_OK && t->field->on_device)
        status = t->progress.rollbacks > rollbacks ? rn_trainer_put(t, err)
                                                   : rn_trainer_keep_good(t, err);
    struct rn_arrays arrays =
        part == RN_SAVE_ALL ? rn_trainer_arrays(t) : (struct rn_arrays){.field = t->field};
    struct rn_counters counters = counters_of(t);
    if (status == RN_OK) status = rn_checkpoint_begin(&arrays, &counters, path, &t->writer, err);
    *ret_begun = status == RN_OK;
    return status;
}

enum rn_save_stage rn_trainer_save_stage(const struct rn_trainer *t) {
    return rn_checkpoint_stage(t->writer);
}

enum rn_status rn_trainer_save_end(struct rn_trainer *t, char ret_sha256[65],
                                   struct rn_error *err) {
    return rn_checkpoint_end(&t->writer, ret_sha256, err);
}

enum rn_status rn_trainer_save(struct rn_trainer *t, const char *path, struct rn_error *err) {
    bool begun = false;
    char sha256[65];
    while (!begun) {
        enum rn_status status = rn_trainer_save_begin(t, RN_SAVE_ALL, path, &begun, err);
        if (status != RN_OK) return status;
    }
    return rn_trainer_save_end(t, sha256, err);
}
