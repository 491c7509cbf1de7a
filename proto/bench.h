// What `ripnerf bench --json` prints: the runner's figures of this machine.
#ifndef RN_PROTO_BENCH_H
#define RN_PROTO_BENCH_H

#include <stdbool.h>

#include "proto/codec.h"

#define RN_BENCH_RECORD_ARRAYS 4

// As struct rn_bench_machine; NAN (null) is what the machine lacks.
struct rn_bench_machine_record {
    char cpu[128];
    int64_t cores;
    double load_average;
    double fma_gmacs, bf16_dot_gmacs, amx_bf16_gmacs, amx_bf16_l1_gmacs;
    double array_mb[RN_BENCH_RECORD_ARRAYS], random_line_ns[RN_BENCH_RECORD_ARRAYS];
    double stream_gbs[RN_BENCH_RECORD_ARRAYS];
};

struct rn_bench_stage_record {
    char name[32], unit[32];
    char limit[16];           // what sets the ceiling
    double operations, bytes; // a unit of work
    double ceiling, measured, ratio;
    double error; // of the check against float64
    bool passed;  // false: measured and ratio are null
};

struct rn_bench_step_record {
    double ms, samples, rays, samples_per_second_per_core;
    double ceiling_ms, ratio;
};

struct rn_bench_frame_record {
    int64_t width, height;
    double ms, samples;
};

struct rn_bench_record {
    struct rn_bench_machine_record machine;
    char kernels[32], preset[16];
    int64_t threads;
    struct rn_bench_stage_record *stages;
    size_t stage_count;
    struct rn_bench_step_record step;
    struct rn_bench_frame_record frame;
};

extern const struct rn_table rn_bench_table;

#endif
