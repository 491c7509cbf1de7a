// A bounded list of events with a replayable past: what server-sent events are read from.
//
// Every event has an id that grows over all rings and restarts of the daemon. A full ring forgets
// its oldest events. An event published with a key replaces the one of the same name and key
// before it: a reader that was away gets the newest progress, not all of it.
#ifndef RN_SERVER_HTTP_RING_H
#define RN_SERVER_HTTP_RING_H

#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"

// Thread-safety: any thread. Owner: reference counted.
struct rn_ring;

// A reader. `wake` is called by publishers with the ring locked: it must neither block nor touch
// the ring.
struct rn_ring_reader {
    struct rn_ring *ring;
    uint64_t after_id; // the last event read
    void (*wake)(void *context);
    void *context;
    struct rn_ring_reader *next;
};

enum rn_status rn_ring_create(size_t max_events, size_t max_bytes, struct rn_ring **ret_ring,
                              struct rn_error *err) RN_MUST_CHECK;
struct rn_ring *rn_ring_ref(struct rn_ring *ring);
void rn_ring_unref(struct rn_ring **ring);

// The next event id; starts from the wall clock, so that ids of an earlier run are smaller.
uint64_t rn_ring_next_id(void);
// The one given out last, or a smaller one than the next when there was none.
uint64_t rn_ring_last_id(void);

// Publishes an event. `name` is static text, `data` one line (JSON), copied; `key` (fewer than
// RN_RING_KEY bytes) may be NULL: the event replaces none. An event that does not fit
// (allocation, max_bytes) is lost.
#define RN_RING_KEY 24
void rn_ring_publish(struct rn_ring *ring, uint64_t id, const char *name, const char *data,
                     const char *key);
// No further events: readers end when they have read what is left.
void rn_ring_close(struct rn_ring *ring);

// Starts reading after event `after_id` (0: everything still kept).
void rn_ring_attach(struct rn_ring *ring, struct rn_ring_reader *reader, uint64_t after_id);
void rn_ring_detach(struct rn_ring_reader *reader);

enum rn_ring_result { RN_RING_EVENT, RN_RING_EMPTY, RN_RING_ENDED, RN_RING_NO_MEMORY };
// The next event as server-sent text ("id: …\nevent: …\ndata: …\n\n"), malloc.
enum rn_ring_result rn_ring_read(struct rn_ring_reader *reader, char **ret_text, size_t *ret_size);

// Whether rn_ring_read would return something other than RN_RING_EMPTY.
bool rn_ring_pending(struct rn_ring_reader *reader);

#endif
