// Case 7: lenses: points bent and unbent, rays, cones, pixels of points, and where a lens folds,
// against the published formulas as their sources write them.
#include "common/math/camera.h"

#include "tests/numerics/exact.h"
#include "tests/support/numerics.h"

#define LENSES 6 // all but the pinhole
static const double pi = 3.14159265358979323846;

// ---- the formulas, as published ---------------------------------------------------------------

// 1 + k[0] s + k[1] s^2 + ...
static exact series(const double *k, int count, exact s) {
    exact sum = number(0);
    for (int i = count - 1; i >= 0; i--)
        sum = times(plus(sum, number(k[i])), s);
    return plus(sum, number(1));
}

// 2 p1 u v + p2 (r^2 + 2 u^2) + prism r^2
static exact tangential(double p1, double p2, double prism, exact u, exact v, exact s) {
    exact first = times(number(2 * p1), times(u, v));
    exact second = times(number(p2), plus(s, times(number(2), square(u))));
    return plus(plus(first, second), times(number(prism), s));
}

static void exact_bend(const struct rn_camera *c, const exact q[2], exact ret[2]) {
    const double *k = c->lens_k;
    exact s = plus(square(q[0]), square(q[1])), g = number(1);
    double p1 = 0, p2 = 0, prism[2] = {0, 0};
    if (c->lens == RN_LENS_OPENCV)
        g = over(series((const double[]){k[0], k[1], k[4]}, 3, s), series(k + 5, 3, s));
    if (c->lens == RN_LENS_POLYNOMIAL || c->lens == RN_LENS_FISHEYE) g = series(k, 4, s);
    if (c->lens == RN_LENS_THIN_PRISM_FISHEYE)
        g = series((const double[]){k[0], k[1], k[4], k[5]}, 4, s);
    if (c->lens == RN_LENS_OPENCV || c->lens == RN_LENS_THIN_PRISM_FISHEYE) p1 = k[2], p2 = k[3];
    if (c->lens == RN_LENS_POLYNOMIAL) p1 = k[4], p2 = k[5];
    if (c->lens == RN_LENS_THIN_PRISM_FISHEYE) prism[0] = k[6], prism[1] = k[7];
    ret[0] = plus(times(q[0], g), tangential(p1, p2, prism[0], q[0], q[1], s));
    ret[1] = plus(times(q[1], g), tangential(p2, p1, prism[1], q[1], q[0], s));
}

// The direction of a flat point, of length 1.
static void exact_look(const struct rn_camera *c, const exact q[2], exact ret[3]) {
    exact r = root(plus(square(q[0]), square(q[1])));
    ret[0] = q[0], ret[1] = q[1], ret[2] = number(1);
    if (c->lens == RN_LENS_EQUIRECTANGULAR) {
        ret[0] = times(sine(q[0]), cosine(q[1]));
        ret[1] = sine(q[1]);
        ret[2] = times(cosine(q[0]), cosine(q[1]));
    } else if (c->lens == RN_LENS_FISHEYE || c->lens == RN_LENS_THIN_PRISM_FISHEYE) {
        exact per = over(sine(r), r);
        ret[0] = times(q[0], per), ret[1] = times(q[1], per), ret[2] = cosine(r);
    } else if (c->lens == RN_LENS_FOV) {
        exact omega = number(c->lens_k[0]);
        exact wide = times(number(2), tangent(over(omega, number(2))));
        exact per = over(over(tangent(times(r, omega)), wide), r);
        ret[0] = times(q[0], per), ret[1] = times(q[1], per);
    }
    exact norm = root(plus(plus(square(ret[0]), square(ret[1])), square(ret[2])));
    for (int i = 0; i < 3; i++)
        ret[i] = over(ret[i], norm);
}

// The flat point of a direction.
static void exact_flatten(const struct rn_camera *c, const double p[3], exact ret[2]) {
    exact x = number(p[0]), y = number(p[1]), z = number(p[2]), per = over(number(1), z);
    exact r = root(plus(square(x), square(y)));
    if (c->lens == RN_LENS_FISHEYE || c->lens == RN_LENS_THIN_PRISM_FISHEYE)
        per = over(angle_of(r, z), r);
    if (c->lens == RN_LENS_FOV) {
        exact omega = number(c->lens_k[0]);
        exact wide = times(number(2), tangent(over(omega, number(2))));
        per = over(over(arc_tangent(times(over(r, z), wide)), omega), r);
    }
    ret[0] = times(x, per), ret[1] = times(y, per);
    if (c->lens != RN_LENS_EQUIRECTANGULAR) return;
    ret[0] = angle_of(x, z);
    ret[1] = angle_of(y, root(plus(square(x), square(z))));
}

// ---- cameras ----------------------------------------------------------------------------------

static void draw_parameters(struct numerics_random *random, int n, struct rn_camera *c) {
    // Every fourth a lens as one finds them, then stronger ones; some purely radial.
    static const double sizes[] = {0.02, 0.1, 0.3, 1};
    double size = sizes[n / LENSES % 4];
    bool radial = n / LENSES % 3 == 0;
    for (int i = 0; i < rn_lens_models[c->lens].count; i++) {
        const char *name = rn_lens_models[c->lens].parameters[i];
        double most = name[0] == 'k' ? size : radial ? 0 : 0.02 * size;
        c->lens_k[i] = numerics_uniform(random, -most, most);
    }
    if (c->lens == RN_LENS_FOV) c->lens_k[0] = numerics_spread(random, 1e-12, 3);
}

static struct rn_camera draw_camera(struct numerics_random *random, int n) {
    struct rn_camera c = {.lens = (enum rn_lens)(1 + n % LENSES), .width = 1920, .height = 1080};
    c.fx = numerics_spread(random, 100, 5000);
    c.fy = c.fx * numerics_spread(random, 0.8, 1.25);
    c.cx = numerics_uniform(random, 800, 1100);
    c.cy = numerics_uniform(random, 400, 700);
    draw_parameters(random, n, &c);
    for (int i = 0; i < 3; i++)
        c.world_from_camera[i][i] = 1;
    struct rn_error err;
    if (rn_camera_check(&c, "", &err) != RN_OK) {
        fprintf(stderr, "%s: %s\n", err.where, err.text);
        exit(1);
    }
    return c;
}

// A flat point inside the fold, as far out as a picture goes: 80 degrees in the plane.
static void draw_flat(struct numerics_random *random, const struct rn_camera *c, double q[2]) {
    double most = fmin(0.98 * c->lens_fold, 5.67), angle = numerics_uniform(random, 0, 2 * pi);
    double r = most * sqrt(numerics_uniform(random, 0, 1));
    q[0] = r * cos(angle), q[1] = r * sin(angle);
    if (c->lens != RN_LENS_EQUIRECTANGULAR) return;
    q[0] = numerics_uniform(random, -pi, pi), q[1] = numerics_uniform(random, -1.57, 1.57);
}

// The sizes of a bent point's terms, all taken as positive: what rounding is measured by.
static double size_of_terms(const struct rn_lens_terms *t, const double q[2]) {
    double s = q[0] * q[0] + q[1] * q[1], r = sqrt(s), sum = 1, below = 1, d = 1, power = s;
    for (int i = 0; i < 4; i++, power *= s) {
        sum += fabs(t->above[i]) * power;
        if (i < 3) below += fabs(t->below[i]) * power, d += t->below[i] * power;
    }
    return r * sum * (below / d) / d +
           s * (3 * hypot(t->p1, t->p2) + hypot(t->prism[0], t->prism[1]));
}

// The least singular value of a bent point's derivative.
static double weakest(const struct rn_bent *b) {
    double half = (b->xx * b->xx + b->xy * b->xy + b->yx * b->yx + b->yy * b->yy) / 2;
    double det = b->xx * b->yy - b->xy * b->yx;
    double large = half + sqrt(fmax(half * half - det * det, 0));
    return fabs(det) / sqrt(large);
}

// The exact root of a bent point, from one near it.
static void exact_root(const struct rn_camera *c, const struct rn_lens_terms *t,
                       const double near[2], const double bent[2], exact ret[2]) {
    struct rn_bent at = rn_lens_bend(t, near[0], near[1]);
    double det = at.xx * at.yy - at.xy * at.yx;
    ret[0] = number(near[0]), ret[1] = number(near[1]);
    // Wrong formulas lead away from it, to where 256 bits of a sine take long.
    for (int i = 0; i < 12 && rounded(plus(size_of(ret[0]), size_of(ret[1]))) < 1e3; i++) {
        exact got[2];
        exact_bend(c, ret, got);
        exact ex = minus(got[0], number(bent[0])), ey = minus(got[1], number(bent[1]));
        ret[0] =
            minus(ret[0], minus(times(number(at.yy / det), ex), times(number(at.xy / det), ey)));
        ret[1] =
            minus(ret[1], minus(times(number(at.xx / det), ey), times(number(at.yx / det), ex)));
    }
}

// ---- cases ------------------------------------------------------------------------------------

#define WHERE "%s %.9g %.9g %.9g %.9g %.9g, flat %.17g %.17g"
#define AT(c, q)                                                                                   \
    rn_lens_names[(c)->lens], (c)->lens_k[0], (c)->lens_k[1], (c)->lens_k[2], (c)->lens_k[3],      \
        (c)->lens_k[4], (q)[0], (q)[1]

static const char *const range = "6 lenses, parameters to 1, tangential ones to 0.02, omega "
                                 "1e-12..3, 98 % of the way to the fold or 80 degrees";

struct cases {
    struct numerics_case bend, root, direction, cone, project;
};

// Of the direction per bent area, by differences in 256 bits.
static exact exact_area(const struct rn_camera *c, const struct rn_lens_terms *t,
                        const exact q[2]) {
    exact h = number(0x1p-80), bent[2][2][2], look[2][2][3], flat[2];
    for (int i = 0; i < 4; i++) { // along u and v, forwards and back
        exact step = i % 2 ? negative(h) : h;
        flat[0] = i < 2 ? plus(q[0], step) : q[0];
        flat[1] = i < 2 ? q[1] : plus(q[1], step);
        exact_bend(c, flat, bent[i / 2][i % 2]);
        exact_look(c, flat, look[i / 2][i % 2]);
    }
    exact j[2][2], d[2][3], squares = number(0), wide = times(number(2), h);
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < 2; k++)
            j[i][k] = over(minus(bent[i][0][k], bent[i][1][k]), wide);
        for (int k = 0; k < 3; k++)
            d[i][k] = over(minus(look[i][0][k], look[i][1][k]), wide);
    }
    for (int k = 0; k < 3; k++) {
        int l = (k + 1) % 3, m = (k + 2) % 3;
        squares = plus(squares, square(minus(times(d[0][l], d[1][m]), times(d[0][m], d[1][l]))));
    }
    exact det = minus(times(j[0][0], j[1][1]), times(j[0][1], j[1][0]));
    bool plane = t->omega == 0 && c->lens != RN_LENS_EQUIRECTANGULAR;
    return over(plane ? number(1) : root(squares), det);
}

static void check_point(struct numerics_random *random, int n, struct cases *cases) {
    const double unit = 0x1p-53;
    struct rn_camera c = draw_camera(random, n);
    struct rn_lens_terms t = rn_lens_terms(c.lens, c.lens_k);
    double q[2], found[2];
    draw_flat(random, &c, q);
    struct rn_bent at = rn_lens_bend(&t, q[0], q[1]), again;
    double size = size_of_terms(&t, q), weak = weakest(&at);
    exact truth[2], flat[2] = {number(q[0]), number(q[1])}, look[3];
    exact_bend(&c, flat, truth);
    double error = fmax(exact_distance(at.x, truth[0]), exact_distance(at.y, truth[1]));
    numerics_see(&cases->bend, error / (unit * size), WHERE, AT(&c, q));
    // Bent points as a picture has them: of a pixel.
    double px = at.x * c.fx + c.cx, py = at.y * c.fy + c.cy;
    double bent[2] = {(px - c.cx) / c.fx, (py - c.cy) / c.fy};
    bool inside = rn_lens_unbend(&t, c.lens_fold, bent[0], bent[1], found, &again);
    exact_root(&c, &t, q, bent, flat);
    error = fmax(exact_distance(found[0], flat[0]), exact_distance(found[1], flat[1]));
    double condition = hypot(q[0], q[1]) + size / weak;
    numerics_see(&cases->root, inside ? error / (unit * condition) : INFINITY, WHERE, AT(&c, q));
    struct rn_ray ray = rn_camera_ray(&c, px, py);
    exact_look(&c, flat, look);
    for (int i = 0; i < 3; i++)
        numerics_see(&cases->direction,
                     exact_distance(ray.direction[i], look[i]) / (unit * (2 + condition)), WHERE,
                     AT(&c, q));
    // The area changes with the derivative's rounding, and where the root is off.
    exact area = exact_area(&c, &t, flat);
    exact radius = root(over(area, times(exact_pi(), times(number(c.fx), number(c.fy)))));
    double r = hypot(q[0], q[1]), sensitive = (1 + size / r / weak) * (1 + condition / r);
    numerics_see(&cases->cone,
                 exact_distance(ray.radius, radius) / rounded(radius) / (unit * sensitive), WHERE,
                 AT(&c, q));
    double pixel[2] = {NAN, NAN};
    exact point[2];
    if (!rn_camera_project(&c, ray.direction, pixel)) pixel[0] = NAN;
    exact_flatten(&c, ray.direction, point);
    exact_bend(&c, point, truth);
    exact x = plus(times(truth[0], number(c.fx)), number(c.cx));
    exact y = plus(times(truth[1], number(c.fy)), number(c.cy));
    error = fmax(exact_distance(pixel[0], x), exact_distance(pixel[1], y));
    numerics_see(&cases->project, error / (unit * (c.fx * size + 2000)), WHERE, AT(&c, q));
}

static int check_points(struct numerics_random *random) {
    struct cases cases = {
        {"7 lens: a point bent", range, "2^-53 of its terms", 16, 0, ""},
        {"7 lens: a point unbent", range, "2^-53 times its condition", 8, 0, ""},
        {"7 lens: ray direction", range, "2^-53 times its condition", 8, 0, ""},
        {"7 lens: cone radius", range, "2^-53 times its condition", 32, 0, ""},
        {"7 lens: pixel of a point", range, "2^-53 of its terms", 48, 0, ""},
    };
    for (int n = 0; n < 12000; n++) {
        exact_reset();
        check_point(random, n, &cases);
    }
    return numerics_close(&cases.bend) + numerics_close(&cases.root) +
           numerics_close(&cases.direction) + numerics_close(&cases.cone) +
           numerics_close(&cases.project);
}

// Radial lenses: the fold is where r g(r) stops growing; a bent point short of it is unbent to a
// point inside, one beyond is refused.
static int check_folds(struct numerics_random *random) {
    struct numerics_case place = {"7 lens: where it folds", range, "relative", 1e-9, 0, ""};
    struct numerics_case beyond = {"7 lens: beyond the fold", range, "wrong", 0, 0, ""};
    for (int n = 0; n < 6000; n++) {
        struct rn_camera c = draw_camera(random, n);
        const double *k = c.lens_k;
        if (c.lens == RN_LENS_FOV || c.lens == RN_LENS_EQUIRECTANGULAR) continue;
        for (int i = 0; i < rn_lens_models[c.lens].count; i++)
            if (rn_lens_models[c.lens].parameters[i][0] != 'k') c.lens_k[i] = 0;
        if (c.lens == RN_LENS_OPENCV) c.lens_k[5] = c.lens_k[6] = c.lens_k[7] = 0;
        double fold = c.lens_fold = rn_lens_fold(c.lens, k), s = fold * fold;
        bool far = fold > (c.lens == RN_LENS_OPENCV || c.lens == RN_LENS_POLYNOMIAL ? 5 : 3.14);
        double a[4] = {k[0], k[1], k[2], k[3]};
        if (c.lens == RN_LENS_OPENCV) a[2] = k[4], a[3] = 0;
        if (c.lens == RN_LENS_THIN_PRISM_FISHEYE) a[2] = k[4], a[3] = k[5];
        if (far) continue;
        double slope = 1 + s * (3 * a[0] + s * (5 * a[1] + s * (7 * a[2] + s * 9 * a[3])));
        double bend =
            s * (6 * a[0] + s * (20 * a[1] + s * (42 * a[2] + s * 72 * a[3]))); // r slope'
        double q[2] = {fold, 0};
        numerics_see(&place, fabs(slope / bend), WHERE, AT(&c, q));
        struct rn_lens_terms t = rn_lens_terms(c.lens, k);
        struct rn_bent at = rn_lens_bend(&t, fold, 0), got;
        double angle = numerics_uniform(random, 0, 2 * pi);
        for (int out = 0; out < 2; out++) {
            double r = at.x * (out ? 1 + 1e-6 : 1 - 1e-6), found[2];
            bool inside = rn_lens_unbend(&t, fold, r * cos(angle), r * sin(angle), found, &got);
            numerics_see(&beyond, inside == (out == 1), WHERE, AT(&c, q));
        }
    }
    return numerics_close(&place) + numerics_close(&beyond);
}

int main(void) {
    struct numerics_random random = numerics_random();
    return check_points(&random) + check_folds(&random) > 0;
}
