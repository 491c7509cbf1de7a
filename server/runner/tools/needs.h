// The runner's needs mode: no connection; what a runner of a scene takes of a machine, before one
// is asked for.
#ifndef RN_SERVER_RUNNER_TOOLS_NEEDS_H
#define RN_SERVER_RUNNER_TOOLS_NEEDS_H

#include <stdbool.h>

struct rn_runner_needs {
    const char *dataset, *scene; // folders
    const char *train;           // options of a training, JSON; NULL: of pictures alone
    int threads;                 // 0 = all
    bool sandbox;
};

// Prints "memory_bytes N gpus N" on stdout, errors on stderr; gpus is -1 where the training takes
// one if there is one. Returns an exit code.
int rn_runner_needs(const struct rn_runner_needs *options);

#endif
