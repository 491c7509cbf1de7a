// Work behind the rendering: several at a time, settled in order, errors told.
#include "server/runner/field/behind.h"

#include <pthread.h>
#include <stdlib.h>

#include "tests/support/suite.h"

struct numbered {
    struct rn_piece piece;
    int number;
};

static struct {
    pthread_mutex_t mutex;
    pthread_cond_t changed;
    int begun, together;  // pieces that have begun; that wait for each other
    int fails, unsettled; // the number of one that does; whose settling does
    int settled[16], settled_count, released;
    pthread_t adds;
    bool elsewhere; // a piece ran on another thread
} seen = {.mutex = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER};

static enum rn_status run(struct rn_piece *piece, struct rn_error *err) {
    const struct numbered *own = (const struct numbered *)piece;
    pthread_mutex_lock(&seen.mutex);
    seen.begun++;
    seen.elsewhere |= !pthread_equal(pthread_self(), seen.adds);
    pthread_cond_broadcast(&seen.changed);
    while (seen.begun < seen.together)
        pthread_cond_wait(&seen.changed, &seen.mutex);
    pthread_mutex_unlock(&seen.mutex);
    return own->number == seen.fails ? rn_error_set(err, RN_ERROR_IO, "frame", "no room") : RN_OK;
}
static enum rn_status settle(struct rn_piece *piece, struct rn_error *err) {
    int number = ((struct numbered *)piece)->number;
    ck_assert(pthread_equal(pthread_self(), seen.adds));
    seen.settled[seen.settled_count++] = number;
    return number == seen.unsettled ? rn_error_set(err, RN_ERROR_IO, "score", "no file") : RN_OK;
}
static void release(struct rn_piece *piece) {
    seen.released++;
    free(piece);
}

static void begin(int together, int fails) {
    seen.begun = seen.settled_count = seen.released = 0;
    seen.together = together;
    seen.fails = fails;
    seen.unsettled = -1;
    seen.adds = pthread_self();
    seen.elsewhere = false;
}

static struct rn_piece *numbered(int number) {
    struct numbered *own = calloc(1, sizeof *own);
    own->piece = (struct rn_piece){.run = run, .settle = settle, .release = release};
    own->number = number;
    return &own->piece;
}

// Three that end only once all have begun: none waits for the one before.
START_TEST(run_together_and_settle_in_order) {
    struct rn_behind behind = {0};
    begin(3, -1);
    for (int i = 0; i < 3; i++)
        OK(rn_behind_add(&behind, numbered(i), 3, &err));
    ck_assert(behind.count == 3 && seen.settled_count == 0);
    for (int i = 3; i < 12; i++) {
        OK(rn_behind_add(&behind, numbered(i), 100, &err)); // no more than there is room for
        ck_assert_uint_lt(behind.count, RN_BEHIND_MOST);
    }
    OK(rn_behind_settle(&behind, 0, &err));
    ck_assert(behind.count == 0 && seen.settled_count == 12 && seen.released == 12);
    for (int i = 0; i < 12; i++)
        ck_assert_int_eq(seen.settled[i], i);
}
END_TEST

START_TEST(none_behind_is_here_and_now) {
    struct rn_behind behind = {0};
    struct rn_error said = {0};
    begin(0, 1);
    OK(rn_behind_add(&behind, numbered(0), 0, &err));
    ck_assert(!seen.elsewhere && seen.settled_count == 1 && seen.released == 1);
    ck_assert(rn_behind_add(&behind, numbered(1), 0, &said) == RN_ERROR_IO);
    ck_assert_str_eq(said.where, "frame");
    ck_assert(behind.count == 0 && seen.settled_count == 1 && seen.released == 2);
}
END_TEST

START_TEST(an_error_is_told_by_who_waits) {
    struct rn_behind behind = {0};
    struct rn_error said = {0};
    begin(0, 1);
    for (int i = 0; i < 4; i++)
        OK(rn_behind_add(&behind, numbered(i), 4, &err));
    ck_assert(rn_behind_settle(&behind, 0, &said) == RN_ERROR_IO);
    ck_assert_str_eq(said.text, "no room");
    ck_assert(behind.count == 2 && seen.settled_count == 1 && seen.settled[0] == 0);
    rn_behind_drop(&behind);
    ck_assert(behind.count == 0 && seen.settled_count == 1 && seen.released == 4);
    ck_assert(seen.begun == 4 && seen.elsewhere);
}
END_TEST

// What goes wrong in the end is told as what went wrong before.
START_TEST(an_error_of_settling_is_told) {
    struct rn_behind behind = {0};
    struct rn_error said = {0};
    begin(0, -1);
    seen.unsettled = 0;
    ck_assert(rn_behind_add(&behind, numbered(0), 0, &said) == RN_ERROR_IO);
    ck_assert_str_eq(said.where, "score");
    ck_assert(behind.count == 0 && seen.released == 1);
}
END_TEST

START_TEST(as_many_as_there_are_threads_and_room_for) {
    ck_assert_uint_eq(rn_behind_most(true, 4, 800, 800), 4);
    ck_assert_uint_eq(rn_behind_most(true, 4, 3840, 2160), 1);
    ck_assert_uint_eq(rn_behind_most(true, 4, 8192, 8192), 0);
    ck_assert_uint_eq(rn_behind_most(false, 4, 800, 800), 0); // its threads render
}
END_TEST

int main(void) {
    Suite *suite = suite_create("behind");
    TCase *group = tcase_create("behind");
    tcase_add_test(group, run_together_and_settle_in_order);
    tcase_add_test(group, none_behind_is_here_and_now);
    tcase_add_test(group, an_error_is_told_by_who_waits);
    tcase_add_test(group, an_error_of_settling_is_told);
    tcase_add_test(group, as_many_as_there_are_threads_and_room_for);
    suite_add_tcase(suite, group);
    return run_suite(suite);
}
