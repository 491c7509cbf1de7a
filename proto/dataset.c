#include "proto/dataset.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "proto/checks.h"

const char *const rn_alpha_mode_names[] = {"premultiplied", "straight", NULL};
const char *const rn_poses_names[] = {"auto", "find", "file", NULL};
const char *const rn_severity_names[] = {"info", "warning", "error", NULL};

#define S struct rn_ingest_options
static const struct rn_field_spec ingest_options[] = {
    RN_F_INT(S, max_size, 0, 0, 16384),          RN_F_INT(S, scales, 0, 1, 8),
    RN_F_NAME(S, alpha, 0, rn_alpha_mode_names), RN_F_TEXT(S, split, 0, rn_check_split_spec),
    RN_F_TEXT(S, bounds, 0, rn_check_bounds),    RN_F_TEXT(S, format, 0, rn_check_format),
    RN_F_TEXT(S, masks, 0, rn_check_inner_path), RN_F_NAME(S, poses, 0, rn_poses_names),
};
const struct rn_table rn_ingest_options_table = RN_TABLE(S, "import options", ingest_options);
#undef S

int rn_ingest_split_every(const char *split) {
    const char *colon = strchr(split, ':');
    return colon ? atoi(colon + 1) : 0;
}

bool rn_ingest_bounds(const char *bounds, double ret_centre[3], double *ret_radius) {
    double numbers[4];
    for (int i = 0; i < 4; i++) {
        char *end;
        numbers[i] = strtod(bounds, &end);
        if (end == bounds || *end != (i < 3 ? ',' : '\0') || !isfinite(numbers[i])) return false;
        bounds = end + 1;
    }
    if (!(numbers[3] > 0)) return false;
    memcpy(ret_centre, numbers, 3 * sizeof *numbers);
    *ret_radius = numbers[3];
    return true;
}

static const char *check_directory(const char *text) {
    return *text == '/' ? NULL : "must be an absolute path";
}

#define S struct rn_dataset_request
static const struct rn_field_spec dataset_request[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, rn_check_name),
    {.name = "directory",
     .type = RN_TYPE_STRING,
     .flags = RN_REQUIRED,
     .offset = offsetof(S, directory),
     .max = 4095,
     .check = check_directory},
    RN_F_OBJECT(S, options, 0, &rn_ingest_options_table),
};
const struct rn_table rn_dataset_request_table = RN_TABLE(S, "a dataset request", dataset_request);
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

#define S struct rn_dataset_report_record
static const struct rn_field_spec report[] = {
    RN_F_TEXT(S, layout, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, usable, RN_REQUIRED, &rn_split_counts_table),
    RN_F_OBJECT(S, unusable, RN_REQUIRED, &rn_split_counts_table),
    RN_F_INT(S, scales, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECT(S, footprint, RN_REQUIRED, &rn_range_table),
    RN_F_OBJECT(S, camera_distance, RN_REQUIRED, &rn_range_table),
    RN_F_NUMBER(S, looking_at_bounds, RN_REQUIRED, 0, 1),
    RN_F_INT(S, with_alpha, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECT(S, width, RN_REQUIRED, &rn_range_table),
    RN_F_OBJECT(S, height, RN_REQUIRED, &rn_range_table),
    RN_F_INT(S, errors, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, warnings, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, dropped, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECTS(S, problems, problem_count, RN_REQUIRED, &report_problem_table,
                 RN_REPORT_PROBLEMS_MAX),
};
const struct rn_table rn_dataset_report_table = RN_TABLE(S, "a dataset report", report);
#undef S

#define S struct rn_dataset_record
#define CONTENTS                                                                                   \
    RN_F_OBJECT(S, views, RN_REQUIRED, &rn_split_counts_table),                                    \
        RN_F_INT(S, scales, RN_REQUIRED, 1, INFINITY),                                             \
        RN_F_INT(S, frames, RN_REQUIRED, 1, INFINITY), RN_F_INT(S, width, RN_REQUIRED, 1, 16384),  \
        RN_F_INT(S, height, RN_REQUIRED, 1, 16384), RN_F_BOOL(S, has_alpha, RN_REQUIRED),          \
        RN_F_OBJECT(S, bounds, RN_REQUIRED, &rn_bounds_record_table),                              \
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
    CONTENTS,
};
const struct rn_table rn_dataset_table = RN_TABLE(S, "a dataset", dataset);
#undef CONTENTS
#undef S
