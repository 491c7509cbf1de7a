// The engine: a radiance field on one device. What the runner drives; no HTTP, no JSON, no
// policy about when to train or render.
//
// One thread calls into an engine and everything made from it (the engine has its own worker
// threads inside). Work is cut into blocks of a few milliseconds: rn_trainer_advance and
// rn_trainer_validate return after `budget_ms`, or when something else is wanted of the thread, so
// that the caller can render or cancel between.
#ifndef RN_SERVER_ENGINE_ENGINE_H
#define RN_SERVER_ENGINE_ENGINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"
#include "common/dataset/dataset.h"
#include "common/image/image.h"
#include "common/math/camera.h"
#include "server/engine/config.h"

struct rn_engine;  // a device: worker threads, kernel set
struct rn_field;   // parameters and occupancy of one scene, enough to render
struct rn_trainer; // a field, its optimiser, the training pixels

// ---- device ---------------------------------------------------------------------------------

struct rn_engine_options {
    // "cpu", "cuda:N", or "auto": the first GPU where there is one that opens and no kernel set is
    // asked for by name, and the CPU for what it cannot do; NULL = "auto"
    const char *device;
    const char *kernels;        // "auto" (timed), "scalar", "avx2", "avx512", ...; NULL = "auto"
    int threads;                // 0 = all cores this process may use
    size_t device_memory_bytes; // at most of a GPU's memory; 0 = what is free (rn_engine_share)
    bool deterministic;         // a GPU trains the same bytes every time, at a price
};
struct rn_device_info {
    char device[16];     // "cpu", "cuda:0"
    char name[128];      // model
    char kernels[32];    // the kernel set in use; on a GPU its architecture, "sm_90"
    char available[128]; // comma separated kernel sets this machine can run
    int threads;
};
enum rn_status rn_engine_create(const struct rn_engine_options *options,
                                struct rn_engine **ret_engine, struct rn_error *err) RN_MUST_CHECK;
void rn_engine_destroy(struct rn_engine **engine);
// Asked between images while a trainer loads its pixels; false makes rn_trainer_create and
// rn_trainer_restore end with RN_ERROR_CANCELLED. NULL = never.
void rn_engine_watch(struct rn_engine *engine, bool (*keep_going)(void *context), void *context);
// Asked by the calling thread every few milliseconds of training and evaluation: true makes
// rn_trainer_advance and rn_trainer_validate return early, and go on with the next call. It changes
// no number. NULL = never.
void rn_engine_yield_to(struct rn_engine *engine, bool (*wanted)(void *context), void *context);
// Memory that a field is about to take of a GPU; the engine holds none there meanwhile.
struct rn_device_wish {
    const char *device; // "cuda:0"
    size_t bytes;       // that it will hold in all; 0: what it held is given back
    size_t free_bytes;  // on the device, for this and every other process
    bool patient;       // it can wait until others have finished
};
// Asked before memory of a GPU is taken, where several processes share it: `*ret_granted` is
// `bytes` at least, or what there is where it never will be or, when it is not patient, is not now.
// RN_ERROR_CANCELLED while it waits. NULL = the engine may take what its options say.
void rn_engine_share(struct rn_engine *engine,
                     enum rn_status (*share)(void *context, const struct rn_device_wish *wish,
                                             size_t *ret_granted, struct rn_error *err),
                     void *context);
// Gives what a field that is not trained holds of a GPU back; its next picture takes it there
// again.
void rn_field_rest(struct rn_field *field);
void rn_engine_describe(const struct rn_engine *engine, struct rn_device_info *ret_info);

// ---- effects --------------------------------------------------------------------------------

// What a scene calls for. An effect that is off is not computed.
enum rn_effect {
    RN_EFFECT_BACKGROUND,
    RN_EFFECT_SCALE_PYRAMID,
    RN_EFFECT_ANISOTROPY,
    RN_EFFECT_VIEW_DEPENDENCE,
    RN_EFFECT_COUNT
};
struct rn_effect_record {
    const char *name; // "background", "scale-pyramid", "anisotropy", "view-dependence"
    bool on;
    bool decided;     // false: measured later in training (view dependence)
    double number;    // the evidence
    double threshold; // what the number is compared with
    char reason[160]; // one sentence with the number and its unit
};

// ---- training -------------------------------------------------------------------------------

#define RN_PROGRESS_LEVELS 16
struct rn_progress {
    int64_t step;
    double train_seconds;                       // the --max-time clock
    double load_seconds;                        // decoding, before the clock starts
    double evaluate_seconds;                    // held-out evaluation, not on the clock
    double loss;                                // of the last step
    double rays_per_second, samples_per_second; // over the last second or so
    uint64_t samples;                           // field evaluations that entered the loss, total
    uint64_t rays;
    uint64_t level_samples[RN_PROGRESS_LEVELS]; // per ripmap level (the larger of the two axes)
    double psnr;                                // latest held-out figure, dB; NAN before the first
    int64_t psnr_step;
    uint64_t nonfinite_rays, steps_rejected, rollbacks;
    double eta_seconds; // on the clock, NAN when unknown
    double fraction;    // 0..1 of the binding limit, NAN when there is no limit
    bool done;          // a limit is reached: nothing left to train
};

// Decodes the training and held-out pixels, detects effects, carves, initialises. Memory is
// computed first: RN_ERROR_LIMIT says what is needed when it exceeds `memory_limit_bytes` (0 = no
// limit). `dataset` must outlive the trainer.
enum rn_status rn_trainer_create(struct rn_engine *engine, const struct rn_dataset *dataset,
                                 const struct rn_train_config *config, size_t memory_limit_bytes,
                                 struct rn_trainer **ret_trainer,
                                 struct rn_error *err) RN_MUST_CHECK;
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
    RN_FAULT_GRADIENT, // only what goes back through the networks is not finite
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

// Held-out PSNR, cut into blocks like training; changes no training state. *ret_done when a
// whole round over the held-out views is finished and progress.psnr is new.
enum rn_status rn_trainer_validate(struct rn_trainer *trainer, double budget_ms, bool *ret_done,
                                   struct rn_error *err) RN_MUST_CHECK;
void rn_trainer_progress(const struct rn_trainer *trainer, struct rn_progress *ret_progress);
// One sentence: which views are held out ("8 of 100 validation views", ...).
const char *rn_trainer_held_out(const struct rn_trainer *trainer);
const struct rn_train_config *rn_trainer_config(const struct rn_trainer *trainer);
// The field as of the last completed update; valid until the next advance.
struct rn_field *rn_trainer_field(struct rn_trainer *trainer);

// ---- saving ----
// A checkpoint is written atomically (temporary, fsync, rename) by a thread beside the caller's.
enum rn_save_stage {
    RN_SAVE_READS, // the trainer's numbers are being read: render and validate, but do not advance
    RN_SAVE_SYNCS, // they were read: training may go on
    RN_SAVE_OVER,  // rn_trainer_save_end will not wait
};
// Completes the step under way and begins to write. *ret_begun is false when something else was
// wanted of the thread before the step was complete: call again. One at a time.
enum rn_status rn_trainer_save_begin(struct rn_trainer *trainer, const char *path, bool *ret_begun,
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

// ---- fields ---------------------------------------------------------------------------------

// Loads what rendering needs from a checkpoint. Non-finite parameters are refused as corrupt.
enum rn_status rn_field_load(struct rn_engine *engine, const char *checkpoint_path,
                             struct rn_field **ret_field, struct rn_error *err) RN_MUST_CHECK;
void rn_field_destroy(struct rn_field **field); // only for fields from rn_field_load

struct rn_field_info {
    struct rn_train_config config;
    struct rn_bounds bounds;
    int64_t steps;
    double train_seconds;
    double psnr; // last held-out figure, NAN if none
    size_t memory_bytes;
    size_t parameter_count;
    struct rn_effect_record effects[RN_EFFECT_COUNT];
    char kernels[32];
};
void rn_field_describe(const struct rn_field *field, struct rn_field_info *ret_info);
// SHA-256 of the parameters: fp32 little endian, [plane][v][u][channel], then the networks
// (density, then colour; each layer row-major [input][output]). Of a field that a device trains: as
// of the last save.
void rn_field_sha256(const struct rn_field *field, char ret_hex[65]);

// ---- rendering ------------------------------------------------------------------------------

enum rn_output { RN_OUTPUT_RGB = 1, RN_OUTPUT_DEPTH = 2, RN_OUTPUT_ALPHA = 4 };

// All that decides a picture: two requests with equal fields give equal pixels.
struct rn_render_options {
    struct rn_camera camera; // dataset coordinates
    unsigned outputs;        // RN_OUTPUT_* ORed
    float background[3];
    double step; // marching step in scene radii; 0 = as trained
    // Early-stop transmittance; 0 = as trained, or the tolerance where that is larger. A ray that
    // ends earlier than in training counts as opaque.
    double stop;
    int subsample; // render every n-th pixel each way and enlarge; 1 = full
    // Cones a side of a pixel, 1, 2, 4, 8 or 16; 0 = as many as make them as narrow as the finest
    // that the field was trained on, where its configuration asks for that, else 1.
    int supersample;
    // A pixel whose four nearest neighbours agree to within this is their mean and is not traced
    // (render/lattice.h): the root mean square distance from that mean of the outputs asked for,
    // at most 0.5. Of pixels of several cones their quarters are meant. 0 = every pixel is traced,
    // and always on a device other than the CPU.
    double tolerance;
};
struct rn_render_stats {
    double render_ms;
    int cones;               // a side of a pixel
    uint64_t rays, samples;  // samples: field evaluations
    uint64_t nonfinite_rays; // of which something was no finite number, and replaced
};
struct rn_render_result {
    struct rn_picture rgb, depth, alpha; // those asked for; the others are zero
    struct rn_render_stats stats;
};
// Renders in tiles. `keep_going` (may be NULL) is polled between tiles; false stops with
// RN_ERROR_CANCELLED. Depth is the distance along the ray over opacity, dataset units, 0 where
// nothing was hit. Every value written is finite.
enum rn_status rn_render(struct rn_engine *engine, struct rn_field *field,
                         const struct rn_render_options *options, bool (*keep_going)(void *context),
                         void *context, struct rn_render_result *ret_result,
                         struct rn_error *err) RN_MUST_CHECK;
void rn_render_result_finish(struct rn_render_result *result);

// One view against its photograph, composited over the options' background. Of the options, camera
// and outputs are not looked at.
struct rn_view_score {
    double psnr, ssim, render_ms;
    uint64_t nonfinite_rays; // as of a rendering
};
enum rn_status rn_evaluate_view(struct rn_engine *engine, struct rn_field *field,
                                const struct rn_frame *frame,
                                const struct rn_render_options *options,
                                bool (*keep_going)(void *context), void *context,
                                struct rn_view_score *ret_score,
                                struct rn_error *err) RN_MUST_CHECK;

#endif
