// What a training takes of memory, known before anything is loaded.
#ifndef RN_ENGINE_TRAIN_MEMORY_H
#define RN_ENGINE_TRAIN_MEMORY_H

#include <stddef.h>

#include "common/base/status.h"

struct rn_trainer;

// Levels that the photographs to train on need.
int rn_trainer_levels(const struct rn_trainer *trainer);
// Bytes at its largest, with the photographs that are held decoded, the held-out ones included.
size_t rn_trainer_bytes(const struct rn_trainer *trainer);
// Of `limit` bytes (0: no limit) what is left for photographs. RN_ERROR_LIMIT where nothing is.
enum rn_status rn_trainer_check_memory(const struct rn_trainer *trainer, size_t limit,
                                       size_t *ret_left, struct rn_error *err) RN_MUST_CHECK;
// Returns `status`. Where it is RN_ERROR_NO_MEMORY of the host and there is a trainer, which may be
// unfinished, the error says how much a training needs and what takes less.
enum rn_status rn_trainer_lacks_memory(const struct rn_trainer *trainer, enum rn_status status,
                                       struct rn_error *err);

#endif
