// A calibration: the beginning of the training that was asked for, looked at three times, which
// says how the whole will do. Nothing of it is kept.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "proto/estimate.h"
#include "server/runner/field/host.h"
#include "server/runner/scene/describe.h"

#define LONGEST_S 60.0 // a training that is asked for longer is begun as one of that
#define LATEST 0.8     // of the training, the last look
#define PROGRESS_S 0.5
#define CHECKPOINTS 2 // kept of a training

struct rn_calibrating {
    char job[RN_ID_MAX];
    struct rn_train_config config; // as asked for
    struct rn_trainer *trainer;    // NULL before it began
    int look;                      // that is next
    int64_t first_steps;           // made before the first
    bool validates;
    struct rn_calibration found;
    double began_s, reported_s;
};

static double now_s(void) {
    return (double)rn_clock_ns() * 1e-9;
}

void rn_calibration_drop(struct rn_host *host) {
    if (!host->calibrating) return;
    rn_trainer_destroy(&host->calibrating->trainer);
    free(host->calibrating);
    host->calibrating = NULL;
}

static void fail(struct rn_host *host, const struct rn_error *err) {
    rn_link_fail(&host->link, host->calibrating->job, RN_ABSENT, err);
    rn_calibration_drop(host);
}

bool rn_calibration_cancel(struct rn_host *host, const char *job) {
    struct rn_error err;
    if (!host->calibrating || strcmp(host->calibrating->job, job) != 0) return false;
    rn_error_set(&err, RN_ERROR_CANCELLED, "", "cancelled");
    fail(host, &err);
    return true;
}

// ---- the beginning -------------------------------------------------------------------------

// Of the training that is begun.
static double whole_seconds(const struct rn_calibrating *c) {
    double asked = c->config.max_seconds;
    return asked > 0 ? fmin(asked, LONGEST_S) : LONGEST_S;
}

static enum rn_status start(struct rn_host *host, struct rn_error *err) {
    struct rn_calibrating *c = host->calibrating;
    struct rn_watch watch = {.link = &host->link, .job = c->job, .request = RN_ABSENT};
    struct rn_train_config config = c->config;
    config.max_seconds = whole_seconds(c);
    config.max_steps = 0;
    config.until_psnr = 0;
    config.until_plateau = false;
    host->watch = &watch;
    rn_engine_watch(host->engine, rn_watch_keep_going, &watch);
    enum rn_status status =
        rn_trainer_create(host->engine, host->dataset, &config,
                          (size_t)rn_int_or(host->place.memory_limit_bytes, 0), &c->trainer, err);
    rn_engine_watch(host->engine, NULL, NULL);
    host->watch = NULL;
    return status;
}

// Newest checkpoints with both moments, and marks without; those of coarse planes are smaller.
static int64_t disk_bytes(const struct rn_field_info *info) {
    int64_t field = info->parameter_count * 4, marks = 0;
    double cells = pow(info->config.field.occupancy, 3);
    for (int i = 0; i < RN_MARKS_KEPT; i++)
        marks += field + (int64_t)(5 * cells);
    return CHECKPOINTS * (3 * field + (int64_t)(9 * cells)) + marks;
}

// Planes have their last size at the last look: memory and disk are what they are then.
static void note_look(struct rn_host *host) {
    struct rn_calibrating *c = host->calibrating;
    struct rn_progress progress;
    struct rn_field_info info;
    rn_field_describe(rn_trainer_field(c->trainer), &info);
    rn_trainer_progress(c->trainer, &progress);
    c->found.seconds[c->look] = progress.train_seconds;
    c->found.psnr[c->look] = progress.psnr;
    double stepped = progress.train_seconds - progress.turn_seconds;
    c->found.turn_seconds = progress.turn_seconds;
    c->found.step_seconds = stepped / (double)(progress.step ? progress.step : 1);
    c->found.load_seconds = progress.load_seconds;
    c->found.memory_bytes = rn_resident_bytes();
    c->found.disk_bytes = disk_bytes(&info);
    c->validates = false;
    if (c->look++ == 0) c->first_steps = progress.step;
}

// Whether a look is due by time. Passes over the photographs may lie between the first look and the
// last, in which no step is made: the last waits for as many steps again, to see what they bring.
static bool is_due(const struct rn_calibrating *c, const struct rn_progress *progress) {
    double due = RN_CALIBRATION_LOOKED / RN_CALIBRATION_LOOKS * (c->look + 1);
    bool last = c->look == RN_CALIBRATION_LOOKS - 1;
    return progress->fraction >= due &&
           (!last || progress->step >= 2 * c->first_steps || progress->fraction >= LATEST);
}

// A little of it; *ret_seen: a look's figure is there.
static enum rn_status go_on(struct rn_host *host, bool *ret_seen, struct rn_error *err) {
    struct rn_calibrating *c = host->calibrating;
    struct rn_progress progress;
    *ret_seen = false;
    if (!c->trainer) return start(host, err);
    if (c->validates) return rn_trainer_validate(c->trainer, RN_SLICE_MS, ret_seen, err);
    enum rn_status status = rn_trainer_advance(c->trainer, RN_SLICE_MS, err);
    rn_trainer_progress(c->trainer, &progress);
    c->validates = is_due(c, &progress);
    return status;
}

// ---- messages ------------------------------------------------------------------------------

static void post_progress(struct rn_host *host) {
    struct rn_calibrating *c = host->calibrating;
    struct rn_progress now = {0};
    double total = RN_CALIBRATION_LOOKED * whole_seconds(c);
    if (c->trainer) rn_trainer_progress(c->trainer, &now);
    double done = now.train_seconds;
    struct rn_work_progress record = {.done = (int64_t)done,
                                      .total = (int64_t)ceil(total),
                                      .fraction = fmin(done / total, 1),
                                      .eta_seconds = fmax(total - done, 0),
                                      .stage = "calibrating"};
    struct rn_wire_progress message = {.progress = NULL};
    memcpy(message.job, c->job, sizeof message.job);
    c->reported_s = now_s();
    if (rn_encode(&rn_work_progress_table, &record, &message.progress, NULL, NULL)) return;
    rn_link_post(&host->link, RN_WIRE_PROGRESS, &message, NULL, 0);
    free(message.progress);
}

static void conclude(struct rn_host *host) {
    struct rn_calibrating *c = host->calibrating;
    struct rn_calibration *found = &c->found;
    struct rn_device_info device;
    struct rn_error err = {0};
    char *result = NULL;
    rn_engine_describe(host->engine, &device);
    found->spent_seconds = now_s() - c->began_s;
    found->whole_seconds = whole_seconds(c);
    found->max_seconds = c->config.max_seconds;
    found->max_steps = c->config.max_steps;
    found->threads = device.threads;
    snprintf(found->device, sizeof found->device, "%s", device.device);
    snprintf(found->kernels, sizeof found->kernels, "%s", device.kernels);
    if (rn_encode(&rn_calibration_table, found, &result, NULL, &err)) {
        fail(host, &err);
        return;
    }
    rn_link_done(&host->link, c->job, result);
    free(result);
    rn_calibration_drop(host);
}

void rn_calibration_slice(struct rn_host *host) {
    struct rn_calibrating *c = host->calibrating;
    struct rn_error err = {0};
    bool seen;
    rn_link_log_of(&host->link, c->job);
    enum rn_status status = go_on(host, &seen, &err);
    // Stopped because the runner must end: the daemon will start the job again.
    if (status == RN_ERROR_CANCELLED && rn_link_must_stop(&host->link)) return;
    if (status) {
        fail(host, &err);
        return;
    }
    if (seen) note_look(host);
    if (now_s() - c->reported_s >= PROGRESS_S) post_progress(host);
    if (c->look == RN_CALIBRATION_LOOKS) conclude(host);
}

void rn_calibration_start(struct rn_host *host, const struct rn_wire_train *train) {
    struct rn_error err = {0};
    struct rn_calibrating *c = calloc(1, sizeof *c);
    enum rn_status status = c ? RN_OK : rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "out of memory");
    if (!status) status = rn_host_need_sound_dataset(host, &err);
    if (!status) status = rn_host_need_engine_for(host, &train->options, &err);
    if (!status)
        status = rn_configure(&train->options, host->dataset->scale_count > 1, &c->config, &err);
    if (status) {
        free(c);
        rn_link_fail(&host->link, train->job, RN_ABSENT, &err);
        return;
    }
    c->config.train_scale = rn_train_scale(host->dataset, &c->config);
    memcpy(c->job, train->job, sizeof c->job);
    c->began_s = now_s();
    host->calibrating = c;
    post_progress(host);
}
