// The way of a runner on another machine to its daemon: over TCP, with a secret that lies in a
// shared folder (proto/join.h).
#ifndef RN_SERVER_RUNNER_LINK_JOIN_H
#define RN_SERVER_RUNNER_LINK_JOIN_H

#include <stddef.h>

#include "common/base/status.h"

// Waits for the secret, which a daemon that was started anew has yet to leave, and connects.
// *ret_fd is then as the one that a daemon on this machine passes on; SIGTERM, by which a cluster
// announces the end, closes it for reading, which makes the runner save and leave.
// RN_ERROR_NOT_FOUND: the folder is not there, or no secret came; RN_ERROR_UNAUTHORISED: what
// listens there is not the daemon; RN_ERROR_UNAVAILABLE: nothing does.
enum rn_status rn_join_daemon(const char *folder, int *ret_fd, struct rn_error *err) RN_MUST_CHECK;

// The same by a secret that stands on `from`, for the runner of this name; SIGTERM is the caller's.
enum rn_status rn_join_daemon_by(int from, const char *name, int *ret_fd,
                                 struct rn_error *err) RN_MUST_CHECK;

// The name of this machine, or of the node of a cluster that this process is on.
void rn_machine_name(char ret_name[64]);

// What a result says of where it came about: the processor's name, of a cluster the node's too.
void rn_machine_text(const char *processor, char *ret_text, size_t size);

#endif
