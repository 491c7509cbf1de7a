#include "proto/ladder.h"

#include <stdlib.h>

#include "proto/folder.h"
#include "proto/marks.h"

#define MAX_SCALES 16

const char *const rn_cell_state_names[] = {"waiting", "training",  "evaluating", "done",
                                           "failed",  "cancelled", NULL};

#define S struct rn_ladder_moment
static const struct rn_field_spec moment[] = {
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, ssim, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
};
static const struct rn_table moment_table = RN_TABLE(S, "a moment", moment);
#undef S

#define S struct rn_ladder_cell
static const struct rn_field_spec cell[] = {
    RN_F_TEXT(S, label, RN_REQUIRED, NULL),
    RN_F_INT(S, arm, RN_REQUIRED, 0, RN_LADDER_ARMS - 1),
    RN_F_INT(S, seed, RN_REQUIRED, 0, INFINITY),
    RN_F_NAME(S, state, RN_REQUIRED, rn_cell_state_names),
    RN_F_TEXT(S, scene, RN_REQUIRED, NULL),
    RN_F_TEXT(S, train_job, 0, NULL),
    RN_F_TEXT(S, eval_job, 0, NULL),
    RN_F_INT(S, steps, 0, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, 0, 0, INFINITY),
    RN_F_NUMBER(S, held_out, 0, -INFINITY, INFINITY),
    RN_F_INT(S, memory_bytes, 0, 0, INFINITY),
    RN_F_INT(S, disk_bytes, 0, 0, INFINITY),
    RN_F_INT(S, field_bytes, 0, 0, INFINITY),
    RN_F_NUMBER(S, psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, ssim, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, render_ms, 0, 0, INFINITY),
    RN_F_NUMBER(S, one_cone_psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, one_cone_ssim, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, one_cone_render_ms, 0, 0, INFINITY),
    RN_F_OBJECTS(S, scales, scale_count, 0, &rn_scale_score_table, MAX_SCALES),
    RN_F_OBJECTS(S, moments, moment_count, 0, &moment_table, RN_MARKS_KEPT),
    RN_F_TEXT(S, problem, 0, NULL),
};
static const struct rn_table cell_table = RN_TABLE(S, "a cell", cell);
#undef S

#define S struct rn_ladder_record
static const struct rn_field_spec ladder[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_TEXT(S, dataset, RN_REQUIRED, NULL),
    RN_F_TEXT(S, dataset_name, RN_REQUIRED, NULL),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
    RN_F_TEXT(S, machine, 0, NULL),
    RN_F_TEXT(S, kernels, 0, NULL),
    RN_F_TEXT(S, version, 0, NULL),
    RN_F_INT(S, threads, 0, 0, 1024),
    RN_F_OBJECT(S, options, RN_REQUIRED, &rn_ladder_options_table),
    RN_F_OBJECT(S, protocol, 0, &rn_protocol_table),
    RN_F_INT(S, views, 0, 0, INFINITY),
    RN_F_OBJECTS(S, cells, count, RN_REQUIRED, &cell_table, RN_LADDER_TRAININGS),
};
const struct rn_table rn_ladder_record_table = RN_TABLE(S, "a ladder's record", ladder);
#undef S

#define S struct rn_ladder_figure
static const struct rn_field_spec figure[] = {
    RN_F_NUMBER(S, mean, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, low, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, high, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_INT(S, count, RN_REQUIRED, 0, INFINITY),
};
static const struct rn_table figure_table = RN_TABLE(S, "a figure", figure);
#undef S

#define S struct rn_ladder_arm_scale
static const struct rn_field_spec arm_scale[] = {
    RN_F_INT(S, scale, RN_REQUIRED, 0, 64),
    RN_F_OBJECT(S, psnr, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, ssim, RN_REQUIRED, &figure_table),
};
static const struct rn_table arm_scale_table = RN_TABLE(S, "an arm's scale", arm_scale);
#undef S

#define S struct rn_ladder_arm_record
static const struct rn_field_spec arm[] = {
    RN_F_TEXT(S, label, RN_REQUIRED, NULL),
    RN_F_OBJECT(S, psnr, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, margin, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, ssim, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, render_ms, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, train_seconds, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, steps, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, memory_bytes, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, disk_bytes, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, field_bytes, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, one_cone_psnr, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, one_cone_ssim, RN_REQUIRED, &figure_table),
    RN_F_OBJECT(S, one_cone_render_ms, RN_REQUIRED, &figure_table),
    RN_F_OBJECTS(S, scales, scale_count, RN_REQUIRED, &arm_scale_table, MAX_SCALES),
};
static const struct rn_table arm_table = RN_TABLE(S, "an arm", arm);
#undef S

#define S struct rn_paper_figure
static const struct rn_field_spec paper[] = {
    RN_F_TEXT(S, what, RN_REQUIRED, NULL),
    RN_F_INT(S, steps, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, minutes, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED, 0, INFINITY),
};
static const struct rn_table paper_table = RN_TABLE(S, "a published figure", paper);
#undef S

#define S struct rn_ladder_report
static const struct rn_field_spec report[] = {
    RN_F_OBJECT(S, ladder, RN_REQUIRED, &rn_ladder_record_table),
    RN_F_OBJECTS(S, arms, arm_count, RN_REQUIRED, &arm_table, RN_LADDER_ARMS),
    RN_F_OBJECTS(S, paper, paper_count, RN_REQUIRED, &paper_table, 32),
};
const struct rn_table rn_ladder_report_table = RN_TABLE(S, "a ladder's report", report);
#undef S

#define S struct rn_ladder_result
static const struct rn_field_spec result[] = {
    RN_F_INT(S, trainings, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, failed, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, arms, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
};
const struct rn_table rn_ladder_result_table = RN_TABLE(S, "ladder result", result);
#undef S

#define FILE_NAME "ladder.json"

enum rn_status rn_ladder_read(const char *job_folder, struct rn_ladder_record *ret_record,
                              struct rn_error *err) {
    return rn_folder_read(job_folder, FILE_NAME, &rn_ladder_record_table, ret_record, err);
}

enum rn_status rn_ladder_write(const char *job_folder, const struct rn_ladder_record *record,
                               struct rn_error *err) {
    char *json = NULL;
    enum rn_status status = rn_encode(&rn_ladder_record_table, record, &json, NULL, err);
    if (status == RN_OK) status = rn_folder_write(job_folder, FILE_NAME, json, err);
    free(json);
    return status;
}
