#include "server/engine/cpu/pool.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <time.h>

#define SPIN_NS 50000  // how long a waiting thread spins before it sleeps
#define ASK_NS 1000000 // how often the caller, who waits for the others, asks whether to stop

// The gate of a pool: the number of its run in the upper half; below, how many workers are in it.
#define RUN_SHIFT 32
#define GATE_CLOSED (1u << 31) // all is handed out: who comes now is not waited for
#define GATE_ENDS (1u << 30)   // and there will be no other run
#define GATE_INSIDE (GATE_ENDS - 1)

struct worker {
    struct rn_pool *pool;
    pthread_t thread;
    int index;
};

struct rn_pool {
    int threads;
    struct worker *workers; // threads - 1
    void (*work)(void *context, int index, int thread);
    void *context;
    int count;
    bool (*stop)(void *context); // NULL: the run is not cut short
    void *stop_context;
    atomic_bool stopped;
    _Alignas(64) atomic_int next; // index to hand out
    _Alignas(64) _Atomic uint64_t gate;
    pthread_mutex_t lock;
    pthread_cond_t started, finished;
};

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static struct timespec later(int64_t ns) {
    ns += now_ns();
    return (struct timespec){.tv_sec = ns / 1000000000, .tv_nsec = ns % 1000000000};
}

static void relax(void) {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#endif
}

static void drain(struct rn_pool *pool, int thread) {
    for (;;) {
        int index = atomic_fetch_add_explicit(&pool->next, 1, memory_order_relaxed);
        if (index >= pool->count) return;
        pool->work(pool->context, index, thread);
    }
}

bool rn_pool_is_stopped(struct rn_pool *pool, int thread) {
    if (thread == 0 && pool->stop && !atomic_load(&pool->stopped) && pool->stop(pool->stop_context))
        atomic_store(&pool->stopped, true);
    return atomic_load(&pool->stopped);
}

// The caller's share of a run that may be cut short; returns the first index that nobody has taken.
static int drain_until(struct rn_pool *pool) {
    for (;;) {
        int index = atomic_fetch_add_explicit(&pool->next, 1, memory_order_relaxed);
        if (index >= pool->count) return pool->count;
        pool->work(pool->context, index, 0);
        if (!rn_pool_is_stopped(pool, 0)) continue;
        index = atomic_exchange_explicit(&pool->next, pool->count, memory_order_relaxed);
        return index < pool->count ? index : pool->count;
    }
}

static bool is_of(uint64_t gate, uint32_t run) {
    return gate >> RUN_SHIFT == run;
}

// The gate of another run than the one that was seen last.
static uint64_t wait_for_run(struct rn_pool *pool, uint32_t seen) {
    int64_t until = now_ns() + SPIN_NS;
    do {
        for (int i = 0; i < 64; i++) {
            uint64_t gate = atomic_load_explicit(&pool->gate, memory_order_acquire);
            if (!is_of(gate, seen)) return gate;
            relax();
        }
    } while (now_ns() < until);
    pthread_mutex_lock(&pool->lock);
    while (is_of(atomic_load(&pool->gate), seen))
        pthread_cond_wait(&pool->started, &pool->lock);
    pthread_mutex_unlock(&pool->lock);
    return atomic_load(&pool->gate);
}

// Whether a worker is in the run, whose context stands from now on until it has left.
static bool enter(struct rn_pool *pool, uint32_t run) {
    uint64_t gate = atomic_load(&pool->gate);
    while (is_of(gate, run) && !(gate & GATE_CLOSED))
        if (atomic_compare_exchange_weak(&pool->gate, &gate, gate + 1)) return true;
    return false;
}

static void leave(struct rn_pool *pool) {
    uint64_t before = atomic_fetch_sub(&pool->gate, 1);
    if (!(before & GATE_CLOSED) || (before & GATE_INSIDE) > 1) return;
    pthread_mutex_lock(&pool->lock);
    pthread_cond_signal(&pool->finished);
    pthread_mutex_unlock(&pool->lock);
}

static void *worker_main(void *argument) {
    struct worker *worker = argument;
    struct rn_pool *pool = worker->pool;
    uint32_t seen = 0;
    for (;;) {
        uint64_t gate = wait_for_run(pool, seen);
        if (gate & GATE_ENDS) return NULL;
        seen = (uint32_t)(gate >> RUN_SHIFT);
        if (!enter(pool, seen)) continue;
        drain(pool, worker->index);
        leave(pool);
    }
}

// Opens the gate to the next run.
static void open_gate(struct rn_pool *pool, uint32_t with) {
    pthread_mutex_lock(&pool->lock);
    uint32_t run = (uint32_t)(atomic_load(&pool->gate) >> RUN_SHIFT) + 1;
    atomic_store(&pool->gate, (uint64_t)run << RUN_SHIFT | with);
    pthread_cond_broadcast(&pool->started);
    pthread_mutex_unlock(&pool->lock);
}

static void start_run(struct rn_pool *pool, int first) {
    atomic_store(&pool->next, first);
    open_gate(pool, 0);
}

static bool is_empty(struct rn_pool *pool) {
    return !(atomic_load_explicit(&pool->gate, memory_order_acquire) & GATE_INSIDE);
}

// All is handed out: waits for the workers that have some of it, not for those that the machine,
// busy with other programs, has not woken yet.
static void wait_for_workers(struct rn_pool *pool) {
    atomic_fetch_or(&pool->gate, GATE_CLOSED);
    int64_t until = now_ns() + SPIN_NS;
    do {
        for (int i = 0; i < 64; i++) {
            if (is_empty(pool)) return;
            relax();
        }
    } while (now_ns() < until);
    pthread_mutex_lock(&pool->lock);
    while (!is_empty(pool)) {
        struct timespec next = later(ASK_NS);
        pthread_cond_timedwait(&pool->finished, &pool->lock, &next);
        rn_pool_is_stopped(pool, 0); // the others may be at work for long
    }
    pthread_mutex_unlock(&pool->lock);
}

void rn_pool_run(struct rn_pool *pool, int count,
                 void (*work)(void *context, int index, int thread), void *context) {
    if (pool->threads == 1 || count <= 1) {
        for (int i = 0; i < count; i++)
            work(context, i, 0);
        return;
    }
    pool->work = work;
    pool->context = context;
    pool->count = count;
    start_run(pool, 0);
    drain(pool, 0);
    wait_for_workers(pool);
}

bool rn_pool_run_some(struct rn_pool *pool, int count, int *next,
                      void (*work)(void *context, int index, int thread), void *context,
                      bool (*stop)(void *stop_context), void *stop_context) {
    if (*next >= count) return true;
    pool->work = work;
    pool->context = context;
    pool->count = count;
    pool->stop = stop;
    pool->stop_context = stop_context;
    start_run(pool, *next);
    *next = drain_until(pool);
    wait_for_workers(pool);
    pool->stop = NULL;
    atomic_store(&pool->stopped, false);
    return *next == count;
}

enum rn_status rn_pool_create(int threads, struct rn_pool **ret_pool, struct rn_error *err) {
    struct rn_pool *pool = aligned_alloc(64, (sizeof *pool + 63) / 64 * 64);
    struct worker *workers = calloc((size_t)threads, sizeof *workers);
    if (!pool || !workers) {
        free(pool);
        free(workers);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "threads", "out of memory");
    }
    *pool = (struct rn_pool){.threads = 1, .workers = workers};
    pthread_mutex_init(&pool->lock, NULL);
    pthread_condattr_t clock;
    pthread_condattr_init(&clock);
    pthread_condattr_setclock(&clock, CLOCK_MONOTONIC);
    pthread_cond_init(&pool->started, &clock);
    pthread_cond_init(&pool->finished, &clock);
    pthread_condattr_destroy(&clock);
    for (int i = 1; i < threads; i++) {
        workers[i - 1] = (struct worker){.pool = pool, .index = i};
        if (pthread_create(&workers[i - 1].thread, NULL, worker_main, &workers[i - 1]) != 0) {
            rn_pool_destroy(&pool);
            return rn_error_set(err, RN_ERROR_LIMIT, "threads",
                                "cannot start thread %d of %d; use fewer", i + 1, threads);
        }
        pool->threads++;
    }
    *ret_pool = pool;
    return RN_OK;
}

void rn_pool_destroy(struct rn_pool **pool) {
    struct rn_pool *p = *pool;
    if (!p) return;
    open_gate(p, GATE_CLOSED | GATE_ENDS);
    for (int i = 0; i < p->threads - 1; i++)
        pthread_join(p->workers[i].thread, NULL);
    pthread_mutex_destroy(&p->lock);
    pthread_cond_destroy(&p->started);
    pthread_cond_destroy(&p->finished);
    free(p->workers);
    free(p);
    *pool = NULL;
}

int rn_pool_threads(const struct rn_pool *pool) {
    return pool->threads;
}
