// Which system calls a process may make: a filter in the kernel (seccomp), for good.
#ifndef RN_SERVER_RUNNER_SANDBOX_CALLS_H
#define RN_SERVER_RUNNER_SANDBOX_CALLS_H

#include "server/runner/sandbox/profile.h"

// For all threads. Refused calls fail with EPERM, and where the profile has listed calls, all that
// are not on the list with ENOSYS. no_new_privs must be set. That the kernel has no filters is
// logged.
void rn_calls_filter(const struct rn_profile *profile);

#endif
