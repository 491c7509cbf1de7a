#include <stdlib.h>

#include "server/api/app.h"

static void follow(struct rn_app *app, struct rn_request *request, const char *job,
                   struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_http_stats stats;
    struct rn_ring *ring = NULL;
    int64_t after = 0;
    const char *last = rn_request_header(request, "Last-Event-ID");
    rn_http_stats(app->http, &stats);
    if (stats.streams >= app->max_streams) {
        rn_reply_problem(reply, RN_PROBLEM_BUSY, "%u event streams are open, the limit",
                         stats.streams);
        return;
    }
    // An id that is none of ours replays everything: a text, or one that was never given out.
    if (last != NULL && rn_api_number(last, 0, INT64_MAX, "Last-Event-ID", &after, NULL) != RN_OK)
        after = 0;
    if ((uint64_t)after > rn_ring_last_id()) after = 0;
    enum rn_status status = rn_control_events(app->control, job, &ring, &err);
    if (!rn_api_failed(status, &err, reply)) rn_reply_events(reply, ring, (uint64_t)after);
}

void rn_follow_job(void *context, struct rn_request *request, struct rn_reply *reply) {
    follow(context, request, rn_request_param(request, 0), reply);
}

void rn_follow_all(void *context, struct rn_request *request, struct rn_reply *reply) {
    follow(context, request, NULL, reply);
}
