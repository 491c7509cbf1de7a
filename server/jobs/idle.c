// What is done when nobody wants anything: the curves of scenes that were trained, and of those
// where pictures had to go by an older one or by none.
#include <stdio.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "server/jobs/inside.h"

void rn_idle_want_curve(struct rn_control *control, const char *scene) {
    if (control->options.curve_after_s == 0) return;
    for (int i = 0; i < control->curves_wanted; i++)
        if (strcmp(control->curve_wanted[i], scene) == 0) return;
    if (control->curves_wanted == RN_MAX_WANTED) control->curves_wanted--; // the oldest gives way
    memmove(control->curve_wanted + 1, control->curve_wanted,
            (size_t)control->curves_wanted * sizeof *control->curve_wanted);
    snprintf(control->curve_wanted[0], RN_ID_MAX, "%s", scene);
    control->curves_wanted++;
}

void rn_idle_has_curve(struct rn_control *control, const char *scene) {
    int kept = 0;
    for (int i = 0; i < control->curves_wanted; i++)
        if (strcmp(control->curve_wanted[i], scene) != 0)
            memmove(control->curve_wanted[kept++], control->curve_wanted[i],
                    sizeof *control->curve_wanted);
    control->curves_wanted = kept;
}

static bool is_idle(const struct rn_control *control, int64_t since_ns) {
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (!rn_job_is_over(task->row.state)) return false;
    for (const struct rn_runner *runner = control->runners; runner != NULL; runner = runner->next)
        if (runner->renders != NULL || runner->last_used_ns > since_ns) return false;
    return control->last_over_ns <= since_ns;
}

static void measure_curve(struct rn_control *control, const char *scene) {
    struct rn_submission wanted = {.type = RN_JOB_CURVE, .scene = scene, .options = "{}"};
    struct rn_error err = {0};
    struct rn_task *task = NULL;
    if (rn_task_submit(control, &wanted, &task, &err) == RN_OK)
        task->automatic = true;
    else
        rn_log(RN_LOG_DEBUG, "no curve of scene %s: %s", scene, err.text);
}

void rn_idle_work(struct rn_control *control) {
    char scene[RN_ID_MAX];
    int64_t since_ns = rn_clock_ns() - control->options.curve_after_s * 1000000000ll;
    if (control->curves_wanted == 0 || control->stopping || !is_idle(control, since_ns)) return;
    snprintf(scene, sizeof scene, "%s", control->curve_wanted[--control->curves_wanted]);
    measure_curve(control, scene);
}

// What was measured is kept: it goes on when there is time again.
void rn_idle_stop(struct rn_control *control) {
    for (struct rn_task *task = control->tasks; task != NULL; task = task->next) {
        if (!task->automatic || rn_job_is_over(task->row.state) ||
            task->row.state == RN_JOB_CANCELLING)
            continue;
        rn_idle_want_curve(control, task->row.scene);
        rn_task_happened(control, task, RN_JOB_CANCEL);
        if (task->runner != NULL && task->sent)
            rn_runner_post_job(control, task->runner, RN_WIRE_CANCEL, task->row.id);
    }
}
