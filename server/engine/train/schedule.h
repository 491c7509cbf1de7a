// What each step of a training is like: rates, march, smoothing and occupancy, as the configuration
// and the progress so far have it. On the CPU and on a device alike.
#ifndef RN_ENGINE_TRAIN_SCHEDULE_H
#define RN_ENGINE_TRAIN_SCHEDULE_H

#include "common/settings/train.h"
#include "server/engine/kernels/kernels.h"
#include "server/engine/scene/progress.h"
#include "server/engine/scene/scene.h"

#define RN_OCCUPANCY_EVERY 16    // steps
#define RN_OCCUPANCY_WARM_UP 256 // steps with every cell measured
#define RN_SMOOTH_EVERY 32       // steps

// 0..1 of the binding limit so far, NAN without one.
double rn_schedule_done(const struct rn_train_config *config, const struct rn_progress *progress);
// Rays that the whole training will draw if it goes on as it did so far; NAN without a limit.
double rn_schedule_rays(const struct rn_train_config *config, const struct rn_progress *progress);
// After a new held-out figure, where the training is to end at its plateau: once the planes have
// their final size, and half as much time again has gained less than 0.1 dB over the best figure so
// far, the limits are brought so near that the last quarter of the schedule, in which the rate
// decays, is what is left. At a limit it is that which ends the training.
void rn_schedule_note_figure(struct rn_train_config *config, struct rn_progress *progress);
// Whether photographs that are withheld, to tell the progress by, are to be trained on from now on:
// after `give_back` of the schedule, or at the plateau where the training ends by it.
bool rn_schedule_gives_back(const struct rn_train_config *config,
                            const struct rn_progress *progress);
// The networks' learning rate as of now.
double rn_schedule_rate(const struct rn_train_config *config, const struct rn_progress *progress);
// How far planes are smoothed at the end of the step that comes next (kernels/kernels.h); 0: not.
float rn_schedule_smoothing(const struct rn_train_config *config,
                            const struct rn_progress *progress);
// How the next step marches, in longer steps while the planes are coarse; nothing of the step
// before is in it.
struct rn_march_options rn_schedule_march(const struct rn_field *field,
                                          const struct rn_progress *progress);

// The side of planes that grow, as it should be by now; without a limit the last one.
int rn_schedule_base(const struct rn_train_config *config, const struct rn_progress *progress);

// Which cells of the hull are measured before a step: every `stride`-th from `first` on. A cell's
// turn comes every `stride` times, and what was measured before decays by as much. Where `sampled`,
// cells that are drawn are measured instead (rn_chances_of_cells), each decays by
// RN_OCCUPANCY_DECAY.
struct rn_occupancy_turn {
    bool due, sampled;
    uint32_t first, stride;
    float decay;
};
struct rn_occupancy_turn rn_schedule_occupancy(const struct rn_train_config *config, int64_t step);

#endif
