#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/seal.h"
#include "proto/job.h"
#include "server/api/app.h"

static const char *const page_query[] = {"limit", "cursor", NULL};

static enum rn_status encode_scene(struct rn_app *app, void *row, char **ret_json,
                                   struct rn_error *err) {
    return rn_control_scene_json(app->control, row, ret_json, err);
}

void rn_list_scenes(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_query query = {0};
    if (rn_api_failed(rn_request_check_query(request, page_query, &err), &err, reply)) return;
    rn_api_list(context, request, &rn_scenes, &query, encode_scene, reply);
}

static bool find_scene(struct rn_app *app, struct rn_request *request, struct rn_scene_row *row,
                       struct rn_reply *reply) {
    struct rn_error err = {0};
    enum rn_status status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE,
                                             rn_request_param(request, 0), row, &err);
    return !rn_api_failed(status, &err, reply);
}

void rn_get_scene(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row row;
    char *json = NULL;
    if (!find_scene(app, request, &row, reply)) return;
    enum rn_status status = rn_control_scene_json(app->control, &row, &json, &err);
    rn_row_finish(&rn_scenes, &row);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_delete_scene(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    if (!rn_api_may_change(app, request, &rn_scenes, reply)) return;
    enum rn_status status =
        rn_control_delete_scene(app->control, rn_request_param(request, 0), &err);
    if (!rn_api_failed(status, &err, reply)) rn_reply_empty(reply, 204);
}

static enum rn_status encode_evaluation(struct rn_app *app, void *row, char **ret_json,
                                        struct rn_error *err) {
    const struct rn_job_row *job = row;
    struct rn_evaluation evaluation = {.options = job->options, .result = job->result};
    snprintf(evaluation.job, sizeof evaluation.job, "%s", job->id);
    rn_time_text(job->finished_ms, evaluation.finished_at);
    return rn_encode(&rn_evaluation_table, &evaluation, ret_json, NULL, err);
}

void rn_list_evaluations(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row row;
    if (rn_api_failed(rn_request_check_query(request, page_query, &err), &err, reply)) return;
    if (!find_scene(app, request, &row, reply)) return;
    struct rn_query query = {.equal = {{"scene", row.id},
                                       {"type", rn_job_type_names[RN_JOB_EVAL]},
                                       {"state", rn_job_state_names[RN_JOB_SUCCEEDED]}},
                             .without = "source"};
    rn_api_list(app, request, &rn_jobs_table, &query, encode_evaluation, reply);
    rn_row_finish(&rn_scenes, &row);
}

static ssize_t read_sealed(void *context, uint8_t *bytes, size_t capacity) {
    return rn_sealed_read(context, bytes, capacity);
}

static void close_sealed(void *context) {
    struct rn_sealed *sealed = context;
    rn_sealed_close(&sealed);
}

// What is damaged is cut off before its end.
static void reply_sealed(struct rn_reply *reply, const char *path) {
    struct rn_error err = {0};
    struct rn_sealed *sealed;
    struct rn_stream stream = {.read = read_sealed, .close = close_sealed};
    if (rn_api_failed(rn_sealed_open(path, &sealed, &stream.size, &err), &err, reply)) return;
    stream.context = sealed;
    rn_reply_stream(reply, "application/octet-stream", stream);
}

void rn_get_checkpoint(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row row;
    struct rn_checkpoint_row *checkpoint;
    void *rows = NULL;
    size_t count = 0;
    if (!find_scene(app, request, &row, reply)) return;
    struct rn_query query = {.equal = {{"scene", row.id}}, .limit = 1};
    enum rn_status status = rn_store_list(app->store, &rn_checkpoints, &query, &rows, &count, &err);
    checkpoint = rows;
    if (!rn_api_failed(status, &err, reply)) {
        char *path =
            count > 0 ? rn_store_path(app->store, "scenes/%s/%s", row.id, checkpoint->path) : NULL;
        if (count == 0) {
            rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "scene '%s' has no checkpoint yet",
                             row.name);
        } else if (path == NULL) {
            rn_reply_problem(reply, RN_PROBLEM_INTERNAL, "no memory");
        } else {
            reply_sealed(reply, path);
            rn_reply_header(reply, "Content-Disposition",
                            "attachment; filename=\"%s-%lld.safetensors\"", row.name,
                            (long long)checkpoint->step);
        }
        free(path);
    }
    rn_rows_finish(&rn_checkpoints, rows, count);
    rn_row_finish(&rn_scenes, &row);
}
