// Gradients and what AdamW keeps of them.
#ifndef RN_ENGINE_TRAIN_OPTIMISER_H
#define RN_ENGINE_TRAIN_OPTIMISER_H

#include <stdatomic.h>

#include "server/engine/scene/scene.h"

struct rn_trainer;

// Laid out as the field's parameters, grad_pyramid as its pyramid. Owner: whoever has the trainer;
// `grad`, with m and v in the same block, outlives rn_optimiser_free.
struct rn_optimiser {
    float *grad, *m, *v;
    float *grad_pyramid;
    struct rn_map grad_maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS];
    int levels;       // of grad_maps: what the training cameras need; a render may build more
    bool tiled;       // the base is a multiple of the coarsest level's texels
    int bands;        // of rows a plane, for the scatter and the update
    uint8_t *touched; // [plane][tile], as rn_tiling
    size_t tiles;     // of a plane
    int64_t updates;  // steps that were not rejected, since the last rollback
    float *good;      // the parameters a rollback returns to
    int rejected;     // steps in a row
    atomic_bool wild; // the update made a parameter that is not finite
    // Where every texel changes at each step, which takes long, the new ones are written apart, and
    // take the place of the old ones at once when all are there: the update can be cut short, and a
    // picture shows the step before. Else NULL: it is done in place, and not cut short.
    float *apart, *apart_pyramid;
    int apart_levels;
    struct rn_map (*apart_maps)[RN_MAX_LEVELS][RN_MAX_LEVELS]; // [RN_MAX_PLANES]
    struct {                                                   // the one under way
        bool under_way;
        int next; // part
        double loss;
        struct rn_adamw networks, planes;
    } update;
};

// Numbers from grad to m, and from m to v.
size_t rn_optimiser_moments(const struct rn_field *field);
// For a field with the levels that are built; `grad` too, unless it is there. RN_ERROR_NO_MEMORY.
enum rn_status rn_optimiser_allocate(const struct rn_field *field, struct rn_optimiser *optimiser,
                                     struct rn_error *err) RN_MUST_CHECK;
void rn_optimiser_free(struct rn_optimiser *optimiser);

// The first row of a plane's band, 0 to `bands`.
int rn_trainer_band(const struct rn_trainer *trainer, int band);
// Bytes of what is written apart, for a training with `levels` a side; 0 where it is in place.
size_t rn_optimiser_apart_bytes(const struct rn_train_config *config, size_t parameters,
                                int levels);

enum rn_update_end {
    RN_UPDATE_CUT_SHORT, // the thread was preempted: call again, before anything else is trained
    RN_UPDATE_REJECTED,  // the gradients are not finite: nothing was done
    RN_UPDATE_DONE
};
// AdamW with the sum of all groups' gradients.
enum rn_update_end rn_trainer_update(struct rn_trainer *trainer);

#endif
