// Tokens as a resource, and links, which are tokens for one thing.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/api/app.h"

static void add_usage(struct rn_app *app, struct rn_token_record *record) {
    struct rn_error err = {0};
    if (rn_control_usage(app->control, record->id, &record->open_jobs, &record->bytes, &err) !=
        RN_OK)
        record->open_jobs = record->bytes = 0;
}

static void describe(struct rn_app *app, const struct rn_token_row *row,
                     struct rn_token_record *record) {
    rn_message_init(&rn_token_table, record);
    memcpy(record->id, row->id, sizeof record->id);
    memcpy(record->name, row->name, sizeof record->name);
    memcpy(record->scene, row->scene, sizeof record->scene);
    memcpy(record->job, row->job, sizeof record->job);
    record->scope = (int)row->scope;
    if (row->created_ms > 0) rn_time_text(row->created_ms, record->created_at);
    if (row->expires_ms > 0) rn_time_text(row->expires_ms, record->expires_at);
    record->max_jobs = row->max_jobs;
    record->max_bytes = row->max_bytes;
    record->open_jobs = record->bytes = 0;
    if (row->id[0] != '\0') add_usage(app, record);
}

void rn_api_describe_caller(struct rn_app *app, const struct rn_caller *caller,
                            struct rn_token_record *ret_record) {
    struct rn_token_row row = {.scope = caller->scope,
                               .created_ms = caller->created_ms,
                               .expires_ms = caller->expires_ms,
                               .max_jobs = caller->max_jobs,
                               .max_bytes = caller->max_bytes};
    memcpy(row.id, caller->id, sizeof row.id);
    memcpy(row.name, caller->name, sizeof row.name);
    memcpy(row.scene, caller->scene, sizeof row.scene);
    memcpy(row.job, caller->job, sizeof row.job);
    describe(app, &row, ret_record);
}

static enum rn_status encode_token(struct rn_app *app, void *row, char **ret_json,
                                   struct rn_error *err) {
    struct rn_token_record record;
    describe(app, row, &record);
    return rn_encode(&rn_token_table, &record, ret_json, NULL, err);
}

void rn_list_tokens(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"limit", "cursor", NULL};
    const struct rn_caller *caller = rn_request_caller(request);
    struct rn_error err = {0};
    struct rn_query query = {0};
    if (rn_api_failed(rn_request_check_query(request, known, &err), &err, reply)) return;
    if (caller->scope < RN_SCOPE_ADMIN) {
        query.equal[0].column = "owner";
        query.equal[0].text = caller->id;
    }
    rn_api_list(context, request, &rn_tokens, &query, encode_token, reply);
}

static enum rn_status find_linked(struct rn_app *app, const struct rn_token_request *wanted,
                                  struct rn_token_row *row, struct rn_error *err) {
    enum rn_status status = RN_OK;
    if (wanted->scene[0] != '\0') {
        struct rn_scene_row scene;
        status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE, wanted->scene, &scene, err);
        if (status != RN_OK) return status;
        memcpy(row->scene, scene.id, sizeof row->scene);
        rn_row_finish(&rn_scenes, &scene);
    } else if (wanted->job[0] != '\0') {
        struct rn_job_row job;
        status = rn_store_resolve(app->store, &rn_jobs_table, RN_ID_JOB, wanted->job, &job, err);
        if (status != RN_OK) return status;
        memcpy(row->job, job.id, sizeof row->job);
        if (job.type != RN_JOB_PATH)
            status = rn_error_set(err, RN_ERROR_INVALID, "#/job", "a %s job has no pictures",
                                  rn_job_type_names[job.type]);
        rn_row_finish(&rn_jobs_table, &job);
    }
    return status;
}

static enum rn_status fill_row(struct rn_app *app, const struct rn_caller *caller,
                               const struct rn_token_request *wanted, struct rn_token_row *row,
                               struct rn_error *err) {
    bool link = wanted->scene[0] != '\0' || wanted->job[0] != '\0';
    row->scope = (enum rn_scope)rn_name_or(wanted->scope, RN_SCOPE_READ);
    if (wanted->scene[0] != '\0' && wanted->job[0] != '\0')
        return rn_error_set(err, RN_ERROR_INVALID, "#/job", "a link is to a scene or to a job");
    if (link && row->scope != RN_SCOPE_READ)
        return rn_error_set(err, RN_ERROR_INVALID, "#/scope", "a link only reads");
    snprintf(row->name, sizeof row->name, "%s", wanted->name);
    memcpy(row->owner, caller->id, sizeof row->owner);
    row->created_ms = rn_clock_wall_ms();
    int64_t expires_s = rn_int_or(wanted->expires_s, 0);
    row->expires_ms = expires_s > 0 ? row->created_ms + expires_s * 1000 : 0;
    row->max_jobs = rn_int_or(wanted->max_jobs, 0);
    row->max_bytes = rn_int_or(wanted->max_bytes, 0);
    return find_linked(app, wanted, row, err);
}

void rn_create_token(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    const struct rn_caller *caller = rn_request_caller(request);
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_token_request wanted;
    struct rn_token_row row = {0};
    struct rn_token_record record;
    char secret[RN_SECRET_MAX], *json = NULL;
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    if (rn_decode(&rn_token_request_table, body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    if (rn_api_failed(fill_row(app, caller, &wanted, &row, &err), &err, reply)) return;
    bool link = row.scene[0] != '\0' || row.job[0] != '\0';
    if (!link && !rn_api_may(caller, RN_SCOPE_ADMIN, reply)) return;
    enum rn_status status = rn_access_make(app->access, &row, secret, &err);
    if (rn_api_failed(status, &err, reply)) return;
    describe(app, &row, &record);
    snprintf(record.token, sizeof record.token, "%s", secret);
    status = rn_encode(&rn_token_table, &record, &json, NULL, &err);
    struct rn_error stays = {0};
    if (status != RN_OK && rn_access_revoke(app->access, row.id, &stays) != RN_OK)
        rn_log(RN_LOG_WARN, "token %s, which nobody was told, stays: %s", row.id, stays.text);
    if (rn_api_failed(status, &err, reply)) return;
    rn_api_json(reply, 201, json);
    rn_reply_header(reply, "Location", "/v1/tokens/%s", row.id);
}

void rn_delete_token(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_token_row row;
    if (!rn_api_may_change(app, request, &rn_tokens, reply)) return;
    enum rn_status status = rn_store_resolve(app->store, &rn_tokens, RN_ID_TOKEN,
                                             rn_request_param(request, 0), &row, &err);
    if (status == RN_OK) status = rn_access_revoke(app->access, row.id, &err);
    if (!rn_api_failed(status, &err, reply)) rn_reply_empty(reply, 204);
}
