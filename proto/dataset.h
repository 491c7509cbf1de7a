// Datasets: the import request, the record, cameras, the reader's report.
#ifndef RN_PROTO_DATASET_H
#define RN_PROTO_DATASET_H

#include "common/dataset/survey.h"
#include "proto/codec.h"
#include "proto/estimate.h"
#include "proto/names.h"

extern const char *const rn_poses_names[];    // by enum rn_poses
extern const char *const rn_backdrop_names[]; // "cut", "keep"
extern const char *const rn_severity_names[]; // "info", "warning", "error"

// Where poses come from: found by a program where no document has them, always found, or only from
// a document.
enum rn_poses { RN_POSES_AUTO, RN_POSES_FIND, RN_POSES_FILE };

struct rn_ingest_options {
    int64_t max_size, scales;
    int alpha;                       // rn_downscale_names
    char split[16];                  // "files" or "every:N"
    char bounds[128];                // "X,Y,Z,RADIUS" of the sphere that holds the scene
    char up[96];                     // "X,Y,Z", or an axis: "z", "-y"; "": by the cameras or GPS
    char crop[192];                  // "X0,Y0,Z0,X1,Y1,Z1" of the box that matters
    char format[RN_FORMAT_NAME_MAX]; // of rn_formats; "": recognised
    char masks[256];                 // folder of masks, relative; "": "masks", if it is there
    int poses;                       // rn_poses_names; absent: file
    int backdrop;                    // rn_backdrop_names; absent: cut
};
extern const struct rn_table rn_ingest_options_table;
// N of "every:N"; 0 for "files" and "". The text was checked by the table.
int rn_ingest_split_every(const char *split);
// What a text says; false, and nothing set, for any other text, such as "". All numbers are finite;
// a sphere's radius is above 0, a direction has a length, a box has a volume.
bool rn_ingest_bounds(const char *bounds, double ret_centre[3], double *ret_radius);
bool rn_ingest_up(const char *up, double ret_up[3]);
bool rn_ingest_crop(const char *crop, struct rn_box *ret_crop);
// How the source is to be read; valid while `options` is.
struct rn_read_options rn_ingest_reading(const struct rn_ingest_options *options);
// How it is to be kept, on no threads and looked at by no survey yet.
struct rn_import_options rn_ingest_keeping(const struct rn_ingest_options *options);

// POST /v1/datasets with application/json: exactly one of directory and upload.
struct rn_dataset_request {
    char name[RN_NAME_MAX];
    char *directory;        // owned
    char upload[RN_ID_MAX]; // of a tar that is whole
    struct rn_ingest_options options;
};
extern const struct rn_table rn_dataset_request_table;

// POST /v1/uploads, and the record.
struct rn_upload_request {
    int64_t size_bytes;     // of the tar
    char name[RN_NAME_MAX]; // of the dataset that it is for; "": not said
};
extern const struct rn_table rn_upload_request_table;
struct rn_upload_record {
    char id[RN_ID_MAX];
    int64_t size_bytes, offset; // offset: bytes that are there
};
extern const struct rn_table rn_upload_table;

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
    char where[256], text[512];
};
// What an import by some options would keep, and what a training with `standard` takes of that.
struct rn_import_choice {
    int64_t max_size, scales; // absent: as the files are
    char split[24];           // "": the files'
    struct rn_split_counts views;
    int64_t width, height; // of the largest photograph
    int64_t train_scale;   // times that training makes photographs smaller
    double memory_bytes, load_seconds, seconds;
};
struct rn_dataset_report_record {
    char layout[RN_FORMAT_NAME_MAX]; // absent, as footprint, camera_distance and looking_at_bounds,
                                     // where there are no poses
    struct rn_split_counts usable, unusable;
    int64_t scales;
    struct rn_bounds_record bounds; // absent in reports of before they were told, as the next two
    int capture;                    // rn_capture_names
    double up[3];
    struct rn_range footprint, camera_distance;
    double looking_at_bounds;
    int64_t with_alpha;
    struct rn_range width, height;
    struct rn_findings survey;   // of the photographs; absent where they were not looked at
    struct rn_expected expected; // of a training; absent with it
    struct rn_import_choice
        *choices;        // owned; the first is what was asked for. None after an import
    size_t choice_count; // <= RN_REPORT_CHOICES_MAX
    int64_t errors, warnings, dropped;
    struct rn_report_problem *problems; // owned
    size_t problem_count;               // <= RN_REPORT_PROBLEMS_MAX
};
#define RN_REPORT_PROBLEMS_MAX 1000
#define RN_REPORT_CHOICES_MAX 8
extern const struct rn_table rn_dataset_report_table;

// What a `validate` job results in: the report, and each view as it would be kept.
struct rn_validated_view {
    int split;                 // rn_split_names; with the split that was asked for
    char file[256], mask[256]; // under the folder; mask "": none
    struct rn_camera camera;   // of the size that was asked for
};
struct rn_validation_record {
    char *report;                   // JSON of a DatasetReport, owned
    struct rn_bounds_record bounds; // absent, as up is, where there are no poses
    double up[3];
    struct rn_split_counts views;    // all of them
    int64_t scales;                  // images that would be kept of each
    struct rn_validated_view *items; // owned; evenly spaced where there are more
    size_t item_count;
};
#define RN_VALIDATED_VIEWS 512
extern const struct rn_table rn_validation_table;

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
    int capture; // rn_capture_names; absent in datasets of before it was found out, as the next two
    double up[3];
    double crop[6]; // its low corner, then its high one; absent: none
    struct rn_range footprint;
    int64_t size_bytes;
    bool premultiplied;
    char *report; // JSON of a DatasetReport, owned
    struct rn_expected_past
        past; // of trainings here; of the resource alone; absent: there are none
};
extern const struct rn_table rn_dataset_contents_table;
extern const struct rn_table rn_dataset_table;

#endif
