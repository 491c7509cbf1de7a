// Files that travel between a daemon and a runner that share no folder, over their connection.
//
// Both ends pass the wire's messages on and put files between them, so that what a message speaks
// of is there before it arrives. `have` tells the runner's end of a file by its digest, `want` asks
// for it where no cache has it, pieces bring it; what the runner writes comes back in pieces, what
// it removes as `gone`. Files are named by their place in the scene's folder or the dataset's.
#ifndef RN_PROTO_CARRY_H
#define RN_PROTO_CARRY_H

#include <limits.h>

#include "common/base/sha256.h"
#include "proto/wire_messages.h"

#define RN_CARRY_DATASET "dataset"
#define RN_CARRY_SCENE "scene"

struct rn_cargo; // what waits to be sent: messages and files, in their order

// One end of such a connection. Thread-safety: owned by one thread.
struct rn_carry {
    struct rn_wire_reader reader;
    struct rn_wire_writer writer;
    struct rn_cargo *first, *last;
    size_t waiting; // messages and files, each of which holds a descriptor
    bool durable;   // what arrives is on disk before it is in its place
    // The file that arrives: one at a time.
    int fd; // -1: none
    char path[PATH_MAX], own[PATH_MAX];
    struct rn_wire_file file;
    int64_t have;
    struct rn_sha256 hash;
};
void rn_carry_init(struct rn_carry *carry, int fd, bool durable);
// Removes what arrived of a file that is not whole.
void rn_carry_finish(struct rn_carry *carry);

// Sends a message as it came, or one about a file, behind what waits.
enum rn_status rn_carry_pass(struct rn_carry *carry, const struct rn_wire_message *message,
                             struct rn_error *err) RN_MUST_CHECK;
enum rn_status rn_carry_post(struct rn_carry *carry, enum rn_wire_type type,
                             const struct rn_wire_file *file, struct rn_error *err) RN_MUST_CHECK;
// Sends the file at `path`, as it is now, whatever becomes of its name.
enum rn_status rn_carry_send(struct rn_carry *carry, const char *root, const char *name,
                             const char *path, struct rn_error *err) RN_MUST_CHECK;
bool rn_carry_is_empty(const struct rn_carry *carry);
// Sends what the socket takes; poll for POLLOUT while it is not empty.
enum rn_status rn_carry_flush(struct rn_carry *carry, struct rn_error *err) RN_MUST_CHECK;

// Takes a piece of the file that is to lie at `path`; *ret_whole: it does. RN_ERROR_CORRUPT when
// its bytes do not have its digest.
enum rn_status rn_carry_take(struct rn_carry *carry, const struct rn_wire_file *piece,
                             const struct rn_wire_message *message, const char *path,
                             bool *ret_whole, struct rn_error *err) RN_MUST_CHECK;

// Whether a name stays in its folder: at most four visible components, the last may be ".step".
bool rn_carry_is_name(const char *name);
// The message with the folder that it names, if it lies in `from`, moved to `to`.
enum rn_status rn_carry_move(struct rn_wire_message *message, const char *from, const char *to,
                             struct rn_error *err) RN_MUST_CHECK;

#endif
