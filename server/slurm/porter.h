// Carries files and messages between the control and a runner that shares no folder with it.
#ifndef RN_SERVER_SLURM_PORTER_H
#define RN_SERVER_SLURM_PORTER_H

#include "common/base/status.h"

// A thread of its own. Owner: whoever started it.
struct rn_porter;

// Takes the runner's connection over, a non-blocking stream socket. `scene`: the name by which the
// runner knows its scene's folder, and by which files are put there; `log`: where its words go, or
// NULL. *ret_fd is the control's end of the conversation, the caller's; it ends with the runner.
enum rn_status rn_porter_start(int fd, const char *scene, const char *log, int *ret_fd,
                               struct rn_porter **ret_porter, struct rn_error *err) RN_MUST_CHECK;
// Hangs up on both and waits for the thread. Nothing is written from here on.
void rn_porter_stop(struct rn_porter **porter);

#endif
