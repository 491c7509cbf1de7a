// What a budget (milliseconds, dB, quality) becomes: settings of the scene's curve, or of the
// presets' where it was not measured.
#ifndef RN_SERVER_RUNNER_FIELD_BUDGET_H
#define RN_SERVER_RUNNER_FIELD_BUDGET_H

#include "common/settings/curve.h"
#include "proto/curve.h"
#include "server/runner/field/work.h"

void rn_pace_finish(struct rn_pace *pace);
// What a curve that is measured here and now is of, but for its digest and its pictures.
void rn_curve_place(const struct rn_host *host, struct rn_curve_record *ret_record);

// The pictures of a job that a budget is for: those whose cost may be the most, in their order.
struct rn_budget_pictures {
    size_t count; // at least 1
    // Picture i of them as it will be rendered, but for its settings.
    void (*describe)(void *context, size_t i, struct rn_render_options *ret_options);
    void *context;
};
// The settings that a budget becomes for all pictures of a job, in place: the budget stays beside
// them. Within a time, some of `pictures` are made in the quickest way, and of these the one that
// takes the most samples a few times, so that what else the cores do counts; where pixels are seen
// from many places (a lens, a shutter), the time decides from how many. Nothing without a budget,
// or where it has become some before. The job has the host's turn; the daemon is told the options,
// as `table` has them, when they changed. RN_ERROR_CANCELLED, rn_render's.
enum rn_status rn_budget_settle(struct rn_work *work, struct rn_field *field,
                                const struct rn_budget_pictures *pictures,
                                union rn_setting_value settings[RN_RENDER_SETTINGS],
                                const struct rn_table *table, const void *options,
                                struct rn_error *err) RN_MUST_CHECK;

// What is told of such a job: the settings that its budget became ("": it had none), and by the
// curve as it is now, while that has them, the PSNR to expect of its pictures, as they are worth on
// average, and how far views lie apart; else NAN.
struct rn_budget_told {
    char setting[96];
    double expected_psnr, expected_spread;
};
void rn_budget_tell(struct rn_host *host, const struct rn_field *field,
                    const union rn_setting_value settings[RN_RENDER_SETTINGS],
                    struct rn_budget_told *ret_told);

// One picture as the request's budget has it: rn_render_within for a time, else the settings that
// it becomes. Fills what `rendered` says of budgets. `options`: all but the settings are set.
enum rn_status rn_budget_render(struct rn_host *host, const struct rn_wire_render *render,
                                const struct rn_field_info *info, struct rn_field *field,
                                struct rn_render_options *options, struct rn_watch *watch,
                                struct rn_wire_rendered *rendered,
                                struct rn_render_result *ret_result,
                                struct rn_error *err) RN_MUST_CHECK;
// How long a picture's file took to be made: the next one by a deadline leaves room for that. Takes
// from the PSNR expected of the picture what its file loses; `missed`, where less than the PSNR
// that was asked for is expected then. `rgb`: as rendered; zero when it was
// not asked for.
void rn_budget_encoded(struct rn_host *host, const struct rn_wire_render *render,
                       const struct rn_picture *rgb, const uint8_t *bytes, size_t size,
                       struct rn_wire_rendered *rendered);
// Looks at what a JPEG loses, once it is sent: of a picture by a deadline there is no time for that
// before, and the next ones know it. `picture_psnr`: expected of the picture before it became a
// file.
void rn_budget_look(struct rn_host *host, const struct rn_wire_render *render,
                    const struct rn_picture *rgb, const uint8_t *bytes, size_t size,
                    double picture_psnr);

#endif
