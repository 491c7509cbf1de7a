// Case 1: the Gaussian of a conical frustum against the exact moments of the frustum as
// represented (middle, width, cone radius), and what forms from end points lose on the same inputs.
#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

// From the end points in exact arithmetic: E[t] and E[t^2] under a density proportional to t^2.
static void exact_moments(double mid, double width, double radius, exact ret[3]) {
    exact half = over(number(width), number(2)), m = number(mid), r2 = square(number(radius));
    if (width == 0) {
        ret[0] = m;
        ret[1] = number(0);
        ret[2] = over(times(r2, square(m)), number(4));
        return;
    }
    exact a = minus(m, half), b = plus(m, half), a3 = times(square(a), a), b3 = times(square(b), b);
    exact d3 = minus(b3, a3), d4 = minus(times(b3, b), times(a3, a));
    exact d5 = minus(times(b3, square(b)), times(a3, square(a)));
    exact mean_square = times(fraction(3, 5), over(d5, d3));
    ret[0] = times(fraction(3, 4), over(d4, d3));
    ret[1] = minus(mean_square, square(ret[0]));
    ret[2] = over(times(r2, mean_square), number(4));
}

static const char *const quantities[] = {"mean", "axial variance", "radial variance"};

typedef void (*moments_form)(double mid, double width, double radius, double ret[3]);

// Bounded cases count ULPs, shown ones the relative error.
static void see(struct numerics_case cases[3], const struct subject *s, double mid, double width,
                double radius, moments_form form) {
    double got[3];
    exact truth[3];
    form(mid, width, radius, got);
    exact_reset();
    exact_moments(mid, width, radius, truth);
    for (int i = 0; i < 3; i++) {
        double error = isfinite(cases[i].bound)
                           ? exact_ulps(got[i], truth[i], s->digits)
                           : exact_distance(got[i], truth[i]) / rounded(truth[i]);
        numerics_see(&cases[i], error, "t %.9g, width %.9g, radius %.9g", mid, width, radius);
    }
}

static int close_three(const struct numerics_case cases[3]) {
    int failed = 0;
    for (int i = 0; i < 3; i++)
        failed += numerics_close(&cases[i]);
    return failed;
}

static int check_moments(const struct subject *s, struct numerics_random *random) {
    static const double mids[] = {1e-6, 1e-3, 0.3, 1, 4, 100, 131072, 1e7};
    static const double ratios[] = {0, 1e-7, 1e-3, 0.5, 1, 1.5, 2};
    char names[3][80];
    struct numerics_case cases[3];
    for (int i = 0; i < 3; i++) {
        snprintf(names[i], sizeof names[i], "1 frustum %s, %s", quantities[i], s->name);
        cases[i] =
            (struct numerics_case){names[i], "t 1e-6..1e7, width/t 0 and 1e-7..2, radius 1e-6..1",
                                   "ULP",    s->digits == 24 ? 8 : 1,
                                   0,        ""};
    }
    for (int n = 0; n < 8 * 7 + 20000; n++) {
        bool corner = n < 56;
        double mid = s->nearest(corner ? mids[n / 7] : numerics_spread(random, 1e-6, 1e7));
        double ratio = corner ? ratios[n % 7] : numerics_spread(random, 1e-7, 2);
        double radius = s->nearest(corner ? 5e-4 : numerics_spread(random, 1e-6, 1));
        double width = fmin(s->nearest(mid * ratio), 2 * mid);
        see(cases, s, mid, width, radius, s->moments);
    }
    return close_three(cases);
}

// What a form from end points loses, over `low`..`high` of width/t.
static void show_form(const struct subject *s, struct numerics_random *random, const char *name,
                      moments_form form, double low, double high) {
    char names[3][80], range[80];
    struct numerics_case cases[3];
    snprintf(range, sizeof range, "t 1e-3..1e3, width/t %g..%g", low, high);
    for (int i = 0; i < 3; i++) {
        snprintf(names[i], sizeof names[i], "1 frustum %s, %s, %s", quantities[i], name, s->name);
        cases[i] = (struct numerics_case){names[i], range, "relative", INFINITY, 0, ""};
    }
    for (int n = 0; n < 2000; n++) {
        double mid = s->nearest(numerics_spread(random, 1e-3, 1e3));
        double width = s->nearest(mid * numerics_spread(random, low, high));
        see(cases, s, mid, width, s->nearest(5e-4), form);
    }
    close_three(cases);
}

int main(void) {
    static const double bands[4] = {1e-6, 1e-4, 1e-2, 1};
    const struct subject *s;
    struct numerics_random random = numerics_random();
    int failed = 0;
    for (int i = 0; (s = subject_at(i)); i++)
        failed += check_moments(s, &random);
    for (int i = 0; (s = subject_at(i)) && !s->fast; i++)
        for (int b = 0; b < 3; b++) {
            show_form(s, &random, "powers of end points", s->moments_powers, bands[b],
                      bands[b + 1]);
            show_form(s, &random, "mip-NeRF from end points", s->moments_mipnerf, bands[b],
                      bands[b + 1]);
            show_form(s, &random, "this form", s->moments, bands[b], bands[b + 1]);
        }
    return failed > 0;
}
