// Case 6: where rays enter the cube and leave the ball, which samples the march finds, and what the
// colour network is told of their directions.
#include <float.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/field/sh.h"
#include "server/engine/kernels/ray.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/scene/scene.h"
#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

#define KINDS 9
static const char *const kinds[KINDS] = {"any",     "parallel to faces",   "on a face",
                                         "tangent", "through a corner",    "through an edge",
                                         "inside",  "denormal components", "far outside"};

// A point within the ball of radius `size`.
static void draw_point(struct numerics_random *random, double size, double ret[3]) {
    numerics_direction(random, ret);
    double r = size * cbrt(numerics_uniform(random, 0, 1));
    for (int i = 0; i < 3; i++)
        ret[i] *= r;
}

// A ray in the normalised frame by kind, its direction unit within rounding.
static struct rn_ray draw_ray(struct numerics_random *random, int kind) {
    struct rn_ray ray = {.radius = 1e-3};
    double target[3], away = numerics_spread(random, 1e-2, 10), norm = 0;
    int axis = (int)numerics_uniform(random, 0, 3), other = (axis + 1) % 3;
    draw_point(random, 1.05, target);
    if (kind == 4 || kind == 5) // a corner of the cube, or a point on one of its edges
        for (int i = 0; i < 3; i++)
            target[i] = kind == 4 || i != axis ? copysign(1, target[i]) : target[i];
    draw_point(random, 1, ray.origin);
    if (kind == 8) away = numerics_spread(random, 1e2, 1e9);
    numerics_direction(random, ray.direction);
    for (int i = 0; i < 3; i++)
        if (kind != 6) ray.origin[i] = target[i] + ray.direction[i] * away;
    if (kind == 4) // through the corner and the centre's neighbourhood
        draw_point(random, 1e-3, target);
    for (int i = 0; i < 3; i++)
        ray.direction[i] = target[i] - ray.origin[i];
    if (kind == 1 || kind == 3)
        for (int i = 0; i < 3; i++)
            ray.direction[i] = i == axis ? -copysign(1, ray.origin[axis]) : i == other ? 0.0 : -0.0;
    if (kind == 2) ray.origin[axis] = copysign(1, ray.origin[axis]);
    if (kind == 3) { // touches the ball where axis `other` does
        ray.origin[other] = copysign(1, ray.origin[other]);
        ray.origin[3 - axis - other] = 0;
    }
    if (kind == 7)
        for (int i = 0; i < 3; i++)
            ray.direction[i] = i == axis ? 1 : i == other ? DBL_TRUE_MIN : 1e-310;
    for (int i = 0; i < 3; i++)
        norm += ray.direction[i] * ray.direction[i];
    for (int i = 0; i < 3 && norm > 0; i++)
        ray.direction[i] /= sqrt(norm);
    return ray;
}

// Exact geometry of a ray and the unit ball, and what rounding the origin alone may cost.
struct truth {
    double across;      // squared distance of the line from the centre
    double distance;    // of the origin from the centre
    double half;        // of the chord
    double condition;   // of the chord's ends
    exact along, exits; // parameters of the point nearest the centre and of the far end
};

static exact exact_dot(const double a[3], const double b[3]) {
    exact sum = number(0);
    for (int i = 0; i < 3; i++)
        sum = plus(sum, times(number(a[i]), number(b[i])));
    return sum;
}

static struct truth exact_truth(const struct rn_ray *ray) {
    struct truth t;
    exact dd = exact_dot(ray->direction, ray->direction), oo = exact_dot(ray->origin, ray->origin);
    exact od = exact_dot(ray->origin, ray->direction);
    t.along = negative(over(od, dd));
    exact across = minus(oo, over(square(od), dd));
    exact inside = larger(minus(number(1), across), number(0));
    t.exits = plus(t.along, root(over(inside, dd)));
    t.across = rounded(across);
    t.distance = sqrt(rounded(oo));
    t.half = sqrt(rounded(inside));
    t.condition = 1 + 1 / fmax(t.half, sqrt(0x1p-52 * (1 + t.distance)));
    return t;
}

// A grid of the ball's cells, `part` of them occupied, scattered or in runs.
static struct rn_field *make_grid(struct numerics_random *random, int cells, double part) {
    struct rn_train_config config;
    struct rn_bounds bounds = {.radius = 1};
    struct rn_field *field = NULL;
    if (rn_preset("draft", false, &config, NULL) != RN_OK) exit(1);
    config.field.occupancy = cells;
    config.field.base = 16;
    config.grow_to = 0;
    config.field.levels = 2;
    config.cone_step = false;
    if (rn_field_create(&config, &bounds, &field, NULL) != RN_OK) exit(1);
    size_t count = (size_t)cells * (size_t)cells * (size_t)cells;
    bool clustered = numerics_uniform(random, 0, 1) < 0.5;
    for (size_t i = 0; i < count; i++) {
        size_t key = clustered ? i / 64 : i; // runs along z
        struct rn_rng4 draw = rn_rng_draw(random->seed, random->count, key);
        field->occupancy[i] = rn_rng_unit(draw.v[0]) < part ? 1 : 0;
    }
    random->count++;
    rn_field_refresh_occupancy(field);
    return field;
}

static struct rn_march_ray cut_ray(const struct subject *s, const struct rn_field *field,
                                   const struct rn_ray *ray) {
    if (!s) return rn_march_ray_from(field, ray, 0.01, 0);
    struct rn_march_ray got;
    s->cut(ray, 0.01, &got);
    return got;
}

// The start lies on the ray, before the ball and within the cube; the end is where the ray leaves
// the ball. Errors in units of 2^-21 (fp32 positions) + 2^-50 times the distance (float64 origins)
// times the condition of the chord's end.
// `s`: the kernel set whose vectors cut the rays, NULL for rn_march_ray_from.
static int check_entry(const struct subject *s, struct numerics_random *random) {
    const char *range = "9 kinds of rays, origins within 1e9 radii", *unit = "of its allowance";
    const char *before = s ? ", " : "", *set = s ? s->name : "";
    char names[3][80];
    snprintf(names[0], sizeof names[0], "6 ray meets the ball%s%s", before, set);
    snprintf(names[1], sizeof names[1], "6 ray start on the ray, in the cube%s%s", before, set);
    snprintf(names[2], sizeof names[2], "6 ray end on the ball%s%s", before, set);
    struct numerics_case hits = {names[0], range, "wrong", 0.5, 0, ""};
    struct numerics_case start = {names[1], range, unit, 1, 0, ""};
    struct numerics_case end = {names[2], range, unit, 1, 0, ""};
    struct rn_field *field = make_grid(random, 16, 1);
    for (int n = 0; n < 40000; n++) {
        int kind = n % KINDS;
        struct rn_ray ray = draw_ray(random, kind);
        struct rn_march_ray got = cut_ray(s, field, &ray);
        exact_reset();
        struct truth t = exact_truth(&ray);
        double allowed = 0x1p-21 + 0x1p-50 * t.distance, exits = rounded(t.exits);
        bool meets = t.across <= 1 && exits > 0, hit = got.length > 0;
        bool unsure = fabs(t.across - 1) < 0x1p-48 * (1 + t.distance) || fabs(exits) < 0x1p-20;
        if (!unsure)
            numerics_see(&hits, meets != hit, "%s, across %.17g, exit %.9g", kinds[kind], t.across,
                         exits);
        if (!hit || unsure) continue;
        double from[3], off = 0, outside = 0;
        for (int i = 0; i < 3; i++) {
            from[i] = (double)got.origin[i] - ray.origin[i];
            outside = fmax(outside, fabs((double)got.origin[i]) - 1);
        }
        exact at = over(exact_dot(from, ray.direction), exact_dot(ray.direction, ray.direction));
        for (int i = 0; i < 3; i++)
            off = fmax(off, fabs(rounded(minus(number((double)got.origin[i]),
                                               plus(number(ray.origin[i]),
                                                    times(at, number(ray.direction[i])))))));
        double late = rounded(at) - fmax(0, rounded(t.along) - t.half);
        numerics_see(&start, fmax(off, fmax(outside, late)) / allowed,
                     "%s, distance %.9g: off %.3g outside %.3g late %.3g", kinds[kind], t.distance,
                     off, outside, late);
        double reach = rounded(plus(at, number((double)got.length))) - exits;
        numerics_see(&end, fabs(reach) / (0x1p-21 + 0x1p-50 * t.distance * t.condition),
                     "%s, distance %.9g, half chord %.3g", kinds[kind], t.distance, t.half);
    }
    rn_field_destroy(&field);
    return numerics_close(&hits) + numerics_close(&start) + numerics_close(&end);
}

// Where a ray enters the cube, slab by slab in exact arithmetic; denormal directions count as 0.
// A ray in a face's plane may meet the cube or miss it.
static void see_cube(struct numerics_case cases[2], const double o[3], const double d[3]) {
    exact enter = number(0), leave = number(1e300);
    bool outside = false, unsure = false;
    for (int i = 0; i < 3; i++) {
        if (fabs(d[i]) < 1e-300) {
            outside |= fabs(o[i]) > 1;
            unsure |= fabs(o[i]) == 1;
            continue;
        }
        double near = d[i] > 0 ? -1 : 1;
        enter = larger(enter, over(minus(number(near), number(o[i])), number(d[i])));
        leave = smaller(leave, over(minus(number(-near), number(o[i])), number(d[i])));
    }
    double got, width = rounded(minus(leave, enter)), size = 1 + rounded(enter);
    bool hit = rn_enter_cube(o, d, &got);
    if (!unsure && fabs(width) > 1e-9 * size)
        numerics_see(&cases[0], hit != (!outside && width > 0),
                     "origin %g %g %g direction %g %g %g", o[0], o[1], o[2], d[0], d[1], d[2]);
    if (hit || unsure)
        numerics_see(&cases[1],
                     unsure ? (isnan(got) ? INFINITY : 0)
                            : exact_distance(got, enter) / (size * 0x1p-52),
                     "origin %g %g %g direction %g %g %g", o[0], o[1], o[2], d[0], d[1], d[2]);
}

static int check_cube(struct numerics_random *random) {
    const char *range = "parallel to faces and in them, zero and denormal components";
    struct numerics_case cases[2] = {
        {"6 ray meets the cube", range, "wrong", 0.5, 0, ""},
        {"6 ray enters the cube", range, "ULP of 1 + distance", 4, 0, ""}};
    const double starts[] = {-1, 1, 0, -0.0, 2, -1e9},
                 slopes[] = {0, -0.0, DBL_TRUE_MIN, 1e-310, 1e-13};
    for (int n = 0; n < 20000; n++) {
        double o[3], d[3];
        numerics_direction(random, d);
        for (int i = 0; i < 3; i++) {
            int kind = (int)numerics_uniform(random, 0, 12);
            o[i] = kind < 6 ? starts[kind] : numerics_uniform(random, -3, 3);
            kind = (int)numerics_uniform(random, 0, 12);
            if (kind < 5) d[i] = slopes[kind];
        }
        if (fabs(d[0]) + fabs(d[1]) + fabs(d[2]) < 1e-2) d[n % 3] = n % 2 ? 1 : -1;
        exact_reset();
        see_cube(cases, o, d);
    }
    return numerics_close(&cases[0]) + numerics_close(&cases[1]);
}

// What no ray may do: be followed when it is not a number.
static int check_wild(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "6 ray with NaN or infinity%s%s", s ? ", " : "", s ? s->name : "");
    struct numerics_case c = {name, "each number of a ray", "followed", 0.5, 0, ""};
    const double wild[] = {NAN, INFINITY, -INFINITY, DBL_MAX};
    struct rn_field *field = make_grid(random, 16, 1);
    for (int n = 0; n < 24; n++) {
        struct rn_ray ray = {{0.1, 0.2, -3}, {0, 0, 1}, 1e-3};
        (n % 6 < 3 ? ray.origin : ray.direction)[n % 3] = wild[n / 6];
        struct rn_march_ray got = cut_ray(s, field, &ray);
        bool finite = true;
        for (int i = 0; i < 3; i++)
            finite &= isfinite(got.origin[i]) && isfinite(got.direction[i]);
        numerics_see(&c, got.length > 0 && !(finite && isfinite(got.length)), "number %d is %g",
                     n % 6, wild[n / 6]);
    }
    rn_field_destroy(&field);
    return numerics_close(&c);
}

// ---- the march ------------------------------------------------------------------------------

// Whether any (or all, for `all`) of the cells within `margin` of a position are occupied.
static bool occupied(const struct rn_field *field, const double p[3], double margin, bool all) {
    int cells = field->cpu.occupancy.cells;
    bool some = false, every = true;
    for (int corner = 0; corner < 8; corner++) {
        int at[3];
        for (int i = 0; i < 3; i++) {
            double x = (p[i] + (corner >> i & 1 ? margin : -margin) + 1) / 2 * cells;
            at[i] = x < 0 ? 0 : x > cells - 1 ? cells - 1 : (int)x;
        }
        size_t word = rn_brick_word(at[0], at[1], at[2], cells);
        bool set = field->cpu.occupancy.words[word] & rn_brick_bit(at[0], at[1]);
        some |= set;
        every &= set;
    }
    return all ? every : some;
}

// Every sample with a step in an occupied cell is found, in order, and no other, but for steps
// within 2e-6 of a cell's face.
static void see_march(struct numerics_case *c, const struct subject *s,
                      const struct rn_field *field, const struct rn_march_ray *ray, double step,
                      int kind) {
    static uint16_t found[65536 + RN_PACKET_SLACK];
    int n = s->march(&field->cpu.occupancy, ray, (float)step, found, 65536), next = 0;
    int count = (int)fmin(65535, (double)ray->length / (double)(float)step + 0.5);
    double wrong = n > 65536;
    for (int i = 1; i < n && n <= 65536; i++)
        wrong += found[i] <= found[i - 1];
    for (int k = 0; k * ray->stride < count; k++) {
        bool must = false, may = false;
        for (int j = k * ray->stride; j < (k + 1) * ray->stride && j <= count; j++) {
            double at = (j + 0.5) * (double)(float)step, p[3];
            for (int i = 0; i < 3; i++)
                p[i] = (double)ray->origin[i] + (double)ray->direction[i] * at;
            must |= occupied(field, p, 2e-6, true) && at < (double)ray->length - 1e-5;
            may |= occupied(field, p, 2e-6, false);
        }
        while (next < n && next < 65536 && found[next] < k)
            next++;
        bool has = next < n && next < 65536 && found[next] == k;
        wrong += has ? !may : must;
    }
    numerics_see(c, wrong, "%s, step %.4g, stride %d, %d of %d samples", kinds[kind], step,
                 ray->stride, n, count / ray->stride);
}

static int check_march(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "6 march finds the occupied samples, %s", s->name);
    struct numerics_case c = {
        name,
        "9 kinds of rays, steps 1e-4..1, 1 to 8 a sample, grids 16 and 64, 0.1..90 % full",
        "wrong samples",
        0.5,
        0,
        ""};
    for (int g = 0; g < 12; g++) {
        struct rn_field *field =
            make_grid(random, g % 2 ? 64 : 16, numerics_spread(random, 1e-3, 0.9));
        for (int n = 0; n < 90; n++) {
            struct rn_ray ray = draw_ray(random, n % KINDS);
            double step = n < 9 ? 1e-4 : numerics_spread(random, 1e-3, 1);
            struct rn_march_ray march = rn_march_ray_from(field, &ray, 0.01, 0);
            march.stride = 1 << n / KINDS % 4;
            see_march(&c, s, field, &march, step, n % KINDS);
        }
        rn_field_destroy(&field);
    }
    return numerics_close(&c);
}

// Any step and any length end, and never write more than there is room for.
static int check_ends(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "6 march ends within its room, %s", s->name);
    struct numerics_case c = {
        name, "steps 1e-30..1e30, lengths and distances to 1e9, NaN", "over the room", 0.5, 0, ""};
    static uint16_t found[1024 + RN_PACKET_SLACK];
    const double wild[] = {NAN, INFINITY, 0, 1e-30, 1e30, 1e-7};
    struct rn_field *field = make_grid(random, 16, 0.3);
    for (int n = 0; n < 20000; n++) {
        struct rn_ray ray = draw_ray(random, n % KINDS);
        struct rn_march_ray march = rn_march_ray_from(field, &ray, 0.01, 0);
        double step = n % 7 ? numerics_spread(random, 1e-9, 1e9) : wild[n / 7 % 6];
        if (n % 5 == 0) march.length = (float)numerics_spread(random, 1e-9, 1e9);
        march.stride = 1 << n % 4;
        march.near = (float)numerics_spread(random, 1, 1e9);
        int count = s->march(&field->cpu.occupancy, &march, (float)step, found, 1024);
        numerics_see(&c, count < 0 || count > 1024, "step %g length %g", step,
                     (double)march.length);
    }
    rn_field_destroy(&field);
    return numerics_close(&c);
}

// ---- directions -----------------------------------------------------------------------------

RN_SH_FUNCTION(exact_harmonics, long double, long double)

static int check_harmonics(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "6 spherical harmonics, %s", s->name);
    struct numerics_case c = {name, "unit directions, along axes and any", "ULP of 1", 4, 0, ""};
    for (int n = 0; n < 20000; n++) {
        double d[3] = {0}, got[RN_SH_COUNT];
        numerics_direction(random, d);
        for (int i = 0; i < 3; i++)
            d[i] = s->nearest(n < 6 ? (i == n / 2) * (n % 2 ? -1 : 1) : d[i]);
        long double truth[RN_SH_COUNT];
        exact_harmonics((const long double[3]){d[0], d[1], d[2]}, truth);
        s->harmonics(d, got);
        for (int i = 0; i < RN_SH_COUNT; i++)
            numerics_see(&c, (double)fabsl(got[i] - truth[i]) * ldexp(1, s->digits - 1),
                         "number %d of %.9g %.9g %.9g", i, d[0], d[1], d[2]);
    }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    const struct subject *s;
    int failed = check_entry(NULL, &random) + check_cube(&random) + check_wild(NULL, &random);
    for (int i = 0; (s = subject_at(i)); i++) {
        if (s->harmonics) failed += check_harmonics(s, &random);
        if (!s->march) continue;
        failed += check_entry(s, &random) + check_wild(s, &random);
        failed += check_march(s, &random);
        failed += check_ends(s, &random);
    }
    return failed > 0;
}
