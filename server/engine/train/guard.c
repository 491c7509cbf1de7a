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

// Numbers that are looked at, or copied, chunk by chunk: one array after the other, of `count`
// each.
struct scan {
    const float *arrays[3];
    size_t count;
    float *copy; // of the first array
    atomic_bool found;
};

static int chunks_of(size_t count) {
    return (int)((count + CHUNK - 1) / CHUNK);
}

static void scan_chunk(void *context, int index, int thread) {
    (void)thread;
    struct scan *scan = context;
    int chunks = chunks_of(scan->count);
    const float *numbers = scan->arrays[index / chunks];
    size_t begin = (size_t)(index % chunks) * CHUNK, end = begin + CHUNK;
    uint32_t found = 0;
    for (size_t i = begin; i < end && i < scan->count; i++) {
        uint32_t bits;
        memcpy(&bits, numbers + i, sizeof bits);
        found |= (bits & 0x7f800000u) == 0x7f800000u;
    }
    if (found) atomic_store(&scan->found, true);
}

static void copy_chunk(void *context, int index, int thread) {
    (void)thread;
    const struct scan *scan = context;
    size_t begin = (size_t)index * CHUNK, left = scan->count - begin;
    memcpy(scan->copy + begin, scan->arrays[0] + begin,
           (left < CHUNK ? left : CHUNK) * sizeof *scan->copy);
}

static struct scan scan_of(const struct rn_trainer *t) {
    return (struct scan){{t->field->parameters.values, t->optimiser.m, t->optimiser.v},
                         t->field->parameters.count,
                         t->optimiser.good,
                         false};
}

bool rn_trainer_all_finite(const struct rn_trainer *t) {
    struct scan scan = scan_of(t);
    rn_pool_run(t->engine->pool, 3 * chunks_of(scan.count), scan_chunk, &scan);
    return !atomic_load(&scan.found);
}

// The rest of `arrays` arrays; false: cut short.
static bool scan_some(struct rn_trainer *t, int arrays) {
    struct scan scan = scan_of(t);
    bool all = rn_pool_run_some(t->engine->pool, arrays * chunks_of(scan.count), &t->guard.next,
                                scan_chunk, &scan, rn_engine_is_wanted, t->engine);
    t->guard.found |= atomic_load(&scan.found);
    if (all) t->guard.next = 0;
    return all;
}

static bool copy_some(struct rn_trainer *t) {
    struct scan scan = scan_of(t);
    bool all = rn_pool_run_some(t->engine->pool, chunks_of(scan.count), &t->guard.next, copy_chunk,
                                &scan, rn_engine_is_wanted, t->engine);
    if (all) t->guard.next = 0;
    return all;
}

enum rn_status rn_trainer_keep_good(struct rn_trainer *t, struct rn_error *err) {
    if (!t->optimiser.good)
        t->optimiser.good = rn_block_create(t->field->parameters.count * sizeof *t->optimiser.good);
    if (!t->optimiser.good)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    struct scan scan = scan_of(t);
    rn_pool_run(t->engine->pool, chunks_of(scan.count), copy_chunk, &scan);
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
static void look(struct rn_trainer *t, bool accepted) {
    struct rn_guard *guard = &t->guard;
    t->optimiser.rejected = accepted ? 0 : t->optimiser.rejected + 1;
    if (!accepted)
        rn_trainer_note(t, RN_INCIDENT_REJECTED);
    else if (has_offenders(t))
        rn_trainer_note(t, RN_INCIDENT_RAYS);
    guard->copies = accepted && t->optimiser.updates % GOOD_EVERY == 0;
    guard->found = t->optimiser.wild;
    guard->next = 0;
    bool scans = !guard->found && (guard->copies || !accepted || has_offenders(t));
    guard->stage = scans ? RN_GUARD_SCANS : RN_GUARD_COPIES;
}

bool rn_trainer_guard_step(struct rn_trainer *t, bool accepted) {
    struct rn_guard *guard = &t->guard;
    if (guard->stage == RN_GUARD_LOOKS) look(t, accepted);
    if (guard->stage == RN_GUARD_SCANS) {
        if (!scan_some(t, 1)) return false;
        guard->stage = RN_GUARD_COPIES;
    }
    if (guard->found || t->optimiser.rejected >= MOST_REJECTED)
        rn_trainer_roll_back(t);
    else if (guard->copies && !copy_some(t))
        return false;
    guard->stage = RN_GUARD_LOOKS;
    return true;
}

bool rn_trainer_guard_save(struct rn_trainer *t) {
    size_t side = (size_t)t->field->config.field.occupancy;
    struct rn_guard *guard = &t->guard;
    for (size_t i = 0; i < side * side * side; i++)
        if (!isfinite(t->field->occupancy[i])) t->field->occupancy[i] = 0;
    if (guard->saved != t->progress.step) guard->next = 0;
    if (guard->next == 0) guard->found = false;
    guard->saved = t->progress.step;
    if (!scan_some(t, 3)) return false;
    if (guard->found) rn_trainer_roll_back(t);
    return true;
}

enum rn_status rn_trainer_guard_check(const struct rn_trainer *t, struct rn_error *err) {
    if (t->progress.rollbacks <= RN_MAX_ROLLBACKS) return RN_OK;
    return rn_error_set(err, RN_ERROR_NUMERIC, t->dataset->name,
                        "training diverged %d times, each time from the last good state and at "
                        "half the rate; the scene keeps that state; try a lower learning rate",
                        (int)t->progress.rollbacks);
}
