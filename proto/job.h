// Jobs: requests, options, progress, results, the resource.
//
// The daemon keeps options, progress and results as JSON text and passes them on; the structs are
// for whoever makes or reads them: requests in the daemon, work in the runner, tables in the
// client.
#ifndef RN_PROTO_JOB_H
#define RN_PROTO_JOB_H

#include "common/base/trace.h"
#include "common/settings/ladder.h"
#include "common/settings/render.h"
#include "common/settings/train.h"
#include "proto/codec.h"
#include "proto/curve.h"
#include "proto/dataset.h"
#include "proto/doctor.h"
#include "proto/effects.h"
#include "proto/estimate.h"
#include "proto/export.h"
#include "proto/names.h"
#include "proto/render.h"

// ---- options: what the user asked for; absent = decided by preset and data ----

struct rn_train_options {
    int preset; // rn_preset_names: "draft", "standard", "paper"
    // Those that have no option are in an object of their own, by their names in records.
    union rn_setting_value settings[RN_TRAIN_SETTINGS];
    int64_t threads, ranks; // ranks: runners that train it together, on nodes of a cluster
    char device[16], kernels[32];
    double checkpoint_interval_s, evaluate_interval_s;
};
extern const struct rn_table rn_train_options_table;

struct rn_path_options {
    int64_t width, height, first, last;
    int output; // enum rn_output_kind
    double fps;
    int film;                        // rn_film_names; absent: frames alone
    int64_t video_quality;           // 0 .. 100
    int format;                      // of a frame: enum rn_picture_format
    int64_t jpeg_quality;            // 1 .. 100
    double crop[6];                  // as of a render request
    struct rn_optics_request optics; // in place of what the path's keys say
    union rn_setting_value settings[RN_RENDER_SETTINGS];
};
extern const struct rn_table rn_path_options_table;
extern const char *const rn_film_names[]; // "h264", "av1", "vp9", "gif"

struct rn_eval_options {
    int split;            // rn_split_names
    int64_t views, scale; // views 0 = all; scale absent = all
    double at;            // as of a render request
    union rn_setting_value settings[RN_RENDER_SETTINGS];
};
extern const struct rn_table rn_eval_options_table;

// A table of trainings that differ in what `over` varies (common/settings/ladder.h), each with the
// same seeds, and evaluated.
struct rn_ladder_options {
    char over[RN_LADDER_TEXT];
    int equal;              // rn_ladder_equal_names
    int64_t seeds;          // of each arm
    int split;              // of the views evaluated, rn_split_names
    int64_t views, moments; // these; times on the way at which they are too
    int one_cone;           // whether also with one cone a pixel; -1 = absent
    int keep;               // whether the scenes stay; -1 = absent
    struct rn_train_options train;
};
extern const struct rn_table rn_ladder_options_table;
#define RN_LADDER_SEEDS 3 // where the request does not say
#define RN_LADDER_VIEWS 20
#define RN_LADDER_MOMENTS 3
// Its arms; their seeds are not set. As rn_ladder_plan, err->where points into the request's
// options: "over" or "train/...". RN_ERROR_LIMIT: more than RN_LADDER_TRAININGS with all seeds.
enum rn_status rn_ladder_options_plan(const struct rn_ladder_options *options,
                                      struct rn_ladder_plan *ret_plan,
                                      struct rn_error *err) RN_MUST_CHECK;

// ---- POST /v1/jobs ----

// Which members count depends on the type: train {dataset, scene, train}, path {scene, path or
// camera_path, path_options}, eval {scene, eval}, curve {scene, curve}, estimate {dataset, train},
// effects {scene, effects}, export {scene, export_options}, ladder {dataset, ladder}, doctor
// {scene, doctor}, validate {upload, ingest}.
struct rn_job_request {
    int type; // enum rn_job_type
    char dataset[RN_NAME_MAX], scene[RN_NAME_MAX], path[RN_NAME_MAX];
    struct rn_path_document camera_path;
    struct rn_train_options train;
    struct rn_path_options path_options;
    struct rn_eval_options eval;
    struct rn_curve_options curve;
    struct rn_effects_options effects;
    struct rn_export_options export_options;
    struct rn_ladder_options ladder;
    struct rn_doctor_job_options doctor;
    char upload[RN_ID_MAX];
    struct rn_ingest_options ingest;
};
// As rn_decode; also checks what the table cannot (exactly one of path and camera_path, ...).
enum rn_status rn_job_request_decode(const char *json, size_t size,
                                     struct rn_job_request *ret_request,
                                     struct rn_field_errors *errors,
                                     struct rn_error *err) RN_MUST_CHECK;
void rn_job_request_finish(struct rn_job_request *request);
// The options of the request's type as JSON: what a job keeps and shows.
enum rn_status rn_job_request_options(const struct rn_job_request *request, char **ret_json,
                                      struct rn_error *err) RN_MUST_CHECK;

// ---- progress ----

struct rn_nonfinite {
    int64_t rays, steps_rejected, rollbacks;
};
struct rn_train_progress {
    int64_t step, max_steps;
    double train_seconds, max_seconds, load_seconds, evaluate_seconds, paused_seconds,
        yielded_seconds;
    double loss; // NAN = null, as psnr, eta_seconds, fraction
    double rays_per_second, samples_per_second;
    int64_t samples;
    int64_t level_samples[16];
    size_t level_count;
    double psnr;
    int64_t psnr_step;
    struct rn_nonfinite nonfinite;
    double eta_seconds, fraction;
    bool evaluating_first, evaluating;
    char fell_back[256]; // a damaged checkpoint that was passed over; "" = absent
    char stage[32];      // what comes before the first step; "" = absent: it trains
};
extern const struct rn_table rn_train_progress_table;

struct rn_work_progress { // ingest, path, eval
    int64_t done, total;
    struct rn_nonfinite
        nonfinite; // rays of pictures that had to be replaced; the rest is training's
    double fraction, eta_seconds;
    char stage[32]; // what is being done, where there is more than one thing; "": not said
};
extern const struct rn_table rn_work_progress_table;

struct rn_metric_event {
    int64_t step;
    double train_seconds, psnr;
};
extern const struct rn_table rn_metric_event_table;

// ---- results ----

struct rn_train_result {
    int64_t steps;
    double train_seconds;
    int64_t samples;
    double psnr;
    int64_t psnr_step; // that it is of: earlier where withheld views were trained on after it
    char parameters_sha256[65];
    int finished_by;                   // enum rn_finished_by
    char fell_back[256];               // as in rn_train_progress
    struct rn_estimate_check estimate; // absent: none was made of it
    char machine[192];                 // that it ended on
};
extern const struct rn_table rn_train_result_table;

struct rn_path_result {
    int64_t frames, width, height, step;
    double render_ms_median;
    char effects[96]; // of the camera, that were on in any frame; "" = absent
    char setting[96]; // what its budget became, rn_curve_setting_text; "" = absent: it had none
    double expected_psnr, expected_spread; // of it, by the curve; NAN = absent
    char film[16];                         // "film.mp4"; "" = absent
    int64_t film_bytes;                    // absent with it
};
extern const struct rn_table rn_path_result_table;

struct rn_scale_score {
    int64_t scale;
    double psnr, ssim, render_ms; // the last a median
};
extern const struct rn_table rn_scale_score_table;
struct rn_view_result {
    char name[256];
    int64_t index, scale;
    double psnr, ssim, render_ms, psnr_fitted;
    double lpips;       // NAN: not measured
    double depth_error; // median, relative, at sparse points; NAN without any
};
struct rn_protocol {
    int split; // rn_split_names
    double background[3];
    int downscale; // rn_downscale_names
    char rounding[64];
    int64_t seed;
    int train_split; // rn_train_split_names
    int64_t step;
    char version[32], device[16], kernels[32];
    int64_t threads;
    char machine[192];
};
extern const struct rn_table rn_protocol_table;
struct rn_eval_result {
    double psnr, ssim;  // mean over views, then over scales; NAN psnr = identical pictures
    double psnr_fitted; // mean over all, each with its own exposure fitted; NAN: nothing was
    double lpips;       // mean over all that have one; NAN: none has
    double depth_error; // median over the views that have one; NAN: none has
    int64_t views;
    double psnr_spread, ssim_spread;
    struct rn_scale_score *scales; // owned
    size_t scale_count;
    struct rn_view_result *per_view; // owned
    size_t view_count;
    double render_ms_median;
    char setting[96]; // as in rn_path_result
    struct rn_protocol protocol;
};
extern const struct rn_table rn_view_result_table;
extern const struct rn_table rn_eval_result_table;

struct rn_ingest_result { // what came into being, one of the two
    char dataset[RN_ID_MAX], scene[RN_ID_MAX];
};
extern const struct rn_table rn_ingest_result_table;

// ---- the resource ----

// Where a job runs, or why it waits, when that is not on the daemon's machine.
struct rn_job_runner {
    char machine[64];   // "" = absent, as all of them
    char slurm_job[24]; // Slurm's number
    char reason[160];   // why it waits
};
struct rn_job {
    char id[RN_ID_MAX];
    int type, state; // enum rn_job_type, enum rn_job_state
    int64_t attempt;
    char created_at[RN_TIME_MAX], started_at[RN_TIME_MAX], finished_at[RN_TIME_MAX];
    char dataset[RN_ID_MAX], dataset_name[RN_NAME_MAX]; // "" = absent
    char scene[RN_ID_MAX], scene_name[RN_NAME_MAX];
    char *options;  // JSON, owned; as the next ones
    char *progress; // NULL = null
    char *result;   // NULL = absent
    char *problem;  // NULL = absent
    struct rn_job_runner runner;
    char owner[RN_ID_MAX];          // the token that asked for it; "" = absent
    char traceparent[RN_TRACE_MAX]; // "" = absent
};
extern const struct rn_table rn_job_table;

// GET /v1/scenes/{id}/evaluations
struct rn_evaluation {
    char job[RN_ID_MAX], finished_at[RN_TIME_MAX];
    char *options, *result; // JSON, owned
};
extern const struct rn_table rn_evaluation_table;

#endif
