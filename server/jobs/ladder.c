// Ladders: jobs of jobs. A ladder trains a table of cells, an arm with a seed each, as ordinary
// jobs, evaluates each and keeps what was found in jobs/ID/ladder.json.
//
// It needs no runner and nothing of it is in memory alone: each of its jobs is submitted under a
// key of its own (`Idempotency-Key`), so a daemon that starts anew finds what the one before had
// submitted, and no cell is trained twice.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "proto/ladder.h"
#include "proto/marks.h"
#include "server/jobs/inside.h"

#define BUSY_RETRY_NS 1000000000ll
#define LATE_SHARE 0.9 // a moment later than that share of a training says what its end says

struct rn_ladder {
    struct rn_ladder_record record;
    struct rn_ladder_plan plan;
    char *folder;
    bool changed;                      // the file is older
    bool removed[RN_LADDER_TRAININGS]; // the cell's scene, as far as this daemon knows
    int64_t begin_ns;                  // this daemon's work on it
    size_t over_at_begin;              // cells
};

void rn_ladder_free(struct rn_ladder *ladder) {
    if (ladder == NULL) return;
    rn_message_finish(&rn_ladder_record_table, &ladder->record);
    rn_ladder_plan_finish(&ladder->plan);
    free(ladder->folder);
    free(ladder);
}

static bool truth_or(int truth, bool fallback) {
    return truth < 0 ? fallback : truth;
}

// ---- a new one, or one as it was left -------------------------------------------------------

static void describe(const struct rn_control *control, const struct rn_job_row *job,
                     struct rn_ladder_record *record) {
    const struct rn_runner_device *device = &control->device;
    snprintf(record->job, sizeof record->job, "%s", job->id);
    snprintf(record->dataset, sizeof record->dataset, "%s", job->dataset);
    snprintf(record->dataset_name, sizeof record->dataset_name, "%s", job->dataset_name);
    rn_time_text(job->created_ms, record->created_at);
    snprintf(record->kernels, sizeof record->kernels, "%s", device->kernels);
    snprintf(record->version, sizeof record->version, "%s", control->options.version);
    record->threads = device->name[0] != '\0' ? device->threads : RN_ABSENT;
}

// Every arm with the first seed, then every arm with the next one: whatever is there when a ladder
// is looked at, or cancelled, compares its arms.
static enum rn_status lay_out(struct rn_ladder *ladder, struct rn_error *err) {
    struct rn_ladder_record *record = &ladder->record;
    const union rn_setting_value *first =
        rn_settings_value(&rn_train_settings, record->options.train.settings, "seed");
    int64_t seeds = rn_int_or(record->options.seeds, RN_LADDER_SEEDS);
    size_t arms = ladder->plan.count, count = arms * (size_t)seeds;
    record->cells = calloc(count, sizeof *record->cells);
    if (record->cells == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "ladder", "no memory");
    for (size_t i = 0; i < count; i++) {
        struct rn_ladder_cell *cell = &record->cells[i];
        cell->arm = (int64_t)(i % arms);
        cell->seed = rn_int_or(first->whole, 1) + (int64_t)(i / arms);
        cell->steps = cell->memory_bytes = cell->disk_bytes = cell->field_bytes = RN_ABSENT;
        cell->train_seconds = cell->held_out = cell->psnr = cell->ssim = cell->render_ms = NAN;
        cell->one_cone_psnr = cell->one_cone_ssim = cell->one_cone_render_ms = NAN;
        snprintf(cell->label, sizeof cell->label, "%s", ladder->plan.arms[cell->arm].label);
        snprintf(cell->scene, sizeof cell->scene, "%.40s-%.6s-%02u-%u", record->dataset_name,
                 record->job + strlen(RN_ID_JOB), (unsigned)(i % arms + 1) % 100,
                 (unsigned)(i / arms + 1) % 100);
    }
    record->count = count;
    ladder->changed = true;
    return RN_OK;
}

static enum rn_status begin(struct rn_control *control, const struct rn_job_row *job,
                            struct rn_ladder *ladder, struct rn_error *err) {
    struct rn_ladder_record *record = &ladder->record;
    rn_message_init(&rn_ladder_record_table, record);
    enum rn_status status = rn_decode(&rn_ladder_options_table, job->options, strlen(job->options),
                                      &record->options, NULL, err);
    if (status != RN_OK) return status;
    describe(control, job, record);
    status = rn_ladder_options_plan(&record->options, &ladder->plan, err);
    return status == RN_OK ? lay_out(ladder, err) : status;
}

// What an earlier daemon wrote goes on, if the arms are those that this version makes of its text.
static enum rn_status go_on(struct rn_ladder *ladder, struct rn_error *err) {
    const struct rn_ladder_record *record = &ladder->record;
    enum rn_status status = rn_ladder_options_plan(&record->options, &ladder->plan, err);
    for (size_t i = 0; status == RN_OK && i < record->count; i++)
        if (record->cells[i].arm >= (int64_t)ladder->plan.count)
            status = rn_error_set(err, RN_ERROR_CORRUPT, "ladder.json", "cell %zu has no arm", i);
    return status;
}

static enum rn_status open_ladder(struct rn_control *control, struct rn_task *task,
                                  struct rn_error *err) {
    struct rn_ladder *ladder = calloc(1, sizeof *ladder);
    if (ladder == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "ladder", "no memory");
    enum rn_status status = RN_OK;
    ladder->folder = rn_store_path(control->store, "jobs/%s", task->row.id);
    if (ladder->folder == NULL)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "ladder", "no memory");
    if (status == RN_OK) status = rn_ladder_read(ladder->folder, &ladder->record, err);
    if (status == RN_OK)
        status = go_on(ladder, err);
    else if (status == RN_ERROR_NOT_FOUND)
        status = begin(control, &task->row, ladder, err);
    if (status != RN_OK) {
        rn_ladder_free(ladder);
        return status;
    }
    ladder->begin_ns = rn_clock_ns();
    for (size_t i = 0; i < ladder->record.count; i++)
        ladder->over_at_begin += rn_cell_is_over(&ladder->record.cells[i]);
    task->ladder = ladder;
    return RN_OK;
}

// ---- its jobs -------------------------------------------------------------------------------

// In whose name a ladder's jobs are made: its owner's, whose quota of bytes they keep to. Of the
// quota of jobs the ladder is one. False: it is nobody's.
static bool find_caller(struct rn_control *control, const char *owner,
                        struct rn_caller *ret_caller) {
    struct rn_token_row token;
    if (owner[0] == '\0') return false;
    *ret_caller = (struct rn_caller){.id = ""};
    snprintf(ret_caller->id, sizeof ret_caller->id, "%s", owner);
    if (rn_store_find(control->store, &rn_tokens, "id", owner, &token, NULL) != RN_OK) return true;
    snprintf(ret_caller->name, sizeof ret_caller->name, "%s", token.name);
    ret_caller->max_bytes = token.max_bytes;
    rn_row_finish(&rn_tokens, &token);
    return true;
}

static enum rn_status submit(struct rn_control *control, const struct rn_task *task,
                             struct rn_submission *wanted, const char *key, char ret_job[RN_ID_MAX],
                             struct rn_error *err) {
    struct rn_caller caller;
    wanted->caller = find_caller(control, task->row.owner, &caller) ? &caller : NULL;
    wanted->key = key;
    wanted->traceparent = task->row.traceparent;
    wanted->digest = "a ladder's";
    return rn_task_submit_once(control, wanted, ret_job, err);
}

static enum rn_status submit_training(struct rn_control *control, struct rn_task *task,
                                      struct rn_ladder_cell *cell, struct rn_error *err) {
    const struct rn_ladder *ladder = task->ladder;
    struct rn_train_options options = ladder->record.options.train;
    char key[96], *json = NULL;
    memcpy(options.settings, ladder->plan.arms[cell->arm].values, sizeof options.settings);
    rn_settings_value(&rn_train_settings, options.settings, "seed")->whole = cell->seed;
    enum rn_status status = rn_encode(&rn_train_options_table, &options, &json, NULL, err);
    if (status != RN_OK) return status;
    struct rn_submission wanted = {.type = RN_JOB_TRAIN,
                                   .dataset = ladder->record.dataset,
                                   .scene = cell->scene,
                                   .options = json};
    snprintf(key, sizeof key, "%s/%s/train", task->row.id, cell->scene);
    status = submit(control, task, &wanted, key, cell->train_job, err);
    free(json);
    if (status == RN_OK) cell->state = RN_CELL_TRAINING;
    return status;
}

// Which evaluation comes next: a moment, the end, the end with one cone a pixel; -1: none.
static int next_evaluation(const struct rn_ladder *ladder, const struct rn_ladder_cell *cell) {
    int count = (int)cell->moment_count;
    for (int i = 0; i < count; i++)
        if (isnan(cell->moments[i].ssim)) return i;
    if (isnan(cell->ssim)) return count;
    bool one = truth_or(ladder->record.options.one_cone, false) && isnan(cell->one_cone_ssim);
    return one ? count + 1 : -1;
}

static enum rn_status submit_evaluation(struct rn_control *control, struct rn_task *task,
                                        struct rn_ladder_cell *cell, int number,
                                        struct rn_error *err) {
    const struct rn_ladder_options *asked = &task->ladder->record.options;
    struct rn_eval_options options;
    char key[128], *json = NULL;
    rn_message_init(&rn_eval_options_table, &options);
    options.split = asked->split;
    options.views = rn_int_or(asked->views, RN_LADDER_VIEWS);
    if (number < (int)cell->moment_count) options.at = cell->moments[number].train_seconds;
    if (number > (int)cell->moment_count)
        rn_settings_value(&rn_render_settings, options.settings, "supersample")->whole = 1;
    enum rn_status status = rn_encode(&rn_eval_options_table, &options, &json, NULL, err);
    if (status != RN_OK) return status;
    struct rn_submission wanted = {.type = RN_JOB_EVAL, .scene = cell->scene, .options = json};
    snprintf(key, sizeof key, "%s/%s/eval-%d", task->row.id, cell->scene, number);
    status = submit(control, task, &wanted, key, cell->eval_job, err);
    free(json);
    return status;
}

// ---- what they found ------------------------------------------------------------------------

static void end_cell(struct rn_ladder *ladder, struct rn_ladder_cell *cell,
                     enum rn_cell_state state, const char *why) {
    cell->state = state;
    snprintf(cell->problem, sizeof cell->problem, "%.255s", why);
    ladder->changed = true;
}

static void end_as_job(struct rn_ladder *ladder, struct rn_ladder_cell *cell,
                       const struct rn_job_row *job) {
    struct rn_api_problem problem = {.detail = ""};
    char why[256];
    bool cancelled = job->state == RN_JOB_CANCELLED;
    if (job->problem != NULL && rn_decode(&rn_api_problem_table, job->problem, strlen(job->problem),
                                          &problem, NULL, NULL) != RN_OK)
        problem.detail[0] = '\0';
    snprintf(why, sizeof why, "job %s %s%s%.180s", job->id, cancelled ? "was cancelled" : "failed",
             problem.detail[0] != '\0' ? ": " : "", problem.detail);
    end_cell(ladder, cell, cancelled ? RN_CELL_CANCELLED : RN_CELL_FAILED, why);
    if (problem.detail[0] != '\0') rn_message_finish(&rn_api_problem_table, &problem);
}

static int64_t checkpoint_bytes(struct rn_control *control, const char *scene) {
    struct rn_query query = {.equal = {{"scene", scene}}, .limit = 1};
    void *rows = NULL;
    size_t count = 0;
    if (rn_store_list(control->store, &rn_checkpoints, &query, &rows, &count, NULL) != RN_OK)
        return RN_ABSENT;
    int64_t bytes = count > 0 ? ((const struct rn_checkpoint_row *)rows)->size_bytes : RN_ABSENT;
    rn_rows_finish(&rn_checkpoints, rows, count);
    return bytes;
}

// That it was trained or evaluated on, if that is not known yet.
static void add_machine(struct rn_ladder_record *record, const char *machine) {
    size_t length = strlen(record->machine), size = strlen(machine);
    if (size == 0) return;
    for (const char *at = record->machine; (at = strstr(at, machine)) != NULL; at++)
        if ((at == record->machine || at[-1] == ' ') && (at[size] == '\0' || at[size] == ';'))
            return;
    snprintf(record->machine + length, sizeof record->machine - length, "%s%s",
             length > 0 ? "; " : "", machine);
}

// The newest marks of its training that say something else than its end.
static enum rn_status take_marks(struct rn_control *control, const struct rn_ladder *ladder,
                                 const char *scene, struct rn_ladder_cell *cell,
                                 struct rn_error *err) {
    struct rn_mark marks[RN_MARKS_KEPT];
    char *folder = rn_store_path(control->store, "scenes/%s", scene);
    size_t count = folder != NULL ? rn_marks_list(folder, marks) : 0;
    size_t most = (size_t)rn_int_or(ladder->record.options.moments, RN_LADDER_MOMENTS);
    free(folder);
    if (count > 0) cell->field_bytes = marks[count - 1].size_bytes;
    while (count > 0 && marks[count - 1].train_seconds > LATE_SHARE * cell->train_seconds)
        count--;
    size_t first = count > most ? count - most : 0;
    if (count == first || cell->moments != NULL) return RN_OK;
    cell->moments = calloc(count - first, sizeof *cell->moments);
    if (cell->moments == NULL) return rn_error_set(err, RN_ERROR_NO_MEMORY, "ladder", "no memory");
    for (size_t i = first; i < count; i++)
        cell->moments[cell->moment_count++] =
            (struct rn_ladder_moment){marks[i].train_seconds, marks[i].step, NAN, NAN};
    return RN_OK;
}

static enum rn_status take_training(struct rn_control *control, struct rn_ladder *ladder,
                                    struct rn_ladder_cell *cell, const struct rn_job_row *job,
                                    struct rn_error *err) {
    struct rn_train_result result;
    struct rn_scene_row scene;
    enum rn_status status =
        rn_decode(&rn_train_result_table, job->result, strlen(job->result), &result, NULL, err);
    if (status != RN_OK) return status;
    cell->steps = result.steps;
    cell->train_seconds = result.train_seconds;
    cell->held_out = result.psnr;
    add_machine(&ladder->record, result.machine);
    rn_message_finish(&rn_train_result_table, &result);
    status = rn_store_find(control->store, &rn_scenes, "id", job->scene, &scene, err);
    if (status != RN_OK) return status;
    cell->memory_bytes = scene.memory_bytes;
    cell->disk_bytes = checkpoint_bytes(control, scene.id);
    status = take_marks(control, ladder, scene.id, cell, err);
    rn_row_finish(&rn_scenes, &scene);
    cell->state = RN_CELL_EVALUATING;
    ladder->changed = true;
    return status;
}

// The end of a training as its evaluation found it.
static void take_end(struct rn_ladder *ladder, struct rn_ladder_cell *cell,
                     struct rn_eval_result *result) {
    struct rn_ladder_record *record = &ladder->record;
    cell->psnr = result->psnr;
    cell->ssim = result->ssim;
    cell->render_ms = result->render_ms_median;
    free(cell->scales);
    cell->scales = result->scales;
    cell->scale_count = result->scale_count;
    result->scales = NULL;
    result->scale_count = 0;
    record->protocol = result->protocol;
    record->threads = result->protocol.threads;
    add_machine(record, result->protocol.machine);
    record->views = result->views;
}

static enum rn_status take_evaluation(struct rn_ladder *ladder, struct rn_ladder_cell *cell,
                                      const struct rn_job_row *job, struct rn_error *err) {
    struct rn_eval_result result;
    int number = next_evaluation(ladder, cell), moments = (int)cell->moment_count;
    enum rn_status status =
        rn_decode(&rn_eval_result_table, job->result, strlen(job->result), &result, NULL, err);
    if (status != RN_OK) return status;
    if (number < moments) {
        cell->moments[number].psnr = result.psnr;
        cell->moments[number].ssim = result.ssim;
    } else if (number == moments) {
        take_end(ladder, cell, &result);
    } else {
        cell->one_cone_psnr = result.psnr;
        cell->one_cone_ssim = result.ssim;
        cell->one_cone_render_ms = result.render_ms_median;
    }
    rn_message_finish(&rn_eval_result_table, &result);
    cell->eval_job[0] = '\0';
    ladder->changed = true;
    return RN_OK;
}

// ---- a cell's life --------------------------------------------------------------------------

// What its job has come to, if it is over; false: it is not.
static enum rn_status look_at(struct rn_control *control, struct rn_task *task,
                              struct rn_ladder_cell *cell, bool *ret_over, struct rn_error *err) {
    struct rn_job_row job;
    bool trains = cell->state == RN_CELL_TRAINING;
    const char *id = trains ? cell->train_job : cell->eval_job;
    enum rn_status status = rn_store_find(control->store, &rn_jobs_table, "id", id, &job, err);
    if (status != RN_OK) return status;
    *ret_over = rn_job_is_over(job.state);
    if (*ret_over && (job.state != RN_JOB_SUCCEEDED || job.result == NULL))
        end_as_job(task->ladder, cell, &job);
    else if (*ret_over && trains)
        status = take_training(control, task->ladder, cell, &job, err);
    else if (*ret_over)
        status = take_evaluation(task->ladder, cell, &job, err);
    rn_row_finish(&rn_jobs_table, &job);
    return status;
}

// As far as it goes now. RN_ERROR_BUSY: later.
static enum rn_status advance(struct rn_control *control, struct rn_task *task,
                              struct rn_ladder_cell *cell, struct rn_error *err) {
    struct rn_ladder *ladder = task->ladder;
    enum rn_status status = RN_OK;
    bool over = true;
    if (cell->state == RN_CELL_WAITING) {
        ladder->changed = true;
        return submit_training(control, task, cell, err);
    }
    if (cell->state == RN_CELL_TRAINING || cell->eval_job[0] != '\0')
        status = look_at(control, task, cell, &over, err);
    if (status != RN_OK || !over || rn_cell_is_over(cell)) return status;
    int next = next_evaluation(ladder, cell);
    if (next < 0) {
        end_cell(ladder, cell, RN_CELL_DONE, "");
        return RN_OK;
    }
    ladder->changed = true;
    return submit_evaluation(control, task, cell, next, err);
}

// ---- the ladder's ---------------------------------------------------------------------------

static size_t count_over(const struct rn_ladder *ladder) {
    size_t over = 0;
    for (size_t i = 0; i < ladder->record.count; i++)
        over += rn_cell_is_over(&ladder->record.cells[i]);
    return over;
}

static void tell_progress(struct rn_control *control, struct rn_task *task) {
    const struct rn_ladder *ladder = task->ladder;
    size_t over = count_over(ladder), total = ladder->record.count;
    size_t lately = over - ladder->over_at_begin;
    double seconds = (double)(rn_clock_ns() - ladder->begin_ns) * 1e-9;
    struct rn_work_progress progress = {.done = (int64_t)over,
                                        .total = (int64_t)total,
                                        .fraction = (double)over / (double)total,
                                        .eta_seconds = NAN};
    if (lately > 0) progress.eta_seconds = seconds / (double)lately * (double)(total - over);
    for (size_t i = 0; i < total; i++) {
        const struct rn_ladder_cell *cell = &ladder->record.cells[i];
        if (rn_cell_is_over(cell) || cell->state == RN_CELL_WAITING) continue;
        snprintf(progress.stage, sizeof progress.stage, "%s %.20s",
                 rn_cell_state_names[cell->state], cell->label);
        break;
    }
    char *json = NULL;
    if (rn_encode(&rn_work_progress_table, &progress, &json, NULL, NULL) != RN_OK) return;
    free(task->row.progress);
    task->row.progress = json;
    rn_task_publish(control, task, RN_EVENT_PROGRESS, json, true);
}

static enum rn_status save(struct rn_control *control, struct rn_task *task, struct rn_error *err) {
    struct rn_ladder *ladder = task->ladder;
    if (!ladder->changed) return RN_OK;
    enum rn_status status = rn_ladder_write(ladder->folder, &ladder->record, err);
    if (status != RN_OK) return status;
    ladder->changed = false;
    tell_progress(control, task);
    return RN_OK;
}

// Scenes of cells that are over, unless they are to be kept. What was found is on the disk by now.
static void remove_scenes(struct rn_control *control, struct rn_ladder *ladder) {
    struct rn_error err = {0};
    if (truth_or(ladder->record.options.keep, false)) return;
    for (size_t i = 0; i < ladder->record.count; i++) {
        const struct rn_ladder_cell *cell = &ladder->record.cells[i];
        if (ladder->removed[i] || !rn_cell_is_over(cell)) continue;
        enum rn_status status = rn_task_delete_scene(control, cell->scene, &err);
        ladder->removed[i] = status == RN_OK || status == RN_ERROR_NOT_FOUND;
    }
}

static void finish(struct rn_control *control, struct rn_task *task) {
    const struct rn_ladder_record *record = &task->ladder->record;
    struct rn_ladder_result result = {.trainings = (int64_t)record->count,
                                      .arms = (int64_t)task->ladder->plan.count};
    struct rn_error err = {.status = RN_ERROR_INVALID};
    char *json = NULL;
    for (size_t i = 0; i < record->count; i++) {
        const struct rn_ladder_cell *cell = &record->cells[i];
        result.failed += cell->state != RN_CELL_DONE;
        result.train_seconds += isnan(cell->train_seconds) ? 0 : cell->train_seconds;
    }
    if (result.failed == result.trainings)
        rn_error_set(&err, RN_ERROR_INVALID, "", "nothing of it was trained and evaluated; %s",
                     record->cells[0].problem);
    else if (rn_encode(&rn_ladder_result_table, &result, &json, NULL, &err) == RN_OK) {
        free(task->row.result);
        task->row.result = json;
        rn_task_happened(control, task, RN_JOB_DONE);
        return;
    }
    rn_task_fail(control, task, &err);
}

// As many cells at once as trainings may run, so that none is measured beside another's training;
// where a cluster runs them, each on cores of its own, as many as leave others room to submit.
static int slots_of(const struct rn_control *control) {
    const struct rn_control_options *options = &control->options;
    if (!control->executor->spreads) return options->training_slots;
    return options->max_queued > 1 ? options->max_queued / 2 : 1;
}

static enum rn_status work(struct rn_control *control, struct rn_task *task, struct rn_error *err) {
    struct rn_ladder_record *record = &task->ladder->record;
    int busy = 0, slots = slots_of(control);
    enum rn_status status = RN_OK;
    for (size_t i = 0; status == RN_OK && i < record->count && busy < slots; i++) {
        struct rn_ladder_cell *cell = &record->cells[i];
        if (rn_cell_is_over(cell)) continue;
        status = advance(control, task, cell, err);
        busy += !rn_cell_is_over(cell);
        bool mild = status == RN_ERROR_BUSY || status == RN_ERROR_UNAVAILABLE ||
                    status == RN_ERROR_NO_SPACE || status == RN_ERROR_IO;
        if (status == RN_OK || mild) continue;
        end_cell(task->ladder, cell, RN_CELL_FAILED, err->text); // of this cell alone
        status = RN_OK;
    }
    return status;
}

// Ends what runs for it, then itself.
static void cancel(struct rn_control *control, struct rn_task *task) {
    struct rn_ladder *ladder = task->ladder;
    bool open = false;
    for (size_t i = 0; i < ladder->record.count; i++) {
        struct rn_ladder_cell *cell = &ladder->record.cells[i];
        if (rn_cell_is_over(cell)) continue;
        struct rn_task *train = rn_task_find(control, cell->train_job);
        struct rn_task *eval = rn_task_find(control, cell->eval_job);
        bool runs = rn_task_cancel(control, train) | rn_task_cancel(control, eval);
        if (!runs) end_cell(ladder, cell, RN_CELL_CANCELLED, "the ladder was cancelled");
        open = open || runs;
    }
    if (open || save(control, task, NULL) != RN_OK) return;
    remove_scenes(control, ladder);
    rn_task_happened(control, task, RN_JOB_STOPPED);
}

static bool another_runs(const struct rn_control *control) {
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (task->row.type == RN_JOB_LADDER &&
            (task->row.state == RN_JOB_RUNNING || task->row.state == RN_JOB_CANCELLING))
            return true;
    return false;
}

static void look_after(struct rn_control *control, struct rn_task *task) {
    struct rn_error err = {0};
    enum rn_status status = RN_OK;
    if (task->row.state == RN_JOB_QUEUED && !another_runs(control))
        rn_task_happened(control, task, RN_JOB_START);
    bool cancelled = task->row.state == RN_JOB_CANCELLING;
    if (task->row.state != RN_JOB_RUNNING && !cancelled) return;
    if (task->ladder == NULL) status = open_ladder(control, task, &err);
    if (status != RN_OK) {
        rn_task_fail(control, task, &err);
        return;
    }
    if (cancelled) {
        cancel(control, task);
        return;
    }
    status = work(control, task, &err);
    enum rn_status saved = save(control, task, &err);
    if (status != RN_OK || saved != RN_OK) {
        task->not_before_ns = rn_clock_ns() + BUSY_RETRY_NS;
        rn_log(RN_LOG_DEBUG, "ladder %s waits: %s", task->row.id, err.text);
        return;
    }
    remove_scenes(control, task->ladder);
    if (count_over(task->ladder) == task->ladder->record.count) finish(control, task);
}

void rn_ladders_work(struct rn_control *control) {
    if (control->stopping) return;
    int64_t now_ns = rn_clock_ns();
    for (struct rn_task *task = control->tasks; task != NULL; task = task->next)
        if (task->row.type == RN_JOB_LADDER && !rn_job_is_over(task->row.state) &&
            now_ns >= task->not_before_ns)
            look_after(control, task);
}

bool rn_ladder_has(const struct rn_control *control, const char *job) {
    for (const struct rn_task *task = control->tasks; task != NULL; task = task->next)
        for (size_t i = 0; task->ladder != NULL && i < task->ladder->record.count; i++)
            if (strcmp(task->ladder->record.cells[i].train_job, job) == 0) return true;
    return false;
}
