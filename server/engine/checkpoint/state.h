// A checkpoint's parts: the list of its tensors, and the JSON with config, counters, effects.
#ifndef RN_ENGINE_CHECKPOINT_STATE_H
#define RN_ENGINE_CHECKPOINT_STATE_H

#include <jansson.h>

#include "server/engine/checkpoint/checkpoint.h"
#include "server/engine/field/mlp.h"

#define RN_CHECKPOINT_TENSORS 32

struct rn_tensor {
    char name[24];
    const char *dtype; // "F32", "F16" or "U8"
    int rank;
    size_t shape[4];
    void *data; // the field's or the trainer's
    size_t bytes;
};
// The tensors in the order of the file: the field's, with moments also these. Returns how many; the
// same list for writing and reading.
int rn_checkpoint_tensors(const struct rn_arrays *arrays,
                          struct rn_tensor list[RN_CHECKPOINT_TENSORS]);
// Appends one tensor, or those of a network's layers, "PREFIX.N".
void rn_checkpoint_add(struct rn_tensor *list, int *count, const char *name, const char *dtype,
                       int rank, const size_t *shape, void *data);
void rn_checkpoint_add_network(struct rn_tensor *list, int *count, const char *prefix,
                               const struct rn_mlp_shape *shape, float *weights);
// Appends photographs' appearances, where the field has such.
void rn_checkpoint_add_appearances(struct rn_tensor *list, int *count,
                                   const struct rn_field *field);
// Reads them; what is missing, misshapen or not finite is RN_ERROR_CORRUPT.
enum rn_status rn_checkpoint_read_list(const struct rn_checkpoint *checkpoint,
                                       const struct rn_tensor *list, int count,
                                       struct rn_error *err) RN_MUST_CHECK;
// Appends those of the blocks to a list of `count`; returns how many there are then.
int rn_checkpoint_add_blocks(const struct rn_arrays *arrays, struct rn_tensor *list, int count);

// A new object, or NULL when out of memory. viewing: what a file for viewing says of itself, NULL
// of a checkpoint.
json_t *rn_checkpoint_state(const struct rn_field *field, const struct rn_counters *counters,
                            const struct rn_viewing *viewing);
// RN_ERROR_CORRUPT names the field.
enum rn_status rn_checkpoint_parse_state(const json_t *state, const char *path,
                                         struct rn_checkpoint *checkpoint,
                                         struct rn_error *err) RN_MUST_CHECK;

// The file's header: the state and where each tensor lies; malloc, NULL when out of memory.
char *rn_checkpoint_header(const struct rn_field *field, const struct rn_counters *counters,
                           const struct rn_viewing *viewing, const struct rn_tensor *list,
                           int count);
// Writes the header, padded with blanks to a multiple of `multiple` bytes, and the tensors. false:
// errno.
bool rn_checkpoint_put(int fd, const char *header, size_t multiple, const struct rn_tensor *list,
                       int count);
// What is written becomes `path`, sealed, or is removed. Closes `fd`. 0 or errno, `error` where
// that is one already.
int rn_checkpoint_settle(int fd, int error, const char *temporary, const char *path,
                         char ret_sha256[65]);

#endif
