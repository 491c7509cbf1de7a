// The held-out figures of a training job: kept with its records, whatever becomes of its events.
#include <stdio.h>
#include <stdlib.h>

#include "proto/job.h"
#include "server/jobs/inside.h"

// Figures of one job. When there are more, every second one is dropped: the curve keeps its shape.
#define MAX_FIGURES 512

static enum rn_status list(struct rn_control *control, const char *job,
                           struct rn_metric_row **ret_rows, size_t *ret_count,
                           struct rn_error *err) {
    struct rn_query query = {.equal = {{"job", job}}};
    void *rows = NULL;
    enum rn_status status =
        rn_store_list(control->store, &rn_metrics, &query, &rows, ret_count, err);
    if (status == RN_OK) *ret_rows = rows;
    return status;
}

// Deletes what a restart from a checkpoint has undone, and what there is too much of. The rows are
// newest first.
static enum rn_status make_room(struct rn_control *control, const struct rn_metric_row *rows,
                                size_t count, int64_t step, struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (size_t i = 0; status == RN_OK && i < count; i++)
        if (rows[i].step >= step || (count >= MAX_FIGURES && i % 2 == 1))
            status = rn_store_delete(control->store, &rn_metrics, rows[i].id, err);
    return status;
}

enum rn_status rn_metric_record(struct rn_control *control, const char *job,
                                const struct rn_metric_event *metric, struct rn_error *err) {
    struct rn_metric_row row = {
        .step = metric->step, .train_seconds = metric->train_seconds, .psnr = metric->psnr};
    struct rn_metric_row *rows = NULL;
    size_t count = 0;
    snprintf(row.id, sizeof row.id, "%s/%lld", job, (long long)metric->step);
    snprintf(row.job, sizeof row.job, "%s", job);
    enum rn_status status = rn_store_begin(control->store, err);
    if (status != RN_OK) return status;
    status = list(control, job, &rows, &count, err);
    if (status == RN_OK) status = make_room(control, rows, count, metric->step, err);
    if (status == RN_OK) status = rn_store_insert(control->store, &rn_metrics, &row, err);
    rn_rows_finish(&rn_metrics, rows, count);
    if (status == RN_OK) return rn_store_commit(control->store, err);
    rn_store_rollback(control->store);
    return status;
}

static enum rn_status encode(const struct rn_metric_row *rows, size_t count, char **ret_json,
                             struct rn_error *err) {
    char *items[MAX_FIGURES + 1];
    size_t done = 0;
    enum rn_status status = RN_OK;
    while (status == RN_OK && done < count && done < MAX_FIGURES + 1) {
        const struct rn_metric_row *row = &rows[count - 1 - done]; // oldest first
        struct rn_metric_event metric = {row->step, row->train_seconds, row->psnr};
        status = rn_encode(&rn_metric_event_table, &metric, &items[done], NULL, err);
        if (status == RN_OK) done++;
    }
    if (status == RN_OK)
        status = rn_encode_list((const char *const *)items, done, NULL, ret_json, NULL, err);
    while (done > 0)
        free(items[--done]);
    return status;
}

enum rn_status rn_control_metrics_json(struct rn_control *control, const char *id, char **ret_json,
                                       struct rn_error *err) {
    struct rn_job_row job;
    struct rn_metric_row *rows = NULL;
    size_t count = 0;
    enum rn_status status =
        rn_store_resolve(control->store, &rn_jobs_table, RN_ID_JOB, id, &job, err);
    if (status != RN_OK) return status;
    rn_row_finish(&rn_jobs_table, &job);
    status = list(control, id, &rows, &count, err);
    if (status == RN_OK) status = encode(rows, count, ret_json, err);
    rn_rows_finish(&rn_metrics, rows, count);
    return status;
}
