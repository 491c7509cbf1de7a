// POST /v1/backup: what came of a backup that was taken in.
#ifndef RN_PROTO_ADOPTED_H
#define RN_PROTO_ADOPTED_H

#include "proto/codec.h"

// How many of each joined; what was there already is not counted.
struct rn_adopted_record {
    int64_t datasets, scenes, camera_paths, jobs;
};
extern const struct rn_table rn_adopted_table;

#endif
