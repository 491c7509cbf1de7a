// What a node keeps of the files that it was sent, by their digests: CACHE/objects/DIGEST.
//
// Any number of processes of one user use a cache at once: files come into being whole, are never
// changed, and one that is removed stays where it was linked to.
#ifndef RN_SERVER_RUNNER_LINK_CACHE_H
#define RN_SERVER_RUNNER_LINK_CACHE_H

#include <limits.h>
#include <stdbool.h>
#include <stdint.h>

#include "common/base/status.h"

// Thread-safety: one thread. Plain value.
struct rn_cache {
    char folder[PATH_MAX];
    int64_t most_bytes;
};

// Makes the folders. RN_ERROR_INVALID when others may write there.
enum rn_status rn_cache_open(const char *folder, int64_t most_bytes, struct rn_cache *ret_cache,
                             struct rn_error *err) RN_MUST_CHECK;
// Links the file with this digest to `path`, in place of what is there; false: it is not kept.
bool rn_cache_take(const struct rn_cache *cache, const char *sha256, const char *path);
// Keeps a file that will not be changed. One that cannot be kept is not.
void rn_cache_keep(const struct rn_cache *cache, const char *sha256, const char *path);
// Removes what was used longest ago until the rest is no more than most_bytes.
void rn_cache_trim(const struct rn_cache *cache);

// A folder of this process's own with this name below the cache's, empty, until the lock that
// *ret_lock holds is closed; those of processes that are gone are removed first.
enum rn_status rn_cache_work(const struct rn_cache *cache, const char *name,
                             char ret_path[PATH_MAX], int *ret_lock,
                             struct rn_error *err) RN_MUST_CHECK;

#endif
