// Files for viewing: a scene without its optimiser, its planes in fewer bits where that is wanted.
//
// A checkpoint (checkpoint.h) with other tensors: planes as F32, as F16, or as U8 codes of blocks
// with planes.low and planes.step F16 (blocks.h); base.N and head.N as they are; cells U8, a bit a
// cell of the occupancy grid as it is marched, [x][y][z], the lowest bit first. `viewing` in its
// state says what it lost. rn_field_load reads it as any checkpoint.
#ifndef RN_ENGINE_CHECKPOINT_VIEWING_H
#define RN_ENGINE_CHECKPOINT_VIEWING_H

#include "server/engine/checkpoint/checkpoint.h"

#define RN_VIEWING_FORMAT 1
#define RN_VIEWING_FORMS 6

// Bits of a value, from the smallest file on: 4, 5, 6, 8, 16, 32.
extern const int rn_viewing_bits[RN_VIEWING_FORMS];
bool rn_viewing_has_bits(int bits);

// Bytes of the file, whatever `viewing` says.
size_t rn_viewing_bytes(const struct rn_field *field, int bits);
// Writes the field as it is, seen whole or not at all. RN_ERROR_LIMIT where its planes hold what no
// half does (beyond 65504), for fewer than 32 bits.
enum rn_status rn_viewing_write(struct rn_field *field, const struct rn_viewing *viewing,
                                const char *path, struct rn_error *err) RN_MUST_CHECK;
// The field's parameters and cells of a file for viewing; part of rn_checkpoint_read_field.
enum rn_status rn_viewing_read(const struct rn_checkpoint *checkpoint, struct rn_field *field,
                               struct rn_error *err) RN_MUST_CHECK;

#endif
