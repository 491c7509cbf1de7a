// Numerics cases: the worst error over many inputs, held against a bound and printed as one line
//   CASE <tab> range <tab> bound <tab> worst <tab> where
// after a first line `seed N`. RN_NUMERICS_SEED repeats a run.
#ifndef RN_TESTS_SUPPORT_NUMERICS_H
#define RN_TESTS_SUPPORT_NUMERICS_H

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "common/math/rng.h"

// Thread-safety: one thread. Fill name, range, unit and bound; the rest starts as zero.
struct numerics_case {
    const char *name, *range;
    const char *unit; // of bound and worst: "ULP", "relative", ...
    double bound;     // INFINITY: shown for comparison only
    double worst;
    char where[160]; // the input of the worst error
};

// Records one input's error; NaN counts as the worst there is.
__attribute__((format(printf, 3, 4))) static inline void
numerics_see(struct numerics_case *c, double error, const char *where, ...) {
    if (isnan(error)) error = INFINITY;
    if (!(error > c->worst) && c->where[0]) return;
    c->worst = error;
    va_list args;
    va_start(args, where);
    vsnprintf(c->where, sizeof c->where, where, args);
    va_end(args);
}

// Prints the case; returns 1 when its bound does not hold or nothing was seen, else 0. With
// RN_NUMERICS_STOP set the first such case ends the program.
static inline int numerics_close(const struct numerics_case *c) {
    char bound[64] = "none, shown";
    if (isfinite(c->bound)) snprintf(bound, sizeof bound, "%.4g %s", c->bound, c->unit);
    printf("%s\t%s\t%s\t%.4g %s\t%s\n", c->name, c->range, bound, c->worst, c->unit, c->where);
    int failed = !(c->worst <= c->bound) || !c->where[0];
    if (failed)
        fprintf(stderr, "FAILED: %s: %.4g for %.4g, %s\n", c->name, c->worst, c->bound, c->where);
    if (failed && getenv("RN_NUMERICS_STOP")) exit(1);
    return failed;
}

// Names what this build or machine does not have, and why; neither passed nor failed:
//   CASE <tab> skipped <tab> reason
static inline void numerics_skip(const char *name, const char *reason) {
    printf("%s\tskipped\t%s\n", name, reason);
}

// Fresh random numbers. Thread-safety: one thread.
struct numerics_random {
    uint64_t seed, count;
};

// Seeded from RN_NUMERICS_SEED or the clock; prints the seed.
static inline struct numerics_random numerics_random(void) {
    const char *given = getenv("RN_NUMERICS_SEED");
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    uint64_t clock = (uint64_t)now.tv_sec * 1000003u + (uint64_t)now.tv_nsec;
    struct numerics_random random = {given ? strtoull(given, NULL, 10) : clock, 0};
    printf("seed %" PRIu64 "\n", random.seed);
    return random;
}

// Uniform in [low, high), 53 random bits.
static inline double numerics_uniform(struct numerics_random *random, double low, double high) {
    struct rn_rng4 draw = rn_rng_draw(random->seed, 0x6e756d, random->count++);
    uint64_t bits = ((uint64_t)draw.v[0] << 32 | draw.v[1]) >> 11;
    return low + (high - low) * ((double)bits * 0x1p-53);
}

// Uniform in the logarithm between two positive numbers.
static inline double numerics_spread(struct numerics_random *random, double low, double high) {
    return low * exp(numerics_uniform(random, 0, log(high / low)));
}

// A unit vector, uniform on the sphere, rounded.
static inline void numerics_direction(struct numerics_random *random, double d[3]) {
    double z = numerics_uniform(random, -1, 1), angle = numerics_uniform(random, 0, 2 * acos(-1));
    double ring = sqrt(1 - z * z);
    d[0] = ring * cos(angle);
    d[1] = ring * sin(angle);
    d[2] = z;
}

#endif
