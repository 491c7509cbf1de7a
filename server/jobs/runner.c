// One runner process: its start, its connection, its end.
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

#define START_NS (60 * 1000000000ll)
#define END_NS (30 * 1000000000ll)
#define MAX_PENDING_BYTES (64u << 20)

struct rn_runner *rn_runner_find(struct rn_control *control, const char *scene) {
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next)
        if (strcmp(runner->mode, "field") == 0 && strcmp(runner->scene, scene) == 0 &&
            runner->helps[0] == '\0')
            return runner;
    return NULL;
}

bool rn_runner_imports(const struct rn_runner *runner) {
    return strcmp(runner->mode, RN_MODE_INGEST) == 0 || strcmp(runner->mode, RN_MODE_POSES) == 0;
}

bool rn_runner_is_for_one(const struct rn_runner *runner) {
    return rn_runner_imports(runner) ||
           strncmp(runner->scene, RN_ID_JOB, sizeof RN_ID_JOB - 1) == 0;
}

bool rn_runner_is_idle(const struct rn_runner *runner) {
    bool trains = runner->train != NULL && runner->train->row.state != RN_JOB_PAUSED;
    return runner->state == RN_RUNNER_READY && !trains && runner->work == NULL &&
           runner->renders == NULL && !runner->rests && !runner->helping;
}

struct rn_runner *rn_runner_oldest_idle(struct rn_control *control, bool remote, const char *gpu) {
    struct rn_runner *oldest = NULL;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        bool counts = gpu == NULL || (runner->gpu_bytes > 0 && strcmp(runner->gpu, gpu) == 0);
        if (counts && runner->process.remote == remote && rn_runner_is_idle(runner) &&
            (oldest == NULL || runner->last_used_ns < oldest->last_used_ns))
            oldest = runner;
    }
    return oldest;
}

void rn_runner_more_time(struct rn_runner *runner) {
    runner->deadline_ns = rn_clock_ns() + START_NS;
}

void rn_runner_connected(struct rn_runner *runner) {
    runner->state = RN_RUNNER_STARTING;
    rn_wire_reader_init(&runner->reader, runner->process.fd);
    rn_wire_writer_init(&runner->writer, runner->process.fd, MAX_PENDING_BYTES);
    runner->last_used_ns = runner->heard_ns = runner->looked_ns = rn_clock_ns();
    rn_runner_more_time(runner);
}

enum rn_status rn_runner_start(struct rn_control *control, const struct rn_order *order,
                               struct rn_runner **ret_runner, struct rn_error *err) {
    if (control->stopping)
        return rn_error_set(err, RN_ERROR_UNAVAILABLE, "", "the daemon is shutting down");
    struct rn_runner *runner = calloc(1, sizeof *runner);
    if (runner == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "runner", "no memory");
    enum rn_status status =
        control->executor->start(control->executor, order, &runner->process, err);
    control->stats.can_start = status == RN_OK;
    if (status != RN_OK) {
        free(runner);
        return status;
    }
    snprintf(runner->mode, sizeof runner->mode, "%s", order->mode);
    snprintf(runner->scene, sizeof runner->scene, "%s", order->scene);
    rn_runner_connected(runner);
    runner->asked_ns = runner->last_used_ns;
    if (runner->process.fd < 0) runner->state = RN_RUNNER_AWAITED;
    runner->next = control->runners;
    control->runners = runner;
    control->stats.runners_started++;
    rn_log(RN_LOG_INFO, "runner %d: %s (%s%s%s)", (int)runner->process.pid,
           runner->state == RN_RUNNER_AWAITED ? "asked for" : "started", order->mode,
           order->scene[0] != '\0' ? " " : "", order->scene);
    rn_control_wake(control);
    *ret_runner = runner;
    return RN_OK;
}

// All runners of the daemon use one kernel set, so that a picture's bytes do not depend on where it
// was made.
static void tell_remote(struct rn_control *control, struct rn_wire_open *open) {
    snprintf(open->kernels, sizeof open->kernels, "%s", control->device.kernels);
    open->memory_limit_bytes = RN_ABSENT;
    open->clock_ns = rn_clock_ns();
}

// Opens runner->folder, which is NULL without memory.
static enum rn_status open_folder(struct rn_control *control, struct rn_runner *runner,
                                  const char *dataset, bool load, struct rn_error *err) {
    struct rn_wire_open open;
    rn_message_init(rn_wire_table(RN_WIRE_OPEN), &open);
    open.scene_folder = runner->folder != NULL ? strdup(runner->folder) : NULL;
    // A scene that came as a file may have no dataset here.
    open.dataset_folder =
        *dataset ? rn_store_path(control->store, "datasets/%s", dataset) : strdup("");
    open.load = load;
    open.threads = control->options.threads;
    open.memory_limit_bytes = control->options.memory_limit_bytes;
    open.gpu_deterministic = control->options.gpu_deterministic;
    snprintf(open.version, sizeof open.version, "%s", control->options.version);
    open.protocol = RN_WIRE_PROTOCOL;
    open.helps = runner->helps[0] != '\0';
    if (runner->process.remote) tell_remote(control, &open);
    enum rn_status status = RN_OK;
    if (open.scene_folder == NULL || open.dataset_folder == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "runner", "no memory");
    else
        rn_runner_post(control, runner, RN_WIRE_OPEN, &open);
    rn_message_finish(rn_wire_table(RN_WIRE_OPEN), &open);
    return status;
}

enum rn_status rn_runner_open(struct rn_control *control, struct rn_runner *runner,
                              const struct rn_scene_row *scene, bool load, struct rn_error *err) {
    free(runner->folder);
    runner->folder = runner->process.remote
                         ? control->executor->folder_of(control->executor, &runner->process)
                         : rn_store_path(control->store, "scenes/%s", runner->scene);
    return open_folder(control, runner, scene->dataset, load, err);
}

static bool has_job(const struct rn_control *control, const char *scene, enum rn_job_type type) {
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (strcmp(task->row.scene, scene) == 0 && task->row.type == type &&
            !rn_job_is_over(task->row.state))
            return true;
    return false;
}

// The options of the scene's own training, where a job is there that trains; NULL otherwise, and
// of a scene whose training is forgotten. malloc'd. What effects bring is measured by one node.
static char *options_to_train(struct rn_control *control, const struct rn_scene_row *scene,
                              int *ret_ranks) {
    struct rn_job_row job;
    bool itself = has_job(control, scene->id, RN_JOB_TRAIN);
    if ((!itself && !has_job(control, scene->id, RN_JOB_EFFECTS)) ||
        rn_store_find(control->store, &rn_jobs_table, "id", scene->job, &job, NULL))
        return NULL;
    char *options = strdup(job.options);
    if (itself) *ret_ranks = rn_train_ranks(job.options);
    rn_row_finish(&rn_jobs_table, &job);
    return options;
}

enum rn_status rn_runner_start_for(struct rn_control *control, const struct rn_scene_row *scene,
                                   const char *job, bool helps, struct rn_runner **ret_runner,
                                   struct rn_error *err) {
    char *log = rn_store_path(control->store, "jobs/%s/log", job);
    char *folder = rn_store_path(control->store, "scenes/%s", scene->id);
    char *dataset = rn_store_path(control->store, "datasets/%s", scene->dataset);
    int ranks = 1;
    char *train = options_to_train(control, scene, &ranks);
    const struct rn_order order = {.mode = "field",
                                   .scene = scene->id,
                                   .folder = folder,
                                   .dataset = dataset,
                                   .train = helps ? NULL : train,
                                   .ranks = helps ? 1 : ranks,
                                   .log_path = log,
                                   .helps = helps};
    enum rn_status status = folder == NULL || dataset == NULL
                                ? rn_error_set(err, RN_ERROR_NO_MEMORY, "runner", "no memory")
                                : rn_runner_start(control, &order, ret_runner, err);
    free(train);
    free(dataset);
    free(folder);
    free(log);
    return status;
}

enum rn_status rn_runner_for_scene(struct rn_control *control, const char *scene_id, bool load,
                                   struct rn_runner **ret_runner, struct rn_error *err) {
    struct rn_runner *runner = rn_runner_find(control, scene_id);
    if (runner != NULL && (runner->state == RN_RUNNER_ENDING || runner->broken))
        return rn_error_set(err, RN_ERROR_BUSY, "", "the scene's runner is ending; try again");
    if (runner != NULL) {
        *ret_runner = runner;
        return RN_OK;
    }
    struct rn_scene_row scene;
    enum rn_status status = rn_store_find(control->store, &rn_scenes, "id", scene_id, &scene, err);
    if (status != RN_OK) return status;
    status = rn_runner_start_for(control, &scene, scene.job, false, &runner, err);
    if (status == RN_OK && runner->state != RN_RUNNER_AWAITED) {
        status = rn_runner_open(control, runner, &scene, load, err);
        if (status != RN_OK) runner->broken = true;
    }
    rn_row_finish(&rn_scenes, &scene);
    if (status == RN_OK) *ret_runner = runner;
    return status;
}

enum rn_status rn_runner_for_estimate(struct rn_control *control, const struct rn_task *task,
                                      struct rn_runner **ret_runner, struct rn_error *err) {
    struct rn_runner *runner;
    char *log = rn_store_path(control->store, "jobs/%s/log", task->row.id);
    const struct rn_order order = {
        .mode = "field", .scene = task->row.id, .log_path = log, .here = true};
    enum rn_status status = rn_runner_start(control, &order, &runner, err);
    free(log);
    if (status != RN_OK) return status;
    runner->folder = rn_store_path(control->store, "spool/%s.work", task->row.id);
    status = open_folder(control, runner, task->row.dataset, false, err);
    if (status != RN_OK)
        runner->broken = true;
    else
        *ret_runner = runner;
    return status;
}

void rn_runner_post(struct rn_control *control, struct rn_runner *runner, enum rn_wire_type type,
                    const void *message) {
    struct rn_error err = {0};
    bool empty;
    if (runner->broken) return;
    if (rn_wire_post(&runner->writer, type, message, NULL, 0, &err) != RN_OK) {
        rn_log(RN_LOG_WARN, "runner %d: %s: %s", (int)runner->process.pid,
               rn_wire_type_name((int)type), err.text);
        runner->broken = true;
    } else if (rn_wire_flush(&runner->writer, &empty, &err) != RN_OK) {
        // What it said last is still to be read: reading finds the end.
        rn_log(RN_LOG_DEBUG, "runner %d: %s", (int)runner->process.pid, err.text);
    }
    runner->last_used_ns = rn_clock_ns();
    rn_control_wake(control);
}

void rn_runner_post_job(struct rn_control *control, struct rn_runner *runner,
                        enum rn_wire_type type, const char *job) {
    if (type == RN_WIRE_CANCEL) {
        struct rn_wire_cancel cancel = {.request = RN_ABSENT};
        snprintf(cancel.job, sizeof cancel.job, "%s", job);
        rn_runner_post(control, runner, type, &cancel);
    } else {
        struct rn_wire_job message;
        snprintf(message.job, sizeof message.job, "%s", job);
        rn_runner_post(control, runner, type, &message);
    }
}

void rn_runner_post_trace(struct rn_control *control, struct rn_runner *runner,
                          const struct rn_task *task) {
    struct rn_wire_trace trace;
    if (task->row.traceparent[0] == '\0') return;
    snprintf(trace.job, sizeof trace.job, "%s", task->row.id);
    snprintf(trace.traceparent, sizeof trace.traceparent, "%s", task->row.traceparent);
    rn_runner_post(control, runner, RN_WIRE_TRACE, &trace);
}

static enum rn_status begin_train(struct rn_control *control, struct rn_task *task,
                                  struct rn_error *err) {
    struct rn_wire_train train;
    rn_message_init(rn_wire_table(RN_WIRE_TRAIN), &train);
    enum rn_status status = rn_decode(&rn_train_options_table, task->row.options,
                                      strlen(task->row.options), &train.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(train.job, sizeof train.job, "%s", task->row.id);
    rn_runner_post(control, task->runner,
                   task->row.type == RN_JOB_TRAIN ? RN_WIRE_TRAIN : RN_WIRE_ESTIMATE, &train);
    rn_message_finish(rn_wire_table(RN_WIRE_TRAIN), &train);
    return RN_OK;
}

// Where the runner writes what a job is made of; malloc'd.
static enum rn_status lent_folder(const struct rn_runner *runner, const struct rn_task *task,
                                  char **ret_folder, struct rn_error *err) {
    if (asprintf(ret_folder, "%s/frames/%s", runner->folder, task->row.id) >= 0) return RN_OK;
    *ret_folder = NULL;
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "frames", "no memory");
}

static enum rn_status post_path(struct rn_control *control, struct rn_runner *runner,
                                const struct rn_task *task, int64_t begin, int64_t end,
                                struct rn_error *err) {
    struct rn_wire_path path;
    rn_message_init(rn_wire_table(RN_WIRE_PATH), &path);
    enum rn_status status = rn_decode(&rn_path_options_table, task->row.options,
                                      strlen(task->row.options), &path.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(path.job, sizeof path.job, "%s", task->row.id);
    path.camera_path.json = strdup(task->row.source);
    if (path.camera_path.json == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "path", "no memory");
    path.begin = begin;
    path.end = end;
    if (status == RN_OK) status = lent_folder(runner, task, &path.folder, err);
    if (status == RN_OK) rn_runner_post(control, runner, RN_WIRE_PATH, &path);
    rn_message_finish(rn_wire_table(RN_WIRE_PATH), &path);
    return status;
}

// Scores are kept in files where other runners may make some of them, or go on from there.
static enum rn_status post_eval(struct rn_control *control, struct rn_runner *runner,
                                const struct rn_task *task, int64_t begin, int64_t end,
                                struct rn_error *err) {
    struct rn_wire_eval eval;
    rn_message_init(rn_wire_table(RN_WIRE_EVAL), &eval);
    enum rn_status status = rn_decode(&rn_eval_options_table, task->row.options,
                                      strlen(task->row.options), &eval.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(eval.job, sizeof eval.job, "%s", task->row.id);
    eval.begin = begin;
    eval.end = end;
    if (runner->process.remote) status = lent_folder(runner, task, &eval.folder, err);
    if (status == RN_OK) rn_runner_post(control, runner, RN_WIRE_EVAL, &eval);
    rn_message_finish(rn_wire_table(RN_WIRE_EVAL), &eval);
    return status;
}

enum rn_status rn_runner_post_part(struct rn_control *control, struct rn_runner *runner,
                                   const struct rn_task *task, int64_t begin, int64_t end,
                                   struct rn_error *err) {
    return task->row.type == RN_JOB_EVAL ? post_eval(control, runner, task, begin, end, err)
                                         : post_path(control, runner, task, begin, end, err);
}

static enum rn_status begin_parts(struct rn_control *control, struct rn_task *task,
                                  struct rn_error *err) {
    bool keeps = task->row.type == RN_JOB_PATH || task->runner->process.remote;
    enum rn_status status = keeps ? rn_frames_lend(control, task, err) : RN_OK;
    task->live_left_s = NAN;
    task->handed = INT64_MAX;
    if (task->told != NULL) memset(task->told, 0, task->told_bytes);
    if (status != RN_OK) return status;
    return rn_runner_post_part(control, task->runner, task, RN_ABSENT, RN_ABSENT, err);
}

static enum rn_status begin_curve(struct rn_control *control, struct rn_task *task,
                                  struct rn_error *err) {
    struct rn_wire_curve curve;
    rn_message_init(rn_wire_table(RN_WIRE_CURVE), &curve);
    enum rn_status status = rn_decode(&rn_curve_options_table, task->row.options,
                                      strlen(task->row.options), &curve.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(curve.job, sizeof curve.job, "%s", task->row.id);
    rn_runner_post(control, task->runner, RN_WIRE_CURVE, &curve);
    rn_message_finish(rn_wire_table(RN_WIRE_CURVE), &curve);
    return RN_OK;
}

// As the scene's own training was asked for; what it was is not known of one whose job is gone.
static enum rn_status training_options(struct rn_control *control, const char *scene_id,
                                       struct rn_train_options *ret_options, struct rn_error *err) {
    struct rn_scene_row scene;
    struct rn_job_row job;
    enum rn_status status = rn_store_find(control->store, &rn_scenes, "id", scene_id, &scene, err);
    if (status != RN_OK) return status;
    status = rn_store_find(control->store, &rn_jobs_table, "id", scene.job, &job, err);
    rn_row_finish(&rn_scenes, &scene);
    if (status == RN_ERROR_NOT_FOUND) return RN_OK;
    if (status != RN_OK) return status;
    if (job.type == RN_JOB_TRAIN)
        status = rn_decode(&rn_train_options_table, job.options, strlen(job.options), ret_options,
                           NULL, err);
    else
        status =
            rn_error_set(err, RN_ERROR_CONFLICT, "#/scene",
                         "it came as a file for viewing: how it was trained is not known here");
    rn_row_finish(&rn_jobs_table, &job);
    return status;
}

static enum rn_status begin_effects(struct rn_control *control, struct rn_task *task,
                                    struct rn_error *err) {
    struct rn_wire_effects effects;
    rn_message_init(rn_wire_table(RN_WIRE_EFFECTS), &effects);
    enum rn_status status = rn_decode(&rn_effects_options_table, task->row.options,
                                      strlen(task->row.options), &effects.options, NULL, err);
    if (status == RN_OK) status = training_options(control, task->row.scene, &effects.train, err);
    if (status != RN_OK) return status;
    snprintf(effects.job, sizeof effects.job, "%s", task->row.id);
    rn_runner_post(control, task->runner, RN_WIRE_EFFECTS, &effects);
    rn_message_finish(rn_wire_table(RN_WIRE_EFFECTS), &effects);
    return RN_OK;
}

static enum rn_status begin_doctor(struct rn_control *control, struct rn_task *task,
                                   struct rn_error *err) {
    struct rn_wire_doctor doctor;
    rn_message_init(rn_wire_table(RN_WIRE_DOCTOR), &doctor);
    enum rn_status status = rn_decode(&rn_doctor_job_options_table, task->row.options,
                                      strlen(task->row.options), &doctor.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(doctor.job, sizeof doctor.job, "%s", task->row.id);
    rn_runner_post(control, task->runner, RN_WIRE_DOCTOR, &doctor);
    rn_message_finish(rn_wire_table(RN_WIRE_DOCTOR), &doctor);
    return RN_OK;
}

static enum rn_status begin_export(struct rn_control *control, struct rn_task *task,
                                   struct rn_error *err) {
    struct rn_wire_export export;
    rn_message_init(rn_wire_table(RN_WIRE_EXPORT), &export);
    enum rn_status status = rn_decode(&rn_export_options_table, task->row.options,
                                      strlen(task->row.options), &export.options, NULL, err);
    if (status == RN_OK) status = rn_frames_lend(control, task, err);
    if (status == RN_OK) status = lent_folder(task->runner, task, &export.folder, err);
    if (status != RN_OK) return status;
    snprintf(export.job, sizeof export.job, "%s", task->row.id);
    rn_runner_post(control, task->runner, RN_WIRE_EXPORT, &export);
    rn_message_finish(rn_wire_table(RN_WIRE_EXPORT), &export);
    return RN_OK;
}

static enum rn_status begin_ingest(struct rn_control *control, struct rn_task *task,
                                   struct rn_error *err) {
    struct rn_wire_ingest ingest;
    rn_message_init(rn_wire_table(RN_WIRE_INGEST), &ingest);
    ingest.scene = task->row.scene[0] != '\0';
    ingest.validate = task->row.type == RN_JOB_VALIDATE;
    enum rn_status status = RN_OK;
    if (!ingest.scene)
        status = rn_decode(&rn_ingest_options_table, task->row.options, strlen(task->row.options),
                           &ingest.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(ingest.job, sizeof ingest.job, "%s", task->row.id);
    snprintf(ingest.name, sizeof ingest.name, "%s",
             ingest.scene      ? task->row.scene_name
             : ingest.validate ? "dataset"
                               : task->row.dataset_name);
    ingest.source = strdup(task->row.source);
    ingest.target = ingest.scene ? rn_store_path(control->store, "scenes/%s", task->row.scene)
                    : ingest.validate
                        ? rn_store_path(control->store, "spool/%s.kept", task->row.id)
                        : rn_store_path(control->store, "datasets/%s", task->row.dataset);
    ingest.work = rn_store_path(control->store, "spool/%s.work", task->row.id);
    ingest.max_bytes = control->options.max_upload_bytes;
    ingest.max_entries = control->options.max_upload_entries;
    ingest.max_frames = control->options.max_frames;
    ingest.max_pixels = control->options.max_pixels;
    ingest.max_seconds = control->options.import_time_s;
    ingest.memory_limit_bytes = control->options.memory_limit_bytes;
    ingest.threads = control->options.threads;
    if (ingest.source == NULL || ingest.target == NULL || ingest.work == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "ingest", "no memory");
    // What an earlier attempt left.
    if (status == RN_OK) status = rn_remove_tree(ingest.target, err);
    if (status == RN_OK) status = rn_remove_tree(ingest.work, err);
    if (status == RN_OK) rn_runner_post(control, task->runner, RN_WIRE_INGEST, &ingest);
    rn_message_finish(rn_wire_table(RN_WIRE_INGEST), &ingest);
    return status;
}

// Sends the runner the order that a job of its type is.
static enum rn_status send_order(struct rn_control *control, struct rn_task *task,
                                 struct rn_error *err) {
    switch (task->row.type) {
    case RN_JOB_TRAIN:
    case RN_JOB_ESTIMATE:
        return begin_train(control, task, err);
    case RN_JOB_PATH:
    case RN_JOB_EVAL:
        return begin_parts(control, task, err);
    case RN_JOB_CURVE:
        return begin_curve(control, task, err);
    case RN_JOB_EFFECTS:
        return begin_effects(control, task, err);
    case RN_JOB_DOCTOR:
        return begin_doctor(control, task, err);
    case RN_JOB_EXPORT:
        return begin_export(control, task, err);
    case RN_JOB_INGEST:
    case RN_JOB_VALIDATE:
        return begin_ingest(control, task, err);
    case RN_JOB_LADDER: // has no runner
        break;
    }
    return RN_OK;
}

void rn_runner_begin(struct rn_control *control, struct rn_task *task) {
    struct rn_runner *runner = task->runner;
    struct rn_error err = {0};
    enum rn_status status = RN_OK;
    if (!task->sent) {
        rn_runner_post_trace(control, runner, task);
        status = send_order(control, task, &err);
    } else if (task->row.state == RN_JOB_RUNNING) {
        rn_runner_post_job(control, runner, RN_WIRE_RESUME, task->row.id);
    }
    if (status != RN_OK) {
        rn_task_fail(control, task, &err);
        return;
    }
    task->sent = true;
    if (task->row.state == RN_JOB_CANCELLING)
        rn_runner_post_job(control, runner, RN_WIRE_CANCEL, task->row.id);
    else if (task->row.state == RN_JOB_PAUSED || task->row.state == RN_JOB_QUEUED) // for a slot
        rn_runner_post_job(control, runner, RN_WIRE_PAUSE, task->row.id);
    else if (task->finish)
        rn_runner_post_job(control, runner, RN_WIRE_FINISH, task->row.id);
}

void rn_runner_shutdown(struct rn_control *control, struct rn_runner *runner) {
    if (runner->state == RN_RUNNER_ENDING) return;
    if (runner->state == RN_RUNNER_AWAITED) {
        runner->broken = true;
        return;
    }
    struct rn_wire_empty empty = {""};
    rn_runner_post(control, runner, RN_WIRE_SHUTDOWN, &empty);
    runner->state = RN_RUNNER_ENDING;
    runner->deadline_ns = rn_clock_ns() + END_NS;
}

static void lose_tasks(struct rn_control *control, struct rn_runner *runner,
                       const struct rn_ending *ending) {
    struct rn_task *tasks[] = {runner->train, runner->work};
    for (int i = 0; i < 2; i++) {
        if (tasks[i] == NULL) continue;
        if (control->stopping && tasks[i]->row.state != RN_JOB_CANCELLING)
            rn_task_detach(tasks[i]); // the next daemon finds it as it is
        else
            rn_task_lost(control, tasks[i], ending);
    }
}

static void unlink_runner(struct rn_control *control, struct rn_runner *runner) {
    struct rn_runner **link = &control->runners;
    while (*link != runner)
        link = &(*link)->next;
    *link = runner->next;
    if (runner->process.fd >= 0) close(runner->process.fd);
}

static void free_runner(struct rn_runner *runner) {
    rn_wire_reader_finish(&runner->reader);
    rn_wire_writer_finish(&runner->writer);
    free(runner->folder);
    free(runner);
}

void rn_runner_remove(struct rn_control *control, struct rn_runner *runner, bool now) {
    struct rn_ending ending = {.how = ""};
    struct rn_error gone = {.status = RN_ERROR_UNAVAILABLE};
    unlink_runner(control, runner);
    if (strcmp(runner->mode, "probe") == 0) control->stats.probed = true;
    control->executor->end(control->executor, &runner->process, now, &ending);
    bool expected = !runner->hangs && (runner->state == RN_RUNNER_ENDING || now);
    if (runner->hangs) ending = (struct rn_ending){.how = "it hangs: it did not answer in time"};
    rn_log(expected ? RN_LOG_INFO : RN_LOG_WARN, "runner %d: ended, %s", (int)runner->process.pid,
           ending.how);
    if (!expected) control->stats.runners_lost++;
    snprintf(gone.text, sizeof gone.text, "the scene's runner ended (%s); try again", ending.how);
    rn_render_fail_all(control, runner, &gone);
    lose_tasks(control, runner, &ending);
    free_runner(runner);
    control->schedule_due = true;
}

void rn_runner_release(struct rn_control *control, struct rn_runner *runner) {
    rn_log(RN_LOG_INFO, "runner %d: left to the next daemon", (int)runner->process.pid);
    unlink_runner(control, runner);
    if (runner->train != NULL) rn_task_detach(runner->train);
    if (runner->work != NULL) rn_task_detach(runner->work);
    free_runner(runner);
}
