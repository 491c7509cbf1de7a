// A checkpoint's parts: the list of its tensors, and the JSON with config, counters, effects.
#ifndef RN_ENGINE_CHECKPOINT_STATE_H
#define RN_ENGINE_CHECKPOINT_STATE_H

#include <jansson.h>

#include "server/engine/checkpoint/checkpoint.h"

#define RN_CHECKPOINT_TENSORS 32

struct rn_tensor {
    char name[24];
    const char *dtype; // "F32" or "U8"
    int rank;
    size_t shape[4];
    void *data; // the field's or the trainer's
    size_t bytes;
};
// The tensors in the order of the file: the field's, with moments also these. Returns how many; the
// same list for writing and reading.
int rn_checkpoint_tensors(const struct rn_arrays *arrays,
                          struct rn_tensor list[RN_CHECKPOINT_TENSORS]);
// Appends those of the blocks to a list of `count`; returns how many there are then.
int rn_checkpoint_add_blocks(const struct rn_arrays *arrays, struct rn_tensor *list, int count);

// A new object, or NULL when out of memory.
json_t *rn_checkpoint_state(const struct rn_field *field, const struct rn_counters *counters);
// RN_ERROR_CORRUPT names the field.
enum rn_status rn_checkpoint_parse_state(const json_t *state, const char *path,
                                         struct rn_checkpoint *checkpoint,
                                         struct rn_error *err) RN_MUST_CHECK;

#endif
