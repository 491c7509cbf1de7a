// Interactive renders: parked HTTP requests that a runner's picture answers.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/sha256.h"
#include "common/settings/curve.h"
#include "server/jobs/inside.h"

#define RENDER_TIMEOUT_MS 120000
#define HOPELESS 0.5 // of the time asked for, late

const double rn_render_ms_bounds[9] = {10, 25, 50, 100, 250, 500, 1000, 2500, 10000};

enum rn_status rn_control_etag(struct rn_control *control, const struct rn_scene_row *scene,
                               const struct rn_render_request *request, char ret_etag[RN_ETAG_MAX],
                               struct rn_error *err) {
    ret_etag[0] = '\0';
    rn_control_lock(control);
    const struct rn_task *task = rn_task_training(control, scene->id);
    bool trains = task != NULL;
    bool has_runner = trains && task->runner != NULL;
    struct rn_runner_device device = control->device;
    rn_control_unlock(control);
    if (scene->sha256[0] == '\0' && !has_runner)
        return rn_error_set(err, RN_ERROR_CONFLICT, "",
                            "scene '%s' has no checkpoint yet: there is nothing to render",
                            scene->name);
    // Before the probe has answered, or the checkpoint was opened once, nothing identifies a
    // picture.
    if (trains || device.kernels[0] == '\0' || scene->digest[0] == '\0') return RN_OK;
    double budget; // what it becomes depends on the hour
    if (rn_budget_of(request->settings, &budget) != RN_BUDGET_NONE) return RN_OK;
    char *json = NULL, head[256], hex[65];
    size_t size;
    enum rn_status status = rn_encode(&rn_render_request_table, request, &json, &size, err);
    if (status != RN_OK) return status;
    struct rn_sha256 hash;
    int head_size =
        snprintf(head, sizeof head, "%s %lld %s %s %s ", scene->id, (long long)scene->steps,
                 scene->digest, device.kernels, control->options.version);
    rn_sha256_init(&hash);
    rn_sha256_update(&hash, head, (size_t)head_size);
    rn_sha256_update(&hash, json, size);
    rn_sha256_final_hex(&hash, hex);
    free(json);
    snprintf(ret_etag, RN_ETAG_MAX, "\"%.40s\"", hex);
    return RN_OK;
}

static void free_render(struct rn_render *render) {
    rn_message_finish(&rn_render_request_table, &render->request);
    free(render);
}

static struct rn_render *take(struct rn_runner *runner, int64_t number) {
    for (struct rn_render **link = &runner->renders; *link != NULL; link = &(*link)->next) {
        struct rn_render *render = *link;
        if (render->number != number) continue;
        *link = render->next;
        return render;
    }
    return NULL;
}

// A client has left, or was told that it took too long.
static void on_gone(void *context, struct rn_parked *parked) {
    struct rn_control *control = context;
    bool found = false;
    rn_control_lock(control);
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        for (struct rn_render *render = runner->renders; render != NULL; render = render->next) {
            struct rn_waiter **link = &render->waiters;
            while (*link != NULL && (*link)->parked != parked)
                link = &(*link)->next;
            struct rn_waiter *waiter = *link;
            if (waiter == NULL) continue;
            found = true;
            *link = waiter->next;
            free(waiter);
            if (render->waiters != NULL || !render->sent) continue;
            struct rn_wire_cancel cancel = {.request = render->number};
            control->stats.renders_cancelled++;
            rn_runner_post(control, runner, RN_WIRE_CANCEL, &cancel);
        }
    }
    if (found) rn_parked_answer(parked, NULL);
    rn_control_unlock(control);
}

static struct rn_render *find_equal(struct rn_runner *runner, const char *etag) {
    if (etag[0] == '\0') return NULL;
    for (struct rn_render *render = runner->renders; render != NULL; render = render->next)
        if (strcmp(render->etag, etag) == 0 && render->waiters != NULL) return render;
    return NULL;
}

static struct rn_render *add_render(struct rn_control *control, struct rn_runner *runner,
                                    const struct rn_render_request *request, const char *etag,
                                    int64_t step, int64_t begin_ns) {
    struct rn_render *render = calloc(1, sizeof *render);
    if (render == NULL) return NULL;
    render->request = *request;
    snprintf(render->etag, sizeof render->etag, "%s", etag);
    render->step = step;
    render->number = ++control->next_render;
    render->begin_ns = begin_ns;
    struct rn_render **link = &runner->renders;
    while (*link != NULL)
        link = &(*link)->next;
    *link = render;
    return render;
}

static enum rn_status enqueue(struct rn_control *control, const struct rn_scene_row *scene,
                              const struct rn_render_request *render_request, const char *etag,
                              struct rn_request *request, struct rn_error *err) {
    struct rn_runner *runner;
    struct rn_waiter *waiter = calloc(1, sizeof *waiter);
    if (waiter == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "render", "no memory");
    enum rn_status status = rn_runner_for_scene(control, scene->id, true, &runner, err);
    if (status == RN_OK)
        status =
            rn_request_park(request, RENDER_TIMEOUT_MS, on_gone, control, &waiter->parked, err);
    if (status != RN_OK) {
        free(waiter);
        return status;
    }
    struct rn_render *render = find_equal(runner, etag);
    if (render == NULL)
        render = add_render(control, runner, render_request, etag, scene->steps,
                            rn_request_begin_ns(request));
    if (render == NULL) {
        struct rn_reply reply = {0};
        rn_reply_problem(&reply, RN_PROBLEM_INTERNAL, "no memory for a render");
        rn_parked_answer(waiter->parked, &reply);
        free(waiter);
        return RN_OK;
    }
    waiter->next = render->waiters;
    render->waiters = waiter;
    if (runner->state == RN_RUNNER_READY) rn_render_send(control, runner);
    return RN_OK;
}

void rn_control_render(struct rn_control *control, const struct rn_scene_row *scene,
                       const struct rn_render_request *render, const char *etag,
                       struct rn_request *request, struct rn_reply *reply) {
    struct rn_error err = {0};
    rn_control_lock(control);
    enum rn_status status = enqueue(control, scene, render, etag, request, &err);
    rn_control_unlock(control);
    if (status != RN_OK) rn_reply_error(reply, &err);
}

static int64_t deadline_of(const struct rn_render *render) {
    double number;
    if (rn_budget_of(render->request.settings, &number) != RN_BUDGET_TIME) return RN_ABSENT;
    return render->begin_ns + (int64_t)(number * 1e6);
}

void rn_render_send(struct rn_control *control, struct rn_runner *runner) {
    for (struct rn_render *render = runner->renders; render != NULL; render = render->next) {
        if (render->sent) continue;
        struct rn_wire_render message = {.request = render->number,
                                         .render = render->request,
                                         .deadline_ns = deadline_of(render),
                                         .needed_ms =
                                             runner->timed.number ? runner->timed.needed_ms : NAN};
        if (message.deadline_ns != RN_ABSENT) runner->timed.needed_ms = NAN;
        render->sent = true;
        rn_runner_post(control, runner, RN_WIRE_RENDER, &message);
    }
    rn_hold_others(control);
}

// What a budget was spent on. Late: the time is over, or less than was asked for is expected.
static void tell_budget(struct rn_reply *reply, const struct rn_render *render,
                        const struct rn_wire_rendered *rendered) {
    double asked, spent_ms = (double)(rn_clock_ns() - render->begin_ns) * 1e-6;
    enum rn_budget_kind kind = rn_budget_of(render->request.settings, &asked);
    if (kind == RN_BUDGET_NONE) return;
    bool late = kind == RN_BUDGET_TIME ? spent_ms > asked : rendered->missed;
    if (kind == RN_BUDGET_TIME) rn_reply_header(reply, "X-Ripnerf-Asked-Ms", "%.6g", asked);
    rn_reply_header(reply, "X-Ripnerf-Spent-Ms", "%.1f", spent_ms);
    rn_reply_header(reply, "X-Ripnerf-Setting", "%s", rendered->setting);
    rn_reply_header(reply, "X-Ripnerf-Curve", "%s", rendered->curve);
    if (!isnan(rendered->expected_psnr))
        rn_reply_header(reply, "X-Ripnerf-Expected-Psnr", "%.2f", rendered->expected_psnr);
    if (!isnan(rendered->expected_spread))
        rn_reply_header(reply, "X-Ripnerf-Expected-Spread", "%.2f", rendered->expected_spread);
    rn_reply_header(reply, "X-Ripnerf-Late", "%d", late);
}

// Where there are other machines: which one made it, and why it was this one.
static void tell_machine(struct rn_reply *reply, const struct rn_runner *runner) {
    if (runner->process.remote)
        rn_reply_header(reply, "X-Ripnerf-Machine", "%s", runner->where.machine);
    else if (runner->where.reason[0] != '\0')
        rn_reply_header(reply, "X-Ripnerf-Machine", "the daemon's; Slurm: %s",
                        runner->where.reason);
}

static void fill_reply(struct rn_reply *reply, const struct rn_render *render,
                       const struct rn_wire_rendered *rendered, uint8_t *copy, size_t size) {
    double total_ms = (double)(rn_clock_ns() - render->begin_ns) * 1e-6;
    double queue_ms = total_ms - rendered->render_ms - rendered->encode_ms;
    // Of another step: its checkpoint was damaged, and the one before took its place.
    bool cacheable =
        render->etag[0] != '\0' && !rendered->training && rendered->step == render->step;
    rn_reply_bytes(reply, 200, rn_picture_format_types[rendered->format], copy, size);
    rn_reply_header(reply, "Server-Timing", "queue;dur=%.1f, render;dur=%.1f, encode;dur=%.1f",
                    queue_ms > 0 ? queue_ms : 0, rendered->render_ms, rendered->encode_ms);
    rn_reply_header(reply, "X-Ripnerf-Step", "%lld", (long long)rendered->step);
    rn_reply_header(reply, "X-Ripnerf-Samples", "%lld", (long long)rendered->samples);
    if (!isnan(rendered->at)) rn_reply_header(reply, "X-Ripnerf-At", "%.2f", rendered->at);
    if (!isnan(rendered->scale_high) && rn_output_kind_units[render->request.output])
        rn_reply_header(reply, "X-Ripnerf-Scale", "0 %g %s", rendered->scale_high,
                        rn_output_kind_units[render->request.output]);
    rn_reply_header(reply, "Cache-Control", cacheable ? "no-cache" : "no-store");
    if (cacheable) rn_reply_header(reply, "ETag", "%s", render->etag);
    if (*rendered->effects)
        rn_reply_header(reply, "X-Ripnerf-Effects", "%s; cones=%lld", rendered->effects,
                        (long long)rendered->cones);
    tell_budget(reply, render, rendered);
}

// What a picture by a deadline needed kept free, by when its last byte went. What never had a
// chance teaches nothing.
static void on_sent(void *context, int64_t number, int64_t sent_ns) {
    struct rn_control *control = context;
    rn_control_lock(control);
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        struct rn_last_timed *timed = &runner->timed;
        double late_ms = (double)(sent_ns - timed->deadline_ns) * 1e-6;
        if (timed->number == number && late_ms < HOPELESS * timed->asked_ms)
            timed->needed_ms = timed->kept_ms + late_ms;
    }
    rn_control_unlock(control);
}

static void follow_timed(struct rn_control *control, struct rn_runner *runner,
                         const struct rn_render *render, const struct rn_wire_rendered *rendered,
                         struct rn_reply *reply) {
    double asked_ms;
    if (rn_budget_of(render->request.settings, &asked_ms) != RN_BUDGET_TIME) return;
    runner->timed = (struct rn_last_timed){render->number, deadline_of(render), asked_ms,
                                           rendered->kept_ms, NAN};
    reply->on_sent = on_sent;
    reply->sent_context = control;
    reply->sent_number = render->number;
}

// A picture by a budget went by a curve that is not of now, or by none: where all pictures are made
// on one machine it is measured when there is time.
static void want_curve(struct rn_control *control, const struct rn_runner *runner,
                       const struct rn_wire_rendered *rendered) {
    bool other = *rendered->curve && strcmp(rendered->curve, "measured") != 0;
    if (other && !rendered->training && control->executor->look == NULL)
        rn_idle_want_curve(control, runner->scene);
}

static void count(struct rn_control *control, const struct rn_render *render) {
    double ms = (double)(rn_clock_ns() - render->begin_ns) * 1e-6;
    int bucket = 0;
    while (bucket < 9 && ms > rn_render_ms_bounds[bucket])
        bucket++;
    control->stats.render_ms_buckets[bucket]++;
    control->stats.render_ms_sum += ms;
    control->stats.renders++;
}

void rn_render_done(struct rn_control *control, struct rn_runner *runner,
                    const struct rn_wire_rendered *rendered, const uint8_t *blob, size_t size) {
    struct rn_render *render = take(runner, rendered->request);
    if (render == NULL) return;
    count(control, render);
    want_curve(control, runner, rendered);
    if (!runner->process.remote) rn_hold_after(control, render);
    runner->last_used_ns = rn_clock_ns();
    while (render->waiters != NULL) {
        struct rn_waiter *waiter = render->waiters;
        struct rn_reply reply = {0};
        uint8_t *copy = malloc(size > 0 ? size : 1);
        if (copy != NULL && size > 0) {
            memcpy(copy, blob, size);
            fill_reply(&reply, render, rendered, copy, size);
            tell_machine(&reply, runner);
            follow_timed(control, runner, render, rendered, &reply);
        } else {
            free(copy);
            rn_reply_problem(&reply, RN_PROBLEM_INTERNAL, "no memory for the picture");
        }
        render->waiters = waiter->next;
        rn_parked_answer(waiter->parked, &reply);
        free(waiter);
    }
    free_render(render);
}

static void fail(struct rn_control *control, struct rn_render *render, const struct rn_error *err) {
    if (err->status != RN_ERROR_CANCELLED) control->stats.renders_failed++;
    while (render->waiters != NULL) {
        struct rn_waiter *waiter = render->waiters;
        struct rn_reply reply = {0};
        rn_reply_error(&reply, err);
        render->waiters = waiter->next;
        rn_parked_answer(waiter->parked, &reply);
        free(waiter);
    }
    free_render(render);
}

void rn_render_failed(struct rn_control *control, struct rn_runner *runner, int64_t number,
                      const struct rn_error *err) {
    struct rn_render *render = take(runner, number);
    if (render != NULL) fail(control, render, err);
}

void rn_render_fail_all(struct rn_control *control, struct rn_runner *runner,
                        const struct rn_error *err) {
    while (runner->renders != NULL)
        fail(control, take(runner, runner->renders->number), err);
}
