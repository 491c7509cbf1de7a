// doctor: whether the mathematics is sound on this machine, and on a scene.

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/api.h"
#include "client/local.h"
#include "common/base/clock.h"
#include "common/base/file.h"
#include "proto/doctor.h"
#include "proto/scene.h"

#define IDLE_S 120 // seconds without a byte before a download is given up

struct doctor_options {
    int64_t seed;
    const char *replay;
};
#define DOCTOR(m) .offset = offsetof(struct doctor_options, m)
static const struct rn_option doctor_table[] = {
    {.name = "seed",
     .kind = RN_OPTION_INTEGER,
     DOCTOR(seed),
     .value = "N",
     .help = "of the random inputs; else a fresh one, which is printed",
     .min = 0,
     .max = 9007199254740991},
    {.name = "replay",
     .kind = RN_OPTION_TEXT,
     DOCTOR(replay),
     .value = "FILE",
     .help = "a record of a step that was not finite: its rays again"},
    {0}};

// ---- a scene's files ------------------------------------------------------------------------

// A resource's body into a file.
static enum rn_exit fetch(struct rn_client *client, const char *kind, const char *id,
                          const char *tail, const char *file) {
    struct rn_error err = {0};
    char *path = rn_api_path(kind, id, tail);
    int fd = open(file, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    enum rn_exit code =
        path && fd >= 0 ? rn_api_download(client, path, IDLE_S, fd, file) : RN_EXIT_FAILED;
    if (fd < 0 || (close(fd) < 0 && code == RN_EXIT_OK)) {
        rn_error_from_errno(&err, errno, file, "write");
        code = rn_client_fail(&err);
    }
    free(path);
    return code;
}

// The scene's last checkpoint and its dataset's cameras.
static enum rn_exit fetch_scene(struct rn_client *client, const char *reference,
                                const char *checkpoint, const char *cameras) {
    struct rn_api_reply reply;
    struct rn_scene scene;
    enum rn_kind kind;
    enum rn_exit code = rn_api_find(client, RN_KIND_SCENE, reference, &kind, &reply);
    if (code != RN_EXIT_OK) return code;
    code = rn_api_decode(&reply, &rn_scene_table, &scene);
    rn_api_reply_finish(&reply);
    if (code != RN_EXIT_OK) return code;
    if (*scene.dataset)
        code = fetch(client, "scenes", scene.id, "/checkpoint", checkpoint);
    else
        code =
            rn_client_usage(reference, "was imported without a dataset, whose cameras are needed");
    if (code == RN_EXIT_OK) code = fetch(client, "datasets", scene.dataset, "/cameras", cameras);
    rn_message_finish(&rn_scene_table, &scene);
    return code;
}

// ---- the report -----------------------------------------------------------------------------

static const char *number(double value, char text[24]) {
    snprintf(text, 24, isnan(value) ? "-" : "%.3g", value);
    return text;
}

static enum rn_status print_report(const struct rn_doctor_record *record, struct rn_error *err) {
    struct rn_text_table table;
    char worst[24], bound[24];
    size_t failed = 0, skipped = 0;
    rn_text_table_init(&table, "RESULT|CASE|KERNELS|>NUMBER|>BOUND|UNIT|WHERE");
    for (size_t i = 0; i < record->case_count; i++) {
        const struct rn_doctor_case_record *c = &record->cases[i];
        const char *outcome = c->skipped ? "skipped" : c->passed ? "pass" : "FAIL";
        failed += !c->passed && !c->skipped;
        skipped += c->skipped;
        rn_text_table_row(&table, "%s|%s|%s|%s|%s|%s|%s", outcome, c->name, c->kernels,
                          number(c->worst, worst), number(c->bound, bound), c->unit, c->where);
    }
    enum rn_status status = rn_text_table_print(&table, err);
    rn_text_table_finish(&table);
    printf("\n%zu cases, %zu failed, %zu skipped; seed %lld\n", record->case_count, failed, skipped,
           (long long)record->seed);
    return status;
}

static enum rn_exit show(const struct rn_client *client, struct rn_buf *report) {
    struct rn_doctor_record record;
    struct rn_error err = {0};
    if (client->json) return fputs((char *)report->data, stdout) < 0 ? RN_EXIT_FAILED : RN_EXIT_OK;
    enum rn_status status =
        rn_decode(&rn_doctor_table, (char *)report->data, report->size, &record, NULL, &err);
    if (status != RN_OK) return rn_client_fail(&err);
    status = print_report(&record, &err);
    rn_message_finish(&rn_doctor_table, &record);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

// ---- the verb -------------------------------------------------------------------------------

static enum rn_exit examine(struct rn_client *client, const struct doctor_options *options,
                            const char *scene, const char *folder) {
    char seed[24], checkpoint[PATH_MAX], cameras[PATH_MAX];
    const char *argv[14] = {NULL, "--mode", "doctor", "--seed", seed};
    int n = 5;
    snprintf(seed, sizeof seed, "%lld",
             (long long)rn_int_or(options->seed, rn_clock_wall_ms() % 1000000000));
    if (scene) {
        snprintf(checkpoint, sizeof checkpoint, "%s/checkpoint.safetensors", folder);
        snprintf(cameras, sizeof cameras, "%s/cameras.json", folder);
        enum rn_exit code = fetch_scene(client, scene, checkpoint, cameras);
        if (code != RN_EXIT_OK) return code;
        argv[n++] = "--checkpoint", argv[n++] = checkpoint;
        argv[n++] = "--cameras", argv[n++] = cameras;
        if (options->replay) argv[n++] = "--replay", argv[n++] = options->replay;
    }
    struct rn_buf report;
    enum rn_exit code = rn_local_run(argv, client->json, &report), shown = RN_EXIT_OK;
    if (report.size > 0) shown = show(client, &report);
    rn_buf_finish(&report);
    return code != RN_EXIT_OK ? code : shown;
}

static enum rn_exit run_doctor(struct rn_client *client, const void *context, const char **args) {
    const struct doctor_options *options = context;
    const char *parent = getenv("TMPDIR");
    struct rn_error err = {0};
    char folder[512];
    if (!args[0] && options->replay)
        return rn_client_usage("--replay", "needs the scene: ripnerf doctor SCENE --replay FILE");
    enum rn_exit code = options->replay ? rn_client_check_source(options->replay) : RN_EXIT_OK;
    if (code != RN_EXIT_OK || !args[0])
        return code != RN_EXIT_OK ? code : examine(client, options, NULL, "");
    int size = snprintf(folder, sizeof folder, "%s/ripnerf-doctor-XXXXXX",
                        parent && *parent ? parent : "/tmp");
    if (size >= (int)sizeof folder) return rn_client_usage("TMPDIR", "is too long a name");
    if (!mkdtemp(folder)) {
        rn_error_from_errno(&err, errno, folder, "make a folder");
        return rn_client_fail(&err);
    }
    code = examine(client, options, args[0], folder);
    if (rn_remove_tree(folder, &err) != RN_OK) {
        enum rn_exit left = rn_client_fail(&err);
        if (code == RN_EXIT_OK) code = left;
    }
    return code;
}

const struct rn_verb rn_verbs_doctor[] = {
    {.name = "doctor",
     .arguments = "[SCENE]",
     .summary = "check the mathematics on this machine, and on a scene's cameras and parameters",
     .details =
         "Each case is a number against its bound: the largest error over fresh random inputs,\n"
         "measured with a higher precision, on every kernel set that this machine has. With\n"
         "SCENE, its last checkpoint and its cameras are fetched and some of its rays computed in\n"
         "float64 too. Needs no daemon without SCENE. Exit code 1 when a bound does not hold.",
     .args_max = 1,
     .table = doctor_table,
     .options_size = sizeof(struct doctor_options),
     .run = run_doctor},
    {0}};
