// Cores, and a parallel loop over independent pieces of coarse work (images, rows).
#ifndef RN_COMMON_BASE_THREADS_H
#define RN_COMMON_BASE_THREADS_H

#include <stddef.h>

// Cores that this process may use, by its affinity; a container's quota is not asked for.
int rn_usable_cores(void);

// Calls work(context, i) once for every i in [0, count), on the calling thread and up to
// threads - 1 others, in no particular order; returns when all calls have. threads < 1 counts as
// 1; when threads cannot be started, those that run do all the work. Failure is for `work` to
// record in `context`.
void rn_parallel_for(int threads, size_t count, void (*work)(void *context, size_t index),
                     void *context);

#endif
