#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "common/path/path.h"
#include "server/api/app.h"

static enum rn_status encode_path(struct rn_app *app, void *row_pointer, char **ret_json,
                                  struct rn_error *err) {
    struct rn_camera_path_row *row = row_pointer;
    struct rn_camera_path_record record = {.path = {.json = row->document}};
    snprintf(record.id, sizeof record.id, "%s", row->id);
    snprintf(record.name, sizeof record.name, "%s", row->name);
    rn_time_text(row->created_ms, record.created_at);
    return rn_encode(&rn_camera_path_record_table, &record, ret_json, NULL, err);
}

static enum rn_status encode_summary(struct rn_app *app, void *row_pointer, char **ret_json,
                                     struct rn_error *err) {
    const struct rn_camera_path_row *row = row_pointer;
    struct rn_camera_path_summary summary;
    snprintf(summary.id, sizeof summary.id, "%s", row->id);
    snprintf(summary.name, sizeof summary.name, "%s", row->name);
    rn_time_text(row->created_ms, summary.created_at);
    return rn_encode(&rn_camera_path_summary_table, &summary, ret_json, NULL, err);
}

void rn_list_camera_paths(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"limit", "cursor", NULL};
    struct rn_error err = {0};
    struct rn_query query = {.without = "document"};
    if (rn_api_failed(rn_request_check_query(request, known, &err), &err, reply)) return;
    rn_api_list(context, request, &rn_camera_paths, &query, encode_summary, reply);
}

static enum rn_status insert(struct rn_app *app, const struct rn_caller *caller,
                             const struct rn_camera_path_request *wanted,
                             struct rn_camera_path_row *row, struct rn_error *err) {
    const struct rn_path *path = wanted->path.path;
    enum rn_status status = rn_api_check_pixels(path->width, path->height, "#/path", err);
    if (status == RN_OK) status = rn_store_new_id(RN_ID_PATH, row->id, err);
    if (status != RN_OK) return status;
    snprintf(row->name, sizeof row->name, "%s", wanted->name);
    snprintf(row->owner, sizeof row->owner, "%s", caller->id);
    row->created_ms = rn_clock_wall_ms();
    row->document = wanted->path.json; // borrowed
    status = rn_store_insert(app->store, &rn_camera_paths, row, err);
    if (status == RN_ERROR_CONFLICT)
        return rn_error_set(err, status, "#/name", "there is a camera path '%s'", row->name);
    return status;
}

void rn_create_camera_path(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_camera_path_request wanted;
    struct rn_camera_path_row row = {0};
    char *json = NULL;
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    if (rn_decode(&rn_camera_path_request_table, body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    enum rn_status status = insert(context, rn_request_caller(request), &wanted, &row, &err);
    if (status == RN_OK) status = encode_path(context, &row, &json, &err);
    rn_message_finish(&rn_camera_path_request_table, &wanted);
    if (rn_api_failed(status, &err, reply)) return;
    rn_api_json(reply, 201, json);
    rn_reply_header(reply, "Location", "/v1/camera-paths/%s", row.id);
}

static bool find_path(struct rn_app *app, struct rn_request *request,
                      struct rn_camera_path_row *row, struct rn_reply *reply) {
    struct rn_error err = {0};
    enum rn_status status = rn_store_resolve(app->store, &rn_camera_paths, RN_ID_PATH,
                                             rn_request_param(request, 0), row, &err);
    return !rn_api_failed(status, &err, reply);
}

void rn_get_camera_path(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_camera_path_row row;
    char *json = NULL;
    if (!find_path(context, request, &row, reply)) return;
    enum rn_status status = encode_path(context, &row, &json, &err);
    rn_row_finish(&rn_camera_paths, &row);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_delete_camera_path(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_camera_path_row row;
    if (!rn_api_may_change(app, request, &rn_camera_paths, reply) ||
        !find_path(app, request, &row, reply))
        return;
    enum rn_status status = rn_store_delete(app->store, &rn_camera_paths, row.id, &err);
    char *folder = rn_store_path(app->store, "camera-paths/%s", row.id);
    if (status == RN_OK && folder != NULL && rn_remove_tree(folder, NULL) != RN_OK)
        rn_log(RN_LOG_WARN, "%s cannot be removed yet", folder);
    free(folder);
    rn_row_finish(&rn_camera_paths, &row);
    if (!rn_api_failed(status, &err, reply)) rn_reply_empty(reply, 204);
}
