// Rings of events: order, bounds, replay, replacement, end.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/ring.h"
#include "tests/support/suite.h"

static struct rn_ring *ring;
static struct rn_ring_reader reader;
static int wakes;

static void wake(void *context) {
    (*(int *)context)++;
}

static void make(size_t max_events, size_t max_bytes) {
    wakes = 0;
    ck_assert_int_eq(rn_ring_create(max_events, max_bytes, &ring, NULL), RN_OK);
    reader = (struct rn_ring_reader){.wake = wake, .context = &wakes};
}

static void expect(const char *expected) {
    char *text = NULL;
    size_t size;
    ck_assert_int_eq(rn_ring_read(&reader, &text, &size), RN_RING_EVENT);
    ck_assert_str_eq(text, expected);
    ck_assert_uint_eq(size, strlen(expected));
    free(text);
}

static void expect_result(enum rn_ring_result expected) {
    char *text = NULL;
    size_t size;
    ck_assert_int_eq(rn_ring_read(&reader, &text, &size), expected);
    ck_assert_int_eq(rn_ring_pending(&reader), expected != RN_RING_EMPTY);
}

static void unmake(void) {
    rn_ring_detach(&reader);
    rn_ring_unref(&ring);
    ck_assert_ptr_null(ring);
}

START_TEST(test_order_and_end) {
    make(4, 1000);
    rn_ring_publish(ring, 1, "state", "{\"a\":1}", NULL);
    rn_ring_attach(ring, &reader, 0);
    rn_ring_publish(ring, 2, "metric", "{}", NULL);
    expect("id: 1\nevent: state\ndata: {\"a\":1}\n\n");
    expect("id: 2\nevent: metric\ndata: {}\n\n");
    expect_result(RN_RING_EMPTY);
    ck_assert_int_eq(wakes, 1);
    rn_ring_close(ring);
    ck_assert_int_eq(wakes, 2);
    expect_result(RN_RING_ENDED);
    rn_ring_publish(ring, 3, "state", "{}", NULL);
    expect_result(RN_RING_ENDED);
    unmake();
}
END_TEST

START_TEST(test_replay) {
    make(8, 1000);
    for (uint64_t id = 10; id < 15; id++)
        rn_ring_publish(ring, id, "frame", "{}", NULL);
    rn_ring_attach(ring, &reader, 12);
    expect("id: 13\nevent: frame\ndata: {}\n\n");
    expect("id: 14\nevent: frame\ndata: {}\n\n");
    expect_result(RN_RING_EMPTY);
    unmake();
}
END_TEST

START_TEST(test_oldest_is_forgotten) {
    make(3, 1000);
    for (uint64_t id = 1; id <= 5; id++)
        rn_ring_publish(ring, id, "frame", "{}", NULL);
    rn_ring_attach(ring, &reader, 1);
    expect("id: 3\nevent: frame\ndata: {}\n\n");
    unmake();
}
END_TEST

START_TEST(test_bytes_are_bounded) {
    make(100, 10);
    rn_ring_publish(ring, 1, "a", "12345", NULL);
    rn_ring_publish(ring, 2, "b", "12345", NULL);
    rn_ring_publish(ring, 3, "c", "1234567890", NULL);
    rn_ring_publish(ring, 4, "d", "12345678901", NULL);
    rn_ring_attach(ring, &reader, 0);
    expect("id: 3\nevent: c\ndata: 1234567890\n\n");
    expect_result(RN_RING_EMPTY);
    unmake();
}
END_TEST

START_TEST(test_newest_replaces) {
    make(100, 1000);
    rn_ring_publish(ring, 1, "progress", "1", "job_a");
    rn_ring_publish(ring, 2, "progress", "2", "job_b");
    rn_ring_publish(ring, 3, "metric", "m", NULL);
    rn_ring_publish(ring, 4, "progress", "4", "job_a");
    rn_ring_attach(ring, &reader, 0);
    expect("id: 2\nevent: progress\ndata: 2\n\n");
    expect("id: 3\nevent: metric\ndata: m\n\n");
    expect("id: 4\nevent: progress\ndata: 4\n\n");
    expect_result(RN_RING_EMPTY);
    unmake();
}
END_TEST

START_TEST(test_ids_grow) {
    uint64_t before = rn_ring_next_id();
    ck_assert_uint_gt(before, 1600000000000ull); // later than those of an earlier run
    ck_assert_uint_gt(rn_ring_next_id(), before);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("ring");
    TCase *tcase = tcase_create("ring");
    tcase_add_test(tcase, test_order_and_end);
    tcase_add_test(tcase, test_replay);
    tcase_add_test(tcase, test_oldest_is_forgotten);
    tcase_add_test(tcase, test_bytes_are_bounded);
    tcase_add_test(tcase, test_newest_replaces);
    tcase_add_test(tcase, test_ids_grow);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
