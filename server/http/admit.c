// What is refused from the headers alone, before a byte of the body is read.
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/http/exchange.h"
#include "server/http/guard.h"

#define GUESS_WINDOW_NS (60 * 1000000000ll)
#define MAX_GUESSES 60 // in a window

static unsigned parse_method(const char *method) {
    if (strcmp(method, "GET") == 0 || strcmp(method, "HEAD") == 0) return RN_METHOD_GET;
    if (strcmp(method, "POST") == 0) return RN_METHOD_POST;
    if (strcmp(method, "PATCH") == 0) return RN_METHOD_PATCH;
    return strcmp(method, "DELETE") == 0 ? RN_METHOD_DELETE : 0;
}

static void refuse_overload(struct rn_request *request, struct rn_reply *reply) {
    struct rn_http *http = request->http;
    bool always = (request->match.route->flags & RN_ROUTE_ALWAYS) != 0;
    pthread_mutex_lock(&http->lock);
    bool stopping = http->stopping;
    bool full = !always && http->stats.connections > http->options.max_connections;
    if (full) http->stats.refused++;
    pthread_mutex_unlock(&http->lock);
    if (stopping)
        rn_reply_problem(reply, RN_PROBLEM_BUSY, "the daemon is shutting down");
    else if (full)
        rn_reply_problem(reply, RN_PROBLEM_BUSY,
                         "%u connections are open, the limit; try again later",
                         http->options.max_connections);
}

static void find_route(struct rn_request *request, const char *method, struct rn_reply *reply) {
    unsigned bit = parse_method(method);
    request->is_head = strcmp(method, "HEAD") == 0;
    request->method = (enum rn_method)bit;
    rn_router_match(request->http->options.routes, bit, request->path, &request->match);
    if (request->match.route != NULL) return;
    unsigned allowed = request->match.allowed;
    if (allowed == 0) {
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "there is nothing at %.200s", request->path);
        return;
    }
    rn_reply_problem(reply, RN_PROBLEM_METHOD_NOT_ALLOWED, "%.16s is not a method of this path",
                     method);
    char methods[48] = "";
    if (allowed & RN_METHOD_GET) strcat(methods, ", GET, HEAD");
    if (allowed & RN_METHOD_POST) strcat(methods, ", POST");
    if (allowed & RN_METHOD_DELETE) strcat(methods, ", DELETE");
    if (allowed & RN_METHOD_PATCH) strcat(methods, ", PATCH");
    rn_reply_header(reply, "Allow", "%s", methods + 2);
}

// A guess too many is told so and cut off; the right token is taken at any time.
static void refuse_token(struct rn_request *request, struct rn_reply *reply) {
    struct rn_http *http = request->http;
    bool guessed = rn_request_header(request, "Authorization") != NULL;
    int64_t now_ns = rn_clock_ns();
    pthread_mutex_lock(&http->lock);
    if (now_ns - http->guesses_since_ns > GUESS_WINDOW_NS) {
        http->guesses_since_ns = now_ns;
        http->guesses = 0;
    }
    http->guesses += guessed;
    unsigned guesses = http->guesses;
    pthread_mutex_unlock(&http->lock);
    // The first of a minute, then ever fewer.
    if (guessed && (guesses & (guesses - 1)) == 0)
        rn_log(RN_LOG_WARN, "http: %u wrong tokens within a minute, the last for %s", guesses,
               request->path);
    if (guesses > MAX_GUESSES) {
        rn_reply_problem(reply, RN_PROBLEM_TOO_MANY_REQUESTS,
                         "too many wrong tokens; wait a minute");
        rn_reply_header(reply, "Connection", "close");
        return;
    }
    rn_reply_problem(reply, RN_PROBLEM_UNAUTHORISED,
                     guessed ? "the token that was sent is not one of this daemon's"
                             : "send a token as 'Authorization: Bearer …'");
    rn_reply_header(reply, "WWW-Authenticate", "Bearer");
}

// Someone on this machine, where no token is needed.
static void take_neighbour(struct rn_request *request, struct rn_reply *reply) {
    const char *host = rn_request_header(request, "Host");
    request->caller.scope = RN_SCOPE_ADMIN;
    if (!rn_guard_host_is_loopback(host))
        rn_reply_problem(reply, RN_PROBLEM_FORBIDDEN,
                         "the Host '%.100s' is not this machine's loopback address",
                         host == NULL ? "" : host);
}

static void check_caller(struct rn_request *request, struct rn_reply *reply) {
    const struct rn_http_options *options = &request->http->options;
    const char *authorization = rn_request_header(request, "Authorization");
    const char *token = rn_guard_bearer(authorization);
    const char *origin = rn_request_header(request, "Origin");
    bool open = (request->match.route->flags & RN_ROUTE_OPEN) != 0;
    bool checked = !open && (options->token_needed || authorization != NULL);
    if (checked && (token == NULL || options->authorise == NULL ||
                    !options->authorise(options->context, request, token, &request->caller, reply)))
        refuse_token(request, reply);
    if (!checked && !options->token_needed) take_neighbour(request, reply);
    if (reply->status == 0 && request->method != RN_METHOD_GET &&
        !rn_guard_origin(origin, rn_request_header(request, "Host")))
        rn_reply_problem(reply, RN_PROBLEM_FORBIDDEN, "the Origin '%.100s' is not this daemon's",
                         origin);
}

uint64_t rn_body_size(const struct rn_request *request) {
    const char *length = rn_request_header(request, "Content-Length");
    return length == NULL ? 0 : strtoull(length, NULL, 10);
}

bool rn_has_body(const struct rn_request *request) {
    return rn_body_size(request) > 0 || rn_request_header(request, "Transfer-Encoding") != NULL;
}

static void check_body(struct rn_request *request, struct rn_reply *reply) {
    uint64_t size = rn_body_size(request), max = request->sink.max;
    bool body = rn_has_body(request);
    if (body && max == 0)
        rn_reply_problem(reply, RN_PROBLEM_TOO_LARGE, "this request takes no body");
    else if (size > max)
        rn_reply_problem(reply, RN_PROBLEM_TOO_LARGE,
                         "the body has %llu bytes, the limit is %llu bytes",
                         (unsigned long long)size, (unsigned long long)max);
    else if (max > 0 && request->sink.path == NULL &&
             !rn_request_has_type(request, "application/json"))
        rn_reply_problem(reply, RN_PROBLEM_MEDIA_TYPE,
                         "send the body with Content-Type: application/json");
}

struct framing {
    int lengths, encodings, hosts;
    bool wrong;
};

static enum MHD_Result see_header(void *context, enum MHD_ValueKind kind, const char *name,
                                  const char *value) {
    struct framing *framing = context;
    if (strcasecmp(name, "Content-Length") == 0) {
        framing->lengths++;
        size_t digits = value != NULL ? strspn(value, "0123456789") : 0;
        framing->wrong |= digits == 0 || digits > 19 || value[digits] != '\0';
    } else if (strcasecmp(name, "Transfer-Encoding") == 0) {
        framing->encodings++;
        framing->wrong |= value == NULL || strcasecmp(value, "chunked") != 0;
    } else if (strcasecmp(name, "Host") == 0) {
        framing->hosts++;
    }
    return MHD_YES;
}

// Where a body ends must be said once: a proxy that reads it otherwise would see other requests.
static void check_framing(struct rn_request *request, struct rn_reply *reply) {
    struct framing framing = {0};
    MHD_get_connection_values(request->connection, MHD_HEADER_KIND, see_header, &framing);
    if (!framing.wrong && framing.lengths + framing.encodings <= 1 && framing.hosts <= 1) return;
    rn_reply_problem(reply, RN_PROBLEM_MALFORMED,
                     "send Host once, and either Content-Length, once, or Transfer-Encoding: "
                     "chunked");
    rn_reply_header(reply, "Connection", "close");
}

void rn_admit(struct rn_request *request, const char *method, struct rn_reply *reply) {
    check_framing(request, reply);
    if (reply->status == 0) find_route(request, method, reply);
    if (reply->status == 0) refuse_overload(request, reply);
    if (reply->status == 0) check_caller(request, reply);
    if (reply->status != 0) return;
    const struct rn_route *route = request->match.route;
    rn_sink_init(&request->sink, route->max_body_bytes);
    if (route->begin != NULL) route->begin(request->http->options.context, request, reply);
    if (reply->status == 0) check_body(request, reply);
}
