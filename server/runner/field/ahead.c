#include "server/runner/field/ahead.h"

#include <stdlib.h>

#include "common/base/log.h"

#define MOST_PIXELS ((size_t)1 << 20) // of the pictures that are kept
#define LOOK 256                      // units to come that are looked at

// What is rendered in one call.
struct call {
    int count;
    size_t units[RN_RENDER_TOGETHER];
    struct rn_render_options options[RN_RENDER_TOGETHER];
    struct rn_render_result results[RN_RENDER_TOGETHER];
};

static size_t pixels_of(const struct rn_render_options *o) {
    return (size_t)o->camera.width * (size_t)o->camera.height;
}

static void forget(struct rn_ahead *ahead, size_t i) {
    ahead->pictures[i] = ahead->pictures[--ahead->count];
}

// The unit's picture out of those that are kept. Those of units before it are not wanted any more:
// somebody else has made them.
static bool take(struct rn_ahead *ahead, size_t unit, struct rn_render_result *ret_result) {
    bool found = false;
    for (size_t i = ahead->count; i-- > 0;) {
        struct rn_ahead_picture *p = &ahead->pictures[i];
        if (p->unit > unit) continue;
        if (p->unit == unit) *ret_result = p->result;
        if (p->unit < unit) rn_render_result_finish(&p->result);
        found |= p->unit == unit;
        forget(ahead, i);
    }
    return found;
}

static bool is_kept(const struct rn_ahead *ahead, size_t unit) {
    for (size_t i = 0; i < ahead->count; i++)
        if (ahead->pictures[i].unit == unit) return true;
    return false;
}

// How many more may be kept that are as large as this one.
static size_t room_for(const struct rn_ahead *ahead, const struct rn_render_options *options) {
    size_t kept = 0, places = RN_AHEAD_MOST - ahead->count;
    for (size_t i = 0; i < ahead->count; i++)
        kept += ahead->pictures[i].pixels;
    size_t fit = kept < MOST_PIXELS ? (MOST_PIXELS - kept) / pixels_of(options) : 0;
    return fit < places ? fit : places;
}

// Units to come whose pictures are of the first one's size.
static void choose_others(const struct rn_ahead *ahead, const struct rn_work *work, size_t most,
                          rn_ahead_describe *describe, void *context, struct call *call) {
    const struct rn_camera *first = &call->options[0].camera;
    for (size_t unit = work->done + 1;
         unit < work->total && unit <= work->done + LOOK && (size_t)call->count < most; unit++) {
        struct rn_render_options *o = &call->options[call->count];
        if (is_kept(ahead, unit) || !describe(context, unit, o)) continue;
        if (o->camera.width != first->width || o->camera.height != first->height) continue;
        call->units[call->count++] = unit;
    }
}

static void keep(struct rn_ahead *ahead, const struct call *call, int i) {
    ahead->pictures[ahead->count++] =
        (struct rn_ahead_picture){call->units[i], pixels_of(&call->options[i]), call->results[i]};
}

static enum rn_status render(struct rn_ahead *ahead, struct rn_work *work, struct rn_field *field,
                             struct call *call, struct rn_error *err) {
    double lent_ms = rn_work_lent_ms(work);
    int made = 0;
    enum rn_status status =
        rn_render_together(work->host->engine, field, call->options, call->count,
                           rn_work_keep_going, work, call->results, &made, err);
    if (status) return status;
    lent_ms = rn_work_lent_ms(work) - lent_ms;
    for (int i = 0; i < made; i++)
        call->results[i].stats.render_ms -= lent_ms / made;
    for (int i = 1; i < made; i++)
        keep(ahead, call, i);
    if (made > 1 && !ahead->told)
        rn_log(RN_LOG_INFO, "several pictures are made in one call of the device, first %d", made);
    ahead->told |= made > 1;
    return RN_OK;
}

enum rn_status rn_ahead_render(struct rn_ahead *ahead, struct rn_work *work, struct rn_field *field,
                               const struct rn_render_options *options, rn_ahead_describe *describe,
                               void *context, struct rn_render_result *ret_result,
                               struct rn_error *err) {
    if (take(ahead, work->done, ret_result)) return RN_OK;
    size_t fit = (size_t)rn_render_fit(work->host->engine, field, options);
    size_t most = fit > 1 ? 1 + room_for(ahead, options) : 1;
    if (most > fit) most = fit;
    if (most == 1) return rn_work_render(work, field, options, ret_result, err);
    struct call *call = malloc(sizeof *call);
    if (!call) return rn_error_set(err, RN_ERROR_NO_MEMORY, "", "out of memory");
    call->count = 1;
    call->options[0] = *options;
    choose_others(ahead, work, most, describe, context, call);
    enum rn_status status = render(ahead, work, field, call, err);
    if (status == RN_OK) *ret_result = call->results[0];
    free(call);
    return status;
}

void rn_ahead_drop(struct rn_ahead *ahead) {
    while (ahead->count > 0)
        rn_render_result_finish(&ahead->pictures[--ahead->count].result);
}
