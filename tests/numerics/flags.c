// The floating point that everything else is proved under: IEEE arithmetic, float64 evaluated as
// float64, no contraction, denormals kept, rounding to nearest. Fails when a compiler flag, the
// start-up code or the environment changes one of them. Compiled also for a processor with FMA,
// where contraction becomes possible.
#include <fenv.h>
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>

#ifdef __FAST_MATH__
#error "compiled with -ffast-math"
#endif
#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "compiled with -ffinite-math-only"
#endif

static int failures;

static void expect(bool holds, const char *what) {
    printf("%s\t%s\n", what, holds ? "yes" : "NO");
    failures += !holds;
}

int main(void) {
#if defined(FLAGS_FMA) && defined(__x86_64__)
    if (!__builtin_cpu_supports("fma")) {
        printf("skipped: this processor has no FMA\n");
        return 77;
    }
#endif
    volatile double a = 1 + 0x1p-30, b = 1 - 0x1p-30, c = 1; // a b = 1 - 2^-60, rounded: 1
    volatile float af = 1 + 0x1p-13f, bf = 1 - 0x1p-13f, cf = 1;
    double x = a, y = b, z = c;
    float xf = af, yf = bf, zf = cf;
    expect(FLT_EVAL_METHOD == 0, "float and double are evaluated in their own precision");
    expect(x * y - z == 0 && xf * yf - zf == 0, "a * b - c is not contracted");
    expect(fma(x, y, -z) == -0x1p-60, "fma rounds once");
    volatile double big = 0x1p53, one = 1; // (2^53 + 1) - 2^53 = 0, 2^53 + (1 - 2^53) = 1
    double s = big, t = one;
    expect((s + t) - s == 0, "sums are not reordered");
    volatile double three = 3;
    double third = 1 / three;
    expect(third * 3 == 1 && 10 / three == 10.0 / 3, "division is not by reciprocals");
    volatile double smallest = DBL_MIN;
    volatile float smallest_f = FLT_MIN;
    double half = smallest / 2;
    float half_f = smallest_f / 2;
    expect(half > 0 && half * 2 == DBL_MIN, "float64 denormals are kept");
    expect(half_f > 0 && half_f * 2 == FLT_MIN, "fp32 denormals are kept");
    volatile double zero = 0;
    double nan = zero / zero;
    expect(nan != nan && isnan(nan) && !(nan <= 1), "NaN is told from numbers");
    expect(isinf(1 / zero) && signbit(-zero), "infinities and signed zeros exist");
    expect(fegetround() == FE_TONEAREST, "rounding is to nearest");
    volatile long double wide = 1;
    expect(LDBL_MANT_DIG < 64 || wide + 0x1p-63L != 1,
           "long double keeps 64 bits where it has them");
    return failures > 0;
}
