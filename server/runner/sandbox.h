// What a runner may do, for it decodes strangers' files: two steps, each for good.
//
// The profiles of modes: ingest reads its source and writes its target; field reads its dataset and
// writes its scene and the frames of its jobs; both start no program and open no network. What the
// kernel lacks is logged and left out: seccomp is Linux 3.5, Landlock 5.13, its network part 6.7.
#ifndef RN_SERVER_RUNNER_SANDBOX_H
#define RN_SERVER_RUNNER_SANDBOX_H

#include <stdbool.h>
#include <stdint.h>

// At the start, before a message is read: no privileges are gained any more, no core is dumped, and
// system calls that no mode needs fail with EPERM: other programs, sockets, namespaces, mounts,
// tracing, modules, keys, other users. Costs a computation nothing.
void rn_sandbox_begin(void);

struct rn_sandbox_places {
    const char *const *read;  // files and folders, NULL-terminated; those that are not there are
    const char *const *write; // passed over
    const char *const *tidy;  // folders below which empty ones may be removed; NULL: none
    int64_t memory_bytes;     // of the process's own data; 0: no limit
    int64_t file_bytes;       // the largest file; 0: no limit
};
// Once it is known what the work needs: nothing else of the disk is seen but the system's folders
// and the program's own, and no TCP. `false`: this kernel has no Landlock.
bool rn_sandbox_confine(const struct rn_sandbox_places *places);

#endif
