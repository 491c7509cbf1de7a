// Who stands still for a picture by a deadline: runners that are no processes.
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "server/jobs/inside.h"
#include "tests/support/suite.h"

#define RUNNERS 4
#define HOUR_NS 3600000000000ll // ahead of the clock: a machine that stalls makes no picture late
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
    picture = (struct rn_render){.number = 1, .begin_ns = rn_clock_ns() + HOUR_NS, .sent = true};
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
    picture.begin_ns -= HOUR_NS + 1000000000; // late already
    rn_hold_others(&control);
    picture.begin_ns += HOUR_NS + 1000000000;
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

// However many follow one another, after each it has its turn, also while the next one is made.
START_TEST(nobody_waits_for_ever) {
    int64_t second_ns = 1000000000;
    ask_within(900);
    picture.begin_ns = rn_clock_ns() - 900 * second_ns;
    rn_turns_end(&control.turns, picture.begin_ns - second_ns, picture.begin_ns, 1);
    rn_hold_after(&control, &picture); // a quarter of an hour after the one before
    int64_t own_ms = (control.turns.own_until_ns - control.turns.ended_ns) / 1000000;
    ck_assert_int_eq(own_ms, 50);
    picture.begin_ns = rn_clock_ns() + HOUR_NS;
    control.turns.ended_ns -= second_ns;
    control.turns.own_until_ns += 100 * second_ns;
    rn_hold_others(&control);
    ck_assert(!stands[TRAINS]);
    control.turns.own_until_ns -= 101 * second_ns;
    rn_hold_others(&control);
    ck_assert(stands[TRAINS]);
}
END_TEST

// Between two pictures that follow one another nothing else is on the cores; but the runner that
// makes them, which has something to train itself, sees to that alone.
START_TEST(it_waits_for_the_next_one) {
    ask_within(900);
    control.turns.wait_until_ns = INT64_MAX;
    runners[RENDERS].train = &other;
    runners[RENDERS].last_used_ns = rn_clock_ns() + 1000000000000;
    answered();
    ck_assert(stands[TRAINS] && !stands[RENDERS]);
    ck_assert_int_eq(rn_hold_timeout_ms(&control, 500), 500);
    control.turns.free_until_ns = INT64_MAX; // but for its turn
    rn_hold_others(&control);
    ck_assert(!stands[TRAINS]);
    control.turns = (struct rn_turns){.free_until_ns = rn_clock_ns()};
    ck_assert_int_eq(rn_hold_timeout_ms(&control, 500), 500); // nothing more changes
    control.turns.wait_until_ns = rn_clock_ns() + 1000000000;
    ck_assert_int_le(rn_hold_timeout_ms(&control, 2000), 1001);
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
    tcase_add_test(cases, it_waits_for_the_next_one);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
