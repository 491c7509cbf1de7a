#include "client/outcome.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/progress.h"
#include "proto/ladder.h"
#include "proto/problem.h"

// "; 33.1 dB after 10.0 s were estimated", or nothing.
static void format_check(const struct rn_estimate_check *check, char *ret_text, size_t capacity) {
    char seconds[24];
    *ret_text = '\0';
    if (!*check->job || isnan(check->psnr)) return;
    rn_format_seconds(check->seconds, seconds, sizeof seconds);
    snprintf(ret_text, capacity, "; %.2f dB after %s were estimated", check->psnr, seconds);
}

static void format_training(const void *message, char *ret_text, size_t capacity) {
    const struct rn_train_result *result = message;
    char seconds[24], psnr[48], check[64];
    rn_format_seconds(result->train_seconds, seconds, sizeof seconds);
    rn_format_figure(result->psnr, result->psnr_step, result->steps, psnr, sizeof psnr);
    format_check(&result->estimate, check, sizeof check);
    snprintf(ret_text, capacity, "%lld steps in %s%s%s%s%s", (long long)result->steps, seconds,
             *psnr ? ", " : "", psnr, check,
             *result->fell_back ? "; a damaged checkpoint was passed over" : "");
}

static void format_evaluation(const void *message, char *ret_text, size_t capacity) {
    const struct rn_eval_result *result = message;
    char psnr[24] = "identical";
    if (!isnan(result->psnr)) snprintf(psnr, sizeof psnr, "%.2f dB", result->psnr);
    snprintf(ret_text, capacity, "%s, SSIM %.4f, %lld %s view%s", psnr, result->ssim,
             (long long)result->views, rn_split_names[result->protocol.split],
             result->views == 1 ? "" : "s");
}

static void format_path(const void *message, char *ret_text, size_t capacity) {
    const struct rn_path_result *result = message;
    snprintf(ret_text, capacity, "%lld frame%s of %lldx%lld", (long long)result->frames,
             result->frames == 1 ? "" : "s", (long long)result->width, (long long)result->height);
}

static void format_estimate(const void *message, char *ret_text, size_t capacity) {
    const struct rn_estimate *estimate = message;
    char seconds[24], psnr[24] = "";
    rn_format_seconds(estimate->seconds, seconds, sizeof seconds);
    if (!isnan(estimate->psnr)) snprintf(psnr, sizeof psnr, ", about %.1f dB", estimate->psnr);
    snprintf(ret_text, capacity, "%s%s", seconds, psnr);
}

static void format_ladder(const void *message, char *ret_text, size_t capacity) {
    const struct rn_ladder_result *result = message;
    char seconds[24], failed[40] = "";
    rn_format_seconds(result->train_seconds, seconds, sizeof seconds);
    if (result->failed > 0)
        snprintf(failed, sizeof failed, ", %lld failed", (long long)result->failed);
    snprintf(ret_text, capacity, "%lld trainings of %lld arms, %s%s", (long long)result->trainings,
             (long long)result->arms, seconds, failed);
}

static void format_export(const void *message, char *ret_text, size_t capacity) {
    const struct rn_export_result *result = message;
    char bytes[24], loss[32] = "";
    rn_format_bytes((double)result->bytes, bytes, sizeof bytes);
    if (!isnan(result->loss)) snprintf(loss, sizeof loss, ", %.3f dB less", result->loss);
    snprintf(ret_text, capacity, "%s, %s%s", result->file, bytes, loss);
}

// From the cheapest setting to the full picture: against photographs where there are any.
static void format_curve(const void *message, char *ret_text, size_t capacity) {
    const struct rn_curve_record *curve = message;
    char times[64] = "", psnr[48] = "";
    if (curve->count > 0) {
        const struct rn_curve_point *cheap = &curve->points[0];
        const struct rn_curve_point *full = &curve->points[curve->count - 1];
        snprintf(times, sizeof times, ", %.1f to %.1f ms", cheap->ms_median, full->ms_median);
        if (curve->photographs && isfinite(cheap->psnr) && isfinite(full->psnr))
            snprintf(psnr, sizeof psnr, ", %.2f to %.2f dB", cheap->psnr, full->psnr);
    }
    snprintf(ret_text, capacity, "%zu settings%s%s", curve->count, times, psnr);
}

// The gain of every effect, dB.
static void format_effects(const void *message, char *ret_text, size_t capacity) {
    const struct rn_effects_record *effects = message;
    size_t used =
        (size_t)snprintf(ret_text, capacity, "%s", effects->count ? "" : "none to measure");
    for (size_t i = 0; i < effects->count && used < capacity; i++) {
        const struct rn_effect_gain *gain = &effects->gains[i];
        char number[24] = "not measured";
        if (!isnan(gain->gain)) snprintf(number, sizeof number, "%+.2f dB", gain->gain);
        used += (size_t)snprintf(ret_text + used, capacity - used, "%s%s %s", i ? ", " : "",
                                 gain->name, number);
    }
}

static void format_doctor(const void *message, char *ret_text, size_t capacity) {
    const struct rn_doctor_record *record = message;
    size_t failed = 0, skipped = 0;
    for (size_t i = 0; i < record->case_count; i++) {
        failed += !record->cases[i].passed && !record->cases[i].skipped;
        skipped += record->cases[i].skipped;
    }
    snprintf(ret_text, capacity, "%zu cases, %zu failed, %zu skipped", record->case_count, failed,
             skipped);
}

static void format_validation(const void *message, char *ret_text, size_t capacity) {
    const struct rn_validation_record *validation = message;
    struct rn_dataset_report_record report;
    char faults[64] = "";
    if (rn_decode(&rn_dataset_report_table, validation->report, strlen(validation->report), &report,
                  NULL, NULL) == RN_OK) {
        snprintf(faults, sizeof faults, "; %lld errors, %lld warnings", (long long)report.errors,
                 (long long)report.warnings);
        rn_message_finish(&rn_dataset_report_table, &report);
    }
    const struct rn_split_counts *views = &validation->views;
    snprintf(ret_text, capacity, "%lld to train, %lld to validate, %lld to test%s",
             (long long)views->train, (long long)views->val, (long long)views->test, faults);
}

static void format_problem(const char *json, char *ret_text, size_t capacity) {
    struct rn_api_problem problem;
    if (rn_decode(&rn_api_problem_table, json, strlen(json), &problem, NULL, NULL) != RN_OK) return;
    snprintf(ret_text, capacity, "%s", *problem.detail ? problem.detail : problem.title);
    for (char *c = ret_text; *c; c++)
        if ((unsigned char)*c < ' ' || *c == 0x7f) *c = '?'; // a terminal might obey it
    rn_message_finish(&rn_api_problem_table, &problem);
}

// What each type of job results in, and its figures; an import's are the dataset's own.
static const struct row {
    const struct rn_table *table;
    void (*format)(const void *message, char *ret_text, size_t capacity);
} rows[] = {[RN_JOB_TRAIN] = {&rn_train_result_table, format_training},
            [RN_JOB_PATH] = {&rn_path_result_table, format_path},
            [RN_JOB_EVAL] = {&rn_eval_result_table, format_evaluation},
            [RN_JOB_CURVE] = {&rn_curve_record_table, format_curve},
            [RN_JOB_ESTIMATE] = {&rn_estimate_table, format_estimate},
            [RN_JOB_EFFECTS] = {&rn_effects_record_table, format_effects},
            [RN_JOB_EXPORT] = {&rn_export_result_table, format_export},
            [RN_JOB_LADDER] = {&rn_ladder_result_table, format_ladder},
            [RN_JOB_DOCTOR] = {&rn_doctor_table, format_doctor},
            [RN_JOB_VALIDATE] = {&rn_validation_table, format_validation}};

static void format_result(const struct rn_job *job, char *ret_text, size_t capacity) {
    bool listed = (size_t)job->type < sizeof rows / sizeof *rows;
    const struct row *row = listed ? &rows[job->type] : NULL;
    if (!row || !row->format) return;
    void *message = malloc(row->table->size);
    if (message &&
        rn_decode(row->table, job->result, strlen(job->result), message, NULL, NULL) == RN_OK) {
        row->format(message, ret_text, capacity);
        rn_message_finish(row->table, message);
    }
    free(message);
}

void rn_format_outcome(const struct rn_job *job, char *ret_text, size_t capacity) {
    snprintf(ret_text, capacity, "%s", "");
    if (job->problem)
        format_problem(job->problem, ret_text, capacity);
    else if (job->result)
        format_result(job, ret_text, capacity);
}
