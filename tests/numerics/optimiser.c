// Case 8: AdamW (Loshchilov & Hutter 2019) with betas of 9/10 and 999/1000.
#include "server/engine/reference/reference.h"
#include "tests/numerics/exact.h"
#include "tests/support/numerics.h"

struct state {
    double parameter, m, v;
};

// One step in exact arithmetic from the state as represented: moments and the update.
static void exact_step(const struct state *s, double g, double rate, double decay, double eps,
                       int64_t step, exact ret_moments[2], exact *ret_update) {
    exact t = number((double)step), one = number(1);
    ret_moments[0] = plus(times(fraction(9, 10), number(s->m)), times(fraction(1, 10), number(g)));
    ret_moments[1] =
        plus(times(fraction(999, 1000), number(s->v)), times(fraction(1, 1000), square(number(g))));
    exact mean = over(ret_moments[0], minus(one, power(fraction(9, 10), t)));
    exact size = root(over(ret_moments[1], minus(one, power(fraction(999, 1000), t))));
    *ret_update = times(number(rate), plus(times(number(decay), number(s->parameter)),
                                           over(mean, plus(size, number(eps)))));
}

// Single steps from random states. The first moment may cancel: its error counts relative to its
// terms, and that of the update relative to its terms too.
static int check_steps(struct numerics_random *random) {
    const char *range = "steps 1..1e7, gradients 0 and 1e-30..1e30, eps 1e-15, rates 1e-5..0.1";
    struct numerics_case update = {
        "8 AdamW update, reference", range, "ULP of its terms", 16, 0, ""};
    struct numerics_case second = {"8 AdamW second moment, reference", range, "ULP", 4, 0, ""};
    for (int n = 0; n < 20000; n++) {
        int64_t step = n % 4 == 0   ? 1
                       : n % 4 == 1 ? 10000000
                                    : (int64_t)numerics_spread(random, 1, 1e7);
        double sign = numerics_uniform(random, 0, 1) < 0.5 ? -1 : 1;
        double g = n % 10 == 0 ? 0 : sign * numerics_spread(random, 1e-30, 1e30);
        double typical = n % 3 ? fabs(g) : numerics_spread(random, 1e-30, 1e30);
        struct state s = {n % 2 ? 0 : numerics_uniform(random, -1, 1), 0, 0};
        if (step > 1) {
            s.m = typical * numerics_uniform(random, -1, 1);
            s.v = typical * typical * numerics_uniform(random, 0, 1);
        }
        double rate = numerics_spread(random, 1e-5, 0.1), decay = n % 3 ? 1e-5 : 0;
        struct state next = s;
        rn_reference_adamw(1, &next.parameter, &g, &next.m, &next.v, rate, decay, 1e-15, step);
        exact_reset();
        exact moments[2], change;
        exact_step(&s, g, rate, decay, 1e-15, step, moments, &change);
        exact terms = plus(size_of(number(s.parameter)), size_of(change));
        if (!mpfr_zero_p(moments[0])) { // what cancels in the first moment is magnified
            exact parts = plus(size_of(times(fraction(9, 10), number(s.m))),
                               size_of(times(fraction(1, 10), number(g))));
            terms = times(terms, over(parts, size_of(moments[0])));
        }
        double error = exact_distance(next.parameter, minus(number(s.parameter), change));
        numerics_see(&update, error / (rounded(terms) * 0x1p-52),
                     "step %lld gradient %.9g m %.9g v %.9g", (long long)step, g, s.m, s.v);
        numerics_see(&second, exact_ulps(next.v, moments[1], 53), "gradient %.9g v %.9g", g, s.v);
    }
    return numerics_close(&update) + numerics_close(&second);
}

// A million steps on a quadratic bowl end at its bottom and stay there.
static int check_long_run(struct numerics_random *random) {
    struct numerics_case c = {"10 AdamW a million steps on a bowl, reference",
                              "bottoms -1..1, rate 1e-3 falling to 1e-6",
                              "absolute",
                              2e-6,
                              0,
                              ""};
    for (int n = 0; n < 4; n++) {
        double bottom = numerics_uniform(random, -1, 1);
        struct state s = {numerics_uniform(random, -1, 1), 0, 0};
        for (int64_t step = 1; step <= 1000000; step++) {
            double g = s.parameter - bottom, rate = step < 100000 ? 1e-3 : 1e-6;
            rn_reference_adamw(1, &s.parameter, &g, &s.m, &s.v, rate, 0, 1e-15, step);
            if (step > 900000)
                numerics_see(&c, fabs(s.parameter - bottom), "bottom %.9g step %lld", bottom,
                             (long long)step);
        }
    }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    return check_steps(&random) + check_long_run(&random) > 0;
}
