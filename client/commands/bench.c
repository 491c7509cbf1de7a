// bench: what this machine can do, and what the engine makes of it. Needs no daemon.

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/local.h"
#include "client/table.h"
#include "common/settings/train.h"
#include "proto/bench.h"

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
     .choices = rn_preset_names},
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
    rn_text_table_init(&table,
                       "stage|unit|>operations|>bytes|limit|>ceiling|>measured|>ratio|>error");
    for (size_t i = 0; i < record->stage_count; i++) {
        const struct rn_bench_stage_record *s = &record->stages[i];
        if (!s->passed) {
            rn_text_table_row(&table, "%s|%s||||||check failed|%.1e", s->name, s->unit, s->error);
            continue;
        }
        rn_text_table_row(&table, "%s|%s|%s|%s|%s|%s|%s|%.0f %%|%.0e", s->name, s->unit,
                          figure(s->operations, a), figure(s->bytes, b), s->limit,
                          figure(s->ceiling, c), figure(s->measured, d), 100 * s->ratio, s->error);
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
    const struct bench_options *options = context;
    char threads[24], seconds[32];
    const char *argv[12] = {NULL, "--mode", "bench", "--threads", threads, "--seconds", seconds};
    int n = 7;
    snprintf(threads, sizeof threads, "%lld", (long long)rn_int_or(options->threads, 0));
    snprintf(seconds, sizeof seconds, "%.17g", rn_number_or(options->seconds, 10));
    if (options->preset) argv[n++] = "--preset", argv[n++] = options->preset;
    if (options->kernels) argv[n++] = "--kernels", argv[n++] = options->kernels;
    struct rn_buf report;
    enum rn_exit code = rn_local_run(argv, client->json, &report), shown = RN_EXIT_OK;
    if (report.size > 0) shown = show(client, &report);
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
