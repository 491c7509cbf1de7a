// Formulas in 256-bit arithmetic (MPFR), written as expressions over temporaries that live until
// the next exact_reset().
#ifndef RN_TESTS_NUMERICS_EXACT_H
#define RN_TESTS_NUMERICS_EXACT_H

#include <mpfr.h>
#include <stdio.h>
#include <stdlib.h>

#define EXACT_BITS 256
#define EXACT_POOL 4096

typedef mpfr_ptr exact;

// Thread-safety: one thread, one translation unit.
static mpfr_t exact_pool[EXACT_POOL];
static int exact_made, exact_used;

static inline void exact_reset(void) {
    exact_used = 0;
}

static inline exact exact_new(void) {
    if (exact_used == EXACT_POOL) {
        fprintf(stderr, "more than %d temporaries between two resets\n", EXACT_POOL);
        abort();
    }
    if (exact_used == exact_made) mpfr_init2(exact_pool[exact_made++], EXACT_BITS);
    return exact_pool[exact_used++];
}

static inline exact number(double x) {
    exact out = exact_new();
    mpfr_set_d(out, x, MPFR_RNDN);
    return out;
}
// p / q, correctly rounded to 256 bits: decimals that float64 does not have.
static inline exact fraction(long p, unsigned long q) {
    exact out = exact_new();
    mpfr_set_si(out, p, MPFR_RNDN);
    mpfr_div_ui(out, out, q, MPFR_RNDN);
    return out;
}

#define EXACT_BINARY(name, function)                                                               \
    static inline exact name(exact a, exact b) {                                                   \
        exact out = exact_new();                                                                   \
        function(out, a, b, MPFR_RNDN);                                                            \
        return out;                                                                                \
    }
#define EXACT_UNARY(name, function)                                                                \
    static inline exact name(exact a) {                                                            \
        exact out = exact_new();                                                                   \
        function(out, a, MPFR_RNDN);                                                               \
        return out;                                                                                \
    }
EXACT_BINARY(plus, mpfr_add)
EXACT_BINARY(minus, mpfr_sub)
EXACT_BINARY(times, mpfr_mul)
EXACT_BINARY(over, mpfr_div)
EXACT_BINARY(power, mpfr_pow)
EXACT_BINARY(angle_of, mpfr_atan2)
EXACT_BINARY(smaller, mpfr_min)
EXACT_BINARY(larger, mpfr_max)
EXACT_UNARY(root, mpfr_sqrt)
EXACT_UNARY(exponential, mpfr_exp)
EXACT_UNARY(exponential_minus_1, mpfr_expm1)
EXACT_UNARY(logarithm_2, mpfr_log2)
EXACT_UNARY(tangent, mpfr_tan)
EXACT_UNARY(arc_tangent, mpfr_atan)
EXACT_UNARY(sine, mpfr_sin)
EXACT_UNARY(cosine, mpfr_cos)
EXACT_UNARY(negative, mpfr_neg)
EXACT_UNARY(size_of, mpfr_abs)

static inline exact exact_pi(void) {
    exact out = exact_new();
    mpfr_const_pi(out, MPFR_RNDN);
    return out;
}
static inline exact square(exact a) {
    return times(a, a);
}
static inline double rounded(exact a) {
    return mpfr_get_d(a, MPFR_RNDN);
}
// |got - truth|, rounded; NaN stays NaN.
static inline double exact_distance(double got, exact truth) {
    return rounded(size_of(minus(number(got), truth)));
}

// Error of `got` in units of the last place of `truth` in a format of 53 (float64) or 24 (float)
// bits. Below the smallest normal number a unit is the smallest denormal.
static inline double exact_ulps(double got, exact truth, int digits) {
    long smallest = digits == 24 ? -149 : -1074;
    long unit = mpfr_zero_p(truth) ? smallest : (long)mpfr_get_exp(truth) - digits;
    if (unit < smallest) unit = smallest;
    exact error = size_of(minus(number(got), truth));
    mpfr_mul_2si(error, error, -unit, MPFR_RNDN);
    return rounded(error);
}

#endif
