// The engine's worker threads: a fixed team, barriers that spin for a moment, then sleep.
#ifndef RN_ENGINE_CPU_POOL_H
#define RN_ENGINE_CPU_POOL_H

#include <stdbool.h>

#include "common/base/status.h"

// Thread-safety: one thread calls rn_pool_run; the workers are inside.
struct rn_pool;

// `threads` >= 1 counts the caller, who works too. RN_ERROR_NO_MEMORY.
enum rn_status rn_pool_create(int threads, struct rn_pool **ret_pool,
                              struct rn_error *err) RN_MUST_CHECK;
void rn_pool_destroy(struct rn_pool **pool);
int rn_pool_threads(const struct rn_pool *pool);

// Calls work(context, index, thread) once for every index in [0, count), indices handed out in
// order; returns when all are done. Which thread does what is not fixed: results must not depend
// on it.
void rn_pool_run(struct rn_pool *pool, int count,
                 void (*work)(void *context, int index, int thread), void *context);

// As rn_pool_run from index *next on, but no more are handed out once `stop` says so, which thread
// 0 asks before each of its items but the first. *next becomes the first index that is left; true:
// none is. So a long run can be cut short and taken up again; nothing is done twice.
bool rn_pool_run_some(struct rn_pool *pool, int count, int *next,
                      void (*work)(void *context, int index, int thread), void *context,
                      bool (*stop)(void *stop_context), void *stop_context);

// Whether a run that may be cut short has been: for work that can be left half done and taken up
// again. On the caller's thread, 0, it is asked anew.
bool rn_pool_is_stopped(struct rn_pool *pool, int thread);

#endif
