// What the tools share that train a procedural scene once for each footprint and look at it.
#ifndef RN_TESTS_BENCH_FOOTPRINTS_H
#define RN_TESTS_BENCH_FOOTPRINTS_H

#include "common/image/image.h"
#include "server/engine/engine.h"

struct bench_training {
    const char *preset;
    struct rn_dataset *dataset;
    struct rn_engine *engine;
    double seconds;
    int64_t steps; // 0: by the time
    uint64_t seed;
    int threads;
};

// Says what went wrong and exits with 1.
_Noreturn void bench_die(const struct rn_error *err);
// time=, steps=, preset=, seed= and threads=: whether it is one of them.
bool bench_set_option(struct bench_training *training, const char *name, const char *value);
// Trains with that footprint, which stays; without `effects` nothing else is switched off either.
struct rn_field *bench_train(const struct bench_training *training, enum rn_footprint footprint,
                             bool effects, struct rn_progress *ret_progress);
// Mean absolute difference of two pictures of one size.
double bench_difference(const struct rn_picture *a, const struct rn_picture *b);
// Of a rendered picture: values beyond [0, 1] are cut.
void bench_clamp(struct rn_picture *picture);

#endif
