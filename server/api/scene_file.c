// POST /v1/scenes: a scene that was exported for viewing comes back.
#include <stdio.h>
#include <stdlib.h>

#include "proto/checks.h"
#include "proto/scene.h"
#include "server/api/app.h"

#define SCENE_TYPE "application/octet-stream"

// Name and dataset stand in the query; the dataset becomes its id.
static enum rn_status read_query(struct rn_app *app, struct rn_request *request,
                                 const char **ret_name, struct rn_scene_import_options *options,
                                 struct rn_error *err) {
    static const char *const known[] = {"name", "dataset", NULL};
    struct rn_dataset_row row;
    rn_message_init(&rn_scene_import_options_table, options);
    enum rn_status status = rn_request_check_query(request, known, err);
    if (status != RN_OK) return status;
    const char *name = rn_request_query(request, "name");
    const char *dataset = rn_request_query(request, "dataset");
    const char *wrong = name == NULL ? "the query must name the scene" : rn_check_name(name);
    if (wrong != NULL) return rn_error_set(err, RN_ERROR_INVALID, "name", "%s", wrong);
    *ret_name = name;
    if (dataset == NULL) return RN_OK;
    status = rn_store_resolve(app->store, &rn_datasets, RN_ID_DATASET, dataset, &row, err);
    if (status != RN_OK) return status;
    snprintf(options->dataset, sizeof options->dataset, "%s", row.id);
    rn_row_finish(&rn_datasets, &row);
    return RN_OK;
}

static enum rn_status check_free(struct rn_app *app, const char *name, struct rn_error *err) {
    struct rn_scene_row row;
    if (rn_store_find(app->store, &rn_scenes, "name", name, &row, NULL) != RN_OK) return RN_OK;
    rn_row_finish(&rn_scenes, &row);
    return rn_error_set(err, RN_ERROR_CONFLICT, "name",
                        "there is a scene '%s'; choose another name or delete that one", name);
}

void rn_begin_scene(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_import_options options;
    const char *name = NULL;
    if (!rn_request_has_type(request, SCENE_TYPE)) return;
    enum rn_status status = read_query(app, request, &name, &options, &err);
    if (status == RN_OK) status = check_free(app, name, &err);
    if (status == RN_OK) status = rn_api_spool(app, request, &err);
    (void)rn_api_failed(status, &err, reply);
}

void rn_create_scene(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_import_options options;
    const char *name = NULL;
    char *json = NULL;
    uint64_t size = 0;
    const char *spooled = rn_request_spooled(request, &size);
    enum rn_status status = read_query(app, request, &name, &options, &err);
    if (status == RN_OK && (spooled == NULL || size == 0))
        status = rn_error_set(
            &err, RN_ERROR_INVALID, "body",
            "holds no scene: send what an export job wrote (as: scene), as " SCENE_TYPE);
    if (status == RN_OK)
        status = rn_encode(&rn_scene_import_options_table, &options, &json, NULL, &err);
    if (rn_api_failed(status, &err, reply)) return;
    const struct rn_submission wanted = {.type = RN_JOB_INGEST,
                                         .scene = name,
                                         .spooled = spooled,
                                         .upload_bytes = (int64_t)size,
                                         .caller = rn_request_caller(request),
                                         .traceparent = rn_request_traceparent(request),
                                         .options = json};
    rn_api_submit(app, &wanted, request, reply);
    free(json);
}
