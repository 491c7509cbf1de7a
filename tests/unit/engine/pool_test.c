#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <stdatomic.h>

#include "server/engine/cpu/pool.h"
#include "tests/support/suite.h"

#define COUNT 1000
#define RUNS 200

static atomic_int done[COUNT];

static void count_item(void *context, int index, int thread) {
    (void)context, (void)thread;
    done[index]++;
}

static bool after_half(void *context) {
    (void)context;
    return done[COUNT / 2] > 0;
}

static struct rn_pool *pool_of(int threads) {
    struct rn_pool *pool = NULL;
    struct rn_error err;
    ck_assert_int_eq(rn_pool_create(threads, &pool, &err), RN_OK);
    return pool;
}

// Run after run, each item once; in runs that are cut short too.
START_TEST(each_item_is_done_once) {
    struct rn_pool *pool = pool_of(4);
    for (int run = 0; run < RUNS; run++) {
        int next = 0;
        if (run % 2 == 0) rn_pool_run(pool, COUNT, count_item, NULL);
        while (run % 2 && !rn_pool_run_some(pool, COUNT, &next, count_item, NULL, after_half, NULL))
            ;
        for (int i = 0; i < COUNT; i++)
            ck_assert_int_eq(atomic_exchange(&done[i], 0), 1);
    }
    rn_pool_destroy(&pool);
}
END_TEST

static pthread_t worker;
static pthread_barrier_t both;
static sem_t held, release;

static void meet(void *context, int index, int thread) {
    (void)context, (void)index;
    if (thread == 1) worker = pthread_self();
    pthread_barrier_wait(&both);
}

static void hold(int number) {
    (void)number;
    sem_post(&held);
    while (sem_wait(&release) != 0)
        ;
}

// As on a machine whose other programs leave the worker no core: what it has not begun is done
// without it, and it is there again when it can be.
START_TEST(a_worker_that_is_held_is_not_waited_for) {
    struct rn_pool *pool = pool_of(2);
    pthread_barrier_init(&both, NULL, 2);
    sem_init(&held, 0, 0);
    sem_init(&release, 0, 0);
    signal(SIGUSR1, hold);
    rn_pool_run(pool, 2, meet, NULL);
    ck_assert_int_eq(pthread_kill(worker, SIGUSR1), 0);
    sem_wait(&held);
    for (int run = 0; run < RUNS; run++)
        rn_pool_run(pool, COUNT, count_item, NULL);
    for (int i = 0; i < COUNT; i++)
        ck_assert_int_eq(atomic_exchange(&done[i], 0), RUNS);
    sem_post(&release);
    rn_pool_run(pool, 2, meet, NULL);
    rn_pool_destroy(&pool);
    sem_destroy(&held);
    sem_destroy(&release);
    pthread_barrier_destroy(&both);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("pool");
    TCase *cases = tcase_create("pool");
    tcase_add_test(cases, each_item_is_done_once);
    tcase_add_test(cases, a_worker_that_is_held_is_not_waited_for);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
