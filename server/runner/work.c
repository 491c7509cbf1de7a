#include "server/runner/work.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"

#define PROGRESS_INTERVAL_S 0.5

static double now_s(void) {
    return (double)rn_clock_ns() * 1e-9;
}

static int compare_doubles(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

double rn_work_median(double *values, size_t count) {
    if (!count) return NAN;
    qsort(values, count, sizeof *values, compare_doubles);
    return 0.5 * (values[(count - 1) / 2] + values[count / 2]);
}

// ---- the list ------------------------------------------------------------------------------

struct rn_work *rn_work_append(struct rn_host *host, const struct rn_work_kind *kind,
                               const char *job) {
    struct rn_work *work = calloc(1, kind->size), **slot = &host->works;
    if (!work) {
        struct rn_error err;
        rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "out of memory");
        rn_link_fail(&host->link, job, RN_ABSENT, &err);
        return NULL;
    }
    strcpy(work->job, job);
    work->kind = kind;
    work->step = RN_ABSENT;
    work->host = host;
    work->watch = (struct rn_watch){.link = &host->link, .job = work->job, .request = RN_ABSENT};
    while (*slot)
        slot = &(*slot)->next;
    *slot = work;
    return work;
}

static void drop(struct rn_work *work) {
    struct rn_work **slot = &work->host->works;
    while (*slot != work)
        slot = &(*slot)->next;
    *slot = work->next;
    work->kind->release(work);
    free(work->render_ms);
    free(work);
}

void rn_work_drop_all(struct rn_host *host) {
    while (host->works)
        drop(host->works);
}

void rn_work_fail(struct rn_work *work, const struct rn_error *err) {
    rn_link_fail(&work->host->link, work->job, RN_ABSENT, err);
    drop(work);
}

static void end_cancelled(struct rn_work *work) {
    struct rn_error err;
    rn_error_set(&err, RN_ERROR_CANCELLED, "", "cancelled; what was finished is kept");
    rn_work_fail(work, &err);
}

bool rn_work_cancel(struct rn_host *host, const char *job) {
    struct rn_work *work = host->works;
    while (work && strcmp(work->job, job) != 0)
        work = work->next;
    if (work) end_cancelled(work);
    return work != NULL;
}

// ---- units ---------------------------------------------------------------------------------

bool rn_work_keep_going(void *context) {
    struct rn_work *work = context;
    if (!rn_watch_keep_going(&work->watch)) return false;
    rn_host_serve_render(work->host);
    return true;
}

void rn_work_rendered(struct rn_work *work, double render_ms, uint64_t nonfinite_rays) {
    work->render_ms[work->rendered++] = render_ms;
    work->nonfinite += nonfinite_rays;
}

static void post_progress(struct rn_work *work) {
    double now = now_s();
    struct rn_work_progress record = {.done = (int64_t)work->done,
                                      .total = (int64_t)work->total,
                                      .nonfinite = {.rays = (int64_t)work->nonfinite},
                                      .fraction = (double)work->done / (double)work->total,
                                      .eta_seconds = NAN};
    if (work->rendered)
        record.eta_seconds =
            (now - work->began_s) * (double)(work->total - work->done) / (double)work->rendered;
    struct rn_wire_progress message = {.progress = NULL};
    strcpy(message.job, work->job);
    if (rn_encode(&rn_work_progress_table, &record, &message.progress, NULL, NULL)) return;
    rn_link_post(&work->host->link, RN_WIRE_PROGRESS, &message, NULL, 0);
    free(message.progress);
    work->reported_s = now;
}

static enum rn_status prepare(struct rn_work *work, struct rn_field *field, struct rn_error *err) {
    enum rn_status status = work->kind->prepare(work, field, err);
    if (status) return status;
    work->render_ms = calloc(work->total, sizeof *work->render_ms);
    if (!work->render_ms) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    work->prepared = true;
    work->began_s = now_s();
    post_progress(work);
    return RN_OK;
}

// All units show one step. A training that was cancelled meanwhile has left another one: then
// everything begins anew.
static enum rn_status take_step(struct rn_work *work, int64_t step, struct rn_error *err) {
    if (step == work->step) return RN_OK;
    work->step = step;
    work->done = work->rendered = 0;
    return work->kind->begin ? work->kind->begin(work, err) : RN_OK;
}

static enum rn_status do_unit(struct rn_work *work, struct rn_error *err) {
    struct rn_field *field;
    struct rn_field_info info;
    enum rn_status status = rn_host_field(work->host, &field, err);
    if (!status && !work->prepared) status = prepare(work, field, err);
    if (status) return status;
    rn_field_describe(field, &info);
    status = take_step(work, info.steps, err);
    if (!status) status = work->kind->unit(work, field, &info, err);
    return status;
}

static enum rn_status finish(struct rn_work *work, struct rn_error *err) {
    struct rn_wire_done done = {.result = NULL};
    struct rn_field *field;
    enum rn_status status = rn_host_field(work->host, &field, err);
    if (!status) status = work->kind->result(work, field, &done.result, err);
    if (status) return status;
    strcpy(done.job, work->job);
    rn_link_post(&work->host->link, RN_WIRE_DONE, &done, NULL, 0);
    free(done.result);
    drop(work);
    return RN_OK;
}

void rn_work_unit(struct rn_host *host) {
    struct rn_work *work = host->works;
    struct rn_error err = {0};
    enum rn_status status = do_unit(work, &err);
    if (!status) {
        work->done++;
        if (work->done == work->total || now_s() - work->reported_s >= PROGRESS_INTERVAL_S)
            post_progress(work);
        if (work->done == work->total) status = finish(work, &err);
    }
    // Stopped because the runner must end: the daemon will start the job again.
    if (status == RN_ERROR_CANCELLED && rn_link_must_stop(&host->link)) return;
    if (status == RN_ERROR_CANCELLED)
        end_cancelled(work);
    else if (status)
        rn_work_fail(work, &err);
}
