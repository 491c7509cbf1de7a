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
        if (strcmp(runner->mode, "field") == 0 && strcmp(runner->scene, scene) == 0) return runner;
    return NULL;
}

bool rn_runner_imports(const struct rn_runner *runner) {
    return strcmp(runner->mode, RN_MODE_INGEST) == 0 || strcmp(runner->mode, RN_MODE_POSES) == 0;
}

bool rn_runner_is_idle(const struct rn_runner *runner) {
    bool trains = runner->train != NULL && runner->train->row.state != RN_JOB_PAUSED;
    return runner->state == RN_RUNNER_READY && !trains && runner->work == NULL &&
           runner->renders == NULL && !runner->rests;
}

struct rn_runner *rn_runner_oldest_idle(struct rn_control *control, const char *gpu) {
    struct rn_runner *oldest = NULL;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        bool counts = gpu == NULL || (runner->gpu_bytes > 0 && strcmp(runner->gpu, gpu) == 0);
        if (counts && rn_runner_is_idle(runner) &&
            (oldest == NULL || runner->last_used_ns < oldest->last_used_ns))
            oldest = runner;
    }
    return oldest;
}

enum rn_status rn_runner_start(struct rn_control *control, const char *mode, const char *scene,
                               const char *log_path, struct rn_runner **ret_runner,
                               struct rn_error *err) {
    if (control->stopping)
        return rn_error_set(err, RN_ERROR_UNAVAILABLE, "", "the daemon is shutting down");
    struct rn_runner *runner = calloc(1, sizeof *runner);
    if (runner == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "runner", "no memory");
    enum rn_status status =
        control->executor->start(control->executor, mode, log_path, &runner->process, err);
    control->stats.can_start = status == RN_OK;
    if (status != RN_OK) {
        free(runner);
        return status;
    }
    snprintf(runner->mode, sizeof runner->mode, "%s", mode);
    snprintf(runner->scene, sizeof runner->scene, "%s", scene);
    rn_wire_reader_init(&runner->reader, runner->process.fd);
    rn_wire_writer_init(&runner->writer, runner->process.fd, MAX_PENDING_BYTES);
    runner->last_used_ns = runner->heard_ns = rn_clock_ns();
    runner->deadline_ns = runner->last_used_ns + START_NS;
    runner->next = control->runners;
    control->runners = runner;
    control->stats.runners_started++;
    rn_log(RN_LOG_INFO, "runner %d: started (%s%s%s)", (int)runner->process.pid, mode,
           scene[0] != '\0' ? " " : "", scene);
    rn_control_wake(control);
    *ret_runner = runner;
    return RN_OK;
}

static enum rn_status open_scene(struct rn_control *control, struct rn_runner *runner,
                                 const struct rn_scene_row *scene, bool load,
                                 struct rn_error *err) {
    struct rn_wire_open open;
    rn_message_init(rn_wire_table(RN_WIRE_OPEN), &open);
    open.scene_folder = rn_store_path(control->store, "scenes/%s", scene->id);
    open.dataset_folder = rn_store_path(control->store, "datasets/%s", scene->dataset);
    open.load = load;
    open.threads = control->options.threads;
    open.memory_limit_bytes = control->options.memory_limit_bytes;
    open.gpu_deterministic = control->options.gpu_deterministic;
    enum rn_status status = RN_OK;
    if (open.scene_folder == NULL || open.dataset_folder == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "runner", "no memory");
    else
        rn_runner_post(control, runner, RN_WIRE_OPEN, &open);
    rn_message_finish(rn_wire_table(RN_WIRE_OPEN), &open);
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
    char *log = rn_store_path(control->store, "jobs/%s/log", scene.job);
    status = rn_runner_start(control, "field", scene_id, log, &runner, err);
    free(log);
    if (status == RN_OK) {
        status = open_scene(control, runner, &scene, load, err);
        if (status != RN_OK) runner->broken = true;
    }
    rn_row_finish(&rn_scenes, &scene);
    if (status == RN_OK) *ret_runner = runner;
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

static enum rn_status begin_train(struct rn_control *control, struct rn_task *task,
                                  struct rn_error *err) {
    struct rn_wire_train train;
    rn_message_init(rn_wire_table(RN_WIRE_TRAIN), &train);
    enum rn_status status = rn_decode(&rn_train_options_table, task->row.options,
                                      strlen(task->row.options), &train.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(train.job, sizeof train.job, "%s", task->row.id);
    rn_runner_post(control, task->runner, RN_WIRE_TRAIN, &train);
    rn_message_finish(rn_wire_table(RN_WIRE_TRAIN), &train);
    return RN_OK;
}

static enum rn_status begin_path(struct rn_control *control, struct rn_task *task,
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
    if (status == RN_OK) status = rn_frames_lend(control, task, &path.folder, err);
    if (status == RN_OK) rn_runner_post(control, task->runner, RN_WIRE_PATH, &path);
    rn_message_finish(rn_wire_table(RN_WIRE_PATH), &path);
    return status;
}

static enum rn_status begin_eval(struct rn_control *control, struct rn_task *task,
                                 struct rn_error *err) {
    struct rn_wire_eval eval;
    rn_message_init(rn_wire_table(RN_WIRE_EVAL), &eval);
    enum rn_status status = rn_decode(&rn_eval_options_table, task->row.options,
                                      strlen(task->row.options), &eval.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(eval.job, sizeof eval.job, "%s", task->row.id);
    rn_runner_post(control, task->runner, RN_WIRE_EVAL, &eval);
    rn_message_finish(rn_wire_table(RN_WIRE_EVAL), &eval);
    return RN_OK;
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

static enum rn_status begin_ingest(struct rn_control *control, struct rn_task *task,
                                   struct rn_error *err) {
    struct rn_wire_ingest ingest;
    rn_message_init(rn_wire_table(RN_WIRE_INGEST), &ingest);
    enum rn_status status = rn_decode(&rn_ingest_options_table, task->row.options,
                                      strlen(task->row.options), &ingest.options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(ingest.job, sizeof ingest.job, "%s", task->row.id);
    snprintf(ingest.name, sizeof ingest.name, "%s", task->row.dataset_name);
    ingest.source = strdup(task->row.source);
    ingest.target = rn_store_path(control->store, "datasets/%s", task->row.dataset);
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

void rn_runner_begin(struct rn_control *control, struct rn_task *task) {
    struct rn_runner *runner = task->runner;
    struct rn_error err = {0};
    enum rn_status status = RN_OK;
    if (!task->sent) {
        switch (task->row.type) {
        case RN_JOB_TRAIN:
            status = begin_train(control, task, &err);
            break;
        case RN_JOB_PATH:
            status = begin_path(control, task, &err);
            break;
        case RN_JOB_EVAL:
            status = begin_eval(control, task, &err);
            break;
        case RN_JOB_CURVE:
            status = begin_curve(control, task, &err);
            break;
        case RN_JOB_INGEST:
            status = begin_ingest(control, task, &err);
            break;
        }
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
    else if (task->row.state == RN_JOB_PAUSED)
        rn_runner_post_job(control, runner, RN_WIRE_PAUSE, task->row.id);
    else if (task->finish)
        rn_runner_post_job(control, runner, RN_WIRE_FINISH, task->row.id);
}

void rn_runner_shutdown(struct rn_control *control, struct rn_runner *runner) {
    if (runner->state == RN_RUNNER_ENDING) return;
    struct rn_wire_empty empty = {""};
    rn_runner_post(control, runner, RN_WIRE_SHUTDOWN, &empty);
    runner->state = RN_RUNNER_ENDING;
    runner->deadline_ns = rn_clock_ns() + END_NS;
}

static void lose_tasks(struct rn_control *control, struct rn_runner *runner, const char *how) {
    struct rn_task *tasks[] = {runner->train, runner->work};
    for (int i = 0; i < 2; i++) {
        if (tasks[i] == NULL) continue;
        if (control->stopping && tasks[i]->row.state != RN_JOB_CANCELLING)
            rn_task_detach(tasks[i]); // the next daemon finds it as it is
        else
            rn_task_lost(control, tasks[i], how);
    }
}

void rn_runner_remove(struct rn_control *control, struct rn_runner *runner, bool now) {
    char how[128] = "";
    struct rn_error gone = {.status = RN_ERROR_UNAVAILABLE};
    struct rn_runner **link = &control->runners;
    while (*link != runner)
        link = &(*link)->next;
    *link = runner->next;
    if (strcmp(runner->mode, "probe") == 0) control->stats.probed = true;
    close(runner->process.fd);
    control->executor->end(control->executor, &runner->process, now, how, sizeof how);
    bool expected = !runner->hangs && (runner->state == RN_RUNNER_ENDING || now);
    if (runner->hangs) snprintf(how, sizeof how, "it hangs: it did not answer in time");
    rn_log(expected ? RN_LOG_INFO : RN_LOG_WARN, "runner %d: ended, %s", (int)runner->process.pid,
           how);
    if (!expected) control->stats.runners_lost++;
    snprintf(gone.text, sizeof gone.text, "the scene's runner ended (%s); try again", how);
    rn_render_fail_all(control, runner, &gone);
    lose_tasks(control, runner, how);
    rn_wire_reader_finish(&runner->reader);
    rn_wire_writer_finish(&runner->writer);
    free(runner);
    control->schedule_due = true;
}
