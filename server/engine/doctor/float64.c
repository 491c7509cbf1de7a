// The reference's formulas in float64 against long double, and the floating point under them.
#include <fenv.h>
#include <float.h>
#include <math.h>
#include <string.h>

#include "server/engine/doctor/cases.h"
#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/field/volume.h"

#define DRAWS 4000

// Error in units of the last place of float64; the truth's own error is 2^-11 of one.
static double ulps(double got, long double truth) {
    int exponent;
    frexpl(truth, &exponent);
    int unit = exponent - 53 < -1074 ? -1074 : exponent - 53;
    return (double)(fabsl(got - truth) / ldexpl(1, unit));
}

// What every bound is stated under; tests/numerics/flags.c has the reasons.
static void check_arithmetic(struct rn_doctor_result *result) {
    struct rn_doctor_case *c =
        rn_doctor_open(result, "IEEE arithmetic as stated", "", 0, "rules broken");
    volatile double a = 1 + 0x1p-30, b = 1 - 0x1p-30, one = 1, big = 0x1p53, three = 3;
    volatile double smallest = DBL_MIN, zero = 0;
    double x = a, y = b, z = one, third = 1 / three, half = smallest / 2, s = big;
    double nan = zero / zero;
    rn_doctor_see(c, FLT_EVAL_METHOD != 0, "double is evaluated as double");
    rn_doctor_see(c, x * y - z != 0, "a * b - c is not contracted");
    rn_doctor_see(c, fma(x, y, -z) != -0x1p-60, "fma rounds once");
    rn_doctor_see(c, (s + z) - s != 0, "sums are not reordered");
    rn_doctor_see(c, third * 3 != 1, "division is rounded");
    rn_doctor_see(c, !(half > 0 && half * 2 == DBL_MIN), "denormals are kept");
    rn_doctor_see(c, !(nan != nan && isnan(nan)), "NaN is told from numbers");
    rn_doctor_see(c, fegetround() != FE_TONEAREST, "rounding is to nearest");
    rn_doctor_close(result, c);
}

static void check_moments(struct rn_doctor_random *random, struct rn_doctor_result *result) {
    struct rn_doctor_case *c = rn_doctor_open(result, "frustum moments", "", 1.01, "ULP");
    for (int n = 0; n < DRAWS; n++) {
        double t = rn_doctor_spread(random, 1e-6, 1e7), r = rn_doctor_spread(random, 1e-6, 1);
        double width = t * rn_doctor_spread(random, 1e-7, 2);
        long double h = (long double)width / 2, m = t, q = (h / m) * (h / m), d = 3 + q;
        struct rn_moments got = rn_frustum_moments(t, width, r);
        long double truth[3] = {m * (1 + 2 * q / d), 3 * h * h * (5 - q * (2 - q)) / (5 * d * d),
                                3 * (r * m) * (r * m) * (5 + q * (10 + q)) / (20 * d)};
        double worst = fmax(ulps(got.mean, truth[0]), ulps(got.axial, truth[1]));
        rn_doctor_see(c, fmax(worst, ulps(got.radial, truth[2])), "t %.9g width %.9g radius %.9g",
                      t, width, r);
    }
    rn_doctor_close(result, c);
}

static void draw_direction(struct rn_doctor_random *random, double d[3]) {
    double norm = 0;
    do {
        norm = 0;
        for (int i = 0; i < 3; i++) {
            d[i] = rn_doctor_uniform(random, -1, 1);
            norm += d[i] * d[i];
        }
    } while (norm > 1 || norm < 0.01);
    for (int i = 0; i < 3; i++)
        d[i] /= sqrt(norm);
}

static void check_footprint(struct rn_doctor_random *random, struct rn_doctor_result *result) {
    struct rn_doctor_case *c = rn_doctor_open(result, "projected variance", "", 8, "ULP");
    for (int n = 0; n < DRAWS; n++) {
        double x[3], d[3], axial = rn_doctor_spread(random, 1e-12, 1e4);
        double radial = rn_doctor_spread(random, 1e-12, 1e4);
        draw_direction(random, x);
        draw_direction(random, d);
        long double dot = 0, cross = 0;
        for (int i = 0; i < 3; i++) {
            int j = (i + 1) % 3, k = (i + 2) % 3;
            long double part = (long double)x[j] * d[k] - (long double)x[k] * d[j];
            dot += (long double)x[i] * d[i];
            cross += part * part;
        }
        if (cross < 1e-4L || fabsl(dot) < 1e-2L) continue; // long double would not be enough
        rn_doctor_see(
            c, ulps(rn_projected_variance(x, d, axial, radial), axial * dot * dot + radial * cross),
            "axis %.6g %.6g %.6g ray %.6g %.6g %.6g", x[0], x[1], x[2], d[0], d[1], d[2]);
    }
    rn_doctor_close(result, c);
}

static void check_compositing(struct rn_doctor_random *random, struct rn_doctor_result *result) {
    struct rn_doctor_case *c =
        rn_doctor_open(result, "weights and rest sum to 1", "", 4, "ULP of 1");
    static double x[1024], weights[1024], after[1024];
    for (int n = 1; n <= 1024; n *= 2)
        for (int kind = 0; kind < 8; kind++) {
            long double sum = 0;
            for (int i = 0; i < n; i++)
                x[i] = kind % 2 ? rn_doctor_spread(random, 1e-12, 1e12) : 3.0 / n;
            rn_composite(n, x, weights, after);
            for (int i = 0; i < n; i++)
                sum += weights[i];
            rn_doctor_see(c, (double)(fabsl(sum + after[n - 1] - 1) / 0x1p-52L), "%d samples", n);
        }
    rn_doctor_close(result, c);
}

void rn_doctor_float64(struct rn_doctor_random *random, struct rn_doctor_result *result) {
    check_arithmetic(result);
    check_moments(random, result);
    check_footprint(random, result);
    check_compositing(random, result);
}
