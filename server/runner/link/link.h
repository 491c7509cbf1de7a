// The runner's end of the socket to the daemon: an inbox of whole messages, blocking sends.
#ifndef RN_SERVER_RUNNER_LINK_LINK_H
#define RN_SERVER_RUNNER_LINK_LINK_H

#include "proto/wire_messages.h"
#include "server/runner/sandbox/profile.h"

// A message that has arrived and has not been dealt with. Owner: the inbox, then its taker.
struct rn_letter {
    struct rn_wire_message message;
    int64_t arrived_ns; // rn_clock_ns
    struct rn_letter *next;
};

#define RN_LINK_TRACES 4

// Thread-safety: owned by one thread.
struct rn_link {
    struct rn_wire_reader reader;
    struct rn_wire_writer writer;
    struct rn_letter *first, *last;   // in order of arrival
    int64_t said_ns;                  // when something was sent last
    size_t count;                     // at most RN_LINK_MAX_LETTERS; more wait in the socket
    const struct rn_profile *profile; // what is learnt of places confines the process to them;
                                      // NULL: it does not
    bool closed;                      // the daemon is gone, or does not speak the protocol
    struct rn_wire_trace traces[RN_LINK_TRACES]; // of the last jobs that have one
    unsigned trace_count;                        // of all so far
};
#define RN_LINK_MAX_LETTERS 256

void rn_link_init(struct rn_link *link, int fd);
void rn_link_finish(struct rn_link *link);

// Waits up to timeout_ms (-1: without end) for something to arrive, then moves all that is there
// to the inbox. With letters in the inbox it does not wait. Tells the daemon now and then that this
// runner is alive.
void rn_link_pump(struct rn_link *link, int timeout_ms);
// Takes the oldest letter; false when there is none. The caller finishes the message.
bool rn_link_take(struct rn_link *link, struct rn_letter *ret_letter);
// The oldest letter of this type, before those of others.
bool rn_link_take_type(struct rn_link *link, enum rn_wire_type type, struct rn_letter *ret_letter);
// Whether something has arrived that was not taken yet. `link`: struct rn_link.
bool rn_link_has_news(void *link);
// What is logged from now on is about this job ("": none): in its trace. The trace before.
const char *rn_link_log_of(struct rn_link *link, const char *job);
// Whether work must stop: the daemon is gone or has asked for the end.
bool rn_link_must_stop(const struct rn_link *link);

// Sends a message, waiting until it is out. A failure closes the link and is logged.
void rn_link_post(struct rn_link *link, enum rn_wire_type type, const void *message,
                  const void *blob, size_t blob_size);
// The same, and also where nothing more is heard, as far as it goes at once: what is worth knowing
// of a runner that was told of its end by other means than the daemon.
void rn_link_post_last(struct rn_link *link, enum rn_wire_type type, const void *message);
// Sends `done`: the job's result is this JSON.
void rn_link_done(struct rn_link *link, const char *job, char *result);
// Sends `failed` about a job ("" for none) or a request (RN_ABSENT for none).
// RN_ERROR_UNAVAILABLE, a lost device, ends the process.
void rn_link_fail(struct rn_link *link, const char *job, int64_t request,
                  const struct rn_error *err);

// What a long computation polls: goes on until its job or request is cancelled.
struct rn_watch {
    struct rn_link *link;
    const char *job;
    int64_t request;
    bool cancelled; // on request; false when it stopped because the runner must
};
bool rn_watch_keep_going(void *watch);

#endif
