#include "server/runner/budget.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"

#define REPLY_NS 700000.0 // from the file to the last byte handed over
#define ENCODE_MARGIN 1.2
#define LEAST_MARGIN_NS 200000.0
#define MOST_MARGIN 0.25 // of the time asked for
#define MARGIN_STEP_NS 400000.0
#define IN_TIME 99   // pictures for one that may be late
#define HOPELESS 0.5 // of the time asked for

// Of a pixel, before one was encoded.
static const double encode_ns[] = {[RN_FORMAT_PNG] = 60, [RN_FORMAT_JPEG] = 20};

void rn_pace_finish(struct rn_pace *pace) {
    rn_message_finish(&rn_curve_record_table, &pace->record);
    *pace = (struct rn_pace){0};
}

static void look_for_curve(struct rn_host *host) {
    struct rn_error err = {0};
    if (host->pace.looked) return;
    host->pace.looked = true;
    enum rn_status status = rn_curve_read(host->place.scene_folder, &host->pace.record, &err);
    if (status == RN_OK || status == RN_ERROR_NOT_FOUND) return;
    host->pace.record = (struct rn_curve_record){0};
    rn_log(RN_LOG_WARN, "the curve is not used: %s: %s", err.where, err.text);
}

void rn_budget_find_curve(struct rn_host *host, struct rn_budget_curve *ret_found) {
    look_for_curve(host);
    const struct rn_curve_record *record = &host->pace.record;
    if (record->count == 0) {
        rn_curve_of_presets(ret_found->points, &ret_found->curve);
        ret_found->source = "preset";
        return;
    }
    bool same = !host->training && strcmp(record->digest, host->digest) == 0;
    ret_found->curve = rn_curve_in(record);
    ret_found->source = same ? "measured" : "stale";
}

static void put_settings(const struct rn_curve_point *point,
                         union rn_setting_value settings[RN_RENDER_SETTINGS]) {
    memcpy(settings, point->setting.values, RN_RENDER_BUDGET * sizeof *settings);
}

static bool has_settings(const union rn_setting_value settings[RN_RENDER_SETTINGS]) {
    for (size_t i = 0; i < RN_RENDER_BUDGET; i++)
        if (!rn_setting_is_absent(&rn_render_settings.rows[i], &settings[i])) return true;
    return false;
}

void rn_budget_resolve(struct rn_host *host, const struct rn_field_info *info, double pixels,
                       union rn_setting_value settings[RN_RENDER_SETTINGS], bool *ret_changed) {
    struct rn_budget_curve found;
    double number;
    bool missed;
    enum rn_budget_kind kind = rn_budget_of(settings, &number);
    *ret_changed = kind != RN_BUDGET_NONE && !has_settings(settings);
    if (!*ret_changed) return;
    rn_budget_find_curve(host, &found);
    size_t point = rn_curve_choose(&found.curve, kind, number, pixels, info->psnr, &missed);
    put_settings(&found.curve.points[point], settings);
    // The full picture's settings are none: what says so, so that the budget is resolved once.
    if (!has_settings(settings))
        *rn_settings_value(&rn_render_settings, settings, "tolerance") =
            (union rn_setting_value){.number = 0};
}

enum rn_status rn_budget_settle(struct rn_work *work, struct rn_field *field, double pixels,
                                union rn_setting_value settings[RN_RENDER_SETTINGS],
                                const struct rn_table *table, const void *options,
                                struct rn_error *err) {
    struct rn_wire_resolved resolved = {.options = NULL};
    struct rn_field_info info;
    bool changed;
    rn_field_describe(field, &info);
    rn_budget_resolve(work->host, &info, pixels, settings, &changed);
    if (!changed) return RN_OK;
    enum rn_status status = rn_encode(table, options, &resolved.options, NULL, err);
    if (status) return status;
    snprintf(resolved.job, sizeof resolved.job, "%s", work->job);
    rn_link_post(&work->host->link, RN_WIRE_RESOLVED, &resolved, NULL, 0);
    free(resolved.options);
    return RN_OK;
}

// ---- one picture ----------------------------------------------------------------------------

static void tell(const struct rn_budget_curve *found, size_t point,
                 const struct rn_render_settings *used, const struct rn_camera *camera, double psnr,
                 struct rn_wire_rendered *rendered) {
    double place[3];
    const struct rn_curve_point *p = &found->curve.points[point];
    struct rn_curve_setting setting = p->setting;
    *rn_settings_value(&rn_render_settings, setting.values, "tolerance") =
        (union rn_setting_value){.number = used->tolerance < 1e-6 ? 0 : used->tolerance};
    rn_curve_setting_text(&setting, rendered->setting, sizeof rendered->setting);
    for (int i = 0; i < 3; i++)
        place[i] = camera->world_from_camera[i][3];
    rendered->expected_psnr = rn_curve_expected_with(&found->curve, point, used->tolerance, psnr) +
                              rn_curve_here(&found->curve, place);
    rendered->expected_spread = isnan(p->psnr) ? NAN : p->psnr_spread;
    snprintf(rendered->curve, sizeof rendered->curve, "%s", found->source);
}

static enum rn_status render_by_deadline(struct rn_host *host, const struct rn_wire_render *render,
                                         const struct rn_field_info *info, struct rn_field *field,
                                         const struct rn_render_options *options,
                                         struct rn_watch *watch, struct rn_wire_rendered *rendered,
                                         struct rn_render_result *ret_result,
                                         struct rn_error *err) {
    struct rn_budget_curve found;
    struct rn_render_choice choices[RN_CURVE_POINTS];
    struct rn_render_spent spent;
    rn_budget_find_curve(host, &found);
    double pixels = (double)options->camera.width * (double)options->camera.height;
    double scale = pixels / rn_curve_pixels(&found.curve);
    for (size_t i = 0; i < found.curve.count; i++) {
        choices[i] = (struct rn_render_choice){.ms = found.curve.points[i].ms_median * scale,
                                               .rays = found.curve.points[i].rays * scale};
        rn_settings_put(&rn_render_settings, found.curve.points[i].setting.values,
                        &choices[i].settings);
    }
    int format = rn_name_or(render->render.format, RN_FORMAT_PNG);
    double pixel_ns =
        host->pace.encode_ns[format] > 0 ? host->pace.encode_ns[format] : encode_ns[format];
    double asked_ms, margin_ns = fmax(host->pace.margin_ns, LEAST_MARGIN_NS);
    rn_budget_of(render->render.settings, &asked_ms);
    margin_ns = fmin(margin_ns, MOST_MARGIN * asked_ms * 1e6);
    double reserve_ns = ENCODE_MARGIN * pixel_ns * pixels + REPLY_NS + margin_ns;
    struct rn_render_budget budget = {.choices = choices,
                                      .count = found.curve.count,
                                      .deadline_ns = render->deadline_ns - (int64_t)reserve_ns,
                                      .slowness =
                                          host->pace.slowness > 0 ? host->pace.slowness : 1};
    enum rn_status status = rn_render_within(host->engine, field, options, &budget,
                                             rn_watch_keep_going, watch, ret_result, &spent, err);
    if (status) return status;
    host->pace.slowness = budget.slowness;
    rendered->render_ms = spent.ms;
    tell(&found, spent.choice, &spent.settings, &options->camera, info->psnr, rendered);
    return RN_OK;
}

enum rn_status rn_budget_render(struct rn_host *host, const struct rn_wire_render *render,
                                const struct rn_field_info *info, struct rn_field *field,
                                struct rn_render_options *options, struct rn_watch *watch,
                                struct rn_wire_rendered *rendered,
                                struct rn_render_result *ret_result, struct rn_error *err) {
    struct rn_budget_curve found;
    double number;
    enum rn_budget_kind kind = rn_budget_of(render->render.settings, &number);
    if (kind == RN_BUDGET_TIME && render->deadline_ns != RN_ABSENT)
        return render_by_deadline(host, render, info, field, options, watch, rendered, ret_result,
                                  err);
    size_t point = 0;
    if (kind != RN_BUDGET_NONE) {
        rn_budget_find_curve(host, &found);
        point = rn_curve_choose(&found.curve, kind, number,
                                (double)options->camera.width * (double)options->camera.height,
                                info->psnr, &rendered->missed);
        rn_settings_put(&rn_render_settings, found.curve.points[point].setting.values,
                        &options->settings);
    }
    enum rn_status status =
        rn_render(host->engine, field, options, rn_watch_keep_going, watch, ret_result, err);
    if (status) return status;
    rendered->render_ms = ret_result->stats.render_ms;
    if (kind != RN_BUDGET_NONE)
        tell(&found, point, &options->settings, &options->camera, info->psnr, rendered);
    return RN_OK;
}

void rn_budget_encoded(struct rn_host *host, const struct rn_wire_render *render,
                       const struct rn_wire_rendered *rendered) {
    double pixels = (double)rendered->width * (double)rendered->height;
    double *kept = &host->pace.encode_ns[rendered->format];
    double now = rendered->encode_ms * 1e6 / pixels;
    if (pixels >= 1e4) *kept = *kept > 0 ? 0.8 * *kept + 0.2 * now : now;
    double asked_ms, *margin = &host->pace.margin_ns;
    if (rn_budget_of(render->render.settings, &asked_ms) != RN_BUDGET_TIME) return;
    // How late it will be. A picture in time lets the margin shrink a little; one that never had a
    // chance teaches nothing.
    double late_ns = (double)(rn_clock_ns() - render->deadline_ns) + REPLY_NS;
    if (late_ns < HOPELESS * asked_ms * 1e6)
        *margin =
            late_ns > 0 ? *margin + MARGIN_STEP_NS : fmax(*margin - MARGIN_STEP_NS / IN_TIME, 0);
}
