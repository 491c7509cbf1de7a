// Cases 3, 9 and 11: planes that grow during training. What the larger planes hold against long
// double, what the field's values may change by, moments that stay moments, and numbers that are
// not finite just before and after. (Same bytes across a growth: reproducible.c.)
#include "server/engine/field/voxels.h"
#include "server/engine/reference/reference.h"
#include "server/engine/train/grow.h"
#include "tests/numerics/trainer.h"

#define SIZES 6
// From, to, and the step at which that much is wanted (the last growth comes at 35 % of 60 steps).
static const int sizes[SIZES][3] = {{16, 32, 22}, {24, 96, 22}, {24, 48, 7},
                                    {40, 80, 22}, {33, 66, 22}, {64, 128, 22}};

static struct rn_trainer *make_growing(struct rn_engine *engine, const struct rn_dataset *dataset,
                                       int n) {
    struct rn_error err = {0};
    struct rn_train_config config;
    struct rn_trainer *t;
    must(rn_preset("standard", false, &config, &err), &err);
    config.field.base = sizes[n][0];
    config.grow_to = sizes[n][2] == 7 ? 2 * sizes[n][1] : sizes[n][1];
    config.field.channels = 4;
    config.field.occupancy = 16;
    config.max_seconds = 0;
    config.max_steps = STEPS;
    must(rn_trainer_create(engine, dataset, &config, 0, &t, &err), &err);
    return t;
}

// Parameters and moments as they were, and the field as the float64 reference has it.
struct old {
    float *numbers[3];
    int base;
    struct rn_reference *reference;
};

static struct rn_reference *reference_of(const struct rn_trainer *t) {
    struct rn_error err = {0};
    struct rn_reference *reference;
    must(rn_reference_create(&t->field->config.field, 1, &reference, &err), &err);
    for (size_t i = 0; i < reference->plane_count; i++)
        reference->planes[i] = (double)t->field->parameters.values[i];
    rn_reference_build(reference);
    return reference;
}

// Random numbers of any size with |m| <= sqrt(v), as AdamW's are; grown.
static struct old grow(struct rn_trainer *t, int n, bool constant, struct numerics_random *random) {
    const struct rn_parameters *p = &t->field->parameters;
    struct old old = {.base = t->field->config.field.base};
    double level = numerics_uniform(random, -1, 1);
    for (size_t i = 0; i < p->count; i++) {
        double v = numerics_spread(random, 1e-30, 1e6);
        p->values[i] = (float)(constant ? level : numerics_uniform(random, -1, 1));
        t->optimiser.m[i] = (float)(numerics_uniform(random, -1, 1) * sqrt(v));
        t->optimiser.v[i] = (float)v;
    }
    float *now[3] = {p->values, t->optimiser.m, t->optimiser.v};
    for (int k = 0; k < 3; k++) {
        old.numbers[k] = malloc(p->count * sizeof(float));
        if (!old.numbers[k]) exit(1);
        memcpy(old.numbers[k], now[k], p->count * sizeof(float));
    }
    old.reference = reference_of(t);
    t->progress.step = sizes[n][2];
    struct rn_error err = {0};
    must(rn_trainer_grow(t, &err), &err);
    if (t->field->config.field.base != sizes[n][1]) {
        fprintf(stderr, "grown to %d, not %d\n", t->field->config.field.base, sizes[n][1]);
        exit(1);
    }
    return old;
}

static void finish_old(struct old *old) {
    for (int k = 0; k < 3; k++)
        free(old->numbers[k]);
    rn_reference_destroy(&old->reference);
}

// ---- what the larger planes hold --------------------------------------------------------------

// Bilinear at texel centres, in long double; *ret_most is the largest texel that enters.
static long double enlarged(const float *plane, int base, int channels, int side, int x, int y,
                            int channel, double *ret_most) {
    long double at[2] = {(x + 0.5L) * base / side - 0.5L, (y + 0.5L) * base / side - 0.5L}, sum = 0;
    int low[2];
    for (int i = 0; i < 2; i++) {
        at[i] = fminl(fmaxl(at[i], 0), base - 1);
        low[i] = (int)at[i];
    }
    *ret_most = 0;
    for (int corner = 0; corner < 4; corner++) {
        int column = low[0] + corner % 2, row = low[1] + corner / 2;
        if (column == base || row == base) continue; // of no weight
        float texel = plane[(row * base + column) * channels + channel];
        long double wx = 1 - fabsl(at[0] - column), wy = 1 - fabsl(at[1] - row);
        sum += wx * wy * texel;
        if (wx * wy > 0) *ret_most = fmax(*ret_most, fabs((double)texel));
    }
    return sum;
}

// Trilinear at voxels' centres, likewise.
static long double enlarged_voxel(const float *voxels, int old, int side, size_t voxel, int channel,
                                  double *ret_most) {
    int at[3] = {(int)voxel % side, (int)voxel / side % side, (int)voxel / side / side}, low[3];
    long double weight[3], sum = 0;
    for (int i = 0; i < 3; i++) {
        long double p = fminl(fmaxl((at[i] + 0.5L) * old / side - 0.5L, 0), old - 1);
        low[i] = (int)p;
        weight[i] = p - low[i];
    }
    *ret_most = 0;
    for (int corner = 0; corner < 8; corner++) {
        size_t from = 0;
        long double w = 1;
        for (int i = 2; i >= 0; i--) {
            bool next = corner >> i & 1;
            w *= next ? weight[i] : 1 - weight[i];
            from = from * (size_t)old + (size_t)(low[i] + (next && low[i] + 1 < old));
        }
        if (!(w > 0)) continue;
        float value = voxels[from * RN_VOXEL_CHANNELS + (size_t)channel];
        sum += w * value;
        *ret_most = fmax(*ret_most, fabs((double)value));
    }
    return sum;
}

struct planes_cases {
    struct numerics_case texels, moments, voxels, ratio, sum, networks;
};

// What the voxels hold against long double; what lies behind them is zero.
static void see_voxels(struct planes_cases *cases, const struct rn_trainer *t,
                       const struct old *old) {
    const struct rn_field_config *c = &t->field->config.field;
    struct rn_field_config before = *c;
    before.base = old->base;
    const float *now[3] = {t->field->parameters.values, t->optimiser.m, t->optimiser.v};
    size_t from = (size_t)c->planes * rn_grid_numbers(&before);
    size_t to = (size_t)c->planes * rn_grid_numbers(c);
    int old_side = rn_voxel_side(&before), side = rn_voxel_side(c);
    for (int k = 0; k < 3; k++)
        for (size_t i = 0; i < rn_grid_numbers(c); i++) {
            size_t voxel = i / RN_VOXEL_CHANNELS;
            double most = 1, scale = pow((double)old_side / side, 3 * k);
            bool within = voxel < (size_t)side * (size_t)side * (size_t)side;
            long double truth =
                within ? scale * enlarged_voxel(old->numbers[k] + from, old_side, side, voxel,
                                                (int)(i % RN_VOXEL_CHANNELS), &most)
                       : 0;
            double error = (double)fabsl(now[k][to + i] - truth) / (scale * most * 0x1p-23);
            numerics_see(&cases->voxels, error, "%d to %d, number %zu of array %d", old_side, side,
                         i, k);
        }
}

static void see_planes(struct planes_cases *cases, const struct rn_trainer *t,
                       const struct old *old) {
    const struct rn_field_config *c = &t->field->config.field;
    const struct rn_parameters *p = &t->field->parameters;
    const float *now[3] = {p->values, t->optimiser.m, t->optimiser.v};
    size_t old_plane = (size_t)(old->base * old->base * c->channels);
    size_t old_grids = (size_t)rn_grid_count(c) * old_plane;
    size_t planes = (size_t)c->planes * rn_grid_numbers(c);
    double share = (double)(old->base * old->base) / (c->base * c->base), sum = 0, size = 0;
    for (int k = 0; k < 3; k++)
        for (size_t i = 0; i < planes; i++) {
            int channel = (int)i % c->channels, x = (int)(i / (size_t)c->channels) % c->base;
            int y = (int)(i / (size_t)(c->channels * c->base)) % c->base;
            size_t plane = i / (size_t)(c->channels * c->base * c->base);
            double most, scale = k == 0 ? 1 : k == 1 ? share : share * share;
            long double truth = scale * enlarged(old->numbers[k] + plane * old_plane, old->base,
                                                 c->channels, c->base, x, y, channel, &most);
            double error = (double)fabsl(now[k][i] - truth) / (scale * most * 0x1p-23);
            numerics_see(k == 0 ? &cases->texels : &cases->moments, error,
                         "%d to %d, texel %d %d, %g", old->base, c->base, x, y, (double)truth);
        }
    for (size_t i = 0; i < planes; i++) {
        numerics_see(&cases->ratio,
                     fabs((double)t->optimiser.m[i]) / sqrt((double)t->optimiser.v[i]), "%d to %d",
                     old->base, c->base);
        sum += (double)t->optimiser.m[i];
    }
    for (size_t i = 0; i < (size_t)c->planes * old_plane; i++) {
        sum -= (double)old->numbers[1][i];
        size += fabs((double)old->numbers[1][i]);
    }
    numerics_see(&cases->sum, fabs(sum) / (size * 0x1p-23), "%d to %d", old->base, c->base);
    for (int k = 0; k < 3; k++)
        numerics_see(&cases->networks,
                     memcmp(now[k] + p->plane_count, old->numbers[k] + old_grids,
                            (p->base_count + p->head_count) * sizeof(float)) != 0,
                     "%d to %d", old->base, c->base);
}

// Numbers of the planes and of the voxels, without the zeros behind them.
static size_t used_numbers(const struct rn_trainer *t) {
    const struct rn_field_config *c = &t->field->config.field;
    size_t side = (size_t)rn_voxel_side(c);
    return (size_t)c->planes * rn_grid_numbers(c) + side * side * side * RN_VOXEL_CHANNELS;
}

static int check_planes(struct rn_engine *engine, const struct rn_dataset *dataset,
                        struct numerics_random *random) {
    const char *range = "16..64 texels doubled once or twice, moments 1e-30..1e6";
    struct planes_cases cases = {
        {"3 growth: texels against long double", range, "ULP of the largest texel", 3, 0, ""},
        {"3 growth: moments against long double", range, "ULP of the largest moment", 4, 0, ""},
        {"3 growth: voxels and their moments against long double",
         "grids beside planes of 16..64 texels", "ULP of the largest", 6, 0, ""},
        {"3 growth: |m| / sqrt(v), at most 1 before", range, "absolute", 1.00001, 0, ""},
        {"3 growth: sum of the first moments", range, "ULP of the sum of sizes", 1, 0, ""},
        {"3 growth: networks and their moments", range, "bytes differ", 0, 0, ""}};
    struct numerics_case unity = {
        "3 growth: constant planes stay as they are", range, "absolute", 0, 0, ""};
    for (int n = 0; n < SIZES; n++)
        for (int constant = 0; constant < 2; constant++) {
            struct rn_trainer *t = make_growing(engine, dataset, n);
            struct old old = grow(t, n, constant, random);
            see_planes(&cases, t, &old);
            see_voxels(&cases, t, &old);
            for (size_t i = 0; i < used_numbers(t) && constant; i++)
                numerics_see(
                    &unity,
                    fabs((double)t->field->parameters.values[i] - (double)old.numbers[0][0]),
                    "%d to %d", old.base, t->field->config.field.base);
            finish_old(&old);
            rn_trainer_destroy(&t);
        }
    return numerics_close(&cases.texels) + numerics_close(&cases.moments) +
           numerics_close(&cases.voxels) + numerics_close(&cases.ratio) +
           numerics_close(&cases.sum) + numerics_close(&cases.networks) + numerics_close(&unity);
}

// ---- continuity -------------------------------------------------------------------------------

// The largest second difference along u, along v, and of one of the other, over a plane whose edge
// texels repeat outside.
static void second_differences(const struct rn_reference *r, int plane, double ret[3]) {
    int base = r->config.base, channels = r->config.channels;
    const double *texels = r->planes + (size_t)(plane * base * base * channels);
    for (int i = 0; i < base * base * channels; i++) {
        int c = i % channels, x = i / channels % base, y = i / channels / base;
        double row[3], at[3][3];
        for (int k = 0; k < 9; k++) {
            int u = x + k % 3 - 1, v = y + k / 3 - 1;
            u = u < 0 ? 0 : u < base ? u : base - 1;
            v = v < 0 ? 0 : v < base ? v : base - 1;
            at[k / 3][k % 3] = texels[(v * base + u) * channels + c];
        }
        for (int k = 0; k < 3; k++)
            row[k] = at[k][0] - 2 * at[k][1] + at[k][2];
        ret[0] = fmax(ret[0], fabs(row[1]));
        ret[1] = fmax(ret[1], fabs(at[0][1] - 2 * at[1][1] + at[2][1]));
        ret[2] = fmax(ret[2], fabs(row[0] - 2 * row[1] + row[2]));
    }
}

// A doubling changes no value of a footprint by more than (|D_u| + |D_v|) / 8 + |D_u D_v| / 64, D
// the largest second differences of the texels: linear interpolation between samples a quarter of a
// texel off, and the mean of a pair of them, are both at most an eighth of one away. A footprint
// of level l has level l + 1 on the larger grid; one below a texel stays at level 0.
static int check_continuity(struct rn_engine *engine, const struct rn_dataset *dataset,
                            struct numerics_random *random) {
    struct numerics_case c = {"3 growth: values of the field before and after",
                              "any position, footprints of 1/4 texel to half the scene",
                              "of (|D_u| + |D_v|) / 8 + |D_u D_v| / 64",
                              1.000001,
                              0,
                              ""};
    for (int n = 0; n < SIZES; n++) {
        if (sizes[n][1] != 2 * sizes[n][0]) continue;
        struct rn_trainer *t = make_growing(engine, dataset, n);
        struct old old = grow(t, n, false, random);
        struct rn_reference *grown = reference_of(t);
        for (int q = 0; q < 4000; q++) {
            int plane = q % grown->config.planes, levels = 0;
            double d[3] = {0}, value[2][4], at[4];
            while (sizes[n][0] >> (levels + 1) && sizes[n][0] % (2 << levels) == 0)
                levels++;
            if (q < grown->config.planes || q % 500 == 0)
                second_differences(old.reference, plane, d);
            static double bound[RN_MAX_PLANES];
            if (d[0] > 0) bound[plane] = (d[0] + d[1]) / 8 + d[2] / 64;
            for (int i = 0; i < 4; i++)
                at[i] = i < 2        ? numerics_uniform(random, -1.05, 1.05)
                        : q % 3 == 0 ? (int)numerics_uniform(random, -2, levels + 1)
                                     : numerics_uniform(random, -2, levels);
            rn_reference_query(old.reference, plane, at[0], at[1], fmax(at[2], 0), fmax(at[3], 0),
                               value[0]);
            rn_reference_query(grown, plane, at[0], at[1], fmax(at[2] + 1, 0), fmax(at[3] + 1, 0),
                               value[1]);
            for (int i = 0; i < 4; i++)
                numerics_see(&c, (fabs(value[1][i] - value[0][i]) - 0x1p-20) / bound[plane],
                             "%d to %d, u %.9g v %.9g levels %.3g %.3g", sizes[n][0], sizes[n][1],
                             at[0], at[1], at[2], at[3]);
        }
        rn_reference_destroy(&grown);
        finish_old(&old);
        rn_trainer_destroy(&t);
    }
    return numerics_close(&c);
}

// ---- numbers that are not finite ----------------------------------------------------------------

// Planted in the step before the planes grow, in the one that begins with it, and right after.
static int check_planted(struct rn_engine *engine, const struct rn_dataset *dataset,
                         struct numerics_random *random) {
    struct numerics_case c = {"9 non-finite numbers left where planes grow",
                              "seven kinds planted before and after step 21 of 60",
                              "numbers",
                              0.5,
                              0,
                              ""};
    for (int what = 0; what < PLANTS; what++)
        for (int step = 20; step <= 22; step++) {
            struct rn_trainer *t = make_trainer(engine, dataset, 1);
            while (t->progress.step < step)
                advance(t);
            plant(t, what, random);
            while (advance(t))
                continue;
            // A slope that is planted just before goes with the gradients of the old planes.
            bool good = t->progress.step == STEPS &&
                        t->progress.rollbacks == !(what == 3 && step == 21) &&
                        t->field->config.field.base == t->field->config.grow_to;
            numerics_see(&c, good ? count_left(engine, t) : INFINITY,
                         "%s at step %d, %d rollbacks, base %d", plant_names[what], step,
                         (int)t->progress.rollbacks, t->field->config.field.base);
            rn_trainer_destroy(&t);
        }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    struct rn_engine_options options = {.device = "cpu", .threads = 1};
    struct rn_engine *engine;
    struct rn_error err = {0};
    if (!mkdtemp(folder)) return 1;
    must(rn_engine_create(&options, &engine, &err), &err);
    struct rn_dataset *dataset = read_views(6);
    int failed = check_planes(engine, dataset, &random);
    failed += check_continuity(engine, dataset, &random);
    failed += check_planted(engine, dataset, &random);
    rn_dataset_destroy(&dataset);
    rn_engine_destroy(&engine);
    must(rn_remove_tree(folder, &err), &err);
    return failed > 0;
}
