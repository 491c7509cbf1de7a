// What a budget (milliseconds, dB, quality) becomes: settings of the scene's curve, or of the
// presets' where it was not measured.
#ifndef RN_SERVER_RUNNER_FIELD_BUDGET_H
#define RN_SERVER_RUNNER_FIELD_BUDGET_H

#include "common/settings/curve.h"
#include "proto/curve.h"
#include "server/runner/field/work.h"

void rn_pace_finish(struct rn_pace *pace);

// The curve to go by, and which one that is: "measured", or "stale" where the parameters have
// changed since, or "preset". Valid until the scene's curve changes.
struct rn_budget_curve {
    struct rn_curve curve;
    struct rn_curve_point points[RN_CURVE_POINTS]; // the preset's
    const char *source;
};
void rn_budget_find_curve(struct rn_host *host, struct rn_budget_curve *ret_found);

// The settings that a budget becomes for all pictures of a job, of so many pixels each, in place:
// the budget stays beside them. Nothing without a budget, or where it has become some before.
// *ret_changed: they are to be recorded.
void rn_budget_resolve(struct rn_host *host, const struct rn_field_info *info, double pixels,
                       union rn_setting_value settings[RN_RENDER_SETTINGS], bool *ret_changed);

// The same for a job that has the host's turn: the daemon is told the options, as `table` has them,
// when the budget in its settings has become others.
enum rn_status rn_budget_settle(struct rn_work *work, struct rn_field *field, double pixels,
                                union rn_setting_value settings[RN_RENDER_SETTINGS],
                                const struct rn_table *table, const void *options,
                                struct rn_error *err) RN_MUST_CHECK;

// One picture as the request's budget has it: rn_render_within for a time, else the settings that
// it becomes. Fills what `rendered` says of budgets. `options`: all but the settings are set.
enum rn_status rn_budget_render(struct rn_host *host, const struct rn_wire_render *render,
                                const struct rn_field_info *info, struct rn_field *field,
                                struct rn_render_options *options, struct rn_watch *watch,
                                struct rn_wire_rendered *rendered,
                                struct rn_render_result *ret_result,
                                struct rn_error *err) RN_MUST_CHECK;
// How long a picture's file took to be made: the next one by a deadline leaves room for that. Takes
// from the PSNR expected of the picture what its file loses. `rgb`: as rendered; zero when it was
// not asked for.
void rn_budget_encoded(struct rn_host *host, const struct rn_wire_render *render,
                       const struct rn_picture *rgb, const uint8_t *bytes, size_t size,
                       struct rn_wire_rendered *rendered);

#endif
