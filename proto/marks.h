// The marks of a scene: what its field was at a few moments of its training, for looking back.
//
// A mark is a checkpoint without the optimiser, in the scene's folder:
// marks/MILLISECONDS-STEP.safetensors, both with nine digits or more. They are kept at
// RN_MARK_FIRST_S times a power of two of training seconds, the newest RN_MARKS_KEPT of them.
#ifndef RN_PROTO_MARKS_H
#define RN_PROTO_MARKS_H

#include <limits.h>

#include "proto/codec.h"

#define RN_MARK_FIRST_S 3.75 // so that there is one at 15 s and at 60 s
#define RN_MARKS_KEPT 8
#define RN_MARK_APART 1.5 // times a mark's seconds, as far as it may be from what is asked for

struct rn_mark {
    double train_seconds;
    int64_t step, size_bytes;
};
extern const struct rn_table rn_mark_table;

// The marks of a scene's folder by time, at most RN_MARKS_KEPT, the newest ones. None where the
// folder cannot be read. Returns how many.
size_t rn_marks_list(const char *scene_folder, struct rn_mark ret_marks[RN_MARKS_KEPT]);
// RN_ERROR_LIMIT: the path is too long.
enum rn_status rn_mark_path(const char *scene_folder, const struct rn_mark *mark,
                            char ret_path[PATH_MAX], struct rn_error *err) RN_MUST_CHECK;
// The one nearest to a time, by ratio. RN_ERROR_INVALID at "#/at" tells which times there are,
// where none is within RN_MARK_APART of it.
enum rn_status rn_mark_nearest(const struct rn_mark *marks, size_t count, double train_seconds,
                               size_t *ret_nearest, struct rn_error *err) RN_MUST_CHECK;
// The training second of the next mark after this one.
double rn_mark_next(double train_seconds);

// For the runner, whose folder it is: removes marks beyond the newest RN_MARKS_KEPT, and those of
// steps after `step`, which a resumed training has undone.
void rn_marks_prune(const char *scene_folder, int64_t step);

#endif
