// Who runs next, and which idle runners end.
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/jobs/inside.h"

// While the scene's old runner is ending.
#define RETRY_NS 200000000ll
// A runner that is on its way for longer waits in the cluster's queue.
#define QUEUED_NS (3 * 1000000000ll)

static bool is_active(const struct rn_task *task) {
    return task->row.state == RN_JOB_RUNNING || task->row.state == RN_JOB_CANCELLING;
}

static int count_active(const struct rn_control *control, enum rn_job_type a, enum rn_job_type b) {
    int count = 0;
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if ((task->row.type == a || task->row.type == b) && is_active(task)) count++;
    return count;
}

static bool has_checkpoint(struct rn_control *control, const char *id) {
    struct rn_scene_row scene;
    if (rn_store_find(control->store, &rn_scenes, "id", id, &scene, NULL) != RN_OK) return false;
    bool has = scene.sha256[0] != '\0';
    rn_row_finish(&rn_scenes, &scene);
    return has;
}

// Whether a path or an evaluation finds parameters. A training that is being loaded, or that a lost
// runner has left without a checkpoint, will have some soon.
static bool is_renderable(struct rn_control *control, const char *scene) {
    const struct rn_task *train = rn_task_training(control, scene);
    if (train == NULL || train->began) return true;
    return !is_active(train) && has_checkpoint(control, scene);
}

// Whether a slot is free for the task and nothing else works on its scene; paths and evaluations
// may, while it trains: the runner lets them go first.
static bool may_start(struct rn_control *control, const struct rn_task *task) {
    const struct rn_runner *runner =
        task->row.scene[0] != '\0' ? rn_runner_find(control, task->row.scene) : NULL;
    bool spreads = control->executor->spreads; // then slots are its cluster's
    switch (task->row.type) {
    case RN_JOB_TRAIN:
    case RN_JOB_ESTIMATE: // whose times are those of a training that has its slot
        return ((spreads && task->row.type == RN_JOB_TRAIN) ||
                count_active(control, RN_JOB_TRAIN, RN_JOB_ESTIMATE) <
                    control->options.training_slots) &&
               (runner == NULL || runner->work == NULL);
    case RN_JOB_INGEST:
    case RN_JOB_VALIDATE:
        return count_active(control, RN_JOB_INGEST, RN_JOB_VALIDATE) == 0;
    case RN_JOB_PATH:
    case RN_JOB_EVAL:
    case RN_JOB_CURVE:
    case RN_JOB_EFFECTS:
    case RN_JOB_EXPORT:
    case RN_JOB_DOCTOR:
        return (spreads || (count_active(control, RN_JOB_PATH, RN_JOB_EVAL) == 0 &&
                            count_active(control, RN_JOB_EXPORT, RN_JOB_DOCTOR) == 0 &&
                            count_active(control, RN_JOB_CURVE, RN_JOB_EFFECTS) == 0)) &&
               (runner == NULL || runner->work == NULL) && is_renderable(control, task->row.scene);
    case RN_JOB_LADDER: // has no runner: ladder.c
        return false;
    }
    return false;
}

// The runner's mode for an import: looking for poses may start programs that others may not.
static const char *mode_of_import(const struct rn_task *task) {
    struct rn_ingest_options options;
    const char *json = task->row.options;
    if (task->row.scene[0] != '\0' || task->row.type == RN_JOB_VALIDATE) return RN_MODE_INGEST;
    if (rn_decode(&rn_ingest_options_table, json, strlen(json), &options, NULL, NULL) != RN_OK)
        return RN_MODE_INGEST; // which says what is wrong
    return rn_name_or(options.poses, RN_POSES_FILE) == RN_POSES_FIND ? RN_MODE_POSES
                                                                     : RN_MODE_INGEST;
}

static enum rn_status find_runner(struct rn_control *control, struct rn_task *task,
                                  struct rn_runner **ret_runner, struct rn_error *err) {
    if (task->row.type == RN_JOB_ESTIMATE)
        return rn_runner_for_estimate(control, task, ret_runner, err);
    bool imports = task->row.type == RN_JOB_INGEST || task->row.type == RN_JOB_VALIDATE;
    struct rn_runner *runner = rn_runner_find(control, task->row.scene);
    // One that was started here for a picture makes way for one that the job is asked of.
    if (!imports && control->executor->spreads && runner != NULL && !runner->process.remote) {
        if (rn_runner_is_idle(runner)) rn_runner_shutdown(control, runner);
        return rn_error_set(err, RN_ERROR_BUSY, "", "the scene's runner is ending");
    }
    if (!imports)
        return rn_runner_for_scene(control, task->row.scene, task->row.type != RN_JOB_TRAIN,
                                   ret_runner, err);
    char *log = rn_store_path(control->store, "jobs/%s/log", task->row.id);
    const struct rn_order order = {
        .mode = mode_of_import(task), .scene = "", .log_path = log, .here = true};
    enum rn_status status = rn_runner_start(control, &order, ret_runner, err);
    free(log);
    return status;
}

static void start(struct rn_control *control, struct rn_task *task) {
    struct rn_error err = {0};
    struct rn_runner *runner = task->runner;
    enum rn_status status = RN_OK;
    if (runner == NULL) status = find_runner(control, task, &runner, &err);
    if (status == RN_ERROR_BUSY || status == RN_ERROR_UNAVAILABLE) {
        task->not_before_ns = rn_clock_ns() + RETRY_NS;
        return;
    }
    if (status != RN_OK) {
        rn_task_fail(control, task, &err);
        return;
    }
    task->runner = runner;
    if (task->row.type == RN_JOB_TRAIN)
        runner->train = task;
    else
        runner->work = task;
    if (task->row.state == RN_JOB_QUEUED && rn_task_is_attached(task))
        rn_task_happened(control, task, RN_JOB_START);
    if (runner->state == RN_RUNNER_READY) rn_runner_begin(control, task);
}

static bool is_stale(const struct rn_control *control, const struct rn_runner *runner,
                     int64_t now_ns) {
    return now_ns - runner->last_used_ns > control->options.keep_alive_s * 1000000000ll;
}

// Runners that wait in the cluster's queue, less those that end and will make room.
static int count_unplaced(const struct rn_control *control, int64_t now_ns) {
    int count = 0;
    for (const struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        bool waits = runner->state == RN_RUNNER_AWAITED && now_ns - runner->asked_ns > QUEUED_NS;
        bool ends = runner->process.remote && runner->state == RN_RUNNER_ENDING;
        count += waits - ends;
    }
    return count;
}

// Remote ones that are idle for long, or for which others wait.
static void evict_remote(struct rn_control *control, int64_t now_ns) {
    struct rn_runner *oldest;
    while ((oldest = rn_runner_oldest_idle(control, true, NULL)) != NULL &&
           (is_stale(control, oldest, now_ns) || count_unplaced(control, now_ns) > 0))
        rn_runner_shutdown(control, oldest);
}

static void evict(struct rn_control *control) {
    int64_t memory = 0, now_ns = rn_clock_ns();
    int loaded = 0;
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        if (runner->state == RN_RUNNER_ENDING || runner->process.remote) continue;
        memory += runner->memory_bytes;
        loaded += strcmp(runner->mode, "field") == 0;
    }
    struct rn_runner *oldest;
    evict_remote(control, now_ns);
    while ((oldest = rn_runner_oldest_idle(control, false, NULL)) != NULL) {
        bool over = loaded > control->options.max_loaded ||
                    (control->options.memory_limit_bytes > 0 && loaded > 1 &&
                     memory > control->options.memory_limit_bytes);
        if (!over && !is_stale(control, oldest, now_ns)) return;
        memory -= oldest->memory_bytes;
        loaded--;
        rn_runner_shutdown(control, oldest);
    }
}

void rn_schedule(struct rn_control *control) {
    control->schedule_due = false;
    if (control->stopping) return;
    int64_t now_ns = rn_clock_ns();
    for (struct rn_task *task = control->tasks; task != NULL; task = task->next) {
        if (now_ns < task->not_before_ns) continue;
        bool awaited = task->runner != NULL && !rn_task_is_attached(task);
        bool queued = task->row.state == RN_JOB_QUEUED && !awaited && may_start(control, task);
        // It has its slot, but another process held its scene.
        bool waits = task->row.state == RN_JOB_RUNNING && task->runner == NULL &&
                     task->row.type != RN_JOB_LADDER;
        if (queued || waits) start(control, task);
    }
    evict(control);
    rn_gpu_share(control);
}
