// Which blocks of pixels the next rays come from: importance sampling by the blocks' errors. A
// block is drawn the more often the larger the errors of its rays were, and its rays weigh the less
// for it, so that the loss stays the mean over all pixels while its gradient varies less (of
// unbiased ones the least where shares follow the size of the gradient, here the error's root).
#ifndef RN_ENGINE_TRAIN_IMPORTANCE_H
#define RN_ENGINE_TRAIN_IMPORTANCE_H

#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"
#include "server/engine/kernels/draw.h"

#define RN_IMPORTANCE_EVERY 64 // steps between two looks at the errors
#define RN_IMPORTANCE_EVEN 0.3 // of all draws, whatever the errors are

// Blocks in lists, [0, count) altogether. Thread-safety: drawing changes nothing.
struct rn_importance {
    size_t count;
    float *error;    // [count]: running mean of the losses of a block's rays; < 0: none yet
    float *share;    // [count]: how often a block is drawn, 1 = as often as the mean of its list
    double *sum;     // of shares, and
    uint32_t *guide; // to the runs of blocks, as struct rn_shares has them
};

// Every block with share 1, in so many lists. RN_ERROR_NO_MEMORY.
enum rn_status rn_importance_init(size_t count, int lists, struct rn_importance *ret,
                                  struct rn_error *err) RN_MUST_CHECK;
void rn_importance_finish(struct rn_importance *importance);
// The loss of a ray of a block.
void rn_importance_note(struct rn_importance *importance, size_t block, double loss);
// Shares from the errors: RN_IMPORTANCE_EVEN and, for the rest, in proportion to their roots.
// Blocks without a ray so far count as the list's mean.
void rn_importance_weigh(struct rn_importance *importance, size_t first, size_t count);
// Makes drawing follow the shares of list number `list`, [first, first + count).
void rn_importance_lay_out(struct rn_importance *importance, int list, size_t first, size_t count);
// Bytes of memory for so many blocks.
size_t rn_importance_bytes(size_t count, int lists);
struct rn_shares rn_importance_shares(const struct rn_importance *importance);
// rn_shared_pixel, which asks ahead for the memory of later turns.
struct rn_live_pixel rn_importance_pixel(const struct rn_importance *importance, int list,
                                         size_t first, size_t count, uint64_t seed, uint64_t turn,
                                         float *ret_weight);

#endif
