// The machine's own figures, one thread.
#ifndef RN_ENGINE_BENCH_MACHINE_H
#define RN_ENGINE_BENCH_MACHINE_H

#include "server/engine/bench/bench.h"

// Calls work(context) at least three times and then until `seconds` have passed; returns the least
// seconds that one call took: on a shared machine the others waited.
double rn_bench_least(double seconds, void (*work)(void *context), void *context);

// Measures for about `seconds`. `kernels` names the set whose vectors count. What cannot be
// measured (no such unit, no memory) is NAN.
void rn_bench_machine_measure(const char *kernels, double seconds,
                              struct rn_bench_machine *ret_machine);

// Ways to use memory.
enum rn_bench_memory {
    RN_BENCH_LINES,  // 64-byte lines at random, addresses known ahead: ns a line
    RN_BENCH_STREAM, // reading in order: ns a byte
    RN_BENCH_UPDATE, // reading and writing back in order: ns a byte, each counted twice
};
// Measures a working set of `bytes` for `seconds`; NAN without that memory.
double rn_bench_memory_ns(enum rn_bench_memory kind, double bytes, double seconds);

#endif
