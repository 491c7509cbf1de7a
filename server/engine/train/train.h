// Training a field: in blocks of a few milliseconds, saved and restored, with what went wrong.
#ifndef RN_ENGINE_TRAIN_TRAIN_H
#define RN_ENGINE_TRAIN_TRAIN_H

#include "common/dataset/dataset.h"
#include "server/engine/checkpoint/checkpoint.h"
#include "server/engine/kernels/exchange.h"
#include "server/engine/scene/engine.h"
#include "server/engine/scene/progress.h"

struct rn_trainer; // a field, its optimiser, the training pixels

// Bytes of memory that a training takes at its largest, photographs included, beside what the
// process itself takes: known before anything is loaded. Errors are of the configuration.
enum rn_status rn_train_need(struct rn_engine *engine, const struct rn_dataset *dataset,
                             const struct rn_train_config *config, size_t *ret_bytes,
                             struct rn_error *err) RN_MUST_CHECK;

// Times that a training makes its photographs smaller, so that shorter ones can be made alike.
int rn_train_scale(const struct rn_dataset *dataset, const struct rn_train_config *config);

// Decodes the training and held-out pixels, detects effects, carves, initialises. Memory is
// computed first: RN_ERROR_LIMIT says what is needed when it exceeds `memory_limit_bytes` (0 = no
// limit). `dataset` must outlive the trainer.
enum rn_status rn_trainer_create(struct rn_engine *engine, const struct rn_dataset *dataset,
                                 const struct rn_train_config *config, size_t memory_limit_bytes,
                                 struct rn_trainer **ret_trainer,
                                 struct rn_error *err) RN_MUST_CHECK;
// Ranks other than 0 (kernels/exchange.h): trains as rank 0 says, which trains a field made alike,
// until it has destroyed its own. Rank 0 tells them so where it could not make one.
enum rn_status rn_trainer_follow(struct rn_trainer *trainer, struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_dismiss(const struct rn_exchange *exchange);
// Continues from a checkpoint: the same bytes as a run that was never interrupted, on a GPU if its
// engine is deterministic. The kernel set is the checkpoint's (RN_ERROR_UNSUPPORTED when this
// machine lacks it); what a GPU trained goes on anywhere.
enum rn_status rn_trainer_restore(struct rn_engine *engine, const struct rn_dataset *dataset,
                                  const char *checkpoint_path, size_t memory_limit_bytes,
                                  struct rn_trainer **ret_trainer,
                                  struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_destroy(struct rn_trainer **trainer);

// Trains for about `budget_ms` (at least one block), or until a limit is reached.
// RN_ERROR_NUMERIC: diverged beyond recovery; the last good state stays readable.
enum rn_status rn_trainer_advance(struct rn_trainer *trainer, double budget_ms,
                                  struct rn_error *err) RN_MUST_CHECK;
// What went wrong in training: a step that left something non-finite behind.
enum rn_incident_kind {
    RN_INCIDENT_RAYS,     // rays were not finite; the step went on without them
    RN_INCIDENT_REJECTED, // a step whose loss or gradients were not finite was not applied
    RN_INCIDENT_ROLLBACK, // back to the last good parameters, at half the rate
    RN_INCIDENT_KINDS
};
enum rn_ray_fault {
    RN_FAULT_NONE, // one of the step's rays, none of which is at fault by itself
    RN_FAULT_COLOUR,
    RN_FAULT_GRADIENT, // only what is backpropagated through the networks is not finite
    RN_FAULTS
};
// One ray as the kernels got it (normalised frame: the scene's ball is the unit ball), and the
// pixel it was drawn through.
struct rn_incident_ray {
    uint32_t id; // of the step's rays
    enum rn_ray_fault fault;
    enum rn_split split;
    int index, scale; // of the photograph
    int x, y;         // pixel
    float origin[3], direction[3], near, length, radius, target[3], weight;
    int stride; // march steps a sample spans
};
struct rn_incident_parameter {
    uint64_t index; // planes, then the networks: as rn_field_sha256
    float value;    // NAN or infinite
};
#define RN_INCIDENT_KEPT 32  // rays and parameters listed
#define RN_INCIDENTS_MOST 64 // of one trainer; later ones are only counted
struct rn_incident {
    enum rn_incident_kind kind;
    int64_t step; // with `seed` it gives the rays, whatever the parameters are
    uint64_t seed;
    double rate;                                   // of the networks, when it happened
    uint64_t nonfinite_rays, nonfinite_parameters; // all of them, listed or not
    float march_step, background[3];
    int ray_count, parameter_count;
    struct rn_incident_ray rays[RN_INCIDENT_KEPT];
    struct rn_incident_parameter parameters[RN_INCIDENT_KEPT];
};
// The oldest incident not taken yet; false when there is none. A few are held between two takes.
bool rn_trainer_take_incident(struct rn_trainer *trainer, struct rn_incident *ret_incident);

// Held-out PSNR, cut into blocks like training, on the CPU of at most 2^18 evenly spread pixels of
// all views, of 2^21 where no later figure can be had; changes no training state. *ret_done when a
// whole round over the held-out views is finished and progress.psnr is new.
enum rn_status rn_trainer_validate(struct rn_trainer *trainer, double budget_ms, bool *ret_done,
                                   struct rn_error *err) RN_MUST_CHECK;
// Whether such a figure can be had. Photographs that are withheld for it may be trained on later in
// the schedule (`give_back`): an advance returns just before, once, so that the last figure is of
// then. Training is the same whether it is asked for or not.
enum rn_figure {
    RN_FIGURE_ANY_TIME,
    RN_FIGURE_LAST, // now or never again
    RN_FIGURE_NONE  // rn_trainer_validate has nothing to look at
};
enum rn_figure rn_trainer_figure(const struct rn_trainer *trainer);
void rn_trainer_progress(const struct rn_trainer *trainer, struct rn_progress *ret_progress);
// One sentence: which views are held out ("8 of 100 validation views", ...).
const char *rn_trainer_held_out(const struct rn_trainer *trainer);
#define RN_WITHHELD "withheld from training" // in it, where they would else be trained on
const struct rn_train_config *rn_trainer_config(const struct rn_trainer *trainer);
// The field as of the last completed update; valid until the next advance.
struct rn_field *rn_trainer_field(struct rn_trainer *trainer);

enum rn_save_part {
    RN_SAVE_ALL,   // what rn_trainer_restore goes on from
    RN_SAVE_FIELD, // without the optimiser: what rn_field_load needs
};
// A checkpoint is written atomically (temporary, fsync, rename) by a thread beside the caller's.
// Completes the step under way and begins to write. *ret_begun is false when the thread was
// preempted before the step was complete: call again. One at a time.
enum rn_status rn_trainer_save_begin(struct rn_trainer *trainer, enum rn_save_part part,
                                     const char *path, bool *ret_begun,
                                     struct rn_error *err) RN_MUST_CHECK;
enum rn_save_stage rn_trainer_save_stage(const struct rn_trainer *trainer);
// Waits for the end. The digest of what was written, as rn_field_sha256.
enum rn_status rn_trainer_save_end(struct rn_trainer *trainer, char ret_sha256[65],
                                   struct rn_error *err) RN_MUST_CHECK;
// All of it at once.
enum rn_status rn_trainer_save(struct rn_trainer *trainer, const char *path,
                               struct rn_error *err) RN_MUST_CHECK;
// Ends the training and keeps its field, which is then as if it had been loaded: rn_field_destroy.
// A device that no longer answers is met by the next render.
struct rn_field *rn_trainer_finish(struct rn_trainer **trainer);

#endif
