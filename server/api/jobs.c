#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/sha256.h"
#include "proto/job.h"
#include "common/path/path.h"
#include "server/api/app.h"

static enum rn_status encode_job(struct rn_app *app, void *row, char **ret_json,
                                 struct rn_error *err) {
    return rn_control_row_json(app->control, row, ret_json, err);
}

static enum rn_status check_name(const char *const *names, const char *name, const char *where,
                                 struct rn_error *err) {
    if (name == NULL || rn_name_index(names, name) >= 0) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, where, "there is no %s '%.32s'", where, name);
}

void rn_list_jobs(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"state", "type", "scene", "limit", "cursor", NULL};
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row scene = {.id = ""};
    const char *state = rn_request_query(request, "state");
    const char *type = rn_request_query(request, "type");
    const char *reference = rn_request_query(request, "scene");
    enum rn_status status = rn_request_check_query(request, known, &err);
    if (status == RN_OK) status = check_name(rn_job_state_names, state, "state", &err);
    if (status == RN_OK) status = check_name(rn_job_type_names, type, "type", &err);
    if (status == RN_OK && reference != NULL)
        status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE, reference, &scene, &err);
    if (rn_api_failed(status, &err, reply)) return;
    struct rn_query query = {.equal = {{state != NULL ? "state" : NULL, state},
                                       {type != NULL ? "type" : NULL, type},
                                       {reference != NULL ? "scene" : NULL, scene.id}},
                             .without = "source"};
    rn_api_list(app, request, &rn_jobs_table, &query, encode_job, reply);
    rn_row_finish(&rn_scenes, &scene);
}

// What the request leaves to the path is written into its options: a job says what it makes.
// `document` is the path as the job keeps it.
static enum rn_status settle_frames(struct rn_job_request *wanted, const char *document,
                                    struct rn_error *err) {
    struct rn_path_options *options = &wanted->path_options;
    const struct rn_path *path = wanted->camera_path.path;
    struct rn_path *stored = NULL;
    if (path == NULL) {
        char *file;
        int size = asprintf(&file, "{\"path\":%s}", document);
        if (size < 0) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for the path");
        enum rn_status status = rn_path_parse(file, (size_t)size, "", &stored, err);
        free(file);
        if (status != RN_OK) return status;
        path = stored;
    }
    options->fps = rn_number_or(options->fps, path->fps);
    if (options->width == RN_ABSENT) {
        options->width = path->width;
        options->height = path->height;
    }
    rn_path_destroy(&stored);
    return RN_OK;
}

// The path job's document: its own, or the named camera path's, as {"path": ...}; malloc.
static enum rn_status find_path(struct rn_app *app, struct rn_job_request *wanted, char **ret_path,
                                struct rn_error *err) {
    struct rn_camera_path_row row;
    if (wanted->type != RN_JOB_PATH) return RN_OK;
    if (wanted->camera_path.json != NULL) {
        const struct rn_path *path = wanted->camera_path.path;
        enum rn_status status =
            rn_api_check_pixels(path->width, path->height, "#/camera_path", err);
        if (status != RN_OK) return status;
        *ret_path = strdup(wanted->camera_path.json);
    } else {
        enum rn_status status =
            rn_store_resolve(app->store, &rn_camera_paths, RN_ID_PATH, wanted->path, &row, err);
        if (status != RN_OK) return status;
        *ret_path = strdup(row.document);
        rn_row_finish(&rn_camera_paths, &row);
    }
    if (*ret_path == NULL)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for the path");
    return settle_frames(wanted, *ret_path, err);
}

static void digest(const char *body, size_t size, char ret_hex[65]) {
    struct rn_sha256 hash;
    rn_sha256_init(&hash);
    rn_sha256_update(&hash, body, size);
    rn_sha256_final_hex(&hash, ret_hex);
}

// The tar that a validation reads, and leaves where it is.
static enum rn_status find_upload(struct rn_app *app, const char *id, char **ret_path,
                                  struct rn_error *err) {
    struct rn_upload_record upload;
    if (!rn_api_find_upload(app, id, &upload))
        return rn_error_set(err, RN_ERROR_NOT_FOUND, "#/upload", "there is no upload '%s'", id);
    if (upload.offset < upload.size_bytes)
        return rn_error_set(err, RN_ERROR_CONFLICT, "#/upload",
                            "of the upload %lld of %lld bytes are there", (long long)upload.offset,
                            (long long)upload.size_bytes);
    *ret_path = rn_api_upload_path(app, &upload);
    return *ret_path ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory for a job");
}

static enum rn_status submit(struct rn_app *app, const struct rn_request *request,
                             struct rn_job_request *wanted, const char *key, const char *digest_hex,
                             char id[RN_ID_MAX], char **ret_json, struct rn_error *err) {
    char *options = NULL, *path = NULL;
    enum rn_status status = wanted->type == RN_JOB_VALIDATE
                                ? find_upload(app, wanted->upload, &path, err)
                                : find_path(app, wanted, &path, err);
    if (status == RN_OK && wanted->type == RN_JOB_PATH)
        status = rn_api_check_pixels(rn_int_or(wanted->path_options.width, 0),
                                     rn_int_or(wanted->path_options.height, 0), "#/options", err);
    if (status == RN_OK) status = rn_job_request_options(wanted, &options, err);
    if (status == RN_OK) {
        struct rn_submission submission = {.type = (enum rn_job_type)wanted->type,
                                           .dataset = wanted->dataset,
                                           .scene = wanted->scene,
                                           .source = path,
                                           .options = options,
                                           .key = key,
                                           .digest = digest_hex,
                                           .caller = rn_request_caller(request),
                                           .traceparent = rn_request_traceparent(request)};
        status = rn_control_submit(app->control, &submission, id, ret_json, err);
    }
    free(options);
    free(path);
    return status;
}

// A job that is recorded, or why not. Takes the JSON.
static void reply_accepted(enum rn_status status, struct rn_error *err, const char *id, char *json,
                           struct rn_reply *reply) {
    if (status == RN_ERROR_BUSY) {
        rn_reply_problem(reply, RN_PROBLEM_QUEUE_FULL, "%s", err->text);
    } else if (!rn_api_failed(status, err, reply)) {
        rn_api_json(reply, 202, json);
        rn_reply_header(reply, "Location", "/v1/jobs/%s", id);
    }
}

void rn_create_job(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_job_request wanted;
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    const char *key = rn_request_header(request, "Idempotency-Key");
    char *json = NULL, id[RN_ID_MAX], hex[65], own_key[RN_KEY_MAX];
    if (key != NULL && (key[0] == '\0' || strlen(key) > 128)) {
        rn_reply_problem(reply, RN_PROBLEM_INVALID, "Idempotency-Key must have 1 to 128 bytes");
        return;
    }
    if (rn_job_request_decode(body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    const struct rn_caller *caller = rn_request_caller(request);
    bool trains = wanted.type == RN_JOB_TRAIN || wanted.type == RN_JOB_ESTIMATE ||
                  wanted.type == RN_JOB_EFFECTS || wanted.type == RN_JOB_LADDER ||
                  wanted.type == RN_JOB_VALIDATE;
    if (trains && !rn_api_may(caller, RN_SCOPE_TRAIN, reply)) {
        rn_job_request_finish(&wanted);
        return;
    }
    digest(body, size, hex);
    if (key != NULL) rn_api_own_key(caller, ':', key, own_key);
    enum rn_status status =
        submit(context, request, &wanted, key != NULL ? own_key : NULL, hex, id, &json, &err);
    rn_job_request_finish(&wanted);
    reply_accepted(status, &err, id, json, reply);
}

void rn_get_job(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status =
        rn_control_job_json(app->control, rn_request_param(request, 0), &json, &err);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_get_job_path(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_job_row row;
    enum rn_status status = rn_store_resolve(app->store, &rn_jobs_table, RN_ID_JOB,
                                             rn_request_param(request, 0), &row, &err);
    if (rn_api_failed(status, &err, reply)) return;
    if (row.type == RN_JOB_PATH && row.source != NULL) {
        rn_api_json(reply, 200, row.source);
        row.source = NULL; // the reply's
    } else {
        rn_reply_problem(reply, RN_PROBLEM_NOT_FOUND, "a %s job has no camera path",
                         rn_job_type_names[row.type]);
    }
    rn_row_finish(&rn_jobs_table, &row);
}

void rn_list_metrics(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status =
        rn_control_metrics_json(app->control, rn_request_param(request, 0), &json, &err);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

static void command(struct rn_app *app, struct rn_request *request, enum rn_job_event event,
                    struct rn_reply *reply) {
    struct rn_error err = {0};
    char *json = NULL;
    if (!rn_api_may_change(app, request, &rn_jobs_table, reply)) return;
    enum rn_status status =
        rn_control_command(app->control, rn_request_param(request, 0), event, &json, &err);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_pause_job(void *context, struct rn_request *request, struct rn_reply *reply) {
    command(context, request, RN_JOB_PAUSE, reply);
}

void rn_resume_job(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    char *json = NULL, id[RN_ID_MAX];
    if (!rn_api_may_change(app, request, &rn_jobs_table, reply)) return;
    enum rn_status status = rn_control_go_on(app->control, rn_request_param(request, 0),
                                             rn_request_caller(request), id, &json, &err);
    if (*id || status == RN_ERROR_BUSY)
        reply_accepted(status, &err, id, json, reply);
    else if (!rn_api_failed(status, &err, reply))
        rn_api_json(reply, 200, json);
}

void rn_finish_job(void *context, struct rn_request *request, struct rn_reply *reply) {
    command(context, request, RN_JOB_FINISH, reply);
}

void rn_cancel_job(void *context, struct rn_request *request, struct rn_reply *reply) {
    command(context, request, RN_JOB_CANCEL, reply);
}
