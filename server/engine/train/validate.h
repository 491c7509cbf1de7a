// Held-out evaluation under way.
#ifndef RN_ENGINE_TRAIN_VALIDATE_H
#define RN_ENGINE_TRAIN_VALIDATE_H

#include <stdbool.h>
#include <stddef.h>

#include "server/engine/kernels/kernels.h"

#define RN_VALIDATE_BLOCK 4096 // rays a block

struct rn_validation {
    bool active;
    int frame;                                          // of those held out
    size_t pixel;                                       // where the block under way begins
    int next_packet;                                    // of the block
    double packets[RN_VALIDATE_BLOCK / RN_PACKET_RAYS]; // its packets' errors
    double squares;                                     // of the frame's errors so far
    double psnr_sum;
};

#endif
