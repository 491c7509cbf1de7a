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

// Nanoseconds of one random line, and bytes a second of a stream, for a working set of `bytes`,
// between the measured sizes (logarithmically).
double rn_bench_line_ns(const struct rn_bench_machine *machine, double bytes);
double rn_bench_stream_gbs(const struct rn_bench_machine *machine, double bytes);

#endif
