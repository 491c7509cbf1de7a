// A still life: the five Platonic solids as cages of thin rods, a glossy ball in each, on a
// polished checkerboard, in the light of a lamp that is wide enough for soft shadows.
#include <pthread.h>

#include "common/dataset/synth_scenes.h"

#define GROUND (-0.46)
#define DISC 1.2    // radius of the checkerboard
#define SQUARE 0.15 // its squares' side
#define PHI 1.6180339887498949
#define SOLIDS 5
#define MOST_VERTICES 20
#define MOST_EDGES 30
#define LOOSE 3 // balls beside the cages

enum { BOARD, BOARD_TOP, ROD, BALL };

// A ball that lies on the board.
struct marble {
    double x, y, radius, colour[3];
};

static const struct row {
    int vertices;
    struct vec down;               // a face's normal: that side lies on the board
    double x, y, turn, reach, rod; // reach: from the centre to a corner; rod: radius
} rows[SOLIDS] = {
    {4, {-1, -1, -1}, -0.42, 0.70, 0.3, 0.36, 0.013},
    {8, {0, 0, -1}, 0.56, 0.60, 0.5, 0.36, 0.013},
    {6, {1, 1, 1}, 0.70, -0.24, 0.9, 0.34, 0.013},
    {20, {0, 1, PHI}, -0.70, -0.12, 0.2, 0.38, 0.012},
    {12, {1, 1, 1}, 0.02, 0.06, 0.4, 0.50, 0.017},
};

static const struct marble marbles[SOLIDS + LOOSE] = {
    {-0.42, 0.70, 0.085, {0.90, 0.66, 0.12}}, {0.56, 0.60, 0.150, {0.10, 0.50, 0.34}},
    {0.70, -0.24, 0.130, {0.74, 0.20, 0.12}}, {-0.70, -0.12, 0.200, {0.14, 0.34, 0.70}},
    {0.02, 0.06, 0.270, {0.70, 0.08, 0.16}},  {-0.16, -0.76, 0.110, {0.86, 0.84, 0.80}},
    {0.16, -0.86, 0.070, {0.92, 0.60, 0.10}}, {0.36, -0.66, 0.085, {0.20, 0.52, 0.60}},
};

struct cage {
    struct vec centre, corners[MOST_VERTICES];
    double reach, rod;
    int corner_count, edge_count;
    struct {
        struct vec from, along; // along: unit
        double length;
    } edges[MOST_EDGES];
};

static struct cage cages[SOLIDS];

// ---- the solids: corners by symmetry, edges between nearest corners ---------------------------

// (x, y, z) with every choice of signs (those of a zero once), in all cyclic orders of the axes
// when `turns` is 3; `even`: only an even number of minus signs.
static void add_corners(struct cage *cage, double x, double y, double z, int turns, bool even) {
    for (int turn = 0; turn < turns; turn++)
        for (int signs = 0; signs < 8; signs++) {
            double p[3] = {x, y, z};
            bool again = false;
            for (int i = 0; i < 3; i++) {
                again |= p[i] == 0 && (signs >> i & 1);
                if (signs >> i & 1) p[i] = -p[i];
            }
            if (again || (even && __builtin_popcount((unsigned)signs) % 2)) continue;
            cage->corners[cage->corner_count++] =
                (struct vec){p[turn], p[(turn + 1) % 3], p[(turn + 2) % 3]};
        }
}

static void make_corners(struct cage *cage, int count) {
    if (count == 4) add_corners(cage, 1, 1, 1, 1, true);
    if (count == 8 || count == 20) add_corners(cage, 1, 1, 1, 1, false);
    if (count == 6) add_corners(cage, 1, 0, 0, 3, false);
    if (count == 12) add_corners(cage, 0, 1, PHI, 3, false);
    if (count == 20) add_corners(cage, 0, PHI, 1 / PHI, 3, false);
}

static struct vec cross(struct vec a, struct vec b) {
    return (struct vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// To its size, its face down, turned, and onto the board.
static void set_down(struct cage *cage, const struct row *row) {
    struct vec up = vec_scale(-1, vec_unit(row->down)),
               seed = {cos(row->turn), sin(row->turn), 0.2};
    struct vec right = vec_unit(vec_add(seed, -vec_dot(seed, up), up)), ahead = cross(up, right);
    double lowest = INFINITY;
    for (int i = 0; i < cage->corner_count; i++) {
        struct vec p = vec_scale(row->reach, vec_unit(cage->corners[i]));
        p = (struct vec){vec_dot(p, right), vec_dot(p, ahead), vec_dot(p, up)};
        cage->corners[i] = p;
        lowest = fmin(lowest, p.z);
    }
    cage->centre = (struct vec){row->x, row->y, GROUND + 1.4 * row->rod - lowest};
    for (int i = 0; i < cage->corner_count; i++)
        cage->corners[i] = vec_add(cage->corners[i], 1, cage->centre);
}

static double distance(struct vec a, struct vec b) {
    struct vec between = vec_add(b, -1, a);
    return sqrt(vec_dot(between, between));
}

static void make_edges(struct cage *cage) {
    double shortest = INFINITY;
    for (int i = 1; i < cage->corner_count; i++)
        shortest = fmin(shortest, distance(cage->corners[0], cage->corners[i]));
    for (int i = 0; i < cage->corner_count; i++)
        for (int j = 0; j < i; j++) {
            struct vec between = vec_add(cage->corners[i], -1, cage->corners[j]);
            double length = distance(cage->corners[i], cage->corners[j]);
            if (length > 1.01 * shortest || cage->edge_count == MOST_EDGES) continue;
            cage->edges[cage->edge_count].from = cage->corners[j];
            cage->edges[cage->edge_count].along = vec_unit(between);
            cage->edges[cage->edge_count++].length = length;
        }
}

static void make_cages(void) {
    for (int i = 0; i < SOLIDS; i++) {
        cages[i].reach = rows[i].reach;
        cages[i].rod = rows[i].rod;
        make_corners(&cages[i], rows[i].vertices);
        set_down(&cages[i], &rows[i]);
        make_edges(&cages[i]);
    }
}

// ---- what a ray meets -------------------------------------------------------------------------

// A round rod without ends: the balls at the corners close it.
static void hit_rod(const struct ray *ray, const struct cage *cage, int edge, struct hit *hit) {
    struct vec along = cage->edges[edge].along;
    struct vec o = vec_add(ray->origin, -1, cage->edges[edge].from);
    double o_along = vec_dot(o, along), d_along = vec_dot(ray->direction, along);
    double apart = vec_dot(o, cross(ray->direction, along)); // times the sine between the lines
    if (apart * apart > cage->rod * cage->rod * (1 - d_along * d_along)) return;
    struct vec op = vec_add(o, -o_along, along), dp = vec_add(ray->direction, -d_along, along);
    double a = vec_dot(dp, dp), b = vec_dot(op, dp);
    double root = b * b - a * (vec_dot(op, op) - cage->rod * cage->rod);
    if (!(root > 0) || a == 0) return;
    double t = (-b - sqrt(root)) / a, at = o_along + t * d_along;
    if (at < 0 || at > cage->edges[edge].length) return;
    take_hit(hit, t, vec_scale(1 / cage->rod, vec_add(op, t, dp)), ROD);
}

static void hit_cage(const struct ray *ray, const struct cage *cage, struct hit *hit) {
    double begin, end;
    if (!sphere_span(ray, cage->centre, cage->reach + 2 * cage->rod, &begin, &end) ||
        end < hit->t_min || begin > hit->t)
        return;
    for (int i = 0; i < cage->edge_count; i++)
        hit_rod(ray, cage, i, hit);
    for (int i = 0; i < cage->corner_count; i++)
        hit_ball(ray, cage->corners[i], 1.4 * cage->rod, ROD, hit);
}

static void still_nearest(const struct ray *ray, struct hit *hit) {
    static pthread_once_t once = PTHREAD_ONCE_INIT;
    pthread_once(&once, make_cages);
    hit_cylinder(ray, DISC, GROUND - 0.06, GROUND, BOARD, hit);
    for (int i = 0; i < SOLIDS; i++)
        hit_cage(ray, &cages[i], hit);
    for (int i = 0; i < SOLIDS + LOOSE; i++) {
        const struct marble *m = &marbles[i];
        hit_ball(ray, (struct vec){m->x, m->y, GROUND + m->radius}, m->radius, BALL + i, hit);
    }
}

// ---- colours ----------------------------------------------------------------------------------

// How much of the light from everywhere the marbles leave at a point of the board: less the cosine-
// weighted share of the half-space that each fills, (r / d)^2 cos(angle).
static double open_above(struct vec point) {
    double open = 1;
    for (int i = 0; i < SOLIDS + LOOSE; i++) {
        const struct marble *m = &marbles[i];
        double squared = pow(m->x - point.x, 2) + pow(m->y - point.y, 2) + m->radius * m->radius;
        open -= pow(m->radius, 3) / (squared * sqrt(squared));
    }
    return open > 0.2 ? open : 0.2;
}

static void paint_board(struct vec point, struct surface *surface) {
    double away = hypot(point.x, point.y);
    surface->ambient = 0.52 * open_above(point);
    surface->gloss = 0.1;
    surface->mirror = 0.10;
    if (away > 0.94 * DISC)
        rn_paint(surface, 0.72, 0.55, 0.26);
    else if (away > 0.90 * DISC || rn_odd(floor(point.x / SQUARE) + floor(point.y / SQUARE)))
        rn_paint(surface, 0.10, 0.12, 0.15);
    else
        rn_paint(surface, 0.90, 0.86, 0.76);
}

static void still_describe(const struct hit *hit, struct vec point, struct surface *surface) {
    surface->ambient = 0.52;
    if (hit->part == BOARD_TOP) {
        paint_board(point, surface);
    } else if (hit->part == BOARD) {
        rn_paint(surface, 0.46, 0.34, 0.16);
    } else if (hit->part == ROD) {
        rn_paint(surface, 0.84, 0.66, 0.30);
        surface->gloss = 0.45;
        surface->mirror = 0.1;
    } else {
        const double *colour = marbles[hit->part - BALL].colour;
        rn_paint(surface, colour[0], colour[1], colour[2]);
        surface->gloss = 0.5;
        surface->mirror = 0.08;
    }
}

// A bright ceiling above a dim room, with a soft border between them.
static void studio(struct vec direction, double rgb[3]) {
    double t = fmin(1, fmax(0, 0.5 + 1.2 * (direction.z - 0.25)));
    t = t * t * (3 - 2 * t);
    static const double low[3] = {0.30, 0.32, 0.36}, high[3] = {0.96, 0.97, 1.0};
    for (int i = 0; i < 3; i++)
        rgb[i] = low[i] + (high[i] - low[i]) * t;
}

const struct rn_synth_scene rn_synth_still_life = {.name = "still-life",
                                                   .radius = 1.31,
                                                   .light = RN_SYNTH_LAMP,
                                                   .lamp = 0.1,
                                                   .nearest = still_nearest,
                                                   .describe = still_describe,
                                                   .stand = rn_synth_orbit,
                                                   .angle_x = RN_SYNTH_ANGLE_X,
                                                   .mirrored = studio};
