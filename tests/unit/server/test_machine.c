// Every state with every event: the legal transitions are listed here once more, all others must
// be conflicts that name the state.
#include <stdlib.h>
#include <string.h>

#include "server/jobs/machine.h"
#include "tests/support/suite.h"

#define ANY -1

struct legal {
    enum rn_job_state from;
    enum rn_job_event event;
    int attached; // ANY, 0, 1
    bool train_only;
    enum rn_job_state to;
};

static const struct legal legal[] = {
    {RN_JOB_QUEUED, RN_JOB_START, ANY, false, RN_JOB_RUNNING},
    {RN_JOB_QUEUED, RN_JOB_PAUSE, ANY, true, RN_JOB_PAUSED},
    {RN_JOB_QUEUED, RN_JOB_CANCEL, 0, false, RN_JOB_CANCELLED},
    {RN_JOB_QUEUED, RN_JOB_CANCEL, 1, false, RN_JOB_CANCELLING},
    {RN_JOB_QUEUED, RN_JOB_FAIL, ANY, false, RN_JOB_FAILED},
    {RN_JOB_QUEUED, RN_JOB_LOST, ANY, false, RN_JOB_QUEUED},
    {RN_JOB_RUNNING, RN_JOB_PAUSE, ANY, true, RN_JOB_PAUSED},
    {RN_JOB_RUNNING, RN_JOB_FINISH, ANY, true, RN_JOB_RUNNING},
    {RN_JOB_RUNNING, RN_JOB_CANCEL, 1, false, RN_JOB_CANCELLING},
    {RN_JOB_RUNNING, RN_JOB_CANCEL, 0, false, RN_JOB_CANCELLED},
    {RN_JOB_RUNNING, RN_JOB_DONE, ANY, false, RN_JOB_SUCCEEDED},
    {RN_JOB_RUNNING, RN_JOB_FAIL, ANY, false, RN_JOB_FAILED},
    {RN_JOB_RUNNING, RN_JOB_STOPPED, ANY, false, RN_JOB_CANCELLED},
    {RN_JOB_RUNNING, RN_JOB_LOST, ANY, false, RN_JOB_INTERRUPTED},
    {RN_JOB_PAUSED, RN_JOB_RESUME, ANY, false, RN_JOB_QUEUED},
    {RN_JOB_PAUSED, RN_JOB_FINISH, 1, true, RN_JOB_RUNNING},
    {RN_JOB_PAUSED, RN_JOB_FINISH, 0, true, RN_JOB_QUEUED},
    {RN_JOB_PAUSED, RN_JOB_CANCEL, 1, false, RN_JOB_CANCELLING},
    {RN_JOB_PAUSED, RN_JOB_CANCEL, 0, false, RN_JOB_CANCELLED},
    {RN_JOB_PAUSED, RN_JOB_DONE, ANY, false, RN_JOB_SUCCEEDED},
    {RN_JOB_PAUSED, RN_JOB_FAIL, ANY, false, RN_JOB_FAILED},
    {RN_JOB_PAUSED, RN_JOB_STOPPED, ANY, false, RN_JOB_CANCELLED},
    {RN_JOB_PAUSED, RN_JOB_LOST, ANY, false, RN_JOB_PAUSED},
    {RN_JOB_CANCELLING, RN_JOB_CANCEL, ANY, false, RN_JOB_CANCELLING},
    {RN_JOB_CANCELLING, RN_JOB_DONE, ANY, false, RN_JOB_SUCCEEDED},
    {RN_JOB_CANCELLING, RN_JOB_FAIL, ANY, false, RN_JOB_FAILED},
    {RN_JOB_CANCELLING, RN_JOB_STOPPED, ANY, false, RN_JOB_CANCELLED},
    {RN_JOB_CANCELLING, RN_JOB_LOST, ANY, false, RN_JOB_CANCELLED},
    {RN_JOB_CANCELLED, RN_JOB_CANCEL, ANY, false, RN_JOB_CANCELLED},
    {RN_JOB_INTERRUPTED, RN_JOB_REQUEUE, ANY, false, RN_JOB_QUEUED},
    {RN_JOB_INTERRUPTED, RN_JOB_GIVE_UP, ANY, false, RN_JOB_FAILED},
    {RN_JOB_INTERRUPTED, RN_JOB_CANCEL, ANY, false, RN_JOB_CANCELLED},
};

static const struct legal *find(enum rn_job_type type, enum rn_job_state state,
                                enum rn_job_event event, bool attached) {
    for (size_t i = 0; i < sizeof legal / sizeof legal[0]; i++)
        if (legal[i].from == state && legal[i].event == event &&
            (legal[i].attached == ANY || legal[i].attached == attached) &&
            (!legal[i].train_only || type == RN_JOB_TRAIN))
            return &legal[i];
    return NULL;
}

START_TEST(test_transitions) {
    for (int type = RN_JOB_TRAIN; type <= RN_JOB_INGEST; type++)
        for (int state = RN_JOB_QUEUED; state <= RN_JOB_INTERRUPTED; state++)
            for (int event = 0; event < RN_JOB_EVENT_COUNT; event++)
                for (int attached = 0; attached < 2; attached++) {
                    const struct legal *expected =
                        find((enum rn_job_type)type, (enum rn_job_state)state,
                             (enum rn_job_event)event, attached != 0);
                    enum rn_job_state next = RN_JOB_QUEUED;
                    struct rn_error err = {0};
                    enum rn_status status =
                        rn_job_next((enum rn_job_type)type, (enum rn_job_state)state,
                                    (enum rn_job_event)event, attached != 0, &next, &err);
                    ck_assert_msg((status == RN_OK) == (expected != NULL),
                                  "%s job, %s, %s, attached %d: status %d", rn_job_type_names[type],
                                  rn_job_state_names[state],
                                  rn_job_event_name((enum rn_job_event)event), attached, status);
                    if (expected != NULL) {
                        ck_assert_int_eq(next, expected->to);
                        continue;
                    }
                    ck_assert_int_eq(status, RN_ERROR_CONFLICT);
                    ck_assert_ptr_nonnull(strstr(err.text, rn_job_state_names[state]));
                }
}
END_TEST

// From every state that is not over, an end can be reached.
START_TEST(test_no_dead_end) {
    bool ends[RN_JOB_INTERRUPTED + 1] = {0};
    for (int state = 0; state <= RN_JOB_INTERRUPTED; state++)
        ends[state] = rn_job_is_over((enum rn_job_state)state);
    for (int round = 0; round <= RN_JOB_INTERRUPTED; round++)
        for (size_t i = 0; i < sizeof legal / sizeof legal[0]; i++)
            ends[legal[i].from] |= !legal[i].train_only && ends[legal[i].to];
    for (int state = 0; state <= RN_JOB_INTERRUPTED; state++)
        ck_assert_msg(ends[state], "no way out of %s", rn_job_state_names[state]);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("machine");
    TCase *tcase = tcase_create("machine");
    tcase_add_test(tcase, test_transitions);
    tcase_add_test(tcase, test_no_dead_end);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
