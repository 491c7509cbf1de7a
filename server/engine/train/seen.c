// Which cells of a place are empty: those that showed nothing to rays that came as far (cpu/crisp.h
// notes the largest weight of each cell), and those that no camera sees. Density alone says less:
// haze keeps cells that no picture would miss, and behind a surface there may be anything.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

#define BEGINS 0.05      // share of the schedule before which everything may still come
#define UNSEEN_ENDS 0.25 // share of the schedule by which every camera has looked at its cells
#define SINCE 1.2 // steps, of those till photographs were given back, after which they have too
#define ENDLESS 10000.0 // steps that stand for a schedule without a limit

enum rn_status rn_trainer_watch_cells(struct rn_trainer *t, struct rn_error *err) {
    size_t side = (size_t)t->field->config.field.occupancy, n = side * side * side;
    if (!rn_is_place(&t->field->cpu) || t->hull.seen) return RN_OK;
    t->hull.seen = rn_block_create(n * sizeof *t->hull.seen);
    if (!t->hull.seen) return rn_error_set(err, RN_ERROR_NO_MEMORY, "occupancy", "out of memory");
    for (size_t i = 0; i < n; i++)
        t->field->occupancy[i] = RN_NEVER_SEEN;
    return RN_OK;
}

struct round {
    struct rn_trainer *trainer;
    bool all_looked;
};

static void update_layer(void *context, int layer, int thread) {
    (void)thread;
    const struct round *round = context;
    struct rn_trainer *t = round->trainer;
    size_t side = (size_t)t->field->config.field.occupancy, first = (size_t)layer * side * side;
    for (size_t i = first; i < first + side * side; i++) {
        float *kept = &t->field->occupancy[i], shown;
        memcpy(&shown, &t->hull.seen[i], sizeof shown);
        *kept = rn_cell_kept(*kept, t->hull.seen[i] ? shown : NAN, round->all_looked);
    }
    memset(t->hull.seen + first, 0, side * side * sizeof *t->hull.seen);
}

struct rn_seen_round rn_trainer_seen_round(const struct rn_trainer *t) {
    double done = rn_schedule_done(&t->field->config, &t->progress);
    if (isnan(done)) done = (double)t->progress.step / ENDLESS;
    bool withheld = rn_trainer_withholds_any(t) ||
                    (double)t->progress.step < SINCE * (double)t->progress.given_back;
    return (struct rn_seen_round){.counts = !(done < BEGINS),
                                  .all_looked = !(done < UNSEEN_ENDS) && !withheld};
}

void rn_trainer_update_seen(struct rn_trainer *t) {
    int side = t->field->config.field.occupancy;
    struct rn_seen_round turn = rn_trainer_seen_round(t);
    if (!turn.counts) {
        size_t n = (size_t)side;
        memset(t->hull.seen, 0, n * n * n * sizeof *t->hull.seen);
        return;
    }
    rn_ranks_tell_seen(t);
    struct round round = {t, turn.all_looked};
    rn_pool_run(t->engine->pool, side, update_layer, &round);
    rn_field_refresh_occupancy(t->field);
}
