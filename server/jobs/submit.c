// New jobs, commands to jobs, and the end of scenes and datasets.
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "proto/event.h"
#include "proto/marks.h"
#include "server/jobs/inside.h"

// What a submission will write.
struct draft {
    struct rn_job_row job;
    struct rn_scene_row scene; // train
};

static void set_text(char *target, size_t size, const char *text) {
    snprintf(target, size, "%s", text);
}

// Unfinished jobs; of one token, where `owner` is not NULL.
static int count_open(const struct rn_control *control, const char *owner) {
    int open = 0;
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        open += !rn_job_is_over(task->row.state) &&
                (owner == NULL || strcmp(task->row.owner, owner) == 0);
    return open;
}

// Bytes that a token's jobs have made, the marks of its scenes with them: these have no record.
static enum rn_status owned_bytes(struct rn_control *control, const char *owner, int64_t *ret_bytes,
                                  struct rn_error *err) {
    struct rn_query query = {.equal = {{"owner", owner}, {"type", rn_job_type_names[RN_JOB_TRAIN]}},
                             .without = "source"};
    void *rows = NULL;
    size_t count = 0;
    enum rn_status status = rn_store_owned_bytes(control->store, owner, ret_bytes, err);
    if (status == RN_OK)
        status = rn_store_list(control->store, &rn_jobs_table, &query, &rows, &count, err);
    for (size_t i = 0; i < count; i++) {
        struct rn_mark marks[RN_MARKS_KEPT];
        const struct rn_job_row *job = &((const struct rn_job_row *)rows)[i];
        char *folder = rn_store_path(control->store, "scenes/%s", job->scene);
        size_t kept = folder != NULL ? rn_marks_list(folder, marks) : 0;
        for (size_t m = 0; m < kept; m++)
            *ret_bytes += marks[m].size_bytes;
        free(folder);
    }
    rn_rows_finish(&rn_jobs_table, rows, count);
    return status;
}

// Evaluations and what is measured leave nothing on the disk to speak of, and a ladder's trainings
// are jobs of their own.
static bool takes_space(enum rn_job_type type) {
    return type != RN_JOB_EVAL && type != RN_JOB_CURVE && type != RN_JOB_ESTIMATE &&
           type != RN_JOB_EFFECTS && type != RN_JOB_LADDER && type != RN_JOB_DOCTOR &&
           type != RN_JOB_VALIDATE;
}

static enum rn_status check_quotas(struct rn_control *control, const struct rn_submission *wanted,
                                   struct rn_error *err) {
    const struct rn_caller *caller = wanted->caller;
    int64_t bytes = 0;
    if (caller == NULL || caller->id[0] == '\0') return RN_OK;
    int open = count_open(control, caller->id);
    if (caller->max_jobs > 0 && open >= caller->max_jobs)
        return rn_error_set(err, RN_ERROR_BUSY, "", "token '%s' has %d unfinished jobs, its quota",
                            caller->name, open);
    if (caller->max_bytes == 0 || !takes_space(wanted->type)) return RN_OK;
    enum rn_status status = owned_bytes(control, caller->id, &bytes, err);
    if (status != RN_OK || bytes + wanted->upload_bytes <= caller->max_bytes) return status;
    return rn_error_set(err, RN_ERROR_LIMIT, "",
                        "what token '%s' has made holds %lld bytes, its quota is %lld; delete "
                        "something",
                        caller->name, (long long)(bytes + wanted->upload_bytes),
                        (long long)caller->max_bytes);
}

enum rn_status rn_control_usage(struct rn_control *control, const char *token, int64_t *ret_jobs,
                                int64_t *ret_bytes, struct rn_error *err) {
    rn_control_lock(control);
    *ret_jobs = count_open(control, token);
    enum rn_status status = owned_bytes(control, token, ret_bytes, err);
    rn_control_unlock(control);
    return status;
}

static enum rn_status check_queue(struct rn_control *control, struct rn_error *err) {
    int open = count_open(control, NULL);
    if (control->stopping)
        return rn_error_set(err, RN_ERROR_UNAVAILABLE, "", "the daemon is shutting down");
    if (open >= control->options.max_queued)
        return rn_error_set(err, RN_ERROR_BUSY, "", "%d jobs wait or run already, the limit", open);
    return RN_OK;
}

static enum rn_status take_dataset(struct rn_control *control, const struct rn_submission *wanted,
                                   struct draft *draft, struct rn_error *err) {
    struct rn_dataset_row dataset;
    enum rn_status status = rn_store_resolve(control->store, &rn_datasets, RN_ID_DATASET,
                                             wanted->dataset, &dataset, err);
    if (status != RN_OK) return status;
    set_text(draft->job.dataset, sizeof draft->job.dataset, dataset.id);
    set_text(draft->job.dataset_name, sizeof draft->job.dataset_name, dataset.name);
    rn_row_finish(&rn_datasets, &dataset);
    return RN_OK;
}

// RN_ERROR_CONFLICT where there is a scene of the wanted name, or an import makes one.
static enum rn_status check_scene_name(struct rn_control *control, const char *name,
                                       const char *where, struct rn_error *err) {
    struct rn_scene_row scene;
    struct rn_error absent;
    if (rn_store_find(control->store, &rn_scenes, "name", name, &scene, &absent) == RN_OK) {
        const struct rn_task *task = rn_task_training(control, scene.id);
        rn_error_set(err, RN_ERROR_CONFLICT, where, "there is a scene '%s'%s%s%s", scene.name,
                     task != NULL ? ", and job " : "", task != NULL ? task->row.id : "",
                     task != NULL ? " is training it" : "; choose another name or delete that one");
        rn_row_finish(&rn_scenes, &scene);
        return RN_ERROR_CONFLICT;
    }
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (task->row.type == RN_JOB_INGEST && !rn_job_is_over(task->row.state) &&
            strcmp(task->row.scene_name, name) == 0)
            return rn_error_set(err, RN_ERROR_CONFLICT, where,
                                "job %s imports a scene '%s' already", task->row.id, name);
    return RN_OK;
}

int rn_train_ranks(const char *json) {
    struct rn_train_options options;
    if (rn_decode(&rn_train_options_table, json, strlen(json), &options, NULL, NULL) != RN_OK)
        return 1;
    int64_t ranks = rn_int_or(options.ranks, 1);
    rn_message_finish(&rn_train_options_table, &options);
    return (int)ranks;
}

// Ranks are started by a cluster's scheduler, and read what they train from a folder that all see.
static enum rn_status check_ranks(const struct rn_control *control, const char *json,
                                  struct rn_error *err) {
    const struct rn_executor *executor = control->executor;
    if (rn_train_ranks(json) == 1 || (executor->spreads && executor->keeps)) return RN_OK;
    return rn_error_set(err, RN_ERROR_INVALID, "#/options/ranks",
                        "%s: one training over several nodes needs a daemon with --executor slurm "
                        "and a folder that all of them see, --shared",
                        executor->spreads ? "nothing is shared" : "this machine is no cluster");
}

static enum rn_status draft_train(struct rn_control *control, const struct rn_submission *wanted,
                                  struct draft *draft, struct rn_error *err) {
    enum rn_status status = take_dataset(control, wanted, draft, err);
    if (status == RN_OK) status = check_ranks(control, wanted->options, err);
    if (status == RN_OK) status = check_scene_name(control, wanted->scene, "#/scene", err);
    if (status != RN_OK) return status;
    status = rn_store_new_id(RN_ID_SCENE, draft->scene.id, err);
    set_text(draft->scene.name, sizeof draft->scene.name, wanted->scene);
    set_text(draft->scene.dataset, sizeof draft->scene.dataset, draft->job.dataset);
    set_text(draft->scene.job, sizeof draft->scene.job, draft->job.id);
    draft->scene.created_ms = draft->job.created_ms;
    draft->scene.psnr = NAN;
    set_text(draft->job.scene, sizeof draft->job.scene, draft->scene.id);
    set_text(draft->job.scene_name, sizeof draft->job.scene_name, draft->scene.name);
    return status;
}

static enum rn_status draft_work(struct rn_control *control, const struct rn_submission *wanted,
                                 struct draft *draft, struct rn_error *err) {
    struct rn_scene_row scene;
    enum rn_status status =
        rn_store_resolve(control->store, &rn_scenes, RN_ID_SCENE, wanted->scene, &scene, err);
    if (status != RN_OK) return status;
    const struct rn_task *task = rn_task_training(control, scene.id);
    set_text(draft->job.scene, sizeof draft->job.scene, scene.id);
    set_text(draft->job.scene_name, sizeof draft->job.scene_name, scene.name);
    bool began = task != NULL && task->began;
    if (scene.sha256[0] == '\0' && !began)
        status = rn_error_set(err, RN_ERROR_CONFLICT, "#/scene",
                              "scene '%s' has nothing to render%s%s%s%s", scene.name,
                              task != NULL ? " yet: its training, job " : " and nothing trains it",
                              task != NULL ? task->row.id : "", task != NULL ? ", is " : "",
                              task != NULL ? rn_job_state_names[task->row.state] : "");
    rn_row_finish(&rn_scenes, &scene);
    return status;
}

// A scene that comes as a file: its record is written when it has been read.
static enum rn_status draft_scene(struct rn_control *control, const struct rn_submission *wanted,
                                  struct draft *draft, struct rn_error *err) {
    enum rn_status status = check_scene_name(control, wanted->scene, "name", err);
    set_text(draft->job.scene_name, sizeof draft->job.scene_name, wanted->scene);
    return status != RN_OK ? status : rn_store_new_id(RN_ID_SCENE, draft->job.scene, err);
}

static enum rn_status draft_ingest(struct rn_control *control, const struct rn_submission *wanted,
                                   struct draft *draft, struct rn_error *err) {
    struct rn_dataset_row dataset;
    struct rn_error absent;
    if (rn_store_find(control->store, &rn_datasets, "name", wanted->dataset, &dataset, &absent) ==
        RN_OK) {
        rn_row_finish(&rn_datasets, &dataset);
        return rn_error_set(err, RN_ERROR_CONFLICT, "#/name",
                            "there is a dataset '%s'; choose another name or delete that one",
                            wanted->dataset);
    }
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (task->row.type == RN_JOB_INGEST && !rn_job_is_over(task->row.state) &&
            strcmp(task->row.dataset_name, wanted->dataset) == 0)
            return rn_error_set(err, RN_ERROR_CONFLICT, "#/name",
                                "job %s imports a dataset '%s' already", task->row.id,
                                wanted->dataset);
    set_text(draft->job.dataset_name, sizeof draft->job.dataset_name, wanted->dataset);
    return rn_store_new_id(RN_ID_DATASET, draft->job.dataset, err);
}

static enum rn_status make_draft(struct rn_control *control, const struct rn_submission *wanted,
                                 struct draft *draft, struct rn_error *err) {
    struct rn_job_row *job = &draft->job;
    if (wanted->caller != NULL) set_text(job->owner, sizeof job->owner, wanted->caller->id);
    if (wanted->traceparent != NULL && wanted->traceparent[0] != '\0')
        rn_trace_begin(wanted->traceparent, job->traceparent);
    job->type = wanted->type;
    job->state = RN_JOB_QUEUED;
    job->attempt = 1;
    job->created_ms = rn_clock_wall_ms();
    enum rn_status status = rn_store_new_id(RN_ID_JOB, job->id, err);
    if (status != RN_OK) return status;
    if (wanted->type == RN_JOB_TRAIN)
        status = draft_train(control, wanted, draft, err);
    else if (wanted->type == RN_JOB_ESTIMATE || wanted->type == RN_JOB_LADDER)
        status = take_dataset(control, wanted, draft, err);
    else if (wanted->type == RN_JOB_INGEST && wanted->scene != NULL)
        status = draft_scene(control, wanted, draft, err);
    else if (wanted->type == RN_JOB_INGEST)
        status = draft_ingest(control, wanted, draft, err);
    else if (wanted->type != RN_JOB_VALIDATE)
        status = draft_work(control, wanted, draft, err);
    if (status != RN_OK) return status;
    job->options = strdup(wanted->options);
    if (wanted->spooled != NULL)
        job->source = rn_store_path(control->store, "spool/%s.tar", job->id);
    else if (wanted->source != NULL)
        job->source = strdup(wanted->source);
    bool needs_source = wanted->spooled != NULL || wanted->source != NULL;
    if (job->options == NULL || (needs_source && job->source == NULL))
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "job", "no memory for a job");
    return RN_OK;
}

static enum rn_status make_folder(struct rn_control *control, const char *job,
                                  struct rn_error *err) {
    char *path = rn_store_path(control->store, "jobs/%s/frames", job);
    if (path == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "job", "no memory for a job");
    enum rn_status status = rn_mkdirs_in(rn_store_folder(control->store), path, 0700, err);
    free(path);
    return status;
}

static enum rn_status write_draft(struct rn_control *control, const struct rn_submission *wanted,
                                  struct draft *draft, struct rn_error *err) {
    enum rn_status status = rn_store_begin(control->store, err); // the data folder is there
    if (status != RN_OK) return status;
    status = make_folder(control, draft->job.id, err);
    if (status == RN_OK && wanted->spooled != NULL)
        status = rn_file_rename(wanted->spooled, draft->job.source, err);
    if (status == RN_OK) status = rn_store_insert(control->store, &rn_jobs_table, &draft->job, err);
    if (status == RN_OK && wanted->type == RN_JOB_TRAIN)
        status = rn_store_insert(control->store, &rn_scenes, &draft->scene, err);
    if (status == RN_OK && wanted->key != NULL) {
        struct rn_key_row key = {.created_ms = draft->job.created_ms};
        set_text(key.id, sizeof key.id, wanted->key);
        set_text(key.digest, sizeof key.digest, wanted->digest);
        set_text(key.job, sizeof key.job, draft->job.id);
        status = rn_store_insert(control->store, &rn_keys, &key, err);
    }
    if (status == RN_OK)
        status = rn_store_commit(control->store, err);
    else
        rn_store_rollback(control->store);
    if (status != RN_OK && wanted->spooled != NULL) unlink(draft->job.source);
    return status;
}

// The job of an earlier request with the same key; RN_ERROR_NOT_FOUND when there was none.
static enum rn_status find_key(struct rn_control *control, const struct rn_submission *wanted,
                               char ret_id[RN_ID_MAX], struct rn_error *err) {
    struct rn_key_row key;
    enum rn_status status = rn_store_find(control->store, &rn_keys, "id", wanted->key, &key, err);
    if (status != RN_OK) return status;
    if (strcmp(key.digest, wanted->digest) != 0)
        return rn_error_set(err, RN_ERROR_CONFLICT, "Idempotency-Key",
                            "the key was used for another request (job %s)", key.job);
    set_text(ret_id, RN_ID_MAX, key.job);
    return RN_OK;
}

enum rn_status rn_task_submit(struct rn_control *control, const struct rn_submission *wanted,
                              struct rn_task **ret_task, struct rn_error *err) {
    struct draft draft = {0};
    struct rn_task *task = NULL;
    enum rn_status status = check_queue(control, err);
    if (status == RN_OK) status = check_quotas(control, wanted, err);
    if (status == RN_OK) status = make_draft(control, wanted, &draft, err);
    if (status == RN_OK) status = rn_task_create(&task, err);
    if (status == RN_OK) status = write_draft(control, wanted, &draft, err);
    if (status == RN_OK) {
        rn_task_add(control, task, &draft.job);
        rn_task_announce(control, task);
        rn_control_wake(control);
        *ret_task = task;
    } else {
        rn_task_free(task);
    }
    rn_row_finish(&rn_jobs_table, &draft.job);
    return status;
}

enum rn_status rn_task_submit_once(struct rn_control *control, const struct rn_submission *wanted,
                                   char ret_id[RN_ID_MAX], struct rn_error *err) {
    struct rn_task *task;
    enum rn_status status = find_key(control, wanted, ret_id, err);
    if (status != RN_ERROR_NOT_FOUND) return status;
    status = rn_task_submit(control, wanted, &task, err);
    if (status == RN_OK) set_text(ret_id, RN_ID_MAX, task->row.id);
    return status;
}

// `begun`: a path job whose frames the new one begins with, or NULL.
static enum rn_status submit(struct rn_control *control, const struct rn_submission *wanted,
                             const char *begun, char ret_id[RN_ID_MAX], char **ret_json,
                             struct rn_error *err) {
    struct rn_task *task;
    rn_idle_stop(control);
    enum rn_status status = rn_task_submit(control, wanted, &task, err);
    if (status != RN_OK) return status;
    set_text(ret_id, RN_ID_MAX, task->row.id);
    if (begun != NULL) rn_frames_hand_on(control, begun, task->row.id);
    rn_schedule(control);
    return rn_document_job(control, &task->row, ret_json, err);
}

enum rn_status rn_control_submit(struct rn_control *control, const struct rn_submission *wanted,
                                 char ret_id[RN_ID_MAX], char **ret_json, struct rn_error *err) {
    enum rn_status status = RN_ERROR_NOT_FOUND;
    rn_control_lock(control);
    if (wanted->key != NULL) status = find_key(control, wanted, ret_id, err);
    bool again = status == RN_OK;
    if (status == RN_ERROR_NOT_FOUND) status = submit(control, wanted, NULL, ret_id, ret_json, err);
    rn_control_unlock(control);
    return again ? rn_control_job_json(control, ret_id, ret_json, err) : status;
}

// Passes a command that changed the state on to the job's runner.
static void tell_runner(struct rn_control *control, struct rn_task *task, enum rn_job_event event) {
    static const enum rn_wire_type types[RN_JOB_EVENT_COUNT] = {
        [RN_JOB_PAUSE] = RN_WIRE_PAUSE,
        [RN_JOB_FINISH] = RN_WIRE_FINISH,
        [RN_JOB_CANCEL] = RN_WIRE_CANCEL,
    };
    if (event == RN_JOB_FINISH) task->finish = true;
    // What was not sent yet is told its state when it is; resuming is the scheduler's.
    if (task->runner == NULL || !task->sent || event == RN_JOB_RESUME) return;
    rn_runner_post_job(control, task->runner, types[event], task->row.id);
}

// A finished job's answer to a command: only cancelling a cancelled one is no conflict.
static enum rn_status command_over(struct rn_control *control, const char *id,
                                   enum rn_job_event event, char **ret_json, struct rn_error *err) {
    struct rn_job_row row;
    enum rn_job_state next;
    enum rn_status status =
        rn_store_resolve(control->store, &rn_jobs_table, RN_ID_JOB, id, &row, err);
    if (status != RN_OK) return status;
    status = rn_job_next(row.type, row.state, event, false, &next, err);
    if (status == RN_OK) status = rn_document_job(control, &row, ret_json, err);
    rn_row_finish(&rn_jobs_table, &row);
    return status;
}

static enum rn_status command(struct rn_control *control, struct rn_task *task,
                              enum rn_job_event event, struct rn_error *err) {
    enum rn_job_state before = task->row.state;
    enum rn_status status = rn_task_apply(control, task, event, false, err);
    bool changed = status == RN_OK && task->row.state != before;
    if (changed || (status == RN_OK && event == RN_JOB_FINISH && !task->finish))
        tell_runner(control, task, event);
    return status;
}

bool rn_task_cancel(struct rn_control *control, struct rn_task *task) {
    struct rn_error err = {0};
    if (task == NULL || rn_job_is_over(task->row.state)) return false;
    if (command(control, task, RN_JOB_CANCEL, &err) != RN_OK)
        rn_task_log(task, RN_LOG_WARN, "%s", err.text);
    return !rn_job_is_over(task->row.state);
}

enum rn_status rn_control_command(struct rn_control *control, const char *id,
                                  enum rn_job_event event, char **ret_json, struct rn_error *err) {
    rn_control_lock(control);
    struct rn_task *task = rn_task_find(control, id);
    enum rn_status status;
    if (task == NULL) {
        status = command_over(control, id, event, ret_json, err);
    } else {
        status = command(control, task, event, err);
        if (status == RN_OK) {
            rn_schedule(control);
            rn_control_wake(control);
            status = rn_document_job(control, &task->row, ret_json, err);
        }
    }
    rn_control_unlock(control);
    return status;
}

static bool is_unfinished_path(const struct rn_job_row *job) {
    return job->type == RN_JOB_PATH &&
           (job->state == RN_JOB_FAILED || job->state == RN_JOB_CANCELLED);
}

enum rn_status rn_control_go_on(struct rn_control *control, const char *id,
                                const struct rn_caller *caller, char ret_id[RN_ID_MAX],
                                char **ret_json, struct rn_error *err) {
    struct rn_job_row row;
    ret_id[0] = '\0';
    rn_control_lock(control);
    const struct rn_task *task = rn_task_find(control, id);
    enum rn_status status =
        rn_store_resolve(control->store, &rn_jobs_table, RN_ID_JOB, id, &row, err);
    bool unfinished = status == RN_OK && is_unfinished_path(task != NULL ? &task->row : &row);
    if (unfinished) {
        struct rn_submission wanted = {.type = RN_JOB_PATH,
                                       .scene = row.scene,
                                       .source = row.source,
                                       .options = row.options,
                                       .caller = caller};
        status = submit(control, &wanted, row.id, ret_id, ret_json, err);
    }
    if (unfinished || status == RN_OK) rn_row_finish(&rn_jobs_table, &row);
    rn_control_unlock(control);
    if (unfinished || status != RN_OK) return status;
    return rn_control_command(control, id, RN_JOB_RESUME, ret_json, err);
}

static void remove_folder(struct rn_control *control, const char *kind, const char *id) {
    struct rn_error err = {0};
    char *path = rn_store_path(control->store, "%s/%s", kind, id);
    // What is left over is removed at the next start, for the store remembers that it was deleted.
    if (path == NULL || rn_remove_tree(path, &err) != RN_OK)
        rn_log(RN_LOG_WARN, "%s/%s: %s", kind, id, err.text);
    free(path);
}

static enum rn_status delete_scene(struct rn_control *control, const struct rn_scene_row *scene,
                                   struct rn_error *err) {
    rn_idle_stop(control);
    const struct rn_task *task = rn_task_of_scene(control, scene->id);
    if (task != NULL && !task->automatic)
        return rn_error_set(err, RN_ERROR_CONFLICT, "", "job %s works on scene '%s' (%s)",
                            task->row.id, scene->name, rn_job_state_names[task->row.state]);
    enum rn_status status = rn_task_settle_scene(control, scene->id, err);
    if (status == RN_OK) status = rn_store_begin(control->store, err);
    if (status != RN_OK) return status;
    status = rn_task_prune_checkpoints(control, scene->id, 0, err);
    if (status == RN_OK) status = rn_store_delete(control->store, &rn_scenes, scene->id, err);
    if (status == RN_OK) {
        status = rn_store_commit(control->store, err);
    } else {
        rn_store_rollback(control->store);
    }
    if (status != RN_OK) return status;
    struct rn_runner *runner = rn_runner_find(control, scene->id);
    if (runner != NULL) rn_runner_remove(control, runner, true);
    remove_folder(control, "scenes", scene->id);
    return RN_OK;
}

enum rn_status rn_task_delete_scene(struct rn_control *control, const char *reference,
                                    struct rn_error *err) {
    struct rn_scene_row scene;
    enum rn_status status =
        rn_store_resolve(control->store, &rn_scenes, RN_ID_SCENE, reference, &scene, err);
    if (status != RN_OK) return status;
    status = delete_scene(control, &scene, err);
    rn_row_finish(&rn_scenes, &scene);
    return status;
}

enum rn_status rn_control_delete_scene(struct rn_control *control, const char *reference,
                                       struct rn_error *err) {
    rn_control_lock(control);
    enum rn_status status = rn_task_delete_scene(control, reference, err);
    rn_control_unlock(control);
    return status;
}

static enum rn_status check_unused(struct rn_control *control, const struct rn_dataset_row *dataset,
                                   struct rn_error *err) {
    struct rn_query query = {.equal = {{"dataset", dataset->id}}, .limit = 1};
    void *rows = NULL;
    size_t count = 0;
    enum rn_status status = rn_store_list(control->store, &rn_scenes, &query, &rows, &count, err);
    if (status != RN_OK) return status;
    if (count > 0)
        status = rn_error_set(err, RN_ERROR_CONFLICT, "",
                              "scene '%s' was made from dataset '%s'; delete it first",
                              ((struct rn_scene_row *)rows)->name, dataset->name);
    rn_rows_finish(&rn_scenes, rows, count);
    for (const struct rn_task *task = control->tasks; status == RN_OK && task; task = task->next)
        if ((task->row.type == RN_JOB_ESTIMATE || task->row.type == RN_JOB_LADDER) &&
            !rn_job_is_over(task->row.state) && strcmp(task->row.dataset, dataset->id) == 0)
            status = rn_error_set(err, RN_ERROR_CONFLICT, "", "job %s works on dataset '%s'",
                                  task->row.id, dataset->name);
    return status;
}

enum rn_status rn_control_delete_dataset(struct rn_control *control, const char *reference,
                                         struct rn_error *err) {
    struct rn_dataset_row dataset;
    rn_control_lock(control);
    enum rn_status status =
        rn_store_resolve(control->store, &rn_datasets, RN_ID_DATASET, reference, &dataset, err);
    if (status == RN_OK) {
        status = check_unused(control, &dataset, err);
        if (status == RN_OK)
            status = rn_store_delete(control->store, &rn_datasets, dataset.id, err);
        if (status == RN_OK) remove_folder(control, "datasets", dataset.id);
        rn_row_finish(&rn_datasets, &dataset);
    }
    rn_control_unlock(control);
    return status;
}
