// A device to train and render on, and what is known of a field on it: what callers of the engine
// see of both.
#ifndef RN_ENGINE_SCENE_ENGINE_H
#define RN_ENGINE_SCENE_ENGINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"
#include "common/dataset/dataset.h"
#include "common/settings/train.h"
#include "server/engine/scene/effect.h"

struct rn_exchange; // other ranks
struct rn_engine;   // a device: worker threads, kernel set
struct rn_field;    // parameters and occupancy of one scene, enough to render

struct rn_engine_options {
    // "cpu", "cuda:N", or "auto": the first GPU where there is one that opens and no kernel set is
    // asked for by name, and the CPU for what it cannot do; NULL = "auto"
    const char *device;
    const char *kernels;        // "auto" (timed), "generic", "avx2", ...; NULL = "auto"
    int threads;                // 0 = all cores this process may use
    size_t device_memory_bytes; // at most of a GPU's memory; 0 = what is free (rn_engine_share)
    bool deterministic;         // a GPU trains the same bytes every time, at a price
    // A GPU sums the gradient of the density network's last layer beside its backward: another
    // order of the sums. Which is quicker is not known; tests/bench/cuda times both.
    bool last_on_chip;
    // Its warps take two tiles of 16 samples at a time through the backward: the same bytes.
    // Likewise.
    bool two_tiles;
};
struct rn_device_info {
    char device[16];     // "cpu", "cuda:0"
    char name[128];      // model
    char kernels[32];    // the kernel set in use; on a GPU its architecture, "sm_90"
    char available[128]; // comma separated kernel sets this machine can run
    char checked[240]; // with "auto": how a GPU agrees with the CPU, or why it is not used; else ""
    int threads;
};
enum rn_status rn_engine_create(const struct rn_engine_options *options,
                                struct rn_engine **ret_engine, struct rn_error *err) RN_MUST_CHECK;
void rn_engine_destroy(struct rn_engine **engine);
// Where photographs that are more than may lie in memory are kept while they are trained on; NULL:
// nowhere, they must fit. A path that is longer than RN_ENGINE_FOLDER_MAX is none.
#define RN_ENGINE_FOLDER_MAX 4096
void rn_engine_keep_in(struct rn_engine *engine, const char *folder);
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
// The ranks that this process was started with, through the module that joins them
// (kernels/exchange.h), for good. RN_ERROR_UNSUPPORTED: it is not installed, or they are too many.
enum rn_status rn_exchange_open(const struct rn_exchange **ret_exchange,
                                struct rn_error *err) RN_MUST_CHECK;
// Trainers that are made from here on train with the other ranks, on the CPU; NULL: alone, as at
// first.
void rn_engine_join(struct rn_engine *engine, const struct rn_exchange *exchange);
void rn_engine_describe(const struct rn_engine *engine, struct rn_device_info *ret_info);

// ---- fields ---------------------------------------------------------------------------------

void rn_field_destroy(struct rn_field **field); // of one that no trainer has

// What a file for viewing is (checkpoint/viewing.h), and what it lost. A field that came from one
// renders as any other, and is never trained further.
struct rn_viewing {
    int bits; // of a value of the planes: 32 as trained, 16 half, fewer in blocks; 0: none
    double psnr, trained; // dB: its pictures' mean, and those of the scene it is of
    int views;            // that both are means over
    char split[8];        // of which these are
    char dataset[80];     // what the dataset is called where it was made
    char sha256[65];      // of the parameters that it is of
    char version[32];     // of the program that wrote it
    bool has_start; // files of older builds tell none: of a disparity box it is told on reading
    struct rn_camera start; // where to begin to look, without a lens
    double up[3];           // the scene's, a unit vector
};

struct rn_field_info {
    struct rn_train_config config;
    struct rn_bounds bounds;
    double finest_cone; // radius at the scene's centre of the finest training pixel's cone, dataset
                        // units; 0: not known
    int64_t steps;
    double train_seconds;
    double psnr; // last held-out figure, NAN if none
    size_t memory_bytes;
    size_t parameter_count;
    struct rn_effect_record effects[RN_EFFECT_COUNT];
    char kernels[32];
    struct rn_viewing viewing; // of 0 bits: it was trained here
};
void rn_field_describe(const struct rn_field *field, struct rn_field_info *ret_info);
// In what light a photograph of the place was taken (effect appearance): the code of it. 0: the
// mean of all, in which pictures are.
struct rn_appearance {
    bool own;
    float code[RN_APPEARANCE];
};
// That of a photograph of its dataset, by its number among the frames; the mean where the field
// does not know it.
struct rn_appearance rn_field_appearance(const struct rn_field *field, size_t photograph);
// SHA-256 of the parameters: fp32 little endian, [plane][v][u][channel], then the networks
// (density, then colour; each layer row-major [input][output]). Of a field that a device trains: as
// of the last save.
void rn_field_sha256(const struct rn_field *field, char ret_hex[65]);

#endif
