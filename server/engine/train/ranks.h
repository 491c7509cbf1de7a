// Training over several ranks (kernels/exchange.h). Each computes its share of the groups of a
// step's rays, hears what the other groups have found, and adds all of it up as one rank would:
// each ends with the same parameters, and they are the same bytes for any number of ranks. What
// follows from the clock or from held-out figures is decided by rank 0.
//
// Every function does nothing where there is one rank.
#ifndef RN_ENGINE_TRAIN_RANKS_H
#define RN_ENGINE_TRAIN_RANKS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "server/engine/kernels/exchange.h"

struct rn_trainer;

// Owner: whoever has the trainer.
struct rn_ranks {
    const struct rn_exchange *exchange; // NULL: one rank
    bool follows;                       // ranks train this field: rank 0 leads them until the end
    bool agreed;                        // on a step, which is not complete yet
    bool shared;                        // the wave that is not scattered yet
    double seconds;                     // of rank 0's clock, that the ranks do not know of
    float *memory;                      // of what is told in a wave or a step
    size_t bytes;
};

// A rank's part of `count` things in a row.
struct rn_share {
    int first, count;
};
struct rn_share rn_ranks_share(const struct rn_trainer *trainer, int count);

// Before a step, rank 0: its clock and figures become everybody's.
void rn_ranks_begin_step(struct rn_trainer *trainer);
// After it; `seconds` of the clock were spent.
void rn_ranks_end_step(struct rn_trainer *trainer, bool complete, double seconds);
// Slabs and cursors of a wave, once; sums of a step.
void rn_ranks_tell_wave(struct rn_trainer *trainer);
void rn_ranks_tell_step(struct rn_trainer *trainer);
// What the hull's cells were found to hold: of `count` cells, the (first + i * stride)-th of them,
// whose `chunk`-wise parts the ranks have measured.
void rn_ranks_tell_cells(struct rn_trainer *trainer, size_t first, size_t stride, size_t count,
                         size_t chunk);
void rn_ranks_tell_seen(struct rn_trainer *trainer); // what cells showed
// Rank 0 saves: everybody looks for what must not be saved.
void rn_ranks_begin_save(struct rn_trainer *trainer);
// Rank 0: the training is over. A step under way must be complete.
void rn_ranks_end(struct rn_trainer *trainer);
void rn_ranks_free(struct rn_trainer *trainer);

// What rank 0 asks of the others.
enum rn_rank_order { RN_RANK_STEPS, RN_RANK_SAVES, RN_RANK_ENDS };
// Waits for it; takes over what a step begins with.
enum rn_rank_order rn_ranks_hear(struct rn_trainer *trainer);

#endif
