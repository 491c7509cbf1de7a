#include "server/runner/field/work.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"

#define PROGRESS_INTERVAL_S 0.5

static double now_s(void) {
    return (double)rn_clock_ns() * 1e-9;
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
    work->at = NAN;
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

static void fail(struct rn_work *work, const struct rn_error *err) {
    rn_link_fail(&work->host->link, work->job, RN_ABSENT, err);
    drop(work);
}

static void end_cancelled(struct rn_work *work) {
    struct rn_error err;
    rn_error_set(&err, RN_ERROR_CANCELLED, "", "cancelled; what was finished is kept");
    fail(work, &err);
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

double rn_work_lent_ms(const struct rn_work *work) {
    return (double)work->host->lent_ns * 1e-6;
}

enum rn_status rn_work_render(struct rn_work *work, struct rn_field *field,
                              const struct rn_render_options *options,
                              struct rn_render_result *ret_result, struct rn_error *err) {
    double lent_ms = rn_work_lent_ms(work);
    enum rn_status status =
        rn_render(work->host->engine, field, options, rn_work_keep_going, work, ret_result, err);
    if (!status) ret_result->stats.render_ms -= rn_work_lent_ms(work) - lent_ms;
    return status;
}

void rn_work_rendered(struct rn_work *work, double render_ms, uint64_t nonfinite_rays) {
    work->render_ms[work->rendered++] = render_ms;
    work->nonfinite += nonfinite_rays;
}

enum rn_status rn_work_score(struct rn_work *work, struct rn_field *field,
                             const struct rn_field_info *info, const struct rn_frame *frame,
                             struct rn_view_score *ret_score, struct rn_error *err) {
    struct rn_render_options options = {.outputs = RN_OUTPUT_RGB};
    memcpy(options.background, info->config.background, sizeof options.background);
    double lent_ms = rn_work_lent_ms(work);
    enum rn_status status = rn_evaluate_view(work->host->engine, field, frame, &options,
                                             rn_work_keep_going, work, ret_score, err);
    if (status) return status;
    ret_score->render_ms -= rn_work_lent_ms(work) - lent_ms;
    rn_work_rendered(work, ret_score->render_ms, ret_score->nonfinite_rays);
    return RN_OK;
}

int rn_work_choose_views(const struct rn_dataset *dataset, enum rn_split split, int wanted,
                         const struct rn_frame **ret_frames) {
    int views = dataset->view_count[split], last = -1, view = 0, chosen = 0;
    if (wanted > views) wanted = views;
    for (size_t i = 0; i < dataset->frame_count; i++) {
        const struct rn_frame *frame = &dataset->frames[i];
        if (frame->split != split || frame->index == last) continue;
        if (chosen < wanted && view == chosen * views / wanted) ret_frames[chosen++] = frame;
        view++;
        last = frame->index;
    }
    return chosen;
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
    enum rn_status status = rn_host_field_at(work->host, work->at, &field, err);
    if (!status && !work->prepared) status = prepare(work, field, err);
    if (status) return status;
    rn_field_describe(field, &info);
    status = take_step(work, info.steps, err);
    if (!status) status = work->kind->unit(work, field, &info, err);
    return status;
}

static enum rn_status finish(struct rn_work *work, struct rn_error *err) {
    char *result = NULL;
    struct rn_field *field;
    enum rn_status status = rn_host_field_at(work->host, work->at, &field, err);
    if (!status) status = work->kind->result(work, field, &result, err);
    if (status) return status;
    rn_link_done(&work->host->link, work->job, result);
    free(result);
    drop(work);
    return RN_OK;
}

void rn_work_unit(struct rn_host *host) {
    struct rn_work *work = host->works;
    struct rn_error err = {0};
    rn_link_log_of(&host->link, work->job);
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
        fail(work, &err);
}
