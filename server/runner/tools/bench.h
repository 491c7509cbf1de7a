// The runner's bench mode: no connection, no scene; figures of this machine on standard output.
#ifndef RN_SERVER_RUNNER_TOOLS_BENCH_H
#define RN_SERVER_RUNNER_TOOLS_BENCH_H

#include "server/engine/bench/bench.h"

// Prints one JSON object (proto/bench.h) on stdout, what is under way and errors on stderr.
// Returns an exit code: 0, 1 when something failed, a check included, 2 for a wrong option.
int rn_runner_bench(const struct rn_bench_options *options);

#endif
