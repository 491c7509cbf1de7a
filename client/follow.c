#include "client/follow.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/interrupt.h"
#include "common/base/clock.h"
#include "proto/problem.h"

#define STREAM_IDLE_S 45 // three heartbeats missed
#define RETRY_MS 500

bool rn_job_has_ended(const struct rn_job *job) {
    return job->state == RN_JOB_SUCCEEDED || job->state == RN_JOB_FAILED ||
           job->state == RN_JOB_CANCELLED;
}

static void format_train(const struct rn_train_progress *progress, char *ret_text,
                         size_t capacity) {
    if (*progress->stage) {
        char load[24];
        rn_format_seconds(progress->load_seconds, load, sizeof load);
        snprintf(ret_text, capacity, "%s  %s", progress->stage, load);
        return;
    }
    char seconds[24], limit[32] = "", psnr[48], rate[16], speed[32] = "", steps[32] = "";
    rn_format_seconds(progress->train_seconds, seconds, sizeof seconds);
    if (progress->max_seconds > 0) rn_format_seconds(progress->max_seconds, limit, sizeof limit);
    bool known = progress->psnr_step != RN_ABSENT;
    bool old = known && 3 * progress->psnr_step < 2 * progress->step; // none has followed it
    rn_format_figure(progress->psnr, old ? progress->psnr_step : progress->step, progress->step,
                     psnr, sizeof psnr);
    rn_format_count(progress->samples_per_second, rate, sizeof rate);
    if (progress->samples_per_second > 0) snprintf(speed, sizeof speed, "  %s samples/s", rate);
    if (progress->max_steps > 0)
        snprintf(steps, sizeof steps, " of %lld", (long long)progress->max_steps);
    int used =
        snprintf(ret_text, capacity, "step %lld%s  %s%s%s%s%s%s", (long long)progress->step, steps,
                 seconds, *limit ? " of " : "", limit, *psnr ? "  " : "", psnr, speed);
    int64_t rejected = progress->nonfinite.rays + progress->nonfinite.steps_rejected;
    if (rejected && used > 0 && (size_t)used < capacity)
        snprintf(ret_text + used, capacity - (size_t)used, "  %lld non-finite",
                 (long long)rejected);
}

static void format_work(const struct rn_work_progress *progress, char *ret_text, size_t capacity) {
    char total[32] = "";
    if (progress->total != RN_ABSENT)
        snprintf(total, sizeof total, " of %lld", (long long)progress->total);
    bool counts = progress->total != RN_ABSENT || progress->done > 0;
    int used = snprintf(ret_text, capacity, "%s", progress->stage);
    if (counts && used >= 0 && (size_t)used < capacity)
        used += snprintf(ret_text + used, capacity - (size_t)used, "%s%lld%s", used ? "  " : "",
                         (long long)progress->done, total);
    if (progress->nonfinite.rays && used > 0 && (size_t)used < capacity)
        snprintf(ret_text + used, capacity - (size_t)used, "  %lld non-finite",
                 (long long)progress->nonfinite.rays);
}

void rn_format_progress(const struct rn_job *job, const char *json, double *ret_fraction,
                        char *ret_text, size_t capacity) {
    union {
        struct rn_train_progress train;
        struct rn_work_progress work;
    } progress;
    bool train = job->type == RN_JOB_TRAIN;
    const struct rn_table *table = train ? &rn_train_progress_table : &rn_work_progress_table;
    char ending[48] = "evaluating", eta[24];
    *ret_fraction = NAN;
    snprintf(ret_text, capacity, "%s", "");
    if (!json || rn_decode(table, json, strlen(json), &progress, NULL, NULL) != RN_OK) return;
    if (train)
        format_train(&progress.train, ret_text, capacity);
    else
        format_work(&progress.work, ret_text, capacity);
    *ret_fraction = train ? progress.train.fraction : progress.work.fraction;
    if (train && *progress.train.stage) {
        *ending = '\0';
    } else if (!train || !(progress.train.evaluating_first || progress.train.evaluating)) {
        rn_format_seconds(train ? progress.train.eta_seconds : progress.work.eta_seconds, eta,
                          sizeof eta);
        snprintf(ending, sizeof ending, "ETA %s", eta);
    }
    size_t used = strlen(ret_text);
    if (!rn_job_has_ended(job)) snprintf(ret_text + used, capacity - used, "  %s", ending);
    rn_message_finish(table, &progress);
}

static void show(struct rn_follow *follow, const char *progress_json) {
    char text[200];
    double fraction;
    const struct rn_job *job = &follow->job;
    const char *state = rn_job_state_names[job->state];
    rn_format_progress(job, progress_json, &fraction, text, sizeof text);
    // Events are few, and what is not shown now might have to wait long for the next one.
    if (follow->progress.terminal) rn_progress_hurry(&follow->progress);
    if (!*text)
        rn_progress_update(&follow->progress, fraction, "%s", state);
    else if (job->state == RN_JOB_RUNNING || rn_job_has_ended(job))
        rn_progress_update(&follow->progress, fraction, "%s", text);
    else
        rn_progress_update(&follow->progress, fraction, "%s  %s", state, text);
}

// A lost runner is no end: the daemon starts the job again.
static void tell_interruption(struct rn_follow *follow) {
    struct rn_api_problem problem;
    const char *json = follow->job.problem;
    if (!json ||
        rn_decode(&rn_api_problem_table, json, strlen(json), &problem, NULL, NULL) != RN_OK)
        return;
    rn_progress_note(&follow->progress, "%s; it is started again", problem.detail);
    rn_message_finish(&rn_api_problem_table, &problem);
}

// Takes over a Job's JSON. A job that this client cannot read keeps its last known state.
static void take_job(struct rn_follow *follow, const char *json, size_t size) {
    struct rn_job job;
    struct rn_error err = {0};
    if (rn_decode(&rn_job_table, json, size, &job, NULL, &err) != RN_OK) {
        rn_progress_note(&follow->progress, "ripnerf: an event that is no job: %s: %s", err.where,
                         err.text);
        return;
    }
    bool changed = !follow->known || job.state != follow->job.state;
    rn_follow_finish(follow);
    follow->job = job;
    follow->known = true;
    if (changed && job.state == RN_JOB_INTERRUPTED) tell_interruption(follow);
    if (changed && !rn_job_has_ended(&job)) rn_progress_hurry(&follow->progress);
    show(follow, job.progress);
}

static bool on_event(void *context, const struct rn_sse_event *event) {
    struct rn_follow *follow = context;
    if (strcmp(event->type, RN_EVENT_STATE) == 0)
        take_job(follow, event->data, event->size_bytes);
    else if (strcmp(event->type, RN_EVENT_PROGRESS) == 0 && follow->known)
        show(follow, event->data);
    return !follow->event || follow->event(follow, event);
}

static bool on_bytes(void *context, const char *bytes, size_t size) {
    return rn_sse_feed(context, bytes, size);
}

// One connection's worth of events.
static void stream(struct rn_follow *follow, const char *path, struct rn_sse *sse,
                   struct rn_api_reply *ret_reply) {
    struct rn_http_request request = {.method = "GET",
                                      .path = path,
                                      .accept = "text/event-stream",
                                      .last_event_id = *sse->last_id ? sse->last_id : NULL,
                                      .receive = on_bytes,
                                      .context = sse,
                                      .idle_s = STREAM_IDLE_S};
    rn_sse_restart(sse);
    rn_api_exchange(follow->client, &request, ret_reply);
}

// Whether a reply means that the daemon is away for a moment.
static bool is_outage(const struct rn_api_reply *reply) {
    return reply->code == RN_EXIT_OK || reply->code == RN_EXIT_UNREACHABLE ||
           reply->http.status == 503;
}

static bool is_over(const struct rn_follow *follow) {
    return rn_interrupt_seen() || follow->code != RN_EXIT_OK ||
           (follow->known && rn_job_has_ended(&follow->job));
}

// Streams again and again until the job ends, the user detaches or the daemon is lost.
static enum rn_exit stream_to_end(struct rn_follow *follow, const char *path) {
    struct rn_sse sse;
    enum rn_exit code = RN_EXIT_OK;
    int64_t lost_ns = 0; // when the daemon went away; 0: it is there
    rn_sse_init(&sse, on_event, follow);
    for (;;) {
        struct rn_api_reply reply;
        stream(follow, path, &sse, &reply);
        if (is_over(follow)) {
            rn_api_reply_finish(&reply);
            break;
        }
        int64_t now = rn_clock_ns();
        if (reply.code == RN_EXIT_OK)
            lost_ns = 0;
        else if (!lost_ns)
            lost_ns = now;
        bool patient = now - lost_ns < (int64_t)RN_FOLLOW_PATIENCE_S * 1000000000;
        if (!is_outage(&reply) || (lost_ns && !patient)) {
            code = rn_api_complain(&reply);
            rn_api_reply_finish(&reply);
            break;
        }
        if (lost_ns == now)
            rn_progress_note(&follow->progress, "the daemon does not answer; trying for %d s",
                             RN_FOLLOW_PATIENCE_S);
        rn_api_reply_finish(&reply);
        rn_interrupt_sleep(RETRY_MS);
    }
    rn_sse_finish(&sse);
    return code == RN_EXIT_OK ? follow->code : code;
}

static enum rn_exit code_of_end(const struct rn_follow *follow) {
    if (follow->job.state == RN_JOB_SUCCEEDED) return RN_EXIT_OK;
    if (follow->job.state == RN_JOB_CANCELLED)
        return rn_client_error(RN_EXIT_CANCELLED, follow->job.id, "was cancelled");
    enum rn_exit code = RN_EXIT_FAILED;
    if (follow->job.problem) code = rn_api_print_problem(follow->job.problem);
    return code == RN_EXIT_INVALID ? RN_EXIT_INVALID : RN_EXIT_FAILED;
}

struct left {
    char *job, *detail; // borrowed
};
static const struct rn_field_spec left_fields[] = {
    RN_F_STRING(struct left, job, RN_REQUIRED, RN_ID_MAX),
    RN_F_STRING(struct left, detail, RN_REQUIRED, 4096)};
static const struct rn_table left_table = RN_TABLE(struct left, "left job", left_fields);

// What becomes of a job that is not waited for any more, and how to come back; as JSON all in one,
// {"detached": {job, detail}}.
static void tell_way_back(const struct rn_follow *follow, const char *job_id, const char *what) {
    char detail[1024];
    snprintf(detail, sizeof detail, "%s. Come back with: ripnerf %s %s%s%s%s%s", what,
             follow->back ? follow->back : "watch", job_id, follow->tail ? " " : "",
             follow->tail ? follow->tail : "", follow->also ? "\n" : "",
             follow->also ? follow->also : "");
    if (!follow->client->json) {
        fprintf(stderr, "%s\n", detail);
        return;
    }
    char *json = rn_api_encode(&left_table, &(struct left){(char *)job_id, detail});
    if (json) fprintf(stderr, "{\"detached\":%s}\n", json);
    free(json);
}

enum rn_exit rn_follow_job(struct rn_follow *follow, const char *job_id) {
    char what[RN_ID_MAX + 64];
    struct rn_error err = {0};
    if (rn_interrupt_catch(&err) != RN_OK) return rn_client_fail(&err);
    char *path = rn_api_path("jobs", job_id, "/events");
    if (!path) return RN_EXIT_FAILED;
    rn_progress_init(&follow->progress, !follow->quiet);
    enum rn_exit code = stream_to_end(follow, path);
    free(path);
    rn_progress_finish(&follow->progress);
    bool left = code == RN_EXIT_CANCELLED && rn_interrupt_seen(); // as `event` was at a request
    bool ended = follow->known && rn_job_has_ended(&follow->job);
    if (code != RN_EXIT_OK && !left) {
        snprintf(what, sizeof what, "job %s is not lost with its daemon", job_id);
        if (!ended && code == RN_EXIT_UNREACHABLE) tell_way_back(follow, job_id, what);
        return code;
    }
    if (!left && ended) return code_of_end(follow);
    follow->detached = true;
    snprintf(what, sizeof what, "detached; job %s goes on", job_id);
    tell_way_back(follow, job_id, what);
    return RN_EXIT_FAILED;
}

void rn_follow_finish(struct rn_follow *follow) {
    if (follow->known) rn_message_finish(&rn_job_table, &follow->job);
    follow->known = false;
}
