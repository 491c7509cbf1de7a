// What this machine can do, and which share of it each stage of the engine reaches.
//
// Every stage has a ceiling: the operations and the fewest bytes of one unit of its work, counted
// from the configuration and from recorded inputs, over the machine's measured figures. Stages run
// on one thread; a step and a frame on all of them. Each stage is checked against float64 before
// it is timed.
#ifndef RN_ENGINE_BENCH_BENCH_H
#define RN_ENGINE_BENCH_BENCH_H

#include <stdbool.h>

#include "common/base/status.h"

struct rn_bench_options {
    const char *preset;  // NULL = "standard"
    const char *kernels; // as rn_engine_options
    int threads;
    double seconds; // about how long all of it may take, 0.5 to 3600
};

#define RN_BENCH_ARRAYS 4 // array sizes that memory is measured with

// Of one thread, while `load` others ran. GMAC/s: 10^9 multiply-adds a second. What this machine
// lacks is NAN.
struct rn_bench_machine {
    char cpu[128];
    int cores;
    double load;                            // load average of the last minute, at the start
    double fma;                             // fp32, in the vectors of the kernel set: GMAC/s
    double bf16_dot;                        // VDPBF16PS: GMAC/s
    double amx_bf16, amx_bf16_l1;           // tiles in registers, tiles loaded from L1: GMAC/s
    double array_mb[RN_BENCH_ARRAYS];       // 2^20 bytes
    double random_line_ns[RN_BENCH_ARRAYS]; // one 64-byte line at random, addresses known ahead
    double stream_gbs[RN_BENCH_ARRAYS];     // reading in order, 10^9 bytes a second
};

struct rn_bench_stage {
    const char *name;
    const char *unit;  // "Msamples/s", ...
    double operations; // a unit of work: vector lane operations, a multiply-add is one
    double bytes;      // a unit of work: fewest to and from beyond the L2 cache
    double ceiling;    // of `measured`, units as `unit`
    const char *limit; // what sets it: "fma", "bf16 dot", "amx", "memory"
    double measured;   // best of several; NAN when the check failed
    double ratio;      // measured / ceiling
    double error;      // of the check: largest difference over the largest magnitude, or of norms
    bool passed;       // the check
};

#define RN_BENCH_STAGES 10
struct rn_bench_result {
    char kernels[32], preset[16];
    int threads;
    struct rn_bench_machine machine;
    int stage_count;
    struct rn_bench_stage stages[RN_BENCH_STAGES];
    struct {
        double ms, samples, rays, samples_per_second_per_core;
        double ceiling_ms; // all stages at their ceilings, one after the other, on all threads
        double ratio;      // ceiling_ms / ms
    } step; // means over whole training steps, occupancy updates included; samples enter the loss
    struct {
        int width, height; // 400 a side; 200, 100 or 50 where that takes long
        double ms, samples;
    } frame;
};

// Runs everything on a procedural scene in a temporary folder, which it removes. Says on
// `progress` (may be NULL) what begins. RN_ERROR_INVALID, RN_ERROR_UNSUPPORTED (kernels), errors of
// the temporary folder, RN_ERROR_NO_MEMORY. A failed check is no error: see `passed`.
enum rn_status rn_bench_run(const struct rn_bench_options *options,
                            void (*progress)(const char *what), struct rn_bench_result *ret_result,
                            struct rn_error *err) RN_MUST_CHECK;

#endif
