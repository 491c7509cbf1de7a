// Case 3: the ripmap's pooling and its query.
#include <float.h>
#include <string.h>

#include "server/engine/reference/reference.h"
#include "server/engine/scene/scene.h"
#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

#define MOST 512
#define COARSER(size) ((size) > 1 ? (size) / 2 : 1)

static double unit_of(const struct subject *s) {
    return ldexp(1, 1 - s->digits);
}

// Tap weights against the overlap of the texel with the box of size / m texels that pooled texel
// i covers; their sum; and the sum of all weights that a texel gives away (constant planes keep
// their mean).
static int check_taps(const struct subject *s) {
    char names[3][80];
    const char *const what[] = {"tap weights", "taps sum to 1", "texels count alike"};
    struct numerics_case cases[3];
    for (int i = 0; i < 3; i++) {
        snprintf(names[i], sizeof names[i], "3 ripmap %s, %s", what[i], s->name);
        cases[i] = (struct numerics_case){names[i], "every texel, sizes 1..512", "ULP", 1, 0, ""};
    }
    for (int size = 1; size <= MOST; size++) {
        double given[MOST] = {0}, weight[3];
        int m = COARSER(size);
        for (int i = 0; i < m; i++) {
            int first, count = s->taps(size, i, &first, weight);
            double sum = 0;
            for (int t = 0; t < count; t++) {
                int low = (first + t) * m > i * size ? (first + t) * m : i * size;
                int high =
                    (first + t + 1) * m < (i + 1) * size ? (first + t + 1) * m : (i + 1) * size;
                double overlap = (double)((high - low) / (long double)size);
                bool outside = first < 0 || first + t >= size;
                numerics_see(&cases[0], outside ? INFINITY : fabs(weight[t] - overlap) / unit_of(s),
                             "size %d texel %d tap %d", size, i, t);
                sum += weight[t];
                if (!outside) given[first + t] += weight[t];
            }
            numerics_see(&cases[1], fabs(sum - 1) / unit_of(s), "size %d texel %d", size, i);
        }
        for (int x = 0; x < size; x++)
            numerics_see(&cases[2], fabs(given[x] - (double)m / size) / unit_of(s),
                         "size %d texel %d", size, x);
    }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]) + numerics_close(&cases[2]);
}

// One pooling of `lines` lines in the subject's arithmetic; numbers of a line `stride` apart, lines
// `pitch` apart.
static void pool(const struct subject *s, int size, int lines, const double *in, int stride,
                 int pitch, double *out, int out_stride, int out_pitch) {
    double weight[3];
    for (int i = 0; i < COARSER(size); i++) {
        int first, count = s->taps(size, i, &first, weight);
        for (int l = 0; l < lines; l++) {
            double sum = 0;
            for (int t = 0; t < count; t++)
                sum =
                    s->nearest(sum + s->nearest(weight[t] * in[(first + t) * stride + l * pitch]));
            out[i * out_stride + l * out_pitch] = sum;
        }
    }
}

static int check_order(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "3 ripmap pooling in either order, %s", s->name);
    struct numerics_case c = {
        name, "sizes 1..64 x 1..64, texels -1..1", "ULP of the largest texel", 4, 0, ""};
    static double in[64 * 64], half[64 * 64], x_first[32 * 32], y_first[32 * 32];
    for (int w = 1; w <= 64; w++)
        for (int h = 1; h <= 64; h++) {
            int cw = COARSER(w), ch = COARSER(h);
            for (int i = 0; i < w * h; i++)
                in[i] = s->nearest(numerics_uniform(random, -1, 1));
            pool(s, w, h, in, 1, w, half, 1, cw);
            pool(s, h, cw, half, cw, 1, x_first, cw, 1);
            pool(s, h, w, in, w, 1, half, w, 1);
            pool(s, w, ch, half, 1, w, y_first, 1, cw);
            for (int i = 0; i < cw * ch; i++)
                numerics_see(&c, fabs(x_first[i] - y_first[i]) / unit_of(s), "%d x %d", w, h);
        }
    return numerics_close(&c);
}

// low + fraction against clamp((p + 1) / 2 size - 1/2) and the texels' range.
static int check_lerp(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "3 ripmap position, %s", s->name);
    struct numerics_case c = {name,
                              "sizes 1..512, p random, at texel centres and edges, beyond, NaN",
                              "ULP of size",
                              2,
                              0,
                              ""};
    const double corners[] = {-1, 1, -0.0, -INFINITY, INFINITY, NAN, -FLT_MAX, FLT_MAX, 1e-30};
    for (int size = 1; size <= MOST; size++)
        for (int n = 0; n < 9 + 100; n++) {
            int texel = (int)numerics_uniform(random, 0, size + 1);
            double p = n < 9    ? corners[n]
                       : n < 50 ? (2 * texel + n % 2) / (double)size - 1
                                : numerics_uniform(random, -1.1, 1.1);
            p = s->nearest(p);
            int low, high;
            double fraction;
            s->lerp(p, size, &low, &high, &fraction);
            double truth = isinf(p) ? p : ((long double)p + 1) / 2 * size - 0.5L;
            truth = truth > 0 ? fmin(truth, size - 1) : 0;
            bool sound = low >= 0 && high < size && (high == low + 1 || size == 1) &&
                         fraction >= 0 && fraction <= 1;
            numerics_see(&c, sound ? fabs(low + fraction - truth) / (size * unit_of(s)) : INFINITY,
                         "p %.17g size %d", p, size);
        }
    return numerics_close(&c);
}

// <P x, y> and <x, P^T y> of the chain of all poolings of a line, relative to the sum of sizes.
static int check_line_adjoint(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "3 ripmap adjoint of pooling, %s", s->name);
    struct numerics_case c = {name, "every size 1..512, 9 poolings", "ULP of sum |x y|", 16, 0, ""};
    for (int size = 1; size <= MOST; size++) {
        double x[MOST], line[MOST], next[MOST], y[MOST], back[MOST], weight[3];
        int sizes[10] = {size};
        for (int i = 0; i < size; i++)
            line[i] = x[i] = s->nearest(numerics_uniform(random, -1, 1));
        for (int l = 0; l < 9; l++) {
            sizes[l + 1] = COARSER(sizes[l]);
            pool(s, sizes[l], 1, line, 1, 0, next, 1, 0);
            memcpy(line, next, (size_t)sizes[l + 1] * sizeof *line);
        }
        double forward = 0, scale = 0, backward = 0;
        y[0] = s->nearest(numerics_uniform(random, -1, 1));
        forward = y[0] * line[0];
        for (int l = 8; l >= 0; l--) {
            memset(back, 0, sizeof back);
            for (int i = 0; i < sizes[l + 1]; i++) {
                int first, count = s->taps(sizes[l], i, &first, weight);
                for (int t = 0; t < count; t++)
                    back[first + t] = s->nearest(back[first + t] + s->nearest(weight[t] * y[i]));
            }
            memcpy(y, back, sizeof y);
        }
        for (int i = 0; i < size; i++) {
            backward += x[i] * y[i];
            scale += fabs(x[i] * y[i]);
        }
        numerics_see(&c, fabs(forward - backward) / (scale * unit_of(s)), "size %d", size);
    }
    return numerics_close(&c);
}

static struct rn_reference *make_field(int base, int levels, struct numerics_random *random) {
    struct rn_field_config config = {.planes = 3,
                                     .base = base,
                                     .channels = 4,
                                     .levels = levels,
                                     .width = 16,
                                     .base_layers = 1,
                                     .head_layers = 1};
    struct rn_reference *ref = NULL;
    if (rn_reference_create(&config, 1, &ref, NULL) != RN_OK) {
        fprintf(stderr, "no field of base %d\n", base);
        exit(1);
    }
    for (size_t i = 0; i < ref->plane_count; i++)
        ref->planes[i] = numerics_uniform(random, -1, 1);
    rn_reference_build(ref);
    return ref;
}

// Value and texel gradient of a query one ULP to either side of a border of texels or levels.
static void see_step(struct rn_reference *ref, struct numerics_case cases[2], double at[4],
                     int which, double scale) {
    double value[2][4], one[4] = {1, 1, 1, 1}, border = at[which];
    size_t count = ref->map_count;
    double *first = calloc(count, sizeof *first);
    if (!first) exit(1);
    for (int side = 0; side < 2; side++) {
        at[which] = nextafter(border, side ? INFINITY : -INFINITY);
        rn_reference_query(ref, 1, at[0], at[1], at[2], at[3], value[side]);
        memset(ref->map_grad, 0, count * sizeof(double));
        rn_reference_query_backward(ref, 1, at[0], at[1], at[2], at[3], one);
        if (side == 0) memcpy(first, ref->map_grad, count * sizeof(double));
    }
    double jump = 0;
    for (size_t i = 0; i < count; i++)
        jump = fmax(jump, fabs(ref->map_grad[i] - first[i]));
    numerics_see(&cases[0], fabs(value[1][2] - value[0][2]) / scale,
                 "base %d u %.9g v %.9g levels %.9g %.9g", ref->config.base, at[0], at[1], at[2],
                 at[3]);
    numerics_see(&cases[1], jump / scale, "base %d u %.9g v %.9g levels %.9g %.9g",
                 ref->config.base, at[0], at[1], at[2], at[3]);
    free(first);
}

static int check_continuity(struct numerics_random *random) {
    static const int bases[] = {2, 3, 7, 8, 13, 32, 45};
    struct numerics_case cases[2] = {
        {"3 ripmap value across borders, reference", "texel and level borders, bases 2..45",
         "ULP of base", 8, 0, ""},
        {"3 ripmap texel gradient across borders, reference",
         "texel and level borders, bases 2..45", "ULP of base", 8, 0, ""}};
    for (int b = 0; b < 7; b++) {
        int base = bases[b], levels = 4;
        struct rn_reference *ref = make_field(base, levels, random);
        for (int n = 0; n < 300; n++) {
            double at[4] = {numerics_uniform(random, -1.05, 1.05),
                            numerics_uniform(random, -1.05, 1.05), numerics_uniform(random, 0, 3),
                            numerics_uniform(random, 0, 3)};
            int which = n % 4, size = base >> (int)numerics_uniform(random, 0, levels);
            if (size < 1) size = 1;
            if (which < 2) // a texel's centre in some map, where one pair of texels ends
                at[which] = (2 * (int)numerics_uniform(random, 0, size) + 1) / (double)size - 1;
            else
                at[which] = (int)numerics_uniform(random, 0, levels);
            see_step(ref, cases, at, which, base * DBL_EPSILON);
        }
        rn_reference_destroy(&ref);
    }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

// Queries are averages: of texels within [-1, 1] never beyond, and finite for any input.
static int check_bounds(struct numerics_random *random) {
    static const double wild[] = {NAN, INFINITY, -INFINITY, DBL_MAX, -DBL_MAX, DBL_TRUE_MIN};
    struct numerics_case c = {"3 ripmap query of ones, reference",
                              "bases 2..64, any position and level, also NaN and infinite",
                              "ULP",
                              4,
                              0,
                              ""};
    for (int base = 2; base <= 64; base++) {
        struct rn_reference *ref = make_field(base, 5, random);
        for (size_t i = 0; i < ref->plane_count; i++)
            ref->planes[i] = 1;
        rn_reference_build(ref);
        for (int n = 0; n < 100; n++) {
            double at[4], value[4];
            for (int i = 0; i < 4; i++)
                at[i] = n % 5 == i ? wild[n / 5 % 6] : numerics_uniform(random, -2, 6);
            rn_reference_query(ref, 2, at[0] / 3, at[1] / 3, at[2], at[3], value);
            numerics_see(&c, fabs(value[1] - 1) / DBL_EPSILON,
                         "base %d u %.9g v %.9g levels %.9g %.9g", base, at[0] / 3, at[1] / 3,
                         at[2], at[3]);
        }
        rn_reference_destroy(&ref);
    }
    return numerics_close(&c);
}

// <A x, y> = <x, A^T y> for the whole pyramid.
static int check_pyramid_adjoint(struct numerics_random *random) {
    struct numerics_case c = {"3 ripmap adjoint of the pyramid, reference",
                              "bases 2..40, 5 x 5 levels",
                              "ULP of sum |x y|",
                              16,
                              0,
                              ""};
    for (int base = 2; base <= 40; base++) {
        struct rn_reference *ref = make_field(base, 5, random);
        double forward = 0, backward = 0, scale = 0;
        for (size_t i = 0; i < ref->map_count; i++) {
            ref->map_grad[i] = numerics_uniform(random, -1, 1);
            forward += ref->map_grad[i] * ref->maps[i];
            scale += fabs(ref->map_grad[i] * ref->maps[i]);
        }
        rn_reference_pull_down(ref);
        for (size_t i = 0; i < ref->plane_count; i++)
            backward += ref->plane_grad[i] * ref->planes[i];
        numerics_see(&c, fabs(forward - backward) / (scale * DBL_EPSILON), "base %d", base);
        rn_reference_destroy(&ref);
    }
    return numerics_close(&c);
}

// ---- the fast paths ---------------------------------------------------------------------------

#define SET_LEVELS 4
#define ROOM (SUBJECT_QUERIES + 16)

// One plane with its pyramid, and gradients of the same shape.
struct plane {
    struct rn_field_config config;
    struct rn_cpu_field field;
    struct rn_map grad_maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS];
    float *memory, *grads;
    uint8_t *touched;
    size_t count;
};

static void make_plane(const struct rn_kernels *k, int base, int channels, bool mip, float low,
                       struct numerics_random *random, struct plane *p) {
    *p = (struct plane){
        .config = {.planes = 1,
                   .base = base,
                   .channels = channels,
                   .levels = SET_LEVELS,
                   .footprint = mip ? RN_FOOTPRINT_MIP : RN_FOOTPRINT_RIP},
        .field = {.features = channels, .feature_stride = 16, .built_levels = SET_LEVELS}};
    const struct rn_field_config *c = p->field.config = &p->config;
    size_t first = (size_t)(base * base * channels), rest = rn_pyramid_count(c, SET_LEVELS);
    p->count = first + rest;
    p->memory = calloc(2 * (p->count + 64), sizeof(float));
    struct rn_tiling tiling = rn_tiling(base, channels, SET_LEVELS);
    p->touched = calloc((size_t)tiling.columns * (size_t)tiling.rows, 1);
    if (!p->memory || !p->touched) exit(1);
    p->grads = p->memory + p->count + 64;
    rn_pyramid_lay_out(c, SET_LEVELS, p->memory, p->memory + first, p->field.maps);
    rn_pyramid_lay_out(c, SET_LEVELS, p->grads, p->grads + first, p->grad_maps);
    for (size_t i = 0; i < first; i++)
        p->memory[i] = (float)numerics_uniform(random, (double)low, 1);
    k->build(p->field.maps[0], SET_LEVELS, mip, channels);
}

static void finish_plane(struct plane *p) {
    free(p->memory);
    free(p->touched);
}

struct query {
    float u[ROOM], v[ROOM], lx[ROOM], ly[ROOM];
};

static void draw_query(struct numerics_random *random, bool mip, int i, struct query *q) {
    q->u[i] = (float)numerics_uniform(random, -1.1, 1.1);
    q->v[i] = (float)numerics_uniform(random, -1.1, 1.1);
    q->lx[i] = (float)numerics_uniform(random, 0, SET_LEVELS - 1);
    q->ly[i] = mip ? q->lx[i] : (float)numerics_uniform(random, 0, SET_LEVELS - 1);
}

// The adjoint of a query: adds n samples' gradients to the (cleared) gradient maps.
static void scatter(const struct rn_kernels *k, struct plane *p, int n, struct query *q,
                    float *grad) {
    struct rn_slab slab = {.count = n, .capacity = n};
    slab.u[0] = q->u;
    slab.v[0] = q->v;
    slab.lx[0] = q->lx;
    slab.ly[0] = q->ly;
    slab.grad[0] = grad;
    memset(p->grads, 0, p->count * sizeof *p->grads);
    k->scatter(&p->field, &slab, 0, SET_LEVELS, 0, p->config.base, p->grad_maps[0], p->touched);
}

// <Q x, y> = <x, Q^T y>, and the partition of unity: planes of ones give ones.
static int check_set_query(const struct subject *s, const struct rn_kernels *k,
                           struct numerics_random *random) {
    char names[2][80];
    snprintf(names[0], sizeof names[0], "3 ripmap adjoint of the query, %s", s->name);
    snprintf(names[1], sizeof names[1], "3 ripmap query of ones, %s", s->name);
    const char *range = "bases 16..70, rip and mip, 4 to 16 channels, any position and level";
    struct numerics_case adjoint = {names[0], range, "ULP of sum |x y|", 16, 0, ""};
    struct numerics_case unity = {names[1], range, "ULP", 4, 0, ""};
    for (int base = 16; base <= 70; base++) {
        bool mip = base % 4 == 3;
        int channels = 4 << base % 3;
        struct plane p;
        make_plane(k, base, channels, mip, base % 2 ? 1 : -1, random, &p);
        struct query q;
        float value[ROOM * 16], grad[ROOM * 16] = {0};
        double forward = 0, backward = 0, scale = 0;
        for (int i = 0; i < ROOM; i++)
            draw_query(random, mip, i, &q);
        q.u[0] = NAN;
        q.v[1] = -INFINITY;
        q.u[2] = FLT_MAX;
        for (int i = 0; i < SUBJECT_QUERIES * channels; i++)
            grad[i] = (float)numerics_uniform(random, -1, 1);
        s->query(&p.field, SUBJECT_QUERIES, q.u, q.v, q.lx, q.ly, value);
        scatter(k, &p, SUBJECT_QUERIES, &q, grad);
        for (int i = 0; i < SUBJECT_QUERIES * channels; i++) {
            forward += (double)value[i] * (double)grad[i];
            scale += fabs((double)value[i] * (double)grad[i]);
            if (base % 2) // texels in [1, 1)
                numerics_see(&unity, fabs((double)value[i] - 1) * 0x1p23, "base %d sample %d", base,
                             i / channels);
        }
        for (size_t i = 0; i < p.count; i++)
            backward += (double)p.memory[i] * (double)p.grads[i];
        numerics_see(&adjoint, fabs(forward - backward) / (scale * 0x1p-23),
                     "base %d, %d channels%s", base, channels, mip ? ", mip" : "");
        finish_plane(&p);
    }
    return numerics_close(&adjoint) + numerics_close(&unity);
}

// A position or a level at which one pair of texels or maps ends.
static float border_of(struct numerics_random *random, int base, bool level) {
    if (level) return (float)(1 + (int)numerics_uniform(random, 0, SET_LEVELS - 2));
    int size = base >> (int)numerics_uniform(random, 0, SET_LEVELS);
    return (2 * (float)(int)numerics_uniform(random, 0, size) + 1) / (float)size - 1;
}

// Value and texel gradient one ULP to either side of a border of texels or levels.
static int check_set_borders(const struct subject *s, const struct rn_kernels *k,
                             struct numerics_random *random) {
    char names[2][80];
    snprintf(names[0], sizeof names[0], "3 ripmap value across borders, %s", s->name);
    snprintf(names[1], sizeof names[1], "3 ripmap texel gradient across borders, %s", s->name);
    const char *range = "texel and level borders, bases 16..45";
    struct numerics_case value = {names[0], range, "ULP of base", 8, 0, ""};
    struct numerics_case slope = {names[1], range, "ULP of base", 8, 0, ""};
    static const int bases[] = {16, 17, 23, 32, 45};
    for (int b = 0; b < 5; b++) {
        struct plane p;
        make_plane(k, bases[b], 4, b == 2, -1, random, &p);
        double unit = bases[b] * 0x1p-23, jump;
        float *first = calloc(p.count, sizeof *first);
        if (!first) exit(1);
        for (int n = 0; n < 200; n++) {
            struct query q = {{0}, {0}, {0}, {0}};
            float got[2][ROOM * 4], one[ROOM * 4] = {1, 1, 1, 1};
            draw_query(random, b == 2, 0, &q);
            float *at = n % 4 == 0 ? q.u : n % 4 == 1 ? q.v : n % 4 == 2 ? q.lx : q.ly;
            float border = border_of(random, bases[b], n % 4 > 1);
            for (int side = 0; side < 2; side++) {
                at[0] = nextafterf(border, side ? INFINITY : -INFINITY);
                if (b == 2) q.ly[0] = n % 4 == 3 ? q.ly[0] : q.lx[0], q.lx[0] = q.ly[0];
                s->query(&p.field, 1, q.u, q.v, q.lx, q.ly, got[side]);
                scatter(k, &p, 1, &q, one);
                if (side == 0) memcpy(first, p.grads, p.count * sizeof *first);
            }
            jump = 0;
            for (size_t i = 0; i < p.count; i++)
                jump = fmax(jump, fabs((double)p.grads[i] - (double)first[i]));
            numerics_see(&slope, jump / unit, "base %d u %.9g v %.9g levels %.9g %.9g", bases[b],
                         (double)q.u[0], (double)q.v[0], (double)q.lx[0], (double)q.ly[0]);
            for (int c = 0; c < 4; c++)
                numerics_see(&value, fabs((double)got[1][c] - (double)got[0][c]) / unit,
                             "base %d u %.9g v %.9g levels %.9g %.9g", bases[b], (double)q.u[0],
                             (double)q.v[0], (double)q.lx[0], (double)q.ly[0]);
        }
        free(first);
        finish_plane(&p);
    }
    return numerics_close(&value) + numerics_close(&slope);
}

// <Q x, y> = <x, Q^T y> of the reference's query.
static int check_query_adjoint(struct numerics_random *random) {
    struct numerics_case c = {"3 ripmap adjoint of the query, reference",
                              "bases 2..64, any position and level",
                              "ULP of sum |x y|",
                              16,
                              0,
                              ""};
    for (int base = 2; base <= 64; base++) {
        struct rn_reference *ref = make_field(base, 5, random);
        double forward = 0, backward = 0, scale = 0;
        memset(ref->map_grad, 0, ref->map_count * sizeof(double));
        for (int n = 0; n < 50; n++) {
            double at[4], value[4], grad[4];
            for (int i = 0; i < 4; i++) {
                at[i] = numerics_uniform(random, i < 2 ? -1.1 : 0, i < 2 ? 1.1 : 4);
                grad[i] = numerics_uniform(random, -1, 1);
            }
            rn_reference_query(ref, 1, at[0], at[1], at[2], at[3], value);
            rn_reference_query_backward(ref, 1, at[0], at[1], at[2], at[3], grad);
            for (int i = 0; i < 4; i++) {
                forward += value[i] * grad[i];
                scale += fabs(value[i] * grad[i]);
            }
        }
        for (size_t i = 0; i < ref->map_count; i++)
            backward += ref->map_grad[i] * ref->maps[i];
        numerics_see(&c, fabs(forward - backward) / (scale * DBL_EPSILON), "base %d", base);
        rn_reference_destroy(&ref);
    }
    return numerics_close(&c);
}

int main(void) {
    const struct subject *s;
    struct numerics_random random = numerics_random();
    int failed = 0;
    for (int i = 0; (s = subject_at(i)); i++) {
        failed += check_lerp(s, &random);
        if (!s->taps) continue;
        failed += check_taps(s);
        failed += check_order(s, &random);
        failed += check_line_adjoint(s, &random);
        const struct rn_kernels *k = s->fast ? rn_kernels_find(s->name) : NULL;
        if (k) failed += check_set_query(s, k, &random) + check_set_borders(s, k, &random);
    }
    failed += check_query_adjoint(&random);
    failed += check_pyramid_adjoint(&random);
    failed += check_continuity(&random);
    failed += check_bounds(&random);
    return failed > 0;
}
