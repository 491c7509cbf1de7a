// What accuracy costs in time: a scene's curve, and the job that measures it.
#include <stdio.h>
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

static enum rn_status read_curve(const char *folder, void *record, struct rn_error *err) {
    return rn_curve_read(folder, record, err);
}

static void tell_stale(struct rn_app *app, const struct rn_scene_row *scene, void *record) {
    struct rn_curve_record *curve = record;
    struct rn_runner_device device;
    rn_control_device(app->control, &device);
    const char *what = changed(curve, scene, &device);
    curve->stale = what != NULL;
    snprintf(curve->stale_because, sizeof curve->stale_because, "%s", what ? what : "");
}

void rn_get_curve(void *context, struct rn_request *request, struct rn_reply *reply) {
    static const struct rn_measured kind = {.what = "the curve",
                                            .does = "",
                                            .verb = "curve",
                                            .table = &rn_curve_record_table,
                                            .read = read_curve,
                                            .complete = tell_stale};
    struct rn_curve_record curve;
    rn_api_get_measured(context, request, &kind, &curve, reply);
}

void rn_measure_curve(void *context, struct rn_request *request, struct rn_reply *reply) {
    struct rn_curve_options wanted;
    rn_api_measure(context, request, RN_JOB_CURVE, &rn_curve_options_table, &wanted, reply);
}
