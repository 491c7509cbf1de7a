#include "proto/bench.h"

#define MOST 1e15

static const struct rn_field_spec machine_fields[] = {
    RN_F_TEXT(struct rn_bench_machine_record, cpu, RN_REQUIRED, NULL),
    RN_F_INT(struct rn_bench_machine_record, cores, RN_REQUIRED, 1, 1e6),
    RN_F_NUMBER(struct rn_bench_machine_record, load_average, RN_REQUIRED | RN_NULLABLE, 0, MOST),
    RN_F_NUMBER(struct rn_bench_machine_record, fma_gmacs, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_machine_record, bf16_dot_gmacs, RN_REQUIRED | RN_NULLABLE, 0, MOST),
    RN_F_NUMBER(struct rn_bench_machine_record, amx_bf16_gmacs, RN_REQUIRED | RN_NULLABLE, 0, MOST),
    RN_F_NUMBER(struct rn_bench_machine_record, amx_bf16_l1_gmacs, RN_REQUIRED | RN_NULLABLE, 0,
                MOST),
    RN_F_NUMBERS(struct rn_bench_machine_record, array_mb, RN_REQUIRED, 0, MOST),
    RN_F_NUMBERS(struct rn_bench_machine_record, random_line_ns, RN_REQUIRED, 0, MOST),
    RN_F_NUMBERS(struct rn_bench_machine_record, stream_gbs, RN_REQUIRED, 0, MOST)};
static const struct rn_table machine_table =
    RN_TABLE(struct rn_bench_machine_record, "machine", machine_fields);

static const struct rn_field_spec stage_fields[] = {
    RN_F_TEXT(struct rn_bench_stage_record, name, RN_REQUIRED, NULL),
    RN_F_TEXT(struct rn_bench_stage_record, unit, RN_REQUIRED, NULL),
    RN_F_NUMBER(struct rn_bench_stage_record, operations, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_stage_record, bytes, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_stage_record, ceiling, RN_REQUIRED, 0, MOST),
    RN_F_TEXT(struct rn_bench_stage_record, limit, RN_REQUIRED, NULL),
    RN_F_NUMBER(struct rn_bench_stage_record, measured, RN_REQUIRED | RN_NULLABLE, 0, MOST),
    RN_F_NUMBER(struct rn_bench_stage_record, ratio, RN_REQUIRED | RN_NULLABLE, 0, MOST),
    RN_F_NUMBER(struct rn_bench_stage_record, error, RN_REQUIRED | RN_NULLABLE, 0, MOST),
    RN_F_BOOL(struct rn_bench_stage_record, passed, RN_REQUIRED)};
static const struct rn_table stage_table =
    RN_TABLE(struct rn_bench_stage_record, "stage", stage_fields);

static const struct rn_field_spec step_fields[] = {
    RN_F_NUMBER(struct rn_bench_step_record, ms, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_step_record, samples, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_step_record, rays, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_step_record, samples_per_second_per_core, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_step_record, ceiling_ms, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_step_record, ratio, RN_REQUIRED, 0, MOST)};
static const struct rn_table step_table =
    RN_TABLE(struct rn_bench_step_record, "step", step_fields);

static const struct rn_field_spec frame_fields[] = {
    RN_F_INT(struct rn_bench_frame_record, width, RN_REQUIRED, 1, 1e6),
    RN_F_INT(struct rn_bench_frame_record, height, RN_REQUIRED, 1, 1e6),
    RN_F_NUMBER(struct rn_bench_frame_record, ms, RN_REQUIRED, 0, MOST),
    RN_F_NUMBER(struct rn_bench_frame_record, samples, RN_REQUIRED, 0, MOST)};
static const struct rn_table frame_table =
    RN_TABLE(struct rn_bench_frame_record, "frame", frame_fields);

static const struct rn_field_spec bench_fields[] = {
    RN_F_OBJECT(struct rn_bench_record, machine, RN_REQUIRED, &machine_table),
    RN_F_TEXT(struct rn_bench_record, kernels, RN_REQUIRED, NULL),
    RN_F_TEXT(struct rn_bench_record, preset, RN_REQUIRED, NULL),
    RN_F_INT(struct rn_bench_record, threads, RN_REQUIRED, 1, 1e6),
    RN_F_OBJECTS(struct rn_bench_record, stages, stage_count, RN_REQUIRED, &stage_table, 64),
    RN_F_OBJECT(struct rn_bench_record, step, RN_REQUIRED, &step_table),
    RN_F_OBJECT(struct rn_bench_record, frame, RN_REQUIRED, &frame_table)};
const struct rn_table rn_bench_table = RN_TABLE(struct rn_bench_record, "bench", bench_fields);
