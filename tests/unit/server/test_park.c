// The HTTP server with handlers of the test's own: parked requests and event streams.
#include <arpa/inet.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "server/http/ring.h"
#include "server/http/server.h"
#include "tests/support/suite.h"

#define PATIENCE_S 50 // the machine may be busy; a case has a minute

static struct rn_http *http;
static struct rn_ring *ring;
static _Atomic(struct rn_parked *) parked;
static atomic_int gone, park_ms, sent;
static _Atomic int64_t answered_ns, sent_ns;

static void on_gone(void *context, struct rn_parked *request) {
    ck_assert_ptr_eq(request, parked);
    gone++;
}

static void park(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err;
    struct rn_parked *handle;
    if (rn_request_park(request, park_ms, on_gone, NULL, &handle, &err) != RN_OK)
        rn_reply_error(reply, &err);
    else
        parked = handle;
}

// Another thread could be quicker than the handler's return.
static void park_and_answer(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err;
    struct rn_parked *handle;
    struct rn_reply answer = {0};
    ck_assert_int_eq(rn_request_park(request, park_ms, on_gone, NULL, &handle, &err), RN_OK);
    rn_reply_text(&answer, 200, "text/plain", "at once");
    rn_parked_answer(handle, &answer);
}

static void follow(void *context, struct rn_request *request, struct rn_reply *reply) {
    rn_reply_events(reply, rn_ring_ref(ring), 0);
}

static const struct rn_route routes[] = {
    {RN_METHOD_GET, "/park", 0, 0, park, NULL},
    {RN_METHOD_GET, "/at-once", 0, 0, park_and_answer, NULL},
    {RN_METHOD_GET, "/events", 0, 0, follow, NULL},
    {0},
};

static void enter(void) {
    struct rn_http_options options = {
        .address = "127.0.0.1", .routes = routes, .max_parked = 2, .idle_timeout_s = 1};
    struct rn_error err;
    parked = NULL;
    gone = 0;
    park_ms = 1000 * PATIENCE_S;
    ck_assert_int_eq(rn_ring_create(10000, 64u << 20, &ring, &err), RN_OK);
    ck_assert_int_eq(rn_http_start(&options, &http, &err), RN_OK);
}

static void leave(void) {
    rn_http_destroy(&http);
    rn_ring_unref(&ring);
}

static int ask(const char *path) {
    char text[128];
    struct timeval timeout = {.tv_sec = PATIENCE_S};
    struct sockaddr_in address = {.sin_family = AF_INET,
                                  .sin_port = htons(rn_http_port(http)),
                                  .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int fd = socket(AF_INET, SOCK_STREAM, 0), small = 4096;
    setsockopt(fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);
    ck_assert_int_eq(connect(fd, (struct sockaddr *)&address, sizeof address), 0);
    int size = snprintf(text, sizeof text, "GET %s HTTP/1.1\r\nHost: localhost\r\n\r\n", path);
    ck_assert_int_eq(send(fd, text, (size_t)size, 0), size);
    return fd;
}

static const char *read_some(int fd) {
    static char text[4096];
    ssize_t size = recv(fd, text, sizeof text - 1, 0);
    text[size > 0 ? size : 0] = '\0';
    return text;
}

// Reads on until `words` have come, since an answer may come in several pieces; all that came.
static const char *expect(int fd, const char *words) {
    static char seen[8192];
    *seen = '\0';
    while (strstr(seen, words) == NULL) {
        const char *more = read_some(fd);
        ck_assert_msg(*more && strlen(seen) + strlen(more) < sizeof seen, "'%s' after '%.80s'",
                      words, seen);
        strcat(seen, more);
    }
    return seen;
}

static void expect_status(int fd, int status) {
    char wanted[32];
    snprintf(wanted, sizeof wanted, "HTTP/1.1 %d ", status);
    const char *text = expect(fd, wanted);
    ck_assert_msg(text == strstr(text, wanted), "'%.40s'", text);
}

#define WAIT_UNTIL(condition)                                                                      \
    for (int tries = 0; !(condition); tries++) {                                                   \
        ck_assert_msg(tries < 100 * PATIENCE_S, "%s does not come true", #condition);              \
        usleep(10000);                                                                             \
    }

static void answer(const char *text) {
    struct rn_reply reply = {0};
    rn_reply_text(&reply, 200, "text/plain", text);
    rn_parked_answer(parked, &reply);
    ck_assert_int_eq(reply.status, 0);
}

static void on_sent(void *context, int64_t number, int64_t now_ns) {
    ck_assert_ptr_eq(context, &sent);
    sent_ns = now_ns;
    sent = (int)number;
}

// Whoever answers is told when the last byte went, and not of an answer that nobody took.
START_TEST(test_sent) {
    struct rn_reply reply = {.on_sent = on_sent, .sent_context = &sent, .sent_number = 7};
    sent = 0;
    int fd = ask("/park");
    WAIT_UNTIL(parked != NULL);
    answered_ns = rn_clock_ns();
    rn_reply_text(&reply, 200, "text/plain", "later");
    rn_parked_answer(parked, &reply);
    expect_status(fd, 200);
    WAIT_UNTIL(sent == 7);
    ck_assert(sent_ns > answered_ns && sent_ns <= rn_clock_ns());
    close(fd);
    sent = 0;
    parked = NULL;
    fd = ask("/park");
    WAIT_UNTIL(parked != NULL);
    close(fd);
    WAIT_UNTIL(gone == 1);
    reply = (struct rn_reply){.on_sent = on_sent, .sent_context = &sent, .sent_number = 8};
    rn_reply_text(&reply, 200, "text/plain", "too late");
    rn_parked_answer(parked, &reply);
    leave();
    ck_assert_int_eq(sent, 0);
    enter();
}
END_TEST

START_TEST(test_answer) {
    int fd = ask("/park");
    WAIT_UNTIL(parked != NULL);
    answer("later");
    expect(fd, "\r\n\r\nlater");
    ck_assert_int_eq(gone, 0);
    close(fd);
    fd = ask("/at-once");
    expect(fd, "\r\n\r\nat once");
    close(fd);
}
END_TEST

START_TEST(test_deadline) {
    park_ms = 100;
    int fd = ask("/park");
    expect_status(fd, 503);
    WAIT_UNTIL(gone == 1);
    answer("too late"); // dropped, and the handle is given back
    close(fd);
}
END_TEST

START_TEST(test_client_leaves) {
    int fd = ask("/park");
    WAIT_UNTIL(parked != NULL);
    close(fd);
    WAIT_UNTIL(gone == 1);
    rn_parked_answer(parked, NULL);
    struct rn_http_stats stats;
    rn_http_stats(http, &stats);
    ck_assert_uint_eq(stats.gone, 1);
}
END_TEST

START_TEST(test_park_limit) {
    struct rn_parked *first, *second;
    int a = ask("/park");
    WAIT_UNTIL(parked != NULL);
    first = parked;
    int b = ask("/park");
    WAIT_UNTIL(parked != first);
    second = parked;
    int c = ask("/park");
    expect_status(c, 503);
    parked = first;
    answer("a");
    parked = second;
    answer("b");
    expect_status(a, 200);
    expect_status(b, 200);
    close(a);
    close(b);
    close(c);
}
END_TEST

START_TEST(test_drain) {
    int waiting = ask("/park"), stream = ask("/events");
    WAIT_UNTIL(parked != NULL);
    expect(stream, "text/event-stream");
    int64_t begin_ns = rn_clock_ns();
    rn_http_drain(http, 1000 * PATIENCE_S);
    ck_assert_int_lt(rn_clock_ns() - begin_ns, PATIENCE_S * 900000000ll);
    expect_status(waiting, 503);
    ck_assert_int_eq(gone, 1);
    rn_parked_answer(parked, NULL);
    close(waiting);
    close(stream);
}
END_TEST

// The library aborts the process when it is stopped with a suspended connection.
START_TEST(test_destroy_with_suspended) {
    int waiting = ask("/park"), stream = ask("/events");
    WAIT_UNTIL(parked != NULL);
    read_some(stream);
    usleep(100000);
    rn_parked_answer(parked, NULL);
    rn_http_destroy(&http);
    close(waiting);
    close(stream);
}
END_TEST

START_TEST(test_stream) {
    int fd = ask("/events");
    ck_assert_ptr_nonnull(strstr(expect(fd, ": beat"), " 200 OK"));
    rn_ring_publish(ring, 5, "metric", "{}", NULL);
    expect(fd, "id: 5\nevent: metric\ndata: {}\n\n");
    rn_ring_close(ring);
    read_some(fd); // the last chunk
    struct rn_http_stats stats;
    WAIT_UNTIL((rn_http_stats(http, &stats), stats.streams == 0));
    close(fd);
}
END_TEST

START_TEST(test_slow_reader_is_dropped) {
    static char data[60000];
    struct rn_http_stats stats;
    memset(data, 'x', sizeof data - 1);
    int fd = ask("/events");
    WAIT_UNTIL((rn_http_stats(http, &stats), stats.streams == 1));
    for (uint64_t id = 1; id <= 400; id++)
        rn_ring_publish(ring, id, "metric", data, NULL);
    WAIT_UNTIL((rn_http_stats(http, &stats), stats.streams == 0));
    close(fd);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("park");
    TCase *tcase = tcase_create("park");
    tcase_add_checked_fixture(tcase, enter, leave);
    tcase_add_test(tcase, test_answer);
    tcase_add_test(tcase, test_sent);
    tcase_add_test(tcase, test_deadline);
    tcase_add_test(tcase, test_client_leaves);
    tcase_add_test(tcase, test_park_limit);
    tcase_add_test(tcase, test_drain);
    tcase_add_test(tcase, test_destroy_with_suspended);
    tcase_add_test(tcase, test_stream);
    tcase_add_test(tcase, test_slow_reader_is_dropped);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
