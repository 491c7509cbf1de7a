// The guard: no step leaves a parameter behind that is not a finite number. All parameters are
// looked at when a step met or wrote something that is not finite, before they are copied as good
// (every 64 updates) and before they are saved; a number that no step reads waits till then.
#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/train/guard.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

#define CHUNK 65536      // numbers looked at together
#define GOOD_EVERY 64    // updates between two copies of the parameters
#define MOST_REJECTED 16 // steps in a row

struct scan {
    const float *numbers;
    size_t count;
    atomic_bool found;
};

static void scan_chunk(void *context, int index, int thread) {
    (void)thread;
    struct scan *scan = context;
    size_t begin = (size_t)index * CHUNK, end = begin + CHUNK;
    uint32_t found = 0;
    for (size_t i = begin; i < end && i < scan->count; i++) {
        uint32_t bits;
        memcpy(&bits, scan->numbers + i, sizeof bits);
        found |= (bits & 0x7f800000u) == 0x7f800000u;
    }
    if (found) atomic_store(&scan->found, true);
}

static bool all_finite(const struct rn_trainer *t, const float *numbers) {
    struct scan scan = {numbers, t->field->parameters.count, false};
    rn_pool_run(t->engine->pool, (int)((scan.count + CHUNK - 1) / CHUNK), scan_chunk, &scan);
    return !atomic_load(&scan.found);
}

bool rn_trainer_all_finite(const struct rn_trainer *t) {
    return all_finite(t, t->field->parameters.values) && all_finite(t, t->optimiser.m) &&
           all_finite(t, t->optimiser.v);
}

static void copy_chunk(void *context, int index, int thread) {
    (void)thread;
    const struct rn_trainer *t = context;
    size_t begin = (size_t)index * CHUNK, left = t->field->parameters.count - begin;
    memcpy(t->optimiser.good + begin, t->field->parameters.values + begin,
           (left < CHUNK ? left : CHUNK) * sizeof *t->optimiser.good);
}

static void copy_good(struct rn_trainer *t) {
    int chunks = (int)((t->field->parameters.count + CHUNK - 1) / CHUNK);
    rn_pool_run(t->engine->pool, chunks, copy_chunk, t);
}

enum rn_status rn_trainer_keep_good(struct rn_trainer *t, struct rn_error *err) {
    if (!t->optimiser.good)
        t->optimiser.good = rn_block_create(t->field->parameters.count * sizeof *t->optimiser.good);
    if (!t->optimiser.good)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    copy_good(t);
    return RN_OK;
}

// The optimiser's moments may be spoilt too: it starts anew.
void rn_trainer_roll_back(struct rn_trainer *t) {
    rn_trainer_note(t, RN_INCIDENT_ROLLBACK);
    size_t bytes = t->field->parameters.count * sizeof *t->optimiser.good;
    memcpy(t->field->parameters.values, t->optimiser.good, bytes);
    memset(t->optimiser.m, 0, bytes);
    memset(t->optimiser.v, 0, bytes);
    t->optimiser.updates = t->optimiser.rejected = 0;
    t->optimiser.wild = false;
    t->progress.rollbacks++;
    rn_field_refresh(t->field, t->engine);
}

static bool has_offenders(const struct rn_trainer *t) {
    for (int g = 0; g < RN_GROUPS; g++)
        if (t->step.groups[g].nonfinite_rays > 0) return true;
    return false;
}

// The optimiser looks at every number that it writes; all are looked at where a step was rejected,
// which is what a number that is not finite leads to, and before a copy is called good.
void rn_trainer_guard_step(struct rn_trainer *t, bool accepted) {
    t->optimiser.rejected = accepted ? 0 : t->optimiser.rejected + 1;
    if (!accepted)
        rn_trainer_note(t, RN_INCIDENT_REJECTED);
    else if (has_offenders(t))
        rn_trainer_note(t, RN_INCIDENT_RAYS);
    bool copy = accepted && t->optimiser.updates % GOOD_EVERY == 0;
    bool wild = t->optimiser.wild || ((copy || !accepted || has_offenders(t)) &&
                                      !all_finite(t, t->field->parameters.values));
    if (wild || t->optimiser.rejected >= MOST_REJECTED)
        rn_trainer_roll_back(t);
    else if (copy)
        copy_good(t);
}

void rn_trainer_guard_save(struct rn_trainer *t) {
    size_t side = (size_t)t->field->config.field.occupancy;
    for (size_t i = 0; i < side * side * side; i++)
        if (!isfinite(t->field->occupancy[i])) t->field->occupancy[i] = 0;
    if (!rn_trainer_all_finite(t)) rn_trainer_roll_back(t);
}

enum rn_status rn_trainer_guard_check(const struct rn_trainer *t, struct rn_error *err) {
    if (t->progress.rollbacks <= RN_MAX_ROLLBACKS) return RN_OK;
    return rn_error_set(err, RN_ERROR_NUMERIC, t->dataset->name,
                        "training diverged %d times, each time from the last good state and at "
                        "half the rate; the scene keeps that state; try a lower learning rate",
                        (int)t->progress.rollbacks);
}
