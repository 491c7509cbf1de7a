// Estimates of trainings: made of a calibration and of how wrong past ones were, and kept with what
// came of them.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/log.h"
#include "server/jobs/forecast.h"
#include "server/jobs/inside.h"

#define MOST_JOBS 64  // of the past that are looked at
#define TRUSTED 3     // estimates that were checked, until their spread is believed
#define SPREAD_DB 0.5 // of a training's end, until then
#define PULL 2        // as many estimates that were right stand against a bias

static const double passed_psnr[] = {30, 33};
enum { PASSINGS = sizeof passed_psnr / sizeof *passed_psnr };

// ---- the past ------------------------------------------------------------------------------

static enum rn_status list_jobs(struct rn_control *control, enum rn_job_type type,
                                const char *dataset, struct rn_job_row **ret_rows,
                                size_t *ret_count, struct rn_error *err) {
    struct rn_query query = {.equal = {{"type", rn_job_type_names[type]},
                                       {"state", rn_job_state_names[RN_JOB_SUCCEEDED]},
                                       {dataset != NULL ? "dataset" : NULL, dataset}},
                             .limit = MOST_JOBS,
                             .without = "source"};
    void *rows = NULL;
    enum rn_status status =
        rn_store_list(control->store, &rn_jobs_table, &query, &rows, ret_count, err);
    if (status == RN_OK) *ret_rows = rows;
    return status;
}

struct past {
    int checked, passings;
    double psnr_off, psnr_bias, log_off; // sums
};

static void add_check(struct past *past, const struct rn_train_result *result) {
    const struct rn_estimate_check *check = &result->estimate;
    if (check->job[0] == '\0' || isnan(check->psnr) || isnan(result->psnr)) return;
    past->checked++;
    past->psnr_off += fabs(result->psnr - check->psnr);
    past->psnr_bias += result->psnr - check->psnr;
    for (size_t i = 0; i < check->passing_count; i++) {
        const struct rn_estimate_passing *passing = &check->passings[i];
        if (!(passing->seconds > 0) || !(passing->reached > 0)) continue;
        past->log_off += fabs(log(passing->reached / passing->seconds));
        past->passings++;
    }
}

static enum rn_status look_back(struct rn_control *control, struct past *past,
                                struct rn_error *err) {
    struct rn_job_row *rows = NULL;
    size_t count = 0;
    enum rn_status status = list_jobs(control, RN_JOB_TRAIN, NULL, &rows, &count, err);
    for (size_t i = 0; i < count; i++) {
        struct rn_train_result result;
        if (rows[i].result == NULL ||
            rn_decode(&rn_train_result_table, rows[i].result, strlen(rows[i].result), &result, NULL,
                      NULL) != RN_OK)
            continue;
        add_check(past, &result);
        rn_message_finish(&rn_train_result_table, &result);
    }
    rn_rows_finish(&rn_jobs_table, rows, count);
    return status;
}

// ---- an estimate ---------------------------------------------------------------------------

enum rn_status rn_estimate_make(struct rn_control *control, char **calibration_to_estimate,
                                struct rn_error *err) {
    struct rn_estimate estimate = {.psnr_spread = NAN};
    struct rn_estimate_passing passings[PASSINGS];
    struct past past = {0};
    char *json = *calibration_to_estimate;
    enum rn_status status =
        rn_decode(&rn_calibration_table, json, strlen(json), &estimate.calibration, NULL, err);
    if (status == RN_OK) status = look_back(control, &past, err);
    if (status != RN_OK) return status;
    const struct rn_calibration *c = &estimate.calibration;
    double bias = past.psnr_bias / (past.checked + PULL);
    bool known = past.checked >= TRUSTED;
    estimate.seconds = rn_forecast_seconds(c);
    estimate.psnr = rn_forecast_psnr(c, estimate.seconds) + bias;
    if (!isnan(estimate.psnr))
        estimate.psnr_spread = known ? past.psnr_off / past.checked : SPREAD_DB;
    for (int i = 0; i < PASSINGS; i++)
        passings[i] = (struct rn_estimate_passing){
            .psnr = passed_psnr[i],
            .seconds = rn_forecast_passing(c, estimate.seconds, passed_psnr[i] - bias),
            .reached = NAN};
    estimate.passings = passings;
    estimate.passing_count = PASSINGS;
    estimate.load_seconds = c->load_seconds;
    estimate.memory_bytes = c->memory_bytes;
    estimate.disk_bytes = c->disk_bytes;
    estimate.past = (struct rn_estimate_past){
        .estimates = past.checked,
        .psnr_off = past.checked > 0 ? past.psnr_off / past.checked : NAN,
        .seconds_off = past.passings > 0 ? exp(past.log_off / past.passings) - 1 : NAN};
    char *text = NULL;
    status = rn_encode(&rn_estimate_table, &estimate, &text, NULL, err);
    if (status != RN_OK) return status;
    free(json);
    *calibration_to_estimate = text;
    return RN_OK;
}

// ---- the truth -----------------------------------------------------------------------------

// The newest estimate of a training with these options of its dataset; RN_ERROR_NOT_FOUND.
static enum rn_status find_estimate(struct rn_control *control, const struct rn_job_row *train,
                                    struct rn_estimate_check *ret_check, struct rn_error *err) {
    struct rn_job_row *rows = NULL;
    size_t count = 0;
    enum rn_status status = list_jobs(control, RN_JOB_ESTIMATE, train->dataset, &rows, &count, err);
    if (status != RN_OK) return status;
    status = RN_ERROR_NOT_FOUND;
    for (size_t i = 0; i < count && status == RN_ERROR_NOT_FOUND; i++) {
        struct rn_estimate estimate;
        bool of_it = rows[i].result != NULL && rows[i].created_ms <= train->created_ms &&
                     strcmp(rows[i].options, train->options) == 0;
        if (!of_it || rn_decode(&rn_estimate_table, rows[i].result, strlen(rows[i].result),
                                &estimate, NULL, NULL) != RN_OK)
            continue;
        *ret_check = (struct rn_estimate_check){.seconds = estimate.seconds,
                                                .psnr = estimate.psnr,
                                                .passings = estimate.passings,
                                                .passing_count = estimate.passing_count};
        snprintf(ret_check->job, sizeof ret_check->job, "%s", rows[i].id);
        estimate.passings = NULL; // the check's now
        estimate.passing_count = 0;
        rn_message_finish(&rn_estimate_table, &estimate);
        status = RN_OK;
    }
    rn_rows_finish(&rn_jobs_table, rows, count);
    return status;
}

// When the held-out figures first passed a PSNR, between the two about it; NAN.
static double passed_at(const struct rn_metric_row *rows, size_t count, double psnr) {
    for (size_t i = count; i-- > 0;) { // oldest first
        if (!(rows[i].psnr >= psnr)) continue;
        if (i + 1 == count) return rows[i].train_seconds;
        const struct rn_metric_row *before = &rows[i + 1];
        double share = (psnr - before->psnr) / fmax(rows[i].psnr - before->psnr, 1e-9);
        return before->train_seconds + share * (rows[i].train_seconds - before->train_seconds);
    }
    return NAN;
}

static enum rn_status add_truth(struct rn_control *control, const char *job,
                                struct rn_estimate_check *check, struct rn_error *err) {
    struct rn_query query = {.equal = {{"job", job}}};
    void *rows = NULL;
    size_t count = 0;
    enum rn_status status = rn_store_list(control->store, &rn_metrics, &query, &rows, &count, err);
    for (size_t i = 0; status == RN_OK && i < check->passing_count; i++)
        check->passings[i].reached = passed_at(rows, count, check->passings[i].psnr);
    rn_rows_finish(&rn_metrics, rows, count);
    return status;
}

void rn_estimate_check_training(struct rn_control *control, struct rn_job_row *train) {
    struct rn_train_result result;
    struct rn_error err = {0};
    char *text = NULL;
    if (train->result == NULL || rn_decode(&rn_train_result_table, train->result,
                                           strlen(train->result), &result, NULL, NULL) != RN_OK)
        return;
    enum rn_status status = find_estimate(control, train, &result.estimate, &err);
    if (status == RN_OK) status = add_truth(control, train->id, &result.estimate, &err);
    if (status == RN_OK) status = rn_encode(&rn_train_result_table, &result, &text, NULL, &err);
    if (status == RN_OK) {
        free(train->result);
        train->result = text;
    } else if (status != RN_ERROR_NOT_FOUND) {
        rn_log(RN_LOG_WARN, "job %s: what was estimated is not kept: %s", train->id, err.text);
    }
    rn_message_finish(&rn_train_result_table, &result);
}
