// The trainer's insides, shared by the files of this folder.
#ifndef RN_ENGINE_TRAIN_TRAINER_H
#define RN_ENGINE_TRAIN_TRAINER_H

#include "server/engine/effects/effects.h"
#include "server/engine/kernels/backend.h"
#include "server/engine/scene/pixels.h"
#include "server/engine/scene/scene.h"
#include "server/engine/train/optimiser.h"
#include "server/engine/train/sampler.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/train.h"

#define RN_MIN_RAYS 64
#define RN_VALIDATE_BLOCK 4096 // rays a block of held-out evaluation
#define RN_MAX_ROLLBACKS 3     // one more ends the training
#define RN_INCIDENTS_HELD 8    // between two takes

// Held-out evaluation under way.
struct rn_validation {
    bool active;
    int frame;                                          // of `held`
    size_t pixel;                                       // where the block under way begins
    int next_packet;                                    // of the block
    double packets[RN_VALIDATE_BLOCK / RN_PACKET_RAYS]; // its packets' errors
    double squares;                                     // of the frame's errors so far
    double psnr_sum;
};

struct rn_trainer {
    struct rn_engine *engine;
    const struct rn_dataset *dataset;
    struct rn_field *field;
    struct rn_pixels train, held;
    char held_out[160];

    struct rn_optimiser optimiser;
    struct rn_sampler sampler;
    struct rn_growth *growth; // NULL when the planes are not growing

    // The step under way. What is cut short for a render goes on at the next chunk, group or band.
    bool stepping;
    int next_chunk; // of the occupancy's cells, before the step
    int next_group, next_band;
    int ray_count;
    uint64_t first_ray; // rays of all steps before
    struct rn_march_ray *rays;
    struct rn_march_options march;
    struct rn_group groups[RN_GROUPS];
    float *group_memory;
    uint32_t *seen;      // NULL, or what each cell showed since the last round, as bits of a float
    uint32_t *hull_list; // cells that may hold matter
    size_t hull_count;
    int next_rays;        // of the next step
    float gradient_scale; // a device's (cuda/README.md); 0 at the start
    int good_steps;       // since it was last changed
    float gradient_size;  // a device's, for the roulette (kernels/backend.h)

    struct rn_incident *incidents; // RN_INCIDENTS_HELD, made with the first one
    int incident_first, incident_count, incidents_noted;

    struct rn_progress progress;
    double window_seconds; // for the rates
    uint64_t window_rays, window_samples;
    double clock_start; // of the advance under way
    struct rn_validation validation;
    struct rn_device_progress counted;   // when last read, where a device trains
    struct rn_checkpoint_writer *writer; // NULL when none is being written
};

// seen.c: where the space is a forward-facing one, begins to note what cells show; and the round
// every RN_OCCUPANCY_EVERY steps, after which cells that showed nothing are empty.
enum rn_status rn_trainer_watch_cells(struct rn_trainer *trainer,
                                      struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_update_seen(struct rn_trainer *trainer);
// trainer.c: before training goes on here, or the host reads what is trained: everything is as new
// as the device's and built for the training's cameras.
enum rn_status rn_trainer_enter(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// Whether the host has something to decide before the next step: view dependence, growth.
bool rn_trainer_turn_due(const struct rn_trainer *trainer);
// device.c: the field and what training needs to the engine's device, in place of what is there;
// nothing where there is no device, or one that may be done without cannot train this field. The
// levels and counts of the field's copy start anew.
enum rn_status rn_trainer_put(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_trainer_validate_rows(struct rn_trainer *trainer,
                                        const struct rn_pixel_frame *frame, int row, int rows,
                                        double *ret_squares, struct rn_error *err) RN_MUST_CHECK;
// A few steps there. As on the CPU, training goes back to its last good parameters, here those of
// the last save or growth, when no step could be taken 40 times in a row; a rejected step by itself
// is how the gradients' scale is found, and told as no incident.
enum rn_status rn_trainer_run_device(struct rn_trainer *trainer,
                                     struct rn_error *err) RN_MUST_CHECK;
// One step there, timed; of a field that is there and has nothing to decide on the host.
enum rn_status rn_trainer_time_device(struct rn_trainer *trainer,
                                      struct rn_device_stage ret_stages[RN_DEVICE_STAGES],
                                      int *ret_count, struct rn_error *err) RN_MUST_CHECK;
// occupancy.c
enum rn_status rn_trainer_list_hull(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_carve(struct rn_trainer *trainer);
void rn_trainer_carve_unseen(struct rn_trainer *trainer);     // cells of unbounded space
bool rn_trainer_update_occupancy(struct rn_trainer *trainer); // false: cut short, call again
// live.c
enum rn_status rn_trainer_list_live(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// Makes rays be drawn by the blocks' shares as they are; with `weigh` by their errors so far.
void rn_trainer_share_out(struct rn_trainer *trainer, bool weigh);
// trainer.c: which effects the photographs call for.
void rn_trainer_detect_effects(struct rn_trainer *trainer);
// What effects look at before the step that marches so.
struct rn_evidence rn_trainer_evidence(const struct rn_trainer *trainer,
                                       const struct rn_march_options *march);
// trainer.c: everything that follows from the pixels and the configuration.
enum rn_status rn_trainer_set_up(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// grow.c: whether the planes should be larger by now.
bool rn_trainer_grows(const struct rn_trainer *trainer);
// Makes the planes as large as they should be by now, or a part of it where the thread is
// preempted: then `growth` is there, no step may be taken, and it is to be called again.
// RN_ERROR_NO_MEMORY.
enum rn_status rn_trainer_grow(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_drop_growth(struct rn_trainer *trainer); // the one under way
// step.c
void rn_trainer_free_step(struct rn_trainer *trainer); // what rn_trainer_allocate took, but grad
// `grad` too, unless it is there.
enum rn_status rn_trainer_allocate(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
// The first row of a plane's band, 0 to `bands`.
int rn_trainer_band(const struct rn_trainer *trainer, int band);
void rn_trainer_take_march(struct rn_trainer *trainer); // for the step that begins
void rn_trainer_begin_step(struct rn_trainer *trainer);
// Puts the rays of the step that was done last in place, for an incident's record.
void rn_trainer_redraw(struct rn_trainer *trainer);
// Draws rays [begin, end) of the step under way.
void rn_trainer_draw(struct rn_trainer *trainer, int begin, int end);
void rn_trainer_note_losses(struct rn_trainer *trainer); // of its rays, to their blocks
// AdamW with the sum of all groups' gradients; false, and nothing is done, where it is not finite.
bool rn_trainer_update(struct rn_trainer *trainer);
void rn_trainer_run_wave(struct rn_trainer *trainer); // clears `stepping` when the step is complete
// Where a ray starts, and its weight in the loss; `frame` is NULL for an absent one.
struct rn_trainer_place {
    const struct rn_pixel_frame *frame;
    int x, y;
    int part; // of a split pixel, from 1; 0: all of it
    float jitter, weight;
    int32_t block; // of the trainer's live ones, < 0: of none
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
// guard.c: after every step the parameters are finite. When they are not, or when 16 steps in a row
// were rejected, training returns to the last good parameters (at most 64 updates old) with a fresh
// optimiser at half the rate. After RN_MAX_ROLLBACKS such returns it fails: RN_ERROR_NUMERIC.
enum rn_status rn_trainer_keep_good(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
bool rn_trainer_all_finite(const struct rn_trainer *trainer); // parameters and moments
void rn_trainer_roll_back(struct rn_trainer *trainer);
void rn_trainer_guard_step(struct rn_trainer *trainer, bool accepted);
void rn_trainer_guard_save(struct rn_trainer *trainer); // the optimiser's numbers too
enum rn_status rn_trainer_guard_check(const struct rn_trainer *trainer,
                                      struct rn_error *err) RN_MUST_CHECK;
// One group's slab and gradients in a block of rn_group_numbers; the next free place is returned.
size_t rn_group_numbers(const struct rn_cpu_field *field, int capacity);
float *rn_group_lay_out(const struct rn_cpu_field *field, int capacity, float *memory,
                        struct rn_group *ret_group);
// incident.c: forward and backward of rays [first, first + n) in a scratch group, of which only
// the memory is used; whether anything was not finite. *ret_group (may be NULL) has its counts.
enum rn_ray_fault rn_try_rays(const struct rn_kernels *kernels, const struct rn_cpu_field *field,
                              const struct rn_march_options *options,
                              const struct rn_march_ray *rays, int first, int n,
                              struct rn_workspace *workspace, const struct rn_group *scratch,
                              struct rn_group *ret_group);
// Records what went wrong in the step whose rays are in place, before anything is put
// right. Without memory for it nothing is recorded.
void rn_trainer_note(struct rn_trainer *trainer, enum rn_incident_kind kind);
// The photograph and pixel of ray r of the step under way or just done; NULL for an absent ray.
const struct rn_pixel_frame *rn_trainer_place(const struct rn_trainer *trainer, int r, int *ret_x,
                                              int *ret_y);
#endif
