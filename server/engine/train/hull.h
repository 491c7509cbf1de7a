// Which cells may hold matter, and which of them do by now.
#ifndef RN_ENGINE_TRAIN_HULL_H
#define RN_ENGINE_TRAIN_HULL_H

#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

struct rn_trainer;

#define RN_HULL_WORD 64 // cells

// Owner: whoever has the trainer; `before` is freed, `seen` a block.
struct rn_hull {
    uint32_t *before; // [cells^3 / RN_HULL_WORD]: of the cells that may hold matter, before a word
    size_t count;     // of all of them
    uint32_t *seen;   // NULL, or what each cell showed since the last round, as bits of a float
};

// occupancy.c: counts the cells that may hold matter.
enum rn_status rn_trainer_count_hull(struct rn_trainer *trainer,
                                     struct rn_error *err) RN_MUST_CHECK;
// Which cell is the i-th of them, i < count; from *word on, where a search before ended (0 at
// first), it takes no longer than there is to pass.
size_t rn_hull_cell(const struct rn_trainer *trainer, size_t i, size_t *word);
void rn_trainer_carve(struct rn_trainer *trainer);            // by the photographs' alpha
void rn_trainer_carve_unseen(struct rn_trainer *trainer);     // cells of unbounded space
bool rn_trainer_update_occupancy(struct rn_trainer *trainer); // false: cut short, call again

// sighted.c: cells of unbounded space that photographs saw through to sparse points, or would have
// seen through from between two of them, begin empty, and so do those that several see through
// between their points (sheets.h). Of some 50,000 sightings at most; without points nothing
// changes.
void rn_trainer_carve_sighted(struct rn_trainer *trainer);

// seen.c: where the space is a forward-facing one, begins to note what cells show; and the round
// every RN_OCCUPANCY_EVERY steps, after which cells that showed nothing are empty.
enum rn_status rn_trainer_watch_cells(struct rn_trainer *trainer,
                                      struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_update_seen(struct rn_trainer *trainer);
// What the round before the next step is: whether it counts, or all is forgotten; whether every
// camera has looked at its cells (rn_cell_kept).
struct rn_seen_round {
    bool counts, all_looked;
};
struct rn_seen_round rn_trainer_seen_round(const struct rn_trainer *trainer);

#endif
