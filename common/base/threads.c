#include "common/base/threads.h"

#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>

#define MAX_THREADS 256

int rn_usable_cores(void) {
    cpu_set_t cores;
    int count = sched_getaffinity(0, sizeof cores, &cores) == 0 ? CPU_COUNT(&cores) : 1;
    return count > 0 ? count : 1;
}

struct loop {
    void (*work)(void *context, size_t index);
    void *context;
    size_t count;
    atomic_size_t next;
};

static void *run(void *argument) {
    struct loop *loop = argument;
    size_t index;
    while ((index = atomic_fetch_add(&loop->next, 1)) < loop->count)
        loop->work(loop->context, index);
    return NULL;
}

void rn_parallel_for(int threads, size_t count, void (*work)(void *context, size_t index),
                     void *context) {
    struct loop loop = {.work = work, .context = context, .count = count};
    pthread_t helpers[MAX_THREADS];
    size_t wanted = threads > MAX_THREADS ? MAX_THREADS : threads > 1 ? (size_t)threads : 1;
    if (wanted > count) wanted = count;
    size_t started = 0;
    while (started + 1 < wanted && pthread_create(&helpers[started], NULL, run, &loop) == 0)
        started++;
    run(&loop);
    for (size_t i = 0; i < started; i++)
        pthread_join(helpers[i], NULL);
}
