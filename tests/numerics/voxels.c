// Case 3: the voxel grid beside the planes. The kernel sets' query against float64, of constants
// and of places that are no numbers; and that adding gradients is its adjoint, cut into bands
// anywhere.
#include <float.h>
#include <string.h>

#include "server/engine/field/voxels.h"
#include "server/engine/reference/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

#define ROOM (SUBJECT_QUERIES + 16)
#define SIZES 4
static const int sizes[SIZES][2] = {{4, 4}, {33, 4}, {16, 8}, {64, 16}}; // base, channels

// A field of one plane and voxels, and gradients of the same shape.
struct grid {
    struct rn_field_config config;
    struct rn_cpu_field field;
    struct rn_map grads[1][RN_MAX_LEVELS];
    float *memory;
    uint8_t *touched;
    size_t numbers, used; // of the grid; of these the voxels'
};

static void make_grid(const int size[2], struct grid *g) {
    *g = (struct grid){.config = {.planes = 1,
                                  .voxels = true,
                                  .base = size[0],
                                  .channels = size[1],
                                  .levels = 1,
                                  .footprint = RN_FOOTPRINT_POINT},
                       .field = {.feature_stride = 32, .built_levels = 1}};
    const struct rn_field_config *c = g->field.config = &g->config;
    struct rn_tiling tiling = rn_tiling(c->base, c->channels, 1);
    size_t side = (size_t)rn_voxel_side(c);
    g->field.features = rn_feature_count(c);
    g->numbers = rn_grid_numbers(c);
    g->used = side * side * side * RN_VOXEL_CHANNELS;
    g->memory = calloc(3 * g->numbers + 64, sizeof(float));
    g->touched = calloc((size_t)tiling.columns * (size_t)tiling.rows, 1);
    if (!g->memory || !g->touched) exit(1);
    g->field.maps[0][0][0] = (struct rn_map){g->memory, c->base, c->base};
    g->field.maps[1][0][0] = (struct rn_map){g->memory + g->numbers, c->base, c->base};
    g->grads[0][0] = (struct rn_map){g->memory + 2 * g->numbers, c->base, c->base};
}

static void finish_grid(struct grid *g) {
    free(g->memory);
    free(g->touched);
}

static void fill(struct grid *g, float low, float high, struct numerics_random *random) {
    for (size_t i = 0; i < g->used; i++)
        g->memory[g->numbers + i] = (float)numerics_uniform(random, (double)low, (double)high);
}

// Places within the cube and a little beyond; every fifth lies on a voxel's centre or its edge.
struct places {
    float x[3][ROOM];
};
static void draw(const struct grid *g, struct places *at, struct numerics_random *random) {
    int side = rn_voxel_side(&g->config);
    for (int i = 0; i < SUBJECT_QUERIES; i++)
        for (int k = 0; k < 3; k++)
            at->x[k][i] =
                (float)(i % 5 ? numerics_uniform(random, -1.05, 1.05)
                              : (int)numerics_uniform(random, 0, 2 * side + 1) / (double)side - 1);
}

static void query(const struct subject *s, const struct grid *g, struct places *at,
                  float ret[SUBJECT_QUERIES * RN_VOXEL_CHANNELS]) {
    float *place[3] = {at->x[0], at->x[1], at->x[2]};
    s->voxels(&g->field, SUBJECT_QUERIES, place, ret);
}

// Against float64; a constant; and places that are no numbers, which read some voxel.
static int check_query(const struct subject *s, struct numerics_random *random) {
    static const float wild[] = {NAN, INFINITY, -INFINITY, FLT_MAX, -FLT_MAX, FLT_TRUE_MIN};
    char names[3][80];
    const char *const what[] = {"query against float64", "query of a constant",
                                "query at places that are no numbers"};
    const char *const range = "sides 2..40, texels of 4 to 16 channels";
    struct numerics_case cases[3];
    for (int i = 0; i < 3; i++)
        snprintf(names[i], sizeof names[i], "3 voxels: %s, %s", what[i], s->name);
    cases[0] =
        (struct numerics_case){names[0], range, "ULP of the side times the largest", 2, 0, ""};
    cases[1] = (struct numerics_case){names[1], range, "ULP", 0, 0, ""};
    cases[2] = (struct numerics_case){names[2], range, "beyond the voxels", 1e-6, 0, ""};
    float found[SUBJECT_QUERIES * RN_VOXEL_CHANNELS];
    for (int n = 0; n < SIZES; n++) {
        struct places at;
        struct grid g;
        make_grid(sizes[n], &g);
        int side = rn_voxel_side(&g.config);
        fill(&g, -1, 1, random);
        draw(&g, &at, random);
        query(s, &g, &at, found);
        for (int i = 0; i < SUBJECT_QUERIES; i++) {
            double exact[RN_VOXEL_CHANNELS];
            rn_exact_voxels(&g.field, (const double[3]){at.x[0][i], at.x[1][i], at.x[2][i]}, exact);
            for (int c = 0; c < RN_VOXEL_CHANNELS; c++)
                numerics_see(&cases[0],
                             fabs((double)found[i * RN_VOXEL_CHANNELS + c] - exact[c]) /
                                 (side * FLT_EPSILON),
                             "side %d at %.9g %.9g %.9g", side, (double)at.x[0][i],
                             (double)at.x[1][i], (double)at.x[2][i]);
        }
        for (int i = 0; i < SUBJECT_QUERIES; i++)
            at.x[i % 3][i] = wild[i / 3 % 6];
        query(s, &g, &at, found);
        for (int i = 0; i < SUBJECT_QUERIES * RN_VOXEL_CHANNELS; i++)
            numerics_see(&cases[2], isfinite(found[i]) ? fabs((double)found[i]) - 1 : INFINITY,
                         "side %d, place %d", side, i / RN_VOXEL_CHANNELS);
        float one = (float)numerics_uniform(random, 0.5, 1);
        fill(&g, one, one, random);
        draw(&g, &at, random);
        query(s, &g, &at, found);
        for (int i = 0; i < SUBJECT_QUERIES * RN_VOXEL_CHANNELS; i++)
            numerics_see(&cases[1], fabs((double)(found[i] - one)) / ((double)one * FLT_EPSILON),
                         "side %d, place %d", side, i / RN_VOXEL_CHANNELS);
        finish_grid(&g);
    }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]) + numerics_close(&cases[2]);
}

// Adds gradients band by band: rows [0, middle), then the rest; no number is added to whose tile is
// not marked.
static bool scatter(const struct rn_kernels *kernels, struct grid *g, struct places *at,
                    float *grad, int middle) {
    const struct rn_field_config *c = &g->config;
    struct rn_tiling tiling = rn_tiling(c->base, c->channels, 1);
    struct rn_slab slab = {.count = SUBJECT_QUERIES, .capacity = ROOM, .voxel_grad = grad};
    bool marked = true;
    for (int k = 0; k < 3; k++)
        slab.voxel[k] = at->x[k];
    kernels->scatter(&g->field, &slab, 1, 1, 0, middle, g->grads, g->touched);
    kernels->scatter(&g->field, &slab, 1, 1, middle, c->base, g->grads, g->touched);
    for (size_t i = 0; i < g->numbers; i++) {
        size_t row = i / (size_t)(c->base * c->channels),
               in_row = i % (size_t)(c->base * c->channels);
        size_t tile = in_row / (size_t)c->channels >> tiling.shift_x;
        if (g->grads[0][0].texels[i] != 0)
            marked &= g->touched[row * (size_t)tiling.columns + tile] != 0;
    }
    return marked;
}

static int check_adjoint(const struct subject *s, const struct rn_kernels *kernels,
                         struct numerics_random *random) {
    char names[2][80];
    const char *const range = "sides 2..40, cut into two bands at every eighth row";
    snprintf(names[0], sizeof names[0], "3 voxels: adjoint of the query, %s", s->name);
    snprintf(names[1], sizeof names[1], "3 voxels: tiles that are not marked, %s", s->name);
    struct numerics_case cases[2] = {{names[0], range, "ULP of sum |x y|", 16, 0, ""},
                                     {names[1], range, "grids", 0, 0, ""}};
    float found[SUBJECT_QUERIES * RN_VOXEL_CHANNELS], grad[ROOM * RN_VOXEL_CHANNELS];
    for (int n = 0; n < SIZES; n++)
        for (int middle = 0; middle <= sizes[n][0]; middle += 8) {
            double forward = 0, backward = 0, size = 0;
            struct places at;
            struct grid g;
            make_grid(sizes[n], &g);
            fill(&g, 0, 1, random);
            draw(&g, &at, random);
            query(s, &g, &at, found);
            for (int i = 0; i < SUBJECT_QUERIES * RN_VOXEL_CHANNELS; i++) {
                grad[i] = (float)numerics_uniform(random, -1, 1);
                forward += (double)grad[i] * (double)found[i];
                size += fabs((double)grad[i] * (double)found[i]);
            }
            bool marked = scatter(kernels, &g, &at, grad, middle);
            for (size_t i = 0; i < g.numbers; i++)
                backward += (double)g.grads[0][0].texels[i] * (double)g.memory[g.numbers + i];
            numerics_see(&cases[0], fabs(forward - backward) / (size * FLT_EPSILON),
                         "base %d, bands meet at row %d", sizes[n][0], middle);
            numerics_see(&cases[1], !marked, "base %d", sizes[n][0]);
            finish_grid(&g);
        }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

// Every voxel of one colour against long double, the other colour as it was; and the range, which
// no voxel leaves.
static void see_smoothed(struct numerics_case cases[2], const float *before, const float *after,
                         int side, int odd, float share) {
    for (int i = 0; i < side * side * side * RN_VOXEL_CHANNELS; i++) {
        int c = i % RN_VOXEL_CHANNELS, voxel = i / RN_VOXEL_CHANNELS;
        int at[3] = {voxel % side, voxel / side % side, voxel / side / side};
        int step[3] = {1, side, side * side};
        long double own = before[i], sum = own;
        double most = fabs((double)own);
        for (int k = 0; k < 6 && (at[0] + at[1] + at[2]) % 2 == odd; k++) {
            int next = at[k / 2] + (k % 2 ? 1 : -1);
            bool inside = next >= 0 && next < side;
            int near = voxel + (inside ? (k % 2 ? 1 : -1) * step[k / 2] : 0);
            long double value = before[near * RN_VOXEL_CHANNELS + c];
            sum += share * (value - own);
            most = fmax(most, fabs((double)value));
        }
        numerics_see(&cases[0], (double)fabsl(after[i] - sum) / (most * FLT_EPSILON),
                     "side %d, voxel %d, share %g", side, voxel, (double)share);
        numerics_see(&cases[1], fabs((double)after[i]) - 1, "side %d, voxel %d, share %g", side,
                     voxel, (double)share);
    }
}

static int check_smoothing(const struct subject *s, const struct rn_kernels *kernels,
                           struct numerics_random *random) {
    char names[2][80];
    const char *const range = "sides 2..40, shares up to 1/6";
    snprintf(names[0], sizeof names[0], "3 voxels: smoothing, %s", s->name);
    snprintf(names[1], sizeof names[1], "3 voxels: smoothing leaves the range, %s", s->name);
    struct numerics_case cases[2] = {{names[0], range, "ULP of the largest", 8, 0, ""},
                                     {names[1], range, "beyond", 1e-6, 0, ""}};
    for (int n = 0; n < SIZES; n++)
        for (int turn = 0; turn < 4; turn++) {
            struct grid g;
            make_grid(sizes[n], &g);
            int side = rn_voxel_side(&g.config), odd = turn % 2;
            float share = turn < 2 ? 1.0f / 6 : (float)numerics_uniform(random, 0, 1.0 / 6);
            fill(&g, -1, 1, random);
            float *voxels = g.memory + g.numbers, *before = g.memory + 2 * g.numbers;
            memcpy(before, voxels, g.numbers * sizeof *before);
            for (int z = 0; z < side; z++)
                kernels->smooth_voxels(voxels, side, z, odd, share);
            see_smoothed(cases, before, voxels, side, odd, share);
            finish_grid(&g);
        }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

int main(void) {
    struct numerics_random random = numerics_random();
    int failed = 0;
    for (int i = 0; subject_at(i); i++) {
        const struct subject *s = subject_at(i);
        if (!s->voxels) continue;
        failed += check_query(s, &random);
        failed += check_adjoint(s, rn_kernels_find(s->name), &random);
        failed += check_smoothing(s, rn_kernels_find(s->name), &random);
    }
    return failed > 0;
}
