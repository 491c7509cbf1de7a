// Case 17: unbounded space, drawn into the unit ball: lengths, footprints, and the steps of a ray.
#include <float.h>

#include "server/engine/field/footprint.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/space.h"
#include "server/engine/kernels/ray.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/scene/scene.h"
#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

// Distances from the centre: any, and the border of the inner ball within two ULP.
static double draw_distance(const struct subject *s, struct numerics_random *random, int n) {
    double ulp = ldexp(1, 1 - s->digits);
    if (n < 5) return 1 + (n - 2) * ulp;
    return s->nearest(numerics_spread(random, 1e-7, 1e12));
}

static int check_contraction(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "18 contraction, %s", s->name);
    struct numerics_case c = {name, "1e-7 to 1e12 radii, the border", "ULP", 4, 0, ""};
    for (int n = 0; n < 20000; n++) {
        double r = draw_distance(s, random, n), got[3];
        s->contraction(r, got);
        exact_reset();
        exact half = fraction(1, 2), inverse = over(number(1), number(r));
        bool outside = r > 1;
        exact across = outside ? times(times(half, inverse), minus(number(2), inverse)) : half;
        exact along = outside ? times(half, square(inverse)) : half;
        double error =
            fmax(exact_ulps(got[0], across, s->digits), exact_ulps(got[1], across, s->digits));
        numerics_see(&c, fmax(error, exact_ulps(got[2], along, s->digits)), "r %.17g", r);
    }
    return numerics_close(&c);
}

// Up to two ULP of the number that the distance is one over of.
static int check_places(const struct subject *s, struct numerics_random *random) {
    char name[80];
    snprintf(name, sizeof name, "18 distance of a place, %s", s->name);
    struct numerics_case c = {name, "distances of 1e-7 to 1e4, both ways", "ULP", 1, 0, ""};
    for (int n = 0; n < 20000; n++) {
        double far = numerics_spread(random, 1e-7, 1e4), sign = n % 2 ? -1 : 1;
        double place = s->nearest(sign * (far <= 1 ? far : 2 - 1 / far)), size = fabs(place);
        exact_reset();
        exact truth = number(size);
        if (size > 1) truth = over(number(1), minus(number(2), number(size)));
        numerics_see(&c, exact_ulps(sign * s->distance_of_place(place), truth, s->digits),
                     "place %.17g", place);
    }
    return numerics_close(&c);
}

static double norm(const double x[3]) {
    return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
}

static void contract(const double x[3], double ret[3]) {
    double scale = rn_contraction_at(norm(x)).scale;
    for (int i = 0; i < 3; i++)
        ret[i] = x[i] * scale;
}

static int check_inverses(struct numerics_random *random) {
    struct numerics_case place = {
        "18 place and distance", "1e-7 to 1e7", "ULP over its condition", 2, 0, ""};
    struct numerics_case ball = {
        "18 contraction and back", "1e-7 to 1e7 radii", "ULP over its condition", 2, 0, ""};
    for (int n = 0; n < 20000; n++) {
        double r = numerics_spread(random, 1e-7, 1e7), sign = n % 2 ? -1 : 1;
        double back = rn_distance_of_place(rn_place_of_distance(sign * r)) * sign;
        double y = r * rn_contraction_at(r).scale, condition = DBL_EPSILON * r * fmax(1, 2 * r);
        numerics_see(&place, fabs(back - r) / condition, "s %.17g", sign * r);
        numerics_see(&ball, fabs(rn_uncontracted(y) - r) / condition, "r %.17g", r);
    }
    return numerics_close(&place) + numerics_close(&ball);
}

// Against differences of the contraction itself; through the border they see both sides.
static int check_jacobian(struct numerics_random *random) {
    struct numerics_case c = {
        "18 Jacobian", "1e-3 to 1e6 radii, any axis", "relative to `across`", 1e-6, 0, ""};
    for (int n = 0; n < 20000; n++) {
        double x[3], towards[3], axis[3], got[3], low[3], high[3], y[2][3];
        double r = n % 10 ? numerics_spread(random, 1e-3, 1e6) : 1 + 1e-9, h = 1e-6 * r;
        numerics_direction(random, towards);
        numerics_direction(random, axis);
        for (int i = 0; i < 3; i++) {
            x[i] = r * towards[i];
            low[i] = x[i] - h * axis[i];
            high[i] = x[i] + h * axis[i];
        }
        contract(low, y[0]);
        contract(high, y[1]);
        struct rn_contraction lengths = rn_contraction_at(r);
        rn_contracted_axis(&lengths, towards, axis, got);
        for (int i = 0; i < 3; i++)
            got[i] -= (y[1][i] - y[0][i]) / (2 * h);
        numerics_see(&c, n % 10 ? norm(got) / lengths.across : norm(got) / lengths.across * 0.1,
                     "r %.9g axis %.9g %.9g %.9g", r, axis[0], axis[1], axis[2]);
    }
    return numerics_close(&c);
}

// The variance along an axis of points of a cylinder that is contracted point by point, beside the
// Gaussian's through the Jacobian at its middle.
static int check_footprint(struct numerics_random *random) {
    enum { POINTS = 4096 };
    struct numerics_case c = {
        "18 contracted footprint", "lengths to a tenth of the distance", "relative", 0.02, 0, ""};
    for (int n = 0; n < 200; n++) {
        double d[3], towards[3], axis[3], y[3], r = numerics_spread(random, 0.1, 1e4);
        double length = r * numerics_spread(random, 1e-3, 0.1), ring = length / 2;
        double sum = 0, squares = 0, side[3], other[3];
        numerics_direction(random, d);
        numerics_direction(random, towards);
        numerics_direction(random, axis);
        if (fabs(r - 1) < length) r += 2 * length; // not through the border
        int k = fabs(d[0]) < 0.5 ? 0 : 1;
        for (int i = 0; i < 3; i++)
            side[i] = (i == k) - d[k] * d[i];
        double size = norm(side);
        for (int i = 0; i < 3; i++)
            side[i] /= size;
        for (int i = 0; i < 3; i++)
            other[i] = d[(i + 1) % 3] * side[(i + 2) % 3] - d[(i + 2) % 3] * side[(i + 1) % 3];
        for (int p = 0; p < POINTS; p++) { // a lattice of the cylinder
            double along = length * ((p % 16 + 0.5) / 16 - 0.5),
                   angle = 2 * acos(-1) * (p / 16 % 16) / 16;
            double out = ring * sqrt((p / 256 + 0.5) / 16), x[3], drawn[3], at = 0;
            for (int i = 0; i < 3; i++)
                x[i] = r * towards[i] + along * d[i] +
                       out * (cos(angle) * side[i] + sin(angle) * other[i]);
            contract(x, drawn);
            for (int i = 0; i < 3; i++)
                at += drawn[i] * axis[i];
            sum += at;
            squares += at * at;
        }
        (void)sum;
        double mean = sum / POINTS, truth = squares / POINTS - mean * mean;
        struct rn_contraction lengths = rn_contraction_at(r);
        rn_contracted_axis(&lengths, towards, axis, y);
        double got = rn_projected_variance(y, d, length * length / 12, ring * ring / 4);
        // The axis of least variance is told by what is left out of the linearisation.
        double scale = lengths.across * lengths.across * length * length / 48;
        numerics_see(&c, fabs(got - truth) / fmax(truth, scale), "r %.6g length %.6g", r, length);
    }
    return numerics_close(&c);
}

// Between any two steps of a ray, and that some come nearly as far.
static int check_pace(struct numerics_random *random) {
    struct numerics_case pace = {"18 way of a bent ray in a step",
                                 "0.01 to 10 radii past the centre",
                                 "of the bound",
                                 1,
                                 0,
                                 ""};
    struct numerics_case slack = {
        "18 bound of that way", "0.01 to 10 radii past the centre", "of the way", 1.05, 0, ""};
    for (int n = 0; n < 400; n++) {
        double b = numerics_spread(random, 0.01, 10), h = numerics_spread(random, 5e-4, 4e-3);
        double bound = h * sqrt((double)rn_squared_pace((float)(b * b))) * (1 + 1e-6), most = 0;
        double at[2][3] = {{0}};
        for (int k = 0; k * 2 * h < 4 - 2 * h; k++) {
            double x[3] = {rn_distance_of_place((2 * k + 1) * h - 2), b, 0}, *y = at[k % 2];
            contract(x, y);
            double way = hypot(y[0] - at[1 - k % 2][0], y[1] - at[1 - k % 2][1]);
            if (k > 0) most = fmax(most, way);
        }
        numerics_see(&pace, most / bound, "b %.9g h %.9g", b, h);
        numerics_see(&slack, bound / most, "b %.9g h %.9g", b, h);
    }
    return numerics_close(&pace) + numerics_close(&slack);
}

static struct rn_field *make_grid(struct numerics_random *random, double part) {
    struct rn_train_config config;
    struct rn_bounds bounds = {.radius = 1};
    struct rn_field *field = NULL;
    if (rn_preset("draft", false, &config, NULL) != RN_OK) exit(1);
    config.field.space = RN_SPACE_UNBOUNDED;
    config.field.occupancy = 32;
    config.field.base = 16;
    config.field.levels = 2;
    config.grow_to = 0;
    if (rn_field_create(&config, &bounds, &field, NULL) != RN_OK) exit(1);
    for (size_t i = 0; i < 32 * 32 * 32; i++)
        field->occupancy[i] = numerics_uniform(random, 0, 1) < part ? 1 : 0;
    rn_field_refresh_occupancy(field);
    return field;
}

static struct rn_ray draw_ray(struct numerics_random *random) {
    struct rn_ray ray = {.radius = 1e-3};
    double away = numerics_spread(random, 1e-3, 1e3);
    numerics_direction(random, ray.origin);
    numerics_direction(random, ray.direction);
    for (int i = 0; i < 3; i++)
        ray.origin[i] *= away;
    return ray;
}

// Every step behind the near end is looked at once: those whose middle lies in an occupied cell are
// samples, in order, and no other. Middles within 1e-4 cells of a cell's side may be either.
static int check_steps(const struct subject *s, struct numerics_random *random) {
    static uint16_t found[4096];
    char name[3][80];
    snprintf(name[2], sizeof name[2], "18 cell told what a sample showed, %s", s->name);
    struct numerics_case told_cells = {name[2], "cameras at 1e-3 to 1e3 radii", "wrong", 0.5, 0,
                                       ""};
    snprintf(name[0], sizeof name[0], "18 samples of a bent ray, %s", s->name);
    snprintf(name[1], sizeof name[1], "18 ray from its near end to infinity, %s", s->name);
    struct numerics_case cells = {name[0], "cameras at 1e-3 to 1e3 radii", "wrong", 0.5, 0, ""};
    struct numerics_case ends = {name[1], "cameras at 1e-3 to 1e3 radii", "of its allowance", 1, 0,
                                 ""};
    for (int n = 0; n < 400; n++) {
        struct rn_field *field = make_grid(random, n % 4 ? 0.3 : 1);
        struct rn_ray ray = draw_ray(random);
        double step = numerics_spread(random, 0.002, 0.05), along = 0;
        struct rn_march_ray march = rn_march_ray_from(field, &ray, step, 0);
        int count = s->march(&field->cpu.occupancy, &march, (float)step, found, 4096);
        int steps = (int)(march.length / (2 * (float)step)), next = 0;
        for (int i = 0; i < 3; i++)
            along += ray.origin[i] * ray.direction[i];
        double begin = 2 - (double)march.length,
               start = rn_place_of_distance(along + RN_SPACE_NEAR);
        numerics_see(&ends, fabs(begin - start) / 0x1p-20, "near end, along %.9g", along);
        numerics_see(&ends, fabs(2 - begin - steps * 2 * step) / (2 * step + 0x1p-20), "far end");
        for (int k = 0; k < steps; k++) {
            double at = rn_distance_of_place(begin + (2 * k + 1) * (double)(float)step), x[3], y[3];
            bool sure = true, occupied;
            int cell[3];
            for (int i = 0; i < 3; i++)
                x[i] = (double)march.origin[i] + at * (double)march.direction[i];
            contract(x, y);
            for (int i = 0; i < 3; i++) {
                double c = (y[i] + 1) * 16;
                cell[i] = rn_cell_of(y[i], 32);
                sure &= fabs(c - nearbyint(c)) > 1e-4;
            }
            size_t index = rn_cell_index(cell[0], cell[1], cell[2], 32);
            double middle = 0; // of the cell, from the centre, squared
            for (int i = 0; i < 3; i++)
                middle += pow((cell[i] + 0.5) / 16 - 1, 2);
            occupied = field->hull[index] &&
                       (field->occupancy[index] > 0.5f || sqrt(middle) > 1 - 0.5 / 16);
            bool got = next < count && found[next] == k;
            next += got;
            int told = s->cell(&field->cpu, &march, at);
            numerics_see(&told_cells, sure && told != (int)index, "cell %d, not %d", told,
                         (int)index);
            numerics_see(&cells, sure && got != occupied, "step %d of %d, %.9g %.9g %.9g", k, steps,
                         x[0], x[1], x[2]);
        }
        numerics_see(&cells, next != count, "%d samples of %d in order", next, count);
        rn_field_destroy(&field);
    }
    return numerics_close(&cells) + numerics_close(&ends) + numerics_close(&told_cells);
}

int main(void) {
    struct numerics_random random = numerics_random();
    const struct subject *s;
    int failed = check_inverses(&random) + check_jacobian(&random) + check_footprint(&random) +
                 check_pace(&random);
    for (int i = 0; (s = subject_at(i)); i++) {
        if (s->contraction) failed += check_contraction(s, &random) + check_places(s, &random);
        if (s->march) failed += check_steps(s, &random);
    }
    return failed > 0;
}
