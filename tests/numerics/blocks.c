// Case 3: planes in few bits. What a block's values come back as, against float64, and the halves
// that its low end and step are kept as.
#include "common/math/half.h"
#include "server/engine/checkpoint/blocks.h"
#include "tests/support/numerics.h"

#include <float.h>
#include <string.h>

#define BLOCKS 4000

// Values of one size around one level; some blocks constant, some with one value far off.
static void draw_block(struct numerics_random *random, int n, float values[RN_BLOCK_VALUES]) {
    double size = numerics_spread(random, 1e-7, 1e3);
    double level = n % 3 ? numerics_uniform(random, -1, 1) * numerics_spread(random, 1e-6, 6e4) : 0;
    for (int i = 0; i < RN_BLOCK_VALUES; i++) {
        double value = level + (n % 7 ? size * numerics_uniform(random, -1, 1) : 0);
        if (n % 5 == 0 && i == n % RN_BLOCK_VALUES) value = -level;
        values[i] = (float)fmin(fmax(value, -65504), 65504);
    }
}

static double half_ulp(double value) {
    return ldexp(0.5, ilogb(fmax(fabs(value), FLT_MIN)) - 23);
}

static int check_blocks(struct numerics_random *random) {
    const char *range = "sizes 1e-7..1e3 around levels up to 65504, 4 to 8 bits";
    struct numerics_case off = {"3 few bits: values, but for the rounding to fp32",
                                range,
                                "steps",
                                0.5 * (1 + 1e-9),
                                0,
                                ""};
    struct numerics_case reach = {"3 few bits: steps over the least that reach the values",
                                  "steps above 2^-14",
                                  "times",
                                  1.002,
                                  0,
                                  ""};
    float values[RN_BLOCK_VALUES], again[RN_BLOCK_VALUES];
    uint8_t codes[RN_BLOCK_VALUES];
    for (int n = 0; n < BLOCKS; n++) {
        int bits = 4 + n % 5;
        uint16_t low, step;
        draw_block(random, n, values);
        rn_block_pack(values, bits, codes, &low, &step);
        rn_block_unpack(codes, bits, low, step, again);
        double size = (double)rn_half_to_float(step), from = (double)rn_half_to_float(low),
               most = from;
        for (int i = 0; i < RN_BLOCK_VALUES; i++) {
            double error = fabs((double)values[i] - (double)again[i]) - half_ulp((double)again[i]);
            numerics_see(&off, error / size, "%.9g of a block from %.9g, %d bits",
                         (double)values[i], from, bits);
            most = fmax(most, (double)values[i]);
        }
        double least = (most - from) / ((1 << bits) - 1);
        if (least > 0x1p-14)
            numerics_see(&reach, size / least, "%.9g to %.9g, %d bits", from, most, bits);
    }
    return numerics_close(&off) + numerics_close(&reach);
}

// Every texel of planes whose sides are no multiple of a block's.
static int check_planes(struct numerics_random *random) {
    enum { BASE = 33, CHANNELS = 3, PLANES = 2, COUNT = PLANES * BASE * BASE * CHANNELS };
    static float planes[COUNT], again[COUNT];
    const struct rn_field_config config = {.planes = PLANES, .base = BASE, .channels = CHANNELS};
    struct rn_blocks blocks = {.count = rn_blocks_count(&config)};
    struct numerics_case c = {"3 few bits: planes of 33 texels a side",
                              "within -1..1, 4 to 8 bits",
                              "steps of 2 / (2^bits - 1)",
                              0.501,
                              0,
                              ""};
    blocks.codes = malloc(blocks.count * RN_BLOCK_VALUES);
    blocks.low = malloc(blocks.count * sizeof *blocks.low);
    blocks.step = malloc(blocks.count * sizeof *blocks.step);
    if (!blocks.codes || !blocks.low || !blocks.step) exit(1);
    for (blocks.bits = 4; blocks.bits <= RN_BLOCK_BITS_MAX; blocks.bits++) {
        for (int i = 0; i < COUNT; i++) {
            planes[i] = (float)numerics_uniform(random, -1, 1);
            again[i] = NAN;
        }
        rn_blocks_pack(&config, planes, &blocks);
        rn_blocks_unpack(&config, &blocks, again);
        for (int i = 0; i < COUNT; i++)
            numerics_see(&c,
                         fabs((double)planes[i] - (double)again[i]) * ((1 << blocks.bits) - 1) / 2,
                         "texel %d, %d bits", i, blocks.bits);
    }
    free(blocks.codes);
    free(blocks.low);
    free(blocks.step);
    return numerics_close(&c);
}

// A half's value by its definition.
static double value_of(unsigned half) {
    int exponent = (int)(half >> 10 & 31), fraction = (int)(half & 1023);
    double size = exponent ? ldexp(1024 + fraction, exponent - 25) : ldexp(fraction, -24);
    return half & 0x8000 ? -size : size;
}

static int check_halves(struct numerics_random *random) {
    struct numerics_case exact = {
        "3 halves: their values", "all 63,488 finite ones", "differ", 0, 0, ""};
    struct numerics_case nearest = {
        "3 halves: the nearest", "2^-26..65504 of both signs", "ULP of a half", 0.5, 0, ""};
    struct numerics_case sides = {
        "3 halves: the one below, the one above", "2^-26..65504 of both signs", "wrong", 0, 0, ""};
    for (unsigned half = 0; half < 0x10000; half++) {
        if (!rn_half_is_finite((uint16_t)half)) continue;
        double value = (double)rn_half_to_float((uint16_t)half);
        bool same = value == value_of(half) && (signbit(value) != 0) == (half >> 15 != 0) &&
                    rn_half_nearest((float)value) == half;
        numerics_see(&exact, !same, "%#x", half);
    }
    for (int n = 0; n < 200000; n++) {
        float x = (float)numerics_spread(random, 0x1p-26, 65504);
        if (n % 2) x = -x;
        if (n % 16 == 0) // halfway between two
            x = (float)(0.5 *
                        (value_of((unsigned)n % 0x7bff) + value_of((unsigned)n % 0x7bff + 1)));
        double ulp = ldexp(1, (int)fmax(ilogb((double)x), -14) - 10);
        unsigned half = rn_half_nearest(x);
        numerics_see(&nearest, fabs(value_of(half) - (double)x) / ulp, "%.9g", (double)x);
        bool even = fabs(value_of(half) - (double)x) < 0.5 * ulp || !(half & 1);
        double below = value_of(rn_half_below(x)), above = value_of(rn_half_above(x));
        bool good = even && below <= (double)x && above >= (double)x && above - below <= ulp;
        numerics_see(&sides, !good, "%.9g", (double)x);
    }
    return numerics_close(&exact) + numerics_close(&nearest) + numerics_close(&sides);
}

int main(void) {
    struct numerics_random random = numerics_random();
    int failed = check_blocks(&random);
    failed += check_planes(&random);
    failed += check_halves(&random);
    return failed != 0;
}
