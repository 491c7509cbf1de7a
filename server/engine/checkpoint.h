// Checkpoints: one safetensors file with parameters, optimiser, occupancy, counters and config.
//
// Tensors: planes F32 [plane][v][u][channel]; base.N and head.N F32 [input][output] (the colour
// network's last layer is padded to 16 outputs, columns 3.. are zero); adam.m and adam.v F32, in
// the order of all the former; occupancy F32 and hull U8 [x][y][z]; draw.error and draw.share F32
// of the blocks that rays are drawn from, where they are drawn by error. Everything else is one
// JSON object in __metadata__["ripnerf"]. Random numbers need no state: they are counters of the
// step.
#ifndef RN_ENGINE_CHECKPOINT_H
#define RN_ENGINE_CHECKPOINT_H

#include "server/engine/train/trainer.h"

// An open checkpoint: header read and checked, tensors not yet. Owner: rn_checkpoint_close.
struct rn_checkpoint {
    char path[4096];
    struct rn_train_config config;
    struct rn_bounds bounds;
    char kernels[32];
    struct rn_effect_record effects[RN_EFFECT_COUNT];
    struct rn_progress progress;
    int64_t updates;
    int next_rays;
    float gradient_scale;
    int good_steps;
    float gradient_size;
    bool has_trainer; // optimiser state is in the file
    void *header;     // the parsed JSON
    int fd;
    uint64_t data_start;
};

// RN_ERROR_NOT_FOUND; RN_ERROR_CORRUPT names what is wrong with the file.
enum rn_status rn_checkpoint_open(const char *path, struct rn_checkpoint *ret_checkpoint,
                                  struct rn_error *err) RN_MUST_CHECK;
void rn_checkpoint_close(struct rn_checkpoint *checkpoint);
// Fill a field or trainer made for checkpoint->config. Non-finite numbers are RN_ERROR_CORRUPT.
enum rn_status rn_checkpoint_read_field(const struct rn_checkpoint *checkpoint,
                                        struct rn_field *field, struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_checkpoint_read_trainer(const struct rn_checkpoint *checkpoint,
                                          struct rn_trainer *trainer,
                                          struct rn_error *err) RN_MUST_CHECK;
// After the trainer's live blocks are listed: how they are drawn.
enum rn_status rn_checkpoint_read_importance(const struct rn_checkpoint *checkpoint,
                                             struct rn_trainer *trainer,
                                             struct rn_error *err) RN_MUST_CHECK;

// A checkpoint that a thread of its own writes. Thread-safety: one thread calls these functions.
// Owner: whoever began it.
struct rn_checkpoint_writer;
// Temporary file, fsync, rename, fsync of the folder: seen whole or not at all. Changes no state.
// The trainer's numbers are read until the stage is no longer RN_SAVE_READS.
enum rn_status rn_checkpoint_begin(const struct rn_trainer *trainer, const char *path,
                                   struct rn_checkpoint_writer **ret_writer,
                                   struct rn_error *err) RN_MUST_CHECK;
enum rn_save_stage rn_checkpoint_stage(const struct rn_checkpoint_writer *writer);
// Waits for the end; the digest is that of rn_field_sha256.
enum rn_status rn_checkpoint_end(struct rn_checkpoint_writer **writer, char ret_sha256[65],
                                 struct rn_error *err);

#endif
