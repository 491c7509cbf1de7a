// What accuracy costs in time: a scene's curve, and the job that measures it.
#include <stdio.h>

#include "proto/curve.h"
#include "server/api/app.h"

static enum rn_status read_curve(const char *folder, void *record, struct rn_error *err) {
    return rn_curve_read(folder, record, err);
}

static void tell_stale(struct rn_app *app, const struct rn_scene_row *scene, void *record) {
    struct rn_curve_record *curve = record, now = {.method = RN_CURVE_METHOD};
    struct rn_runner_device device;
    rn_control_device(app->control, &device);
    now.threads = device.threads;
    snprintf(now.machine, sizeof now.machine, "%s", device.name);
    snprintf(now.device, sizeof now.device, "%s", device.device);
    snprintf(now.kernels, sizeof now.kernels, "%s", device.kernels);
    snprintf(now.version, sizeof now.version, "%s", RN_VERSION);
    snprintf(now.digest, sizeof now.digest, "%s", scene->digest);
    const char *what = rn_curve_changed(curve, &now);
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
