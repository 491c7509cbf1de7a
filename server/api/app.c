#include "server/api/app.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define GET RN_METHOD_GET
#define POST RN_METHOD_POST
#define DELETE RN_METHOD_DELETE
#define PATCH RN_METHOD_PATCH
#define RENDER RN_ROUTE_RENDER
#define TRAIN RN_ROUTE_TRAIN
#define OF_NONE RN_ROUTE_OF_NONE
#define OF_SCENE RN_ROUTE_OF_SCENE
#define OF_JOB RN_ROUTE_OF_JOB

const struct rn_route rn_api_routes[] = {
    {GET, "/healthz", RN_ROUTE_OPEN | RN_ROUTE_ALWAYS, 0, rn_get_health, NULL},
    {GET, "/readyz", RN_ROUTE_OPEN | RN_ROUTE_ALWAYS, 0, rn_get_ready, NULL},
    {GET, "/metrics", 0, 0, rn_get_metrics, NULL},
    {GET, "/v1/info", OF_NONE, 0, rn_get_info, NULL},
    {GET, "/v1/openapi.json", 0, 0, rn_get_openapi, NULL},
    {GET, "/v1/formats", 0, 0, rn_get_formats, NULL},
    {GET, "/v1/datasets", 0, 0, rn_list_datasets, NULL},
    {POST, "/v1/datasets", TRAIN, RN_MAX_BODY, rn_create_dataset, rn_begin_dataset},
    {GET, "/v1/datasets/{id}", 0, 0, rn_get_dataset, NULL},
    {DELETE, "/v1/datasets/{id}", TRAIN, 0, rn_delete_dataset, NULL},
    {GET, "/v1/datasets/{id}/cameras", 0, 0, rn_list_cameras, NULL},
    {GET, "/v1/datasets/{id}/points", 0, 0, rn_list_points, NULL},
    {GET, "/v1/datasets/{id}/model", 0, 0, rn_get_model, NULL},
    {GET, "/v1/datasets/{id}/images/{split}/{index}", 0, 0, rn_get_image, NULL},
    {POST, "/v1/uploads", TRAIN, RN_MAX_BODY, rn_create_upload, NULL},
    {GET, "/v1/uploads/{id}", TRAIN, 0, rn_get_upload, NULL},
    {PATCH, "/v1/uploads/{id}", TRAIN, RN_MAX_BODY, rn_take_upload_part, rn_begin_upload_part},
    {DELETE, "/v1/uploads/{id}", TRAIN, 0, rn_delete_upload, NULL},
    {GET, "/v1/scenes", 0, 0, rn_list_scenes, NULL},
    {POST, "/v1/scenes", TRAIN, RN_MAX_BODY, rn_create_scene, rn_begin_scene},
    {GET, "/v1/scenes/{id}", OF_SCENE, 0, rn_get_scene, NULL},
    {DELETE, "/v1/scenes/{id}", TRAIN, 0, rn_delete_scene, NULL},
    {POST, "/v1/scenes/{id}/render", RENDER | OF_SCENE, RN_MAX_BODY, rn_render_scene, NULL},
    {GET, "/v1/scenes/{id}/start", OF_SCENE, 0, rn_get_start, NULL},
    {GET, "/v1/scenes/{id}/curve", OF_SCENE, 0, rn_get_curve, NULL},
    {POST, "/v1/scenes/{id}/curve", RENDER, RN_MAX_BODY, rn_measure_curve, NULL},
    {GET, "/v1/scenes/{id}/effects", OF_SCENE, 0, rn_get_effects, NULL},
    {POST, "/v1/scenes/{id}/effects", TRAIN, RN_MAX_BODY, rn_measure_effects, NULL},
    {GET, "/v1/scenes/{id}/export", 0, 0, rn_get_scene_export, NULL},
    {GET, "/v1/scenes/{id}/evaluations", 0, 0, rn_list_evaluations, NULL},
    {GET, "/v1/scenes/{id}/incidents", 0, 0, rn_list_incidents, NULL},
    {GET, "/v1/scenes/{id}/checkpoint", 0, 0, rn_get_checkpoint, NULL},
    {GET, "/v1/jobs", 0, 0, rn_list_jobs, NULL},
    {POST, "/v1/jobs", RENDER, RN_MAX_BODY, rn_create_job, NULL},
    {GET, "/v1/jobs/{id}", OF_JOB, 0, rn_get_job, NULL},
    {GET, "/v1/jobs/{id}/metrics", 0, 0, rn_list_metrics, NULL},
    {POST, "/v1/jobs/{id}/pause", RENDER, 0, rn_pause_job, NULL},
    {POST, "/v1/jobs/{id}/resume", RENDER, 0, rn_resume_job, NULL},
    {POST, "/v1/jobs/{id}/finish", RENDER, 0, rn_finish_job, NULL},
    {POST, "/v1/jobs/{id}/cancel", RENDER, 0, rn_cancel_job, NULL},
    {GET, "/v1/jobs/{id}/frames", OF_JOB, 0, rn_list_frames, NULL},
    {GET, "/v1/jobs/{id}/frames/{index}", OF_JOB, 0, rn_get_frame, NULL},
    {GET, "/v1/jobs/{id}/frames.tar", OF_JOB, 0, rn_get_frames_tar, NULL},
    {GET, "/v1/jobs/{id}/export", 0, 0, rn_get_export, NULL},
    {GET, "/v1/jobs/{id}/film", OF_JOB, 0, rn_get_film, NULL},
    {GET, "/v1/jobs/{id}/camera-path", 0, 0, rn_get_job_path, NULL},
    {GET, "/v1/jobs/{id}/report", 0, 0, rn_get_report, NULL},
    {GET, "/v1/jobs/{id}/events", 0, 0, rn_follow_job, NULL},
    {GET, "/v1/events", 0, 0, rn_follow_all, NULL},
    {GET, "/v1/camera-paths", 0, 0, rn_list_camera_paths, NULL},
    {POST, "/v1/camera-paths", RENDER, RN_MAX_BODY, rn_create_camera_path, NULL},
    {POST, "/v1/camera-paths/convert", RENDER, RN_MAX_BODY, rn_convert_camera_path, NULL},
    {GET, "/v1/camera-paths/{id}", 0, 0, rn_get_camera_path, NULL},
    {DELETE, "/v1/camera-paths/{id}", RENDER, 0, rn_delete_camera_path, NULL},
    {GET, "/v1/backup", RN_ROUTE_ADMIN, 0, rn_get_backup, NULL},
    {POST, "/v1/backup", RN_ROUTE_ADMIN, 0, rn_adopt_backup, rn_begin_adoption},
    {GET, "/v1/tokens", TRAIN, 0, rn_list_tokens, NULL},
    {POST, "/v1/tokens", TRAIN, RN_MAX_BODY, rn_create_token, NULL},
    {DELETE, "/v1/tokens/{id}", TRAIN, 0, rn_delete_token, NULL},
    {GET, "/", RN_ROUTE_OPEN, 0, rn_get_page, NULL},
    {GET, "/web/*", RN_ROUTE_OPEN, 0, rn_get_page_file, NULL},
    {0},
};

void rn_app_finish(struct rn_app *app) {
    rn_dataset_destroy(&app->dataset);
    rn_access_destroy(&app->access);
}

void rn_api_json(struct rn_reply *reply, int status, char *json) {
    rn_reply_bytes(reply, status, "application/json", (uint8_t *)json, strlen(json));
}

bool rn_api_failed(enum rn_status status, const struct rn_error *err, struct rn_reply *reply) {
    if (status == RN_OK) return false;
    rn_reply_error(reply, err);
    return true;
}

enum rn_status rn_api_number(const char *text, int64_t min, int64_t max, const char *where,
                             int64_t *ret_value, struct rn_error *err) {
    char *end;
    errno = 0;
    long long value = strtoll(text, &end, 10);
    if (text[0] < '0' || text[0] > '9' || *end != '\0' || errno != 0 || value < min || value > max)
        return rn_error_set(err, RN_ERROR_INVALID, where,
                            "must be a whole number from %lld to %lld", (long long)min,
                            (long long)max);
    *ret_value = value;
    return RN_OK;
}

enum rn_status rn_api_page(const struct rn_request *request, int *ret_limit, int64_t *ret_cursor,
                           struct rn_error *err) {
    const char *limit_text = rn_request_query(request, "limit");
    const char *cursor_text = rn_request_query(request, "cursor");
    int64_t limit = 50, cursor = 0;
    enum rn_status status = RN_OK;
    if (limit_text != NULL) status = rn_api_number(limit_text, 1, 200, "limit", &limit, err);
    if (status == RN_OK && cursor_text != NULL &&
        rn_api_number(cursor_text, 1, INT64_MAX, "cursor", &cursor, err) != RN_OK)
        status = rn_error_set(err, RN_ERROR_INVALID, "cursor",
                              "not a cursor of this list; pass the next_cursor of the page before");
    if (status != RN_OK) return status;
    *ret_limit = (int)limit;
    *ret_cursor = cursor;
    return RN_OK;
}

static void reply_items(struct rn_reply *reply, char **items, size_t count, const char *cursor) {
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status =
        rn_encode_list((const char *const *)items, count, cursor, &json, NULL, &err);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_api_list(struct rn_app *app, struct rn_request *request, const struct rn_store_table *table,
                 struct rn_query *query,
                 enum rn_status (*encode)(struct rn_app *app, void *row, char **ret_json,
                                          struct rn_error *err),
                 struct rn_reply *reply) {
    struct rn_error err = {0};
    char *items[200], cursor[32];
    void *rows = NULL;
    size_t count = 0, done = 0;
    int limit;
    enum rn_status status = rn_api_page(request, &limit, &query->before_seq, &err);
    query->limit = limit + 1; // one more, to know whether there is a next page
    if (status == RN_OK) status = rn_store_list(app->store, table, query, &rows, &count, &err);
    size_t shown = count > (size_t)limit ? (size_t)limit : count;
    size_t row_size = rn_store_row_size(table);
    while (status == RN_OK && done < shown) {
        status = encode(app, (char *)rows + done * row_size, &items[done], &err);
        if (status == RN_OK) done++;
    }
    if (!rn_api_failed(status, &err, reply)) {
        // seq is every row's first member.
        if (shown > 0)
            snprintf(cursor, sizeof cursor, "%lld",
                     (long long)*(int64_t *)(void *)((char *)rows + (shown - 1) * row_size));
        reply_items(reply, items, shown, count > shown ? cursor : NULL);
    }
    while (done > 0)
        free(items[--done]);
    rn_rows_finish(table, rows, count);
}
