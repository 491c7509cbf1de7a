#include "proto/dataset.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "proto/checks.h"
#include "proto/job.h"

const char *const rn_poses_names[] = {"auto", "find", "file", NULL};
const char *const rn_backdrop_names[] = {"cut", "keep", NULL};
const char *const rn_severity_names[] = {"info", "warning", "error", NULL};

#define S struct rn_ingest_options
static const struct rn_field_spec ingest_options[] = {
    RN_F_INT(S, max_size, 0, 0, 16384),           RN_F_INT(S, scales, 0, 1, 8),
    RN_F_NAME(S, alpha, 0, rn_downscale_names),   RN_F_TEXT(S, split, 0, rn_check_split_spec),
    RN_F_TEXT(S, bounds, 0, rn_check_bounds),     RN_F_TEXT(S, up, 0, rn_check_up),
    RN_F_TEXT(S, crop, 0, rn_check_crop),         RN_F_TEXT(S, format, 0, rn_check_format),
    RN_F_TEXT(S, masks, 0, rn_check_inner_path),  RN_F_NAME(S, poses, 0, rn_poses_names),
    RN_F_NAME(S, backdrop, 0, rn_backdrop_names),
};
const struct rn_table rn_ingest_options_table = RN_TABLE(S, "import options", ingest_options);
#undef S

int rn_ingest_split_every(const char *split) {
    const char *colon = strchr(split, ':');
    return colon ? atoi(colon + 1) : 0;
}

// `count` finite numbers with commas between them, and nothing else.
static bool read_numbers(const char *text, int count, double *numbers) {
    for (int i = 0; i < count; i++) {
        char *end;
        numbers[i] = strtod(text, &end);
        if (end == text || *end != (i < count - 1 ? ',' : '\0') || !isfinite(numbers[i]))
            return false;
        text = end + 1;
    }
    return true;
}

bool rn_ingest_bounds(const char *bounds, double ret_centre[3], double *ret_radius) {
    double numbers[4];
    if (!read_numbers(bounds, 4, numbers) || !(numbers[3] > 0)) return false;
    memcpy(ret_centre, numbers, 3 * sizeof *numbers);
    *ret_radius = numbers[3];
    return true;
}

bool rn_ingest_up(const char *up, double ret_up[3]) {
    double numbers[3] = {0};
    const char *axis = up + (*up == '-' || *up == '+');
    if (*axis >= 'x' && *axis <= 'z' && !axis[1])
        numbers[*axis - 'x'] = *up == '-' ? -1 : 1;
    else if (!read_numbers(up, 3, numbers))
        return false;
    double size = sqrt(numbers[0] * numbers[0] + numbers[1] * numbers[1] + numbers[2] * numbers[2]);
    if (!(size > 1e-100) || !isfinite(size)) return false;
    memcpy(ret_up, numbers, sizeof numbers);
    return true;
}

bool rn_ingest_crop(const char *crop, struct rn_box *ret_crop) {
    double numbers[6];
    if (!read_numbers(crop, 6, numbers)) return false;
    for (int i = 0; i < 3; i++)
        if (!(numbers[i] < numbers[3 + i])) return false;
    memcpy(ret_crop->low, numbers, sizeof ret_crop->low);
    memcpy(ret_crop->high, numbers + 3, sizeof ret_crop->high);
    return true;
}

struct rn_read_options rn_ingest_reading(const struct rn_ingest_options *options) {
    struct rn_read_options reading = {.format = *options->format ? options->format : NULL,
                                      .masks = *options->masks ? options->masks : NULL};
    if (!rn_ingest_bounds(options->bounds, reading.bounds.centre, &reading.bounds.radius))
        reading.bounds.radius = 0;
    reading.keep_backdrop = rn_name_or(options->backdrop, 0) != 0;
    reading.up_given = rn_ingest_up(options->up, reading.up);
    reading.cropped = rn_ingest_crop(options->crop, &reading.crop);
    return reading;
}

struct rn_import_options rn_ingest_keeping(const struct rn_ingest_options *options) {
    return (struct rn_import_options){
        .max_size = (int)rn_int_or(options->max_size, 0),
        .scales = (int)rn_int_or(options->scales, 1),
        .downscale = (enum rn_downscale)rn_name_or(options->alpha, RN_DOWNSCALE_PREMULTIPLIED),
        .test_every = rn_ingest_split_every(options->split)};
}

static const char *check_directory(const char *text) {
    return *text == '/' ? NULL : "must be an absolute path";
}

#define S struct rn_dataset_request
static const struct rn_field_spec dataset_request[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, rn_check_name),
    {.name = "directory",
     .type = RN_TYPE_STRING,
     .offset = offsetof(S, directory),
     .max = 4095,
     .check = check_directory},
    RN_F_TEXT(S, upload, 0, rn_check_reference),
    RN_F_OBJECT(S, options, 0, &rn_ingest_options_table),
};
const struct rn_table rn_dataset_request_table = RN_TABLE(S, "a dataset request", dataset_request);
#undef S

#define S struct rn_upload_request
static const struct rn_field_spec upload_request[] = {
    RN_F_INT(S, size_bytes, RN_REQUIRED, 1, 1e15),
    RN_F_TEXT(S, name, 0, rn_check_name),
};
const struct rn_table rn_upload_request_table = RN_TABLE(S, "an upload request", upload_request);
#undef S

#define S struct rn_upload_record
static const struct rn_field_spec upload_fields[] = {
    RN_F_TEXT(S, id, RN_REQUIRED, NULL),
    RN_F_INT(S, size_bytes, RN_REQUIRED, 1, 1e15),
    RN_F_INT(S, offset, RN_REQUIRED, 0, 1e15),
};
const struct rn_table rn_upload_table = RN_TABLE(S, "an upload", upload_fields);
#undef S

#define S struct rn_range
static const struct rn_field_spec range[] = {
    RN_F_NUMBER(S, min, RN_REQUIRED, -INFINITY, INFINITY),
    RN_F_NUMBER(S, max, RN_REQUIRED, -INFINITY, INFINITY),
};
const struct rn_table rn_range_table = RN_TABLE(S, "a range", range);
#undef S

#define S struct rn_split_counts
static const struct rn_field_spec split_counts[] = {
    RN_F_INT(S, train, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, val, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, test, RN_REQUIRED, 0, INFINITY),
};
const struct rn_table rn_split_counts_table = RN_TABLE(S, "counts", split_counts);
#undef S

#define S struct rn_bounds_record
static const struct rn_field_spec bounds[] = {
    RN_F_NUMBERS(S, centre, RN_REQUIRED, -INFINITY, INFINITY),
    RN_F_NUMBER(S, radius, RN_REQUIRED | RN_OVER_MIN, 0, INFINITY),
    RN_F_NAME(S, source, RN_REQUIRED, rn_bounds_source_names),
};
const struct rn_table rn_bounds_record_table = RN_TABLE(S, "bounds", bounds);
#undef S

#define S struct rn_report_problem
static const struct rn_field_spec report_problem[] = {
    RN_F_NAME(S, severity, RN_REQUIRED, rn_severity_names),
    RN_F_TEXT(S, where, RN_REQUIRED, NULL),
    RN_F_TEXT(S, text, RN_REQUIRED, NULL),
};
static const struct rn_table report_problem_table = RN_TABLE(S, "a problem", report_problem);
#undef S

#define S struct rn_findings
#define NUMBER(m) RN_F_NUMBER(S, m, 0, -INFINITY, INFINITY)
static const struct rn_field_spec findings[] = {
    NUMBER(blurred),
    NUMBER(duplicates),
    NUMBER(looking_away),
    NUMBER(exposure_spread),
    NUMBER(azimuth_gap_deg),
    NUMBER(elevation_min_deg),
    NUMBER(elevation_max_deg),
    NUMBER(reprojection_px),
    NUMBER(reprojection_median_px),
    NUMBER(reprojection_p95_px),
    NUMBER(reprojection_worst_px),
    NUMBER(train_bytes),
};
static const struct rn_table findings_table = RN_TABLE(S, "a survey", findings);
#undef NUMBER
#undef S

#define S struct rn_import_choice
static const struct rn_field_spec choice[] = {
    RN_F_INT(S, max_size, 0, 1, 16384),
    RN_F_INT(S, scales, 0, 1, 8),
    RN_F_TEXT(S, split, 0, rn_check_split_spec),
    RN_F_OBJECT(S, views, RN_REQUIRED, &rn_split_counts_table),
    RN_F_INT(S, width, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, height, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, train_scale, RN_REQUIRED, 1, 16),
    RN_F_NUMBER(S, memory_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, load_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, seconds, RN_REQUIRED, 0, INFINITY),
};
static const struct rn_table choice_table = RN_TABLE(S, "an import's options", choice);
#undef S

#define S struct rn_dataset_report_record
static const struct rn_field_spec report[] = {
    RN_F_TEXT(S, layout, 0, NULL),
    RN_F_OBJECT(S, usable, RN_REQUIRED, &rn_split_counts_table),
    RN_F_OBJECT(S, unusable, RN_REQUIRED, &rn_split_counts_table),
    RN_F_INT(S, scales, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECT(S, bounds, 0, &rn_bounds_record_table),
    RN_F_NAME(S, capture, 0, rn_capture_names),
    RN_F_NUMBERS(S, up, 0, -INFINITY, INFINITY),
    RN_F_OBJECT(S, footprint, 0, &rn_range_table),
    RN_F_OBJECT(S, camera_distance, 0, &rn_range_table),
    RN_F_NUMBER(S, looking_at_bounds, 0, 0, 1),
    RN_F_INT(S, with_alpha, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECT(S, width, RN_REQUIRED, &rn_range_table),
    RN_F_OBJECT(S, height, RN_REQUIRED, &rn_range_table),
    RN_F_OBJECT(S, survey, 0, &findings_table),
    RN_F_OBJECT(S, expected, 0, &rn_expected_table),
    RN_F_OBJECTS(S, choices, choice_count, 0, &choice_table, RN_REPORT_CHOICES_MAX),
    RN_F_INT(S, errors, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, warnings, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, dropped, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECTS(S, problems, problem_count, RN_REQUIRED, &report_problem_table,
                 RN_REPORT_PROBLEMS_MAX),
};
const struct rn_table rn_dataset_report_table = RN_TABLE(S, "a dataset report", report);
#undef S

#define S struct rn_validated_view
static const struct rn_field_spec validated_view[] = {
    RN_F_NAME(S, split, RN_REQUIRED, rn_split_names),
    RN_F_TEXT(S, file, RN_REQUIRED, NULL),
    RN_F_TEXT(S, mask, 0, NULL),
    RN_F_CAMERA(S, camera, RN_REQUIRED),
};
static const struct rn_table validated_view_table = RN_TABLE(S, "a view", validated_view);
#undef S

#define S struct rn_validation_record
static const struct rn_field_spec validation[] = {
    RN_F_JSON(S, report, RN_REQUIRED | RN_IS_OBJECT),
    RN_F_OBJECT(S, bounds, 0, &rn_bounds_record_table),
    RN_F_NUMBERS(S, up, 0, -1.01, 1.01),
    RN_F_OBJECT(S, views, RN_REQUIRED, &rn_split_counts_table),
    RN_F_INT(S, scales, RN_REQUIRED, 1, 16),
    RN_F_OBJECTS(S, items, item_count, RN_REQUIRED, &validated_view_table, RN_VALIDATED_VIEWS),
};
const struct rn_table rn_validation_table = RN_TABLE(S, "a validation", validation);
#undef S

#define S struct rn_dataset_record
#define CONTENTS                                                                                   \
    RN_F_OBJECT(S, views, RN_REQUIRED, &rn_split_counts_table),                                    \
        RN_F_INT(S, scales, RN_REQUIRED, 1, INFINITY),                                             \
        RN_F_INT(S, frames, RN_REQUIRED, 1, INFINITY), RN_F_INT(S, width, RN_REQUIRED, 1, 16384),  \
        RN_F_INT(S, height, RN_REQUIRED, 1, 16384), RN_F_BOOL(S, has_alpha, RN_REQUIRED),          \
        RN_F_OBJECT(S, bounds, RN_REQUIRED, &rn_bounds_record_table),                              \
        RN_F_NAME(S, capture, 0, rn_capture_names), RN_F_NUMBERS(S, up, 0, -1, 1),                 \
        RN_F_NUMBERS(S, crop, 0, -INFINITY, INFINITY),                                             \
        RN_F_OBJECT(S, footprint, RN_REQUIRED, &rn_range_table),                                   \
        RN_F_INT(S, size_bytes, RN_REQUIRED, 0, INFINITY),                                         \
        RN_F_BOOL(S, premultiplied, RN_REQUIRED), RN_F_JSON(S, report, RN_REQUIRED | RN_IS_OBJECT)
static const struct rn_field_spec contents[] = {CONTENTS};
const struct rn_table rn_dataset_contents_table = RN_TABLE(S, "a dataset's contents", contents);
static const struct rn_field_spec dataset[] = {
    RN_F_TEXT(S, id, RN_REQUIRED, NULL),
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
    RN_F_TEXT(S, state, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, past, 0, &rn_expected_past_table),
    CONTENTS,
};
const struct rn_table rn_dataset_table = RN_TABLE(S, "a dataset", dataset);
#undef CONTENTS
#undef S
