// Training in blocks: what the host decides between steps, steps, and the ranks' agreement on them.
#include "server/engine/train/trainer.h"

#include <math.h>

#include "common/base/clock.h"
#include "server/engine/train/grow.h"
#include "server/engine/train/memory.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/withheld.h"

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

// The field may have been rendered in between, with more levels.
enum rn_status rn_trainer_enter(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = rn_trainer_fetch(t, err);
    if (status == RN_OK) status = rn_engine_prepare(t->engine, t->field, err);
    t->field->cpu.built_levels = t->optimiser.levels;
    if (status == RN_OK && t->field->fresh_levels < t->optimiser.levels)
        rn_field_refresh(t->field, t->engine);
    return status;
}

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
// yet, or marches in longer steps.
static bool march_due(const struct rn_trainer *t) {
    struct rn_march_options now = rn_schedule_march(t->field, &t->progress);
    return t->field->on_device &&
           (t->step.march.colour.background_variance > now.colour.background_variance ||
            t->step.march.split != now.split || t->step.march.step > now.step);
}

bool rn_trainer_turn_due(const struct rn_trainer *t) {
    return effects_are_due(t) || rn_trainer_poses_due(t) || rn_trainer_outliers_due(t) ||
           rn_trainer_gives_back(t) || t->growth || rn_trainer_grows(t) || march_due(t);
}

static enum rn_status take_due(struct rn_trainer *t, bool *ret_busy, struct rn_error *err) {
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

// *ret_busy: there is more of it to do before a step.
static enum rn_status take_turn(struct rn_trainer *t, bool *ret_busy, struct rn_error *err) {
    double begin = (double)rn_clock_ns();
    enum rn_status status = take_due(t, ret_busy, err);
    t->progress.turn_seconds += ((double)rn_clock_ns() - begin) * 1e-9;
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
    if (!t->step.under_way) return begin_step(t, err);
    rn_trainer_run_wave(t);
    return RN_OK;
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

enum rn_status rn_trainer_complete_step(struct rn_trainer *t, bool *ret_complete,
                                        struct rn_error *err) {
    enum rn_status status = RN_OK;
    *ret_complete = false;
    while (status == RN_OK && within_step(t)) {
        status = run_block(t, err);
        if (status == RN_OK && within_step(t) && rn_engine_is_wanted(t->engine)) return RN_OK;
    }
    *ret_complete = status == RN_OK;
    return status;
}

enum rn_status rn_trainer_agree(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = t->ranks.agreed ? rn_trainer_enter(t, err) : RN_OK;
    while (status == RN_OK && t->ranks.agreed)
        status = run_block(t, err);
    return status;
}

void rn_trainer_end_ranks(struct rn_trainer *t) {
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
        if (status != RN_OK) return rn_trainer_lacks_memory(t, status, err);
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

const struct rn_train_config *rn_trainer_config(const struct rn_trainer *t) {
    return &t->field->config;
}

struct rn_field *rn_trainer_field(struct rn_trainer *t) {
    return t->field;
}
