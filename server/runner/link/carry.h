// The runner's carry mode: a runner on a node that shares no folder with the daemon.
#ifndef RN_SERVER_RUNNER_LINK_CARRY_H
#define RN_SERVER_RUNNER_LINK_CARRY_H

#include <stdbool.h>
#include <stdint.h>

struct rn_carry_options {
    const char *name;  // of this runner, as the daemon knows it
    const char *cache; // folder
    int64_t cache_bytes;
    bool sandbox;
};

// Joins the daemon by the secret on standard input, starts this program in mode field and passes
// their messages on; what the field reads is fetched or taken from the cache before it is spoken
// of, what it has written is sent before that is. Returns an exit code (proto/join.h).
int rn_runner_carry(const struct rn_carry_options *options);

#endif
