// Where rays are drawn from: blocks of pixels that may see the hull, some more often than others.
#ifndef RN_ENGINE_TRAIN_SAMPLER_H
#define RN_ENGINE_TRAIN_SAMPLER_H

#include "server/engine/kernels/kernels.h"
#include "server/engine/scene/pixels.h"
#include "server/engine/train/importance.h"

struct rn_trainer;

// A block of pixels of a training frame whose cones may meet the hull.
struct rn_live_block {
    int frame, x, y; // x, y: its first pixel
};

#define RN_LIVE_STRIDE 4096

// Owner: rn_sampler_finish.
struct rn_sampler {
    uint32_t *first; // [frames]: number of each frame's first block
    // Blocks to draw rays from, in the order of their numbers, so scale after scale: a bit a block;
    // how many are before each word; the word that every RN_LIVE_STRIDE-th of them is in.
    uint64_t *live;
    uint32_t *live_before, *live_guide;
    size_t live_count, live_first[17];
    struct rn_importance importance; // of the live blocks; none where they are drawn evenly
    float *ray_loss;                 // [RN_MAX_RAYS]: of the step's rays
    uint32_t *ray_photograph;        // [RN_MAX_RAYS]: of the dataset, that they are of
    int32_t *ray_block;              // [RN_MAX_RAYS]: of `live`, that they are of; < 0: of none
};

// Room for what a step's rays have. RN_ERROR_NO_MEMORY.
enum rn_status rn_sampler_allocate_rays(struct rn_sampler *sampler,
                                        struct rn_error *err) RN_MUST_CHECK;
void rn_sampler_free_rays(struct rn_sampler *sampler);
void rn_sampler_finish(struct rn_sampler *sampler);

// live.c: the live blocks of the hull as it is. RN_ERROR_NO_MEMORY, RN_ERROR_LIMIT.
enum rn_status rn_trainer_list_live(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
struct rn_live_block rn_trainer_live(const struct rn_trainer *trainer, size_t live); // of them
size_t rn_trainer_live_bytes(size_t blocks); // of what is kept of so many, without importance
size_t rn_trainer_blocks(const struct rn_camera *camera); // of a frame, live or not
// Makes rays be drawn by the blocks' shares as they are; with `weigh` by their errors so far.
void rn_trainer_share_out(struct rn_trainer *trainer, bool weigh);

// Whether rays are drawn from a pixel, and whether there may be one from which none are: masks
// leave it out, or it is an outlier by now or later.
bool rn_trainer_is_drawn(const struct rn_trainer *trainer, const struct rn_pixel_frame *frame,
                         int x, int y);
bool rn_trainer_leaves_out(const struct rn_trainer *trainer);

// Where a ray starts, and its weight in the loss; `frame` is NULL for an absent one.
struct rn_trainer_place {
    const struct rn_pixel_frame *frame;
    int x, y;
    int part; // of a split pixel, from 1; 0: all of it
    float jitter, weight;
    int32_t block; // of the live ones, < 0: of none
};
#define RN_TRAINER_RAYS 128
// The rays through `count` <= RN_TRAINER_RAYS pixels, marched in `step` (scene radii), targets over
// the background. Weight 1; of an absent one 0.
void rn_trainer_rays(const struct rn_trainer *trainer, const struct rn_pixels *pixels,
                     const struct rn_trainer_place *places, int count, double step,
                     struct rn_march_ray *ret_rays);
// One of them.
struct rn_march_ray rn_trainer_ray(const struct rn_trainer *trainer, const struct rn_pixels *pixels,
                                   const struct rn_pixel_frame *frame, int x, int y, double step,
                                   double jitter);
// Draws rays [begin, end) of the step under way.
void rn_trainer_draw(struct rn_trainer *trainer, int begin, int end);
void rn_trainer_note_losses(struct rn_trainer *trainer); // of its rays, to their blocks
// The photograph and pixel of ray r of the step under way or just done; NULL for an absent ray.
const struct rn_pixel_frame *rn_trainer_place(const struct rn_trainer *trainer, int r, int *ret_x,
                                              int *ret_y);

#endif
