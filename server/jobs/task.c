// Jobs in memory: transitions, events, and what follows from a runner's end.
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "proto/event.h"
#include "proto/problem.h"
#include "server/jobs/inside.h"

// The pause between a lost runner and the next attempt.
#define RETRY_NS 1000000000ll

void rn_task_log(const struct rn_task *task, enum rn_log_level level, const char *fmt, ...) {
    char text[RN_LOG_TEXT_MAX];
    va_list args;
    va_start(args, fmt);
    vsnprintf(text, sizeof text, fmt, args);
    va_end(args);
    const char *before = rn_log_set_trace(task->row.traceparent);
    rn_log(level, "job %s: %s", task->row.id, text);
    rn_log_set_trace(before);
}

struct rn_task *rn_task_find(struct rn_control *control, const char *id) {
    for (struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (strcmp(task->row.id, id) == 0) return task;
    return NULL;
}

struct rn_task *rn_task_training(struct rn_control *control, const char *scene) {
    for (struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (task->row.type == RN_JOB_TRAIN && !rn_job_is_over(task->row.state) &&
            strcmp(task->row.scene, scene) == 0)
            return task;
    return NULL;
}

struct rn_task *rn_task_of_scene(struct rn_control *control, const char *scene) {
    for (struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (!rn_job_is_over(task->row.state) && strcmp(task->row.scene, scene) == 0) return task;
    return NULL;
}

enum rn_status rn_task_create(struct rn_task **ret_task, struct rn_error *err) {
    struct rn_task *task = calloc(1, sizeof *task);
    if (task == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "job", "no memory for a job");
    enum rn_status status = rn_ring_create(RN_RING_EVENTS, RN_RING_BYTES, &task->ring, err);
    if (status != RN_OK) {
        free(task);
        return status;
    }
    task->live.step = RN_ABSENT;
    *ret_task = task;
    return RN_OK;
}

void rn_task_add(struct rn_control *control, struct rn_task *task, struct rn_job_row *row) {
    task->row = *row;
    *row = (struct rn_job_row){0};
    struct rn_task **link = &control->tasks;
    while (*link != NULL)
        link = &(*link)->next;
    *link = task;
}

void rn_task_free(struct rn_task *task) {
    if (task == NULL) return;
    rn_ring_unref(&task->ring);
    rn_row_finish(&rn_jobs_table, &task->row);
    rn_ladder_free(task->ladder);
    free(task->told);
    free(task);
}

bool rn_task_is_attached(const struct rn_task *task) {
    return task->runner != NULL && task->runner->state != RN_RUNNER_AWAITED;
}

// Whether it ends when somebody who works on it says so, and not at once. A ladder that has begun
// is worked on by the daemon itself.
static bool is_held(const struct rn_task *task) {
    bool ladder = task->row.type == RN_JOB_LADDER && task->row.started_ms != 0;
    return ladder || rn_task_is_attached(task);
}

enum rn_scene_state rn_scene_state_of(const struct rn_scene_row *row, const struct rn_task *task) {
    bool has_checkpoint = row->sha256[0] != '\0';
    if (has_checkpoint && (task == NULL || rn_job_is_over(task->row.state))) return RN_SCENE_READY;
    if (task == NULL) return row->state == RN_SCENE_NEW ? RN_SCENE_NEW : RN_SCENE_FAILED;
    switch (task->row.state) {
    case RN_JOB_QUEUED:
        return task->row.started_ms == 0 ? RN_SCENE_NEW : RN_SCENE_TRAINING;
    case RN_JOB_PAUSED:
        return RN_SCENE_PAUSED;
    case RN_JOB_CANCELLED: // nothing failed: nothing was learnt that a checkpoint holds
        return RN_SCENE_NEW;
    case RN_JOB_SUCCEEDED:
    case RN_JOB_FAILED:
        return RN_SCENE_FAILED;
    default:
        return RN_SCENE_TRAINING;
    }
}

static enum rn_status write_scene_state(struct rn_control *control, const struct rn_task *task,
                                        struct rn_error *err) {
    struct rn_scene_row scene;
    enum rn_status status =
        rn_store_find(control->store, &rn_scenes, "id", task->row.scene, &scene, err);
    if (status != RN_OK) return status;
    scene.state = rn_scene_state_of(&scene, task);
    status = rn_store_update(control->store, &rn_scenes, &scene, err);
    rn_row_finish(&rn_scenes, &scene);
    return status;
}

static enum rn_status persist(struct rn_control *control, const struct rn_task *task,
                              struct rn_error *err) {
    enum rn_status status = rn_store_begin(control->store, err);
    if (status != RN_OK) return status;
    status = rn_store_update(control->store, &rn_jobs_table, &task->row, err);
    if (status == RN_OK && task->makes != NULL)
        status = rn_store_insert(control->store, &rn_datasets, task->makes, err);
    if (status == RN_OK && task->makes_scene != NULL)
        status = rn_store_insert(control->store, &rn_scenes, task->makes_scene, err);
    if (status == RN_OK && task->makes_checkpoint != NULL)
        status = rn_store_insert(control->store, &rn_checkpoints, task->makes_checkpoint, err);
    if (status == RN_OK && task->row.type == RN_JOB_TRAIN)
        status = write_scene_state(control, task, err);
    if (status == RN_OK) return rn_store_commit(control->store, err);
    rn_store_rollback(control->store);
    return status;
}

void rn_task_publish(struct rn_control *control, struct rn_task *task, const char *name,
                     const char *json, bool latest) {
    uint64_t id = rn_ring_next_id();
    rn_ring_publish(task->ring, id, name, json, latest ? task->row.id : NULL);
    if (strcmp(name, RN_EVENT_STATE) == 0) {
        rn_ring_publish(control->ring, id, name, json, NULL);
    } else if (strcmp(name, RN_EVENT_PROGRESS) == 0) {
        struct rn_job_progress_event event = {.progress = (char *)json};
        char *text = NULL;
        snprintf(event.job, sizeof event.job, "%s", task->row.id);
        if (rn_encode(&rn_job_progress_event_table, &event, &text, NULL, NULL) == RN_OK)
            rn_ring_publish(control->ring, id, name, text, task->row.id);
        free(text);
    }
}

void rn_task_announce(struct rn_control *control, struct rn_task *task) {
    char *json = NULL;
    struct rn_error err;
    if (rn_document_job(control, &task->row, &json, &err) == RN_OK)
        rn_task_publish(control, task, RN_EVENT_STATE, json, false);
    else
        rn_task_log(task, RN_LOG_ERROR, "no event: %s", err.text);
    free(json);
    if (rn_job_is_over(task->row.state)) rn_ring_close(task->ring);
}

enum rn_status rn_task_apply(struct rn_control *control, struct rn_task *task,
                             enum rn_job_event event, bool must, struct rn_error *err) {
    struct rn_job_row before = task->row; // its documents stay with the task
    enum rn_job_state next;
    enum rn_status status =
        rn_job_next(task->row.type, task->row.state, event, is_held(task), &next, err);
    if (status != RN_OK) return status;
    if (next == task->row.state) return RN_OK;
    task->row.state = next;
    if (event == RN_JOB_START && task->row.started_ms == 0)
        task->row.started_ms = rn_clock_wall_ms();
    if (event == RN_JOB_REQUEUE) task->row.attempt++;
    if (rn_job_is_over(next)) {
        task->row.finished_ms = rn_clock_wall_ms();
        control->last_over_ns = rn_clock_ns();
    }
    if (rn_job_is_over(next)) rn_frames_take_back(control, task);
    status = persist(control, task, err);
    if (status != RN_OK && !must) {
        task->row = before;
        return status;
    }
    if (status != RN_OK)
        rn_task_log(task, RN_LOG_ERROR, "%s, but the record cannot be written yet: %s",
                    rn_job_state_names[next], err != NULL ? err->text : "");
    task->dirty = status != RN_OK;
    control->stats.jobs_ended[next]++;
    rn_task_log(task, RN_LOG_INFO, "%s", rn_job_state_names[next]);
    rn_task_announce(control, task);
    control->schedule_due = true;
    bool wants_runner = !rn_job_is_over(next) && next != RN_JOB_PAUSED;
    if (!wants_runner && !rn_task_is_attached(task)) rn_task_detach(task);
    return RN_OK;
}

void rn_task_happened(struct rn_control *control, struct rn_task *task, enum rn_job_event event) {
    struct rn_error err = {0};
    if (rn_task_apply(control, task, event, true, &err) != RN_OK)
        rn_task_log(task, RN_LOG_WARN, "%s", err.text);
}

static void set_problem(struct rn_task *task, char *json) {
    free(task->row.problem);
    task->row.problem = json;
}

void rn_task_detach(struct rn_task *task) {
    if (task->runner == NULL) return;
    if (task->runner->train == task) task->runner->train = NULL;
    if (task->runner->work == task) task->runner->work = NULL;
    task->runner->last_used_ns = rn_clock_ns();
    task->runner = NULL;
    task->sent = task->began = false;
}

void rn_task_fail(struct rn_control *control, struct rn_task *task, const struct rn_error *err) {
    char *json = NULL;
    if (rn_problem_json_from_error(err, &json, NULL) == RN_OK) set_problem(task, json);
    rn_task_log(task, RN_LOG_WARN, "%s%s%s", err->where, err->where[0] != '\0' ? ": " : "",
                err->text);
    rn_task_happened(control, task, RN_JOB_FAIL);
    rn_task_detach(task);
}

static void set_lost_problem(struct rn_task *task, const char *how) {
    char detail[512], *json = NULL;
    snprintf(detail, sizeof detail, "the %s ended in attempt %d%s%s; see jobs/%s/log",
             how ? "runner" : "daemon", task->row.attempt, how ? ": " : "", how ? how : "",
             task->row.id);
    if (rn_problem_json(RN_PROBLEM_RUNNER_LOST, detail, NULL, &json, NULL) == RN_OK)
        set_problem(task, json);
}

void rn_task_lost(struct rn_control *control, struct rn_task *task,
                  const struct rn_ending *ending) {
    rn_task_detach(task);
    bool ran = task->row.state == RN_JOB_RUNNING;
    if (ran) {
        if (task->progressed) task->row.stalls = 0;
        task->row.stalls += !task->progressed && !(ending != NULL && ending->taken);
        task->progressed = false;
        set_lost_problem(task, ending != NULL ? ending->how : NULL);
    }
    rn_task_happened(control, task, RN_JOB_LOST);
    if (!ran) return;
    if (task->row.stalls >= RN_MAX_STALLS) {
        rn_task_happened(control, task, RN_JOB_GIVE_UP);
        return;
    }
    task->not_before_ns = rn_clock_ns() + RETRY_NS;
    set_problem(task, NULL);
    rn_task_happened(control, task, RN_JOB_REQUEUE);
}

static void remember(struct rn_control *control, struct rn_task *task) {
    struct rn_recent *recent = &control->recent[control->recent_next++ % RN_MAX_RECENT];
    rn_ring_unref(&recent->ring);
    snprintf(recent->id, sizeof recent->id, "%s", task->row.id);
    recent->ring = rn_ring_ref(task->ring);
}

// What a job that is of no scene had in the spool.
static void remove_spooled(struct rn_control *control, const struct rn_task *task) {
    bool estimate = task->row.type == RN_JOB_ESTIMATE;
    if (task->row.type != RN_JOB_INGEST && !estimate) return;
    char *path =
        rn_store_path(control->store, estimate ? "spool/%s.work" : "spool/%s.tar", task->row.id);
    if (path != NULL && estimate && rn_remove_tree(path, NULL) != RN_OK)
        rn_log(RN_LOG_WARN, "%s cannot be removed", path);
    if (path != NULL && !estimate) (void)unlink(path);
    free(path);
}

static enum rn_status settle(struct rn_control *control, struct rn_task *task,
                             struct rn_error *err) {
    if (!task->dirty) return RN_OK;
    enum rn_status status = persist(control, task, err);
    task->dirty = status != RN_OK;
    return status;
}

enum rn_status rn_task_settle_scene(struct rn_control *control, const char *scene,
                                    struct rn_error *err) {
    enum rn_status status = RN_OK;
    for (struct rn_task *task = control->tasks; task != NULL && status == RN_OK; task = task->next)
        if (strcmp(task->row.scene, scene) == 0) status = settle(control, task, err);
    return status;
}

void rn_tasks_tidy(struct rn_control *control) {
    struct rn_task **link = &control->tasks;
    while (*link != NULL) {
        struct rn_task *task = *link;
        (void)settle(control, task, NULL);
        if (!rn_job_is_over(task->row.state) || task->dirty || task->runner != NULL) {
            link = &task->next;
            continue;
        }
        *link = task->next;
        if (task->row.type == RN_JOB_PATH) control->next_retain_ns = 0; // what it made takes room
        remember(control, task);
        remove_spooled(control, task);
        rn_task_free(task);
    }
}
