// A path or an evaluation over several runners, where they are on other machines.
//
// The runner that has the job makes its frames, or scores, from the first one on. Others make parts
// of it from its end towards it; it passes over what is there when it comes to it. So a frame that
// a helper owes is made in any case, by whoever comes first, and is the same bytes.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

#define PART_S 3.0   // that a part should take
#define WORTH_S 10.0 // of work for each runner: below it, a start costs more than it brings

// A task that may be helped: of a scene at rest, which all runners load alike.
static bool takes_help(const struct rn_task *task) {
    bool in_parts = task->row.type == RN_JOB_PATH || task->row.type == RN_JOB_EVAL;
    return in_parts && task->row.state == RN_JOB_RUNNING && task->sent && task->runner != NULL &&
           task->runner->process.remote && task->runner->train == NULL &&
           task->runner->state == RN_RUNNER_READY && !isnan(task->live_left_s);
}

static int count_helpers(const struct rn_control *control, const struct rn_task *task) {
    int count = 0;
    for (const struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next)
        count += strcmp(runner->helps, task->row.id) == 0 && runner->state != RN_RUNNER_ENDING;
    return count;
}

static bool ask_for_one(struct rn_control *control, const struct rn_task *task) {
    struct rn_error err = {0};
    struct rn_runner *runner;
    struct rn_scene_row scene;
    enum rn_status status =
        rn_store_find(control->store, &rn_scenes, "id", task->row.scene, &scene, &err);
    if (status == RN_OK) {
        status = rn_runner_start_for(control, &scene, task->row.id, true, &runner, &err);
        rn_row_finish(&rn_scenes, &scene);
    }
    if (status == RN_OK)
        snprintf(runner->helps, sizeof runner->helps, "%s", task->row.id);
    else
        rn_task_log(task, RN_LOG_WARN, "no help: %s", err.text);
    return status == RN_OK;
}

// The number of the job's first frame.
static int64_t first_of(const struct rn_task *task) {
    struct rn_path_options options;
    const char *json = task->row.options;
    if (task->row.type != RN_JOB_PATH ||
        rn_decode(&rn_path_options_table, json, strlen(json), &options, NULL, NULL) != RN_OK)
        return 0;
    return rn_int_or(options.first, 0);
}

// The frames that nobody has: `next` .. task->handed - 1, `next` after the one that is being made.
static bool is_left(struct rn_task *task, int64_t *ret_next, double *ret_frame_s) {
    struct rn_work_progress progress;
    const char *report = task->row.progress;
    if (report == NULL ||
        rn_decode(&rn_work_progress_table, report, strlen(report), &progress, NULL, NULL) != RN_OK)
        return false;
    int64_t first = first_of(task), left = progress.total - progress.done;
    if (task->handed > first + progress.total) task->handed = first + progress.total;
    *ret_next = first + progress.done + 1;
    *ret_frame_s = left > 0 ? task->live_left_s / (double)left : PART_S;
    return task->handed > *ret_next;
}

// The last of them, for PART_S.
static bool next_part(struct rn_task *task, int64_t *ret_begin, int64_t *ret_end) {
    int64_t next;
    double frame_s;
    if (!is_left(task, &next, &frame_s)) return false;
    int64_t size = (int64_t)fmax(1, fmin(PART_S / fmax(frame_s, 1e-3), 1000));
    *ret_end = task->handed - 1;
    *ret_begin = task->handed - size > next ? task->handed - size : next;
    task->handed = *ret_begin;
    return true;
}

// The runner that has the job counts as one.
static void ask_for_help(struct rn_control *control, struct rn_task *task) {
    int64_t next;
    double frame_s;
    if (!is_left(task, &next, &frame_s)) return;
    int wanted = (int)fmin(task->live_left_s / WORTH_S, control->options.path_runners) - 1;
    for (int have = count_helpers(control, task); have < wanted; have++)
        if (!ask_for_one(control, task)) return;
}

static void let_go(struct rn_control *control) {
    for (struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next) {
        if (runner->helps[0] == '\0') continue;
        const struct rn_task *task = rn_task_find(control, runner->helps);
        if (task == NULL || !takes_help(task)) rn_runner_shutdown(control, runner);
    }
}

void rn_helpers_work(struct rn_control *control) {
    if (!control->executor->spreads || control->stopping) return;
    let_go(control);
    for (struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (takes_help(task)) ask_for_help(control, task);
}

void rn_helper_go_on(struct rn_control *control, struct rn_runner *runner) {
    struct rn_task *task = rn_task_find(control, runner->helps);
    struct rn_error err = {0};
    int64_t begin, end;
    runner->helping = false;
    if (task == NULL || !takes_help(task) || !next_part(task, &begin, &end)) {
        rn_runner_shutdown(control, runner);
        return;
    }
    rn_runner_post_trace(control, runner, task);
    if (rn_runner_post_part(control, runner, task, begin, end, &err) != RN_OK) {
        rn_task_log(task, RN_LOG_WARN, "%s", err.text);
        rn_runner_shutdown(control, runner);
        return;
    }
    runner->helping = true;
}
