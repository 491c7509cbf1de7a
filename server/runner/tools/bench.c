#include "server/runner/tools/bench.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/bench.h"

_Static_assert(RN_BENCH_ARRAYS == RN_BENCH_RECORD_ARRAYS, "memory figures");

static void say(const char *what) {
    fprintf(stderr, "bench: %s\n", what);
}

static void fill_machine(const struct rn_bench_machine *m, struct rn_bench_machine_record *ret) {
    ret->cores = m->cores;
    ret->load_average = m->load;
    ret->fma_gmacs = m->fma;
    ret->bf16_dot_gmacs = m->bf16_dot;
    ret->amx_bf16_gmacs = m->amx_bf16;
    ret->amx_bf16_l1_gmacs = m->amx_bf16_l1;
    snprintf(ret->cpu, sizeof ret->cpu, "%s", m->cpu);
    memcpy(ret->array_mb, m->array_mb, sizeof ret->array_mb);
    memcpy(ret->random_line_ns, m->random_line_ns, sizeof ret->random_line_ns);
    memcpy(ret->stream_gbs, m->stream_gbs, sizeof ret->stream_gbs);
}

static void fill_stage(const struct rn_bench_stage *s, struct rn_bench_stage_record *ret) {
    *ret = (struct rn_bench_stage_record){.operations = s->operations,
                                          .bytes = s->bytes,
                                          .ceiling = s->ceiling,
                                          .measured = s->measured,
                                          .ratio = s->ratio,
                                          .error = s->error,
                                          .passed = s->passed};
    snprintf(ret->name, sizeof ret->name, "%s", s->name);
    snprintf(ret->unit, sizeof ret->unit, "%s", s->unit);
    snprintf(ret->limit, sizeof ret->limit, "%s", s->limit);
}

static enum rn_status fill(const struct rn_bench_result *r, struct rn_bench_record *ret,
                           struct rn_error *err) {
    rn_message_init(&rn_bench_table, ret);
    ret->stages = calloc((size_t)r->stage_count, sizeof *ret->stages);
    if (!ret->stages) return rn_error_set(err, RN_ERROR_NO_MEMORY, "bench", "out of memory");
    ret->stage_count = (size_t)r->stage_count;
    for (int i = 0; i < r->stage_count; i++)
        fill_stage(&r->stages[i], &ret->stages[i]);
    fill_machine(&r->machine, &ret->machine);
    snprintf(ret->kernels, sizeof ret->kernels, "%s", r->kernels);
    snprintf(ret->preset, sizeof ret->preset, "%s", r->preset);
    ret->threads = r->threads;
    ret->step = (struct rn_bench_step_record){.ms = r->step.ms,
                                              .samples = r->step.samples,
                                              .rays = r->step.rays,
                                              .samples_per_second_per_core =
                                                  r->step.samples_per_second_per_core,
                                              .ceiling_ms = r->step.ceiling_ms,
                                              .ratio = r->step.ratio};
    ret->frame = (struct rn_bench_frame_record){r->frame.width, r->frame.height, r->frame.ms,
                                                r->frame.samples};
    return RN_OK;
}

static bool all_passed(const struct rn_bench_result *r) {
    for (int i = 0; i < r->stage_count; i++)
        if (!r->stages[i].passed) return false;
    return true;
}

int rn_runner_bench(const struct rn_bench_options *options) {
    struct rn_bench_result result;
    struct rn_bench_record record;
    struct rn_error err = {0};
    char *json = NULL;
    enum rn_status status = rn_bench_run(options, say, &result, &err);
    if (status == RN_OK) {
        status = fill(&result, &record, &err);
        if (status == RN_OK) status = rn_encode(&rn_bench_table, &record, &json, NULL, &err);
        rn_message_finish(&rn_bench_table, &record);
    }
    if (status != RN_OK) {
        fprintf(stderr, "ripnerf-runner: %s: %s\n", err.where, err.text);
        return status == RN_ERROR_INVALID || status == RN_ERROR_UNSUPPORTED ? 2 : 1;
    }
    bool written = puts(json) >= 0 && fflush(stdout) == 0;
    free(json);
    return written && all_passed(&result) ? 0 : 1;
}
