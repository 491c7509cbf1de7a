// Case 17: the disparity box of forward-facing captures: the map and its Jacobian at extremes,
// rays cut to the box, what follows from a ray, cones through the map against sampled ones, and the
// distortion loss against its sum over all pairs.
#include <string.h>

#include "server/engine/kernels/ray.h"
#include "tests/numerics/exact.h"
#include "tests/numerics/subject.h"
#include "tests/support/numerics.h"

// A box around what a camera of up to 45 degrees to a side sees, the reference camera at the
// dataset's origin.
static struct rn_disparity draw_box(struct numerics_random *random) {
    struct rn_disparity box = {.on = true, .unit = 1, .axes = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    box.near = numerics_spread(random, 1e-6, 1e6);
    box.far = box.near * numerics_spread(random, 1.1, 1e6);
    double reach = numerics_uniform(random, 0.2, 1), disparity = 1 / box.near - 1 / box.far;
    for (int i = 0; i < 2; i++) {
        box.scale[i] = 1 / reach;
        box.shift[i] = numerics_uniform(random, -0.2, 0.2);
        box.half[i] = i ? numerics_uniform(random, 0.5, 1) : 1;
    }
    box.scale[2] = -2 / disparity;
    box.shift[2] = 1 - box.scale[2] / box.far;
    box.half[2] = 1;
    return box;
}

static exact exact_map(const struct rn_disparity *box, int i, const exact p[3]) {
    exact u = i < 2 ? over(p[i], p[2]) : over(number(1), p[2]);
    return plus(times(number(box->scale[i]), u), number(box->shift[i]));
}

static int check_map(struct numerics_random *random) {
    const char *range = "near 1e-6..1e6, far to 1e6 times that, z 1e-7..1e12";
    struct numerics_case map = {"17 disparity map", range, "ULP", 3, 0, ""};
    struct numerics_case back = {
        "17 disparity map and back", "z between near and far", "of its condition", 16, 0, ""};
    for (int n = 0; n < 20000; n++) {
        struct rn_disparity box = draw_box(random);
        double z = n % 2 ? numerics_spread(random, 1e-7, 1e12)
                         : numerics_spread(random, box.near, box.far),
               q[3], again[3];
        double p[3] = {z * numerics_uniform(random, -2, 2), z * numerics_uniform(random, -2, 2), z};
        rn_disparity_map(&box, p, q);
        rn_disparity_unmap(&box, q, again);
        exact_reset();
        exact at[3] = {number(p[0]), number(p[1]), number(p[2])};
        for (int i = 0; i < 3; i++) {
            double u = i < 2 ? p[i] / p[2] : 1 / p[2];
            double unit = 0x1p-52 * (fabs(box.scale[i] * u) + fabs(box.shift[i]));
            numerics_see(&map, exact_distance(q[i], exact_map(&box, i, at)) / unit,
                         "z %.9g, coordinate %d", z, i);
            // 1 / z is a difference of the cube's coordinate and its shift.
            double condition = 1 + fabs(box.shift[2] * z / box.scale[2]);
            double lateral = 1 + fabs(box.shift[i < 2 ? i : 0] / box.scale[i < 2 ? i : 0]);
            double size = fmax(fabs(p[i]), z);
            if (z >= box.near && z <= box.far)
                numerics_see(&back, fabs(again[i] - p[i]) / (size * condition * lateral * 0x1p-52),
                             "z %.9g, coordinate %d", z, i);
        }
    }
    return numerics_close(&map) + numerics_close(&back);
}

// A camera's ray in the reference camera's frame, its direction up to 50 degrees off the axis.
static struct rn_ray draw_ray(struct numerics_random *random, const struct rn_disparity *box) {
    struct rn_ray ray = {.radius = 1e-3};
    double norm = 0;
    for (int i = 0; i < 3; i++) {
        // Some cameras stand within the box.
        ray.origin[i] = box->near * numerics_uniform(random, -0.8, i < 2 ? 0.8 : 2);
        ray.direction[i] = i < 2 ? numerics_uniform(random, -0.8, 0.8) : 1;
        norm += ray.direction[i] * ray.direction[i];
    }
    for (int i = 0; i < 3; i++)
        ray.direction[i] /= sqrt(norm);
    return ray;
}

static void point_at(const struct rn_disparity *box, const struct rn_ray *ray, double t,
                     double ret[3]) {
    double p[3];
    for (int i = 0; i < 3; i++)
        p[i] = ray->origin[i] + t * ray->direction[i];
    rn_disparity_map(box, p, ret);
}

// By how much a point lies outside the box.
static double outside(const struct rn_disparity *box, const double q[3]) {
    double most = -INFINITY;
    for (int i = 0; i < 3; i++)
        most = fmax(most, fabs(q[i]) - box->half[i]);
    return most;
}

// Where a step of the march ends on the ray, distance from the camera.
static double distance_of(const struct rn_disparity *box, const struct rn_forward_ray *was,
                          const struct rn_march_ray *ray, double s) {
    double z = (double)ray->origin[2] + s * (double)ray->direction[2] - box->shift[2];
    return (box->scale[2] / z - was->eye) * was->slant;
}

// The stretch of the ray that is marched is that which lies within the box: a ray that misses has
// none, the ends lie on its faces, the camera or infinity, and on the ray; distances grow along it.
static int check_cut(struct numerics_random *random, const struct subject *s) {
    char names[4][80];
    const char *set = s ? s->name : "scalar", *range = "rays up to 50 degrees off the axis";
    static const char *const what[] = {"meets the box", "ends on its faces", "lies on the ray",
                                       "grows with the march"};
    struct numerics_case cases[4];
    for (int i = 0; i < 4; i++) {
        snprintf(names[i], sizeof names[i], "17 ray in a disparity box %s, %s", what[i], set);
        cases[i] = (struct numerics_case){names[i], range, "of 2^-20", 2, 0, ""};
    }
    cases[0].unit = cases[3].unit = "wrong";
    cases[0].bound = cases[3].bound = 0.5;
    cases[2].bound = 0.5;
    for (int n = 0; n < 20000; n++) {
        struct rn_disparity box = draw_box(random);
        box.far = fmin(box.far, 1e3 * box.near); // as positions in fp32 tell apart
        box.scale[2] = -2 / (1 / box.near - 1 / box.far);
        box.shift[2] = 1 - box.scale[2] / box.far;
        struct rn_ray ray = draw_ray(random, &box);
        struct rn_march_ray got;
        if (s)
            s->cut_forward(&box, &ray, 0.01, &got);
        else
            got = rn_ray_cut_forward(&box, &ray, 0.01, 0);
        // By sampling: how far into the box some point of the ray comes.
        double deepest = INFINITY, q[3];
        for (int i = 0; i <= 4096; i++) {
            double d = (1 / box.near) + (1 / box.far - 1 / box.near) * i / 4096;
            double t = (1 / d - ray.origin[2]) / ray.direction[2];
            if (t < 0) continue;
            point_at(&box, &ray, t, q);
            deepest = fmin(deepest, outside(&box, q));
        }
        bool hit = got.length > 0, clear = fabs(deepest) > 2e-3;
        numerics_see(&cases[0], clear && hit != (deepest < 0), "ray %d, deepest %.4g", n, deepest);
        if (!hit) continue;
        struct rn_forward_ray was = rn_forward_ray(&box, &got);
        double last = -1;
        for (int i = 0; i <= 8; i++) {
            double at = (double)got.length * i / 8, there[3];
            double t = distance_of(&box, &was, &got, at);
            point_at(&box, &ray, t, there);
            double apart = 0, along = 0; // `there` is the ray's point of the same depth
            for (int k = 0; k < 3; k++) {
                q[k] = (double)got.origin[k] + at * (double)got.direction[k];
                along += (q[k] - there[k]) * (double)got.direction[k];
            }
            for (int k = 0; k < 3; k++)
                apart = fmax(apart, fabs(q[k] - there[k] - along * (double)got.direction[k]));
            numerics_see(&cases[2], apart / 0x1p-20, "ray %d, %d eighths", n, i);
            numerics_see(&cases[3], !(t > last), "ray %d, %d eighths", n, i);
            last = t;
            bool within = ray.origin[2] > box.near; // it may start at the camera
            bool end = (i == 0 && !within) || i == 8;
            numerics_see(&cases[1], (end ? fabs(outside(&box, q)) : outside(&box, q)) / 0x1p-20,
                         "ray %d, %d eighths", n, i);
        }
    }
    int failed = 0;
    for (int i = 0; i < 4; i++)
        failed += numerics_close(&cases[i]);
    return failed;
}

// What a ray was before it was cut, from its line in the cube.
static int check_recovery(struct numerics_random *random) {
    struct numerics_case view = {
        "17 a cut ray's direction", "50 degrees off the axis", "of 2^-20", 4, 0, ""};
    struct numerics_case eye = {
        "17 a cut ray's camera", "far to 1e3 times near", "of 2^-20", 8, 0, ""};
    for (int n = 0; n < 20000; n++) {
        struct rn_disparity box = draw_box(random);
        box.far = fmin(box.far, 1e3 * box.near);
        box.scale[2] = -2 / (1 / box.near - 1 / box.far);
        box.shift[2] = 1 - box.scale[2] / box.far;
        struct rn_ray ray = draw_ray(random, &box);
        struct rn_march_ray cut = rn_ray_cut_forward(&box, &ray, 0.01, 0.5);
        if (!(cut.length > 0.1f)) continue;
        struct rn_forward_ray was = rn_forward_ray(&box, &cut);
        double start = box.scale[2] / ((double)cut.origin[2] - box.shift[2]); // z
        for (int i = 0; i < 3; i++)
            numerics_see(&view, fabs(was.view[i] - ray.direction[i]) / 0x1p-20, "ray %d", n);
        numerics_see(&eye, fabs(was.eye - ray.origin[2]) / (start * start / box.near * 0x1p-20),
                     "ray %d, starts at %.3g near depths", n, start / box.near);
    }
    return numerics_close(&view) + numerics_close(&eye);
}

// The radius that a sample's levels go by, against the spread of points of the cone's cross-section
// through the map, along and across: what is left out is the tilt towards the reference's axis.
static int check_width(struct numerics_random *random) {
    struct numerics_case c = {"17 a cone's width in a disparity box against sampled points",
                              "35 degrees off the axis",
                              "levels",
                              0.4,
                              0,
                              ""};
    for (int n = 0; n < 400; n++) {
        struct rn_disparity box = draw_box(random);
        struct rn_ray ray = draw_ray(random, &box);
        ray.radius = 1e-4;
        double side = hypot(ray.direction[0], ray.direction[1]);
        if (side > sin(35 / 57.2957795)) continue;
        double z = box.near * numerics_uniform(random, 1.1, 20);
        double t = (z - ray.origin[2]) / ray.direction[2], axis[3][3], squares[2] = {0};
        if (t <= 0) continue;
        // Two directions across the ray.
        memcpy(axis[2], ray.direction, sizeof axis[2]);
        double help[3] = {1, 0, 0};
        for (int k = 0; k < 3; k++)
            axis[0][k] =
                help[(k + 1) % 3] * axis[2][(k + 2) % 3] - help[(k + 2) % 3] * axis[2][(k + 1) % 3];
        double size =
            sqrt(axis[0][0] * axis[0][0] + axis[0][1] * axis[0][1] + axis[0][2] * axis[0][2]);
        for (int k = 0; k < 3; k++)
            axis[0][k] /= size;
        for (int k = 0; k < 3; k++)
            axis[1][k] = axis[2][(k + 1) % 3] * axis[0][(k + 2) % 3] -
                         axis[2][(k + 2) % 3] * axis[0][(k + 1) % 3];
        // A disc's points, moved along the mapped ray to one depth.
        double centre[3], ahead[3], p[3], q[3];
        point_at(&box, &ray, t, centre);
        point_at(&box, &ray, t * (1 + 1e-6), ahead);
        enum { RING = 64 };
        for (int i = 0; i < RING; i++) {
            double angle = 6.283185307179586 * i / RING, radius = ray.radius * t;
            for (int k = 0; k < 3; k++)
                p[k] = ray.origin[k] + t * axis[2][k] +
                       radius * (cos(angle) * axis[0][k] + sin(angle) * axis[1][k]);
            rn_disparity_map(&box, p, q);
            double back = (q[2] - centre[2]) / (ahead[2] - centre[2]);
            for (int k = 0; k < 2; k++) {
                double off = q[k] - centre[k] - back * (ahead[k] - centre[k]);
                squares[k] += off * off / (RING / 2.0);
            }
        }
        double wide = ray.radius / ray.direction[2] * box.scale[0] * (1 - ray.origin[2] / z);
        double most = sqrt(fmax(squares[0], squares[1])),
               least = sqrt(fmin(squares[0], squares[1]));
        numerics_see(&c, fmax(fabs(log2(most / wide)), fabs(log2(least / wide))),
                     "%.0f degrees off, z %.3g near depths", asin(side) * 57.2957795, z / box.near);
    }
    return numerics_close(&c);
}

// Against the sum over all pairs in exact arithmetic, differentiated by hand.
static int check_distortion(const struct subject *s, struct numerics_random *random) {
    enum { MOST = 256 };
    char name[80];
    snprintf(name, sizeof name, "17 gradient of the distortion loss, %s", s->name);
    struct numerics_case c = {name, "1 to 256 samples", "of factor times length", 1e-6, 0, ""};
    for (int n = 0; n < 40; n++) {
        double weights[MOST], places[MOST], grad[MOST], width = 1.0 / 96, sum = 0;
        int count = n < 2 ? n + 1 : (int)numerics_spread(random, 1, MOST);
        for (int i = 0; i < count; i++)
            sum += weights[i] = numerics_spread(random, 1e-6, 1);
        for (int i = 0; i < count; i++) {
            weights[i] = s->nearest(weights[i] / sum);
            places[i] = s->nearest((i + 0.5) * width);
        }
        s->distortion(count, weights, places, width, 0.5, grad);
        for (int k = 0; k < count; k++) {
            exact_reset();
            exact truth = times(number(weights[k]), number(width * (2.0 / 3)));
            for (int i = 0; i < count; i++) {
                exact apart = size_of(minus(number(places[i]), number(places[k])));
                truth = plus(truth, times(number(2), times(number(weights[i]), apart)));
            }
            truth = times(truth, number(0.5));
            double length = 0.5 * fmax(count * width, width);
            numerics_see(&c, exact_distance(grad[k], truth) / length, "%d samples, sample %d",
                         count, k);
        }
    }
    return numerics_close(&c);
}

int main(void) {
    struct numerics_random random = numerics_random();
    const struct subject *s;
    int failed = check_map(&random) + check_cut(&random, NULL) + check_recovery(&random) +
                 check_width(&random);
    for (int i = 0; (s = subject_at(i)); i++)
        if (s->cut_forward) failed += check_cut(&random, s) + check_distortion(s, &random);
    return failed > 0;
}
