#include "client/outcome.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "client/progress.h"
#include "proto/problem.h"

static void format_training(const struct rn_train_result *result, char *ret_text, size_t capacity) {
    char seconds[24], psnr[24] = "";
    rn_format_seconds(result->train_seconds, seconds, sizeof seconds);
    if (!isnan(result->psnr)) snprintf(psnr, sizeof psnr, ", %.2f dB", result->psnr);
    snprintf(ret_text, capacity, "%lld steps in %s%s%s", (long long)result->steps, seconds, psnr,
             *result->fell_back ? "; a damaged checkpoint was passed over" : "");
}

static void format_evaluation(const struct rn_eval_result *result, char *ret_text,
                              size_t capacity) {
    char psnr[24] = "identical";
    if (!isnan(result->psnr)) snprintf(psnr, sizeof psnr, "%.2f dB", result->psnr);
    snprintf(ret_text, capacity, "%s, SSIM %.4f, %lld %s view%s", psnr, result->ssim,
             (long long)result->views, rn_split_names[result->protocol.split],
             result->views == 1 ? "" : "s");
}

static void format_path(const struct rn_path_result *result, char *ret_text, size_t capacity) {
    snprintf(ret_text, capacity, "%lld frame%s of %lldx%lld", (long long)result->frames,
             result->frames == 1 ? "" : "s", (long long)result->width, (long long)result->height);
}

static void format_problem(const char *json, char *ret_text, size_t capacity) {
    struct rn_api_problem problem;
    if (rn_decode(&rn_api_problem_table, json, strlen(json), &problem, NULL, NULL) != RN_OK) return;
    snprintf(ret_text, capacity, "%s", *problem.detail ? problem.detail : problem.title);
    for (char *c = ret_text; *c; c++)
        if ((unsigned char)*c < ' ' || *c == 0x7f) *c = '?'; // a terminal might obey it
    rn_message_finish(&rn_api_problem_table, &problem);
}

static void format_result(const struct rn_job *job, char *ret_text, size_t capacity) {
    union {
        struct rn_train_result train;
        struct rn_path_result path;
        struct rn_eval_result eval;
    } result;
    const struct rn_table *table = job->type == RN_JOB_TRAIN  ? &rn_train_result_table
                                   : job->type == RN_JOB_PATH ? &rn_path_result_table
                                   : job->type == RN_JOB_EVAL ? &rn_eval_result_table
                                                              : NULL;
    if (!table || rn_decode(table, job->result, strlen(job->result), &result, NULL, NULL) != RN_OK)
        return;
    if (job->type == RN_JOB_TRAIN)
        format_training(&result.train, ret_text, capacity);
    else if (job->type == RN_JOB_PATH)
        format_path(&result.path, ret_text, capacity);
    else
        format_evaluation(&result.eval, ret_text, capacity);
    rn_message_finish(table, &result);
}

void rn_format_outcome(const struct rn_job *job, char *ret_text, size_t capacity) {
    snprintf(ret_text, capacity, "%s", "");
    if (job->problem)
        format_problem(job->problem, ret_text, capacity);
    else if (job->result)
        format_result(job, ret_text, capacity);
}
