// The fast paths against long double, on every kernel set that this machine has.
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/doctor/cases.h"

#define LANES 16
#define DRAWS 1000 // of LANES inputs

// Error in units of the last place of fp32.
static double ulps(float got, long double truth) {
    int exponent;
    frexpl(truth, &exponent);
    int unit = exponent - 24 < -149 ? -149 : exponent - 24;
    return (double)(fabsl(got - truth) / ldexpl(1, unit));
}

static void check_exp(const struct rn_kernels *k, struct rn_doctor_random *random,
                      struct rn_doctor_result *result) {
    struct rn_doctor_case *c = rn_doctor_open(result, "exp", k->name, 2, "ULP");
    float x[LANES], y[LANES];
    for (int n = 0; n < DRAWS; n++) {
        for (int i = 0; i < LANES; i++)
            x[i] = (float)rn_doctor_uniform(random, -87, 88);
        k->parts->exp(LANES, x, y);
        for (int i = 0; i < LANES; i++)
            rn_doctor_see(c, ulps(y[i], expl(x[i])), "x %.9g", (double)x[i]);
    }
    rn_doctor_close(result, c);
}

static void check_opacity(const struct rn_kernels *k, struct rn_doctor_random *random,
                          struct rn_doctor_result *result) {
    struct rn_doctor_case *c = rn_doctor_open(result, "opacity, 1 - exp(-x)", k->name, 4, "ULP");
    float x[LANES], y[LANES];
    for (int n = 0; n < DRAWS; n++) {
        for (int i = 0; i < LANES; i++)
            x[i] = (float)(i % 2 ? rn_doctor_spread(random, 1e-12, 1e12)
                                 : rn_doctor_uniform(random, 0, 4));
        k->parts->one_minus_exp(LANES, x, y);
        for (int i = 0; i < LANES; i++)
            rn_doctor_see(c, ulps(y[i], -expm1l(-(long double)x[i])), "x %.9g", (double)x[i]);
    }
    rn_doctor_close(result, c);
}

static void check_log2(const struct rn_kernels *k, struct rn_doctor_random *random,
                       struct rn_doctor_result *result) {
    struct rn_doctor_case *c =
        rn_doctor_open(result, "log2", k->name, 2.5, "ULP of max(1, size of log2)");
    float x[LANES], y[LANES];
    for (int n = 0; n < DRAWS; n++) {
        for (int i = 0; i < LANES; i++)
            x[i] = (float)(i % 2 ? rn_doctor_spread(random, FLT_MIN, 3.4e38)
                                 : rn_doctor_uniform(random, 0.5, 2));
        k->parts->log2(LANES, x, y);
        for (int i = 0; i < LANES; i++) {
            long double truth = log2l(x[i]), unit = fmaxl(1, fabsl(truth)) * 0x1p-23L;
            rn_doctor_see(c, (double)(fabsl(y[i] - truth) / unit), "x %.9g", (double)x[i]);
        }
    }
    rn_doctor_close(result, c);
}

static void check_moments(const struct rn_kernels *k, struct rn_doctor_random *random,
                          struct rn_doctor_result *result) {
    struct rn_doctor_case *c = rn_doctor_open(result, "frustum moments", k->name, 8, "ULP");
    float t[LANES], out[3][LANES];
    for (int n = 0; n < DRAWS / 4; n++) {
        float width = (float)rn_doctor_spread(random, 1e-6, 2e-3);
        float radius = (float)rn_doctor_spread(random, 1e-6, 1);
        for (int i = 0; i < LANES; i++)
            t[i] = fmaxf((float)(rn_doctor_spread(random, 0.5, 1e7) * (double)width), 0.5f * width);
        k->parts->moments(LANES, t, width, radius, out[0], out[1], out[2]);
        for (int i = 0; i < LANES; i++) {
            long double h = 0.5L * width, m = t[i], q = (h / m) * (h / m), d = 3 + q;
            double worst = ulps(out[0][i], m * 2 * q / d);
            worst = fmax(worst, ulps(out[1][i], 0.6L * h * h * (5 - q * (2 - q)) / (d * d)));
            worst = fmax(worst,
                         ulps(out[2][i], 0.15L * radius * m * radius * m * (5 + q * (10 + q)) / d));
            rn_doctor_see(c, worst, "t %.9g width %.9g radius %.9g", (double)t[i], (double)width,
                          (double)radius);
        }
    }
    rn_doctor_close(result, c);
}

// What is left of the parameter's error after its own rounding, in units of its change.
static void check_adamw(const struct rn_kernels *k, struct rn_doctor_random *random,
                        struct rn_doctor_result *result) {
    struct rn_doctor_case *c =
        rn_doctor_open(result, "AdamW", k->name, 16, "ULP of the change, beyond rounding");
    for (int n = 0; n < DRAWS; n++) {
        double step = n % 2 ? 1 : floor(rn_doctor_spread(random, 2, 1e7));
        double beta2 = n % 4 < 2 ? 0.999 : 0.99;
        struct rn_adamw o = {.scale = 1,
                             .rate = (float)rn_doctor_spread(random, 1e-5, 0.1),
                             .decay = 1e-5f,
                             .eps = 1e-15f,
                             .keep = (float)beta2,
                             .fresh = (float)(1 - beta2),
                             .correction1 = (float)-expm1(step * log1p(-0.1)),
                             .correction2 = (float)-expm1(step * log(beta2))};
        float p[LANES], g[LANES], m[LANES], v[LANES];
        long double change[LANES];
        double before[LANES];
        for (int i = 0; i < LANES; i++) {
            g[i] = (float)rn_doctor_spread(random, 1e-15, 1e15);
            m[i] = step > 1 ? g[i] * (float)rn_doctor_uniform(random, 0.1, 1) : 0;
            v[i] = step > 1 ? g[i] * g[i] * (float)rn_doctor_uniform(random, 0.01, 1) : 0;
            before[i] = p[i] = (float)rn_doctor_uniform(random, -1, 1);
            long double first = 0.9L * m[i] + 0.1L * g[i];
            long double second = o.keep * (long double)v[i] + o.fresh * (long double)g[i] * g[i];
            change[i] = o.rate * (o.decay * (long double)p[i] +
                                  first / o.correction1 / (sqrtl(second / o.correction2) + o.eps));
        }
        k->adamw(&o, LANES, p, g, m, v);
        for (int i = 0; i < LANES; i++) {
            double size = fmax(fabs(before[i]), fabs((double)p[i]));
            double error = (double)fabsl(p[i] - (before[i] - change[i]));
            error -= 0.5 * ldexp(1, ilogb(size) - 23);
            rn_doctor_see(c, fmax(0, error) / (double)(fabsl(change[i]) * 0x1p-23L),
                          "step %.9g parameter %.9g", step, before[i]);
        }
    }
    rn_doctor_close(result, c);
}

// A pyramid of one plane in one block.
#define BASE 37
#define LEVELS 4
#define CHANNELS 8
#define ROOM ((size_t)BASE * BASE * CHANNELS * 4 + 4096)

static size_t lay_out(float *block, struct rn_map maps[LEVELS][RN_MAX_LEVELS]) {
    size_t used = 0;
    for (int y = 0; y < LEVELS; y++)
        for (int x = 0; x < LEVELS; x++) {
            maps[y][x] = (struct rn_map){block + used, BASE >> x, BASE >> y};
            used += (size_t)(BASE >> x) * (size_t)(BASE >> y) * CHANNELS;
        }
    return used;
}

// <A x, y> = <x, A^T y> for building the pyramid and pulling its gradient down.
static void check_pyramid(const struct rn_kernels *k, struct rn_doctor_random *random,
                          struct rn_doctor_result *result) {
    struct rn_doctor_case *c =
        rn_doctor_open(result, "ripmap and its adjoint", k->name, 16, "ULP of the sum of sizes");
    static float x[ROOM], y[ROOM], kept[ROOM];
    struct rn_map x_maps[LEVELS][RN_MAX_LEVELS], y_maps[LEVELS][RN_MAX_LEVELS];
    size_t count = lay_out(x, x_maps), base = (size_t)BASE * BASE * CHANNELS;
    double forward = 0, backward = 0, scale = 0;
    lay_out(y, y_maps);
    for (size_t i = 0; i < count; i++) {
        x[i] = (float)rn_doctor_uniform(random, -1, 1);
        kept[i] = y[i] = (float)rn_doctor_uniform(random, -1, 1);
    }
    k->build(x_maps, LEVELS, false, CHANNELS);
    k->pull_down(y_maps, LEVELS, false, CHANNELS);
    for (size_t i = 0; i < count; i++) {
        forward += (double)x[i] * (double)kept[i];
        scale += fabs((double)x[i] * (double)kept[i]);
    }
    for (size_t i = 0; i < base; i++)
        backward += (double)x[i] * (double)y[i];
    rn_doctor_see(c, fabs(forward - backward) / (scale * 0x1p-23), "base %d, %d levels", BASE,
                  LEVELS);
    rn_doctor_close(result, c);
}

void rn_doctor_kernels(struct rn_doctor_random *random, struct rn_doctor_result *result) {
    const struct rn_kernels *k;
    for (int i = 0; (k = rn_kernels_available(i)); i++) {
        check_exp(k, random, result);
        check_opacity(k, random, result);
        check_log2(k, random, result);
        check_moments(k, random, result);
        check_adamw(k, random, result);
        check_pyramid(k, random, result);
    }
}
