// The checkpoints of a scene: SCENE/checkpoints/step-%09d.safetensors, the newest
// RN_CHECKPOINTS_KEPT (proto/scene.h) of them.
#ifndef RN_SERVER_RUNNER_SCENE_CHECKPOINTS_H
#define RN_SERVER_RUNNER_SCENE_CHECKPOINTS_H

#include <limits.h>
#include <stdint.h>

#include "common/base/status.h"

// Thread-safety: the folder belongs to the process that holds the scene's lock.

// Makes the folder, and that of marks, and removes what an interrupted write has left there.
enum rn_status rn_checkpoints_prepare(const char *scene_folder, struct rn_error *err) RN_MUST_CHECK;
// The file's name and path for a step.
void rn_checkpoint_name(int64_t step, char ret_name[64]);
enum rn_status rn_checkpoint_path(const char *scene_folder, int64_t step, char ret_path[PATH_MAX],
                                  struct rn_error *err) RN_MUST_CHECK;
// The highest step below `before`; RN_ERROR_NOT_FOUND when there is none.
enum rn_status rn_checkpoints_newest(const char *scene_folder, int64_t before, int64_t *ret_step,
                                     struct rn_error *err) RN_MUST_CHECK;
// Removes all but the newest. What cannot be removed is logged.
void rn_checkpoints_prune(const char *scene_folder);
// Whether an error says that this checkpoint (and not, say, a photograph) is damaged.
bool rn_checkpoint_is_damaged(enum rn_status status, const struct rn_error *err, const char *path);
// Renames a damaged checkpoint to NAME.damaged, so that it is not tried again, logs it and tells in
// ret_told which one, and why.
void rn_checkpoint_set_aside(const char *scene_folder, int64_t step, const struct rn_error *why,
                             char ret_told[512]);

#endif
