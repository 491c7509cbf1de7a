// The fast paths as the engine calls them, every kernel set this machine has: vector functions
// over their whole range, AdamW in fp32, the pyramid and its adjoint.
#include <float.h>
#include <string.h>
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

#include "common/math/rng.h"
#include "server/engine/kernels/kernels.h"
#include "server/engine/reference/reference.h"
#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

#define LANES 16

// Error in fp32 units of a truth in long double, whose own error is 2^-11 of one.
static double ulps(float got, long double truth) {
    int exponent;
    frexpl(truth, &exponent);
    int unit = exponent - 24 < -149 ? -149 : exponent - 24;
    return (double)(fabsl(got - truth) / ldexpl(1, unit));
}

typedef void (*vector_fn)(size_t n, const float *x, float *y);

static long double exp_truth(float x) {
    return expl(x < -87.3f ? -87.3f : x > 88.7f ? 88.7f : x);
}
static long double one_minus_exp_truth(float x) {
    return -expm1l(-(long double)x);
}

// `count` batches of lanes drawn by kind: spread over magnitudes or uniform.
static int check_function(const char *what, const char *range, const char *set, vector_fn function,
                          long double (*truth)(float x), double bound, double low, double high,
                          double smallest, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "%s, %s", what, set);
    struct numerics_case c = {name, range, "ULP", bound, 0, ""};
    float x[LANES], y[LANES];
    for (int n = 0; n < 20000; n++) {
        for (int i = 0; i < LANES; i++) {
            double spread = numerics_spread(random, smallest, high);
            x[i] = (float)(i == 0             ? (n % 2 ? low : high)
                           : i % 2            ? numerics_uniform(random, low, high)
                           : low < 0 && n % 2 ? fmax(-spread, low)
                                              : spread);
        }
        function(LANES, x, y);
        for (int i = 0; i < LANES; i++)
            numerics_see(&c, ulps(y[i], truth(x[i])), "x %.9g", (double)x[i]);
    }
    return numerics_close(&c);
}

// log2 of normal numbers: relative where it is far from 0, absolute around 1.
static int check_log2(const struct rn_kernels *k, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "2 vector log2, %s", k->name);
    struct numerics_case c = {
        name, "all normal numbers, dense around 1", "ULP of max(1, |log2|)", 2.5, 0, ""};
    float x[LANES], y[LANES];
    for (int n = 0; n < 20000; n++) {
        for (int i = 0; i < LANES; i++)
            x[i] = (float)(i % 3 == 0   ? numerics_spread(random, FLT_MIN, 3.4e38)
                           : i % 3 == 1 ? numerics_spread(random, 1, 262144)
                                        : numerics_uniform(random, 0.5, 2));
        k->parts->log2(LANES, x, y);
        for (int i = 0; i < LANES; i++) {
            long double truth = log2l(x[i]), size = fmaxl(1, fabsl(truth));
            numerics_see(&c, (double)(fabsl(y[i] - truth) / (size * 0x1p-23L)), "x %.9g",
                         (double)x[i]);
        }
    }
    return numerics_close(&c);
}

// What none of the functions may turn into a number that is not one.
static int check_wild(const struct rn_kernels *k) {
    char name[80];
    snprintf(name, sizeof name, "5 vector functions of NaN and infinities, %s", k->name);
    struct numerics_case c = {name, "NaN, infinite, denormal, zero", "wrong values", 0.5, 0, ""};
    const float wild[4] = {NAN, INFINITY, -INFINITY, FLT_TRUE_MIN};
    float x[LANES], y[LANES];
    for (int i = 0; i < LANES; i++)
        x[i] = i < 4 ? wild[i] : 0;
    k->parts->exp(LANES, x, y);
    for (int i = 0; i < LANES; i++)
        numerics_see(&c, !isfinite(y[i]) || y[i] <= 0, "exp of %g", (double)x[i]);
    x[2] = FLT_MAX; // not for negative depths
    k->parts->one_minus_exp(LANES, x, y);
    for (int i = 1; i < LANES; i++)
        numerics_see(&c, !(y[i] >= 0 && y[i] <= 1), "1 - exp of %g", (double)x[i]);
    return numerics_close(&c);
}

static void exact_moments(float t, float width, float radius, exact ret[3]) {
    exact m = number((double)t), q = square(over(over(number((double)width), number(2)), m));
    exact s = plus(number(3), q), h2 = square(over(number((double)width), number(2)));
    ret[0] = times(m, over(times(number(2), q), s));
    ret[1] = times(times(fraction(3, 5), h2),
                   over(plus(number(5), times(q, minus(q, number(2)))), square(s)));
    ret[2] = times(times(fraction(3, 20), square(times(number((double)radius), m))),
                   over(plus(number(5), times(q, plus(number(10), q))), s));
}

static int check_moments(const struct rn_kernels *k, struct numerics_random *random) {
    static const char *const what[] = {"mean shift", "axial variance", "radial variance"};
    char names[3][80];
    struct numerics_case cases[3];
    for (int i = 0; i < 3; i++) {
        snprintf(names[i], sizeof names[i], "1 frustum %s of a ray, %s", what[i], k->name);
        cases[i] = (struct numerics_case){
            names[i], "t 1e-6..1e7, width/t 1e-7..2, radius 1e-6..1", "ULP", 8, 0, ""};
    }
    float t[LANES], out[3][LANES];
    for (int n = 0; n < 2000; n++) {
        float width = (float)numerics_spread(random, 1e-6, 2e-3);
        float radius = (float)numerics_spread(random, 1e-6, 1);
        for (int i = 0; i < LANES; i++)
            t[i] = fmaxf((float)numerics_spread(random, 0.5 * (double)width, 1e7 * (double)width),
                         0.5f * width);
        k->parts->moments(LANES, t, width, radius, out[0], out[1], out[2]);
        for (int i = 0; i < LANES; i++) {
            exact truth[3];
            exact_reset();
            exact_moments(t[i], width, radius, truth);
            for (int j = 0; j < 3; j++)
                numerics_see(&cases[j], exact_ulps((double)out[j][i], truth[j], 24),
                             "t %.9g width %.9g radius %.9g", (double)t[i], (double)width,
                             (double)radius);
        }
    }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]) + numerics_close(&cases[2]);
}

// ---- AdamW ----------------------------------------------------------------------------------

struct lane {
    float parameter, grad, m, v;
};

static struct lane draw_lane(struct numerics_random *random, bool first) {
    double sign = numerics_uniform(random, 0, 1) < 0.5 ? -1 : 1;
    double g = numerics_uniform(random, 0, 1) < 0.1 ? 0 : numerics_spread(random, 1e-30, 1e30);
    double typical =
        fmin(numerics_uniform(random, 0, 1) < 0.7 ? g : numerics_spread(random, 1e-30, 1e19), 1e19);
    struct lane l = {(float)numerics_uniform(random, -1, 1), (float)(sign * g), 0, 0};
    if (!first) {
        l.m = (float)(typical * numerics_uniform(random, 0.1, 1) * sign);
        l.v = (float)(typical * typical * numerics_uniform(random, 0.01, 1));
    }
    return l;
}

// The change of the parameter and the second moment; gradients count up to 1.8e19.
static exact exact_change(const struct rn_adamw *o, const struct lane *l, bool slow, exact *ret_v) {
    double clipped = fmax(-1.8e19f, fmin(1.8e19f, (double)l->grad));
    exact g = number(clipped);
    exact m = plus(times(fraction(9, 10), number((double)l->m)), times(fraction(1, 10), g));
    exact keep = slow ? fraction(999, 1000) : fraction(99, 100);
    *ret_v = plus(times(keep, number((double)l->v)), times(minus(number(1), keep), square(g)));
    exact size = root(over(*ret_v, number((double)o->correction2)));
    exact step = over(over(m, number((double)o->correction1)), plus(size, number((double)o->eps)));
    return times(number((double)o->rate),
                 plus(times(number((double)o->decay), number((double)l->parameter)), step));
}

// What is left of the parameter's error after its own rounding, in units of its change. A GPU's own
// root and quotient are off by 2 ULP each.
static int check_adamw(const struct rn_kernels *k, struct numerics_random *random) {
    char names[2][80];
    const char *range = "steps 1..1e7, gradients 0 and 1e-30..1e30, eps 1e-15, rates 1e-5..0.1, "
                        "beta2 0.999 and 0.99";
    struct numerics_case change = {names[0],          range, "ULP of the change, beyond rounding",
                                   k->parts ? 8 : 12, 0,     ""};
    struct numerics_case second = {names[1], range, "ULP", 4, 0, ""};
    snprintf(names[0], sizeof names[0], "8 AdamW change, %s", k->name);
    snprintf(names[1], sizeof names[1], "8 AdamW second moment, %s", k->name);
    for (int n = 0; n < 2000; n++) {
        double step = n % 3 == 0 ? 1 : n % 3 == 1 ? 1e7 : floor(numerics_spread(random, 1, 1e7));
        bool slow = n % 2;
        struct rn_adamw o = {.scale = 1,
                             .rate = (float)numerics_spread(random, 1e-5, 0.1),
                             .decay = 1e-5f,
                             .eps = 1e-15f,
                             .keep = slow ? 0.999f : 0.99f,
                             .fresh = slow ? 0.001f : 0.01f,
                             .correction1 = (float)-expm1(step * log1p(-0.1)),
                             .correction2 = (float)-expm1(step * log1p(slow ? -0.001 : -0.01))};
        struct lane lanes[LANES];
        float p[LANES], g[LANES], m[LANES], v[LANES];
        for (int i = 0; i < LANES; i++) {
            lanes[i] = draw_lane(random, step == 1);
            p[i] = lanes[i].parameter;
            g[i] = lanes[i].grad;
            m[i] = lanes[i].m;
            v[i] = lanes[i].v;
        }
        k->adamw(&o, LANES - (size_t)(n % LANES), p, g, m, v);
        for (int i = 0; i < LANES - n % LANES; i++) {
            exact_reset();
            exact v_truth, moved = exact_change(&o, &lanes[i], slow, &v_truth);
            double before = (double)lanes[i].parameter, size = fabs(rounded(moved));
            double error = exact_distance((double)p[i], minus(number(before), moved));
            error -= 0.5 * ldexp(1, ilogb(fmax(fabs(before), fabs((double)p[i]))) - 23);
            if (size > 0)
                numerics_see(&change, fmax(0, error) / (size * 0x1p-23),
                             "step %.9g gradient %.9g m %.9g v %.9g parameter %.9g", step,
                             (double)lanes[i].grad, (double)lanes[i].m, (double)lanes[i].v, before);
            numerics_see(&second, exact_ulps((double)v[i], v_truth, 24), "gradient %.9g v %.9g",
                         (double)lanes[i].grad, (double)lanes[i].v);
            if (g[i] != 0) numerics_see(&second, INFINITY, "a gradient was not cleared");
        }
    }
    return numerics_close(&change) + numerics_close(&second);
}

// Flushing denormals moves a parameter by a small part of the learning rate only.
static int check_denormals(const struct rn_kernels *k, struct numerics_random *random) {
#if defined(__x86_64__)
    char name[80];
    snprintf(name, sizeof name, "8 AdamW with denormals flushed, %s", k->name);
    struct numerics_case c = {
        name, "gradients 1e-30..1e-10, steps 1 and 1000", "of the rate", 2e-5, 0, ""};
    for (int n = 0; n < 2000; n++) {
        double step = n % 2 ? 1 : 1000;
        struct rn_adamw o = {.scale = 1,
                             .rate = 0.02f,
                             .eps = 1e-15f,
                             .keep = 0.999f,
                             .fresh = 0.001f,
                             .correction1 = (float)-expm1(step * log1p(-0.1)),
                             .correction2 = (float)-expm1(step * log1p(-0.001))};
        float p[2][LANES] = {{0}}, g[2][LANES], m[2][LANES] = {{0}}, v[2][LANES] = {{0}};
        for (int i = 0; i < LANES; i++)
            g[0][i] = g[1][i] = (float)numerics_spread(random, 1e-30, 1e-10);
        float drawn[LANES];
        memcpy(drawn, g[0], sizeof drawn);
        k->adamw(&o, LANES, p[0], g[0], m[0], v[0]);
        unsigned kept = _mm_getcsr();
        _mm_setcsr(kept | 0x8040); // flush to zero, denormals are zero
        k->adamw(&o, LANES, p[1], g[1], m[1], v[1]);
        _mm_setcsr(kept);
        for (int i = 0; i < LANES; i++)
            numerics_see(&c, fabs((double)p[0][i] - (double)p[1][i]) / (double)o.rate,
                         "step %g gradient %.9g", step, (double)drawn[i]);
    }
    return numerics_close(&c);
#else
    (void)k;
    (void)random;
    return 0;
#endif
}

// ---- the pyramid ----------------------------------------------------------------------------

struct pyramid {
    struct rn_map maps[RN_MAX_LEVELS][RN_MAX_LEVELS];
    float *memory;
    size_t count;
};

static struct pyramid make_pyramid(int base, int levels, bool mip, int channels) {
    struct pyramid p = {.count = 0};
    for (int pass = 0; pass < 2; pass++) {
        p.count = 0;
        for (int y = 0; y < levels; y++)
            for (int x = 0; x < levels; x++) {
                if (!rn_map_exists(mip, x, y)) continue;
                struct rn_map *map = &p.maps[y][x];
                map->width = base >> x > 1 ? base >> x : 1;
                map->height = base >> y > 1 ? base >> y : 1;
                if (pass) map->texels = p.memory + p.count;
                p.count += (size_t)map->width * (size_t)map->height * (size_t)channels;
            }
        if (pass == 0) p.memory = calloc(p.count, sizeof(float));
        if (!p.memory) exit(1);
    }
    return p;
}

// <A x, y> = <x, A^T y>: build against pull_down, relative to sum |x y|.
static int check_pyramid(const struct rn_kernels *k, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "3 ripmap adjoint of the pyramid, %s", k->name);
    struct numerics_case c = {
        name, "bases 2..70, 5 levels, rip and mip, 4 to 16 channels", "ULP of sum |x y|", 16, 0,
        ""};
    for (int base = 2; base <= 70; base++) {
        bool mip = base % 3 == 0;
        int channels = 4 << base % 3;
        struct pyramid x = make_pyramid(base, 5, mip, channels);
        struct pyramid y = make_pyramid(base, 5, mip, channels);
        size_t first = (size_t)base * (size_t)base * (size_t)channels;
        float *base_of_x = x.maps[0][0].texels, *base_of_y = y.maps[0][0].texels;
        double forward = 0, backward = 0, scale = 0;
        for (size_t i = 0; i < first; i++)
            base_of_x[i] = (float)numerics_uniform(random, -1, 1);
        for (size_t i = 0; i < y.count; i++)
            y.memory[i] = (float)numerics_uniform(random, -1, 1);
        k->build(x.maps, 5, mip, channels);
        for (size_t i = 0; i < x.count; i++) {
            forward += (double)x.memory[i] * (double)y.memory[i];
            scale += fabs((double)x.memory[i] * (double)y.memory[i]);
        }
        k->pull_down(y.maps, 5, mip, channels);
        for (size_t i = 0; i < first; i++)
            backward += (double)base_of_x[i] * (double)base_of_y[i];
        numerics_see(&c, fabs(forward - backward) / (scale * 0x1p-23), "base %d, %d channels%s",
                     base, channels, mip ? ", mip" : "");
        free(x.memory);
        free(y.memory);
    }
    return numerics_close(&c);
}

// Smoothing against float64, and many times over: no texel leaves the first range.
static int check_smoothing(const struct rn_kernels *k, struct numerics_random *random) {
    char names[2][80];
    struct numerics_case once = {names[0],
                                 "bases 2..70, 4 to 16 channels, shares 0..1/4, numbers 1e-6..10",
                                 "ULP of the largest",
                                 8,
                                 0,
                                 ""};
    struct numerics_case often = {
        names[1], "1 to 1,000 times by 1/4, base 32, 16 channels", "ULP of the largest", 8, 0, ""};
    snprintf(names[0], sizeof names[0], "3 ripmap smoothing, %s", k->name);
    snprintf(names[1], sizeof names[1], "3 ripmap smoothing leaves the range, %s", k->name);
    for (int base = 2; base <= 70; base++) {
        struct rn_field_config config = {.planes = 3,
                                         .base = base,
                                         .channels = 4 << base % 3,
                                         .levels = 1,
                                         .width = 16,
                                         .base_layers = 1,
                                         .head_layers = 1,
                                         .occupancy = 16};
        struct rn_reference *truth;
        struct rn_error err;
        if (rn_reference_create(&config, 1, &truth, &err) != RN_OK) exit(1);
        float share = base % 10 == 0 ? 0.25f : (float)numerics_uniform(random, 0, 0.25);
        float *planes = malloc(truth->plane_count * sizeof *planes);
        double largest = 0;
        for (size_t i = 0; i < truth->plane_count; i++) {
            double sign = numerics_uniform(random, -1, 1) < 0 ? -1 : 1;
            planes[i] = (float)(sign * numerics_spread(random, 1e-6, 10));
            truth->planes[i] = (double)planes[i];
            largest = fmax(largest, fabs(truth->planes[i]));
        }
        for (size_t p = 0; p < 3; p++)
            k->smooth(planes + p * truth->plane_count / 3, base, config.channels, share);
        rn_reference_smooth(truth, (double)share);
        for (size_t i = 0; i < truth->plane_count; i++)
            numerics_see(&once, fabs((double)planes[i] - truth->planes[i]) / (largest * 0x1p-23),
                         "base %d, share %.9g, number %zu", base, (double)share, i);
        free(planes);
        rn_reference_destroy(&truth);
    }
    static float plane[32 * 32 * 16];
    double largest = 0;
    for (size_t i = 0; i < sizeof plane / sizeof *plane; i++) {
        plane[i] = (float)numerics_uniform(random, -1, 1);
        largest = fmax(largest, fabs((double)plane[i]));
    }
    for (int pass = 1; pass <= 1000; pass++) {
        k->smooth(plane, 32, 16, 0.25f);
        for (size_t i = 0; i < sizeof plane / sizeof *plane; i++)
            numerics_see(&often, fmax(0, fabs((double)plane[i]) - largest) / (largest * 0x1p-23),
                         "time %d, number %zu", pass, i);
    }
    return numerics_close(&once) + numerics_close(&often);
}

// What a product's error may be, relative to the sum of its terms' magnitudes: a rounding of each
// term and sum; and where operands are rounded to bf16, 2^-8 for each: 2^-7 + 2^-16 together.
static double product_bound(const struct rn_kernels *k, int terms) {
    double sums = (terms + 2) * 0x1p-24;
    return rn_kernels_bf16(k) ? sums + 0x1p-7 + 0x1p-16 : sums;
}

static int check_products(const struct rn_kernels *k, struct numerics_random *random) {
    enum { ROWS = 70, K = 200, N = 64 };
    static float a[ROWS * K], b[K * N], c[ROWS * N];
    char name[80], unit[80];
    snprintf(name, sizeof name, "5 networks' products, %s", k->name);
    snprintf(unit, sizeof unit, "of (%s(K + 2) 2^-24) sum |a b|",
             rn_kernels_bf16(k) ? "2^-7 + 2^-16 + " : "");
    struct numerics_case cases = {name, "K 1..200, numbers 1e-4..1e4 of both signs", unit, 1, 0,
                                  ""};
    for (int trial = 0; trial < 60; trial++) {
        int rows = 1 + trial, terms = 1 + trial * trial * 7 % K, columns = 16 + trial % 4 * 16;
        for (int i = 0; i < ROWS * K; i++)
            a[i] = (float)numerics_spread(random, 1e-4, 1e4) * (i % 3 ? 1 : -1);
        for (int i = 0; i < K * N; i++)
            b[i] = (float)numerics_spread(random, 1e-4, 1e4) * (i % 5 ? 1 : -1);
        k->parts->gemm(rows, terms, columns, a, K, b, N, c, N);
        for (int i = 0; i < rows; i++)
            for (int j = 0; j < columns; j++) {
                long double sum = 0, size = 0;
                for (int t = 0; t < terms; t++) {
                    long double term = (long double)a[i * K + t] * (long double)b[t * N + j];
                    sum += term;
                    size += fabsl(term);
                }
                double error = (double)(fabsl((long double)c[i * N + j] - sum) / size);
                numerics_see(&cases, error / product_bound(k, terms), "K %d, row %d, column %d",
                             terms, i, j);
            }
    }
    return numerics_close(&cases);
}

int main(void) {
    struct numerics_random random = numerics_random();
    const struct rn_kernels *k;
    int failed = 0;
    for (int i = 0; (k = rn_kernels_available(i)); i++) {
        failed += check_function("5 vector exp", "-90..90", k->name, k->parts->exp, exp_truth, 2,
                                 -90, 90, 1e-12, &random);
        failed +=
            check_function("5 vector 1 - exp(-x)", "0, 1e-30..100", k->name,
                           k->parts->one_minus_exp, one_minus_exp_truth, 4, 0, 100, 1e-30, &random);
        failed += check_log2(k, &random);
        failed += check_wild(k);
        failed += check_moments(k, &random);
        failed += check_pyramid(k, &random);
        failed += check_smoothing(k, &random);
        failed += check_products(k, &random);
    }
    for (int i = 0; (k = optimiser_at(i)); i++)
        failed += check_adamw(k, &random) + check_denormals(k, &random);
    return failed > 0;
}
