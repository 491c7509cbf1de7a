// Datasets: the import request, the record, cameras, the reader's report.
#ifndef RN_PROTO_DATASET_H
#define RN_PROTO_DATASET_H

#include "common/dataset/dataset.h"
#include "proto/codec.h"
#include "proto/names.h"

extern const char *const rn_alpha_mode_names[]; // "premultiplied", "straight"
extern const char *const rn_poses_names[];      // by enum rn_poses
extern const char *const rn_severity_names[];   // "info", "warning", "error"

// Where poses come from: found by a program where no document has them, always found, or only from
// a document.
enum rn_poses { RN_POSES_AUTO, RN_POSES_FIND, RN_POSES_FILE };

struct rn_ingest_options {
    int64_t max_size, scales;
    int alpha;                       // rn_alpha_mode_names
    char split[16];                  // "files" or "every:N"
    char bounds[128];                // "X,Y,Z,RADIUS" of the sphere that holds the scene
    char format[RN_FORMAT_NAME_MAX]; // of rn_formats; "": recognised
    char masks[256];                 // folder of masks, relative; "": "masks", if it is there
    int poses;                       // rn_poses_names; absent: file
};
extern const struct rn_table rn_ingest_options_table;
// N of "every:N"; 0 for "files" and "". The text was checked by the table.
int rn_ingest_split_every(const char *split);
// The sphere of "X,Y,Z,RADIUS", each finite and the radius above 0; false, and nothing set, for any
// other text, such as "".
bool rn_ingest_bounds(const char *bounds, double ret_centre[3], double *ret_radius);

// POST /v1/datasets with application/json.
struct rn_dataset_request {
    char name[RN_NAME_MAX];
    char *directory; // owned
    struct rn_ingest_options options;
};
extern const struct rn_table rn_dataset_request_table;

struct rn_range {
    double min, max;
};
extern const struct rn_table rn_range_table;
struct rn_split_counts {
    int64_t train, val, test;
};
extern const struct rn_table rn_split_counts_table;
struct rn_bounds_record {
    double centre[3], radius;
    int source; // rn_bounds_source_names
};
extern const struct rn_table rn_bounds_record_table;

struct rn_report_problem {
    int severity; // rn_severity_names
    char where[256], text[384];
};
struct rn_dataset_report_record {
    char layout[RN_FORMAT_NAME_MAX];
    struct rn_split_counts usable, unusable;
    int64_t scales;
    struct rn_range footprint, camera_distance;
    double looking_at_bounds;
    int64_t with_alpha;
    struct rn_range width, height;
    int64_t errors, warnings, dropped;
    struct rn_report_problem *problems; // owned
    size_t problem_count;               // <= RN_REPORT_PROBLEMS_MAX
};
#define RN_REPORT_PROBLEMS_MAX 1000
extern const struct rn_table rn_dataset_report_table;

// Two tables over one struct: rn_dataset_contents_table is what an import finds out (all but id,
// name, created_at, state: the result of the runner's ingest job); rn_dataset_table is the whole
// resource. The daemon decodes the first, fills in the rest and encodes the second.
struct rn_dataset_record {
    char id[RN_ID_MAX], name[RN_NAME_MAX], created_at[RN_TIME_MAX];
    char state[8]; // "ready"
    struct rn_split_counts views;
    int64_t scales, frames, width, height;
    bool has_alpha;
    struct rn_bounds_record bounds;
    struct rn_range footprint;
    int64_t size_bytes;
    bool premultiplied;
    char *report; // JSON of a DatasetReport, owned
};
extern const struct rn_table rn_dataset_contents_table;
extern const struct rn_table rn_dataset_table;

#endif
