// Held-out evaluation under way.
#ifndef RN_ENGINE_TRAIN_VALIDATE_H
#define RN_ENGINE_TRAIN_VALIDATE_H

#include <stdbool.h>
#include <stddef.h>

#include "server/engine/kernels/kernels.h"

#define RN_VALIDATE_BLOCK 4096 // pixels a block
#define RN_VALIDATE_LEAST 8    // of it, a piece, at least

struct rn_validation {
    bool active;
    int frame;                                            // of those held out
    size_t pixel;                                         // where the block under way begins
    int next_piece;                                       // of the block
    double pieces[RN_VALIDATE_BLOCK / RN_VALIDATE_LEAST]; // its pieces' errors
    double squares;                                       // of the frame's errors so far
    double psnr_sum;
};

#endif
