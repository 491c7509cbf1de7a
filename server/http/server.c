#include "server/http/server.h"

#include <arpa/inet.h>
#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/http/exchange.h"
#include "server/http/guard.h"

// Connections beyond the admission limit that are still told 503.
#define SPARE_CONNECTIONS 64
#define HEADER_BYTES (32u << 10)
#define MAX_ARGUMENTS 64
#define BACKLOG 1024

static void begin_trace(struct rn_request *request) {
    char span[17];
    rn_trace_begin(rn_request_header(request, "traceparent"), request->traceparent);
    rn_trace_ids(request->traceparent, request->trace, span);
}

static struct rn_request *create(struct rn_http *http, struct MHD_Connection *connection,
                                 const char *path) {
    struct rn_request *request = calloc(1, sizeof *request);
    if (request == NULL) return NULL;
    request->path = strdup(path);
    if (request->path == NULL) {
        free(request);
        return NULL;
    }
    request->http = http;
    request->connection = connection;
    request->sink.fd = -1;
    request->references = 1;
    request->begin_ns = rn_clock_ns();
    pthread_mutex_lock(&http->lock);
    request->next = http->requests;
    if (http->requests != NULL) http->requests->previous = request;
    http->requests = request;
    http->request_count++;
    pthread_mutex_unlock(&http->lock);
    rn_socket_begin(request);
    begin_trace(request);
    return request;
}

static void on_completed(void *context, struct MHD_Connection *connection, void **state,
                         enum MHD_RequestTerminationCode code) {
    struct rn_http *http = context;
    struct rn_request *request = *state;
    if (request == NULL) return;
    int64_t now_ns = rn_clock_ns();
    *state = NULL;
    rn_access_tell(request);
    rn_socket_end(request);
    pthread_mutex_lock(&http->lock);
    http->answer_bytes -= request->answer_bytes;
    if (request->previous != NULL) request->previous->next = request->next;
    if (request->next != NULL) request->next->previous = request->previous;
    if (http->requests == request) http->requests = request->next;
    http->request_count--;
    bool tell = request->is_parked && !request->answered && !request->gone;
    if (request->suspended) http->suspended_count--;
    request->suspended = false;
    request->finished = true;
    http->stats.body_bytes += request->sink.size;
    pthread_cond_broadcast(&http->changed);
    pthread_mutex_unlock(&http->lock);
    if (tell) request->parked.on_gone(request->parked.context, &request->parked);
    if (request->on_sent != NULL && code == MHD_REQUEST_TERMINATED_COMPLETED_OK)
        request->on_sent(request->sent_context, request->sent_number, now_ns);
    rn_exchange_unref(request);
}

// A parked request: answered, abandoned, or still waiting.
static enum MHD_Result go_on(struct rn_request *request) {
    struct rn_http *http = request->http;
    struct rn_reply reply = {0};
    pthread_mutex_lock(&http->lock);
    // A library that is being stopped takes no response, says that it did, and asks again.
    bool gone = request->gone || !request->is_parked, answered = request->answered;
    if (answered && !gone) {
        reply = request->reply;
        request->reply = (struct rn_reply){0};
    } else if (!gone) {
        rn_exchange_suspend(request);
    }
    pthread_mutex_unlock(&http->lock);
    if (gone) return MHD_NO;
    return answered ? rn_respond(request, &reply) : MHD_YES;
}

static void count_upload(struct rn_http *http) {
    pthread_mutex_lock(&http->lock);
    http->stats.uploads++;
    pthread_mutex_unlock(&http->lock);
}

static void call_handler(struct rn_request *request, struct rn_reply *reply) {
    const char *before = rn_log_set_trace(request->traceparent);
    request->match.route->handle(request->http->options.context, request, reply);
    rn_log_set_trace(before);
}

static enum MHD_Result handle(struct rn_request *request) {
    struct rn_http *http = request->http;
    struct rn_reply reply = {0};
    struct rn_error err = {0};
    request->handled = true;
    bool spooled = request->sink.path != NULL;
    if (rn_sink_close(&request->sink, &err) != RN_OK)
        rn_reply_error(&reply, &err);
    else
        call_handler(request, &reply);
    if (spooled && reply.status == 202) count_upload(http);
    if (reply.status == 0 && request->is_parked) return go_on(request);
    if (reply.status == 0) rn_reply_problem(&reply, RN_PROBLEM_INTERNAL, "no answer was made");
    return rn_respond(request, &reply);
}

static enum MHD_Result on_request(void *context, struct MHD_Connection *connection, const char *url,
                                  const char *method, const char *version, const char *upload,
                                  size_t *upload_size, void **state) {
    struct rn_request *request = *state;
    if (request == NULL) {
        *state = request = create(context, connection, url);
        if (request == NULL) return MHD_NO;
        struct rn_reply reply = {0};
        rn_admit(request, method, &reply);
        if (reply.status == 0) return MHD_YES;
        request->handled = true;
        if (request->socket != NULL) request->socket->lingers = rn_has_body(request);
        return rn_respond(request, &reply);
    }
    if (*upload_size > 0) {
        if (request->handled) return MHD_NO;
        if (!rn_sink_write(&request->sink, upload, *upload_size)) {
            struct rn_reply reply = {0};
            rn_reply_error(&reply, &request->sink.error);
            rn_answer_raw(request->http, request->socket, &reply);
            return MHD_NO;
        }
        *upload_size = 0;
        return MHD_YES;
    }
    return request->handled ? go_on(request) : handle(request);
}

// Percent codes, but for the one of NUL, which would cut the text: it stays as it is.
static size_t on_unescape(void *context, struct MHD_Connection *connection, char *text) {
    char *to = text;
    for (const char *from = text; *from != '\0';) {
        unsigned byte = 0;
        bool code = from[0] == '%' && isxdigit((unsigned char)from[1]) &&
                    isxdigit((unsigned char)from[2]) && sscanf(from + 1, "%2x", &byte) == 1;
        if (code && byte != 0) {
            *to++ = (char)byte;
            from += 3;
        } else {
            *to++ = *from++;
        }
    }
    *to = '\0';
    return (size_t)(to - text);
}

// The library keeps each argument in the memory of the connection and stalls when that is full.
static void *on_uri(void *context, const char *uri, struct MHD_Connection *connection) {
    struct rn_reply reply = {0};
    int arguments = 0;
    for (const char *at = strchr(uri, '?'); at != NULL; at = strchr(at + 1, '&'))
        arguments++;
    if (arguments <= MAX_ARGUMENTS) return NULL;
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    rn_reply_problem(&reply, RN_PROBLEM_MALFORMED, "the query has more than %d parameters",
                     MAX_ARGUMENTS);
    rn_answer_raw(context, info != NULL ? info->socket_context : NULL, &reply);
    return NULL;
}

static void on_log(void *context, const char *fmt, va_list args) {
    char text[512];
    vsnprintf(text, sizeof text, fmt, args);
    text[strcspn(text, "\n")] = '\0';
    rn_log(RN_LOG_DEBUG, "http: %s", text);
}

static int make_address(const struct rn_http_options *options, struct sockaddr_storage *address,
                        socklen_t *size) {
    struct sockaddr_in v4 = {.sin_family = AF_INET, .sin_port = htons(options->port)};
    struct sockaddr_in6 v6 = {.sin6_family = AF_INET6, .sin6_port = htons(options->port)};
    bool name = strcasecmp(options->address, "localhost") == 0;
    if (inet_pton(AF_INET, name ? "127.0.0.1" : options->address, &v4.sin_addr) == 1) {
        memcpy(address, &v4, *size = sizeof v4);
        return AF_INET;
    }
    if (inet_pton(AF_INET6, options->address, &v6.sin6_addr) == 1) {
        memcpy(address, &v6, *size = sizeof v6);
        return AF_INET6;
    }
    return -1;
}

// The socket that the service manager has opened (sd_listen_fds(3)), -1: none.
static int passed_socket(void) {
    const char *pid = getenv("LISTEN_PID"), *count = getenv("LISTEN_FDS");
    const int fd = 3;
    if (pid == NULL || count == NULL || atol(pid) != (long)getpid() || atoi(count) != 1) return -1;
    bool ours = fcntl(fd, F_SETFD, FD_CLOEXEC) == 0 && fcntl(fd, F_SETFL, O_NONBLOCK) == 0;
    return ours ? fd : -1;
}

static bool is_same_host(const struct sockaddr_storage *a, const struct sockaddr_storage *b) {
    if (a->ss_family != b->ss_family) return false;
    if (a->ss_family == AF_INET)
        return ((const struct sockaddr_in *)a)->sin_addr.s_addr ==
               ((const struct sockaddr_in *)b)->sin_addr.s_addr;
    return memcmp(&((const struct sockaddr_in6 *)a)->sin6_addr,
                  &((const struct sockaddr_in6 *)b)->sin6_addr, sizeof(struct in6_addr)) == 0;
}

// One that was passed has the port that it has, and must listen where the options say: whether a
// token is needed follows from that.
static enum rn_status listen_at(const struct rn_http_options *options, int fd, bool passed,
                                const struct sockaddr_storage *address, socklen_t size,
                                uint16_t *ret_port, struct rn_error *err) {
    struct sockaddr_storage bound;
    socklen_t bound_size = sizeof bound;
    int on = 1;
    if (!passed) setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    if ((!passed &&
         (bind(fd, (const struct sockaddr *)address, size) != 0 || listen(fd, BACKLOG) != 0)) ||
        getsockname(fd, (struct sockaddr *)&bound, &bound_size) != 0)
        return rn_error_set(err, RN_ERROR_UNAVAILABLE, "listen", "%s port %u: %s%s",
                            options->address, options->port, strerror(errno),
                            errno == EADDRINUSE ? "; choose another with --listen ADDR:PORT" : "");
    if (!is_same_host(&bound, address))
        return rn_error_set(err, RN_ERROR_INVALID, "listen",
                            "the service manager's socket is of another address than %s; name the "
                            "same in both",
                            options->address);
    *ret_port = ntohs(bound.ss_family == AF_INET ? ((struct sockaddr_in *)&bound)->sin_port
                                                 : ((struct sockaddr_in6 *)&bound)->sin6_port);
    return RN_OK;
}

static enum rn_status open_socket(const struct rn_http_options *options, int *ret_fd,
                                  int *ret_family, uint16_t *ret_port, struct rn_error *err) {
    struct sockaddr_storage address;
    socklen_t size;
    int family = make_address(options, &address, &size);
    if (family < 0)
        return rn_error_set(err, RN_ERROR_INVALID, "listen",
                            "'%s' is not a numeric IPv4 or IPv6 address", options->address);
    int fd = passed_socket();
    bool passed = fd >= 0;
    if (!passed) fd = socket(family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd < 0) return rn_error_from_errno(err, errno, "listen", "open a socket");
    enum rn_status status = listen_at(options, fd, passed, &address, size, ret_port, err);
    if (status != RN_OK) {
        close(fd);
        return status;
    }
    *ret_fd = fd;
    *ret_family = family;
    return RN_OK;
}

static enum rn_status start_daemon(struct rn_http *http, struct rn_error *err) {
    int fd = -1, family = 0;
    enum rn_status status = open_socket(&http->options, &fd, &family, &http->port, err);
    if (status != RN_OK) return status;
    unsigned flags = MHD_USE_EPOLL | MHD_USE_INTERNAL_POLLING_THREAD | MHD_USE_ERROR_LOG |
                     MHD_ALLOW_SUSPEND_RESUME | MHD_USE_ITC |
                     (family == AF_INET6 ? MHD_USE_IPv6 : 0);
    http->daemon = MHD_start_daemon(
        flags, 0, NULL, NULL, on_request, http, MHD_OPTION_EXTERNAL_LOGGER, on_log, http,
        MHD_OPTION_LISTEN_SOCKET, fd, MHD_OPTION_CONNECTION_LIMIT,
        http->options.max_connections + SPARE_CONNECTIONS, MHD_OPTION_CONNECTION_TIMEOUT,
        (unsigned)http->options.idle_timeout_s, MHD_OPTION_CONNECTION_MEMORY_LIMIT,
        (size_t)HEADER_BYTES, MHD_OPTION_NOTIFY_COMPLETED, on_completed, http,
        MHD_OPTION_NOTIFY_CONNECTION, rn_socket_notify, http, MHD_OPTION_UNESCAPE_CALLBACK,
        on_unescape, http, MHD_OPTION_URI_LOG_CALLBACK, on_uri, http, MHD_OPTION_END);
    if (http->daemon != NULL) return RN_OK;
    close(fd);
    return rn_error_set(err, RN_ERROR_UNAVAILABLE, "http", "the HTTP thread cannot be started");
}

enum rn_status rn_http_start(const struct rn_http_options *options, struct rn_http **ret_http,
                             struct rn_error *err) {
    struct rn_http *http = calloc(1, sizeof *http);
    if (http == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "http", "no memory");
    pthread_condattr_t monotonic;
    pthread_condattr_init(&monotonic);
    pthread_condattr_setclock(&monotonic, CLOCK_MONOTONIC);
    pthread_mutex_init(&http->lock, NULL);
    pthread_cond_init(&http->changed, &monotonic);
    pthread_condattr_destroy(&monotonic);
    for (int i = 0; i < RN_MAX_LINGERING; i++)
        http->lingering[i].fd = -1;
    http->options = *options;
    http->address = strdup(options->address);
    http->options.address = http->address;
    if (http->options.max_connections == 0) http->options.max_connections = 448;
    if (http->options.max_parked == 0) http->options.max_parked = 64;
    if (http->options.idle_timeout_s == 0) http->options.idle_timeout_s = 30;
    if (http->options.header_timeout_s == 0) http->options.header_timeout_s = 10;
    if (http->options.least_rate == 0) http->options.least_rate = 1024;
    if (http->options.max_answer_bytes == 0) http->options.max_answer_bytes = 256u << 20;
    enum rn_status status = RN_ERROR_NO_MEMORY;
    http->audit_fd = -1;
    if (http->address == NULL) goto fail;
    status = rn_audit_open(http, err);
    if (status != RN_OK) goto fail;
    *ret_http = http; // handlers may look at it from the first request on
    status = start_daemon(http, err);
    if (status != RN_OK) goto fail;
    http->keeper_runs = true;
    if (pthread_create(&http->keeper, NULL, rn_keeper_main, http) != 0) {
        http->keeper_runs = false;
        status = rn_error_set(err, RN_ERROR_IO, "http", "a thread cannot be started");
        goto fail;
    }
    return RN_OK;
fail:
    *ret_http = NULL;
    rn_http_destroy(&http);
    return status;
}

uint16_t rn_http_port(const struct rn_http *http) {
    return http->port;
}

void rn_http_stats(struct rn_http *http, struct rn_http_stats *ret_stats) {
    pthread_mutex_lock(&http->lock);
    *ret_stats = http->stats;
    ret_stats->answer_bytes = http->answer_bytes;
    pthread_mutex_unlock(&http->lock);
}

void rn_http_drain(struct rn_http *http, int64_t timeout_ms) {
    int64_t deadline_ns = rn_clock_ns() + timeout_ms * 1000000;
    pthread_mutex_lock(&http->lock);
    http->stopping = true;
    for (struct rn_request *request = http->requests; request != NULL; request = request->next) {
        request->parked.deadline_ns = 0;
        if (request->events.attached) rn_exchange_wake(request);
    }
    pthread_cond_broadcast(&http->changed);
    while (http->request_count > 0 && rn_clock_ns() < deadline_ns) {
        pthread_mutex_unlock(&http->lock);
        usleep(10000);
        pthread_mutex_lock(&http->lock);
    }
    pthread_mutex_unlock(&http->lock);
}

// No connection may be suspended when the library is stopped.
static void wake_all(struct rn_http *http) {
    pthread_mutex_lock(&http->lock);
    http->stopping = true;
    for (struct rn_request *request = http->requests; request != NULL; request = request->next) {
        request->gone = true;
        rn_exchange_wake(request);
    }
    pthread_mutex_unlock(&http->lock);
}

void rn_http_destroy(struct rn_http **http_pointer) {
    struct rn_http *http = *http_pointer;
    if (http == NULL) return;
    *http_pointer = NULL;
    if (http->keeper_runs) {
        pthread_mutex_lock(&http->lock);
        http->keeper_runs = false;
        pthread_cond_broadcast(&http->changed);
        pthread_mutex_unlock(&http->lock);
        pthread_join(http->keeper, NULL);
    }
    if (http->daemon != NULL) {
        wake_all(http);
        MHD_stop_daemon(http->daemon);
    }
    rn_sockets_finish(http);
    if (http->audit_fd >= 0) close(http->audit_fd);
    pthread_cond_destroy(&http->changed);
    pthread_mutex_destroy(&http->lock);
    free(http->address);
    free(http);
}
