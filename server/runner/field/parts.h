// What a job keeps of each of its units: a file a unit in a folder, for the attempt after this one,
// and for runners that make parts of it beside the one that has the job.
#ifndef RN_SERVER_RUNNER_FIELD_PARTS_H
#define RN_SERVER_RUNNER_FIELD_PARTS_H

#include <limits.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

// Thread-safety: plain value, its texts are the caller's.
struct rn_parts {
    const char *folder, *ending; // FOLDER/%05zu.ending
    size_t first;                // number of unit 0
    int64_t begin;               // of a runner that helps, its first number; RN_ABSENT of others
};

// The units from..to of `count`, by number; RN_ERROR_INVALID when they are not among them.
enum rn_status rn_parts_take(struct rn_parts *parts, int64_t begin, int64_t end, size_t count,
                             size_t *ret_units, struct rn_error *err) RN_MUST_CHECK;
// Files of an earlier attempt are kept when they show the same step; a hidden file tells. Others of
// `units` are removed, or RN_ERROR_CONFLICT for a runner that helps.
enum rn_status rn_parts_begin(const struct rn_parts *parts, int64_t step, size_t units,
                              struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_parts_file(const struct rn_parts *parts, size_t unit, char ret_path[PATH_MAX],
                             struct rn_error *err) RN_MUST_CHECK;
// Whether the unit's file is there, or cannot be named.
bool rn_parts_has(const struct rn_parts *parts, size_t unit);
// One that helps may make a unit at the same moment as the one that has the job: the same bytes,
// under a name of its own until it is whole.
enum rn_status rn_parts_write(const struct rn_parts *parts, const char *path, const void *bytes,
                              size_t size, struct rn_error *err) RN_MUST_CHECK;

#endif
