// The end of a Check program's main.
#ifndef RN_TESTS_SUPPORT_SUITE_H
#define RN_TESTS_SUPPORT_SUITE_H

#include <check.h>
#include <stdbool.h>
#include <stdio.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/base/status.h"

// A call that says with `err` what went wrong.
#define OK(call)                                                                                   \
    do {                                                                                           \
        struct rn_error err = {0};                                                                 \
        enum rn_status status = (call);                                                            \
        ck_assert_msg(status == RN_OK, "%s: %s", #call, err.text);                                 \
    } while (0)

// Runs a suite, which it frees; the exit code.
static inline int run_suite(Suite *suite) {
    SRunner *runner = srunner_create(suite);
    srunner_run_all(runner, CK_NORMAL);
    int failed = srunner_ntests_failed(runner);
    srunner_free(runner);
    return failed != 0;
}

// What `holds` says in a process of its own: who has met a GPU once cannot fork, as Check does for
// every test.
static inline bool holds_in_a_child(bool (*holds)(void)) {
    int status = 1;
    pid_t child = fork();
    if (child == 0) {
        bool held = holds();
        fflush(stdout);
        _exit(!held);
    }
    return child > 0 && waitpid(child, &status, 0) == child && status == 0;
}

#endif
