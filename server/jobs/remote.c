// Runners on other machines: waited for, joined, lost.
#include <stdio.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

// Pictures that nothing but their own wish for a runner holds up are made here after so long.
#define PATIENCE_NS (5 * 1000000000ll)
// How long it may take to be told how a runner ended that has hung up.
#define SETTLE_NS (15 * 1000000000ll)
#define RETRY_NS (1000000000ll)

// Its jobs show where it is, or why it waits.
static void note(struct rn_control *control, struct rn_runner *runner,
                 const struct rn_whereabouts *now) {
    struct rn_task *tasks[] = {runner->train, runner->work};
    bool same = strcmp(runner->where.machine, now->machine) == 0 &&
                strcmp(runner->where.job, now->job) == 0 &&
                strcmp(runner->where.reason, now->reason) == 0;
    runner->where = *now;
    for (int i = 0; i < 2 && !same; i++)
        if (tasks[i] != NULL) rn_task_announce(control, tasks[i]);
}

static void begin(struct rn_control *control, struct rn_runner *runner) {
    struct rn_scene_row scene;
    struct rn_error err = {0};
    struct rn_task *tasks[] = {runner->train, runner->work};
    rn_runner_connected(runner);
    rn_log(RN_LOG_INFO, "runner %d: started on %s, job %s", (int)runner->process.pid,
           runner->where.machine[0] != '\0' ? runner->where.machine : "its node",
           runner->where.job);
    enum rn_status status =
        rn_store_find(control->store, &rn_scenes, "id", runner->scene, &scene, &err);
    if (status == RN_OK) {
        status = rn_runner_open(control, runner, &scene, runner->train == NULL, &err);
        rn_row_finish(&rn_scenes, &scene);
    }
    for (int i = 0; i < 2; i++)
        if (tasks[i] != NULL && tasks[i]->row.state == RN_JOB_QUEUED)
            rn_task_happened(control, tasks[i], RN_JOB_START);
    if (status == RN_OK) return;
    rn_log(RN_LOG_ERROR, "runner %d: %s", (int)runner->process.pid, err.text);
    runner->broken = true;
}

// The pictures that wait for it are made on this machine, in its stead.
static bool stay_here(struct rn_control *control, struct rn_runner *runner, const char *why) {
    struct rn_scene_row scene;
    struct rn_ending ending;
    struct rn_process process;
    struct rn_error err = {0};
    const struct rn_order order = {.mode = "field", .scene = runner->scene, .here = true};
    enum rn_status status =
        rn_store_find(control->store, &rn_scenes, "id", runner->scene, &scene, &err);
    if (status != RN_OK) return false;
    status = control->executor->start(control->executor, &order, &process, &err);
    if (status == RN_OK) {
        control->executor->end(control->executor, &runner->process, true, &ending);
        runner->process = process;
        runner->where = (struct rn_whereabouts){.where = RN_WHERE_THERE};
        snprintf(runner->where.reason, sizeof runner->where.reason, "%.159s", why);
        rn_runner_connected(runner);
        status = rn_runner_open(control, runner, &scene, true, &err);
        rn_log(RN_LOG_INFO, "runner %d: here, in place of Slurm's: %s", (int)process.pid, why);
    }
    rn_row_finish(&rn_scenes, &scene);
    return status == RN_OK;
}

// It ended before it began: what waits for it fails, or is asked for again.
static void give_up(struct rn_control *control, struct rn_runner *runner,
                    const struct rn_error *refusal) {
    struct rn_task *tasks[] = {runner->train, runner->work};
    for (int i = 0; i < 2; i++) {
        struct rn_task *task = tasks[i];
        if (task == NULL) continue;
        if (refusal->status != RN_OK) {
            rn_task_fail(control, task, refusal);
        } else if (++task->row.stalls >= RN_MAX_STALLS) {
            struct rn_error err;
            rn_error_set(&err, RN_ERROR_IO, "slurm",
                         "%d runners in a row ended before they began; see the daemon's log and "
                         "jobs/%s/log",
                         RN_MAX_STALLS, task->row.id);
            rn_task_fail(control, task, &err);
        } else {
            rn_task_detach(task);
            task->not_before_ns = rn_clock_ns() + RETRY_NS;
        }
    }
}

static bool is_wanted(const struct rn_runner *runner) {
    return runner->helps[0] != '\0' || runner->train != NULL || runner->work != NULL ||
           runner->renders != NULL;
}

static bool await(struct rn_control *control, struct rn_runner *runner,
                  const struct rn_whereabouts *now) {
    bool for_pictures = runner->train == NULL && runner->work == NULL && runner->renders != NULL;
    if (runner->broken || !is_wanted(runner)) return true;
    if (now->where == RN_WHERE_THERE) {
        begin(control, runner);
        return false;
    }
    bool gone = now->where == RN_WHERE_GONE;
    bool late = rn_clock_ns() - runner->asked_ns > PATIENCE_NS;
    if (for_pictures && (gone || late) &&
        stay_here(control, runner, gone ? now->refusal.text : now->reason))
        return false;
    if (gone) give_up(control, runner, &now->refusal);
    return gone;
}

bool rn_remote_is_lost(struct rn_control *control, struct rn_runner *runner) {
    struct rn_whereabouts now;
    control->executor->look(control->executor, &runner->process, &now);
    if (now.where != RN_WHERE_GONE) note(control, runner, &now);
    if (runner->state == RN_RUNNER_AWAITED) return await(control, runner, &now);
    // Its node may be lost while it still talks: what Slurm took away is not to be written to.
    return now.where == RN_WHERE_GONE && runner->state != RN_RUNNER_ENDING && !runner->broken;
}

bool rn_remote_is_settled(struct rn_control *control, struct rn_runner *runner) {
    struct rn_whereabouts now;
    if (!runner->process.remote || runner->state == RN_RUNNER_ENDING) return true;
    if (runner->hung_up_ns == 0) {
        runner->hung_up_ns = rn_clock_ns();
        control->executor->hung_up(control->executor, &runner->process);
    }
    control->executor->look(control->executor, &runner->process, &now);
    return now.where == RN_WHERE_GONE || rn_clock_ns() - runner->hung_up_ns > SETTLE_NS;
}
