// What the scene's effects bring: for each that a training can do without, short trainings with it
// and without it, in pairs of one seed that take turns, so that a machine that slows down slows
// both alike.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "proto/folder.h"
#include "server/runner/field/work.h"
#include "server/runner/scene/describe.h"

#define MOST_SEEDS 16
#define TURNS 10 // of a pair, each of a tenth of its time: a unit of the work
#define ADVANCE_MS 50.0
#define VALIDATE_MS 1000.0

// A training at its end.
struct outcome {
    double psnr, ray_s, picture_s; // training seconds a ray, evaluation seconds of all views
};

// One effect, and what its pairs came to: of each seed the training with it, then without.
struct measure {
    enum rn_effect effect;
    bool on; // in the scene
    struct outcome outcomes[MOST_SEEDS][2];
    int pairs;
};

struct effects_work {
    struct rn_work work;
    struct rn_effects_options options;
    struct rn_train_options train;
    double seconds;
    int seeds, count;
    struct measure measures[RN_EFFECT_COUNT];
    struct rn_trainer *pair[2]; // under way: with the effect, without it
    bool alike;                 // both have it or both have not: there is nothing to measure
    char held_out[256];
};

// ---- a pair ---------------------------------------------------------------------------------

static void drop_pair(struct effects_work *effects) {
    rn_trainer_destroy(&effects->pair[0]);
    rn_trainer_destroy(&effects->pair[1]);
}

static bool has_effect(struct rn_trainer *trainer, enum rn_effect effect) {
    struct rn_field_info info;
    rn_field_describe(rn_trainer_field(trainer), &info);
    return info.effects[effect].on;
}

// The scene's own training, but for its time, its seed and one effect.
static enum rn_status start_one(struct effects_work *effects, const struct measure *m, int seed,
                                bool with, struct rn_error *err) {
    struct rn_host *host = effects->work.host;
    struct rn_train_config config;
    enum rn_status status =
        rn_configure(&effects->train, host->dataset->scale_count > 1, &config, err);
    if (status) return status;
    config.train_scale = rn_train_scale(host->dataset, &config);
    config.max_seconds = effects->seconds;
    config.max_steps = 0;
    config.until_psnr = 0;
    config.train_held_out = false;
    config.give_back = 0; // the figure is of the end
    config.seed += (uint64_t)seed;
    config.effect[m->effect] = !with   ? RN_EFFECT_UNWANTED
                               : m->on ? RN_EFFECT_AUTO
                                       : RN_EFFECT_WANTED;
    return rn_trainer_create(host->engine, host->dataset, &config,
                             (size_t)rn_int_or(host->place.memory_limit_bytes, 0),
                             &effects->pair[with ? 0 : 1], err);
}

static enum rn_status start_pair(struct effects_work *effects, const struct measure *m, int seed,
                                 struct rn_error *err) {
    drop_pair(effects);
    enum rn_status status = start_one(effects, m, seed, true, err);
    if (!status) status = start_one(effects, m, seed, false, err);
    if (status) return status;
    effects->alike =
        has_effect(effects->pair[0], m->effect) == has_effect(effects->pair[1], m->effect);
    snprintf(effects->held_out, sizeof effects->held_out, "%s",
             rn_trainer_held_out(effects->pair[0]));
    if (effects->alike) drop_pair(effects);
    return RN_OK;
}

static enum rn_status advance(struct effects_work *effects, struct rn_trainer *trainer,
                              double until_s, struct rn_error *err) {
    struct rn_progress progress;
    rn_trainer_progress(trainer, &progress);
    while (!progress.done && progress.train_seconds < until_s) {
        enum rn_status status = rn_trainer_advance(trainer, ADVANCE_MS, err);
        if (status) return status;
        if (!rn_work_keep_going(effects))
            return rn_error_set(err, RN_ERROR_CANCELLED, "", "cancelled");
        rn_trainer_progress(trainer, &progress);
    }
    return RN_OK;
}

static enum rn_status finish_one(struct effects_work *effects, struct rn_trainer *trainer,
                                 struct outcome *ret_outcome, struct rn_error *err) {
    struct rn_progress progress;
    for (bool done = false; !done;) {
        enum rn_status status = rn_trainer_validate(trainer, VALIDATE_MS, &done, err);
        if (status) return status;
        if (!rn_work_keep_going(effects))
            return rn_error_set(err, RN_ERROR_CANCELLED, "", "cancelled");
    }
    rn_trainer_progress(trainer, &progress);
    *ret_outcome =
        (struct outcome){progress.psnr, progress.train_seconds / (double)(progress.rays + 1),
                         progress.evaluate_seconds};
    return RN_OK;
}

static enum rn_status finish_pair(struct effects_work *effects, struct measure *m,
                                  struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (int i = 0; i < 2 && !status; i++)
        status = finish_one(effects, effects->pair[i], &m->outcomes[m->pairs][i], err);
    if (!status) m->pairs++;
    drop_pair(effects);
    return status;
}

// ---- the kind of work -----------------------------------------------------------------------

static void list_measures(struct effects_work *effects, struct rn_field *field) {
    struct rn_field_info info;
    rn_field_describe(field, &info);
    effects->count = 0;
    for (int i = 0; i < RN_EFFECT_COUNT; i++) {
        bool on = info.effects[i].on;
        if (!rn_effect_is_optional((enum rn_effect)i, on)) continue;
        effects->measures[effects->count++] = (struct measure){.effect = i, .on = on};
    }
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    struct effects_work *effects = (struct effects_work *)work;
    enum rn_status status = rn_host_need_sound_dataset(work->host, err);
    if (status) return status;
    effects->seconds = rn_number_or(effects->options.seconds, RN_EFFECTS_SECONDS);
    effects->seeds = (int)rn_int_or(effects->options.seeds, RN_EFFECTS_SEEDS);
    list_measures(effects, field);
    work->total = (size_t)(effects->count * effects->seeds * TURNS);
    return RN_OK;
}

static enum rn_status begin(struct rn_work *work, struct rn_error *err) {
    struct effects_work *effects = (struct effects_work *)work;
    (void)err;
    drop_pair(effects);
    effects->alike = false;
    for (int i = 0; i < effects->count; i++)
        effects->measures[i].pairs = 0;
    return RN_OK;
}

// Unit i: turn i mod TURNS of a pair, seed after seed, effect after effect.
static enum rn_status unit(struct rn_work *work, struct rn_field *field,
                           const struct rn_field_info *info, struct rn_error *err) {
    struct effects_work *effects = (struct effects_work *)work;
    int turn = (int)(work->done % TURNS), pair = (int)(work->done / TURNS);
    int seed = pair % effects->seeds;
    struct measure *m = &effects->measures[pair / effects->seeds];
    double began_s = (double)rn_clock_ns() * 1e-9;
    enum rn_status status = RN_OK;
    (void)field, (void)info;
    if (turn == 0 && (seed == 0 || !effects->alike)) status = start_pair(effects, m, seed, err);
    if (status || effects->alike) return status;
    double until_s = turn == TURNS - 1 ? INFINITY : effects->seconds * (turn + 1) / TURNS;
    for (int i = 0; i < 2 && !status; i++)
        status = advance(effects, effects->pair[(i + turn) % 2], until_s, err);
    if (!status && turn == TURNS - 1) status = finish_pair(effects, m, err);
    rn_work_rendered(work, ((double)rn_clock_ns() * 1e-9 - began_s) * 1e3, 0);
    return status;
}

static struct rn_effect_gain gain_of(const struct measure *m) {
    double psnr[2] = {0, 0}, low = INFINITY, high = -INFINITY, cost = 0, picture_cost = 0;
    for (int s = 0; s < m->pairs; s++) {
        const struct outcome *with = &m->outcomes[s][0], *without = &m->outcomes[s][1];
        psnr[0] += with->psnr / m->pairs;
        psnr[1] += without->psnr / m->pairs;
        low = fmin(low, with->psnr - without->psnr);
        high = fmax(high, with->psnr - without->psnr);
        cost += (with->ray_s / without->ray_s - 1) / m->pairs;
        picture_cost += (with->picture_s / without->picture_s - 1) / m->pairs;
    }
    struct rn_effect_gain gain = {.on = m->on,
                                  .psnr = psnr[0],
                                  .psnr_without = psnr[1],
                                  .gain = psnr[0] - psnr[1],
                                  .gain_spread =
                                      m->pairs > 1 && high >= low ? (high - low) / 2 : NAN,
                                  .cost = cost,
                                  .picture_cost = picture_cost};
    snprintf(gain.name, sizeof gain.name, "%s", rn_effect_name(m->effect));
    return gain;
}

static void describe(const struct effects_work *effects, struct rn_effects_record *record) {
    struct rn_device_info device;
    rn_engine_describe(effects->work.host->engine, &device);
    *record = (struct rn_effects_record){
        .threads = device.threads, .seconds = effects->seconds, .seeds = effects->seeds};
    snprintf(record->machine, sizeof record->machine, "%s", device.name);
    snprintf(record->device, sizeof record->device, "%s", device.device);
    snprintf(record->kernels, sizeof record->kernels, "%s", device.kernels);
    snprintf(record->version, sizeof record->version, "%s", RIPNERF_VERSION);
    snprintf(record->held_out, sizeof record->held_out, "%s", effects->held_out);
    rn_time_text(rn_clock_wall_ms(), record->measured_at);
}

static enum rn_status result(struct rn_work *work, struct rn_field *field, char **ret_json,
                             struct rn_error *err) {
    const struct effects_work *effects = (const struct effects_work *)work;
    struct rn_effect_gain gains[RN_EFFECT_COUNT];
    struct rn_effects_record record;
    char *json = NULL;
    (void)field;
    describe(effects, &record);
    record.gains = gains;
    for (int i = 0; i < effects->count; i++)
        if (effects->measures[i].pairs > 0) gains[record.count++] = gain_of(&effects->measures[i]);
    enum rn_status status = rn_encode(&rn_effects_record_table, &record, &json, NULL, err);
    if (!status)
        status = rn_folder_write(work->host->place.scene_folder, "effects.json", json, err);
    if (status)
        free(json);
    else
        *ret_json = json;
    return status;
}

static void release(struct rn_work *work) {
    drop_pair((struct effects_work *)work);
}

static const struct rn_work_kind kind = {.size = sizeof(struct effects_work),
                                         .prepare = prepare,
                                         .begin = begin,
                                         .unit = unit,
                                         .result = result,
                                         .release = release};

void rn_work_add_effects(struct rn_host *host, const struct rn_wire_effects *request) {
    struct rn_work *work = rn_work_append(host, &kind, request->job);
    if (!work) return;
    ((struct effects_work *)work)->options = request->options;
    ((struct effects_work *)work)->train = request->train;
}
