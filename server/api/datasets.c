#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/dataset.h"
#include "server/api/app.h"

// `past` (may be NULL): of trainings here.
static enum rn_status encode(const struct rn_dataset_row *row, const struct rn_expected_past *past,
                             char **ret_json, struct rn_error *err) {
    struct rn_dataset_record record;
    enum rn_status status =
        rn_decode(&rn_dataset_contents_table, row->record, strlen(row->record), &record, NULL, err);
    if (status != RN_OK) return status;
    snprintf(record.id, sizeof record.id, "%s", row->id);
    snprintf(record.name, sizeof record.name, "%s", row->name);
    snprintf(record.state, sizeof record.state, "ready");
    rn_time_text(row->created_ms, record.created_at);
    rn_message_init(&rn_expected_past_table, &record.past);
    if (past) record.past = *past;
    status = rn_encode(&rn_dataset_table, &record, ret_json, NULL, err);
    rn_message_finish(&rn_dataset_table, &record);
    return status;
}

static enum rn_status encode_item(struct rn_app *app, void *row, char **ret_json,
                                  struct rn_error *err) {
    (void)app;
    return encode(row, NULL, ret_json, err);
}

void rn_list_datasets(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const char *const known[] = {"limit", "cursor", NULL};
    struct rn_error err = {0};
    struct rn_query query = {0};
    if (rn_api_failed(rn_request_check_query(request, known, &err), &err, reply)) return;
    rn_api_list(context, request, &rn_datasets, &query, encode_item, reply);
}

void rn_get_dataset(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_dataset_row row;
    struct rn_expected_past past;
    char *json = NULL;
    enum rn_status status = rn_store_resolve(app->store, &rn_datasets, RN_ID_DATASET,
                                             rn_request_param(request, 0), &row, &err);
    if (rn_api_failed(status, &err, reply)) return;
    status = rn_control_past(app->control, row.record, &past, &err);
    if (status == RN_OK) status = encode(&row, &past, &json, &err);
    rn_row_finish(&rn_datasets, &row);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_delete_dataset(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    if (!rn_api_may_change(app, request, &rn_datasets, reply)) return;
    enum rn_status status =
        rn_control_delete_dataset(app->control, rn_request_param(request, 0), &err);
    if (rn_api_failed(status, &err, reply)) return;
    rn_dataset_destroy(&app->dataset);
    rn_reply_empty(reply, 204);
}
