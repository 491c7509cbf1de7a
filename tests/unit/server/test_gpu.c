// Who gets how much of a GPU, who waits, and who goes: runners that are sockets, no processes.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/jobs/inside.h"
#include "tests/support/suite.h"

#define RUNNERS 4
#define NOTHING -1 // has been answered
#define RESTS -2   // was told to give its memory back
#define ENDS -3    // was told to end

static struct rn_control control;
static struct rn_runner runners[RUNNERS];
static struct rn_wire_reader ends[RUNNERS]; // the runners' ends
static struct rn_task training;
static int64_t asked[RUNNERS]; // the number of each one's last question

static void set_up(void) {
    training.row.state = RN_JOB_RUNNING;
    control = (struct rn_control){.wake_fd = eventfd(0, EFD_NONBLOCK)};
    control.options.gpu_memory_bytes = 100;
    for (int i = 0; i < RUNNERS; i++) {
        int pair[2];
        ck_assert_int_eq(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, pair), 0);
        runners[i] = (struct rn_runner){.mode = "field",
                                        .process = {.pid = i, .fd = pair[0]},
                                        .state = RN_RUNNER_READY,
                                        .last_used_ns = i + 1,
                                        .next = i + 1 < RUNNERS ? &runners[i + 1] : NULL};
        rn_wire_reader_init(&ends[i], pair[1]);
        rn_wire_writer_init(&runners[i].writer, pair[0], 0);
    }
    control.runners = runners;
}

static void tear_down(void) {
    for (int i = 0; i < RUNNERS; i++) {
        rn_wire_writer_finish(&runners[i].writer);
        rn_wire_reader_finish(&ends[i]);
        close(runners[i].process.fd);
        close(ends[i].fd);
    }
    close(control.wake_fd);
}

// What runner `i` has been told since it was last asked here.
static int64_t told(int i) {
    struct rn_wire_message message;
    struct rn_wire_grant grant;
    struct rn_error err;
    bool ready;
    ck_assert(rn_wire_read(&ends[i], &ready, &message, &err) == RN_OK);
    if (!ready) return NOTHING;
    int64_t bytes = message.type == RN_WIRE_REST ? RESTS : ENDS;
    if (message.type == RN_WIRE_GRANT) {
        ck_assert(rn_wire_take(&message, &grant, &err) == RN_OK);
        ck_assert_int_eq(grant.number, asked[i]);
        bytes = grant.bytes;
    }
    rn_wire_message_finish(&message);
    return bytes;
}

// Runner `i` asks; the answer, if there is one.
static int64_t ask(int i, int64_t bytes, bool patient, int64_t free_bytes) {
    struct rn_wire_reserve reserve = {.number = asked[i] += 10,
                                      .device = "cuda:0",
                                      .bytes = bytes,
                                      .free_bytes = free_bytes,
                                      .patient = patient};
    rn_gpu_reserve(&control, &runners[i], &reserve);
    return told(i);
}

static void give_back(int i) {
    ck_assert_int_eq(ask(i, 0, false, 0), NOTHING);
}

// Its process has ended.
static void gone(int i) {
    for (struct rn_runner **link = &control.runners; *link != NULL; link = &(*link)->next)
        if (*link == &runners[i]) {
            *link = runners[i].next;
            break;
        }
    rn_gpu_share(&control);
}

START_TEST(the_one_used_longest_ago_makes_room) {
    ck_assert_int_eq(ask(0, 40, false, 0), 40);
    ck_assert_int_eq(ask(1, 40, false, 0), 40);
    runners[0].last_used_ns = 10; // runner 1 was used before it
    ck_assert_int_eq(ask(2, 40, false, 0), NOTHING);
    ck_assert_int_eq(told(1), RESTS);
    ck_assert_int_eq(told(0), NOTHING);
    rn_gpu_share(&control); // it still holds its memory, and no other one has to go
    ck_assert_int_eq(told(2), NOTHING);
    ck_assert_int_eq(told(0), NOTHING);
    give_back(1);
    ck_assert_int_eq(told(2), 40);
    ck_assert_uint_eq(control.stats.scenes_rested, 1);
    ck_assert_int_eq(runners[0].gpu_bytes + runners[2].gpu_bytes, 80);
    ck_assert_int_eq(runners[1].last_used_ns, 2);
    ck_assert_int_eq(ask(1, 40, false, 0), NOTHING); // it is wanted again
    ck_assert_int_eq(told(2), RESTS);
    give_back(2);
    ck_assert_int_eq(told(1), 40);
}
END_TEST

START_TEST(as_many_go_as_it_takes) {
    for (int i = 0; i < 3; i++)
        ck_assert_int_eq(ask(i, 30, false, 0), 30);
    training.row.state = RN_JOB_PAUSED;
    runners[0].train = &training;
    ck_assert_int_eq(ask(3, 65, true, 0), NOTHING);
    ck_assert_int_eq(told(0), ENDS); // a paused training goes on in another runner
    ck_assert_int_eq(told(1), RESTS);
    ck_assert_int_eq(told(2), NOTHING);
    give_back(1);
    ck_assert_int_eq(told(3), NOTHING);
    gone(0);
    ck_assert_int_eq(told(3), 65);
}
END_TEST

START_TEST(who_works_is_waited_for) {
    ck_assert_int_eq(ask(0, 30, false, 0), 30);
    ck_assert_int_eq(ask(1, 60, true, 0), 60);
    runners[1].train = &training;
    ck_assert_int_eq(ask(2, 80, true, 0), NOTHING); // nobody goes in vain
    ck_assert_int_eq(told(0), NOTHING);
    ck_assert_int_eq(ask(3, 80, false, 0), 40); // refused: so much there would be
    ck_assert_int_eq(runners[3].gpu_bytes, 0);
    runners[1].train = NULL;
    ck_assert_int_eq(ask(1, 20, false, 0), 20); // at rest it holds less
    ck_assert_int_eq(told(0), RESTS);
    ck_assert_int_eq(told(1), NOTHING);
    give_back(0);
    ck_assert_int_eq(told(2), 80);
}
END_TEST

START_TEST(what_is_on_its_way_is_counted_once) {
    ck_assert_int_eq(ask(0, 40, true, 0), 40);
    runners[0].train = &training;
    ck_assert_int_eq(ask(1, 40, false, 0), 40);
    ck_assert_int_eq(ask(2, 60, true, 0), NOTHING);
    ck_assert_int_eq(told(1), RESTS);
    ck_assert_int_eq(ask(3, 70, false, 0), 60);
    ck_assert_int_eq(told(1), NOTHING);
    give_back(1);
    ck_assert_int_eq(told(2), 60);
}
END_TEST

START_TEST(first_come_first_served) {
    ck_assert_int_eq(ask(0, 60, true, 0), 60);
    runners[0].train = &training;
    ck_assert_int_eq(ask(1, 90, true, 0), NOTHING);
    ck_assert_int_eq(ask(2, 40, true, 0), NOTHING); // would fit, but is not next
    ck_assert_int_eq(ask(3, 40, false, 0), 40);     // a picture need not wait for a training
    gone(0);
    ck_assert_int_eq(told(3), RESTS);
    give_back(3);
    ck_assert_int_eq(told(1), 90);
    rn_gpu_share(&control);
    ck_assert_int_eq(told(2), NOTHING);
    ck_assert_int_eq(told(1), RESTS); // which is idle here
    give_back(1);
    ck_assert_int_eq(told(2), 40);
}
END_TEST

START_TEST(what_never_fits_is_refused_at_once) {
    ck_assert_int_eq(ask(0, 70, false, 0), 70);
    ck_assert_int_eq(ask(1, 101, true, 0), 100);
    ck_assert_int_eq(runners[1].gpu_bytes, 0);
    ck_assert_int_eq(told(0), NOTHING);
    ck_assert_int_eq(ask(0, 50, true, 0), 50); // of its own
    ck_assert_int_eq(ask(0, 100, true, 0), 100);
    snprintf(runners[2].gpu, sizeof runners[2].gpu, "cuda:1");
    runners[2].gpu_bytes = 100;
    ck_assert_int_eq(ask(0, 50, true, 0), 50); // another device is none of its business
    ck_assert_int_eq(ask(0, 100, true, 0), 100);
    ck_assert_int_eq(ask(0, 0, false, 0), NOTHING);
    ck_assert_int_eq(runners[0].gpu_bytes, 0);
}
END_TEST

START_TEST(without_an_option_there_is_what_was_free) {
    control.options.gpu_memory_bytes = 0;
    ck_assert_int_eq(ask(0, 40, false, 90), 40);
    ck_assert_int_eq(ask(1, 50, false, 50), 50); // of 90; another's is not free any more
    ck_assert_int_eq(ask(0, 0, false, 0), NOTHING);
    ck_assert_int_eq(ask(1, 0, false, 0), NOTHING);
    ck_assert_int_eq(ask(1, 50, true, 30), 30); // other programs have come
}
END_TEST

int main(void) {
    Suite *suite = suite_create("gpu");
    TCase *tcase = tcase_create("gpu");
    tcase_add_checked_fixture(tcase, set_up, tear_down);
    tcase_add_test(tcase, the_one_used_longest_ago_makes_room);
    tcase_add_test(tcase, as_many_go_as_it_takes);
    tcase_add_test(tcase, who_works_is_waited_for);
    tcase_add_test(tcase, what_is_on_its_way_is_counted_once);
    tcase_add_test(tcase, first_come_first_served);
    tcase_add_test(tcase, what_never_fits_is_refused_at_once);
    tcase_add_test(tcase, without_an_option_there_is_what_was_free);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
