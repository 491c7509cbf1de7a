// Counters and gauges in the Prometheus text format.
#include "common/base/buf.h"
#include "common/base/clock.h"
#include "server/api/app.h"
#include "server/store/scrub.h"

static void head(struct rn_buf *text, const char *name, const char *type, const char *help) {
    rn_buf_printf(text, "# HELP ripnerf_%s %s\n# TYPE ripnerf_%s %s\n", name, help, name, type);
}

static void one(struct rn_buf *text, const char *name, const char *type, const char *help,
                double value) {
    head(text, name, type, help);
    rn_buf_printf(text, "ripnerf_%s %.17g\n", name, value);
}

static void put_jobs(struct rn_buf *text, const struct rn_control_stats *stats) {
    head(text, "jobs", "gauge", "Unfinished jobs by state.");
    for (int state = 0; rn_job_state_names[state] != NULL; state++)
        if (!rn_job_is_over((enum rn_job_state)state))
            rn_buf_printf(text, "ripnerf_jobs{state=\"%s\"} %u\n", rn_job_state_names[state],
                          stats->jobs_open[state]);
    head(text, "job_transitions_total", "counter", "Transitions by the state reached.");
    for (int state = 0; rn_job_state_names[state] != NULL; state++)
        rn_buf_printf(text, "ripnerf_job_transitions_total{state=\"%s\"} %llu\n",
                      rn_job_state_names[state], (unsigned long long)stats->jobs_ended[state]);
    head(text, "nonfinite_total", "counter",
         "What was no finite number in jobs: rays left out or replaced, steps, rollbacks.");
    rn_buf_printf(text,
                  "ripnerf_nonfinite_total{kind=\"rays\"} %llu\n"
                  "ripnerf_nonfinite_total{kind=\"steps_rejected\"} %llu\n"
                  "ripnerf_nonfinite_total{kind=\"rollbacks\"} %llu\n",
                  (unsigned long long)stats->nonfinite_rays,
                  (unsigned long long)stats->steps_rejected, (unsigned long long)stats->rollbacks);
}

static void put_runners(struct rn_buf *text, const struct rn_control_stats *stats) {
    one(text, "runners", "gauge", "Runner processes.", stats->runners);
    one(text, "scenes_loaded", "gauge", "Scenes that a runner holds.", stats->scenes_loaded);
    one(text, "runner_memory_bytes", "gauge", "Memory of all runners, as they report it.",
        (double)stats->memory_bytes);
    one(text, "gpu_memory_bytes", "gauge", "Memory of GPUs that runners hold or were granted.",
        (double)stats->gpu_memory_bytes);
    one(text, "runners_started_total", "counter", "Runners started.",
        (double)stats->runners_started);
    one(text, "scenes_rested_total", "counter", "Scenes that gave a GPU's memory up for others.",
        (double)stats->scenes_rested);
    one(text, "runners_lost_total", "counter", "Runners that ended unasked.",
        (double)stats->runners_lost);
}

static void put_renders(struct rn_buf *text, const struct rn_control_stats *stats) {
    uint64_t sum = 0;
    one(text, "renders_waiting", "gauge", "Pictures that are being made.", stats->renders_waiting);
    one(text, "renders_failed_total", "counter", "Renders that failed.",
        (double)stats->renders_failed);
    one(text, "renders_cancelled_total", "counter", "Renders whose clients left.",
        (double)stats->renders_cancelled);
    head(text, "render_milliseconds", "histogram", "From request to picture.");
    for (int i = 0; i < 9; i++) {
        sum += stats->render_ms_buckets[i];
        rn_buf_printf(text, "ripnerf_render_milliseconds_bucket{le=\"%g\"} %llu\n",
                      rn_render_ms_bounds[i], (unsigned long long)sum);
    }
    rn_buf_printf(text,
                  "ripnerf_render_milliseconds_bucket{le=\"+Inf\"} %llu\n"
                  "ripnerf_render_milliseconds_sum %.17g\n"
                  "ripnerf_render_milliseconds_count %llu\n",
                  (unsigned long long)stats->renders, stats->render_ms_sum,
                  (unsigned long long)stats->renders);
}

static void put_store(struct rn_buf *text, const struct rn_control_stats *stats,
                      struct rn_scrubber *scrubber) {
    struct rn_scrub_result scrub;
    rn_scrubber_result(scrubber, &scrub);
    one(text, "scrub_checked_total", "counter", "Stored files and folders read in idle time.",
        (double)scrub.checked);
    one(text, "scrub_damaged_total", "counter", "Those of them that were not as written.",
        (double)scrub.damaged);
    one(text, "scrub_unread_total", "counter", "Stored files and folders that could not be read.",
        (double)scrub.unread);
    one(text, "checkpoints_damaged_total", "counter",
        "Checkpoints that were not as they were written; the one before was taken.",
        (double)stats->checkpoints_damaged);
}

static void put_http(struct rn_buf *text, const struct rn_http_stats *stats) {
    head(text, "http_responses_total", "counter", "Responses by status code.");
    for (int status = 0; status < 600; status++)
        if (stats->by_status[status] > 0)
            rn_buf_printf(text, "ripnerf_http_responses_total{code=\"%d\"} %llu\n", status,
                          (unsigned long long)stats->by_status[status]);
    one(text, "http_received_bytes_total", "counter", "Bytes of request bodies.",
        (double)stats->body_bytes);
    one(text, "http_uploads_total", "counter", "Dataset uploads received whole.",
        (double)stats->uploads);
    one(text, "http_connections", "gauge", "Open connections.", stats->connections);
    one(text, "http_streams", "gauge", "Open event streams.", stats->streams);
    one(text, "http_refused_total", "counter", "Requests over the admission limit.",
        (double)stats->refused);
    one(text, "http_gone_total", "counter", "Clients that left before their answer.",
        (double)stats->gone);
    one(text, "http_slow_total", "counter", "Connections ended for being too slow.",
        (double)stats->slow);
    one(text, "http_evicted_total", "counter", "Idle connections ended to make room.",
        (double)stats->evicted);
    one(text, "http_answer_bytes", "gauge", "Held by answers that are being sent.",
        (double)stats->answer_bytes);
}

void rn_get_metrics(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_control_stats stats;
    struct rn_http_stats http;
    struct rn_buf text;
    size_t size;
    rn_control_stats(app->control, &stats);
    rn_http_stats(app->http, &http);
    rn_buf_init(&text, 1u << 20);
    one(&text, "uptime_seconds", "gauge", "Since the start.",
        (double)(rn_clock_ns() - app->start_ns) * 1e-9);
    put_jobs(&text, &stats);
    put_runners(&text, &stats);
    put_renders(&text, &stats);
    put_store(&text, &stats, app->scrubber);
    put_http(&text, &http);
    uint8_t *bytes = rn_buf_take(&text, &size);
    if (bytes != NULL)
        rn_reply_bytes(reply, 200, "text/plain; version=0.0.4", bytes, size);
    else
        rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "no memory for the metrics");
}
