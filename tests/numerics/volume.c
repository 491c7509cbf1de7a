// Case 5: density and compositing.
#include <string.h>

#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

#define MOST SUBJECT_MAX_SAMPLES

// exp has the condition number |x|: rounding x = logit - 1 alone costs |x| half units.
static int check_density(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "5 density, %s", s->name);
    struct numerics_case c = {
        name, "logits -1e4..1e4, infinite, NaN", "ULP per 1 + |logit - 1|", 1, 0, ""};
    const double corners[] = {-1e4,      -14, -13.999999, 0,         1,  16,
                              15.999999, 1e4, INFINITY,   -INFINITY, NAN};
    for (int n = 0; n < 11 + 40000; n++) {
        double logit = n < 11       ? corners[n]
                       : n % 5 == 0 ? numerics_uniform(random, -1e4, 1e4)
                                    : numerics_uniform(random, -17, 17);
        logit = s->nearest(logit);
        exact_reset();
        double clamped = logit > -14 ? fmin(logit, 16) : -14;
        exact x = minus(number(clamped), number(1));
        double error = exact_ulps(s->density(logit), exponential(x), s->digits);
        numerics_see(&c, error / (1 + fabs(rounded(x))), "logit %.17g", logit);
    }
    return numerics_close(&c);
}

static int check_alpha(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "5 opacity of one interval, %s", s->name);
    struct numerics_case c = {name, "optical depth 0, 1e-12..1e12", "ULP", 2, 0, ""};
    for (int n = 0; n < 40000; n++) {
        double x = n == 0 ? 0
                          : s->nearest(n % 2 ? numerics_spread(random, 1e-12, 1e12)
                                             : numerics_uniform(random, 0, 4));
        exact_reset();
        exact truth = negative(exponential_minus_1(number(-x)));
        numerics_see(&c, exact_ulps(s->alpha(x), truth, s->digits), "depth %.17g", x);
    }
    return numerics_close(&c);
}

// Optical depths of a ray of `n` samples, by kind.
#define KINDS 7
static const char *const kind_names[KINDS] = {"thin fog",   "opaque first sample", "wall and fog",
                                              "any depths", "uniform medium",      "empty",
                                              "thick"};
static void draw_depths(const struct subject *s, struct numerics_random *random, int kind, int n,
                        double *x) {
    for (int i = 0; i < n; i++) {
        double fog = numerics_spread(random, 1e-12, 1e-9);
        double all[KINDS] = {1e-12 * (1 + i % 3),
                             i == 0 ? 1e12 : fog,
                             i % 2 ? fog : 1e12 * fog,
                             numerics_spread(random, 1e-12, 1e12),
                             3.0 / n,
                             0,
                             numerics_spread(random, 1e-3, 30)};
        x[i] = s->nearest(all[kind]);
    }
}

static int draw_count(struct numerics_random *random, int trial) {
    static const int corners[] = {1, 2, 3, 64, 1000, MOST};
    return trial < 6 ? corners[trial] : (int)numerics_spread(random, 1, MOST + 1);
}

// What one ray's compositing is held against: exact weights and their errors.
struct truth {
    mpfr_t depth, carried, total;
};

// Weights (normal ones; fp32 above 1.25e-38, as the vector exponential ends at exp(-87.3)): error
// in ULP per 1 + S, the optical depth in front (the condition number of exp(-S)). Then the returned
// depth, the opacity, and the sum of the weights with the final transmittance, itself summed in
// float64 for floats and exactly for float64. Depths are summed in float64, but in a GPU's tile of
// 16, where a scan of four additions, the own depth and the rounding of the end are 2^-24 each: 3
// ULP.
static void see_composite(struct numerics_case cases[4], const struct subject *s, int n,
                          const double *x, const char *kind, struct truth *t) {
    static double weights[MOST], after[MOST];
    double depth = s->composite(n, x, weights, after), plain = 0;
    mpfr_set_zero(t->depth, 1);
    mpfr_set_zero(t->total, 1);
    for (int i = 0; i < n; i++) {
        exact_reset();
        exact weight =
            times(exponential(negative(t->depth)), negative(exponential_minus_1(number(-x[i]))));
        double front = rounded(t->depth);
        if (rounded(weight) > (s->digits == 24 ? 1.25e-38 : 0x1p-1022))
            numerics_see(&cases[0], exact_ulps(weights[i], weight, s->digits) / (1 + front),
                         "%s, sample %d of %d", kind, i, n);
        mpfr_add_d(t->depth, t->depth, x[i], MPFR_RNDN);
        mpfr_add_d(t->total, t->total, weights[i], MPFR_RNDN);
        plain += weights[i];
    }
    exact_reset();
    numerics_see(&cases[1], exact_ulps(depth, t->depth, s->digits), "%s, %d samples", kind, n);
    exact opacity = negative(exponential_minus_1(negative(t->depth)));
    double own = s->alpha(depth);
    if (!mpfr_zero_p(opacity))
        numerics_see(&cases[2], exact_distance(own, opacity) / rounded(opacity), "%s, %d samples",
                     kind, n);
    mpfr_add_d(t->total, t->total, after[n - 1], MPFR_RNDN);
    double sum = s->digits == 24 ? fabs(plain + after[n - 1] - 1) : exact_distance(1, t->total);
    numerics_see(&cases[3], sum / ldexp(1, 1 - s->digits), "%s, %d samples", kind, n);
}

static int check_composite(const struct subject *s, struct numerics_random *random) {
    const char *range = "1..4096 samples, depths 0, 1e-12..1e12; fog, walls, opaque first, empty";
    char names[4][80];
    static const char *const what[] = {"weights", "optical depth", "opacity of a ray",
                                       "weights and rest sum to 1"};
    struct numerics_case cases[4] = {{names[0], range, "ULP per 1 + depth in front", 3, 0, ""},
                                     {names[1], range, "ULP", 2, 0, ""},
                                     {names[2], range, "relative", 1e-6, 0, ""},
                                     {names[3], range, "ULP of 1", 4, 0, ""}};
    if (s->device) cases[1].bound = 3;
    if (s->digits == 53) cases[2].bound = 4e-16;
    for (int i = 0; i < 4; i++)
        snprintf(names[i], sizeof names[i], "5 compositing, %s, %s", what[i], s->name);
    static double x[MOST];
    struct truth truth;
    mpfr_inits2(EXACT_BITS, truth.depth, truth.total, (mpfr_ptr)0);
    for (int trial = 0; trial < 12; trial++)
        for (int kind = 0; kind < KINDS; kind++) {
            int n = draw_count(random, trial);
            draw_depths(s, random, kind, n, x);
            see_composite(cases, s, n, x, kind_names[kind], &truth);
        }
    mpfr_clears(truth.depth, truth.total, (mpfr_ptr)0);
    int failed = 0;
    for (int i = 0; i < 4; i++)
        failed += numerics_close(&cases[i]);
    return failed;
}

// dL/dx_i = T_{i+1} g_i - sum over j > i of w_j g_j, from the exact optical depths: the error
// relative to T_{i+1} |g_i| + sum of w_j |g_j|.
static void see_backward(struct numerics_case *c, const struct subject *s, int n, const double *x,
                         const double *g, const char *kind, struct truth *t) {
    static double weights[MOST], after[MOST], grad[MOST];
    s->composite(n, x, weights, after);
    s->composite_backward(n, weights, after, g, grad);
    mpfr_set_zero(t->depth, 1);
    for (int i = 0; i < n; i++)
        mpfr_add_d(t->depth, t->depth, x[i], MPFR_RNDN);
    mpfr_set_zero(t->total, 1);   // the suffix
    mpfr_set_zero(t->carried, 1); // and that of absolute values
    for (int i = n - 1; i >= 0; i--) {
        exact_reset();
        exact behind = exponential(negative(t->depth)), own = times(behind, number(g[i]));
        exact truth = minus(own, t->total), scale = plus(size_of(own), t->carried);
        if (rounded(scale) > 1e-30)
            numerics_see(c, exact_distance(grad[i], truth) / rounded(scale), "%s, sample %d of %d",
                         kind, i, n);
        mpfr_sub_d(t->depth, t->depth, x[i], MPFR_RNDN);
        exact weight =
            times(exponential(negative(t->depth)), negative(exponential_minus_1(number(-x[i]))));
        mpfr_add(t->total, t->total, times(weight, number(g[i])), MPFR_RNDN);
        mpfr_add(t->carried, t->carried, times(weight, number(fabs(g[i]))), MPFR_RNDN);
    }
}

static int check_backward(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "5 compositing backward, %s", s->name);
    struct numerics_case c = {name,
                              "1..4096 samples, depths 0, 1e-12..1e12, slopes -1..1",
                              "relative to its terms",
                              s->device         ? 2e-5 // a tile's depths are summed in fp32
                              : s->digits == 24 ? 1e-5
                                                : 1e-13,
                              0,
                              ""};
    static double x[MOST], g[MOST];
    struct truth truth;
    mpfr_inits2(EXACT_BITS, truth.depth, truth.carried, truth.total, (mpfr_ptr)0);
    for (int trial = 0; trial < 12; trial++)
        for (int kind = 0; kind < KINDS; kind++) {
            int n = draw_count(random, trial);
            draw_depths(s, random, kind, n, x);
            for (int i = 0; i < n; i++)
                g[i] = s->nearest(numerics_uniform(random, -1, 1));
            see_backward(&c, s, n, x, g, kind_names[kind], &truth);
        }
    mpfr_clears(truth.depth, truth.carried, truth.total, (mpfr_ptr)0);
    return numerics_close(&c);
}

// Weights of a ray that ends where the transmittance falls below `stop`: as the kernels do it, or
// cut off here.
static void stop_early(const struct subject *s, int n, const double *x, double stop,
                       const double *weights, const double *after, double *ret_stopped) {
    if (s->fast) {
        s->composite_stopped(n, x, -log(stop), ret_stopped);
        return;
    }
    for (int i = 0; i < n; i++)
        ret_stopped[i] = i > 0 && after[i - 1] < stop ? 0 : weights[i];
}

// Ending a ray where the transmittance falls below epsilon moves its colour over the background by
// at most epsilon (colours within [0, 1]); the error as a fraction of epsilon.
static int check_early_stop(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "5 early stop's error, %s", s->name);
    struct numerics_case c = {name, "epsilon 1e-6..1e-1, 1..4096 samples", "of epsilon", 1.00001, 0,
                              ""};
    static double x[MOST], weights[MOST], after[MOST], stopped[MOST];
    for (int trial = 0; trial < 300; trial++) {
        int n = draw_count(random, trial), kind = trial % KINDS;
        double stop = numerics_spread(random, 1e-6, 1e-1), background = trial % 2, error = 0;
        draw_depths(s, random, kind, n, x);
        s->composite(n, x, weights, after);
        stop_early(s, n, x, stop, weights, after, stopped);
        for (int i = 0; i < n; i++) { // the worst case: what is hidden differs from the background
            bool hidden = i > 0 && after[i - 1] < stop;
            double shade = hidden ? 1 - background : numerics_uniform(random, 0, 1);
            error += (weights[i] - stopped[i]) * (shade - background);
        }
        numerics_see(&c, fabs(error) / stop, "%s, epsilon %.3g, %d samples", kind_names[kind], stop,
                     n);
    }
    return numerics_close(&c);
}

int main(void) {
    const struct subject *s;
    struct numerics_random random = numerics_random();
    int failed = 0;
    for (int i = 0; (s = subject_at(i)); i++) {
        failed += check_density(s, &random);
        failed += check_alpha(s, &random);
        failed += check_composite(s, &random);
        failed += check_backward(s, &random);
        failed += check_early_stop(s, &random);
    }
    return failed > 0;
}
