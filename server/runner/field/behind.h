// What is left to do of units once a device has rendered them - pictures to be encoded and written
// - on threads of the processor, which has nothing to do while the device renders the next ones.
#ifndef RN_SERVER_RUNNER_FIELD_BEHIND_H
#define RN_SERVER_RUNNER_FIELD_BEHIND_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>

#include "common/base/status.h"

#define RN_BEHIND_MOST 8

// The first member of what a kind of job leaves of a unit; owned by the list once it is added.
struct rn_piece {
    enum rn_status (*run)(struct rn_piece *piece, struct rn_error *err); // on a thread of its own
    // It ran well; on the thread that adds, in order.
    enum rn_status (*settle)(struct rn_piece *piece, struct rn_error *err);
    void (*release)(struct rn_piece *piece);
    // The list's own.
    pthread_t thread;
    bool on_thread;
    enum rn_status status;
    struct rn_error err;
};

// Those under way, the oldest first. Thread-safety: one thread adds and settles.
struct rn_behind {
    struct rn_piece *pieces[RN_BEHIND_MOST];
    size_t count;
};

// Begins a piece, then settles until `most` are under way; 0 does all of it here and now.
enum rn_status rn_behind_add(struct rn_behind *behind, struct rn_piece *piece, size_t most,
                             struct rn_error *err) RN_MUST_CHECK;
// Waits for the oldest and settles them until `most` are under way. The error of one that failed.
enum rn_status rn_behind_settle(struct rn_behind *behind, size_t most,
                                struct rn_error *err) RN_MUST_CHECK;
// How many may be under way behind a picture of width x height: where a device rendered it, one for
// each of the processor's threads while they are few pixels together; else none.
size_t rn_behind_most(bool on_device, int threads, int width, int height);
// Waits for all and forgets them, unsettled.
void rn_behind_drop(struct rn_behind *behind);

#endif
