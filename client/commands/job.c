// train, jobs, watch, pause, resume, finish, cancel.

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/estimate.h"
#include "client/commands/submit.h"
#include "client/follow.h"
#include "client/outcome.h"
#include "proto/incident.h"

static const struct rn_option no_options[] = {{0}};

// ---- train ----

struct train_options {
    const char *name, *preset, *device, *kernels;
    union rn_setting_value settings[RN_TRAIN_SETTINGS];
    int64_t threads, ranks;
    bool wait, estimate;
};
#define TRAIN(m) .offset = offsetof(struct train_options, m)
static const struct rn_option train_table[] = {
    {.name = "name",
     .kind = RN_OPTION_TEXT,
     TRAIN(name),
     .value = "SCENE",
     .members = "scene",
     .help = "the new scene's name"},
    {.name = "preset",
     .kind = RN_OPTION_CHOICE,
     TRAIN(preset),
     .choices = rn_preset_names,
     .help = "where the settings start from (standard)"},
    {.name = "", .kind = RN_OPTION_SETTINGS, TRAIN(settings), .settings = &rn_train_settings},
    {.name = "threads",
     .kind = RN_OPTION_INTEGER,
     TRAIN(threads),
     .value = "N",
     .min = 0,
     .max = 1024,
     .help = "0 takes all cores; results do not depend on it"},
    {.name = "ranks",
     .kind = RN_OPTION_INTEGER,
     TRAIN(ranks),
     .value = "N",
     .min = 1,
     .max = 16,
     .help = "nodes of a Slurm cluster that train it together (1); results do not depend on it"},
    {.name = "device",
     .kind = RN_OPTION_TEXT,
     TRAIN(device),
     .value = "auto|cpu|cuda:0",
     .help = "where to train (auto)"},
    {.name = "kernels",
     .kind = RN_OPTION_TEXT,
     TRAIN(kernels),
     .value = "SET",
     .help = "the CPU's kernel set, of those `ripnerf info` lists; else the fastest"},
    {.name = "wait", .kind = RN_OPTION_FLAG, TRAIN(wait), .help = "show progress until the end"},
    {.name = "estimate",
     .kind = RN_OPTION_FLAG,
     TRAIN(estimate),
     .help = "do not train: measure for some seconds what it would take, and tell"},
    {0}};

struct train_request {
    int type;
    char *dataset, *scene;
    struct rn_train_options options;
};
static const struct rn_field_spec train_request_fields[] = {
    RN_F_NAME(struct train_request, type, RN_REQUIRED, rn_job_type_names),
    RN_F_STRING(struct train_request, dataset, RN_REQUIRED, 4096),
    RN_F_STRING(struct train_request, scene, 0, 4096),
    RN_F_OBJECT(struct train_request, options, 0, &rn_train_options_table)};
static const struct rn_table train_request_table =
    RN_TABLE(struct train_request, "training request", train_request_fields);

// -1 for an absent word.
static int index_of(const char *const *names, const char *word) {
    return word ? rn_name_index(names, word) : -1;
}

static enum rn_exit train_body(const struct train_options *options, const char *dataset,
                               char **ret_body) {
    struct train_request request;
    rn_message_init(&train_request_table, &request);
    request.type = options->estimate ? RN_JOB_ESTIMATE : RN_JOB_TRAIN;
    request.dataset = (char *)dataset; // only read
    request.scene = options->estimate ? NULL : (char *)options->name;
    struct rn_train_options *train = &request.options;
    train->preset = index_of(rn_preset_names, options->preset);
    memcpy(train->settings, options->settings, sizeof train->settings);
    train->threads = options->threads;
    train->ranks = options->ranks;
    if (!rn_take_text("--device", options->device, NULL, train->device, sizeof train->device) ||
        !rn_take_text("--kernels", options->kernels, NULL, train->kernels, sizeof train->kernels))
        return RN_EXIT_USAGE;
    *ret_body = rn_api_encode(&train_request_table, &request);
    return *ret_body ? RN_EXIT_OK : RN_EXIT_FAILED;
}

// What `train --wait --json` ends with: the job's end, with what is known of it.
struct train_summary {
    char job[RN_ID_MAX], scene[RN_ID_MAX], scene_name[RN_NAME_MAX];
    int state;
    int64_t steps;
    double train_seconds;
    int64_t samples;
    double psnr;
    int64_t psnr_step;
    char parameters_sha256[65];
    int finished_by;
    char *problem; // borrowed
};
#define NULLABLE (RN_REQUIRED | RN_NULLABLE)
static const struct rn_field_spec train_summary_fields[] = {
    RN_F_TEXT(struct train_summary, job, RN_REQUIRED, NULL),
    RN_F_TEXT(struct train_summary, scene, RN_REQUIRED, NULL),
    RN_F_TEXT(struct train_summary, scene_name, RN_REQUIRED, NULL),
    RN_F_NAME(struct train_summary, state, RN_REQUIRED, rn_job_state_names),
    RN_F_INT(struct train_summary, steps, RN_REQUIRED, 0, INT64_MAX),
    RN_F_NUMBER(struct train_summary, train_seconds, RN_REQUIRED, 0, INFINITY),
    RN_F_INT(struct train_summary, samples, RN_REQUIRED, 0, INT64_MAX),
    RN_F_NUMBER(struct train_summary, psnr, NULLABLE, -INFINITY, INFINITY),
    RN_F_INT(struct train_summary, psnr_step, 0, 0, INT64_MAX),
    RN_F_TEXT(struct train_summary, parameters_sha256, NULLABLE, NULL),
    RN_F_NAME(struct train_summary, finished_by, NULLABLE, rn_finished_by_names),
    RN_F_JSON(struct train_summary, problem, 0)};
static const struct rn_table train_summary_table =
    RN_TABLE(struct train_summary, "summary", train_summary_fields);

static void summarise(const struct rn_job *job, struct train_summary *ret_summary) {
    struct rn_train_result result;
    struct rn_train_progress progress;
    rn_message_init(&train_summary_table, ret_summary);
    memcpy(ret_summary->job, job->id, sizeof job->id);
    memcpy(ret_summary->scene, job->scene, sizeof job->scene);
    memcpy(ret_summary->scene_name, job->scene_name, sizeof job->scene_name);
    ret_summary->state = job->state;
    ret_summary->steps = ret_summary->samples = 0;
    ret_summary->train_seconds = 0;
    ret_summary->problem = job->problem;
    if (job->result && rn_decode(&rn_train_result_table, job->result, strlen(job->result), &result,
                                 NULL, NULL) == RN_OK) {
        ret_summary->steps = result.steps;
        ret_summary->train_seconds = result.train_seconds;
        ret_summary->samples = result.samples;
        ret_summary->psnr = result.psnr;
        ret_summary->psnr_step = result.psnr_step;
        ret_summary->finished_by = result.finished_by;
        memcpy(ret_summary->parameters_sha256, result.parameters_sha256,
               sizeof result.parameters_sha256);
        rn_message_finish(&rn_train_result_table, &result);
    } else if (job->progress && rn_decode(&rn_train_progress_table, job->progress,
                                          strlen(job->progress), &progress, NULL, NULL) == RN_OK) {
        ret_summary->steps = progress.step;
        ret_summary->train_seconds = progress.train_seconds;
        ret_summary->samples = progress.samples;
        ret_summary->psnr = progress.psnr;
        ret_summary->psnr_step = progress.psnr_step;
    }
}

static void print_summary(const struct rn_job *job, bool json) {
    struct train_summary summary;
    char seconds[24], psnr[48];
    summarise(job, &summary);
    if (json) {
        char *text = rn_api_encode(&train_summary_table, &summary);
        if (text) puts(text);
        free(text);
        return;
    }
    rn_format_seconds(summary.train_seconds, seconds, sizeof seconds);
    rn_format_figure(summary.psnr, summary.psnr_step, summary.steps, psnr, sizeof psnr);
    printf("scene %s (%s): %lld steps in %s, PSNR %s\n", summary.scene_name, summary.scene,
           (long long)summary.steps, seconds, *psnr ? psnr : "not measured");
}

// Waits for a job and prints how it ended.
static enum rn_exit wait_for(struct rn_client *client, const char *job_id) {
    struct rn_follow follow = {.client = client, .quiet = client->json};
    enum rn_exit code = rn_follow_job(&follow, job_id);
    if (follow.known && rn_job_has_ended(&follow.job) &&
        (client->json || follow.job.state != RN_JOB_FAILED))
        print_summary(&follow.job, client->json);
    rn_follow_finish(&follow);
    return code;
}

static enum rn_exit run_train(struct rn_client *client, const void *context, const char **args) {
    const struct train_options *options = context;
    char job[RN_ID_MAX], *answer = NULL;
    struct rn_error err;
    if (options->name && options->estimate)
        return rn_client_usage("", "--name and --estimate exclude each other: an estimate leaves "
                                   "no scene to name");
    if (!options->name && !options->estimate) return rn_name_missing("train", args[0]);
    if (rn_train_choice_check(options->settings, &err) != RN_OK) {
        char flag[64];
        snprintf(flag, sizeof flag, "--%.60s", err.where);
        return rn_client_usage(flag, "%s", err.text);
    }
    char *body = NULL;
    enum rn_exit code = train_body(options, args[0], &body);
    if (code == RN_EXIT_OK) code = rn_submit(client, body, job, &answer);
    free(body);
    if (code == RN_EXIT_OK && options->estimate)
        code = rn_wait_for_estimate(client, job);
    else if (code == RN_EXIT_OK && options->wait)
        code = wait_for(client, job);
    else if (code == RN_EXIT_OK && client->json)
        puts(answer);
    else if (code == RN_EXIT_OK)
        printf("%s trains scene %s. Follow it with: ripnerf watch %s\n", job, options->name, job);
    free(answer);
    return code;
}

// ---- jobs ----

// Where it runs, or why it waits, before its figures.
static void add_place(const struct rn_job *job, char text[RN_TEXT_TABLE_CELL]) {
    const struct rn_job_runner *runner = &job->runner;
    char figures[RN_TEXT_TABLE_CELL], number[40] = "";
    memcpy(figures, text, sizeof figures);
    if (*runner->slurm_job) snprintf(number, sizeof number, "Slurm %s", runner->slurm_job);
    if (*runner->reason)
        snprintf(text, RN_TEXT_TABLE_CELL, "waits: %.50s%s%s", runner->reason, *number ? "; " : "",
                 number);
    else if (*runner->machine)
        snprintf(text, RN_TEXT_TABLE_CELL, "on %.24s (%s)%s%.30s", runner->machine, number,
                 *figures ? ": " : "", figures);
}

static void add_job_row(struct rn_text_table *table, const void *message) {
    const struct rn_job *job = message;
    char text[RN_TEXT_TABLE_CELL] = "";
    double fraction = NAN;
    if (rn_job_has_ended(job))
        rn_format_outcome(job, text, sizeof text);
    else
        rn_format_progress(job, job->progress, &fraction, text, sizeof text);
    add_place(job, text);
    rn_text_table_row(table, "%s|%s|%s|%s|%s|%s", job->id, rn_job_type_names[job->type],
                      rn_job_state_names[job->state],
                      *job->scene_name ? job->scene_name : job->dataset_name, job->created_at,
                      text);
}

static enum rn_exit run_jobs(struct rn_client *client, const void *options, const char **args) {
    static const struct rn_api_list list = {.kind = RN_KIND_JOB,
                                            .table = &rn_job_table,
                                            .heading = "ID|TYPE|STATE|FOR|CREATED|FIGURES",
                                            .row = add_job_row};
    return rn_api_print_list(client, &list);
}

// ---- watch ----

// {"event": ..., "data": ...}, a line each.
static bool print_event(struct rn_follow *follow, const struct rn_sse_event *event) {
    printf("{\"event\":\"%s\",\"data\":%s}\n", event->type, event->data);
    if (fflush(stdout) != 0) follow->code = RN_EXIT_FAILED; // nobody reads any more
    return follow->code == RN_EXIT_OK;
}

static void note_incident(struct rn_follow *follow, const struct rn_sse_event *event) {
    struct rn_incident_event incident;
    if (rn_decode(&rn_incident_event_table, event->data, event->size_bytes, &incident, NULL,
                  NULL) != RN_OK)
        return;
    rn_progress_note(&follow->progress,
                     "step %lld  %s: %lld rays and %lld parameters were not finite  %s",
                     (long long)incident.step, rn_incident_kind_names[incident.kind],
                     (long long)incident.rays, (long long)incident.parameters, incident.file);
    rn_message_finish(&rn_incident_event_table, &incident);
}

static bool note_event(struct rn_follow *follow, const struct rn_sse_event *event) {
    struct rn_metric_event metric;
    if (strcmp(event->type, RN_EVENT_INCIDENT) == 0) note_incident(follow, event);
    if (strcmp(event->type, RN_EVENT_METRIC) != 0 ||
        rn_decode(&rn_metric_event_table, event->data, event->size_bytes, &metric, NULL, NULL) !=
            RN_OK)
        return true;
    rn_progress_note(&follow->progress, "step %lld  %.1f s  PSNR %.2f dB", (long long)metric.step,
                     metric.train_seconds, metric.psnr);
    rn_message_finish(&rn_metric_event_table, &metric);
    return true;
}

static enum rn_exit run_watch(struct rn_client *client, const void *options, const char **args) {
    char job[RN_ID_MAX];
    enum rn_exit code = rn_api_find_job(client, args[0], job);
    if (code != RN_EXIT_OK) return code;
    struct rn_follow follow = {
        .client = client, .quiet = client->json, .event = client->json ? print_event : note_event};
    code = rn_follow_job(&follow, job);
    if (follow.detached)
        code = RN_EXIT_OK; // leaving is how watching ends
    else if (follow.known && !client->json && code == RN_EXIT_OK) {
        if (follow.job.type == RN_JOB_TRAIN)
            print_summary(&follow.job, false);
        else
            printf("%s has %s\n", job, rn_job_state_names[follow.job.state]);
    }
    rn_follow_finish(&follow);
    return code;
}

// ---- pause, resume, finish, cancel ----

static enum rn_exit order(struct rn_client *client, const char *reference, const char *action) {
    char id[RN_ID_MAX];
    struct rn_api_reply reply;
    struct rn_job job;
    enum rn_exit code = rn_api_find_job(client, reference, id);
    if (code != RN_EXIT_OK) return code;
    char *path = rn_api_path("jobs", id, action);
    if (!path) return RN_EXIT_FAILED;
    rn_api_send(client, "POST", path, NULL, &reply);
    free(path);
    code = reply.code == RN_EXIT_OK ? rn_api_decode(&reply, &rn_job_table, &job)
                                    : rn_api_complain(&reply);
    if (code == RN_EXIT_OK) {
        if (client->json)
            puts((char *)reply.http.body.data);
        else
            printf("%s: %s\n", job.id, rn_job_state_names[job.state]);
        rn_message_finish(&rn_job_table, &job);
    }
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit run_pause(struct rn_client *client, const void *options, const char **args) {
    return order(client, args[0], "/pause");
}

static enum rn_exit run_resume(struct rn_client *client, const void *options, const char **args) {
    return order(client, args[0], "/resume");
}

static enum rn_exit run_finish(struct rn_client *client, const void *options, const char **args) {
    return order(client, args[0], "/finish");
}

static enum rn_exit run_cancel(struct rn_client *client, const void *options, const char **args) {
    return order(client, args[0], "/cancel");
}

const struct rn_verb rn_verbs_job[] = {
    {.name = "train",
     .arguments = "DATASET --name SCENE",
     .summary = "train a new scene",
     .details =
         "Without --max-time and --max-steps it ends where the preset does: draft after 15 s,\n"
         "standard after 60 s, paper after 120,000 steps. With --wait --json the last line is\n"
         "an object with job, scene, state, steps, train_seconds, samples and psnr. Ctrl-C\n"
         "while waiting leaves the job running.",
     .args_min = 1,
     .args_max = 1,
     .table = train_table,
     .options_size = sizeof(struct train_options),
     .run = run_train},
    {.name = "jobs", .arguments = "", .summary = "list jobs", .table = no_options, .run = run_jobs},
    {.name = "watch",
     .arguments = "JOB",
     .summary = "follow a job until it ends",
     .details = "With --json, each event on a line: {\"event\": ..., \"data\": ...}.",
     .args_min = 1,
     .args_max = 1,
     .table = no_options,
     .run = run_watch},
    {.name = "pause",
     .arguments = "JOB",
     .summary = "pause training; a checkpoint is kept",
     .args_min = 1,
     .args_max = 1,
     .table = no_options,
     .run = run_pause},
    {.name = "resume",
     .arguments = "JOB",
     .summary = "go on with a paused job, or with a path that has ended early",
     .details = "Of a path job that failed or was cancelled, a new one makes what is missing.",
     .args_min = 1,
     .args_max = 1,
     .table = no_options,
     .run = run_resume},
    {.name = "finish",
     .arguments = "JOB",
     .summary = "stop training now and keep the scene",
     .args_min = 1,
     .args_max = 1,
     .table = no_options,
     .run = run_finish},
    {.name = "cancel",
     .arguments = "JOB",
     .summary = "cancel a job; the last checkpoint is kept",
     .args_min = 1,
     .args_max = 1,
     .table = no_options,
     .run = run_cancel},
    {0}};
