// What runners report.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "proto/event.h"
#include "proto/scene.h"
#include "server/jobs/inside.h"

#define BUSY_RETRY_NS 1000000000ll

// The runner's task with this id, or NULL.
static struct rn_task *task_of(struct rn_runner *runner, const char *job) {
    if (runner->train != NULL && strcmp(runner->train->row.id, job) == 0) return runner->train;
    if (runner->work != NULL && strcmp(runner->work->row.id, job) == 0) return runner->work;
    return NULL;
}

static char *take(char **text) {
    char *taken = *text;
    *text = NULL;
    return taken;
}

static void set_document(char **document, char **text) {
    free(*document);
    *document = take(text);
}

static void update_scene(struct rn_control *control, struct rn_scene_row *scene) {
    struct rn_error err = {0};
    if (rn_store_update(control->store, &rn_scenes, scene, &err) != RN_OK)
        rn_log(RN_LOG_ERROR, "scene %s: %s", scene->id, err.text);
}

static bool find_scene(struct rn_control *control, const char *id, struct rn_scene_row *scene) {
    struct rn_error err = {0};
    if (rn_store_find(control->store, &rn_scenes, "id", id, scene, &err) == RN_OK) return true;
    rn_log(RN_LOG_ERROR, "scene %s: %s", id, err.text);
    return false;
}

// A daemon that was killed may have missed the runner's last checkpoint.
static void adopt_checkpoint(struct rn_scene_row *scene, const struct rn_wire_opened *opened) {
    if (opened->parameters_sha256[0] == '\0') return;
    scene->steps = opened->steps;
    scene->train_seconds = opened->train_seconds;
    scene->psnr = opened->psnr;
    snprintf(scene->sha256, sizeof scene->sha256, "%s", opened->parameters_sha256);
    snprintf(scene->digest, sizeof scene->digest, "%s", opened->digest);
}

// A checkpoint was damaged; the one before it took its place. Its record goes with it.
static void fell_back(struct rn_control *control, const char *scene, const char *set_aside,
                      int64_t steps) {
    struct rn_query query = {.equal = {{"scene", scene}}};
    void *rows = NULL;
    size_t count = 0;
    struct rn_error err = {0};
    rn_log(RN_LOG_ERROR, "scene %s: a checkpoint is damaged: %s; it is at step %lld now", scene,
           set_aside, (long long)steps);
    control->stats.checkpoints_damaged++;
    enum rn_status status =
        rn_store_list(control->store, &rn_checkpoints, &query, &rows, &count, &err);
    const struct rn_checkpoint_row *row = rows;
    for (size_t i = 0; status == RN_OK && i < count; i++)
        if (row[i].step > steps)
            status = rn_store_delete(control->store, &rn_checkpoints, row[i].id, &err);
    if (status != RN_OK) rn_log(RN_LOG_ERROR, "scene %s: %s", scene, err.text);
    rn_rows_finish(&rn_checkpoints, rows, count);
}

static void on_opened(struct rn_control *control, struct rn_runner *runner,
                      struct rn_wire_opened *opened) {
    struct rn_scene_row scene;
    runner->state = RN_RUNNER_READY;
    if (runner->helps[0] != '\0') {
        rn_helper_go_on(control, runner);
        return;
    }
    if (opened->set_aside[0] != '\0')
        fell_back(control, runner->scene, opened->set_aside, opened->steps);
    if (opened->loaded && find_scene(control, runner->scene, &scene)) {
        if (opened->memory_bytes > 0) scene.memory_bytes = opened->memory_bytes;
        adopt_checkpoint(&scene, opened);
        update_scene(control, &scene);
        rn_row_finish(&rn_scenes, &scene);
    }
    if (runner->train != NULL) rn_runner_begin(control, runner->train);
    if (runner->work != NULL) rn_runner_begin(control, runner->work);
    rn_render_send(control, runner);
    control->schedule_due = true; // memory is known now
}

static void on_state(struct rn_control *control, struct rn_runner *runner,
                     struct rn_wire_state *state) {
    struct rn_scene_row scene;
    if (state->set_aside[0] != '\0')
        fell_back(control, runner->scene, state->set_aside, state->steps);
    if (state->scene == NULL || !find_scene(control, runner->scene, &scene)) return;
    set_document(&scene.record, &state->scene);
    update_scene(control, &scene);
    rn_row_finish(&rn_scenes, &scene);
}

// Counters of a job begin at zero, again after a restart of its runner.
static uint64_t growth(int64_t before, int64_t now) {
    return (uint64_t)(now >= before ? now - before : now);
}

static void count_nonfinite(struct rn_control *control, struct rn_task *task,
                            const struct rn_nonfinite *now) {
    struct rn_nonfinite *old = &task->live_nonfinite;
    struct rn_control_stats *stats = &control->stats;
    stats->nonfinite_rays += growth(old->rays, now->rays);
    stats->steps_rejected += growth(old->steps_rejected, now->steps_rejected);
    stats->rollbacks += growth(old->rollbacks, now->rollbacks);
    *old = *now;
}

static void on_progress(struct rn_control *control, struct rn_runner *runner,
                        struct rn_wire_progress *progress) {
    struct rn_task *task = task_of(runner, progress->job);
    if (task == NULL || progress->progress == NULL) return;
    if (task->row.type == RN_JOB_TRAIN) {
        struct rn_train_progress live;
        if (rn_decode(&rn_train_progress_table, progress->progress, strlen(progress->progress),
                      &live, NULL, NULL) == RN_OK) {
            count_nonfinite(control, task, &live.nonfinite);
            bool trains = live.stage[0] == '\0';
            if (trains) task->live = live;
            if (trains && !task->began)
                control->schedule_due = true; // paths may have waited for it
            task->began |= trains;
        }
    } else {
        struct rn_work_progress work;
        if (rn_decode(&rn_work_progress_table, progress->progress, strlen(progress->progress),
                      &work, NULL, NULL) == RN_OK) {
            if (work.done > task->live_done && task->row.type == RN_JOB_PATH)
                task->progressed = true;
            task->live_done = work.done;
            task->live_left_s = work.eta_seconds;
            count_nonfinite(control, task, &work.nonfinite);
        }
    }
    set_document(&task->row.progress, &progress->progress);
    rn_task_publish(control, task, RN_EVENT_PROGRESS, task->row.progress, true);
}

static void on_metric(struct rn_control *control, struct rn_runner *runner,
                      const struct rn_wire_metric *metric) {
    struct rn_task *task = task_of(runner, metric->job);
    struct rn_error err = {0};
    char *json = NULL;
    if (task == NULL) return;
    if (rn_metric_record(control, task->row.id, &metric->metric, &err) != RN_OK)
        rn_task_log(task, RN_LOG_ERROR, "a figure is not kept: %s", err.text);
    if (rn_encode(&rn_metric_event_table, &metric->metric, &json, NULL, NULL) == RN_OK)
        rn_task_publish(control, task, RN_EVENT_METRIC, json, false);
    free(json);
}

static void on_incident(struct rn_control *control, struct rn_runner *runner,
                        const struct rn_wire_incident *incident) {
    struct rn_task *task = task_of(runner, incident->job);
    char *json = NULL;
    if (task == NULL) return;
    rn_task_log(task, RN_LOG_WARN,
                "step %lld: %s; %lld rays and %lld parameters were not finite: %s",
                (long long)incident->incident.step, rn_incident_kind_names[incident->incident.kind],
                (long long)incident->incident.rays, (long long)incident->incident.parameters,
                incident->incident.file);
    if (rn_encode(&rn_incident_event_table, &incident->incident, &json, NULL, NULL) == RN_OK)
        rn_task_publish(control, task, RN_EVENT_INCIDENT, json, false);
    free(json);
}

// `path` holds its path.
static struct rn_checkpoint_row
checkpoint_row(const char *scene, const struct rn_wire_checkpoint *checkpoint, char path[96]) {
    struct rn_checkpoint_row row = {.step = checkpoint->step,
                                    .size_bytes = checkpoint->size_bytes,
                                    .created_ms = rn_clock_wall_ms(),
                                    .path = path};
    snprintf(row.id, sizeof row.id, "%s/%lld", scene, (long long)checkpoint->step);
    snprintf(row.scene, sizeof row.scene, "%s", scene);
    snprintf(row.sha256, sizeof row.sha256, "%s", checkpoint->parameters_sha256);
    snprintf(row.digest, sizeof row.digest, "%s", checkpoint->digest);
    snprintf(path, 96, "checkpoints/%s", checkpoint->file);
    return row;
}

static enum rn_status insert_checkpoint(struct rn_control *control,
                                        const struct rn_scene_row *scene,
                                        const struct rn_wire_checkpoint *checkpoint,
                                        struct rn_error *err) {
    char path[96];
    struct rn_checkpoint_row row = checkpoint_row(scene->id, checkpoint, path);
    enum rn_status status = rn_store_delete(control->store, &rn_checkpoints, row.id, err);
    if (status == RN_OK) status = rn_store_insert(control->store, &rn_checkpoints, &row, err);
    return status;
}

enum rn_status rn_task_prune_checkpoints(struct rn_control *control, const char *scene, size_t kept,
                                         struct rn_error *err) {
    struct rn_query query = {.equal = {{"scene", scene}}};
    void *rows = NULL;
    size_t count = 0;
    enum rn_status status =
        rn_store_list(control->store, &rn_checkpoints, &query, &rows, &count, err);
    const struct rn_checkpoint_row *row = rows;
    for (size_t i = kept; status == RN_OK && i < count; i++)
        status = rn_store_delete(control->store, &rn_checkpoints, row[i].id, err);
    rn_rows_finish(&rn_checkpoints, rows, count);
    return status;
}

static enum rn_status record_checkpoint(struct rn_control *control, struct rn_scene_row *scene,
                                        const struct rn_wire_checkpoint *checkpoint,
                                        struct rn_error *err) {
    enum rn_status status = rn_store_begin(control->store, err);
    if (status != RN_OK) return status;
    status = rn_store_update(control->store, &rn_scenes, scene, err);
    if (status == RN_OK) status = insert_checkpoint(control, scene, checkpoint, err);
    if (status == RN_OK)
        status = rn_task_prune_checkpoints(control, scene->id, RN_CHECKPOINTS_KEPT, err);
    if (status == RN_OK) return rn_store_commit(control->store, err);
    rn_store_rollback(control->store);
    return status;
}

static void on_checkpoint(struct rn_control *control, struct rn_runner *runner,
                          struct rn_wire_checkpoint *checkpoint) {
    struct rn_error err = {0};
    struct rn_scene_row scene;
    struct rn_task *task = task_of(runner, checkpoint->job);
    if (!find_scene(control, runner->scene, &scene)) return;
    if (task != NULL && checkpoint->step > scene.steps) task->progressed = true;
    scene.steps = checkpoint->step;
    scene.train_seconds = checkpoint->train_seconds;
    scene.psnr = checkpoint->psnr;
    runner->memory_bytes = control->executor->memory(control->executor, &runner->process);
    scene.memory_bytes = runner->memory_bytes;
    snprintf(scene.sha256, sizeof scene.sha256, "%s", checkpoint->parameters_sha256);
    snprintf(scene.digest, sizeof scene.digest, "%s", checkpoint->digest);
    if (checkpoint->scene != NULL) set_document(&scene.record, &checkpoint->scene);
    if (record_checkpoint(control, &scene, checkpoint, &err) != RN_OK)
        rn_log(RN_LOG_ERROR, "scene %s, checkpoint %s: %s", scene.id, checkpoint->file, err.text);
    rn_row_finish(&rn_scenes, &scene);
}

// Whether a frame is told of for the first time in this attempt: where parts meet, two runners may
// make the same one at the same moment. Without memory to know, each is told of.
static bool is_news(struct rn_task *task, int64_t index) {
    size_t byte = (size_t)index / 8;
    uint8_t bit = (uint8_t)(1u << index % 8);
    if (byte >= task->told_bytes) {
        uint8_t *told = realloc(task->told, 2 * byte + 1);
        if (told == NULL) return true;
        memset(told + task->told_bytes, 0, 2 * byte + 1 - task->told_bytes);
        task->told = told;
        task->told_bytes = 2 * byte + 1;
    }
    bool news = !(task->told[byte] & bit);
    task->told[byte] |= bit;
    return news;
}

static void on_frame(struct rn_control *control, struct rn_runner *runner,
                     const struct rn_wire_frame *frame) {
    struct rn_task *task = strcmp(runner->helps, frame->job) == 0
                               ? rn_task_find(control, frame->job)
                               : task_of(runner, frame->job);
    struct rn_frame_event event = {.index = frame->index};
    char *json = NULL;
    if (task == NULL) return;
    task->progressed = true;
    if (task->row.type != RN_JOB_PATH || !is_news(task, frame->index)) return;
    snprintf(event.url, sizeof event.url, "/v1/jobs/%s/frames/%lld", frame->job,
             (long long)frame->index);
    if (rn_encode(&rn_frame_event_table, &event, &json, NULL, NULL) == RN_OK)
        rn_task_publish(control, task, RN_EVENT_FRAME, json, false);
    free(json);
}

// The job ends with what it has made, of which there is one record with its end, or neither.
static enum rn_status end_made(struct rn_control *control, struct rn_task *task,
                               const struct rn_ingest_result *made, struct rn_error *err) {
    char *result = NULL;
    enum rn_status status = rn_encode(&rn_ingest_result_table, made, &result, NULL, err);
    if (status != RN_OK) return status;
    set_document(&task->row.result, &result);
    status = rn_task_apply(control, task, RN_JOB_DONE, false, err);
    if (status != RN_OK) set_document(&task->row.result, &result); // there is none
    return status;
}

// The scene comes into being, with the checkpoint that was taken in.
static enum rn_status make_scene(struct rn_control *control, struct rn_task *task,
                                 const struct rn_wire_checkpoint *taken, struct rn_error *err) {
    struct rn_scene_row scene = {.created_ms = rn_clock_wall_ms(),
                                 .state = RN_SCENE_READY,
                                 .steps = taken->step,
                                 .train_seconds = taken->train_seconds,
                                 .psnr = taken->psnr,
                                 .record = taken->scene};
    struct rn_scene_import_options options;
    struct rn_ingest_result made = {.dataset = ""};
    char path[96];
    enum rn_status status = rn_decode(&rn_scene_import_options_table, task->row.options,
                                      strlen(task->row.options), &options, NULL, err);
    if (status != RN_OK) return status;
    snprintf(scene.id, sizeof scene.id, "%s", task->row.scene);
    snprintf(scene.name, sizeof scene.name, "%s", task->row.scene_name);
    snprintf(scene.dataset, sizeof scene.dataset, "%s", options.dataset);
    snprintf(scene.job, sizeof scene.job, "%s", task->row.id);
    snprintf(scene.sha256, sizeof scene.sha256, "%s", taken->parameters_sha256);
    snprintf(scene.digest, sizeof scene.digest, "%s", taken->digest);
    snprintf(made.scene, sizeof made.scene, "%s", task->row.scene);
    struct rn_checkpoint_row checkpoint = checkpoint_row(scene.id, taken, path);
    task->makes_scene = &scene;
    task->makes_checkpoint = &checkpoint;
    status = end_made(control, task, &made, err);
    task->makes_scene = NULL;
    task->makes_checkpoint = NULL;
    return status;
}

static enum rn_status end_scene_import(struct rn_control *control, struct rn_task *task,
                                       const char *contents, struct rn_error *err) {
    const struct rn_table *table = rn_wire_table(RN_WIRE_CHECKPOINT);
    struct rn_wire_checkpoint taken;
    enum rn_status status = rn_decode(table, contents, strlen(contents), &taken, NULL, err);
    if (status != RN_OK) return status;
    status = make_scene(control, task, &taken, err);
    rn_message_finish(table, &taken);
    return status;
}

// The dataset comes into being, named as the job said.
static enum rn_status end_ingest(struct rn_control *control, struct rn_task *task,
                                 const char *contents, struct rn_error *err) {
    struct rn_dataset_row dataset = {.created_ms = rn_clock_wall_ms(), .record = (char *)contents};
    struct rn_ingest_result ingest = {.scene = ""};
    if (task->row.scene[0] != '\0') return end_scene_import(control, task, contents, err);
    snprintf(dataset.id, sizeof dataset.id, "%s", task->row.dataset);
    snprintf(dataset.name, sizeof dataset.name, "%s", task->row.dataset_name);
    snprintf(ingest.dataset, sizeof ingest.dataset, "%s", task->row.dataset);
    task->makes = &dataset;
    enum rn_status status = end_made(control, task, &ingest, err);
    task->makes = NULL;
    return status;
}

static enum rn_status end_other(struct rn_control *control, struct rn_task *task,
                                struct rn_wire_done *done, struct rn_error *err) {
    enum rn_status status =
        task->row.type == RN_JOB_ESTIMATE ? rn_estimate_make(control, &done->result, err) : RN_OK;
    if (status != RN_OK) return status;
    set_document(&task->row.result, &done->result);
    if (task->row.type == RN_JOB_TRAIN) rn_estimate_check_training(control, &task->row);
    rn_task_happened(control, task, RN_JOB_DONE);
    if (task->row.type == RN_JOB_TRAIN && !rn_ladder_has(control, task->row.id))
        rn_idle_want_curve(control, task->row.scene);
    if (task->row.type == RN_JOB_CURVE) rn_idle_has_curve(control, task->row.scene);
    return RN_OK;
}

static void on_done(struct rn_control *control, struct rn_runner *runner,
                    struct rn_wire_done *done) {
    struct rn_error err = {0};
    struct rn_task *task = task_of(runner, done->job);
    if (runner->helps[0] != '\0') rn_helper_go_on(control, runner);
    if (task == NULL) return;
    enum rn_status status = task->row.type == RN_JOB_INGEST
                                ? end_ingest(control, task, done->result, &err)
                                : end_other(control, task, done, &err);
    if (status != RN_OK)
        rn_task_fail(control, task, &err);
    else
        rn_task_detach(task);
    if (rn_runner_is_for_one(runner)) rn_runner_shutdown(control, runner);
}

// The settings that a job's budget has become are its options from now on.
static void on_resolved(struct rn_control *control, struct rn_runner *runner,
                        struct rn_wire_resolved *resolved) {
    struct rn_error err = {0};
    struct rn_task *task = task_of(runner, resolved->job);
    if (task == NULL) return;
    set_document(&task->row.options, &resolved->options);
    if (rn_store_update(control->store, &rn_jobs_table, &task->row, &err) != RN_OK)
        rn_task_log(task, RN_LOG_ERROR, "%s", err.text);
    rn_task_announce(control, task);
}

static void try_again(struct rn_task *task) {
    rn_task_detach(task);
    task->not_before_ns = rn_clock_ns() + BUSY_RETRY_NS;
}

// The scene could not be opened: all that waits for it fails.
static void open_failed(struct rn_control *control, struct rn_runner *runner,
                        const struct rn_error *err) {
    if (err->status == RN_ERROR_BUSY) { // an orphan still holds the scene's folder
        if (runner->train != NULL) try_again(runner->train);
        if (runner->work != NULL) try_again(runner->work);
        rn_render_fail_all(control, runner, err);
        rn_runner_shutdown(control, runner);
        return;
    }
    if (runner->train != NULL) rn_task_fail(control, runner->train, err);
    if (runner->work != NULL) rn_task_fail(control, runner->work, err);
    rn_render_fail_all(control, runner, err);
    rn_runner_shutdown(control, runner);
}

static void on_failed(struct rn_control *control, struct rn_runner *runner,
                      const struct rn_wire_failed *failed) {
    struct rn_error err = {.status = rn_status_from_name(failed->status)};
    struct rn_task *task = task_of(runner, failed->job);
    snprintf(err.where, sizeof err.where, "%s", failed->where);
    snprintf(err.text, sizeof err.text, "%s", failed->text);
    if (runner->helps[0] != '\0') { // the runner that has the job makes its frames
        rn_log(RN_LOG_WARN, "runner %d: %s", (int)runner->process.pid, err.text);
        rn_runner_shutdown(control, runner);
    } else if (failed->request != RN_ABSENT) {
        rn_render_failed(control, runner, failed->request, &err);
    } else if (failed->job[0] == '\0') {
        open_failed(control, runner, &err);
    } else if (task != NULL && err.status == RN_ERROR_CANCELLED) {
        // By the daemon's own end: the next one finds it as it is.
        if (!control->stopping || task->row.state == RN_JOB_CANCELLING)
            rn_task_happened(control, task, RN_JOB_STOPPED);
        rn_task_detach(task);
    } else if (task != NULL) {
        rn_task_fail(control, task, &err);
    }
    if (rn_runner_is_for_one(runner)) rn_runner_shutdown(control, runner);
}

static void on_info(struct rn_control *control, struct rn_runner *runner,
                    const struct rn_wire_info *info) {
    struct rn_runner_device *device = &control->device;
    snprintf(device->device, sizeof device->device, "%s", info->device);
    snprintf(device->name, sizeof device->name, "%s", info->device_name);
    snprintf(device->kernels, sizeof device->kernels, "%s", info->kernels);
    snprintf(device->available, sizeof device->available, "%s", info->available);
    device->threads = info->threads;
    device->films = info->films;
    runner->state = RN_RUNNER_ENDING;
}

static void on_hello(struct rn_control *control, struct rn_runner *runner,
                     const struct rn_wire_hello *hello) {
    struct rn_error err;
    const char *version = control->options.version;
    if (hello->protocol != RN_WIRE_PROTOCOL || strcmp(hello->version, version) != 0 ||
        strcmp(hello->mode, runner->mode) != 0) {
        rn_error_set(&err, RN_ERROR_UNSUPPORTED, "version",
                     "the runner%s%s is version %.20s (protocol %lld, mode %.10s), the daemon %s "
                     "(protocol %d): install the same",
                     runner->where.machine[0] != '\0' ? " on " : "", runner->where.machine,
                     hello->version, (long long)hello->protocol, hello->mode, version,
                     RN_WIRE_PROTOCOL);
        rn_log(RN_LOG_ERROR, "runner %d: %s", (int)runner->process.pid, err.text);
        open_failed(control, runner, &err);
    } else if (rn_runner_imports(runner)) {
        runner->state = RN_RUNNER_READY;
        if (runner->work != NULL) rn_runner_begin(control, runner->work);
    }
}

union any {
    struct rn_wire_hello hello;
    struct rn_wire_opened opened;
    struct rn_wire_state state;
    struct rn_wire_progress progress;
    struct rn_wire_metric metric;
    struct rn_wire_checkpoint checkpoint;
    struct rn_wire_incident incident;
    struct rn_wire_frame frame;
    struct rn_wire_rendered rendered;
    struct rn_wire_done done;
    struct rn_wire_failed failed;
    struct rn_wire_resolved resolved;
    struct rn_wire_info info;
    struct rn_wire_reserve reserve;
};

static void dispatch(struct rn_control *control, struct rn_runner *runner,
                     const struct rn_wire_message *message, union any *any) {
    switch (message->type) {
    case RN_WIRE_HELLO:
        on_hello(control, runner, &any->hello);
        break;
    case RN_WIRE_OPENED:
        on_opened(control, runner, &any->opened);
        break;
    case RN_WIRE_STATE:
        on_state(control, runner, &any->state);
        break;
    case RN_WIRE_PROGRESS:
        on_progress(control, runner, &any->progress);
        break;
    case RN_WIRE_METRIC:
        on_metric(control, runner, &any->metric);
        break;
    case RN_WIRE_CHECKPOINT:
        on_checkpoint(control, runner, &any->checkpoint);
        break;
    case RN_WIRE_INCIDENT:
        on_incident(control, runner, &any->incident);
        break;
    case RN_WIRE_FRAME:
        on_frame(control, runner, &any->frame);
        break;
    case RN_WIRE_RENDERED:
        rn_render_done(control, runner, &any->rendered, message->blob, message->blob_size);
        break;
    case RN_WIRE_DONE:
        on_done(control, runner, &any->done);
        break;
    case RN_WIRE_FAILED:
        on_failed(control, runner, &any->failed);
        break;
    case RN_WIRE_INFO:
        on_info(control, runner, &any->info);
        break;
    case RN_WIRE_RESOLVED:
        on_resolved(control, runner, &any->resolved);
        break;
    case RN_WIRE_RESERVE:
        rn_gpu_reserve(control, runner, &any->reserve);
        break;
    case RN_WIRE_ALIVE: // one that fetches what it needs may take its time
        if (runner->state == RN_RUNNER_STARTING) rn_runner_more_time(runner);
        break;
    default:
        break;
    }
}

void rn_runner_receive(struct rn_control *control, struct rn_runner *runner,
                       const struct rn_wire_message *message) {
    const struct rn_table *table =
        message->type >= RN_WIRE_HELLO ? rn_wire_table(message->type) : NULL;
    struct rn_error err = {0};
    union any any;
    if (table == NULL || rn_wire_take(message, &any, &err) != RN_OK) {
        rn_log(RN_LOG_ERROR, "runner %d: bad %s message: %s %s", (int)runner->process.pid,
               rn_wire_type_name(message->type), err.where, err.text);
        runner->broken = true;
        return;
    }
    dispatch(control, runner, message, &any);
    rn_message_finish(table, &any);
}
