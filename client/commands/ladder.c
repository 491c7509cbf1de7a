// ladder: a table of trainings that differ in what is asked for, compared.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/commands/submit.h"
#include "client/table.h"
#include "proto/ladder.h"

struct ladder_options {
    const char *over, *with, *equal, *preset, *split, *device, *kernels, *report;
    int64_t seeds, views, moments, threads;
    union rn_setting_value settings[RN_TRAIN_SETTINGS];
    bool one_cone, keep, wait, overwrite;
};
#define LADDER(m) .offset = offsetof(struct ladder_options, m)
static const struct rn_option ladder_table[] = {
    {.name = "over",
     .kind = RN_OPTION_TEXT,
     LADDER(over),
     .value = "NAME=V,V",
     .help = "what varies: any setting by its name, with its values; more of them follow as words, "
             "every value is trained with every other; after a word + another table begins"},
    {.name = "with",
     .kind = RN_OPTION_TEXT,
     LADDER(with),
     .needs = "over",
     .value = "NAME=V ...",
     .help = "settings of all of them by name, such as 'target_samples=65536 carve=false'"},
    {.name = "equal",
     .kind = RN_OPTION_CHOICE,
     LADDER(equal),
     .needs = "over",
     .choices = rn_ladder_equal_names,
     .help = "what all have in common: seconds (the default), --max-steps, or the planes' texels"},
    {.name = "seeds",
     .kind = RN_OPTION_INTEGER,
     LADDER(seeds),
     .needs = "over",
     .value = "N",
     .min = 1,
     .max = 16,
     .help = "trainings of each, with seeds that all share (3)"},
    {.name = "preset",
     .kind = RN_OPTION_CHOICE,
     LADDER(preset),
     .needs = "over",
     .choices = rn_preset_names,
     .help = "where the settings start from (standard)"},
    {.name = "",
     .kind = RN_OPTION_SETTINGS,
     LADDER(settings),
     .needs = "over",
     .settings = &rn_train_settings},
    {.name = "split",
     .kind = RN_OPTION_CHOICE,
     LADDER(split),
     .needs = "over",
     .choices = rn_split_names,
     .help = "views to evaluate on (test)"},
    {.name = "views",
     .kind = RN_OPTION_INTEGER,
     LADDER(views),
     .needs = "over",
     .value = "N",
     .min = 0,
     .max = 1000000,
     .help = "so many of them, evenly spaced; 0 all (20)"},
    {.name = "moments",
     .kind = RN_OPTION_INTEGER,
     LADDER(moments),
     .needs = "over",
     .value = "N",
     .min = 0,
     .max = 8,
     .help = "also evaluated at so many times on the way (3)"},
    {.name = "one-cone",
     .kind = RN_OPTION_FLAG,
     LADDER(one_cone),
     .needs = "over",
     .help = "also evaluated with one cone a pixel"},
    {.name = "threads",
     .kind = RN_OPTION_INTEGER,
     LADDER(threads),
     .needs = "over",
     .value = "N",
     .min = 0,
     .max = 1024,
     .help = "0 takes all cores"},
    {.name = "device",
     .kind = RN_OPTION_TEXT,
     LADDER(device),
     .needs = "over",
     .value = "auto|cpu|cuda:0",
     .help = "where to train (auto)"},
    {.name = "kernels",
     .kind = RN_OPTION_TEXT,
     LADDER(kernels),
     .needs = "over",
     .value = "SET",
     .help = "the CPU's kernel set; else the fastest"},
    {.name = "keep",
     .kind = RN_OPTION_FLAG,
     LADDER(keep),
     .needs = "over",
     .help = "keep the scenes; else each is removed once it is evaluated"},
    {.name = "wait", .kind = RN_OPTION_FLAG, LADDER(wait), .help = "show progress until the end"},
    {.name = "report",
     .kind = RN_OPTION_TEXT,
     LADDER(report),
     .value = "FILE",
     .help = "wait, and write the report: .html, .csv or .json; of a ladder's id, as it is now"},
    {.name = "overwrite",
     .kind = RN_OPTION_FLAG,
     LADDER(overwrite),
     .needs = "report",
     .help = "replace the report's file"},
    {0}};

struct ladder_request {
    int type;
    char *dataset;
    struct rn_ladder_options options;
};
static const struct rn_field_spec ladder_request_fields[] = {
    RN_F_NAME(struct ladder_request, type, RN_REQUIRED, rn_job_type_names),
    RN_F_STRING(struct ladder_request, dataset, RN_REQUIRED, 4096),
    RN_F_OBJECT(struct ladder_request, options, RN_REQUIRED, &rn_ladder_options_table)};
static const struct rn_table ladder_request_table =
    RN_TABLE(struct ladder_request, "ladder request", ladder_request_fields);

// ---- asking ---------------------------------------------------------------------------------

static int index_of(const char *const *names, const char *word) {
    return word ? rn_name_index(names, word) : -1;
}

// --over and the words behind the dataset, as one text.
static bool join_over(const char *over, const char **words, char ret_text[RN_LADDER_TEXT]) {
    size_t length = (size_t)snprintf(ret_text, RN_LADDER_TEXT, "%s", over);
    for (; *words && length < RN_LADDER_TEXT; words++)
        length += (size_t)snprintf(ret_text + length, RN_LADDER_TEXT - length, " %s", *words);
    return length < RN_LADDER_TEXT;
}

// "NAME=VALUE NAME=VALUE": each is a table of one arm.
static enum rn_exit take_with(const char *with, union rn_setting_value *values) {
    struct rn_ladder_plan plan;
    struct rn_error err;
    if (rn_ladder_plan(with, RN_LADDER_EQUAL_TIME, RN_PRESET_STANDARD, values, &plan, &err) !=
        RN_OK)
        return rn_client_usage("--with", "%s", err.text);
    bool one = plan.count == 1;
    if (one) memcpy(values, plan.arms[0].values, sizeof plan.arms[0].values);
    rn_ladder_plan_finish(&plan);
    return one ? RN_EXIT_OK : rn_client_usage("--with", "gives a setting several values");
}

static enum rn_exit make_body(const struct ladder_options *options, const char **args,
                              char **ret_body) {
    struct ladder_request request;
    rn_message_init(&ladder_request_table, &request);
    request.type = RN_JOB_LADDER;
    request.dataset = (char *)args[0]; // only read
    struct rn_ladder_options *wanted = &request.options;
    if (!join_over(options->over, args + 1, wanted->over))
        return rn_client_usage("--over", "must have at most %d bytes in all", RN_LADDER_TEXT - 1);
    wanted->equal = index_of(rn_ladder_equal_names, options->equal);
    wanted->split = index_of(rn_split_names, options->split);
    wanted->seeds = options->seeds;
    wanted->views = options->views;
    wanted->moments = options->moments;
    wanted->one_cone = options->one_cone ? 1 : -1;
    wanted->keep = options->keep ? 1 : -1;
    struct rn_train_options *train = &wanted->train;
    train->preset = index_of(rn_preset_names, options->preset);
    memcpy(train->settings, options->settings, sizeof train->settings);
    enum rn_exit code = options->with ? take_with(options->with, train->settings) : RN_EXIT_OK;
    if (code != RN_EXIT_OK) return code;
    train->threads = options->threads;
    if (!rn_take_text("--device", options->device, NULL, train->device, sizeof train->device) ||
        !rn_take_text("--kernels", options->kernels, NULL, train->kernels, sizeof train->kernels))
        return RN_EXIT_USAGE;
    *ret_body = rn_api_encode(&ladder_request_table, &request);
    return *ret_body ? RN_EXIT_OK : RN_EXIT_FAILED;
}

// ---- its report -----------------------------------------------------------------------------

static const char *format_of(const char *file) {
    static const char *const formats[] = {"html", "csv", "json", NULL};
    const char *dot = file ? strrchr(file, '.') : NULL;
    int i = dot ? rn_name_index(formats, dot + 1) : -1;
    return i < 0 ? NULL : formats[i];
}

static enum rn_exit check_report(const struct ladder_options *options) {
    if (!options->report) return RN_EXIT_OK;
    if (!format_of(options->report))
        return rn_client_usage("--report", "must end in .html, .csv or .json; it is '%s'",
                               options->report);
    return rn_client_check_target(options->report, options->overwrite);
}

// "/v1/jobs/JOB/report?format=..."; malloc'd.
static char *report_path(const char *job, const char *format) {
    char tail[32];
    snprintf(tail, sizeof tail, "/report?format=%s", format);
    return rn_api_path("jobs", job, tail);
}

static enum rn_exit save_report(struct rn_client *client, const char *job, const char *file) {
    char *path = report_path(job, format_of(file));
    enum rn_exit code = path ? rn_api_save(client, path, file) : RN_EXIT_FAILED;
    free(path);
    return code;
}

static void format_figure(const struct rn_ladder_figure *figure, double unit, int digits,
                          char text[48]) {
    text[0] = '\0';
    if (figure->count == 0) return;
    int length = snprintf(text, 48, "%.*f", digits, figure->mean / unit);
    if (figure->count > 1 && length > 0)
        snprintf(text + length, 48 - (size_t)length, " +-%.*f", digits,
                 (figure->high - figure->low) / 2 / unit);
}

static enum rn_exit print_arms(const struct rn_ladder_report *report) {
    struct rn_text_table table;
    struct rn_error err = {0};
    rn_text_table_init(&table, "ARM|>PSNR|>OVER THE FIRST|>SSIM|>SECONDS|>STEPS|>MS A "
                               "PICTURE|>MEMORY, MIB|>ON DISK, MIB");
    for (size_t i = 0; i < report->arm_count; i++) {
        const struct rn_ladder_arm_record *arm = &report->arms[i];
        const struct rn_ladder_figure *figures[] = {
            &arm->psnr,  &arm->margin,    &arm->ssim,         &arm->train_seconds,
            &arm->steps, &arm->render_ms, &arm->memory_bytes, &arm->disk_bytes};
        static const int digits[] = {2, 2, 4, 1, 0, 1, 0, 1};
        char texts[8][48];
        for (int k = 0; k < 8; k++)
            format_figure(figures[k], k < 6 ? 1 : 1048576, digits[k], texts[k]);
        rn_text_table_row(&table, "%s|%s|%s|%s|%s|%s|%s|%s|%s", arm->label, texts[0], texts[1],
                          texts[2], texts[3], texts[4], texts[5], texts[6], texts[7]);
    }
    enum rn_status status = rn_text_table_print(&table, &err);
    rn_text_table_finish(&table);
    for (size_t i = 0; i < report->ladder.count; i++) {
        const struct rn_ladder_cell *cell = &report->ladder.cells[i];
        if (!*cell->problem) continue;
        printf("%s, seed %lld: ", cell->label, (long long)cell->seed);
        rn_client_print(stdout, cell->problem);
        putchar('\n');
    }
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

static enum rn_exit tell_report(struct rn_client *client, const char *job) {
    struct rn_api_reply reply;
    struct rn_ladder_report report;
    char *path = report_path(job, "json");
    rn_api_send(client, "GET", path ? path : "/", NULL, &reply);
    free(path);
    enum rn_exit code = reply.code == RN_EXIT_OK ? RN_EXIT_OK : rn_api_complain(&reply);
    if (code == RN_EXIT_OK && client->json)
        puts((char *)reply.http.body.data);
    else if (code == RN_EXIT_OK)
        code = rn_api_decode(&reply, &rn_ladder_report_table, &report);
    if (code == RN_EXIT_OK && !client->json) {
        code = print_arms(&report);
        rn_message_finish(&rn_ladder_report_table, &report);
    }
    rn_api_reply_finish(&reply);
    return code;
}

// ---- the verb -------------------------------------------------------------------------------

// What there is of a ladder: its report is written where that is wanted, and told.
static enum rn_exit show(struct rn_client *client, const struct ladder_options *options,
                         const char *job) {
    enum rn_exit code = RN_EXIT_OK;
    if (options->report) code = save_report(client, job, options->report);
    return code == RN_EXIT_OK ? tell_report(client, job) : code;
}

static enum rn_exit start(struct rn_client *client, const char *body) {
    char job[RN_ID_MAX], *answer = NULL;
    enum rn_exit code = rn_submit(client, body, job, &answer);
    if (code == RN_EXIT_OK && client->json)
        puts(answer);
    else if (code == RN_EXIT_OK)
        printf("%s; see it with: ripnerf ladder %s\n", job, job);
    free(answer);
    return code;
}

static enum rn_exit begin(struct rn_client *client, const struct ladder_options *options,
                          const char **args) {
    struct rn_follow follow;
    char *body = NULL;
    enum rn_exit code = make_body(options, args, &body);
    if (code != RN_EXIT_OK) return code;
    if (options->wait || options->report) {
        code = rn_submit_and_follow(client, body, &follow);
        if (code == RN_EXIT_OK) code = show(client, options, follow.job.id);
        rn_follow_finish(&follow);
        return code;
    }
    code = start(client, body);
    free(body);
    return code;
}

static enum rn_exit look(struct rn_client *client, const struct ladder_options *options,
                         const char *job) {
    struct rn_follow follow = {.client = client, .quiet = client->json};
    enum rn_exit code = options->wait ? rn_follow_job(&follow, job) : RN_EXIT_OK;
    if (options->wait) rn_follow_finish(&follow);
    return code == RN_EXIT_OK ? show(client, options, job) : code;
}

static enum rn_exit run_ladder(struct rn_client *client, const void *context, const char **args) {
    const struct ladder_options *options = context;
    enum rn_exit code = check_report(options);
    if (code != RN_EXIT_OK) return code;
    if (options->over) return begin(client, options, args);
    if (strncmp(args[0], RN_ID_JOB, strlen(RN_ID_JOB)) != 0)
        return rn_client_usage("ladder", "needs --over NAME=VALUE,VALUE to begin one of a dataset, "
                                         "or the id of a ladder");
    if (args[1]) return rn_client_usage(args[1], "is one argument too many");
    return look(client, options, args[0]);
}

const struct rn_verb rn_verbs_ladder[] = {
    {.name = "ladder",
     .arguments = "DATASET|JOB",
     .summary = "train a table of settings and compare: PSNR, SSIM, time, memory, bytes on disk",
     .details =
         "  ripnerf ladder lego --over planes=3,4,6,10 footprint=rip,mip --max-time 15s\n"
         "  ripnerf ladder lego --over planes=3,10 + planes=10 footprint=mip \\\n"
         "      --preset paper --equal steps --max-steps 1000\n\n"
         "Every arm is trained with the same seeds, one training after the other, and evaluated "
         "on views it never saw, on the way too. The ladder is a job: it goes on after the daemon "
         "was stopped or killed, without training anything again, and can be cancelled. With its "
         "id the verb tells what is there so far. The report is one page with plots that needs "
         "nothing beside it; the daemon shows it at /v1/jobs/JOB/report.",
     .args_min = 1,
     .args_max = RN_VERB_MAX_ARGS,
     .table = ladder_table,
     .options_size = sizeof(struct ladder_options),
     .run = run_ladder},
    {0}};
