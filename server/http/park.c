// Requests that wait: parked renders and quiet event streams. A suspended connection never times
// out and shows nothing of a client that left, so a thread watches over them.
#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <time.h>

#include "common/base/clock.h"
#include "server/http/exchange.h"

#define WATCH_MS 250

void rn_exchange_suspend(struct rn_request *request) {
    request->suspended = true;
    request->http->suspended_count++;
    MHD_suspend_connection(request->connection);
    pthread_cond_signal(&request->http->changed);
}

void rn_exchange_wake(struct rn_request *request) {
    if (!request->suspended || request->finished) return;
    request->suspended = false;
    request->http->suspended_count--;
    MHD_resume_connection(request->connection);
}

void rn_exchange_unref(struct rn_request *request) {
    struct rn_http *http = request->http;
    pthread_mutex_lock(&http->lock);
    bool last = --request->references == 0;
    pthread_mutex_unlock(&http->lock);
    if (!last) return;
    rn_reply_finish(&request->reply);
    rn_sink_finish(&request->sink);
    free(request->events.text);
    free(request->path);
    free(request);
}

enum rn_status rn_request_park(struct rn_request *request, int64_t timeout_ms,
                               void (*on_gone)(void *context, struct rn_parked *parked),
                               void *context, struct rn_parked **ret_parked, struct rn_error *err) {
    struct rn_http *http = request->http;
    enum rn_status status = RN_OK;
    pthread_mutex_lock(&http->lock);
    if (http->parked_count >= http->options.max_parked || http->stopping) {
        status = rn_error_set(err, RN_ERROR_BUSY, "", "%u requests wait already; try again later",
                              http->parked_count);
    } else {
        http->parked_count++;
        request->references++;
        request->is_parked = true;
        request->parked = (struct rn_parked){.request = request,
                                             .on_gone = on_gone,
                                             .context = context,
                                             .deadline_ns = rn_clock_ns() + timeout_ms * 1000000};
    }
    pthread_mutex_unlock(&http->lock);
    if (status == RN_OK) *ret_parked = &request->parked;
    return status;
}

void rn_parked_answer(struct rn_parked *parked, struct rn_reply *reply) {
    struct rn_request *request = parked->request;
    struct rn_http *http = request->http;
    pthread_mutex_lock(&http->lock);
    http->parked_count--;
    if (reply != NULL && !request->answered && !request->gone && !request->finished) {
        request->reply = *reply;
        *reply = (struct rn_reply){0};
        request->answered = true;
        rn_exchange_wake(request);
    }
    pthread_mutex_unlock(&http->lock);
    if (reply != NULL) rn_reply_finish(reply);
    rn_exchange_unref(request);
}

static bool has_left(const struct rn_request *request) {
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(request->connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    if (info == NULL) return false;
    struct pollfd poll_fd = {.fd = info->connect_fd, .events = POLLRDHUP};
    return poll(&poll_fd, 1, 0) == 1 && (poll_fd.revents & (POLLRDHUP | POLLHUP | POLLERR)) != 0;
}

// Looks after one suspended request; true when its owner has to be told that it is not wanted.
static bool watch(struct rn_request *request, int64_t now_ns) {
    if (has_left(request)) {
        request->gone = true;
        request->http->stats.gone++;
        rn_exchange_wake(request);
        return request->is_parked;
    }
    if (request->is_parked && now_ns >= request->parked.deadline_ns) {
        rn_reply_problem(&request->reply, RN_PROBLEM_BUSY,
                         "no answer in time; the machine is busy, try again later");
        request->answered = true;
        rn_exchange_wake(request);
        return true;
    }
    if (request->events.attached && now_ns >= request->events.next_beat_ns) {
        request->events.beat = true;
        request->events.next_beat_ns = now_ns + RN_BEAT_NS;
        rn_exchange_wake(request);
    }
    return false;
}

// One request whose owner must be told, with a reference; NULL when all are fine.
static struct rn_request *watch_all(struct rn_http *http, int64_t now_ns) {
    for (struct rn_request *request = http->requests; request != NULL; request = request->next) {
        if (!request->suspended || !watch(request, now_ns)) continue;
        request->references++;
        return request;
    }
    return NULL;
}

void *rn_keeper_main(void *context) {
    struct rn_http *http = context;
    pthread_mutex_lock(&http->lock);
    while (http->keeper_runs) {
        struct rn_request *request = watch_all(http, rn_clock_ns());
        if (request != NULL) {
            pthread_mutex_unlock(&http->lock);
            request->parked.on_gone(request->parked.context, &request->parked);
            rn_exchange_unref(request);
            pthread_mutex_lock(&http->lock);
            continue;
        }
        int64_t wait_ns = rn_sockets_watch(http, rn_clock_ns());
        if (http->suspended_count > 0 && wait_ns > WATCH_MS * 1000000ll)
            wait_ns = WATCH_MS * 1000000ll;
        struct timespec until;
        clock_gettime(CLOCK_MONOTONIC, &until);
        until.tv_nsec += wait_ns % 1000000000;
        until.tv_sec += wait_ns / 1000000000 + until.tv_nsec / 1000000000;
        until.tv_nsec %= 1000000000;
        pthread_cond_timedwait(&http->changed, &http->lock, &until);
    }
    pthread_mutex_unlock(&http->lock);
    return NULL;
}
