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

// ---- what other options would give ----

#define LEAST_SIDE 400 // pixels of the longest side that are suggested at least
#define SUGGESTED_SCALES 4
#define SUGGESTED_SPLIT 8

static void add_choice(const struct rn_dataset *dataset, struct rn_import_options options,
                       struct rn_dataset_report_record *report) {
    if (report->choice_count == RN_REPORT_CHOICES_MAX) return;
    struct rn_training_cost cost = rn_training_cost(dataset, &options);
    struct rn_import_choice *choice = &report->choices[report->choice_count++];
    *choice =
        (struct rn_import_choice){.max_size = options.max_size > 0 ? options.max_size : RN_ABSENT,
                                  .scales = options.scales > 1 ? options.scales : RN_ABSENT,
                                  .views = split_counts(cost.views),
                                  .width = cost.width,
                                  .height = cost.height,
                                  .train_scale = cost.reduced,
                                  .memory_bytes = cost.bytes,
                                  .load_seconds = cost.load_seconds,
                                  .seconds = cost.seconds};
    if (options.test_every > 0)
        snprintf(choice->split, sizeof choice->split, "every:%d", options.test_every);
}

// What is asked for first; then with a test split, smaller, and at several scales.
static enum rn_status fill_choices(const struct rn_dataset *dataset,
                                   const struct rn_import_options *kept,
                                   struct rn_dataset_report_record *report, struct rn_error *err) {
    report->choices = calloc(RN_REPORT_CHOICES_MAX, sizeof *report->choices);
    if (!report->choices) return rn_error_set(err, RN_ERROR_NO_MEMORY, "report", "memory ran out");
    const struct rn_import_options asked = rn_import_settle(dataset, kept, NULL);
    add_choice(dataset, asked, report);
    int64_t width = report->choices[0].width, height = report->choices[0].height;
    struct rn_import_options other = asked;
    other.test_every = SUGGESTED_SPLIT;
    if (!asked.test_every && report->choices[0].views.test == 0) add_choice(dataset, other, report);
    other = asked;
    other.max_size = (int)(width > height ? width : height);
    while ((other.max_size /= 2) >= LEAST_SIDE)
        add_choice(dataset, other, report);
    other = asked;
    other.scales = SUGGESTED_SCALES;
    if (asked.scales == 1 && dataset->scale_count == 1) add_choice(dataset, other, report);
    return RN_OK;
}

static void fill_images(const struct rn_dataset_report *found,
                        struct rn_dataset_report_record *report) {
    report->usable = split_counts(found->usable);
    report->unusable = split_counts(found->unusable);
    report->scales = found->scale_count;
    report->with_alpha = found->with_alpha;
    report->width = (struct rn_range){found->width_min, found->width_max};
    report->height = (struct rn_range){found->height_min, found->height_max};
}

enum rn_status rn_photos_report_fill(const struct rn_dataset *frames,
                                     const struct rn_problems *problems,
                                     const struct rn_findings *survey,
                                     struct rn_dataset_report_record *ret_report,
                                     struct rn_error *err) {
    struct rn_dataset_report found;
    enum rn_status status = rn_report_problems_fill(problems, ret_report, err);
    if (status != RN_OK) return status;
    rn_dataset_describe(frames, &found);
    fill_images(&found, ret_report);
    ret_report->survey = *survey;
    return RN_OK;
}

enum rn_status
rn_dataset_report_fill(const struct rn_dataset *dataset, const struct rn_problems *problems,
                       const struct rn_findings *survey, const struct rn_import_options *kept,
                       struct rn_dataset_report_record *ret_report, struct rn_error *err) {
    struct rn_dataset_report found;
    enum rn_status status = rn_report_problems_fill(problems, ret_report, err);
    if (status != RN_OK) return status;
    if (kept && (status = fill_choices(dataset, kept, ret_report, err)) != RN_OK) {
        rn_message_finish(&rn_dataset_report_table, ret_report);
        return status;
    }
    rn_dataset_describe(dataset, &found);
    if (survey) {
        ret_report->survey = *survey;
        ret_report->expected = (struct rn_expected){
            .seconds = rn_settings_find(&rn_train_settings, "max_seconds")->standard,
            .memory_bytes = survey->train_bytes};
    }
    snprintf(ret_report->layout, sizeof ret_report->layout, "%s", dataset->format->name);
    fill_images(&found, ret_report);
    ret_report->bounds = rn_describe_bounds(&dataset->bounds);
    ret_report->capture = (int)dataset->lie.kind;
    memcpy(ret_report->up, dataset->lie.up, sizeof ret_report->up);
    ret_report->footprint = (struct rn_range){found.footprint_min, found.footprint_max};
    ret_report->camera_distance =
        (struct rn_range){found.camera_distance_min, found.camera_distance_max};
    ret_report->looking_at_bounds = found.looking_at_bounds;
    return RN_OK;
}
