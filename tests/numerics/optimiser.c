// Cases 8 and 10: AdamW (Loshchilov & Hutter 2019), single steps, long runs, and what sparse
// updates leave out.
#include <string.h>

#include "server/engine/kernels/kernels.h"
#include "server/engine/reference/reference.h"
#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
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

// ---- the fast paths ---------------------------------------------------------------------------

#define LANES 16

struct lanes {
    float p[LANES], g[LANES], m[LANES], v[LANES];
};

static struct rn_adamw options_at(int64_t step, double rate, double decay, double beta2) {
    return (struct rn_adamw){.scale = 1,
                             .rate = (float)rate,
                             .decay = (float)decay,
                             .eps = 1e-15f,
                             .keep = (float)beta2,
                             .fresh = (float)(1 - beta2),
                             .correction1 = (float)-expm1((double)step * log(0.9)),
                             .correction2 = (float)-expm1((double)step * log(beta2))};
}

// A million steps in fp32 on a fixed problem: bowls of steepness 1e-3 to 1e3, the rate falling from
// 1e-3 to 1e-6. Next to a float64 run of the same problem on the way down (near the bottom AdamW
// steps by the sign of what is left); at the bottom for the last 100,000 steps.
static int check_long_runs(const struct rn_kernels *k, struct numerics_random *random) {
    char names[2][80];
    snprintf(names[0], sizeof names[0], "10 AdamW a million steps on bowls, %s", k->name);
    snprintf(names[1], sizeof names[1], "10 AdamW beside float64, %s", k->name);
    struct numerics_case end = {
        names[0],   "bottoms -1..1, steepness 1e-3..1e3, rate 1e-3 falling to 1e-6",
        "absolute", 2e-6,
        0,          ""};
    struct numerics_case beside = {
        names[1], "on the way to 0.01 from the bottom", "absolute", 2e-5, 0, ""};
    struct lanes l = {0};
    struct state truth[LANES];
    bool arrived[LANES] = {false};
    double bottom[LANES], steepness[LANES];
    for (int i = 0; i < LANES; i++) {
        bottom[i] = (double)(float)numerics_uniform(random, -1, 1);
        steepness[i] = numerics_spread(random, 1e-3, 1e3);
        truth[i] = (struct state){numerics_uniform(random, -1, 1), 0, 0};
        l.p[i] = (float)truth[i].parameter;
    }
    for (int64_t step = 1; step <= 1000000; step++) {
        double rate = step < 100000 ? 1e-3 : 1e-6;
        struct rn_adamw o = options_at(step, rate, 0, 0.999);
        for (int i = 0; i < LANES; i++)
            l.g[i] = (float)(steepness[i] * ((double)l.p[i] - bottom[i]));
        k->adamw(&o, LANES, l.p, l.g, l.m, l.v);
        for (int i = 0; i < LANES; i++) {
            struct state *s = &truth[i];
            arrived[i] |= fabs(s->parameter - bottom[i]) < 0.01;
            if (arrived[i]) continue;
            double g = steepness[i] * (s->parameter - bottom[i]);
            rn_reference_adamw(1, &s->parameter, &g, &s->m, &s->v, rate, 0, 1e-15, step);
            numerics_see(&beside, fabs((double)l.p[i] - s->parameter),
                         "bottom %.9g steepness %.3g step %lld", bottom[i], steepness[i],
                         (long long)step);
        }
        for (int i = 0; i < LANES && step > 900000; i++)
            numerics_see(&end, fabs((double)l.p[i] - bottom[i]),
                         "bottom %.9g steepness %.3g step %lld", bottom[i], steepness[i],
                         (long long)step);
    }
    return numerics_close(&end) + numerics_close(&beside);
}

// ---- sparse against dense -----------------------------------------------------------------------

// How far dense AdamW moves a parameter whose gradients stay away, in units of the rate: the sum of
// 0.9^j / beta2^(j/2) over j > 0, times the largest |m| / sqrt(v) there is (by Cauchy-Schwarz).
static double forgotten_bound(double beta2) {
    double ratio = 0.9 / sqrt(beta2);
    return ratio / (1 - ratio) * 0.1 / sqrt((1 - beta2) * (1 - 0.81 / beta2));
}

// Gradients of a texel's past: steady, one peak at the end, alternating, rare, or growing (the
// worst case: each 1/0.9 of the next).
static double past_gradient(struct numerics_random *random, int lane, int step, int last) {
    double peak = numerics_spread(random, 0.5, 2);
    switch (lane % 5) {
    case 0:
        return peak;
    case 1:
        return step == last ? 1e3 * peak : 1e-3 * peak;
    case 2:
        return step % 2 ? peak : -peak;
    case 3:
        return step % 17 ? 0 : peak;
    default:
        return pow(0.9, last - step);
    }
}

// Sparse updates leave out texels that no sample met: the parameter, its moments and its decay
// stand still. What dense AdamW would have done meanwhile is bounded.
static int check_forgotten(const struct rn_kernels *k, struct numerics_random *random) {
    char names[2][80];
    snprintf(names[0], sizeof names[0], "8 sparse against dense AdamW, texels left alone, %s",
             k->name);
    snprintf(names[1], sizeof names[1], "8 sparse against dense AdamW, texels met, %s", k->name);
    struct numerics_case left = {
        names[0],
        "after 1..2000 updates, then 1..3000 without, beta2 0.99 and 0.999",
        "of what is stated: 21 rates (beta2 0.99), 66 (0.999)",
        1,
        0,
        ""};
    struct numerics_case met = {names[1], "up to 2000 updates of the same texels", "bytes", 0, 0,
                                ""};
    for (int n = 0; n < 60; n++) {
        double beta2 = n % 2 ? 0.999 : 0.99, rate = numerics_spread(random, 1e-4, 1e-1);
        int last = (int)numerics_spread(random, 1, 2000);
        int alone = (int)numerics_spread(random, 1, 3000);
        struct lanes dense[2] = {0}; // with a neighbour that the sparse optimiser never visits
        struct lanes sparse = {0};
        int step = 1;
        for (; step <= last; step++) {
            struct rn_adamw o = options_at(step, rate, 0, beta2);
            for (int i = 0; i < LANES; i++)
                dense[0].g[i] = sparse.g[i] = (float)past_gradient(random, i, step, last);
            k->adamw(&o, LANES, sparse.p, sparse.g, sparse.m, sparse.v);
            for (int j = 0; j < 2; j++)
                k->adamw(&o, LANES, dense[j].p, dense[j].g, dense[j].m, dense[j].v);
        }
        numerics_see(&met, memcmp(&dense[0], &sparse, sizeof sparse) != 0, "%d updates", last);
        numerics_see(&met, memcmp(&dense[1], &(struct lanes){0}, sizeof sparse) != 0,
                     "%d updates of a texel that is never met", last);
        for (int j = 0; j < alone; j++, step++) {
            struct rn_adamw o = options_at(step, rate, 0, beta2);
            k->adamw(&o, LANES, dense[0].p, dense[0].g, dense[0].m, dense[0].v);
        }
        for (int i = 0; i < LANES; i++)
            numerics_see(&left,
                         fabs((double)dense[0].p[i] - (double)sparse.p[i]) / rate /
                             forgotten_bound(beta2),
                         "%d updates, %d without, lane %d, beta2 %g", last, alone, i, beta2);
    }
    return numerics_close(&left) + numerics_close(&met);
}

// A decay that sparse updates would leave out is refused; a dense one reaches every texel, but for
// the rounding of each step, up to half a unit of the parameter (as in any fp32 AdamW).
static int check_decay(const struct rn_kernels *k) {
    char name[80];
    snprintf(name, sizeof name, "8 weight decay of texels left alone, dense, %s", k->name);
    struct numerics_case c = {
        name, "10,000 steps of rate 0.02, decay 1e-5", "half ULP a step", 1, 0, ""};
    struct lanes l = {0};
    for (int i = 0; i < LANES; i++)
        l.p[i] = (float)(i + 1) / LANES;
    for (int64_t step = 1; step <= 10000; step++) {
        struct rn_adamw o = options_at(step, 0.02, 1e-5, 0.999);
        k->adamw(&o, LANES, l.p, l.g, l.m, l.v);
    }
    for (int i = 0; i < LANES; i++) {
        double truth = (i + 1.0) / LANES * exp(10000 * log1p(-0.02 * 1e-5));
        numerics_see(&c, fabs((double)l.p[i] - truth) / truth / (10000 * 0x1p-24), "from %g",
                     (i + 1.0) / LANES);
    }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    const struct rn_kernels *k;
    int failed = check_steps(&random) + check_long_run(&random);
    for (int i = 0; (k = optimiser_at(i)); i++) {
        failed += check_long_runs(k, &random) + check_forgotten(k, &random) + check_decay(k);
    }
    return failed > 0;
}
