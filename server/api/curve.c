// What accuracy costs in time: a scene's curve, and the job that measures it.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/curve.h"
#include "server/api/app.h"

// What has changed since it was measured; NULL: nothing.
static const char *changed(const struct rn_curve_record *curve, const struct rn_scene_row *scene,
                           const struct rn_runner_device *device) {
    if (strcmp(curve->digest, scene->digest) != 0) return "the scene's parameters";
    if (device->kernels[0] == '\0') return NULL; // not known yet
    if (strcmp(curve->machine, device->name) != 0) return "the machine";
    if (strcmp(curve->device, device->device) != 0) return "the device";
    if (strcmp(curve->kernels, device->kernels) != 0) return "the kernel set";
    if (curve->threads != device->threads) return "the number of threads";
    return strcmp(curve->version, RN_VERSION) != 0 ? "the version" : NULL;
}

static enum rn_status encode_curve(struct rn_app *app, const struct rn_scene_row *scene,
                                   char **ret_json, struct rn_error *err) {
    struct rn_curve_record curve;
    struct rn_runner_device device;
    char *folder = rn_store_path(app->store, "scenes/%s", scene->id);
    if (folder == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "no memory");
    enum rn_status status = rn_curve_read(folder, &curve, err);
    free(folder);
    if (status == RN_ERROR_NOT_FOUND)
        return rn_error_set(err, status, "",
                            "the curve of scene '%s' was not measured yet; POST here measures it",
                            scene->name);
    if (status != RN_OK) return rn_error_set(err, RN_ERROR_CORRUPT, "", "%.300s", err->text);
    rn_control_device(app->control, &device);
    const char *what = changed(&curve, scene, &device);
    curve.stale = what != NULL;
    snprintf(curve.stale_because, sizeof curve.stale_because, "%s", what ? what : "");
    status = rn_encode(&rn_curve_record_table, &curve, ret_json, NULL, err);
    rn_message_finish(&rn_curve_record_table, &curve);
    return status;
}

void rn_get_curve(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_scene_row scene;
    char *json = NULL;
    enum rn_status status = rn_store_resolve(app->store, &rn_scenes, RN_ID_SCENE,
                                             rn_request_param(request, 0), &scene, &err);
    if (rn_api_failed(status, &err, reply)) return;
    status = encode_curve(app, &scene, &json, &err);
    rn_row_finish(&rn_scenes, &scene);
    if (!rn_api_failed(status, &err, reply)) rn_api_json(reply, 200, json);
}

void rn_measure_curve(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_app *app = context;
    struct rn_error err = {0};
    struct rn_field_errors errors = {0};
    struct rn_curve_options wanted;
    char *options = NULL, *json = NULL, id[RN_ID_MAX];
    size_t size;
    const char *body = (const char *)rn_request_body(request, &size);
    if (size == 0) body = "{}", size = 2;
    if (rn_decode(&rn_curve_options_table, body, size, &wanted, &errors, &err) != RN_OK) {
        rn_reply_invalid(reply, &errors, &err);
        return;
    }
    enum rn_status status = rn_encode(&rn_curve_options_table, &wanted, &options, NULL, &err);
    struct rn_submission submission = {
        .type = RN_JOB_CURVE, .scene = rn_request_param(request, 0), .options = options};
    if (status == RN_OK) status = rn_control_submit(app->control, &submission, id, &json, &err);
    free(options);
    if (status == RN_ERROR_BUSY) {
        rn_reply_problem(reply, RN_PROBLEM_QUEUE_FULL, "%s", err.text);
    } else if (!rn_api_failed(status, &err, reply)) {
        rn_api_json(reply, 202, json);
        rn_reply_header(reply, "Location", "/v1/jobs/%s", id);
    }
}
