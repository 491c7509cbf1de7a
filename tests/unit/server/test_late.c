// Which runners are late: of one that is given no processor, what it has had counts.
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include "server/jobs/inside.h"
#include "tests/support/suite.h"

#define SECOND_NS 1000000000ll
#define TIMEOUT_S 20
#define START_S 60

static struct rn_control control;
static struct rn_executor executor;
static struct rn_runner runner;
static struct rn_task training;
static int64_t used_ns;
static bool ready;

static int64_t tell_used(struct rn_executor *e, const struct rn_process *process, bool *ret_ready) {
    ck_assert(e == &executor && process == &runner.process);
    if (ret_ready != NULL) *ret_ready = ready;
    return used_ns;
}

static void set_up(void) {
    executor = (struct rn_executor){.used = tell_used};
    control =
        (struct rn_control){.executor = &executor, .options = {.runner_timeout_s = TIMEOUT_S}};
    runner = (struct rn_runner){.mode = "field",
                                .state = RN_RUNNER_READY,
                                .train = &training,
                                .deadline_ns = START_S * SECOND_NS};
    used_ns = 0;
    ready = false;
}

// After how many seconds of silence it is late, looked at each half of one; -1: not within an hour.
static int late_after(double share) {
    for (int64_t half = 0; half < 7200; half++) {
        used_ns = (int64_t)((double)half * share * 0.5e9);
        if (rn_runner_is_late(&control, &runner, half * SECOND_NS / 2)) return (int)(half / 2);
    }
    return -1;
}

START_TEST(one_that_sleeps_hangs) {
    ck_assert_int_eq(late_after(0), TIMEOUT_S);
}
END_TEST

START_TEST(so_does_one_that_works_for_ever) {
    ready = true;
    ck_assert_int_eq(late_after(1), TIMEOUT_S);
    set_up();
    ready = true;
    ck_assert_int_eq(late_after(4), TIMEOUT_S); // on four cores
}
END_TEST

START_TEST(one_that_is_given_no_processor_is_waited_for) {
    ready = true;
    ck_assert_int_eq(late_after(0), -1);
    set_up();
    ready = true;
    int seconds = late_after(0.1);
    ck_assert(seconds > 9 * TIMEOUT_S && seconds < 11 * TIMEOUT_S);
}
END_TEST

START_TEST(so_is_one_that_starts) {
    runner.state = RN_RUNNER_STARTING;
    ck_assert_int_eq(late_after(0), START_S);
    set_up();
    runner.state = RN_RUNNER_STARTING;
    ready = true;
    ck_assert_int_eq(late_after(0), -1);
}
END_TEST

START_TEST(but_not_one_that_is_to_end) {
    runner.state = RN_RUNNER_ENDING;
    ready = true;
    ck_assert_int_eq(late_after(0), START_S);
}
END_TEST

START_TEST(of_another_machine_the_clock_counts) {
    runner.process.remote = true;
    ready = true;
    ck_assert_int_eq(late_after(0), TIMEOUT_S);
    set_up();
    used_ns = -1;
    executor.used = NULL;
    ck_assert_int_eq(late_after(0), TIMEOUT_S);
}
END_TEST

// A process whose name looks like what /proc says behind it.
static pid_t begin(bool works) {
    pid_t pid = fork();
    ck_assert_int_ge(pid, 0);
    if (pid == 0) prctl(PR_SET_NAME, works ? "a) S 1 (b" : "a) R 1 (b");
    for (volatile unsigned i = 0; pid == 0; i++)
        if (!works) pause();
    return pid;
}

START_TEST(what_a_process_has_had) {
    struct rn_executor *local;
    bool can_go_on = false;
    ck_assert_int_eq(rn_local_executor_create("/bin/true", false, &local, NULL), RN_OK);
    struct rn_process works = {.pid = begin(true)}, sleeps = {.pid = begin(false)};
    while (!can_go_on || local->used(local, &works, NULL) == 0)
        (void)local->used(local, &works, &can_go_on);
    while (can_go_on)
        ck_assert_int_ge(local->used(local, &sleeps, &can_go_on), 0);
    kill(works.pid, SIGSTOP);
    ck_assert_int_eq(waitpid(works.pid, NULL, WUNTRACED), works.pid);
    ck_assert_int_gt(local->used(local, &works, &can_go_on), 0);
    ck_assert(!can_go_on);
    kill(works.pid, SIGKILL);
    kill(sleeps.pid, SIGKILL);
    ck_assert_int_eq(waitpid(works.pid, NULL, 0), works.pid);
    ck_assert_int_eq(waitpid(sleeps.pid, NULL, 0), sleeps.pid);
    ck_assert_int_eq(local->used(local, &works, &can_go_on), -1);
    local->destroy(local);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("late");
    TCase *cases = tcase_create("late");
    tcase_add_checked_fixture(cases, set_up, NULL);
    tcase_add_test(cases, one_that_sleeps_hangs);
    tcase_add_test(cases, so_does_one_that_works_for_ever);
    tcase_add_test(cases, one_that_is_given_no_processor_is_waited_for);
    tcase_add_test(cases, so_is_one_that_starts);
    tcase_add_test(cases, but_not_one_that_is_to_end);
    tcase_add_test(cases, of_another_machine_the_clock_counts);
    tcase_add_test(cases, what_a_process_has_had);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
