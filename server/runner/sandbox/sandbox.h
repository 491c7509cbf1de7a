// What a runner may do, for it decodes strangers' files: two steps, each for good, by the profile
// of its mode (profile.h).
//
// What the kernel lacks is logged and left out: seccomp is Linux 3.5, Landlock 5.13, its network
// part 6.7.
#ifndef RN_SERVER_RUNNER_SANDBOX_SANDBOX_H
#define RN_SERVER_RUNNER_SANDBOX_SANDBOX_H

#include <stdbool.h>
#include <stdint.h>

#include "server/runner/sandbox/profile.h"

// At the start, before a message is read: no privileges are gained any more, no core is dumped, and
// system calls that the mode does not need fail with EPERM: sockets, namespaces, mounts, tracing,
// modules, keys, other users, and other programs where the profile has none. Costs a computation
// nothing.
void rn_sandbox_begin(const struct rn_profile *profile);

struct rn_sandbox_places {
    const char *paths[RN_PLACE_COUNT]; // NULL, and what is not there: passed over
    int64_t memory_bytes;              // that the work may take of data; 0: no limit
    int64_t file_bytes;                // the largest file; 0: no limit
};
// Once it is known what the work needs: nothing else of the disk is seen but the system's folders
// and the program's own, no program is started but the profile's, and no TCP. `false`: this kernel
// has no Landlock.
bool rn_sandbox_confine(const struct rn_profile *profile, const struct rn_sandbox_places *places);

#endif
