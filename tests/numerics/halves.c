// Case 3 where maps and features are stored in fp16, as the GPU's kernels have them: an emulator
// runs these (tests/ops). A number that is rounded to fp16 is off by 2^-11 of itself at most, or
// below 2^-14 by 2^-25.
#include <string.h>

#include "server/engine/field/ripmap.h"
#include "tests/numerics/subject_cuda.h"
#include "tests/support/numerics.h"

#define MOST_BASE 64
#define MOST_CHANNELS 16
#define QUERIES 64
#define FINE 4 // levels a side whose maps are made from the parameters themselves (cuda/layout.h)
#define HALF 0x1p-11

// A plane of random texels, its exact pyramid, and the device's.
struct plane {
    struct rn_field_config config;
    struct cuda_plane *device;
    float texels[MOST_BASE * MOST_BASE * MOST_CHANNELS];
};

static struct plane *make_plane(int base, int levels, int channels, bool mip, float low,
                                struct numerics_random *random) {
    struct plane *p = calloc(1, sizeof *p);
    if (!p) exit(1);
    p->config = (struct rn_field_config){.planes = 1,
                                         .base = base,
                                         .channels = channels,
                                         .levels = levels,
                                         .footprint = mip ? RN_FOOTPRINT_MIP : RN_FOOTPRINT_RIP};
    for (int i = 0; i < base * base * channels; i++)
        p->texels[i] = (float)numerics_uniform(random, (double)low, 1);
    p->device = cuda_plane_create(&p->config, p->texels);
    return p;
}

static void finish_plane(struct plane *p) {
    cuda_plane_destroy(&p->device);
    free(p);
}

// The exact mean of the base's texels that a map's texel covers, and the largest of them.
static double pooled(const struct plane *p, int lx, int ly, int x, int y, int channel,
                     double *ret_largest) {
    double sum = 0, largest = 0;
    for (int v = y << ly; v < (y + 1) << ly; v++)
        for (int u = x << lx; u < (x + 1) << lx; u++) {
            double t = (double)p->texels[(v * p->config.base + u) * p->config.channels + channel];
            sum += t;
            largest = fmax(largest, fabs(t));
        }
    if (ret_largest) *ret_largest = largest;
    return ldexp(sum, -lx - ly);
}

// What a case does with every plane there is.
#define FOR_PLANES(random, low)                                                                    \
    for (int kind = 0; kind < 12; kind++)                                                          \
        for (struct plane *p =                                                                     \
                 make_plane(16 << kind % 3, 2 + kind % 4, 4 << kind % 3, kind % 2, low, random);   \
             p; finish_plane(p), p = NULL)

// Rounded once from sums in fp32; above level 3 from maps that were rounded.
static int check_maps(struct numerics_random *random) {
    const char *range = "bases 16..64, 2..5 levels, rip and mip, 4 to 16 channels";
    struct numerics_case fine = {"3 ripmap maps in fp16, cuda",
                                 range,
                                 "2^-11 of the mean and 2^-22 of the largest texel",
                                 1,
                                 0,
                                 ""};
    struct numerics_case coarse = {"3 ripmap maps in fp16 above level 3, cuda",
                                   range,
                                   "2^-11 of the largest texel that is averaged",
                                   2,
                                   0,
                                   ""};
    FOR_PLANES(random, -1) {
        for (int ly = 0; ly < p->config.levels; ly++)
            for (int lx = 0; lx < p->config.levels; lx++) {
                if (!cuda_plane_has(p->device, lx, ly)) continue;
                bool once = lx < FINE && ly < FINE;
                int w = p->config.base >> lx, h = p->config.base >> ly;
                for (int i = 0; i < w * h; i++) {
                    double largest, truth = pooled(p, lx, ly, i % w, i / w, i % 4, &largest);
                    double got = cuda_plane_texel(p->device, lx, ly, i % w, i / w, i % 4);
                    double unit = once ? fabs(truth) * HALF + largest * 0x1p-22 : largest * HALF;
                    numerics_see(once ? &fine : &coarse, fabs(got - truth) / fmax(unit, 0x1p-25),
                                 "base %d, map %d %d, texel %d %d", p->config.base, lx, ly, i % w,
                                 i / w);
                }
            }
    }
    return numerics_close(&fine) + numerics_close(&coarse);
}

static struct cuda_query draw_query(const struct plane *p, struct numerics_random *random) {
    double top = p->config.levels - 1;
    struct cuda_query q = {
        (float)numerics_uniform(random, -1.1, 1.1), (float)numerics_uniform(random, -1.1, 1.1),
        (float)numerics_uniform(random, -1, top), (float)numerics_uniform(random, -1, top)};
    q.lx = fmaxf(q.lx, 0); // half of them and more where nothing is pooled
    q.ly = p->config.footprint == RN_FOOTPRINT_MIP ? q.lx : fmaxf(q.ly, 0);
    return q;
}

// Four texels of one map, each as `texel` has it.
typedef double texel_of(const struct plane *p, int lx, int ly, int x, int y, int channel);
static double exact_texel(const struct plane *p, int lx, int ly, int x, int y, int channel) {
    return pooled(p, lx, ly, x, y, channel, NULL);
}
static double stored_texel(const struct plane *p, int lx, int ly, int x, int y, int channel) {
    return cuda_plane_texel(p->device, lx, ly, x, y, channel);
}

// A query in float64 (field/ripmap.h).
static double query(const struct plane *p, const struct cuda_query *q, int channel,
                    texel_of *texel) {
    double sum = 0;
    bool mip = p->config.footprint == RN_FOOTPRINT_MIP;
    struct rn_lerp lx = rn_rip_level((double)q->lx, p->config.levels);
    struct rn_lerp ly = rn_rip_level((double)q->ly, p->config.levels);
    for (int corner = 0; corner < 4; corner++) {
        double weight = rn_rip_map_weight(&lx, &ly, mip, corner);
        int mx = corner & 1 ? lx.high : lx.low, my = corner & 2 ? ly.high : ly.low;
        if (!(weight > 0)) continue;
        struct rn_lerp x = rn_rip_lerp((double)q->u, p->config.base >> mx);
        struct rn_lerp y = rn_rip_lerp((double)q->v, p->config.base >> my);
        for (int k = 0; k < 4; k++) {
            double fx = k & 1 ? x.fraction : 1 - x.fraction;
            double fy = k & 2 ? y.fraction : 1 - y.fraction;
            if (fx * fy > 0)
                sum += weight * fx * fy *
                       texel(p, mx, my, k & 1 ? x.high : x.low, k & 2 ? y.high : y.low, channel);
        }
    }
    return sum;
}

// A fetch from the maps as they are stored; the feature beside the field that has no fp16 at all;
// and planes of ones.
static int check_fetch(struct numerics_random *random) {
    const char *range = "bases 16..64, rip and mip, 4 to 16 channels, any position and level";
    struct numerics_case fetch = {
        "3 ripmap fetch from fp16 maps, cuda", range, "ULP of base", 4, 0, ""};
    struct numerics_case feature = {
        "3 ripmap feature in fp16, cuda", range, "2^-11 of the largest texel", 2.25, 0, ""};
    struct numerics_case unity = {
        "3 ripmap query of ones, fp16 maps, cuda", range, "ULP", 4, 0, ""};
    FOR_PLANES(random, -1) {
        for (int n = 0; n < 300; n++) {
            struct cuda_query q = draw_query(p, random);
            float got[MOST_CHANNELS];
            int channel = n % p->config.channels;
            cuda_plane_fetch(p->device, &q, got);
            double stored = query(p, &q, channel, stored_texel);
            double exact = query(p, &q, channel, exact_texel);
            numerics_see(&fetch, fabs((double)got[channel] - stored) / (p->config.base * 0x1p-23),
                         "base %d u %.9g v %.9g levels %.9g %.9g", p->config.base, (double)q.u,
                         (double)q.v, (double)q.lx, (double)q.ly);
            numerics_see(&feature, fabs(cuda_feature(got[channel]) - exact) / HALF,
                         "base %d u %.9g v %.9g levels %.9g %.9g", p->config.base, (double)q.u,
                         (double)q.v, (double)q.lx, (double)q.ly);
        }
    }
    FOR_PLANES(random, 1) {
        for (int n = 0; n < 100; n++) {
            struct cuda_query q = draw_query(p, random);
            float got[MOST_CHANNELS];
            cuda_plane_fetch(p->device, &q, got);
            numerics_see(&unity, fabs((double)got[n % p->config.channels] - 1) * 0x1p23,
                         "base %d query %d", p->config.base, n);
        }
    }
    return numerics_close(&fetch) + numerics_close(&feature) + numerics_close(&unity);
}

// Queries that jump about, follow a line, stay where levels rise and the texel's place is the first
// of either map, or stay in the first of level 0.
enum style { JUMPS, LINE, CORNER, FIRST_TEXEL, STYLES };
static void draw_queries(const struct plane *p, struct numerics_random *random, enum style style,
                         struct cuda_query *q) {
    for (int i = 0; i < QUERIES; i++)
        q[i] = draw_query(p, random);
    struct cuda_query from = q[0], to = q[1];
    for (int i = 0; i < QUERIES && style == LINE; i++) {
        float s = (float)i / QUERIES;
        q[i] =
            (struct cuda_query){from.u + s * (to.u - from.u), from.v + s * (to.v - from.v),
                                from.lx + s * (to.lx - from.lx), from.ly + s * (to.ly - from.ly)};
    }
    float top = (float)(p->config.levels - 1);
    for (int i = 0; i < QUERIES && style >= CORNER; i++) {
        float level = style == CORNER ? fminf(2.01f + 2.0f * (float)i / QUERIES, top) : 0;
        float at = style == CORNER ? -0.7f : -0.98f;
        q[i] = (struct cuda_query){at, at, level, level};
    }
}

// <x, Q^T y> over all maps, and over their sizes; *ret_missed: texels with a gradient in blocks
// that the optimiser will not look at.
static double over_maps(const struct plane *p, bool fixed, int *ret_missed) {
    double sum = 0;
    for (int ly = 0; ly < p->config.levels; ly++)
        for (int lx = 0; lx < p->config.levels; lx++) {
            if (!cuda_plane_has(p->device, lx, ly)) continue;
            int w = p->config.base >> lx, h = p->config.base >> ly;
            for (int i = 0; i < w * h * p->config.channels; i++) {
                int channel = i % p->config.channels, x = i / p->config.channels % w;
                int y = i / p->config.channels / w;
                double g = cuda_plane_gradient(p->device, lx, ly, x, y, channel, fixed);
                sum += g * stored_texel(p, lx, ly, x, y, channel);
                for (int k = 0; k < 4 && g != 0; k++)
                    *ret_missed +=
                        !cuda_plane_is_touched(p->device, k & 1 ? ((x + 1) << lx) - 1 : x << lx,
                                               k & 2 ? ((y + 1) << ly) - 1 : y << ly);
            }
        }
    return sum;
}

// <Q x, y> = <x, Q^T y>: in fixed point, and in fp16, where every sum that is kept is rounded.
static int check_adjoint(struct numerics_random *random, bool fixed) {
    const char *range = "64 queries that jump, follow a line or stay, bases 16..64, rip and mip";
    struct numerics_case c = {
        "3 ripmap adjoint of the fetch, fp16 sums, cuda", range, "2^-11 of sum |x y|", 1, 0, ""};
    struct numerics_case blocks = {
        "3 ripmap gradients in blocks that are not visited, cuda", range, "texels", 0, 0, ""};
    if (fixed) {
        c.name = "3 ripmap adjoint of the fetch, fixed point, cuda";
        c.unit = "ULP of sum |x y|";
        c.bound = 16;
    }
    for (int style = 0; style < STYLES; style++)
        FOR_PLANES(random, -1) {
            struct cuda_query q[QUERIES];
            float grad[QUERIES * MOST_CHANNELS], got[MOST_CHANNELS];
            double forward = 0, scale = 0;
            int missed = 0, channels = p->config.channels;
            draw_queries(p, random, (enum style)style, q);
            for (int i = 0; i < QUERIES; i++) {
                cuda_plane_fetch(p->device, &q[i], got);
                for (int k = 0; k < channels; k++) {
                    bool last = i % 5 == 0 && k < channels - 1; // where only one channel has any
                    float g = grad[i * channels + k] =
                        last ? 0 : (float)numerics_uniform(random, -1, 1);
                    forward += (double)got[k] * (double)g;
                    scale += fabs((double)got[k] * (double)g);
                }
            }
            cuda_plane_scatter(p->device, QUERIES, q, grad, fixed);
            double backward = over_maps(p, fixed, &missed), unit = fixed ? 0x1p-23 : HALF;
            numerics_see(&c, fabs(forward - backward) / (scale * unit), "base %d, %d channels%s",
                         p->config.base, channels, kind % 2 ? ", mip" : "");
            numerics_see(&blocks, missed, "base %d, %d channels", p->config.base, channels);
        }
    return numerics_close(&c) + (fixed ? numerics_close(&blocks) : 0);
}

// Every fp16 number of a pixel, as its sign, exponent and fraction say; -0 keeps its sign, NaN is
// one.
static int check_numbers(void) {
    struct numerics_case c = {"3 pixels from fp16 without the instruction, cuda",
                              "all 65,536",
                              "numbers that are others",
                              0,
                              0,
                              ""};
    for (uint32_t half = 0; half < 0x10000; half++) {
        int exponent = half >> 10 & 31, fraction = half & 1023;
        double exact =
            ldexp(exponent > 0 ? 1024 + fraction : fraction, exponent > 0 ? exponent - 25 : -24);
        double got = (double)cuda_number_of_half(half);
        if (exponent == 31) exact = fraction ? NAN : INFINITY;
        bool same =
            isnan(exact) ? isnan(got) : fabs(got) == exact && !signbit(got) == !(half >> 15);
        numerics_see(&c, same ? 0 : 1, "%04x", (unsigned)half);
    }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    int failed = check_maps(&random) + check_fetch(&random) + check_numbers();
    failed += check_adjoint(&random, true) + check_adjoint(&random, false);
    return failed > 0;
}
