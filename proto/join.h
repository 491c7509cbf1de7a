// How a runner on another machine and its daemon find and recognise each other, before the first
// message of the wire.
//
// The daemon leaves FOLDER/join, which only its user can read, where runner and daemon share a
// folder: where it listens, a secret to be said and another to be heard. The runner takes it away
// as it reads it, so that each serves one connection. It says its name and the secret; the daemon
// answers with the other one, or hangs up.
#ifndef RN_PROTO_JOIN_H
#define RN_PROTO_JOIN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/buf.h"
#include "common/base/status.h"

#define RN_JOIN_NAME_MAX 32
#define RN_JOIN_SECRET_MAX 65 // 256 bits in hexadecimal
#define RN_JOIN_GREETING 192  // bytes that the runner sends, padded with NUL
#define RN_JOIN_ANSWER 64     // bytes that the daemon sends: the other secret

// How a runner on another machine ends, beside 0 (it was told to) and what a crash makes of it.
enum {
    RN_JOIN_EXIT_LOST = 75,      // its connection: it may be started again, for another secret
    RN_JOIN_EXIT_ALONE = 100,    // no daemon wanted it
    RN_JOIN_EXIT_NO_RANKS = 104, // it cannot join the other ranks
    // Of the script that starts it:
    RN_JOIN_EXIT_NOT_SHARED = 101, // the folder is not there
    RN_JOIN_EXIT_NO_PROGRAM = 102, // nor is the runner
    RN_JOIN_EXIT_NO_CACHE = 103,   // the folder of its cache cannot be made
};

// Plain value.
struct rn_join {
    char host[256];
    uint16_t port;
    char said[RN_JOIN_SECRET_MAX], heard[RN_JOIN_SECRET_MAX];
};

// New secrets.
enum rn_status rn_join_make(struct rn_join *join, struct rn_error *err) RN_MUST_CHECK;
// Leaves FOLDER/join.
enum rn_status rn_join_leave(const char *folder, const struct rn_join *join,
                             struct rn_error *err) RN_MUST_CHECK;
// The same text at the end of `text`, and read from what is left of a stream, to its end.
void rn_join_print(const struct rn_join *join, struct rn_buf *text);
enum rn_status rn_join_read(int fd, struct rn_join *ret_join, struct rn_error *err) RN_MUST_CHECK;
// Reads FOLDER/join and removes it. RN_ERROR_NOT_FOUND: the folder is not there; RN_ERROR_BUSY: it
// is, without the file; RN_ERROR_CORRUPT.
enum rn_status rn_join_take(const char *folder, struct rn_join *ret_join,
                            struct rn_error *err) RN_MUST_CHECK;

// What a runner says first. Plain value.
struct rn_greeting {
    char name[RN_JOIN_NAME_MAX]; // of its folder
    char said[RN_JOIN_SECRET_MAX];
    char machine[64]; // that it is on
};
void rn_join_write_greeting(char bytes[RN_JOIN_GREETING], const struct rn_greeting *greeting);
// false: it is none.
bool rn_join_read_greeting(const char bytes[RN_JOIN_GREETING], struct rn_greeting *ret_greeting);
// Compares two secrets in a time that does not depend on where they differ; empty ones differ.
bool rn_join_is(const char *secret, const char *other);

#endif
