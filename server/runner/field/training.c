#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "common/base/seal.h"
#include "proto/marks.h"
#include "server/runner/field/host.h"
#include "server/runner/field/incidents.h"
#include "server/runner/field/ranks.h"
#include "server/runner/field/saving.h"
#include "server/runner/link/join.h"
#include "server/runner/scene/checkpoints.h"
#include "server/runner/scene/describe.h"

#define PROGRESS_INTERVAL_S 0.5
#define LOADING "loading photographs" // the stage before the first step
#define FIRST_EVALUATION_S 2.0        // of training, and not before FIRST_EVALUATION_STEPS
#define FIRST_EVALUATION_STEPS 16     // so that a wide field's first steps are not waited on;
#define FOG_S 10.0                    // nor, for as long as that,
#define FOG_STEPS 256                 // while the field is a fog, whose pictures take the longest
#define EVALUATION_GROWTH 0.5         // of the time trained so far, until the next round,
#define PLATEAU_GROWTH 0.1            // the same where the training ends at its plateau
#define EVALUATION_INTERVAL_S 30.0    // but this at most,
#define TRAIN_PER_EVALUATION 4.0      // and this many times the last round's time at least
#define CHECKPOINT_INTERVAL_S 30.0    // at most; a fifth of the time trained, but FIRST_ at least
#define FIRST_CHECKPOINT_S 5.0
#define QUICK_STEP_S 0.1 // a step that is worth completing and saving before a cancel
#define SAVING_POLL_MS 2

// A training job. Times are seconds of the monotonic clock, but evaluated_at: of the training
// clock.
struct rn_training {
    char job[RN_ID_MAX];
    struct rn_trainer *trainer;
    double checkpoint_interval_s, evaluate_interval_s; // NAN: ever fewer as time goes on
    double paused_since, paused_seconds;               // since: NAN when it is not paused
    double yielded_seconds;
    double checkpointed_at, reported_at;
    double evaluated_at;                    // training seconds at the last round
    int64_t evaluated_step;                 // -1 before the first round
    double evaluate_seconds, round_seconds; // of all rounds so far, of the last one
    bool evaluating;                        // a round over the held-out views is under way
    bool closing;                           // a limit is reached: the last round, then the end
    bool finish_asked;
    struct rn_saving saving;
    double next_mark; // training seconds
    bool announced;
    char set_aside[512]; // the damaged checkpoint that was passed over, and why; "" = none
    enum { THEN_GO_ON, THEN_CANCELLED, THEN_DONE } then; // when it is saved
};

static double now_s(void) {
    return (double)rn_clock_ns() * 1e-9;
}

bool rn_training_is(const struct rn_host *host, const char *job) {
    return host->training && *job && strcmp(host->training->job, job) == 0;
}

// There and not paused.
static bool runs(const struct rn_host *host) {
    return host->training && isnan(host->training->paused_since);
}

bool rn_training_is_busy(const struct rn_host *host) {
    return runs(host) || (host->training && rn_saving_is_busy(&host->training->saving));
}

bool rn_training_is_ending(const struct rn_host *host) {
    return host->training && host->training->then == THEN_CANCELLED;
}

struct rn_field *rn_training_field(struct rn_training *training) {
    return rn_trainer_field(training->trainer);
}

void rn_training_yielded(struct rn_host *host, double seconds) {
    if (runs(host)) host->training->yielded_seconds += seconds;
}

void rn_training_drop(struct rn_host *host) {
    if (!host->training) return;
    rn_trainer_destroy(&host->training->trainer);
    free(host->training);
    host->training = NULL;
}

// ---- messages ------------------------------------------------------------------------------

static char *description(struct rn_training *training, struct rn_error *err) {
    struct rn_field_info info;
    rn_field_describe(rn_trainer_field(training->trainer), &info);
    char *json = NULL;
    if (rn_describe_scene(&info, rn_trainer_held_out(training->trainer), &json, err))
        rn_log(RN_LOG_ERROR, "the scene cannot be described: %s", err->text);
    return json;
}

static void post_state(struct rn_host *host, enum rn_job_state state) {
    struct rn_error err = {0};
    struct rn_wire_state message = {.state = (int)state,
                                    .scene = description(host->training, &err)};
    struct rn_progress progress;
    rn_trainer_progress(host->training->trainer, &progress);
    message.steps = progress.step;
    memcpy(message.job, host->training->job, sizeof message.job);
    if (!host->training->announced)
        memcpy(message.set_aside, host->training->set_aside, sizeof message.set_aside);
    host->training->announced = true;
    rn_link_post(&host->link, RN_WIRE_STATE, &message, NULL, 0);
    free(message.scene);
}

static void tell_fallback(const struct rn_training *training, char ret_text[256]) {
    snprintf(ret_text, 256, "%.255s", training->set_aside);
}

static void post_record(struct rn_host *host, const char *job,
                        const struct rn_train_progress *record) {
    struct rn_wire_progress message = {.progress = NULL};
    struct rn_error err = {0};
    snprintf(message.job, sizeof message.job, "%s", job);
    if (rn_encode(&rn_train_progress_table, record, &message.progress, NULL, &err)) {
        rn_log(RN_LOG_ERROR, "progress cannot be reported: %s", err.text);
        return;
    }
    rn_link_post(&host->link, RN_WIRE_PROGRESS, &message, NULL, 0);
    free(message.progress);
}

static void post_progress(struct rn_host *host, const struct rn_progress *progress) {
    struct rn_training *training = host->training;
    struct rn_train_progress record =
        rn_describe_progress(progress, rn_trainer_config(training->trainer));
    record.paused_seconds = training->paused_seconds;
    record.yielded_seconds = training->yielded_seconds;
    record.evaluating_first = training->closing;
    record.evaluating = training->evaluating;
    tell_fallback(training, record.fell_back);
    post_record(host, training->job, &record);
    training->reported_at = now_s();
}

static void post_metric(struct rn_host *host, const struct rn_progress *progress) {
    struct rn_wire_metric message = {.metric = {.step = progress->step,
                                                .train_seconds = progress->train_seconds,
                                                .psnr = progress->psnr}};
    memcpy(message.job, host->training->job, sizeof message.job);
    rn_link_post(&host->link, RN_WIRE_METRIC, &message, NULL, 0);
}

// ---- checkpoints ---------------------------------------------------------------------------

static void post_checkpoint(struct rn_host *host) {
    struct rn_training *training = host->training;
    const struct rn_progress *saved = &training->saving.progress;
    struct rn_error err = {0};
    struct stat about = {0};
    char path[PATH_MAX];
    if (rn_checkpoint_path(host->place.scene_folder, saved->step, path, &err) ||
        stat(path, &about) < 0)
        rn_log(RN_LOG_WARN, "%s has vanished", path);
    struct rn_wire_checkpoint message = {.step = saved->step,
                                         .size_bytes = about.st_size,
                                         .train_seconds = saved->train_seconds,
                                         .psnr = saved->psnr,
                                         .scene = description(training, &err)};
    memcpy(message.job, training->job, sizeof message.job);
    rn_checkpoint_name(saved->step, message.file);
    memcpy(message.parameters_sha256, training->saving.sha256, sizeof message.parameters_sha256);
    if (rn_seal_read(path, message.digest, &err))
        rn_log(RN_LOG_WARN, "%s: %s", err.where, err.text);
    memcpy(host->digest, message.digest, sizeof host->digest);
    if (message.scene) rn_link_post_last(&host->link, RN_WIRE_CHECKPOINT, &message);
    free(message.scene);
}

// A full disk must not end a training.
static void warn(const struct rn_error *err) {
    rn_log(RN_LOG_WARN, "no checkpoint could be written: %s: %s", err->where, err->text);
}

void rn_training_save(struct rn_host *host) {
    struct rn_training *training = host->training;
    struct rn_error err = {0};
    if (!training) return;
    if (rn_saving_finish(&training->saving, training->trainer, host->place.scene_folder, &err))
        warn(&err);
    else
        post_checkpoint(host);
}

// ---- begin ---------------------------------------------------------------------------------

// A trainer from the newest good checkpoint. RN_ERROR_NOT_FOUND when there is none.
static enum rn_status restore(struct rn_host *host, struct rn_trainer **ret_trainer, char told[512],
                              struct rn_error *err) {
    for (;;) {
        int64_t step;
        char path[PATH_MAX];
        enum rn_status status =
            rn_checkpoints_newest(host->place.scene_folder, INT64_MAX, &step, err);
        if (!status) status = rn_checkpoint_path(host->place.scene_folder, step, path, err);
        if (status) return status;
        status = rn_seal_check(path, host->digest, err);
        if (status == RN_OK) status = rn_ranks_make_trainer(host, NULL, path, ret_trainer, err);
        if (!rn_checkpoint_is_damaged(status, err, path)) return status;
        rn_checkpoint_set_aside(host->place.scene_folder, step, err, told);
    }
}

// An option that the engine refuses is named with its place in the request.
static enum rn_status point_at_option(enum rn_status status, struct rn_error *err) {
    if (status == RN_ERROR_INVALID || status == RN_ERROR_UNSUPPORTED) {
        char name[64];
        snprintf(name, sizeof name, "%.63s", err->where);
        snprintf(err->where, sizeof err->where, "#/options/%s", name);
    }
    return status;
}

enum rn_status rn_host_need_engine_for(struct rn_host *host, const struct rn_train_options *options,
                                       struct rn_error *err) {
    const struct rn_wire_open *place = &host->place;
    const char *device = *options->device ? options->device : place->device;
    enum rn_status status =
        rn_host_need_engine(host, host->exchange ? "cpu" : device,
                            *options->kernels ? options->kernels : place->kernels,
                            (int)rn_int_or(options->threads, rn_int_or(place->threads, 0)), err);
    return point_at_option(status, err);
}

static enum rn_status restore_or_create(struct rn_host *host,
                                        const struct rn_train_options *options,
                                        struct rn_trainer **ret_trainer, char told[512],
                                        struct rn_error *err) {
    enum rn_status status = restore(host, ret_trainer, told, err);
    if (status != RN_ERROR_NOT_FOUND) return status;
    struct rn_train_config config;
    status = rn_configure(options, host->dataset->scale_count > 1, &config, err);
    if (status) return point_at_option(status, err);
    return rn_ranks_make_trainer(host, &config, NULL, ret_trainer, err);
}

// Photographs are checked and loaded: what lasts is told.
struct loading {
    struct rn_host *host;
    double begun, told;
};

static bool keep_loading(void *context) {
    struct loading *loading = context;
    struct rn_host *host = loading->host;
    double now = now_s();
    struct rn_train_progress record = {.load_seconds = now - loading->begun,
                                       .loss = NAN,
                                       .psnr = NAN,
                                       .psnr_step = RN_ABSENT,
                                       .eta_seconds = NAN,
                                       .fraction = NAN,
                                       .stage = LOADING};
    if (now - loading->told >= PROGRESS_INTERVAL_S) {
        post_record(host, host->watch->job, &record);
        loading->told = now;
    }
    return rn_watch_keep_going(host->watch);
}

static enum rn_status create_trainer(struct rn_host *host, const char *job,
                                     const struct rn_train_options *options,
                                     struct rn_trainer **ret_trainer, char told[512],
                                     struct rn_error *err) {
    enum rn_status status = rn_host_need_sound_dataset(host, err);
    if (!status) status = rn_host_need_engine_for(host, options, err);
    if (status) return status;
    if (host->marked) rn_field_destroy(&host->marked);
    if (host->loaded) rn_field_destroy(&host->loaded); // room for the optimiser
    struct rn_watch watch = {.link = &host->link, .job = job, .request = RN_ABSENT};
    struct loading loading = {.host = host, .begun = now_s(), .told = now_s()};
    host->watch = &watch;
    rn_engine_watch(host->engine, keep_loading, &loading);
    status = restore_or_create(host, options, ret_trainer, told, err);
    rn_engine_watch(host->engine, NULL, NULL);
    host->watch = NULL;
    return status;
}

void rn_training_start(struct rn_host *host, const struct rn_wire_train *train) {
    const struct rn_train_options *options = &train->options;
    struct rn_error err = {0};
    struct rn_training *training = calloc(1, sizeof *training);
    enum rn_status status =
        training ? RN_OK : rn_error_set(&err, RN_ERROR_NO_MEMORY, "", "out of memory");
    if (!status)
        status = create_trainer(host, train->job, options, &training->trainer, training->set_aside,
                                &err);
    if (status) {
        free(training);
        rn_link_fail(&host->link, train->job, RN_ABSENT, &err);
        return;
    }
    memcpy(training->job, train->job, sizeof training->job);
    training->checkpoint_interval_s = options->checkpoint_interval_s;
    training->evaluate_interval_s = options->evaluate_interval_s;
    training->paused_since = NAN;
    training->checkpointed_at = training->reported_at = now_s();
    struct rn_progress progress;
    rn_trainer_progress(training->trainer, &progress);
    training->next_mark = rn_mark_next(progress.train_seconds);
    rn_marks_prune(host->place.scene_folder, progress.step); // of what a crash has undone
    training->evaluated_step = isnan(progress.psnr) ? -1 : progress.psnr_step;
    training->evaluated_at = isnan(progress.psnr) ? 0 : progress.train_seconds;
    host->training = training;
    rn_log(RN_LOG_INFO, "job %s: trains from step %lld on", training->job,
           (long long)progress.step);
    post_state(host, RN_JOB_RUNNING);
    post_progress(host, &progress);
}

// ---- end -----------------------------------------------------------------------------------

// The job is over: what is kept for rendering is its field, or the last checkpoint.
static void leave(struct rn_host *host) {
    struct rn_error err = {0};
    rn_training_drop(host);
    if (rn_host_load(host, &err) && err.status != RN_ERROR_NOT_FOUND)
        rn_log(RN_LOG_ERROR, "the scene cannot be loaded after training: %s", err.text);
}

static void fail(struct rn_host *host, const struct rn_error *err) {
    char job[RN_ID_MAX];
    memcpy(job, host->training->job, sizeof job);
    leave(host);
    rn_link_fail(&host->link, job, RN_ABSENT, err);
}

static enum rn_finished_by reason(const struct rn_training *training,
                                  const struct rn_progress *progress) {
    const struct rn_train_config *config = rn_trainer_config(training->trainer);
    if (training->finish_asked) return RN_FINISHED_REQUEST;
    if (config->until_psnr > 0 && progress->psnr >= config->until_psnr) return RN_FINISHED_PSNR;
    if (progress->plateau) return RN_FINISHED_PLATEAU;
    bool by_steps = config->max_steps > 0 && progress->step >= config->max_steps;
    return by_steps ? RN_FINISHED_STEPS : RN_FINISHED_TIME;
}

// The scene is saved: the job's result, and the field stays for rendering.
static void conclude(struct rn_host *host) {
    struct rn_training *training = host->training;
    const struct rn_progress *progress = &training->saving.progress;
    struct rn_error err = {0};
    struct rn_device_info device;
    post_progress(host, progress);
    struct rn_train_result result = {.steps = progress->step,
                                     .train_seconds = progress->train_seconds,
                                     .samples = (int64_t)progress->samples,
                                     .psnr = progress->psnr,
                                     .psnr_step =
                                         isnan(progress->psnr) ? RN_ABSENT : progress->psnr_step,
                                     .finished_by = (int)reason(training, progress),
                                     .estimate = {.seconds = NAN, .psnr = NAN}};
    memcpy(result.parameters_sha256, training->saving.sha256, sizeof result.parameters_sha256);
    tell_fallback(training, result.fell_back);
    rn_engine_describe(host->engine, &device);
    rn_machine_text(device.name, result.machine, sizeof result.machine);
    char job[RN_ID_MAX], *json = NULL;
    memcpy(job, training->job, sizeof job);
    if (rn_encode(&rn_train_result_table, &result, &json, NULL, &err)) {
        fail(host, &err);
        return;
    }
    host->loaded = rn_trainer_finish(&training->trainer);
    leave(host);
    rn_link_done(&host->link, job, json);
    free(json);
}

static void end_cancelled(struct rn_host *host) {
    struct rn_error err;
    rn_error_set(&err, RN_ERROR_CANCELLED, "", "cancelled; the last checkpoint is kept");
    fail(host, &err);
}

// ---- saving --------------------------------------------------------------------------------

static void after_saving(struct rn_host *host, enum rn_status status, const struct rn_error *err) {
    struct rn_training *training = host->training;
    bool mark = training->saving.is_mark;
    if (!mark) training->checkpointed_at = now_s();
    if (status && training->then == THEN_DONE && !mark) {
        fail(host, err);
        return;
    }
    if (status)
        warn(err);
    else if (!mark)
        post_checkpoint(host);
    if (rn_saving_is_busy(&training->saving)) return; // another one is wanted
    if (training->then == THEN_CANCELLED)
        end_cancelled(host);
    else if (training->then == THEN_DONE)
        conclude(host);
}

// Goes on with a checkpoint; false when there is nothing else to do.
static bool go_on_saving(struct rn_host *host) {
    struct rn_training *training = host->training;
    struct rn_error err = {0};
    bool saved = false;
    enum rn_status status = rn_saving_go_on(&training->saving, training->trainer,
                                            host->place.scene_folder, &saved, &err);
    rn_incidents_report(host, training->trainer, training->job);
    if (status || saved) after_saving(host, status, &err);
    if (!host->training || !rn_saving_is_busy(&training->saving)) return host->training != NULL;
    bool waits =
        training->saving.begun && (training->then != THEN_GO_ON || !isnan(training->paused_since) ||
                                   rn_saving_holds(&training->saving, training->trainer));
    if (waits) rn_link_pump(&host->link, SAVING_POLL_MS);
    return !waits && training->saving.begun;
}

// ---- slices --------------------------------------------------------------------------------

// A figure within seconds, then ever fewer: half as long again after each, a fifth of the time at
// most; and the last that can be had. Training does not depend on it, but for one that ends at its
// plateau, which needs more of them to see it.
static bool evaluation_is_due(const struct rn_training *training,
                              const struct rn_progress *progress) {
    double since = progress->train_seconds - training->evaluated_at;
    enum rn_figure figure = rn_trainer_figure(training->trainer);
    if (progress->step == training->evaluated_step || figure == RN_FIGURE_NONE) return false;
    if (training->closing || figure == RN_FIGURE_LAST) return true;
    if (!isnan(training->evaluate_interval_s)) return since >= training->evaluate_interval_s;
    if (training->evaluated_step < 0)
        return since >= FIRST_EVALUATION_S && progress->step >= FIRST_EVALUATION_STEPS &&
               (since >= FOG_S || progress->step >= FOG_STEPS);
    bool to_plateau = rn_trainer_config(training->trainer)->until_plateau;
    double wait = fmin((to_plateau ? PLATEAU_GROWTH : EVALUATION_GROWTH) * training->evaluated_at,
                       EVALUATION_INTERVAL_S);
    return since >= fmax(wait, TRAIN_PER_EVALUATION * training->round_seconds);
}

static bool checkpoint_is_due(const struct rn_training *training, double train_seconds,
                              double now) {
    double interval = fmin(fmax(0.2 * train_seconds, FIRST_CHECKPOINT_S), CHECKPOINT_INTERVAL_S);
    return !rn_saving_is_busy(&training->saving) &&
           now - training->checkpointed_at >=
               rn_number_or(training->checkpoint_interval_s, interval);
}

// What there is to look back at; nothing waits for it.
static void mark_when_due(struct rn_training *training, double train_seconds) {
    if (train_seconds < training->next_mark || training->closing) return;
    training->next_mark = rn_mark_next(train_seconds);
    training->saving.mark_wanted = true;
}

static enum rn_status advance(struct rn_host *host, struct rn_error *err) {
    struct rn_training *training = host->training;
    bool round_done = false;
    enum rn_status status =
        training->evaluating ? rn_trainer_validate(training->trainer, RN_SLICE_MS, &round_done, err)
                             : rn_trainer_advance(training->trainer, RN_SLICE_MS, err);
    rn_incidents_report(host, training->trainer, training->job);
    if (status || !round_done) return status;
    struct rn_progress progress;
    rn_trainer_progress(training->trainer, &progress);
    training->evaluating = false;
    training->round_seconds = progress.evaluate_seconds - training->evaluate_seconds;
    training->evaluate_seconds = progress.evaluate_seconds;
    training->evaluated_step = progress.step;
    training->evaluated_at = progress.train_seconds;
    post_metric(host, &progress);
    return RN_OK;
}

void rn_training_slice(struct rn_host *host) {
    struct rn_training *training = host->training;
    struct rn_error err = {0};
    rn_link_log_of(&host->link, training->job);
    if (rn_saving_is_busy(&training->saving) && !go_on_saving(host)) return;
    if (!runs(host)) return;
    if (advance(host, &err)) {
        fail(host, &err);
        return;
    }
    struct rn_progress progress;
    rn_trainer_progress(training->trainer, &progress);
    if (!training->evaluating) {
        training->closing = progress.done || training->finish_asked;
        training->evaluating = evaluation_is_due(training, &progress);
    }
    if (training->closing && !training->evaluating) {
        training->then = THEN_DONE;
        training->saving.wanted = true;
        training->saving.mark_wanted = false;
        return;
    }
    double now = now_s();
    mark_when_due(training, progress.train_seconds);
    if (now - training->reported_at >= PROGRESS_INTERVAL_S) post_progress(host, &progress);
    if (!training->closing && checkpoint_is_due(training, progress.train_seconds, now))
        training->saving.wanted = true;
}

// ---- control -------------------------------------------------------------------------------

void rn_training_pause(struct rn_host *host) {
    struct rn_training *training = host->training;
    if (isnan(training->paused_since)) {
        training->saving.wanted = true;
        training->paused_since = now_s();
    }
    struct rn_progress progress;
    rn_trainer_progress(training->trainer, &progress);
    post_progress(host, &progress);
    post_state(host, RN_JOB_PAUSED);
}

void rn_training_resume(struct rn_host *host) {
    struct rn_training *training = host->training;
    if (!isnan(training->paused_since)) {
        training->paused_seconds += now_s() - training->paused_since;
        training->paused_since = NAN;
        training->checkpointed_at = now_s();
    }
    post_state(host, RN_JOB_RUNNING);
}

void rn_training_finish(struct rn_host *host) {
    rn_training_resume(host);
    host->training->finish_asked = true;
}

// Within a moment: what is being written is completed, and a step that takes long is given up.
void rn_training_cancel(struct rn_host *host) {
    struct rn_training *training = host->training;
    struct rn_progress progress;
    rn_trainer_progress(training->trainer, &progress);
    bool quick = progress.step > 0 && progress.train_seconds / (double)progress.step < QUICK_STEP_S;
    training->then = THEN_CANCELLED;
    training->saving.wanted = quick && !training->saving.begun;
    training->saving.mark_wanted = false;
    if (!rn_saving_is_busy(&training->saving)) end_cancelled(host);
}
