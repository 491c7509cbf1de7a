// A training made, anew or from a checkpoint, finished, and destroyed.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/engine/checkpoint/checkpoint.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/train/grow.h"
#include "server/engine/train/memory.h"
#include "server/engine/train/photographs.h"
#include "server/engine/train/saving.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

static enum rn_status start(struct rn_engine *engine, const struct rn_dataset *dataset,
                            const struct rn_train_config *config, const struct rn_bounds *bounds,
                            struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_trainer *t = calloc(1, sizeof *t);
    if (!t) return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    t->engine = engine;
    t->dataset = dataset;
    t->ranks.exchange = engine->exchange;
    t->next_rays = config->initial_rays;
    t->progress.psnr = t->progress.eta_seconds = t->progress.fraction = NAN;
    enum rn_status status = rn_field_create(config, bounds, &t->field, err);
    if (status != RN_OK) {
        rn_trainer_destroy(&t);
        return status;
    }
    snprintf(t->field->kernels, sizeof t->field->kernels, "%s", engine->kernels->name);
    *ret_trainer = t;
    return RN_OK;
}

// After the effects: views and hull of the space that they found.
static enum rn_status take_space(struct rn_trainer *t) {
    if (!t->field->cpu.disparity.on) return RN_OK;
    rn_trainer_place_cameras(t);
    return rn_field_fill(t->field);
}

// A trainer before it has loaded anything, and what effects are known of by the dataset alone.
static enum rn_status plan(struct rn_engine *engine, const struct rn_dataset *dataset,
                           struct rn_train_config *config,
                           struct rn_effect_record ret_prepared[RN_EFFECT_COUNT],
                           struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_bounds bounds =
        rn_effects_prepare(dataset, engine->backend != NULL, config, ret_prepared);
    enum rn_status status = rn_train_config_check(config, err);
    if (status == RN_OK) status = start(engine, dataset, config, &bounds, ret_trainer, err);
    return status;
}

enum rn_status rn_train_need(struct rn_engine *engine, const struct rn_dataset *dataset,
                             const struct rn_train_config *config, size_t *ret_bytes,
                             struct rn_error *err) {
    struct rn_trainer *t = NULL;
    struct rn_train_config own = *config;
    struct rn_effect_record prepared[RN_EFFECT_COUNT];
    enum rn_status status = plan(engine, dataset, &own, prepared, &t, err);
    if (status == RN_OK) *ret_bytes = rn_trainer_bytes(t);
    rn_trainer_destroy(&t);
    return status;
}

int rn_train_scale(const struct rn_dataset *dataset, const struct rn_train_config *config) {
    return rn_effect_scale(dataset, config);
}

enum rn_status rn_trainer_set_up(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = rn_field_need_levels(t->field, rn_trainer_levels(t), err);
    if (status == RN_OK) status = rn_engine_prepare(t->engine, t->field, err);
    if (status == RN_OK) status = rn_trainer_allocate(t, err);
    if (status == RN_OK) status = rn_trainer_watch_cells(t, err);
    if (status == RN_OK) status = rn_trainer_allocate_poses(t, err);
    if (status == RN_OK) status = rn_trainer_allocate_outliers(t, err);
    return status;
}

// All is as a step wants it; `begin` (ns) is when its loading began.
static enum rn_status make_ready(struct rn_trainer *t, int64_t begin, struct rn_error *err) {
    enum rn_status status = rn_trainer_keep_good(t, err);
    if (status != RN_OK) return status;
    rn_field_refresh(t->field, t->engine);
    rn_field_refresh_occupancy(t->field);
    status = rn_trainer_put(t, err);
    t->progress.load_seconds = (double)(rn_clock_ns() - begin) * 1e-9;
    t->ranks.follows = status == RN_OK;
    return status;
}

enum rn_status rn_trainer_create(struct rn_engine *engine, const struct rn_dataset *dataset,
                                 const struct rn_train_config *config, size_t memory_limit_bytes,
                                 struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_trainer *t = NULL;
    struct rn_train_config own = *config;
    size_t left;
    struct rn_effect_record prepared[RN_EFFECT_COUNT];
    int64_t begin = rn_clock_ns();
    enum rn_status status = plan(engine, dataset, &own, prepared, &t, err);
    if (status == RN_OK) status = rn_trainer_check_memory(t, memory_limit_bytes, &left, err);
    if (status == RN_OK) status = rn_trainer_load_photographs(t, prepared, left, err);
    if (status != RN_OK) goto fail;
    memcpy(t->field->effects, prepared, sizeof prepared);
    rn_trainer_detect_effects(t);
    status = take_space(t);
    if (status != RN_OK) goto fail;
    rn_field_randomise(t->field, own.seed);
    status = rn_trainer_set_up(t, err);
    if (status != RN_OK) goto fail;
    if (own.field.space == RN_SPACE_UNBOUNDED) rn_trainer_carve_unseen(t);
    if (rn_is_place(&t->field->cpu)) {
        rn_trainer_carve_sighted(t);
    } else if (t->field->config.carve) {
        rn_trainer_carve(t);
    }
    status = rn_trainer_count_hull(t, err);
    if (status == RN_OK) status = rn_trainer_list_live(t, err);
    if (status == RN_OK) status = make_ready(t, begin, err);
    if (status != RN_OK) goto fail;
    *ret_trainer = t;
    return RN_OK;
fail:
    status = rn_trainer_lacks_memory(t, status, err);
    rn_trainer_destroy(&t);
    return status;
}

// What the checkpoint holds besides the field's configuration and effects.
static enum rn_status take_state(struct rn_trainer *t, struct rn_checkpoint *checkpoint,
                                 struct rn_error *err) {
    struct rn_arrays arrays = rn_trainer_arrays(t);
    enum rn_status status = rn_checkpoint_read_arrays(checkpoint, &arrays, err);
    if (status != RN_OK) return status;
    rn_trainer_take_counters(t, &checkpoint->counters);
    rn_trainer_note_withheld(t); // what was given back
    status = rn_trainer_count_hull(t, err);
    if (status == RN_OK) status = rn_trainer_list_live(t, err);
    if (status != RN_OK) return status;
    rn_trainer_place_cameras(t); // those that were moved
    arrays = rn_trainer_arrays(t);
    status = rn_checkpoint_read_blocks(checkpoint, &arrays, err);
    if (status == RN_OK) rn_trainer_share_out(t, false);
    return status;
}

enum rn_status rn_trainer_restore(struct rn_engine *engine, const struct rn_dataset *dataset,
                                  const char *checkpoint_path, size_t memory_limit_bytes,
                                  struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_trainer *t = NULL;
    struct rn_checkpoint checkpoint;
    size_t left;
    int64_t begin = rn_clock_ns();
    enum rn_status status = rn_checkpoint_open(checkpoint_path, &checkpoint, err);
    if (status != RN_OK) return status;
    const struct rn_kernels *kernels = rn_device_trained(checkpoint.kernels)
                                           ? engine->kernels
                                           : rn_kernels_find(checkpoint.kernels);
    if (!kernels) {
        status = rn_error_set(err, RN_ERROR_UNSUPPORTED, checkpoint_path,
                              "was trained with the kernel set '%s', which this machine lacks; "
                              "train a new scene",
                              checkpoint.kernels);
        goto fail;
    }
    engine->kernels = kernels;
    status = start(engine, dataset, &checkpoint.config, &checkpoint.bounds, &t, err);
    if (status == RN_OK) {
        t->field->cpu.disparity = checkpoint.disparity;
        memcpy(t->field->effects, checkpoint.effects, sizeof checkpoint.effects);
        status = rn_trainer_check_memory(t, memory_limit_bytes, &left, err);
    }
    if (status == RN_OK) status = rn_trainer_load_photographs(t, t->field->effects, left, err);
    if (status == RN_OK) status = rn_trainer_set_up(t, err);
    if (status == RN_OK) status = take_state(t, &checkpoint, err);
    if (status == RN_OK) status = make_ready(t, begin, err);
    if (status != RN_OK) goto fail;
    rn_checkpoint_close(&checkpoint);
    *ret_trainer = t;
    return RN_OK;
fail:
    rn_checkpoint_close(&checkpoint);
    status = rn_trainer_lacks_memory(t, status, err);
    rn_trainer_destroy(&t);
    return status;
}

void rn_trainer_destroy(struct rn_trainer **trainer) {
    struct rn_trainer *t = *trainer;
    char sha256[65];
    if (!t) return;
    if (t->writer) (void)rn_checkpoint_end(&t->writer, sha256, NULL);
    rn_trainer_end_ranks(t);
    rn_field_destroy(&t->field);
    rn_pixels_finish(&t->train);
    rn_pixels_finish(&t->held);
    rn_trainer_free_step(t);
    rn_block_destroy(t->optimiser.grad);
    rn_trainer_drop_growth(t);
    rn_ranks_free(t);
    free(t->hull.before);
    rn_block_destroy(t->hull.seen);
    rn_sampler_finish(&t->sampler);
    rn_poses_finish(&t->poses);
    rn_outliers_finish(&t->outliers);
    free(t->incidents.held);
    free(t);
    *trainer = NULL;
}

struct rn_field *rn_trainer_finish(struct rn_trainer **trainer) {
    struct rn_field *field = (*trainer)->field;
    struct rn_engine *engine = (*trainer)->engine;
    rn_trainer_end_ranks(*trainer);
    bool here = rn_field_fetch(field, NULL, NULL) == RN_OK;
    (*trainer)->field = NULL;
    rn_trainer_destroy(trainer); // what follows needs memory of its own
    if (here) rn_field_refine_occupancy(field, engine);
    if (here && field->on_device) (void)!rn_field_put_to_render(engine, field, NULL);
    return field;
}
