// Checkpoints: one safetensors file with parameters, optimiser, occupancy, counters and config.
//
// Tensors: planes F32 [plane][v][u][channel]; base.N and head.N F32 [input][output] (the colour
// network's last layer is padded to 16 outputs, columns 3.. are zero); adam.m and adam.v F32, in
// the order of all the former; occupancy F32 and hull U8 [x][y][z], and seen F32 where cells are
// kept by what they show; draw.error and draw.share F32 of the blocks that rays are drawn from,
// where they are drawn by error; poses F32 [photograph][move] where they are refined; outliers U8
// of the photographs' blocks that are left out, where some are. Everything else is one JSON object
// in __metadata__["ripnerf"]; __metadata__["sha256"] is the file's seal. Random numbers need no
// state: they are counters of the step. A file for viewing (viewing.h) holds other tensors.
#ifndef RN_ENGINE_CHECKPOINT_CHECKPOINT_H
#define RN_ENGINE_CHECKPOINT_CHECKPOINT_H

#include "server/engine/field/disparity.h"
#include "server/engine/scene/engine.h"
#include "server/engine/scene/progress.h"

struct json_t;

// Where a training is, besides its arrays.
struct rn_counters {
    struct rn_progress progress;
    int64_t updates;      // steps that were not rejected, since the last rollback
    int next_rays;        // of the next step
    float gradient_scale; // a device's (cuda/README.md); 0 at the start
    int good_steps;       // since it was last changed
    float gradient_size;  // a device's, for the roulette (kernels/backend.h)
    int pose_turns;       // of poses that are refined (train/poses.h)
    int outlier_turns;    // of outliers that are left out (train/outliers.h)
};
// The arrays of a field and of its training. Owner: the field and the trainer.
struct rn_arrays {
    struct rn_field *field;
    float *m, *v;       // the optimiser's moments; NULL: of the field alone
    uint32_t *seen;     // NULL, or what cells showed since the last round (train/seen.c)
    size_t block_count; // that rays are drawn from, where they are drawn by error; else 0
    float *block_error, *block_share;
    size_t pose_count;    // photographs, where their poses are refined; else 0
    float *poses;         // of each RN_POSE_UNKNOWNS numbers
    size_t outlier_count; // blocks of photographs, where some are left out; else 0
    uint8_t *outliers;
};

// An open checkpoint: header read and checked, tensors not yet. Owner: rn_checkpoint_close.
struct rn_checkpoint {
    char path[4096];
    struct rn_train_config config;
    struct rn_bounds bounds;
    struct rn_disparity disparity;
    double finest_cone;
    char kernels[32];
    struct rn_effect_record effects[RN_EFFECT_COUNT];
    struct rn_counters counters;
    struct rn_viewing viewing; // of 0 bits: it is no file for viewing
    bool has_trainer;          // optimiser state is in the file
    struct json_t *header;     // the parsed JSON
    int fd;
    uint64_t data_start;
};

// RN_ERROR_NOT_FOUND; RN_ERROR_CORRUPT names what is wrong with the file.
enum rn_status rn_checkpoint_open(const char *path, struct rn_checkpoint *ret_checkpoint,
                                  struct rn_error *err) RN_MUST_CHECK;
void rn_checkpoint_close(struct rn_checkpoint *checkpoint);
// Fill a field, or the arrays of a training, made for checkpoint->config. Non-finite numbers are
// RN_ERROR_CORRUPT.
enum rn_status rn_checkpoint_read_field(const struct rn_checkpoint *checkpoint,
                                        struct rn_field *field, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_checkpoint_read_arrays(const struct rn_checkpoint *checkpoint,
                                         const struct rn_arrays *arrays,
                                         struct rn_error *err) RN_MUST_CHECK;
// Their blocks alone, once they are listed.
enum rn_status rn_checkpoint_read_blocks(const struct rn_checkpoint *checkpoint,
                                         const struct rn_arrays *arrays,
                                         struct rn_error *err) RN_MUST_CHECK;
// Bytes of memory that such a field takes, with all levels that a picture may need.
enum rn_status rn_field_need(const char *checkpoint_path, size_t *ret_bytes,
                             struct rn_error *err) RN_MUST_CHECK;
// Loads what rendering needs from a checkpoint. Non-finite parameters are refused as corrupt.
enum rn_status rn_field_load(struct rn_engine *engine, const char *checkpoint_path,
                             struct rn_field **ret_field, struct rn_error *err) RN_MUST_CHECK;

enum rn_save_stage {
    RN_SAVE_READS, // the trainer's numbers are being read: render and validate, but do not advance
    RN_SAVE_SYNCS, // they were read: training may go on
    RN_SAVE_OVER,  // rn_trainer_save_end will not wait
};
// A checkpoint that a thread of its own writes. Thread-safety: one thread calls these functions.
// Owner: whoever began it.
struct rn_checkpoint_writer;
// Temporary file, fsync, rename, fsync of the folder: seen whole or not at all. Changes no state.
// The arrays are read until the stage is no longer RN_SAVE_READS.
enum rn_status rn_checkpoint_begin(const struct rn_arrays *arrays,
                                   const struct rn_counters *counters, const char *path,
                                   struct rn_checkpoint_writer **ret_writer,
                                   struct rn_error *err) RN_MUST_CHECK;
enum rn_save_stage rn_checkpoint_stage(const struct rn_checkpoint_writer *writer);
// Waits for the end; the digest is that of rn_field_sha256.
enum rn_status rn_checkpoint_end(struct rn_checkpoint_writer **writer, char ret_sha256[65],
                                 struct rn_error *err);

#endif
