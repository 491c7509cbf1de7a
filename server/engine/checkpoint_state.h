// A checkpoint's parts: the list of its tensors, and the JSON with config, counters, effects.
#ifndef RN_ENGINE_CHECKPOINT_STATE_H
#define RN_ENGINE_CHECKPOINT_STATE_H

#include <jansson.h>

#include "server/engine/checkpoint.h"

#define RN_CHECKPOINT_TENSORS 32

struct rn_tensor {
    char name[24];
    const char *dtype; // "F32" or "U8"
    int rank;
    size_t shape[4];
    void *data; // the field's or the trainer's
    size_t bytes;
};
// The tensors of a field, with m and v also the optimiser's, in the order of the file; returns how
// many. The same list for writing and reading.
int rn_checkpoint_tensors(struct rn_field *field, float *m, float *v,
                          struct rn_tensor list[RN_CHECKPOINT_TENSORS]);
// Appends those of how rays are drawn to a list of `count`; returns how many there are then.
int rn_checkpoint_add_importance(const struct rn_importance *importance, struct rn_tensor *list,
                                 int count);

// A new object, or NULL when out of memory.
json_t *rn_checkpoint_state(const struct rn_trainer *trainer);
// RN_ERROR_CORRUPT names the field.
enum rn_status rn_checkpoint_parse_state(const json_t *state, const char *path,
                                         struct rn_checkpoint *checkpoint,
                                         struct rn_error *err) RN_MUST_CHECK;

#endif
