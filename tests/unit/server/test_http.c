// Router and guards.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/http/guard.h"
#include "server/http/router.h"
#include "tests/support/suite.h"

static void handle(void *context, struct rn_request *request, struct rn_reply *reply) {}

static const struct rn_route routes[] = {
    {RN_METHOD_GET, "/", 0, 0, handle, NULL},
    {RN_METHOD_GET, "/v1/jobs", 0, 0, handle, NULL},
    {RN_METHOD_POST, "/v1/jobs", 0, 0, handle, NULL},
    {RN_METHOD_GET, "/v1/jobs/{id}", 0, 0, handle, NULL},
    {RN_METHOD_DELETE, "/v1/jobs/{id}", 0, 0, handle, NULL},
    {RN_METHOD_GET, "/v1/jobs/{id}/frames.tar", 0, 0, handle, NULL},
    {RN_METHOD_GET, "/v1/jobs/{id}/frames/{index}", 0, 0, handle, NULL},
    {RN_METHOD_GET, "/web/*", 0, 0, handle, NULL},
    {0},
};

static struct rn_match match(unsigned method, const char *path) {
    struct rn_match found;
    rn_router_match(routes, method, path, &found);
    return found;
}

START_TEST(test_match) {
    ck_assert_ptr_eq(match(RN_METHOD_GET, "/").route, &routes[0]);
    ck_assert_ptr_eq(match(RN_METHOD_POST, "/v1/jobs").route, &routes[2]);
    struct rn_match found = match(RN_METHOD_GET, "/v1/jobs/job_a/frames/12");
    ck_assert_ptr_eq(found.route, &routes[6]);
    ck_assert_int_eq(found.param_count, 2);
    ck_assert_str_eq(found.params[0], "job_a");
    ck_assert_str_eq(found.params[1], "12");
    ck_assert_ptr_eq(match(RN_METHOD_GET, "/v1/jobs/job_a/frames.tar").route, &routes[5]);
    found = match(RN_METHOD_GET, "/web/js/app.js");
    ck_assert_ptr_eq(found.route, &routes[7]);
    ck_assert_str_eq(found.params[0], "js/app.js");
}
END_TEST

START_TEST(test_no_match) {
    static const char *const paths[] = {
        "",          "/v1",   "/v1/jobs/", "/v1/jobs/a/", "/v1/jobs/a/b",
        "//v1/jobs", "/web/", "/V1/jobs",  "v1/jobs"};
    for (size_t i = 0; i < sizeof paths / sizeof paths[0]; i++) {
        struct rn_match found = match(RN_METHOD_GET, paths[i]);
        ck_assert_msg(found.route == NULL && found.allowed == 0, "'%s' matches", paths[i]);
    }
    char path[1000];
    snprintf(path, sizeof path, "/v1/jobs/%0*d", RN_MAX_PARAM_BYTES, 1);
    ck_assert_ptr_null(match(RN_METHOD_GET, path).route);
}
END_TEST

START_TEST(test_other_method) {
    struct rn_match found = match(0, "/v1/jobs/job_a");
    ck_assert_ptr_null(found.route);
    ck_assert_uint_eq(found.allowed, RN_METHOD_GET | RN_METHOD_DELETE);
    found = match(RN_METHOD_POST, "/");
    ck_assert_ptr_null(found.route);
    ck_assert_uint_eq(found.allowed, RN_METHOD_GET);
}
END_TEST

START_TEST(test_token) {
    static const char *const bad[] = {
        NULL, "", "Bearer", "Bearer ", "Basic 0123456789abcdef", "0123456789abcdef"};
    ck_assert_str_eq(rn_guard_bearer("Bearer 0123456789abcdef"), "0123456789abcdef");
    ck_assert_str_eq(rn_guard_bearer("bearer 0123456789abcdef"), "0123456789abcdef");
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        ck_assert_msg(rn_guard_bearer(bad[i]) == NULL, "'%s' passes", bad[i]);
}
END_TEST

START_TEST(test_host) {
    static const char *const good[] = {"localhost",      "LOCALHOST:7373", "127.0.0.1",
                                       "127.0.0.1:7373", "127.8.9.1:80",   "[::1]",
                                       "[::1]:7373"};
    static const char *const bad[] = {NULL,
                                      "",
                                      "evil.example",
                                      "127.0.0.1.evil.example",
                                      "localhost.evil.example:7373",
                                      "128.0.0.1",
                                      "[::2]:80",
                                      "[::1",
                                      "[::1]x",
                                      "localhost:80x",
                                      ":7373",
                                      "0.0.0.0:7373"};
    for (size_t i = 0; i < sizeof good / sizeof good[0]; i++)
        ck_assert_msg(rn_guard_host_is_loopback(good[i]), "'%s' is refused", good[i]);
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++)
        ck_assert_msg(!rn_guard_host_is_loopback(bad[i]), "'%s' passes", bad[i]);
}
END_TEST

START_TEST(test_origin) {
    ck_assert(rn_guard_origin(NULL, "localhost:7373"));
    ck_assert(rn_guard_origin("http://localhost:7373", "localhost:7373"));
    ck_assert(rn_guard_origin("https://Scenes.example", "scenes.example"));
    ck_assert(!rn_guard_origin("null", "localhost:7373"));
    ck_assert(!rn_guard_origin("http://localhost:8080", "localhost:7373"));
    ck_assert(!rn_guard_origin("http://evil.example", "localhost:7373"));
    ck_assert(!rn_guard_origin("http://localhost:7373.evil.example", "localhost:7373"));
    ck_assert(!rn_guard_origin("http://localhost:7373", NULL));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("http");
    TCase *tcase = tcase_create("http");
    tcase_add_test(tcase, test_match);
    tcase_add_test(tcase, test_no_match);
    tcase_add_test(tcase, test_other_method);
    tcase_add_test(tcase, test_token);
    tcase_add_test(tcase, test_host);
    tcase_add_test(tcase, test_origin);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
