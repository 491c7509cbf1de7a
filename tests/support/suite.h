// The end of a Check program's main.
#ifndef RN_TESTS_SUPPORT_SUITE_H
#define RN_TESTS_SUPPORT_SUITE_H

#include <check.h>

// Runs a suite, which it frees; the exit code.
static inline int run_suite(Suite *suite) {
    SRunner *runner = srunner_create(suite);
    srunner_run_all(runner, CK_NORMAL);
    int failed = srunner_ntests_failed(runner);
    srunner_free(runner);
    return failed != 0;
}

#endif
