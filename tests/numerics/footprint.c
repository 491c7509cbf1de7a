// Case 2: the Gaussian's footprint on a plane and the ripmap level it asks for.
#include <float.h>

#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

// axial (x.d)^2 + radial |x cross d|^2 of the vectors as represented.
static exact exact_variance(const double x[3], const double d[3], double axial, double radial) {
    exact dot = number(0), cross = number(0);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        dot = plus(dot, times(number(x[i]), number(d[i])));
        cross = plus(cross, square(minus(times(number(x[j]), number(d[k])),
                                         times(number(x[k]), number(d[j])))));
    }
    return plus(times(number(axial), square(dot)), times(number(radial), cross));
}

// A direction d and an axis x near it (0), within an ULP of parallel (1), parallel (2), orthogonal
// as far as rounding allows (3), orthogonal exactly (4).
static void draw_axis(const struct subject *s, struct numerics_random *random, int kind,
                      double x[3], double d[3]) {
    numerics_direction(random, d);
    numerics_direction(random, x);
    double along = x[0] * d[0] + x[1] * d[1] + x[2] * d[2], norm = 0;
    for (int i = 0; i < 3; i++) {
        d[i] = s->nearest(d[i]);
        if (kind == 1 || kind == 2) x[i] = d[i];
        if (kind == 3) x[i] -= along * d[i];
        norm += x[i] * x[i];
    }
    for (int i = 0; i < 3 && kind == 3; i++)
        x[i] /= sqrt(norm);
    if (kind == 4) {
        x[0] = -d[1];
        x[1] = d[0];
        x[2] = 0;
    }
    for (int i = 0; i < 3; i++)
        x[i] = s->nearest(x[i]);
    if (kind == 1) {
        int i = (int)numerics_uniform(random, 0, 3);
        double ulp = s->digits == 24 ? 0x1p-24 : 0x1p-53;
        x[i] = s->nearest(x[i] * (1 + (numerics_uniform(random, 0, 1) < 0.5 ? -2 : 2) * ulp));
    }
}

// The anisotropy of the standard deviations is up to 1e8 either way.
static int check_variance(const struct subject *s, struct numerics_random *random) {
    static const char *const kinds[] = {"any axis", "axis within 1 ULP of the ray", "axis = ray",
                                        "axis orthogonal, rounded", "axis orthogonal, exactly"};
    int failed = 0;
    for (int kind = 0; kind < 5; kind++) {
        char name[80];
        snprintf(name, sizeof name, "2 projected variance, %s, %s", kinds[kind], s->name);
        struct numerics_case c = {name, "sigmas 1e-9..1e3, ratio 1e-8..1e8", "ULP", 8, 0, ""};
        for (int n = 0; n < 10000; n++) {
            double x[3], d[3], sigma = numerics_spread(random, 1e-9, 1e3);
            double ratio = numerics_spread(random, 1e-8, 1e8);
            double axial = s->nearest(sigma * sigma * fmax(1, ratio) * fmax(1, ratio));
            double radial = s->nearest(sigma * sigma / fmin(1, ratio) / fmin(1, ratio));
            draw_axis(s, random, kind, x, d);
            double got = s->variance(x, d, axial, radial);
            exact_reset();
            double error = exact_ulps(got, exact_variance(x, d, axial, radial), s->digits);
            numerics_see(&c, got < 0 ? INFINITY : error,
                         "axis %.9g %.9g %.9g ray %.9g %.9g %.9g variances %.9g %.9g", x[0], x[1],
                         x[2], d[0], d[1], d[2], axial, radial);
        }
        failed += numerics_close(&c);
    }
    return failed;
}

static exact exact_level(double variance, int size, int levels) {
    if (!(variance > 0)) return number(0);
    exact level = plus(over(logarithm_2(number(variance)), number(2)),
                       logarithm_2(times(number(2), number(size))));
    return smaller(larger(level, number(0)), number(levels - 1));
}

// In units of the last place of max(1, level).
static double level_error(const struct subject *s, double got, exact truth) {
    return exact_distance(got, truth) / ldexp(fmax(1, rounded(truth)), 1 - s->digits);
}

// A device's own logarithm is off by 2^-22 and 2^-22 of itself, of a level twice as much of a ball.
static double level_bound(const struct subject *s) {
    return s->device ? 6 : 2;
}

static int check_level(const struct subject *s, struct numerics_random *random) {
    char name[80], name_ball[80];
    snprintf(name, sizeof name, "2 level, %s", s->name);
    snprintf(name_ball, sizeof name_ball, "2 level of a ball, %s", s->name);
    const char *range = "variance 0..largest, denormal, infinite, NaN; size 2..4096, levels 1..10";
    struct numerics_case c = {name, range, "ULP of max(1, level)", level_bound(s), 0, ""};
    struct numerics_case ball = {name_ball, range, "ULP of max(1, level)", level_bound(s), 0, ""};
    const double corners[] = {0, -0.0,    DBL_TRUE_MIN, FLT_TRUE_MIN, DBL_MIN,  FLT_MIN, 1e-30,
                              1, FLT_MAX, 1e30,         DBL_MAX,      INFINITY, NAN,     -1};
    int count = sizeof corners / sizeof *corners;
    for (int n = 0; n < 20000; n++) {
        int size = n % 3 ? 2 << (int)numerics_uniform(random, 0, 12)
                         : (int)numerics_uniform(random, 2, 4097);
        int levels = (int)numerics_uniform(random, 1, 11);
        double v =
            s->nearest(n < 20 * count ? corners[n % count] : numerics_spread(random, 1e-9, 100));
        exact_reset();
        exact truth = isinf(v) ? number(levels - 1) : exact_level(v, size, levels);
        numerics_see(&c, level_error(s, s->level(v, size, levels), truth),
                     "variance %.9g size %d levels %d", v, size, levels);
        truth = isinf(v) ? number(levels - 1)
                         : exact_level(v > 0 ? v * v / 4 : 0, size, levels); // a ball is 2 sigma
        if (s->ball_level && (n >= 20 * count || !(v > 0) || isinf(v)))
            numerics_see(&ball, level_error(s, s->ball_level(v, size, levels), truth),
                         "ball %.9g size %d levels %d", v, size, levels);
    }
    return numerics_close(&c) + (s->ball_level ? numerics_close(&ball) : 0);
}

// Steps of one ULP of the variance across both clamps: the level neither jumps nor falls.
static int check_continuity(const struct subject *s) {
    char name[80];
    snprintf(name, sizeof name, "2 level across both clamps, %s", s->name);
    struct numerics_case c = {name,
                              "one-ULP steps, sizes 2..4096, levels 2..10",
                              "ULP of max(1, level)",
                              level_bound(s),
                              0,
                              ""};
    double step = 1 + ldexp(1, 1 - s->digits);
    for (int size = 2; size <= 4096; size++)
        for (int end = 0; end < 2; end++) {
            int levels = 2 + size % 9;
            double edge = pow(0.5 / size, 2) * (end ? pow(4, levels - 1) : 1);
            double v = s->nearest(edge * (1 - 20 * (step - 1))), last = s->level(v, size, levels);
            for (int i = 0; i < 40; i++) {
                v = s->nearest(v * step);
                double level = s->level(v, size, levels), jump = level - last;
                numerics_see(&c, jump < 0 ? INFINITY : jump / ldexp(fmax(1, level), 1 - s->digits),
                             "variance %.17g size %d levels %d", v, size, levels);
                last = level;
            }
        }
    return numerics_close(&c);
}

int main(void) {
    const struct subject *s;
    struct numerics_random random = numerics_random();
    int failed = 0;
    for (int i = 0; (s = subject_at(i)); i++) {
        failed += check_variance(s, &random);
        failed += check_level(s, &random);
        failed += check_continuity(s);
    }
    return failed > 0;
}
