// What `ripnerf doctor --json` prints, and what a `doctor` job results in: cases, their numbers and
// bounds.
#ifndef RN_PROTO_DOCTOR_H
#define RN_PROTO_DOCTOR_H

#include <stdbool.h>

#include "proto/camera.h"

// As struct rn_doctor_case.
struct rn_doctor_case_record {
    char name[64], kernels[32]; // kernels "" = none in particular
    double worst;               // NAN (null): not a number
    double bound;               // NAN (null): shown for information
    char unit[40];
    bool passed, skipped;
    char where[160];
};

struct rn_doctor_record {
    bool passed;
    int64_t seed;
    char kernels[128];
    struct rn_doctor_case_record *cases; // owned
    size_t case_count;
};
extern const struct rn_table rn_doctor_table;

// The options of a `doctor` job, which examines a scene as `ripnerf doctor SCENE` does; its result
// is JSON of rn_doctor_table.
struct rn_doctor_job_options {
    int64_t seed;      // of the random inputs; absent: a fresh one
    char incident[64]; // a record to replay, as IncidentEvent.file names it; "": none
};
extern const struct rn_table rn_doctor_job_options_table;

// A list of cameras as GET /v1/datasets/{id}/cameras gives it.
struct rn_camera_list_record {
    struct rn_dataset_camera *items; // owned
    size_t item_count;
};
extern const struct rn_table rn_camera_list_table;

#endif
