#include "proto/doctor.h"

#include "proto/incident.h"

#define CASES_MOST 256
#define CAMERAS_MOST 1000000

#define S struct rn_doctor_case_record
static const struct rn_field_spec case_fields[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_NUMBER(S, worst, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, bound, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_TEXT(S, unit, RN_REQUIRED, NULL),
    RN_F_BOOL(S, passed, RN_REQUIRED),
    RN_F_BOOL(S, skipped, RN_REQUIRED),
    RN_F_TEXT(S, where, RN_REQUIRED, NULL),
};
static const struct rn_table case_table = RN_TABLE(S, "case", case_fields);
#undef S

#define S struct rn_doctor_record
static const struct rn_field_spec doctor[] = {
    RN_F_BOOL(S, passed, RN_REQUIRED),
    RN_F_INT(S, seed, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_OBJECTS(S, cases, case_count, RN_REQUIRED, &case_table, CASES_MOST),
};
const struct rn_table rn_doctor_table = RN_TABLE(S, "doctor", doctor);
#undef S

#define S struct rn_doctor_job_options
static const struct rn_field_spec job_options[] = {
    RN_F_INT(S, seed, 0, 0, 9007199254740991.0),
    RN_F_TEXT(S, incident, 0, rn_check_incident_file),
};
const struct rn_table rn_doctor_job_options_table = RN_TABLE(S, "doctor options", job_options);
#undef S

#define S struct rn_camera_list_record
static const struct rn_field_spec camera_list[] = {
    RN_F_OBJECTS(S, items, item_count, RN_REQUIRED, &rn_dataset_camera_table, CAMERAS_MOST),
};
const struct rn_table rn_camera_list_table = RN_TABLE(S, "cameras", camera_list);
#undef S
