#include "proto/estimate.h"

#define S struct rn_calibration
static const struct rn_field_spec calibration[] = {
    RN_F_NUMBERS(S, seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBERS(S, psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, whole_seconds, 0, 0, INFINITY),
    RN_F_NUMBER(S, step_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, turn_seconds, 0, 0, INFINITY),
    RN_F_NUMBER(S, load_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, spent_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, max_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, max_steps, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, memory_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, disk_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, device, RN_REQUIRED, NULL),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_INT(S, threads, RN_REQUIRED, 1, 1024),
};
const struct rn_table rn_calibration_table = RN_TABLE(S, "a calibration", calibration);
#undef S

#define S struct rn_estimate_passing
static const struct rn_field_spec passing[] = {
    RN_F_NUMBER(S, psnr, RN_REQUIRED, -INFINITY, INFINITY),
    RN_F_NUMBER(S, seconds, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, reached, 0, 0, INFINITY),
};
static const struct rn_table passing_table = RN_TABLE(S, "when a PSNR is passed", passing);
#undef S

#define S struct rn_estimate_past
static const struct rn_field_spec past[] = {
    RN_F_INT(S, estimates, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr_off, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, seconds_off, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
};
static const struct rn_table past_table = RN_TABLE(S, "past estimates", past);
#undef S

#define S struct rn_estimate
static const struct rn_field_spec estimate[] = {
    RN_F_NUMBER(S, seconds, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, psnr_spread, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_OBJECTS(S, passings, passing_count, RN_REQUIRED, &passing_table, RN_ESTIMATE_PASSINGS),
    RN_F_NUMBER(S, load_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, memory_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, disk_bytes, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECT(S, past, RN_REQUIRED, &past_table),
    RN_F_OBJECT(S, calibration, RN_REQUIRED, &rn_calibration_table),
};
const struct rn_table rn_estimate_table = RN_TABLE(S, "an estimate", estimate);
#undef S

#define S struct rn_expected
static const struct rn_field_spec expected[] = {
    RN_F_NUMBER(S, seconds, 0, 0, INFINITY),
    RN_F_NUMBER(S, memory_bytes, 0, 0, INFINITY),
};
const struct rn_table rn_expected_table = RN_TABLE(S, "what is expected", expected);
#undef S

#define S struct rn_expected_past
static const struct rn_field_spec expected_past[] = {
    RN_F_INT(S, trainings, 0, 1, INFINITY),
    RN_F_NUMBER(S, seconds, 0, 0, INFINITY),
    RN_F_NUMBER(S, memory_bytes, 0, 0, INFINITY),
};
const struct rn_table rn_expected_past_table = RN_TABLE(S, "what was seen", expected_past);
#undef S

#define S struct rn_estimate_check
static const struct rn_field_spec check[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_NUMBER(S, seconds, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_OBJECTS(S, passings, passing_count, RN_REQUIRED, &passing_table, RN_ESTIMATE_PASSINGS),
};
const struct rn_table rn_estimate_check_table = RN_TABLE(S, "an estimate and its truth", check);
#undef S
