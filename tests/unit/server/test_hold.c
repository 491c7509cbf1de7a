// Who stands still for a picture by a deadline: runners that are no processes.
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "server/jobs/inside.h"
#include "tests/support/suite.h"

#define RUNNERS 4
enum { RENDERS, TRAINS, IDLE, ELSEWHERE };

static struct rn_control control;
static struct rn_executor executor;
static struct rn_runner runners[RUNNERS];
static struct rn_task training, other;
static struct rn_render picture;
static bool stands[RUNNERS];
static int calls;

static void hold(struct rn_executor *e, const struct rn_process *process, bool held) {
    ck_assert(e == &executor && stands[process->pid] != held);
    stands[process->pid] = held;
    calls++;
}

static void set_up(void) {
    executor = (struct rn_executor){.hold = hold};
    control = (struct rn_control){.executor = &executor, .wake_fd = eventfd(0, EFD_NONBLOCK)};
    memset(stands, 0, sizeof stands);
    calls = 0;
    for (int i = 0; i < RUNNERS; i++)
        runners[i] = (struct rn_runner){.mode = "field",
                                        .process = {.pid = i, .fd = -1, .remote = i == ELSEWHERE},
                                        .state = RN_RUNNER_READY,
                                        .next = i + 1 < RUNNERS ? &runners[i + 1] : NULL};
    runners[TRAINS].train = &training;
    runners[ELSEWHERE].train = &other;
    control.runners = runners;
    picture = (struct rn_render){.number = 1, .begin_ns = rn_clock_ns(), .sent = true};
    rn_message_init(&rn_render_request_table, &picture.request);
    runners[RENDERS].renders = &picture;
}

static void tear_down(void) {
    rn_message_finish(&rn_render_request_table, &picture.request);
    close(control.wake_fd);
}

static void ask_within(double ms) {
    rn_settings_value(&rn_render_settings, picture.request.settings, "within")->number = ms;
}

static void answered(void) {
    runners[RENDERS].renders = NULL;
    rn_hold_others(&control);
}

// The rest of a second is never met here: a picture has only just begun.
START_TEST(a_training_waits) {
    rn_hold_others(&control);
    ck_assert_int_eq(calls, 0); // a picture that takes as long as it takes
    ask_within(900);
    rn_hold_others(&control);
    ck_assert(stands[TRAINS] && calls == 1);
    rn_hold_others(&control);
    ck_assert_int_eq(calls, 1);
    answered();
    ck_assert(!stands[TRAINS] && calls == 2);
}
END_TEST

START_TEST(only_for_what_is_urgent) {
    ask_within(5000); // the cores can be shared
    rn_hold_others(&control);
    ask_within(900);
    picture.begin_ns -= 1000000000; // late already
    rn_hold_others(&control);
    picture.begin_ns += 1000000000;
    picture.sent = false;
    rn_hold_others(&control);
    picture.sent = true;
    runners[RENDERS].process.remote = true; // other cores
    rn_hold_others(&control);
    ck_assert_int_eq(calls, 0);
}
END_TEST

// One that has a picture of its own to make, or is told to end, goes on at once.
START_TEST(whoever_is_needed_goes_on) {
    struct rn_render own = {.number = 2, .begin_ns = rn_clock_ns()};
    ask_within(900);
    rn_hold_others(&control);
    ck_assert(stands[TRAINS]);
    runners[TRAINS].renders = &own;
    rn_hold_others(&control);
    ck_assert(!stands[TRAINS]);
    runners[TRAINS].renders = NULL;
    rn_hold_others(&control);
    ck_assert(stands[TRAINS]);
    runners[TRAINS].state = RN_RUNNER_ENDING;
    rn_hold_others(&control);
    ck_assert(!stands[TRAINS]);
}
END_TEST

// However many follow one another, of every second some is the training's.
START_TEST(nobody_waits_for_ever) {
    ask_within(900);
    rn_hold_others(&control);
    ck_assert(stands[TRAINS]);
    control.urgent_ns = rn_clock_ns() - 2960000000;
    rn_hold_others(&control);
    ck_assert(!stands[TRAINS]);
    control.urgent_ns = rn_clock_ns() - 2500000000;
    rn_hold_others(&control);
    ck_assert(stands[TRAINS]);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("hold");
    TCase *cases = tcase_create("hold");
    tcase_add_checked_fixture(cases, set_up, tear_down);
    tcase_add_test(cases, a_training_waits);
    tcase_add_test(cases, only_for_what_is_urgent);
    tcase_add_test(cases, whoever_is_needed_goes_on);
    tcase_add_test(cases, nobody_waits_for_ever);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
