// The scheduler of the simulation: threads of the daemon and of its clients are coroutines that can
// be left wherever they wait or take a lock.
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

#include "common/base/clock.h"
#include "tests/sim/calls.h"
#include "tests/sim/life.h"

#define THREADS 32
#define STACK_BYTES (1u << 20)

enum waits { FOR_NOTHING, FOR_LOCK, FOR_POLL, FOR_TIME, FOR_THREAD };

// Lies in the place of a pthread_mutex_t, which is zero at first; recursive.
struct lock {
    int owner; // 1 + the thread's place; 0: nobody
    int depth;
};
_Static_assert(sizeof(struct lock) <= sizeof(pthread_mutex_t), "a lock fits");

struct thread {
    ucontext_t context;
    void *stack;
    bool used, ended;
    void *(*run)(void *context);
    void (*run_plain)(void *context);
    void *argument;
    enum waits waits;
    const struct lock *lock;
    struct pollfd *polls;
    nfds_t poll_count;
    int64_t until_ns;
    const struct thread *joined;
};
static struct thread threads[THREADS];
static struct thread *current; // NULL: the scheduler
static ucontext_t scheduler;

// ---- waiting ----------------------------------------------------------------------------------

static void leave(enum waits waits) {
    struct thread *self = current;
    if (self == NULL) return;
    self->waits = waits;
    swapcontext(&self->context, &scheduler);
    self->waits = FOR_NOTHING;
}

static bool is_readable(const struct pollfd *polls, nfds_t count) {
    for (nfds_t i = 0; i < count; i++)
        if ((polls[i].events & POLLOUT) || sim_readable(polls[i].fd)) return true;
    return false;
}

static bool can_go_on(const struct thread *thread) {
    switch (thread->waits) {
    case FOR_NOTHING:
        return true;
    case FOR_LOCK:
        return thread->lock->owner == 0;
    case FOR_POLL:
        return sim->now_ns >= thread->until_ns || is_readable(thread->polls, thread->poll_count);
    case FOR_TIME:
        return sim->now_ns >= thread->until_ns;
    case FOR_THREAD:
        return thread->joined->ended;
    }
    return false;
}

static int place_of(const struct thread *thread) {
    return 1 + (int)(thread - threads);
}

int sim_mutex_init(pthread_mutex_t *mutex) {
    memset(mutex, 0, sizeof *mutex);
    return 0;
}

// Anyone may come first.
int sim_mutex_lock(pthread_mutex_t *mutex) {
    struct lock *lock = (struct lock *)(void *)mutex;
    if (current == NULL) return 0;
    if (lock->owner != place_of(current)) {
        current->lock = lock;
        if (lock->owner != 0 || sim_chance(4)) leave(FOR_LOCK);
        lock->owner = place_of(current);
    }
    lock->depth++;
    return 0;
}

int sim_mutex_unlock(pthread_mutex_t *mutex) {
    struct lock *lock = (struct lock *)(void *)mutex;
    if (current == NULL) return 0;
    if (lock->owner != place_of(current)) sim_violated("a lock is given back by who has it not");
    if (--lock->depth > 0) return 0;
    lock->owner = 0;
    if (sim_chance(4)) leave(FOR_NOTHING);
    return 0;
}

int sim_poll(struct pollfd *polls, nfds_t count, int timeout_ms) {
    int ready = 0;
    current->polls = polls;
    current->poll_count = count;
    current->until_ns = timeout_ms < 0 ? INT64_MAX : sim->now_ns + timeout_ms * 1000000ll;
    leave(FOR_POLL);
    for (nfds_t i = 0; i < count; i++) {
        polls[i].revents = sim_readable(polls[i].fd) ? POLLIN : 0;
        ready += polls[i].revents != 0;
    }
    return ready;
}

void sim_sleep(int64_t ns) {
    current->until_ns = sim->now_ns + ns;
    leave(FOR_TIME);
}

int sim_nanosleep(const struct timespec *time) {
    sim_sleep(time->tv_sec * 1000000000ll + time->tv_nsec);
    return 0;
}

ssize_t sim_getrandom(void *bytes, size_t size) {
    for (size_t i = 0; i < size; i++)
        ((uint8_t *)bytes)[i] = (uint8_t)sim_random();
    return (ssize_t)size;
}

// ---- threads ----------------------------------------------------------------------------------

static void enter(void) {
    struct thread *self = current;
    if (self->run != NULL)
        self->run(self->argument);
    else
        self->run_plain(self->argument);
    self->ended = true;
    for (;;)
        swapcontext(&self->context, &scheduler);
}

static struct thread *begin(void) {
    struct thread *thread = threads;
    while (thread < threads + THREADS && thread->used)
        thread++;
    if (thread == threads + THREADS) sim_violated("%d threads are there", THREADS);
    *thread = (struct thread){.used = true, .stack = malloc(STACK_BYTES)};
    getcontext(&thread->context);
    thread->context.uc_stack.ss_sp = thread->stack;
    thread->context.uc_stack.ss_size = STACK_BYTES;
    makecontext(&thread->context, enter, 0);
    return thread;
}

int sim_thread_create(pthread_t *ret_thread, void *(*run)(void *context), void *context) {
    struct thread *thread = begin();
    thread->run = run;
    thread->argument = context;
    *ret_thread = (pthread_t)place_of(thread);
    return 0;
}

void sim_thread_begin(void (*run)(void *context), void *context) {
    struct thread *thread = begin();
    thread->run_plain = run;
    thread->argument = context;
}

int sim_thread_join(pthread_t joined) {
    current->joined = &threads[joined - 1];
    if (!current->joined->ended) leave(FOR_THREAD);
    return 0;
}

// ---- the scheduler ----------------------------------------------------------------------------

static int64_t next_due(void) {
    int64_t due_ns = sim_runners_due();
    for (const struct thread *thread = threads; thread < threads + THREADS; thread++)
        if (thread->used && !thread->ended &&
            (thread->waits == FOR_POLL || thread->waits == FOR_TIME) && thread->until_ns < due_ns)
            due_ns = thread->until_ns;
    return due_ns;
}

static struct thread *draw(void) {
    struct thread *ready[THREADS];
    int count = 0;
    for (struct thread *thread = threads; thread < threads + THREADS; thread++)
        if (thread->used && !thread->ended && can_go_on(thread)) ready[count++] = thread;
    return count > 0 ? ready[sim_below(count)] : NULL;
}

static void run_one(struct thread *thread) {
    current = thread;
    swapcontext(&scheduler, &thread->context);
    current = NULL;
}

static void step(void) {
    bool runners = sim_runners_due() <= sim->now_ns;
    struct thread *thread = draw();
    sim->figures.steps++;
    if (runners && (thread == NULL || sim_chance(2))) {
        (void)sim_runners_step();
    } else if (thread != NULL) {
        run_one(thread);
    } else {
        int64_t due_ns = next_due();
        if (due_ns == INT64_MAX) sim_violated("all threads wait for each other");
        if (due_ns > sim->now_ns) sim->now_ns = due_ns;
    }
    sim->now_ns += 1000 + sim_below(50000);
}

void sim_threads_run(void (*first)(void *context)) {
    sim_thread_begin(first, NULL);
    const struct thread *main_thread = &threads[0];
    while (!main_thread->ended)
        step();
}
