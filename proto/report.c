#include "proto/report.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/settings/train.h"

enum rn_status rn_report_problems_fill(const struct rn_problems *problems,
                                       struct rn_dataset_report_record *ret_report,
                                       struct rn_error *err) {
    size_t count =
        problems->count < RN_REPORT_PROBLEMS_MAX ? problems->count : RN_REPORT_PROBLEMS_MAX;
    struct rn_report_problem *items = calloc(count ? count : 1, sizeof *items);
    if (!items) return rn_error_set(err, RN_ERROR_NO_MEMORY, "report", "memory ran out");
    for (size_t i = 0; i < count; i++) {
        const struct rn_problem *problem = &problems->items[i];
        items[i].severity = (int)problem->severity;
        snprintf(items[i].where, sizeof items[i].where, "%s", problem->where);
        snprintf(items[i].text, sizeof items[i].text, "%s", problem->text);
    }
    rn_message_init(&rn_dataset_report_table, ret_report);
    ret_report->problems = items;
    ret_report->problem_count = count;
    ret_report->errors = (int64_t)problems->errors;
    ret_report->warnings = (int64_t)problems->warnings;
    ret_report->dropped = (int64_t)(problems->dropped + problems->count - count);
    return RN_OK;
}

static struct rn_split_counts split_counts(const int counts[RN_SPLIT_COUNT]) {
    return (struct rn_split_counts){.train = counts[RN_SPLIT_TRAIN],
                                    .val = counts[RN_SPLIT_VAL],
                                    .test = counts[RN_SPLIT_TEST]};
}

struct rn_bounds_record rn_describe_bounds(const struct rn_bounds *bounds) {
    return (struct rn_bounds_record){
        .centre = {bounds->centre[0], bounds->centre[1], bounds->centre[2]},
        .radius = bounds->radius,
        .source = (int)bounds->source};
}

enum rn_status rn_dataset_report_fill(const struct rn_dataset *dataset,
                                      const struct rn_problems *problems,
                                      const struct rn_findings *survey,
                                      struct rn_dataset_report_record *ret_report,
                                      struct rn_error *err) {
    struct rn_dataset_report found;
    enum rn_status status = rn_report_problems_fill(problems, ret_report, err);
    if (status != RN_OK) return status;
    rn_dataset_describe(dataset, &found);
    if (survey) {
        ret_report->survey = *survey;
        ret_report->expected = (struct rn_expected){
            .seconds = rn_settings_find(&rn_train_settings, "max_seconds")->standard,
            .memory_bytes = survey->train_bytes};
    }
    snprintf(ret_report->layout, sizeof ret_report->layout, "%s", dataset->format->name);
    ret_report->usable = split_counts(found.usable);
    ret_report->unusable = split_counts(found.unusable);
    ret_report->scales = found.scale_count;
    ret_report->bounds = rn_describe_bounds(&dataset->bounds);
    ret_report->capture = (int)dataset->lie.kind;
    memcpy(ret_report->up, dataset->lie.up, sizeof ret_report->up);
    ret_report->footprint = (struct rn_range){found.footprint_min, found.footprint_max};
    ret_report->camera_distance =
        (struct rn_range){found.camera_distance_min, found.camera_distance_max};
    ret_report->looking_at_bounds = found.looking_at_bounds;
    ret_report->with_alpha = found.with_alpha;
    ret_report->width = (struct rn_range){found.width_min, found.width_max};
    ret_report->height = (struct rn_range){found.height_min, found.height_max};
    return RN_OK;
}
