// The JSON half of a checkpoint: config, counters, effects.
#ifndef RN_ENGINE_CHECKPOINT_STATE_H
#define RN_ENGINE_CHECKPOINT_STATE_H

#include <jansson.h>

#include "server/engine/checkpoint.h"

// A new object, or NULL when out of memory.
json_t *rn_checkpoint_state(const struct rn_trainer *trainer);
// RN_ERROR_CORRUPT names the field.
enum rn_status rn_checkpoint_parse_state(const json_t *state, const char *path,
                                         struct rn_checkpoint *checkpoint,
                                         struct rn_error *err) RN_MUST_CHECK;

#endif
