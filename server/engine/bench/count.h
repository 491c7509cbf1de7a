// What one unit of each stage's work takes at least: operations and bytes, counted from the
// configuration and the recording. The table is explained in cpu/README.md.
#ifndef RN_ENGINE_BENCH_COUNT_H
#define RN_ENGINE_BENCH_COUNT_H

#include "server/engine/bench/machine.h"
#include "server/engine/bench/stages.h"

struct rn_bench_count {
    double amount;               // units of work that one timed call does on one thread
    double operations;           // a unit: lane operations, a multiply-add is one
    double products;             // of these: multiply-adds of the networks
    double bytes;                // a unit: fewest to and from beyond the L2 cache; 0: none
    double lines;                // a unit, RN_BENCH_LINES: lines at random places
    enum rn_bench_memory memory; // how the bytes are visited
    double set_bytes;            // the memory that they lie in
};

// Units of work a second / 10^6 that the machine allows: arithmetic, the networks' at their unit's
// peak (AMX: with operands from L1) and the rest at machine->fma, or memory, measured for this set,
// whichever is slower, each as if alone. *ret_limit names it: "fma", "bf16 dot", "amx", "memory".
double rn_bench_ceiling(const struct rn_bench_count *count, enum rn_product_unit unit,
                        const struct rn_bench_machine *machine, const char **ret_limit);

struct rn_bench_count rn_bench_count_rays(const struct rn_bench_recording *recording, int rays);
struct rn_bench_count rn_bench_count_march(const struct rn_bench_recording *recording);
struct rn_bench_count rn_bench_count_encode(const struct rn_bench_recording *recording);
struct rn_bench_count rn_bench_count_forward(const struct rn_bench_recording *recording);
struct rn_bench_count rn_bench_count_composite(const struct rn_bench_recording *recording);
struct rn_bench_count rn_bench_count_backward(const struct rn_bench_recording *recording);
struct rn_bench_count rn_bench_count_scatter(const struct rn_bench_recording *recording);
// After the scatter, which marks what is touched.
struct rn_bench_count rn_bench_count_optimiser(const struct rn_bench_recording *recording);
struct rn_bench_count rn_bench_count_pyramid(const struct rn_bench_recording *recording);
struct rn_bench_count rn_bench_count_occupancy(const struct rn_bench_recording *recording);

#endif
