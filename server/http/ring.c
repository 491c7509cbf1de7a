#include "server/http/ring.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"

struct event {
    uint64_t id;
    const char *name;
    char key[RN_RING_KEY]; // empty: replaces none
    char *data;
    size_t size;
};

struct rn_ring {
    pthread_mutex_t lock;
    size_t max_events, max_bytes;
    struct event *events; // oldest first
    size_t count, bytes;
    struct rn_ring_reader *readers;
    bool closed;
    atomic_int references;
};

enum rn_status rn_ring_create(size_t max_events, size_t max_bytes, struct rn_ring **ret_ring,
                              struct rn_error *err) {
    struct rn_ring *ring = calloc(1, sizeof *ring);
    struct event *events = calloc(max_events, sizeof *events);
    if (ring == NULL || events == NULL) {
        free(ring);
        free(events);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "events", "no memory for an event ring");
    }
    pthread_mutex_init(&ring->lock, NULL);
    ring->max_events = max_events;
    ring->max_bytes = max_bytes;
    ring->events = events;
    atomic_init(&ring->references, 1);
    *ret_ring = ring;
    return RN_OK;
}

struct rn_ring *rn_ring_ref(struct rn_ring *ring) {
    atomic_fetch_add(&ring->references, 1);
    return ring;
}

void rn_ring_unref(struct rn_ring **ring_pointer) {
    struct rn_ring *ring = *ring_pointer;
    *ring_pointer = NULL;
    if (ring == NULL || atomic_fetch_sub(&ring->references, 1) != 1) return;
    for (size_t i = 0; i < ring->count; i++)
        free(ring->events[i].data);
    pthread_mutex_destroy(&ring->lock);
    free(ring->events);
    free(ring);
}

static _Atomic uint64_t last_id;

uint64_t rn_ring_last_id(void) {
    uint64_t zero = 0;
    atomic_compare_exchange_strong(&last_id, &zero, (uint64_t)rn_clock_wall_ms());
    return atomic_load(&last_id);
}

uint64_t rn_ring_next_id(void) {
    (void)rn_ring_last_id();
    return atomic_fetch_add(&last_id, 1) + 1;
}

static void drop(struct rn_ring *ring, size_t i) {
    ring->bytes -= ring->events[i].size;
    free(ring->events[i].data);
    ring->count--;
    memmove(&ring->events[i], &ring->events[i + 1], (ring->count - i) * sizeof ring->events[0]);
}

static void drop_superseded(struct rn_ring *ring, const char *name, const char *key) {
    for (size_t i = ring->count; i-- > 0;) {
        const struct event *event = &ring->events[i];
        if (strcmp(event->key, key) != 0 || strcmp(event->name, name) != 0) continue;
        drop(ring, i);
        return;
    }
}

void rn_ring_publish(struct rn_ring *ring, uint64_t id, const char *name, const char *data,
                     const char *key) {
    size_t size = strlen(data);
    char *copy = size <= ring->max_bytes ? strdup(data) : NULL;
    pthread_mutex_lock(&ring->lock);
    if (copy == NULL || ring->closed) {
        free(copy);
    } else {
        if (key != NULL) drop_superseded(ring, name, key);
        while (ring->count == ring->max_events || ring->bytes + size > ring->max_bytes)
            drop(ring, 0);
        struct event *event = &ring->events[ring->count++];
        *event = (struct event){.id = id, .name = name, .data = copy, .size = size};
        if (key != NULL) snprintf(event->key, sizeof event->key, "%s", key);
        ring->bytes += size;
    }
    for (struct rn_ring_reader *reader = ring->readers; reader != NULL; reader = reader->next)
        reader->wake(reader->context);
    pthread_mutex_unlock(&ring->lock);
}

void rn_ring_close(struct rn_ring *ring) {
    pthread_mutex_lock(&ring->lock);
    ring->closed = true;
    for (struct rn_ring_reader *reader = ring->readers; reader != NULL; reader = reader->next)
        reader->wake(reader->context);
    pthread_mutex_unlock(&ring->lock);
}

void rn_ring_attach(struct rn_ring *ring, struct rn_ring_reader *reader, uint64_t after_id) {
    pthread_mutex_lock(&ring->lock);
    reader->ring = ring;
    reader->after_id = after_id;
    reader->next = ring->readers;
    ring->readers = reader;
    pthread_mutex_unlock(&ring->lock);
}

void rn_ring_detach(struct rn_ring_reader *reader) {
    struct rn_ring *ring = reader->ring;
    pthread_mutex_lock(&ring->lock);
    struct rn_ring_reader **link = &ring->readers;
    while (*link != reader)
        link = &(*link)->next;
    *link = reader->next;
    pthread_mutex_unlock(&ring->lock);
}

// First event newer than `after_id`: ids grow along the list.
static const struct event *find_after(const struct rn_ring *ring, uint64_t after_id) {
    size_t low = 0, high = ring->count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (ring->events[middle].id > after_id)
            high = middle;
        else
            low = middle + 1;
    }
    return low < ring->count ? &ring->events[low] : NULL;
}

enum rn_ring_result rn_ring_read(struct rn_ring_reader *reader, char **ret_text, size_t *ret_size) {
    struct rn_ring *ring = reader->ring;
    enum rn_ring_result result = RN_RING_EVENT;
    pthread_mutex_lock(&ring->lock);
    const struct event *event = find_after(ring, reader->after_id);
    if (event == NULL) {
        result = ring->closed ? RN_RING_ENDED : RN_RING_EMPTY;
    } else {
        int size = asprintf(ret_text, "id: %llu\nevent: %s\ndata: %s\n\n",
                            (unsigned long long)event->id, event->name, event->data);
        if (size < 0) {
            result = RN_RING_NO_MEMORY;
        } else {
            *ret_size = (size_t)size;
            reader->after_id = event->id;
        }
    }
    pthread_mutex_unlock(&ring->lock);
    return result;
}

bool rn_ring_pending(struct rn_ring_reader *reader) {
    struct rn_ring *ring = reader->ring;
    pthread_mutex_lock(&ring->lock);
    bool pending = ring->closed || find_after(ring, reader->after_id) != NULL;
    pthread_mutex_unlock(&ring->lock);
    return pending;
}
