// The lock on a scene's folder: one runner at a time, whatever became of the one before.
#ifndef RN_SERVER_RUNNER_SCENE_LOCK_H
#define RN_SERVER_RUNNER_SCENE_LOCK_H

#include "server/runner/link/link.h"

// Takes FOLDER/lock and writes into it who holds it. A runner of a daemon that is gone has a moment
// to save and leave; then it is killed, so that one that hangs or was stopped cannot keep the
// scene. RN_ERROR_BUSY when the holder is no such runner and does not let go in 15 s, or the end is
// asked for. *ret_fd: closing it gives the lock back.
enum rn_status rn_lock_scene(const char *folder, struct rn_link *link, int *ret_fd,
                             struct rn_error *err) RN_MUST_CHECK;

#endif
