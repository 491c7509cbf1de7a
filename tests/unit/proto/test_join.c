// How a runner on another machine and its daemon recognise each other.
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/base/file.h"
#include "proto/join.h"
#include "tests/support/suite.h"

static char folder[] = "/tmp/join-XXXXXX";

static void make_folder(void) {
    strcpy(folder, "/tmp/join-XXXXXX");
    ck_assert_ptr_nonnull(mkdtemp(folder));
}

static void remove_folder(void) {
    OK(rn_remove_tree(folder, &err));
}

START_TEST(a_secret_is_taken_once) {
    struct rn_join join = {.host = "head.cluster", .port = 7374}, other, taken;
    OK(rn_join_make(&join, &err));
    OK(rn_join_make(&other, &err));
    ck_assert_uint_eq(strlen(join.said), RN_JOIN_SECRET_MAX - 1);
    ck_assert(!rn_join_is(join.said, join.heard) && !rn_join_is(join.said, other.said));
    ck_assert_int_eq(rn_join_take(folder, &taken, NULL), RN_ERROR_BUSY);
    OK(rn_join_leave(folder, &join, &err));
    OK(rn_join_take(folder, &taken, &err));
    ck_assert_str_eq(taken.host, join.host);
    ck_assert_uint_eq(taken.port, join.port);
    ck_assert(rn_join_is(taken.said, join.said) && rn_join_is(taken.heard, join.heard));
    ck_assert_int_eq(rn_join_take(folder, &taken, NULL), RN_ERROR_BUSY);
    ck_assert_int_eq(rn_join_take("/nowhere", &taken, NULL), RN_ERROR_NOT_FOUND);
}
END_TEST

START_TEST(what_no_daemon_wrote_is_refused) {
    static const char *const texts[] = {"",
                                        "head",
                                        "head 0\naa\nbb\n",
                                        "head 70000\naa\nbb\n",
                                        "head 7374\nxyz\nbb\n",
                                        "head 7374\naa\n"};
    struct rn_join taken;
    char path[64];
    snprintf(path, sizeof path, "%s/join", folder);
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++) {
        OK(rn_file_write_atomic(path, texts[i], strlen(texts[i]), &err));
        ck_assert_int_eq(rn_join_take(folder, &taken, NULL), RN_ERROR_CORRUPT);
    }
}
END_TEST

START_TEST(a_greeting_survives_the_trip) {
    struct rn_greeting greeting = {.name = "r0123456789abcdef", .machine = "node-17.rack_2"};
    struct rn_greeting heard = {.name = ""};
    char bytes[RN_JOIN_GREETING];
    memset(greeting.said, 'f', sizeof greeting.said - 1);
    rn_join_write_greeting(bytes, &greeting);
    ck_assert(rn_join_read_greeting(bytes, &heard));
    ck_assert_mem_eq(&heard, &greeting, sizeof heard);
    // The longest of each fits, and what is no greeting is none.
    memset(greeting.name, 'r', sizeof greeting.name - 1);
    memset(greeting.machine, 'n', sizeof greeting.machine - 1);
    rn_join_write_greeting(bytes, &greeting);
    ck_assert(rn_join_read_greeting(bytes, &heard));
    ck_assert_mem_eq(&heard, &greeting, sizeof heard);
    bytes[0] = 'G';
    ck_assert(!rn_join_read_greeting(bytes, &heard));
    memset(bytes, 'f', sizeof bytes);
    ck_assert(!rn_join_read_greeting(bytes, &heard));
}
END_TEST

START_TEST(secrets_are_equal_or_not) {
    ck_assert(rn_join_is("abc", "abc"));
    ck_assert(!rn_join_is("abc", "abd") && !rn_join_is("abc", "ab") && !rn_join_is("ab", "abc"));
    ck_assert(!rn_join_is("", "")); // one that was used
}
END_TEST

int main(void) {
    TCase *tests = tcase_create("join");
    tcase_add_checked_fixture(tests, make_folder, remove_folder);
    tcase_add_test(tests, a_secret_is_taken_once);
    tcase_add_test(tests, what_no_daemon_wrote_is_refused);
    tcase_add_test(tests, a_greeting_survives_the_trip);
    tcase_add_test(tests, secrets_are_equal_or_not);
    Suite *suite = suite_create("proto");
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
