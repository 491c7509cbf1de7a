// What trainings with `standard` took here beside what was expected of them: what the next takes.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/numbers.h"
#include "common/settings/train.h"
#include "proto/dataset.h"
#include "proto/job.h"
#include "server/jobs/inside.h"

#define MOST_JOBS 64 // that are looked at, the newest
#define STANDARD 1   // of rn_preset_names

struct seen {
    double beside; // seconds from start to end that no training was in, the least; NAN: none yet
    double memory[MOST_JOBS]; // ratios of what was to what was expected
    size_t trainings, measured;
};

static bool is_standard(const struct rn_job_row *train) {
    struct rn_train_options options;
    if (train->options == NULL || rn_decode(&rn_train_options_table, train->options,
                                            strlen(train->options), &options, NULL, NULL) != RN_OK)
        return false;
    bool standard = rn_name_or(options.preset, STANDARD) == STANDARD;
    rn_message_finish(&rn_train_options_table, &options);
    return standard;
}

// By the formula, from a dataset's record; NAN: it was not looked at then.
static double expected_memory(const char *record) {
    struct rn_dataset_record dataset;
    struct rn_dataset_report_record report;
    double bytes = NAN;
    if (rn_decode(&rn_dataset_contents_table, record, strlen(record), &dataset, NULL, NULL))
        return NAN;
    if (rn_decode(&rn_dataset_report_table, dataset.report, strlen(dataset.report), &report, NULL,
                  NULL) == RN_OK) {
        bytes = report.survey.train_bytes;
        rn_message_finish(&rn_dataset_report_table, &report);
    }
    rn_message_finish(&rn_dataset_contents_table, &dataset);
    return bytes;
}

// Loading, looks at held-out views and saving are not on the training clock, and do not grow with
// it: their seconds are added to those of another training, not multiplied. What else the machine
// did meanwhile made them more, never less. A training that was interrupted tells nothing.
static void add_time(const struct rn_job_row *train, struct seen *seen) {
    struct rn_train_result result;
    if (train->result == NULL || train->attempt > 1 ||
        rn_decode(&rn_train_result_table, train->result, strlen(train->result), &result, NULL,
                  NULL))
        return;
    double wall = (double)(train->finished_ms - train->started_ms) * 1e-3;
    if (wall > result.train_seconds) seen->beside = fmin(seen->beside, wall - result.train_seconds);
    rn_message_finish(&rn_train_result_table, &result);
}

static void add_memory(struct rn_store *store, const struct rn_job_row *train, struct seen *seen) {
    struct rn_scene_row scene;
    struct rn_dataset_row dataset;
    if (rn_store_find(store, &rn_scenes, "id", train->scene, &scene, NULL) != RN_OK) return;
    double took = (double)scene.memory_bytes;
    rn_row_finish(&rn_scenes, &scene);
    if (!(took > 0) || rn_store_find(store, &rn_datasets, "id", train->dataset, &dataset, NULL))
        return;
    double ratio = took / expected_memory(dataset.record);
    if (isfinite(ratio)) seen->memory[seen->measured++] = ratio;
    rn_row_finish(&rn_datasets, &dataset);
}

enum rn_status rn_control_past(struct rn_control *control, const char *record,
                               struct rn_expected_past *ret_past, struct rn_error *err) {
    struct rn_query query = {.equal = {{"type", rn_job_type_names[RN_JOB_TRAIN]},
                                       {"state", rn_job_state_names[RN_JOB_SUCCEEDED]}},
                             .limit = MOST_JOBS,
                             .without = "source"};
    struct seen seen = {.beside = NAN};
    struct rn_job_row *rows = NULL;
    size_t count = 0;
    void *list = NULL;
    enum rn_status status =
        rn_store_list(control->store, &rn_jobs_table, &query, &list, &count, err);
    if (status != RN_OK) return status;
    rows = list;
    for (size_t i = 0; i < count; i++) {
        if (!is_standard(&rows[i])) continue;
        seen.trainings++;
        add_time(&rows[i], &seen);
        add_memory(control->store, &rows[i], &seen);
    }
    rn_rows_finish(&rn_jobs_table, rows, count);
    rn_message_init(&rn_expected_past_table, ret_past);
    if (!seen.trainings) return RN_OK;
    double seconds = rn_settings_find(&rn_train_settings, "max_seconds")->standard;
    ret_past->trainings = (int64_t)seen.trainings;
    ret_past->seconds = seconds + seen.beside;
    if (seen.measured)
        ret_past->memory_bytes =
            expected_memory(record) * rn_numbers_median(seen.memory, seen.measured);
    return RN_OK;
}
