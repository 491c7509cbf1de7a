// bench: what this machine can do, and what the engine makes of it. Needs no daemon.

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include "client/client.h"
#include "client/table.h"
#include "common/base/buf.h"
#include "proto/bench.h"

extern char **environ;

#define REPORT_MAX (1 << 20)

struct bench_options {
    const char *preset, *kernels;
    int64_t threads;
    double seconds;
};
#define BENCH(m) .offset = offsetof(struct bench_options, m)
static const struct rn_option bench_table[] = {
    {.name = "preset",
     .kind = RN_OPTION_CHOICE,
     BENCH(preset),
     .value = "NAME",
     .help = "the field that is measured: draft, standard (default), paper",
     .choices = "draft|standard|paper"},
    {.name = "kernels",
     .kind = RN_OPTION_TEXT,
     BENCH(kernels),
     .value = "SET",
     .help = "the kernel set; else the fastest of this machine"},
    {.name = "threads",
     .kind = RN_OPTION_INTEGER,
     BENCH(threads),
     .value = "N",
     .help = "of the whole step and the frame; else all cores",
     .min = 1,
     .max = 1024},
    {.name = "seconds",
     .kind = RN_OPTION_SECONDS,
     BENCH(seconds),
     .value = "S",
     .help = "about how long it may take (10)",
     .min = 0.5,
     .max = 3600},
    {0}};

// The runner lies where the daemon looks for it: beside the programs of a build, or installed.
static enum rn_status find_runner(char ret_path[PATH_MAX], struct rn_error *err) {
    static const char *const places[] = {"../server/ripnerf-runner", "ripnerf-runner",
                                         "../libexec/ripnerf/ripnerf-runner"};
    char folder[PATH_MAX];
    ssize_t size = readlink("/proc/self/exe", folder, sizeof folder - 1);
    if (size <= 0) return rn_error_from_errno(err, errno, "/proc/self/exe", "reading");
    folder[size] = '\0';
    dirname(folder);
    for (size_t i = 0; i < sizeof places / sizeof *places; i++)
        if (snprintf(ret_path, PATH_MAX, "%s/%s", folder, places[i]) < PATH_MAX &&
            access(ret_path, X_OK) == 0)
            return RN_OK;
    return rn_error_set(err, RN_ERROR_NOT_FOUND, "ripnerf-runner",
                        "is neither beside ripnerf nor in ../server or ../libexec/ripnerf");
}

// Starts the runner with its standard output in a pipe.
static enum rn_status start(const char *runner, const struct bench_options *options, pid_t *ret_pid,
                            int *ret_fd, struct rn_error *err) {
    char threads[24], seconds[32];
    const char *argv[12] = {runner, "--mode", "bench", "--threads", threads, "--seconds", seconds};
    int n = 7, ends[2];
    posix_spawn_file_actions_t actions;
    snprintf(threads, sizeof threads, "%lld",
             options->threads == RN_OPTION_ABSENT ? 0LL : (long long)options->threads);
    snprintf(seconds, sizeof seconds, "%.17g", rn_number_or(options->seconds, 10));
    if (options->preset) argv[n++] = "--preset", argv[n++] = options->preset;
    if (options->kernels) argv[n++] = "--kernels", argv[n++] = options->kernels;
    if (pipe2(ends, O_CLOEXEC) != 0)
        return rn_error_from_errno(err, errno, runner, "making a pipe");
    posix_spawn_file_actions_init(&actions);
    int errnum = posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    if (errnum == 0)
        errnum = posix_spawn(ret_pid, runner, &actions, NULL, (char *const *)argv, environ);
    posix_spawn_file_actions_destroy(&actions);
    close(ends[1]);
    if (errnum != 0) {
        close(ends[0]);
        return rn_error_from_errno(err, errnum, runner, "starting");
    }
    *ret_fd = ends[0];
    return RN_OK;
}

static enum rn_status read_all(int fd, struct rn_buf *report, struct rn_error *err) {
    char part[4096];
    ssize_t size;
    while ((size = read(fd, part, sizeof part)) != 0) {
        if (size < 0 && errno == EINTR) continue;
        if (size < 0) return rn_error_from_errno(err, errno, "ripnerf-runner", "reading");
        rn_buf_append(report, part, (size_t)size);
    }
    if (report->failed) return rn_error_set(err, RN_ERROR_LIMIT, "ripnerf-runner", "says too much");
    return RN_OK;
}

static enum rn_exit wait_for(pid_t pid) {
    int status = 0;
    while (waitpid(pid, &status, 0) < 0)
        if (errno != EINTR) return RN_EXIT_FAILED;
    if (!WIFEXITED(status)) {
        fprintf(stderr, "ripnerf: ripnerf-runner was killed by signal %d\n", WTERMSIG(status));
        return RN_EXIT_FAILED;
    }
    return WEXITSTATUS(status) == 0   ? RN_EXIT_OK
           : WEXITSTATUS(status) == 2 ? RN_EXIT_USAGE
                                      : RN_EXIT_FAILED;
}

// ---- table ----

// A figure with three digits; "-" where there is none.
static const char *figure(double value, char text[24]) {
    if (isnan(value))
        snprintf(text, 24, "-");
    else
        snprintf(text, 24, value < 10 ? "%.2f" : value < 100 ? "%.1f" : "%.0f", value);
    return text;
}

static void print_machine(const struct rn_bench_record *record) {
    const struct rn_bench_machine_record *m = &record->machine;
    char a[24], b[24], c[24], d[24];
    printf("%s, %lld cores, load average %s when it began\n", m->cpu, (long long)m->cores,
           figure(m->load_average, a));
    printf("kernels %s, preset %s, %lld threads\n\n", record->kernels, record->preset,
           (long long)record->threads);
    printf(
        "one thread, 10^9 multiply-adds/s: fp32 %s, bf16 dot %s, AMX bf16 %s, AMX from L1 %s\n\n",
        figure(m->fma_gmacs, a), figure(m->bf16_dot_gmacs, b), figure(m->amx_bf16_gmacs, c),
        figure(m->amx_bf16_l1_gmacs, d));
}

static enum rn_status print_memory(const struct rn_bench_machine_record *m, struct rn_error *err) {
    struct rn_text_table table;
    char a[24], b[24];
    rn_text_table_init(&table, ">array MB|>random line ns|>stream GB/s");
    for (int i = 0; i < RN_BENCH_RECORD_ARRAYS; i++)
        rn_text_table_row(&table, "%.0f|%s|%s", m->array_mb[i], figure(m->random_line_ns[i], a),
                          figure(m->stream_gbs[i], b));
    enum rn_status status = rn_text_table_print(&table, err);
    rn_text_table_finish(&table);
    return status;
}

static enum rn_status print_stages(const struct rn_bench_record *record, struct rn_error *err) {
    struct rn_text_table table;
    char a[24], b[24], c[24], d[24];
    rn_text_table_init(&table, "stage|unit|>operations|>bytes|>ceiling|>measured|>ratio|>error");
    for (size_t i = 0; i < record->stage_count; i++) {
        const struct rn_bench_stage_record *s = &record->stages[i];
        if (!s->passed) {
            rn_text_table_row(&table, "%s|%s|||||check failed|%.1e", s->name, s->unit, s->error);
            continue;
        }
        rn_text_table_row(&table, "%s|%s|%s|%s|%s|%s|%.0f %%|%.0e", s->name, s->unit,
                          figure(s->operations, a), figure(s->bytes, b), figure(s->ceiling, c),
                          figure(s->measured, d), 100 * s->ratio, s->error);
    }
    enum rn_status status = rn_text_table_print(&table, err);
    rn_text_table_finish(&table);
    return status;
}

static enum rn_status print_report(const struct rn_bench_record *record, struct rn_error *err) {
    print_machine(record);
    enum rn_status status = print_memory(&record->machine, err);
    putchar('\n');
    if (status == RN_OK) status = print_stages(record, err);
    printf("\nstep   %.1f ms, %.0f samples of %.0f rays: %.2f M samples/s and core\n",
           record->step.ms, record->step.samples, record->step.rays,
           record->step.samples_per_second_per_core * 1e-6);
    printf("       all stages at their ceilings: %.2f ms, of which it reaches %.0f %%\n",
           record->step.ceiling_ms, 100 * record->step.ratio);
    printf("frame  %lldx%lld in %.1f ms, %.0f samples\n", (long long)record->frame.width,
           (long long)record->frame.height, record->frame.ms, record->frame.samples);
    return status;
}

static enum rn_exit show(const struct rn_client *client, struct rn_buf *report) {
    struct rn_bench_record record;
    struct rn_error err = {0};
    if (client->json) return fputs((char *)report->data, stdout) < 0 ? RN_EXIT_FAILED : RN_EXIT_OK;
    enum rn_status status =
        rn_decode(&rn_bench_table, (char *)report->data, report->size, &record, NULL, &err);
    if (status != RN_OK) return rn_client_fail(&err);
    status = print_report(&record, &err);
    rn_message_finish(&rn_bench_table, &record);
    return status == RN_OK ? RN_EXIT_OK : rn_client_fail(&err);
}

static enum rn_exit run_bench(struct rn_client *client, const void *context, const char **args) {
    char runner[PATH_MAX];
    struct rn_error err = {0};
    struct rn_buf report;
    pid_t pid = 0;
    int fd = -1;
    enum rn_status status = find_runner(runner, &err);
    if (status == RN_OK) status = start(runner, context, &pid, &fd, &err);
    if (status != RN_OK) return rn_client_fail(&err);
    rn_buf_init(&report, REPORT_MAX);
    status = read_all(fd, &report, &err);
    close(fd);
    enum rn_exit code = wait_for(pid), shown = RN_EXIT_OK;
    if (status != RN_OK)
        shown = rn_client_fail(&err);
    else if (report.size > 0)
        shown = show(client, &report);
    rn_buf_finish(&report);
    return code != RN_EXIT_OK ? code : shown;
}

const struct rn_verb rn_verbs_bench[] = {
    {.name = "bench",
     .arguments = "",
     .summary = "measure this machine and each stage of the engine; needs no daemon",
     .details =
         "Each stage is checked against float64, then timed on one thread. Its ceiling is what\n"
         "its operations and fewest bytes allow on this machine (server/engine/cpu/README.md).",
     .table = bench_table,
     .options_size = sizeof(struct bench_options),
     .local = true,
     .run = run_bench},
    {0}};
