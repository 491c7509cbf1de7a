// What photographs show and the others do not (effect robust-loss): blocks of their pixels that no
// ray is drawn from, found in turns, between steps, each a pass over the photographs that a render
// may cut short.
//
// In place of a robust function of a pixel's error, which takes fine detail for a distractor as
// soon as it is not learned yet: a block's error is the mean of its pixels' differences with their
// signs. What is blurred leaves little of it, what stands elsewhere all. As in Sabour et al. 2023
// (RobustNeRF) errors are smoothed over neighbours, what is beyond a threshold is trimmed, and
// again where most around it is.
#ifndef RN_ENGINE_TRAIN_OUTLIERS_H
#define RN_ENGINE_TRAIN_OUTLIERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

struct rn_trainer;
struct rn_pixel_frame;

#define RN_OUTLIER_BLOCK 8    // pixels a side
#define RN_OUTLIER_LEAST 0.05 // a block's mean difference that is never large
#define RN_OUTLIER_TIMES 2.5f // one that is, in medians of all

// The formulas, over blocks of a photograph, `across` x `down` row by row; difference[block][3].
// Means of each block's and its neighbours' differences where they are known (count > 0), less the
// photograph's median in each channel; ret_size[block]: the length of it over sqrt(3), in [0, 1]; 0
// where none is known.
enum rn_status rn_outlier_sizes(const float *difference, const uint8_t *known, int across, int down,
                                float *ret_size, struct rn_error *err) RN_MUST_CHECK;
// Blocks in whose neighbourhood of 5 x 5 nine, at least, are large.
void rn_outlier_trim(const uint8_t *large, int across, int down, uint8_t *ret_out);

// Owner: whoever has the trainer; rn_outliers_finish.
struct rn_outliers {
    uint8_t *out;       // [count]: 1 where no ray is drawn; NULL: everywhere
    size_t *first;      // [train.frame_count]: of a photograph's blocks
    size_t count, most; // most: of a pass, about; of more photographs every second, third, ...
    double affords;     // of the rays that are trained on, in all passes
    int turns;          // that are over
    // The pass under way: it looks at every `apart`-th photograph. Means of the differences and of
    // what photographs show, so far, and photographs done.
    int apart;
    float (*difference)[3], (*taken)[3];
    uint8_t *known;
    float *size, *depth; // depth: where the field has what a block shows, bounds' radii
    float threshold;     // of the sizes; 0: not all photographs are looked at
    uint8_t *large;
    int next;
    double share; // of the pixels, as the effect has it
    bool share_known;
};
void rn_outliers_finish(struct rn_outliers *outliers);
// Bytes of memory that a pass over so many blocks takes, `most` of them in one photograph.
size_t rn_outlier_pass_bytes(size_t blocks, size_t most);
// Before training goes on: room for what is left out, where something is. RN_ERROR_NO_MEMORY.
enum rn_status rn_trainer_allocate_outliers(struct rn_trainer *trainer,
                                            struct rn_error *err) RN_MUST_CHECK;

// Whether photographs are to be looked at before the next step.
bool rn_trainer_outliers_due(const struct rn_trainer *trainer);
// Does so, until it is done or preempted; to be called again while *ret_busy. RN_ERROR_NO_MEMORY.
enum rn_status rn_trainer_seek_outliers(struct rn_trainer *trainer, bool *ret_busy,
                                        struct rn_error *err) RN_MUST_CHECK;
// Whether pixel (x, y) of a photograph is left out.
bool rn_trainer_is_outlier(const struct rn_trainer *trainer, const struct rn_pixel_frame *frame,
                           int x, int y);

#endif
