// Mode ingest, of a scene: a file for viewing becomes a scene's only checkpoint.
#ifndef RN_SERVER_RUNNER_INGEST_ADOPT_H
#define RN_SERVER_RUNNER_INGEST_ADOPT_H

#include "proto/wire_messages.h"

// Checks the file's seal, loads it as a render would and copies it into the folder order->target.
// *ret_json: JSON of rn_wire_checkpoint, malloc'd. RN_ERROR_CORRUPT, RN_ERROR_UNSUPPORTED of a
// newer format, RN_ERROR_INVALID of a checkpoint that a training goes on from.
enum rn_status rn_scene_adopt(const struct rn_wire_ingest *order, char **ret_json,
                              struct rn_error *err) RN_MUST_CHECK;

#endif
