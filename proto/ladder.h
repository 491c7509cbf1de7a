// What a ladder has found so far: jobs/ID/ladder.json, and GET /v1/jobs/{id}/report.
#ifndef RN_PROTO_LADDER_H
#define RN_PROTO_LADDER_H

#include "proto/job.h"

enum rn_cell_state {
    RN_CELL_WAITING,
    RN_CELL_TRAINING,
    RN_CELL_EVALUATING,
    RN_CELL_DONE, // this and the next: over
    RN_CELL_FAILED,
    RN_CELL_CANCELLED,
};
extern const char *const rn_cell_state_names[]; // "waiting", "training", ...

// What the views looked like at a time on the way; NAN before they were looked at.
struct rn_ladder_moment {
    double train_seconds;
    int64_t step;
    double psnr, ssim;
};

// One training: an arm with a seed.
struct rn_ladder_cell {
    char label[160]; // of its arm
    int64_t arm, seed;
    int state; // enum rn_cell_state
    char scene[RN_NAME_MAX];
    char train_job[RN_ID_MAX], eval_job[RN_ID_MAX]; // the last one; "" = absent
    int64_t steps;
    double train_seconds, held_out;      // NAN = absent, as the next ones
    int64_t memory_bytes;                // of its runner, training
    int64_t disk_bytes, field_bytes;     // of a checkpoint; of one without the optimiser
    double psnr, ssim, render_ms;        // means over views and scales; a median
    double one_cone_psnr, one_cone_ssim; // the same pictures with one cone a pixel
    double one_cone_render_ms;
    struct rn_scale_score *scales; // owned
    size_t scale_count;
    struct rn_ladder_moment *moments; // owned, by time
    size_t moment_count;
    char problem[256]; // why it failed; "" = absent
};

struct rn_ladder_record {
    char job[RN_ID_MAX], dataset[RN_ID_MAX], dataset_name[RN_NAME_MAX];
    char created_at[RN_TIME_MAX], kernels[32], version[32];
    char machine[1024]; // or several, in the order in which they came
    int64_t threads;
    struct rn_ladder_options options;
    struct rn_protocol protocol;  // of the evaluations; step absent before the first
    int64_t views;                // of an evaluation; absent before the first
    struct rn_ladder_cell *cells; // owned
    size_t count;
};
extern const struct rn_table rn_ladder_record_table;

// Reads jobs/ID/ladder.json of a job's folder; the caller finishes it with rn_message_finish.
// RN_ERROR_NOT_FOUND: nothing was written yet.
enum rn_status rn_ladder_read(const char *job_folder, struct rn_ladder_record *ret_record,
                              struct rn_error *err) RN_MUST_CHECK;
// Replaces it, durably.
enum rn_status rn_ladder_write(const char *job_folder, const struct rn_ladder_record *record,
                               struct rn_error *err) RN_MUST_CHECK;

static inline bool rn_cell_is_over(const struct rn_ladder_cell *cell) {
    return cell->state >= RN_CELL_DONE;
}

// ---- the report -------------------------------------------------------------------------------

// Of the seeds that are done; `count` 0: of none, and the rest is NAN.
struct rn_ladder_figure {
    double mean, low, high;
    int64_t count;
};

struct rn_ladder_arm_scale {
    int64_t scale;
    struct rn_ladder_figure psnr, ssim;
};

// An arm over its seeds. The margin is over the first arm's PSNR, in pairs of one seed.
struct rn_ladder_arm_record {
    char label[160];
    struct rn_ladder_figure psnr, margin, ssim, render_ms, train_seconds, steps, memory_bytes,
        disk_bytes, field_bytes, one_cone_psnr, one_cone_ssim, one_cone_render_ms;
    struct rn_ladder_arm_scale *scales; // owned
    size_t scale_count;
};

// What the paper publishes of a scene of its own.
struct rn_paper_figure {
    char what[96]; // "10 planes, rip; four scales; 25,000 steps"
    int64_t steps;
    double minutes; // of an A100; NAN: not published
    double psnr;
};

struct rn_ladder_report {
    struct rn_ladder_record ladder;
    struct rn_ladder_arm_record *arms; // owned, as the next one
    size_t arm_count;
    struct rn_paper_figure *paper;
    size_t paper_count;
};
extern const struct rn_table rn_ladder_report_table;

// What is left in the job's record.
struct rn_ladder_result {
    int64_t trainings, failed, arms;
    double train_seconds; // of all
};
extern const struct rn_table rn_ladder_result_table;

#endif
