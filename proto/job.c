#include "proto/job.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/checks.h"
#include "proto/dataset.h"
#include "proto/marks.h"

#define MAX_SIZE 16384 // pixels

// ---- options ----

static const struct rn_table train_by_name_table = {
    .title = "settings by name",
    .size = sizeof(union rn_setting_value[RN_TRAIN_SETTINGS]),
    .settings = &rn_train_settings,
    .by_name = true};

#define S struct rn_train_options
static const struct rn_field_spec train_options[] = {
    RN_F_NAME(S, preset, 0, rn_preset_names),
    RN_F_INT(S, threads, 0, 0, 1024),
    RN_F_INT(S, ranks, 0, 1, 16),
    RN_F_TEXT(S, device, 0, rn_check_device),
    RN_F_TEXT(S, kernels, 0, rn_check_kernels),
    RN_F_NUMBER(S, checkpoint_interval_s, 0, 0, 86400),
    RN_F_NUMBER(S, evaluate_interval_s, RN_OVER_MIN, 0, 86400),
    RN_F_OBJECT(S, settings, 0, &train_by_name_table),
};
const struct rn_table rn_train_options_table = RN_TABLE_OF_SETTINGS(
    S, "training options", train_options, &rn_train_settings, settings, 1, true);
#undef S

const char *const rn_film_names[] = {"h264", "av1", "vp9", "gif", NULL};

#define S struct rn_path_options
static const struct rn_field_spec path_options[] = {
    RN_F_INT(S, width, 0, 1, MAX_SIZE),
    RN_F_INT(S, height, 0, 1, MAX_SIZE),
    RN_F_INT(S, first, 0, 0, 99999),
    RN_F_INT(S, last, 0, 0, 99999),
    RN_F_NAME(S, output, 0, rn_output_kind_names),
    RN_F_NUMBER(S, fps, 0, 0.001, 1000),
    RN_F_NAME(S, film, 0, rn_film_names),
    RN_F_INT(S, video_quality, 0, 0, 100),
    RN_F_NAME(S, format, 0, rn_picture_format_names),
    RN_F_INT(S, jpeg_quality, 0, 1, 100),
    RN_F_NUMBERS(S, crop, 0, -INFINITY, INFINITY),
    RN_F_OBJECT(S, optics, 0, &rn_optics_table),
};
const struct rn_table rn_path_options_table =
    RN_TABLE_OF_SETTINGS(S, "path options", path_options, &rn_render_settings, settings, 11, true);
#undef S

#define S struct rn_eval_options
static const struct rn_field_spec eval_options[] = {
    RN_F_NAME(S, split, 0, rn_split_names),
    RN_F_INT(S, views, 0, 0, 1e6),
    RN_F_INT(S, scale, 0, 0, 15),
    RN_F_NUMBER(S, at, RN_OVER_MIN, 0, 31536000),
};
const struct rn_table rn_eval_options_table = RN_TABLE_OF_SETTINGS(
    S, "evaluation options", eval_options, &rn_render_settings, settings, 4, true);
#undef S

#define S struct rn_ladder_options
static const struct rn_field_spec ladder_options[] = {
    RN_F_TEXT(S, over, RN_REQUIRED, NULL),
    RN_F_NAME(S, equal, 0, rn_ladder_equal_names),
    RN_F_INT(S, seeds, 0, 1, 16),
    RN_F_NAME(S, split, 0, rn_split_names),
    RN_F_INT(S, views, 0, 0, 1e6),
    RN_F_INT(S, moments, 0, 0, RN_MARKS_KEPT),
    {.name = "one_cone", .type = RN_TYPE_TRUTH, .offset = offsetof(S, one_cone)},
    {.name = "keep", .type = RN_TYPE_TRUTH, .offset = offsetof(S, keep)},
    RN_F_OBJECT(S, train, 0, &rn_train_options_table),
};
const struct rn_table rn_ladder_options_table = RN_TABLE(S, "ladder options", ladder_options);
#undef S

enum rn_status rn_ladder_options_plan(const struct rn_ladder_options *options,
                                      struct rn_ladder_plan *ret_plan, struct rn_error *err) {
    struct rn_error why;
    int preset = rn_name_or(options->train.preset, RN_PRESET_STANDARD);
    int equal = rn_name_or(options->equal, RN_LADDER_EQUAL_TIME);
    int64_t seeds = rn_int_or(options->seeds, RN_LADDER_SEEDS);
    enum rn_status status =
        rn_ladder_plan(options->over, (enum rn_ladder_equal)equal, (enum rn_preset_name)preset,
                       options->train.settings, ret_plan, &why);
    if (status != RN_OK) {
        bool over = strcmp(why.where, "over") == 0;
        rn_error_set(err, status, "", "%s", why.text);
        snprintf(err->where, sizeof err->where, "%s%.60s", over ? "" : "train/", why.where);
        return status;
    }
    int64_t trainings = seeds * (int64_t)ret_plan->count;
    if (trainings <= RN_LADDER_TRAININGS) return RN_OK;
    rn_ladder_plan_finish(ret_plan);
    return rn_error_set(err, RN_ERROR_LIMIT, "over",
                        "asks for %lld trainings with all seeds; a ladder has at most %d",
                        (long long)trainings, RN_LADDER_TRAININGS);
}

// ---- requests: one struct, a table for each type ----

#define S struct rn_job_request
static const struct rn_field_spec train_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, dataset, RN_REQUIRED, rn_check_reference),
    RN_F_TEXT(S, scene, RN_REQUIRED, rn_check_name),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, train),
     .table = &rn_train_options_table},
};
static const struct rn_field_spec path_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, scene, RN_REQUIRED, rn_check_reference),
    RN_F_TEXT(S, path, 0, rn_check_reference),
    RN_F_PATH(S, camera_path, 0),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, path_options),
     .table = &rn_path_options_table},
};
static const struct rn_field_spec eval_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, scene, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, eval),
     .table = &rn_eval_options_table},
};
static const struct rn_field_spec curve_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, scene, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, curve),
     .table = &rn_curve_options_table},
};
static const struct rn_field_spec estimate_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, dataset, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, train),
     .table = &rn_train_options_table},
};
static const struct rn_field_spec effects_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, scene, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, effects),
     .table = &rn_effects_options_table},
};
static const struct rn_field_spec export_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, scene, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, export_options),
     .table = &rn_export_options_table},
};
static const struct rn_field_spec ladder_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, dataset, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .flags = RN_REQUIRED,
     .offset = offsetof(S, ladder),
     .table = &rn_ladder_options_table},
};
static const struct rn_field_spec doctor_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, scene, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, doctor),
     .table = &rn_doctor_job_options_table},
};
static const struct rn_field_spec validate_request[] = {
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_TEXT(S, upload, RN_REQUIRED, rn_check_reference),
    {.name = "options",
     .type = RN_TYPE_OBJECT,
     .offset = offsetof(S, ingest),
     .table = &rn_ingest_options_table},
};
// All fields of the struct: what an empty request is made of, and what is freed.
static const struct rn_field_spec whole_request[] = {
    RN_F_NAME(S, type, 0, rn_job_type_names),
    RN_F_TEXT(S, dataset, 0, NULL),
    RN_F_TEXT(S, scene, 0, NULL),
    RN_F_TEXT(S, path, 0, NULL),
    RN_F_PATH(S, camera_path, 0),
    RN_F_OBJECT(S, train, 0, &rn_train_options_table),
    RN_F_OBJECT(S, path_options, 0, &rn_path_options_table),
    RN_F_OBJECT(S, eval, 0, &rn_eval_options_table),
    RN_F_OBJECT(S, curve, 0, &rn_curve_options_table),
    RN_F_OBJECT(S, effects, 0, &rn_effects_options_table),
    RN_F_OBJECT(S, export_options, 0, &rn_export_options_table),
    RN_F_OBJECT(S, ladder, 0, &rn_ladder_options_table),
    RN_F_OBJECT(S, doctor, 0, &rn_doctor_job_options_table),
    RN_F_TEXT(S, upload, 0, NULL),
    RN_F_OBJECT(S, ingest, 0, &rn_ingest_options_table),
};
static const struct rn_table whole_request_table = RN_TABLE(S, "a job", whole_request);
static const struct rn_table request_tables[] = {
    [RN_JOB_TRAIN] = RN_TABLE(S, "a training job", train_request),
    [RN_JOB_PATH] = RN_TABLE(S, "a path job", path_request),
    [RN_JOB_EVAL] = RN_TABLE(S, "an evaluation job", eval_request),
    [RN_JOB_CURVE] = RN_TABLE(S, "a curve job", curve_request),
    [RN_JOB_ESTIMATE] = RN_TABLE(S, "an estimate job", estimate_request),
    [RN_JOB_EFFECTS] = RN_TABLE(S, "an effects job", effects_request),
    [RN_JOB_EXPORT] = RN_TABLE(S, "an export job", export_request),
    [RN_JOB_LADDER] = RN_TABLE(S, "a ladder", ladder_request),
    [RN_JOB_DOCTOR] = RN_TABLE(S, "a doctor job", doctor_request),
    [RN_JOB_VALIDATE] = RN_TABLE(S, "a validation job", validate_request),
};
#undef S

static bool has_train_options(int type) {
    return type == RN_JOB_TRAIN || type == RN_JOB_ESTIMATE;
}

static const char *check_budget(const struct rn_job_request *request, const char **ret_pointer) {
    static const char *const pointers[] = {"", "#/options/within_ms", "#/options/render_psnr",
                                           "#/options/quality"};
    enum rn_budget_kind kind = RN_BUDGET_NONE;
    const char *wrong = NULL;
    if (request->type == RN_JOB_PATH)
        wrong = rn_budget_check(request->path_options.settings, &kind);
    if (request->type == RN_JOB_EVAL) wrong = rn_budget_check(request->eval.settings, &kind);
    *ret_pointer = pointers[kind];
    if (wrong || kind == RN_BUDGET_NONE || isnan(request->eval.at)) return wrong;
    *ret_pointer = "#/options/at";
    return RN_AT_ALONE;
}

// Whether a training can be made of its options.
static const char *check_train(const struct rn_job_request *request, char pointer[80],
                               struct rn_error *why) {
    static const char no_solid[] = "must be 3, 4, 6 or 10 along a Platonic solid";
    if (rn_train_choice_check(request->train.settings, why) == RN_OK) return NULL;
    bool planes = strcmp(why->where, "planes") == 0;
    snprintf(pointer, 80, "#/options/%s%.48s", planes ? "" : "settings/", why->where);
    return planes ? no_solid : why->text;
}

static const char *check_ladder(const struct rn_job_request *request, char pointer[80],
                                struct rn_error *why) {
    struct rn_ladder_plan plan;
    if (rn_ladder_options_plan(&request->ladder, &plan, why) != RN_OK) {
        snprintf(pointer, 80, "#/options/%.64s", why->where);
        return why->text;
    }
    rn_ladder_plan_finish(&plan);
    return NULL;
}

static const char *check_path(const struct rn_job_request *request, const char **ret_pointer) {
    *ret_pointer = "#/path";
    if (!*request->path == !request->camera_path.json)
        return "exactly one of path and camera_path must be given";
    const struct rn_path_options *options = &request->path_options;
    *ret_pointer = "#/options/height";
    if ((options->width == RN_ABSENT) != (options->height == RN_ABSENT))
        return "width and height must be given together";
    *ret_pointer = "#/options/last";
    if (options->last != RN_ABSENT && options->last < rn_int_or(options->first, 0))
        return "must not be less than first";
    *ret_pointer = "#/options/format";
    if (options->film >= 0 && rn_name_or(options->format, RN_FORMAT_PNG) != RN_FORMAT_PNG)
        return "is of frames without a film, which is made of png";
    const char *wrong = rn_picture_format_check(options->format, options->output);
    if (wrong) return wrong;
    *ret_pointer = "#/options/crop";
    return rn_crop_check(options->crop);
}

// What a table cannot say. Pointers and words may be those of `place` and `why`.
static const char *check_request(const struct rn_job_request *request, char place[80],
                                 struct rn_error *why, const char **ret_pointer) {
    *ret_pointer = place;
    if (has_train_options(request->type)) return check_train(request, place, why);
    if (request->type == RN_JOB_LADDER) return check_ladder(request, place, why);
    if (request->type == RN_JOB_EXPORT)
        return rn_export_check(&request->export_options, ret_pointer);
    const char *wrong = check_budget(request, ret_pointer);
    return wrong || request->type != RN_JOB_PATH ? wrong : check_path(request, ret_pointer);
}

#define MUST_BE_A_TYPE                                                                             \
    "must be one of train, path, eval, curve, estimate, effects, export, ladder, doctor, validate"
enum rn_status rn_job_request_decode(const char *json, size_t size,
                                     struct rn_job_request *ret_request,
                                     struct rn_field_errors *errors, struct rn_error *err) {
    char type_name[16];
    enum rn_status status =
        rn_decode_peek(json, size, "type", sizeof type_name, type_name, errors, err);
    if (status) return status;
    int type = rn_name_index(rn_job_type_names, type_name);
    if (type < 0 || type == RN_JOB_INGEST) {
        rn_field_errors_add(errors, "#/type", MUST_BE_A_TYPE);
        return rn_error_set(err, RN_ERROR_INVALID, "#/type", MUST_BE_A_TYPE);
    }
    struct rn_job_request request;
    status = rn_decode(&request_tables[type], json, size, &request, errors, err);
    if (status) return status;
    // The type's own table has left the other types' options zero.
    if (!has_train_options(type)) rn_message_init(&rn_train_options_table, &request.train);
    if (type != RN_JOB_PATH) rn_message_init(&rn_path_options_table, &request.path_options);
    if (type != RN_JOB_EVAL) rn_message_init(&rn_eval_options_table, &request.eval);
    if (type != RN_JOB_CURVE) rn_message_init(&rn_curve_options_table, &request.curve);
    if (type != RN_JOB_EFFECTS) rn_message_init(&rn_effects_options_table, &request.effects);
    if (type != RN_JOB_EXPORT) rn_message_init(&rn_export_options_table, &request.export_options);
    if (type != RN_JOB_LADDER) rn_message_init(&rn_ladder_options_table, &request.ladder);
    if (type != RN_JOB_DOCTOR) rn_message_init(&rn_doctor_job_options_table, &request.doctor);
    if (type != RN_JOB_VALIDATE) rn_message_init(&rn_ingest_options_table, &request.ingest);
    struct rn_error why;
    char place[80];
    const char *pointer, *wrong = check_request(&request, place, &why, &pointer);
    if (wrong) {
        rn_field_errors_add(errors, pointer, "%s", wrong);
        rn_job_request_finish(&request);
        return rn_error_set(err, RN_ERROR_INVALID, pointer, "%s", wrong);
    }
    *ret_request = request;
    return RN_OK;
}

void rn_job_request_finish(struct rn_job_request *request) {
    rn_message_finish(&whole_request_table, request);
}

enum rn_status rn_job_request_options(const struct rn_job_request *request, char **ret_json,
                                      struct rn_error *err) {
    if (has_train_options(request->type))
        return rn_encode(&rn_train_options_table, &request->train, ret_json, NULL, err);
    if (request->type == RN_JOB_PATH)
        return rn_encode(&rn_path_options_table, &request->path_options, ret_json, NULL, err);
    if (request->type == RN_JOB_CURVE)
        return rn_encode(&rn_curve_options_table, &request->curve, ret_json, NULL, err);
    if (request->type == RN_JOB_EFFECTS)
        return rn_encode(&rn_effects_options_table, &request->effects, ret_json, NULL, err);
    if (request->type == RN_JOB_EXPORT)
        return rn_encode(&rn_export_options_table, &request->export_options, ret_json, NULL, err);
    if (request->type == RN_JOB_LADDER)
        return rn_encode(&rn_ladder_options_table, &request->ladder, ret_json, NULL, err);
    if (request->type == RN_JOB_DOCTOR)
        return rn_encode(&rn_doctor_job_options_table, &request->doctor, ret_json, NULL, err);
    if (request->type == RN_JOB_VALIDATE)
        return rn_encode(&rn_ingest_options_table, &request->ingest, ret_json, NULL, err);
    return rn_encode(&rn_eval_options_table, &request->eval, ret_json, NULL, err);
}

// ---- progress ----

#define S struct rn_nonfinite
static const struct rn_field_spec nonfinite[] = {
    RN_F_INT(S, rays, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, steps_rejected, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, rollbacks, RN_REQUIRED, 0, INFINITY),
};
static const struct rn_table nonfinite_table = RN_TABLE(S, "nonfinite", nonfinite);
#undef S

#define S struct rn_train_progress
static const struct rn_field_spec train_progress[] = {
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, max_steps, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, max_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, load_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, evaluate_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, paused_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, yielded_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, loss, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, rays_per_second, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, samples_per_second, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, samples, RN_REQUIRED, 0, INFINITY),
    RN_F_INTS(S, level_samples, level_count, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_INT(S, psnr_step, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_OBJECT(S, nonfinite, RN_REQUIRED, &nonfinite_table),
    RN_F_NUMBER(S, eta_seconds, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, fraction, RN_REQUIRED | RN_NULLABLE, 0, 1),
    RN_F_BOOL(S, evaluating_first, RN_REQUIRED),
    RN_F_BOOL(S, evaluating, 0),
    RN_F_TEXT(S, fell_back, 0, NULL),
    RN_F_TEXT(S, stage, 0, NULL),
};
const struct rn_table rn_train_progress_table = RN_TABLE(S, "training progress", train_progress);
#undef S

#define S struct rn_work_progress
static const struct rn_field_spec work_progress[] = {
    RN_F_INT(S, done, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, total, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_OBJECT(S, nonfinite, RN_REQUIRED, &nonfinite_table),
    RN_F_NUMBER(S, fraction, RN_REQUIRED | RN_NULLABLE, 0, 1),
    RN_F_NUMBER(S, eta_seconds, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_TEXT(S, stage, 0, NULL),
};
const struct rn_table rn_work_progress_table = RN_TABLE(S, "progress", work_progress);
#undef S

#define S struct rn_metric_event
static const struct rn_field_spec metric_event[] = {
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
};
const struct rn_table rn_metric_event_table = RN_TABLE(S, "metric", metric_event);
#undef S

// ---- results ----

#define S struct rn_train_result
static const struct rn_field_spec train_result[] = {
    RN_F_INT(S, steps, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, samples, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_INT(S, psnr_step, 0, 0, INFINITY),
    RN_F_TEXT(S, parameters_sha256, RN_REQUIRED, rn_check_sha256),
    RN_F_NAME(S, finished_by, RN_REQUIRED, rn_finished_by_names),
    RN_F_TEXT(S, fell_back, 0, NULL),
    RN_F_OBJECT(S, estimate, 0, &rn_estimate_check_table),
    RN_F_TEXT(S, machine, 0, NULL),
};
const struct rn_table rn_train_result_table = RN_TABLE(S, "training result", train_result);
#undef S

#define S struct rn_path_result
static const struct rn_field_spec path_result[] = {
    RN_F_INT(S, frames, RN_REQUIRED, 0, 100000),
    RN_F_INT(S, width, RN_REQUIRED, 1, MAX_SIZE),
    RN_F_INT(S, height, RN_REQUIRED, 1, MAX_SIZE),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, render_ms_median, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_TEXT(S, effects, 0, NULL),
    RN_F_TEXT(S, setting, 0, NULL),
    RN_F_NUMBER(S, expected_psnr, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, expected_spread, 0, 0, INFINITY),
    RN_F_TEXT(S, film, 0, NULL),
    RN_F_INT(S, film_bytes, 0, 0, INFINITY),
};
const struct rn_table rn_path_result_table = RN_TABLE(S, "path result", path_result);
#undef S

#define S struct rn_scale_score
static const struct rn_field_spec scale_score[] = {
    RN_F_INT(S, scale, RN_REQUIRED, 0, 64),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, ssim, RN_REQUIRED, -INFINITY, INFINITY),
    RN_F_NUMBER(S, render_ms, RN_REQUIRED, 0, INFINITY),
};
const struct rn_table rn_scale_score_table = RN_TABLE(S, "scale score", scale_score);
#undef S

#define S struct rn_view_result
static const struct rn_field_spec view_result[] = {
    RN_F_TEXT(S, name, RN_REQUIRED, NULL),
    RN_F_INT(S, index, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(S, scale, RN_REQUIRED, 0, 64),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, ssim, RN_REQUIRED, -INFINITY, INFINITY),
    RN_F_NUMBER(S, render_ms, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr_fitted, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, lpips, 0, 0, INFINITY),
    RN_F_NUMBER(S, depth_error, 0, 0, INFINITY),
};
const struct rn_table rn_view_result_table = RN_TABLE(S, "view score", view_result);
#undef S

#define S struct rn_protocol
static const struct rn_field_spec protocol[] = {
    RN_F_NAME(S, split, RN_REQUIRED, rn_split_names),
    RN_F_NUMBERS(S, background, RN_REQUIRED, 0, 1),
    RN_F_NAME(S, downscale, RN_REQUIRED, rn_downscale_names),
    RN_F_TEXT(S, rounding, RN_REQUIRED, NULL),
    RN_F_INT(S, seed, RN_REQUIRED, 0, INFINITY),
    RN_F_NAME(S, train_split, RN_REQUIRED, rn_train_split_names),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, version, RN_REQUIRED, NULL),
    RN_F_TEXT(S, device, RN_REQUIRED, NULL),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_INT(S, threads, RN_REQUIRED, 1, 1024),
    RN_F_TEXT(S, machine, 0, NULL),
};
const struct rn_table rn_protocol_table = RN_TABLE(S, "protocol", protocol);
#undef S

#define S struct rn_eval_result
static const struct rn_field_spec eval_result[] = {
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, ssim, RN_REQUIRED, -INFINITY, INFINITY),
    RN_F_NUMBER(S, psnr_fitted, 0, -INFINITY, INFINITY),
    RN_F_NUMBER(S, lpips, 0, 0, INFINITY),
    RN_F_NUMBER(S, depth_error, 0, 0, INFINITY),
    RN_F_INT(S, views, RN_REQUIRED, 1, INFINITY),
    RN_F_NUMBER(S, psnr_spread, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, ssim_spread, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_OBJECTS(S, scales, scale_count, RN_REQUIRED, &rn_scale_score_table, 16),
    RN_F_OBJECTS(S, per_view, view_count, RN_REQUIRED, &rn_view_result_table, 1e6),
    RN_F_NUMBER(S, render_ms_median, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, setting, 0, NULL),
    RN_F_OBJECT(S, protocol, RN_REQUIRED, &rn_protocol_table),
};
const struct rn_table rn_eval_result_table = RN_TABLE(S, "evaluation result", eval_result);
#undef S

#define S struct rn_ingest_result
static const struct rn_field_spec ingest_result[] = {
    RN_F_TEXT(S, dataset, 0, NULL),
    RN_F_TEXT(S, scene, 0, NULL),
};
const struct rn_table rn_ingest_result_table = RN_TABLE(S, "import result", ingest_result);
#undef S

// ---- the resource ----

#define S struct rn_job_runner
static const struct rn_field_spec job_runner[] = {
    RN_F_TEXT(S, machine, 0, NULL),
    RN_F_TEXT(S, slurm_job, 0, NULL),
    RN_F_TEXT(S, reason, 0, NULL),
};
static const struct rn_table job_runner_table = RN_TABLE(S, "a runner", job_runner);
#undef S

#define S struct rn_job
static const struct rn_field_spec job[] = {
    RN_F_TEXT(S, id, RN_REQUIRED, NULL),
    RN_F_NAME(S, type, RN_REQUIRED, rn_job_type_names),
    RN_F_NAME(S, state, RN_REQUIRED, rn_job_state_names),
    RN_F_INT(S, attempt, RN_REQUIRED, 1, INFINITY),
    RN_F_TEXT(S, created_at, RN_REQUIRED, NULL),
    RN_F_TEXT(S, started_at, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, finished_at, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_TEXT(S, dataset, 0, NULL),
    RN_F_TEXT(S, dataset_name, 0, NULL),
    RN_F_TEXT(S, scene, 0, NULL),
    RN_F_TEXT(S, scene_name, 0, NULL),
    RN_F_JSON(S, options, RN_REQUIRED | RN_IS_OBJECT),
    RN_F_JSON(S, progress, RN_REQUIRED | RN_NULLABLE | RN_IS_OBJECT),
    RN_F_JSON(S, result, RN_IS_OBJECT),
    RN_F_JSON(S, problem, RN_IS_OBJECT),
    RN_F_OBJECT(S, runner, 0, &job_runner_table),
    RN_F_TEXT(S, owner, 0, NULL),
    RN_F_TEXT(S, traceparent, 0, NULL),
};
const struct rn_table rn_job_table = RN_TABLE(S, "a job", job);
#undef S

#define S struct rn_evaluation
static const struct rn_field_spec evaluation[] = {
    RN_F_TEXT(S, job, RN_REQUIRED, NULL),
    RN_F_TEXT(S, finished_at, RN_REQUIRED, NULL),
    RN_F_JSON(S, options, RN_REQUIRED | RN_IS_OBJECT),
    RN_F_JSON(S, result, RN_REQUIRED | RN_IS_OBJECT),
};
const struct rn_table rn_evaluation_table = RN_TABLE(S, "an evaluation", evaluation);
#undef S
