#include "proto/curve.h"

#include <string.h>

#include "proto/checks.h"
#include "proto/folder.h"

static const struct rn_table setting_table = {.title = "a point's settings",
                                              .size = sizeof(struct rn_curve_setting),
                                              .settings = &rn_render_settings,
                                              .settings_offset =
                                                  offsetof(struct rn_curve_setting, values),
                                              .as_options = true};

#define S struct rn_curve_point
static const struct rn_field_spec point[] = {
    RN_F_OBJECT(S, setting, RN_REQUIRED, &setting_table),
    RN_F_NUMBER(S, ms_median, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, ms_p95, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, ssim, RN_REQUIRED | RN_NULLABLE, -1, 1),
    RN_F_NUMBER(S, psnr_full, RN_REQUIRED | RN_NULLABLE, -INFINITY, INFINITY),
    RN_F_NUMBER(S, psnr_spread, RN_REQUIRED | RN_NULLABLE, 0, INFINITY),
    RN_F_NUMBER(S, rays, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, samples, RN_REQUIRED, 0, INFINITY),
    RN_F_NUMBER(S, interpolation, 0, 0, INFINITY),
    RN_F_NUMBER(S, roughness, 0, 0, INFINITY),
};
static const struct rn_table point_table = RN_TABLE(S, "a point of a curve", point);
#undef S

#define S struct rn_curve_view
static const struct rn_field_spec view[] = {
    RN_F_NUMBERS(S, position, RN_REQUIRED, -INFINITY, INFINITY),
    RN_F_NUMBER(S, psnr, RN_REQUIRED, -INFINITY, INFINITY),
};
static const struct rn_table view_table = RN_TABLE(S, "a view of a curve", view);
#undef S

#define S struct rn_curve_record
static const struct rn_field_spec record[] = {
    RN_F_TEXT(S, machine, RN_REQUIRED, NULL),
    RN_F_TEXT(S, device, RN_REQUIRED, NULL),
    RN_F_TEXT(S, kernels, RN_REQUIRED, NULL),
    RN_F_INT(S, threads, RN_REQUIRED, 1, 1024),
    RN_F_TEXT(S, version, RN_REQUIRED, NULL),
    RN_F_INT(S, method, 0, 0, INFINITY),
    RN_F_TEXT(S, digest, RN_REQUIRED | RN_NULLABLE, NULL),
    RN_F_INT(S, step, RN_REQUIRED, 0, INFINITY),
    RN_F_TEXT(S, measured_at, RN_REQUIRED, NULL),
    RN_F_BOOL(S, stale, RN_REQUIRED),
    RN_F_TEXT(S, stale_because, 0, NULL),
    RN_F_INT(S, width, RN_REQUIRED, 1, 16384),
    RN_F_INT(S, height, RN_REQUIRED, 1, 16384),
    RN_F_INT(S, views, RN_REQUIRED, 1, 1e6),
    RN_F_BOOL(S, photographs, RN_REQUIRED),
    RN_F_NUMBER(S, seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_OBJECTS(S, points, count, RN_REQUIRED, &point_table, RN_CURVE_POINTS),
    RN_F_OBJECTS(S, around, around_count, RN_REQUIRED, &view_table, RN_CURVE_VIEWS),
};
const struct rn_table rn_curve_record_table = RN_TABLE(S, "a curve", record);
#undef S

#define S struct rn_curve_options
static const struct rn_field_spec options[] = {
    RN_F_INT(S, views, 0, 1, 64),
};
const struct rn_table rn_curve_options_table = RN_TABLE(S, "curve options", options);
#undef S

struct rn_curve rn_curve_in(const struct rn_curve_record *r) {
    return (struct rn_curve){r->points, r->count, r->around, r->around_count, r->width, r->height};
}

const char *rn_curve_changed(const struct rn_curve_record *curve,
                             const struct rn_curve_record *now) {
    if (strcmp(curve->digest, now->digest) != 0) return "the scene's parameters";
    if (curve->method != now->method) return "the way of measuring";
    if (now->kernels[0] == '\0') return NULL;
    if (strcmp(curve->machine, now->machine) != 0) return "the machine";
    if (strcmp(curve->device, now->device) != 0) return "the device";
    if (strcmp(curve->kernels, now->kernels) != 0) return "the kernel set";
    if (curve->threads != now->threads) return "the number of threads";
    return strcmp(curve->version, now->version) != 0 ? "the version" : NULL;
}

enum rn_status rn_curve_read(const char *scene_folder, struct rn_curve_record *ret_record,
                             struct rn_error *err) {
    enum rn_status status =
        rn_folder_read(scene_folder, "curve.json", &rn_curve_record_table, ret_record, err);
    if (status || ret_record->count > 0) return status;
    rn_message_finish(&rn_curve_record_table, ret_record);
    return rn_error_set(err, RN_ERROR_INVALID, scene_folder,
                        "curve.json has no points; measure it again");
}
