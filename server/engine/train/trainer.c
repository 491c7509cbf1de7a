// The trainer: set-up, training in blocks, held-out evaluation.
#include "server/engine/train/grow.h"
#include "server/engine/train/guard.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/engine/checkpoint/checkpoint.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"

// Times that photographs are made smaller.
static int scale_of(const struct rn_train_config *config) {
    return config->train_scale > 1 ? config->train_scale : 1;
}

// Again where a lens turns out to make no difference.
static void place_cameras(const struct rn_trainer *t, struct rn_pixels *pixels) {
    const struct rn_field *field = t->field;
    for (int f = 0; f < pixels->frame_count; f++) {
        struct rn_pixel_frame *frame = &pixels->frames[f];
        struct rn_camera *camera = &frame->camera;
        struct rn_camera as_stored = rn_field_camera(field, frame->frame);
        *camera = rn_camera_reduced(&as_stored, scale_of(&field->config));
        if (pixels == &t->train) *camera = rn_trainer_pose(t, f, camera);
        frame->parts = rn_camera_resized(camera, 2 * camera->width, 2 * camera->height);
        frame->view = rn_field_view(field, camera);
        frame->fine = rn_field_view(field, &frame->parts);
    }
}

void rn_trainer_place_cameras(struct rn_trainer *t) {
    place_cameras(t, &t->train);
    place_cameras(t, &t->held);
}

// What the effects make of the photographs.
static void take_effects(struct rn_trainer *t) {
    rn_trainer_place_cameras(t);
    rn_effects_take(t->field, &t->train, t->engine);
}

// `records`: of the effects, as far as they are known.
static enum rn_status load_pixels(struct rn_trainer *t, const struct rn_effect_record *records,
                                  size_t limit, struct rn_error *err) {
    struct rn_selection s = {t->dataset, &t->field->config, false};
    const struct rn_train_config *config = &t->field->config;
    struct rn_pixel_treatment treatment = {.reduced = scale_of(config),
                                           .memory_bytes = (size_t)config->pixel_memory << 20};
    rn_effects_treat(config, records, false, &treatment);
    enum rn_status status = rn_pixels_load(t->dataset, rn_selection_wants, &s, t->engine, treatment,
                                           limit, &t->train, err);
    if (status != RN_OK) return status;
    size_t used = t->train.paged.bytes ? 0 : rn_pixels_bytes(t->train.pixel_count, t->train.used);
    if (limit) limit = limit > used ? limit - used : 1;
    treatment.taken_bytes = t->train.paged.bytes ? treatment.memory_bytes : used;
    s.held = true;
    rn_effects_treat(config, records, true, &treatment);
    status = rn_pixels_load(t->dataset, rn_selection_wants, &s, t->engine, treatment, limit,
                            &t->held, err);
    if (status == RN_ERROR_INVALID) status = RN_OK; // nothing to hold out
    take_effects(t);
    rn_trainer_note_withheld(t);
    return status;
}

// ---- set-up ---------------------------------------------------------------------------------

// That the photographs to train on need; they need not be loaded.
static int training_levels(const struct rn_trainer *t) {
    struct rn_selection s = {t->dataset, &t->field->config, false};
    int levels = 1;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        const struct rn_frame *frame = &t->dataset->frames[f];
        if (!rn_selection_wants(&s, frame)) continue;
        struct rn_camera camera = rn_camera_reduced(&frame->camera, scale_of(&t->field->config));
        int need = rn_levels_for_camera(t->field, &camera, t->field->config.step);
        if (need > levels) levels = need;
    }
    return levels < t->field->config.field.levels ? levels : t->field->config.field.levels;
}

struct rn_evidence rn_trainer_evidence(const struct rn_trainer *t,
                                       const struct rn_march_options *march) {
    return (struct rn_evidence){.engine = t->engine,
                                .field = t->field,
                                .photographs = &t->train,
                                .step = t->progress.step,
                                .done = rn_schedule_done(&t->field->config, &t->progress),
                                .march = *march,
                                .pose_gain_known = t->poses.gain_known,
                                .pose_gain = t->poses.gain,
                                .outlier_share_known = t->outliers.share_known,
                                .outlier_share = t->outliers.share};
}

void rn_trainer_detect_effects(struct rn_trainer *t) {
    struct rn_evidence evidence = rn_trainer_evidence(t, &t->step.march);
    rn_effects_detect(&evidence);
    take_effects(t);
}

// Everything that follows from the pixels and the configuration.
enum rn_status rn_trainer_set_up(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = rn_field_need_levels(t->field, training_levels(t), err);
    if (status == RN_OK) status = rn_engine_prepare(t->engine, t->field, err);
    if (status == RN_OK) status = rn_trainer_allocate(t, err);
    if (status == RN_OK) status = rn_trainer_watch_cells(t, err);
    if (status == RN_OK) status = rn_trainer_allocate_poses(t, err);
    if (status == RN_OK) status = rn_trainer_allocate_outliers(t, err);
    return status;
}

// What training takes besides pixels once its planes are grown: parameters, their gradients, two
// moments and the last good ones; a pyramid and its gradients; what an update writes apart; a
// packet a thread; what a step's groups keep.
static size_t training_bytes(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_cpu_field *cpu = &t->field->cpu;
    struct rn_train_config grown = *config;
    if (config->grow_to > config->field.base) grown.field.base = config->grow_to;
    size_t side = (size_t)grown.field.base, before = (size_t)config->field.base;
    size_t parameters = t->field->parameters.plane_count / (before * before) * (side * side) +
                        t->field->parameters.base_count + t->field->parameters.head_count;
    size_t pyramid =
        rn_pyramid_count(&grown.field, training_levels(t)) * (size_t)grown.field.planes;
    int capacity = 2 * rn_workspace_capacity(cpu, config->step);
    return rn_field_bytes(&grown, 1) + (4 * parameters + 2 * pyramid) * sizeof(float) +
           rn_optimiser_apart_bytes(&grown, parameters, training_levels(t)) +
           RN_GROUPS * rn_group_numbers(cpu, capacity) * sizeof(float) +
           (size_t)rn_pool_threads(t->engine->pool) * rn_workspace_size(cpu, config->step) +
           RN_MAX_RAYS * sizeof(struct rn_march_ray);
}

static enum rn_status check_memory(const struct rn_trainer *t, size_t limit, size_t *ret_left,
                                   struct rn_error *err) {
    *ret_left = 0;
    if (!limit) return RN_OK;
    size_t need = training_bytes(t);
    if (need >= limit)
        return rn_error_set(err, RN_ERROR_LIMIT, t->dataset->name,
                            "training needs %zu MiB besides the pixels and the limit is %zu MiB; "
                            "use fewer planes or a smaller base",
                            need >> 20, limit >> 20);
    *ret_left = limit - need;
    return RN_OK;
}

// Of the photographs that are held decoded in memory, the held-out ones included.
static size_t pixel_bytes(const struct rn_trainer *t) {
    struct rn_selection train = {t->dataset, &t->field->config, false}, held = train;
    size_t pixels = 0;
    bool masked = false;
    held.held = true;
    for (size_t f = 0; f < t->dataset->frame_count; f++) {
        const struct rn_frame *frame = &t->dataset->frames[f];
        struct rn_camera camera = rn_camera_reduced(&frame->camera, scale_of(&t->field->config));
        size_t n = (size_t)camera.width * (size_t)camera.height;
        masked = masked || frame->mask_path;
        pixels += n * ((size_t)rn_selection_wants(&train, frame) +
                       (size_t)rn_selection_wants(&held, frame));
    }
    size_t bytes = rn_pixels_bytes(pixels, masked),
           most = (size_t)t->field->config.pixel_memory << 20;
    return most && bytes > most && *t->engine->folder ? most : bytes;
}

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
    struct rn_bounds bounds = rn_effects_prepare(dataset, config, ret_prepared);
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
    if (status == RN_OK) *ret_bytes = training_bytes(t) + pixel_bytes(t);
    rn_trainer_destroy(&t);
    return status;
}

int rn_train_scale(const struct rn_dataset *dataset, const struct rn_train_config *config) {
    return rn_effect_scale(dataset, config);
}

enum rn_status rn_trainer_create(struct rn_engine *engine, const struct rn_dataset *dataset,
                                 const struct rn_train_config *config, size_t memory_limit_bytes,
                                 struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_trainer *t = NULL;
    struct rn_train_config own = *config;
    size_t left;
    struct rn_effect_record prepared[RN_EFFECT_COUNT];
    double begin = (double)rn_clock_ns();
    enum rn_status status = plan(engine, dataset, &own, prepared, &t, err);
    if (status == RN_OK) status = check_memory(t, memory_limit_bytes, &left, err);
    if (status == RN_OK) status = load_pixels(t, prepared, left, err);
    if (status != RN_OK) goto fail;
    memcpy(t->field->effects, prepared, sizeof prepared);
    rn_trainer_detect_effects(t);
    status = take_space(t);
    if (status != RN_OK) goto fail;
    rn_field_randomise(t->field, own.seed);
    status = rn_trainer_set_up(t, err);
    if (status != RN_OK) goto fail;
    if (own.field.space == RN_SPACE_UNBOUNDED) {
        rn_trainer_carve_unseen(t);
        rn_trainer_carve_sighted(t);
    } else if (t->field->config.carve) {
        rn_trainer_carve(t);
    }
    status = rn_trainer_list_hull(t, err);
    if (status == RN_OK) status = rn_trainer_list_live(t, err);
    if (status == RN_OK) status = rn_trainer_keep_good(t, err);
    if (status != RN_OK) goto fail;
    rn_field_refresh(t->field, engine);
    rn_field_refresh_occupancy(t->field);
    status = rn_trainer_put(t, err);
    if (status != RN_OK) goto fail;
    t->progress.load_seconds = ((double)rn_clock_ns() - begin) * 1e-9;
    t->ranks.follows = true;
    *ret_trainer = t;
    return RN_OK;
fail:
    rn_trainer_destroy(&t);
    return status;
}

// What a checkpoint holds of a training.
static struct rn_arrays arrays_of(struct rn_trainer *t) {
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

static void take_counters(struct rn_trainer *t, const struct rn_counters *from) {
    t->progress = from->progress;
    t->optimiser.updates = from->updates;
    t->next_rays = from->next_rays;
    t->device.gradient_scale = from->gradient_scale;
    t->device.good_steps = from->good_steps;
    t->device.gradient_size = from->gradient_size;
    t->poses.turns = from->pose_turns;
    t->outliers.turns = from->outlier_turns;
}

enum rn_status rn_trainer_restore(struct rn_engine *engine, const struct rn_dataset *dataset,
                                  const char *checkpoint_path, size_t memory_limit_bytes,
                                  struct rn_trainer **ret_trainer, struct rn_error *err) {
    struct rn_trainer *t = NULL;
    struct rn_checkpoint checkpoint;
    size_t left;
    double begin = (double)rn_clock_ns();
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
        status = check_memory(t, memory_limit_bytes, &left, err);
    }
    if (status == RN_OK) status = load_pixels(t, t->field->effects, left, err);
    if (status == RN_OK) status = rn_trainer_set_up(t, err);
    struct rn_arrays arrays = arrays_of(t);
    if (status == RN_OK) status = rn_checkpoint_read_arrays(&checkpoint, &arrays, err);
    if (status == RN_OK) take_counters(t, &checkpoint.counters);
    if (status == RN_OK) rn_trainer_note_withheld(t); // what was given back
    if (status == RN_OK) status = rn_trainer_list_hull(t, err);
    if (status == RN_OK) status = rn_trainer_list_live(t, err);
    if (status == RN_OK) rn_trainer_place_cameras(t); // those that were moved
    arrays = arrays_of(t);
    if (status == RN_OK) status = rn_checkpoint_read_blocks(&checkpoint, &arrays, err);
    if (status == RN_OK) rn_trainer_share_out(t, false);
    if (status == RN_OK) status = rn_trainer_keep_good(t, err);
    if (status != RN_OK) goto fail;
    rn_field_refresh(t->field, engine);
    rn_field_refresh_occupancy(t->field);
    status = rn_trainer_put(t, err);
    if (status != RN_OK) goto fail;
    rn_checkpoint_close(&checkpoint);
    t->progress.load_seconds = ((double)rn_clock_ns() - begin) * 1e-9;
    t->ranks.follows = true;
    *ret_trainer = t;
    return RN_OK;
fail:
    rn_checkpoint_close(&checkpoint);
    rn_trainer_destroy(&t);
    return status;
}

static void end_ranks(struct rn_trainer *t);

void rn_trainer_destroy(struct rn_trainer **trainer) {
    struct rn_trainer *t = *trainer;
    char sha256[65];
    if (!t) return;
    if (t->writer) (void)rn_checkpoint_end(&t->writer, sha256, NULL);
    end_ranks(t);
    rn_field_destroy(&t->field);
    rn_pixels_finish(&t->train);
    rn_pixels_finish(&t->held);
    rn_trainer_free_step(t);
    rn_block_destroy(t->optimiser.grad);
    rn_trainer_drop_growth(t);
    rn_ranks_free(t);
    free(t->hull.list);
    rn_block_destroy(t->hull.seen);
    rn_sampler_finish(&t->sampler);
    rn_poses_finish(&t->poses);
    rn_outliers_finish(&t->outliers);
    free(t->incidents.held);
    free(t);
    *trainer = NULL;
}

// The field may have been rendered in between, with more levels.
enum rn_status rn_trainer_enter(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = rn_trainer_fetch(t, err);
    if (status == RN_OK) status = rn_engine_prepare(t->engine, t->field, err);
    t->field->cpu.built_levels = t->optimiser.levels;
    if (status == RN_OK && t->field->fresh_levels < t->optimiser.levels)
        rn_field_refresh(t->field, t->engine);
    return status;
}

// ---- training -------------------------------------------------------------------------------

static bool reached_limit(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    if (config->until_psnr > 0 && t->progress.psnr >= config->until_psnr) return true;
    return rn_schedule_done(&t->field->config, &t->progress) >= 1;
}

static bool within_step(const struct rn_trainer *t) {
    return t->step.under_way || t->step.next_chunk > 0 || t->ranks.agreed;
}

static bool effects_are_due(const struct rn_trainer *t) {
    struct rn_evidence evidence = rn_trainer_evidence(t, &t->step.march);
    return rn_effects_are_due(&evidence);
}

static void decide_effects(const struct rn_trainer *t) {
    struct rn_march_options march = rn_schedule_march(t->field, &t->progress);
    struct rn_evidence evidence = rn_trainer_evidence(t, &march);
    rn_effects_decide(&evidence);
}

// The device still trains over random backgrounds, whose time is over, or does not split pixels
// yet.
static bool march_due(const struct rn_trainer *t) {
    struct rn_march_options now = rn_schedule_march(t->field, &t->progress);
    return t->field->on_device &&
           (t->step.march.colour.background_variance > now.colour.background_variance ||
            t->step.march.split != now.split);
}

bool rn_trainer_turn_due(const struct rn_trainer *t) {
    return effects_are_due(t) || rn_trainer_poses_due(t) || rn_trainer_outliers_due(t) ||
           rn_trainer_gives_back(t) || t->growth || rn_trainer_grows(t) || march_due(t);
}

// *ret_busy: there is more of it to do before a step.
static enum rn_status take_turn(struct rn_trainer *t, bool *ret_busy, struct rn_error *err) {
    *ret_busy = false;
    if (!t->growth && rn_trainer_poses_due(t)) {
        enum rn_status status = rn_trainer_refine_poses(t, ret_busy, err);
        if (status != RN_OK || *ret_busy) return status;
    }
    if (!t->growth && rn_trainer_outliers_due(t)) {
        enum rn_status status = rn_trainer_seek_outliers(t, ret_busy, err);
        if (status != RN_OK || *ret_busy) return status;
    }
    if (!t->growth && effects_are_due(t)) decide_effects(t);
    enum rn_status status = rn_trainer_allocate_poses(t, err);
    if (status == RN_OK) status = rn_trainer_allocate_outliers(t, err);
    if (status == RN_OK && rn_trainer_gives_back(t)) status = rn_trainer_give_back(t, err);
    if (status == RN_OK) status = rn_trainer_grow(t, err);
    *ret_busy = t->growth != NULL;
    return status;
}

// What comes before a step, and its beginning, unless it is cut short.
static enum rn_status begin_step(struct rn_trainer *t, struct rn_error *err) {
    bool busy = false;
    enum rn_status status = t->step.next_chunk == 0 ? take_turn(t, &busy, err) : RN_OK;
    if (status != RN_OK || busy) return status;
    struct rn_occupancy_turn turn = rn_schedule_occupancy(&t->field->config, t->progress.step);
    if (turn.due && !rn_trainer_update_occupancy(t)) return RN_OK;
    if (t->progress.step > 0 && t->progress.step % RN_IMPORTANCE_EVERY == 0)
        rn_trainer_share_out(t, true);
    rn_trainer_begin_step(t);
    return RN_OK;
}

static void update_rates(struct rn_trainer *t, double seconds) {
    t->window.seconds += seconds;
    if (t->window.seconds < 0.5) return;
    t->progress.rays_per_second = (double)t->window.rays / t->window.seconds;
    t->progress.samples_per_second = (double)t->window.samples / t->window.seconds;
    t->window.seconds = 0;
    t->window.rays = t->window.samples = 0;
}

static enum rn_status run_here(struct rn_trainer *t, struct rn_error *err) {
    rn_ranks_begin_step(t);
    enum rn_status status = t->step.under_way ? RN_OK : begin_step(t, err);
    if (status == RN_OK && t->step.under_way) rn_trainer_run_wave(t);
    return status;
}

// What the host decides, it decides on its own copy, and the device gets a new one.
static enum rn_status run_there(struct rn_trainer *t, struct rn_error *err) {
    if (!rn_trainer_turn_due(t)) return rn_trainer_run_device(t, err);
    enum rn_status status = rn_trainer_enter(t, err);
    bool busy = false;
    if (status == RN_OK) status = take_turn(t, &busy, err);
    if (status != RN_OK || busy) return status;
    return rn_trainer_put(t, err);
}

static enum rn_status run_block(struct rn_trainer *t, struct rn_error *err) {
    double begin = (double)rn_clock_ns();
    int64_t step = t->progress.step;
    enum rn_status status = t->field->on_device ? run_there(t, err) : run_here(t, err);
    if (status != RN_OK) return status;
    double seconds = ((double)rn_clock_ns() - begin) * 1e-9;
    rn_ranks_end_step(t, t->progress.step != step, seconds);
    t->field->train_seconds = t->progress.train_seconds;
    update_rates(t, seconds);
    return RN_OK;
}

enum rn_status rn_trainer_agree(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = t->ranks.agreed ? rn_trainer_enter(t, err) : RN_OK;
    while (status == RN_OK && t->ranks.agreed)
        status = run_block(t, err);
    return status;
}

static void end_ranks(struct rn_trainer *t) {
    if (t->ranks.agreed && rn_trainer_agree(t, NULL) != RN_OK) t->ranks.exchange->abandon();
    rn_ranks_end(t);
}

enum rn_status rn_trainer_follow(struct rn_trainer *t, struct rn_error *err) {
    for (;;) {
        enum rn_rank_order order = rn_ranks_hear(t);
        enum rn_status status = rn_trainer_agree(t, err);
        if (status != RN_OK || order == RN_RANK_ENDS) return status;
        if (order != RN_RANK_SAVES) continue;
        rn_ranks_begin_save(t);
        while (!rn_trainer_guard_save(t)) {
        }
    }
}

enum rn_status rn_trainer_advance(struct rn_trainer *t, double budget_ms, struct rn_error *err) {
    int64_t until = rn_clock_ns() + (int64_t)(budget_ms * 1e6);
    enum rn_status status = t->field->on_device ? RN_OK : rn_trainer_enter(t, err);
    if (status != RN_OK) return status;
    do {
        if (!t->step.under_way && !t->ranks.agreed && reached_limit(t)) {
            t->progress.done = true;
            return RN_OK;
        }
        if (!within_step(t) && rn_trainer_gives_back(t) && !t->figure_offered) {
            t->figure_offered = true;
            return RN_OK;
        }
        status = run_block(t, err);
        if (status == RN_OK) status = rn_trainer_guard_check(t, err);
        if (status != RN_OK) return status;
    } while (rn_clock_ns() < until && !rn_engine_is_wanted(t->engine));
    return RN_OK;
}

void rn_trainer_progress(const struct rn_trainer *t, struct rn_progress *ret_progress) {
    *ret_progress = t->progress;
    double f = rn_schedule_done(&t->field->config, &t->progress), spent = t->progress.train_seconds;
    ret_progress->fraction = f > 1 ? 1 : f;
    ret_progress->eta_seconds = f > 0 ? fmax(0, spent / f - spent) : NAN;
    if (t->field->config.max_seconds > 0)
        ret_progress->eta_seconds =
            fmin(isnan(ret_progress->eta_seconds) ? 1e30 : ret_progress->eta_seconds,
                 fmax(0, t->field->config.max_seconds - spent));
    ret_progress->done = t->progress.done || (!t->step.under_way && reached_limit(t));
}

// ---- access ---------------------------------------------------------------------------------

const struct rn_train_config *rn_trainer_config(const struct rn_trainer *t) {
    return &t->field->config;
}
struct rn_field *rn_trainer_field(struct rn_trainer *t) {
    return t->field;
}

// ---- saving ---------------------------------------------------------------------------------

enum rn_status rn_trainer_save_begin(struct rn_trainer *t, enum rn_save_part part, const char *path,
                                     bool *ret_begun, struct rn_error *err) {
    *ret_begun = false;
    enum rn_status status = rn_trainer_enter(t, err);
    if (status != RN_OK) return status;
    while (status == RN_OK && within_step(t)) {
        status = run_block(t, err);
        if (status == RN_OK && within_step(t) && rn_engine_is_wanted(t->engine)) return RN_OK;
    }
    if (status != RN_OK) return status;
    uint64_t rollbacks = t->progress.rollbacks;
    rn_ranks_begin_save(t);
    while (!rn_trainer_guard_save(t))
        if (!t->ranks.exchange) return RN_OK;
    if (status == RN_OK && t->field->on_device)
        status = t->progress.rollbacks > rollbacks ? rn_trainer_put(t, err)
                                                   : rn_trainer_keep_good(t, err);
    struct rn_arrays arrays =
        part == RN_SAVE_ALL ? arrays_of(t) : (struct rn_arrays){.field = t->field};
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

struct rn_field *rn_trainer_finish(struct rn_trainer **trainer) {
    struct rn_field *field = (*trainer)->field;
    end_ranks(*trainer);
    bool here = rn_field_fetch(field, NULL, NULL) == RN_OK;
    if (here) rn_field_refine_occupancy(field, (*trainer)->engine);
    if (here && field->on_device) (void)!rn_field_put_to_render((*trainer)->engine, field, NULL);
    (*trainer)->field = NULL;
    rn_trainer_destroy(trainer);
    return field;
}
