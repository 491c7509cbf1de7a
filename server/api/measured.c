// What was measured of a scene, kept in its folder, and the jobs that measure it.
#include <stdlib.h>

#include "server/api/app.h"

static enum rn_status encode(struct rn_app *app, const struct rn_scene_row *scene,
                             const struct rn_measured *kind, void *record, char **ret_json,
                             struct rn_error *err) {
    char *folder = rn_store_path(app->store, "scenes/%s", scene->id);
    if (folder == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory");
    enum rn_status status = kind->read(folder, record, err);
    free(folder);
    if (status == RN_ERROR_NOT_FOUND)
        return rn_error_set(err, status, "",
                            "%s of scene '%s'%s was not measured yet: ripnerf %s %s --measure, or "
                            "POST here",
                            kind->what, scene->name, kind->does, kind->verb, scene->name);
    if (status != RN_OK) return rn_error_set(err, RN_ERROR_CORRUPT, "", "%.300s", err->text);
    if (kind->complete) kind->complete(app, scene, record);
    status = rn_encode(kind->table, record, ret_json, NULL, err);
    rn_message_finish(kind->table, record);
    return status;
}

void rn_api_get_measured(struct rn_app *app, struct rn_request *request,
                         const struct rn_measured *kind, void *record, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_scene_row scene;
    char *json = NULL;
    enum rn_status status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE,
                                             rn_request_param(request, 0), &scene, &err);
    if (rn_api_failed(status, &err, reply)) return;
    status = encode(app, &scene, kind, record, &json, &err);
    rn_row_finish(&rn_scenes, &scene);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_api_measure(struct rn_app *app, struct rn_request *request, enum rn_job_type type,
                    const struct rn_table *table, void *wanted, struct rn_reply *reply) {
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    char *options = NULL, *json = NULL, id[RN_ID_MAX];
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    if (size == 0) body = "{}", size = 2;
    if (rn_decode(table, body, size, wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    enum rn_status status = rn_encode(table, wanted, &options, NULL, &err);
    struct rn_submission submission = {.type = type,
                                       .scene = rn_request_param(request, 0),
                                       .options = options,
                                       .caller = rn_request_caller(request),
                                       .traceparent = rn_request_traceparent(request)};
    if (status == RN_OK) status = rn_control_submit(app->control, &submission, id, &json, &err);
    free(options);
    if (status == RN_ERROR_BUSY) {
        rn_reply_problem(reply, RN_PROBLEM_QUEUE_FULL, "%s", err.text);
    } else if (!rn_api_failed(status, &err, reply)) {
        rn_api_json(reply, 202, json);
        rn_reply_header(reply, "Location", "/v1/jobs/%s", id);
    }
}
