// Records as the API shows them.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/job.h"
#include "proto/scene.h"
#include "server/jobs/inside.h"

#define MAX_CHECKPOINTS 16

static void copy(char *target, size_t size, const char *text) {
    snprintf(target, size, "%s", text);
}

static void time_text(int64_t wall_ms, char target[RN_TIME_MAX]) {
    target[0] = '\0';
    if (wall_ms != 0) rn_time_text(wall_ms, target);
}

enum rn_status rn_document_job(struct rn_control *control, struct rn_job_row *row, char **ret_json,
                               struct rn_error *err) {
    struct rn_job job; // borrows the row's texts
    rn_message_init(&rn_job_table, &job);
    copy(job.id, sizeof job.id, row->id);
    job.type = (int)row->type;
    job.state = (int)row->state;
    job.attempt = row->attempt;
    time_text(row->created_ms, job.created_at);
    time_text(row->started_ms, job.started_at);
    time_text(row->finished_ms, job.finished_at);
    copy(job.dataset, sizeof job.dataset, row->dataset);
    copy(job.dataset_name, sizeof job.dataset_name, row->dataset_name);
    copy(job.scene, sizeof job.scene, row->scene);
    copy(job.scene_name, sizeof job.scene_name, row->scene_name);
    job.options = row->options != NULL ? row->options : (char *)"{}";
    job.progress = row->progress;
    job.result = row->result;
    job.problem = row->problem;
    copy(job.owner, sizeof job.owner, row->owner);
    copy(job.traceparent, sizeof job.traceparent, row->traceparent);
    const struct rn_task *task = rn_task_find(control, row->id);
    if (task != NULL && task->runner != NULL && task->runner->process.remote) {
        const struct rn_whereabouts *where = &task->runner->where;
        copy(job.runner.machine, sizeof job.runner.machine, where->machine);
        copy(job.runner.slurm_job, sizeof job.runner.slurm_job, where->job);
        copy(job.runner.reason, sizeof job.runner.reason, where->reason);
    }
    return rn_encode(&rn_job_table, &job, ret_json, NULL, err);
}

static enum rn_status list_checkpoints(struct rn_control *control, const char *scene,
                                       struct rn_checkpoint_record *records, size_t *ret_count,
                                       struct rn_error *err) {
    struct rn_query query = {.equal = {{"scene", scene}}, .limit = MAX_CHECKPOINTS};
    void *rows = NULL;
    size_t count = 0;
    enum rn_status status =
        rn_store_list(control->store, &rn_checkpoints, &query, &rows, &count, err);
    if (status != RN_OK) return status;
    const struct rn_checkpoint_row *row = rows;
    for (size_t i = 0; i < count; i++) {
        records[i] = (struct rn_checkpoint_record){row[i].step, row[i].size_bytes, ""};
        rn_time_text(row[i].created_ms, records[i].created_at);
    }
    rn_rows_finish(&rn_checkpoints, rows, count);
    *ret_count = count;
    return RN_OK;
}

static size_t list_marks(struct rn_control *control, const char *scene,
                         struct rn_mark marks[RN_MARKS_KEPT]) {
    char *folder = rn_store_path(control->store, "scenes/%s", scene);
    size_t count = folder != NULL ? rn_marks_list(folder, marks) : 0;
    free(folder);
    return count;
}

static enum rn_status dataset_name(struct rn_control *control, const char *id, char *name,
                                   struct rn_error *err) {
    struct rn_dataset_row dataset;
    enum rn_status status = rn_store_find(control->store, &rn_datasets, "id", id, &dataset, err);
    if (status == RN_ERROR_NOT_FOUND) copy(name, RN_NAME_MAX, id); // its record is lost
    if (status != RN_OK) return status == RN_ERROR_NOT_FOUND ? RN_OK : status;
    copy(name, RN_NAME_MAX, dataset.name);
    rn_row_finish(&rn_datasets, &dataset);
    return RN_OK;
}

static enum rn_status document_scene(struct rn_control *control, struct rn_scene_row *row,
                                     char **ret_json, struct rn_error *err) {
    const struct rn_task *task = rn_task_training(control, row->id);
    struct rn_checkpoint_record checkpoints[MAX_CHECKPOINTS];
    struct rn_mark marks[RN_MARKS_KEPT];
    struct rn_scene scene;
    rn_message_init(&rn_scene_table, &scene);
    enum rn_status status = RN_OK;
    if (row->record != NULL)
        status = rn_decode(&rn_scene_description_table, row->record, strlen(row->record),
                           &scene.description, NULL, err);
    if (status == RN_OK) status = dataset_name(control, row->dataset, scene.dataset_name, err);
    if (status == RN_OK)
        status = list_checkpoints(control, row->id, checkpoints, &scene.checkpoint_count, err);
    if (status == RN_OK) {
        copy(scene.id, sizeof scene.id, row->id);
        copy(scene.name, sizeof scene.name, row->name);
        copy(scene.dataset, sizeof scene.dataset, row->dataset);
        copy(scene.job, sizeof scene.job, row->job);
        copy(scene.parameters_sha256, sizeof scene.parameters_sha256, row->sha256);
        rn_time_text(row->created_ms, scene.created_at);
        scene.state = (int)rn_scene_state_of(row, task);
        bool live = task != NULL && task->live.step != RN_ABSENT;
        scene.steps = live ? task->live.step : row->steps;
        scene.train_seconds = live ? task->live.train_seconds : row->train_seconds;
        scene.psnr = live && !isnan(task->live.psnr) ? task->live.psnr : row->psnr;
        scene.checkpoints = checkpoints;
        scene.marks = marks;
        scene.mark_count = list_marks(control, row->id, marks);
        scene.description.memory_bytes = row->memory_bytes > 0 ? row->memory_bytes : RN_ABSENT;
        const struct rn_runner *runner = rn_runner_find(control, row->id);
        scene.loaded = runner != NULL && runner->state == RN_RUNNER_READY;
        status = rn_encode(&rn_scene_table, &scene, ret_json, NULL, err);
    }
    scene.checkpoints = NULL;
    scene.marks = NULL;
    scene.checkpoint_count = scene.mark_count = 0;
    rn_message_finish(&rn_scene_table, &scene);
    return status;
}

enum rn_status rn_control_scene_json(struct rn_control *control, struct rn_scene_row *row,
                                     char **ret_json, struct rn_error *err) {
    rn_control_lock(control);
    enum rn_status status = document_scene(control, row, ret_json, err);
    rn_control_unlock(control);
    return status;
}

enum rn_status rn_control_row_json(struct rn_control *control, struct rn_job_row *row,
                                   char **ret_json, struct rn_error *err) {
    rn_control_lock(control);
    struct rn_task *task = rn_task_find(control, row->id);
    enum rn_status status =
        rn_document_job(control, task != NULL ? &task->row : row, ret_json, err);
    rn_control_unlock(control);
    return status;
}

enum rn_status rn_control_job_json(struct rn_control *control, const char *id, char **ret_json,
                                   struct rn_error *err) {
    struct rn_job_row row;
    enum rn_status status =
        rn_store_resolve(control->store, &rn_jobs_table, RN_ID_JOB, id, &row, err);
    if (status != RN_OK) return status;
    status = rn_control_row_json(control, &row, ret_json, err);
    rn_row_finish(&rn_jobs_table, &row);
    return status;
}
