// Where rays are drawn from: blocks of pixels that may see the hull, some more often than others.
#ifndef RN_ENGINE_TRAIN_SAMPLER_H
#define RN_ENGINE_TRAIN_SAMPLER_H

#include "server/engine/scene/pixels.h"
#include "server/engine/train/importance.h"

// A block of pixels of a training frame whose cones may meet the hull.
struct rn_live_block {
    uint32_t frame;
    uint16_t x, y; // its first pixel
};

// Owner: rn_sampler_finish.
struct rn_sampler {
    struct rn_live_block *live; // blocks to draw rays from, scale after scale
    size_t live_count, live_first[17];
    struct rn_importance importance; // of the live blocks; none where they are drawn evenly
    float *ray_loss;                 // [RN_MAX_RAYS]: of the step's rays
    int32_t *ray_block;              // [RN_MAX_RAYS]: of `live`, that they are of; < 0: of none
};

// Room for what a step's rays have. RN_ERROR_NO_MEMORY.
enum rn_status rn_sampler_allocate_rays(struct rn_sampler *sampler,
                                        struct rn_error *err) RN_MUST_CHECK;
void rn_sampler_free_rays(struct rn_sampler *sampler);
void rn_sampler_finish(struct rn_sampler *sampler);

#endif
