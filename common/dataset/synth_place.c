// A place without bounds: a room with a window and a row of columns, thin posts near and far, a
// checker floor to the horizon, hills and a sky. Two captures of it: `place` goes around in the
// room, `window` faces one way.
#include "common/dataset/synth_scenes.h"

#define FLOOR (-1.2)
#define CEILING 4.2
#define HALF 6.0   // of the room, inside
#define WALL 0.3   // thickness
#define HAZE 150.0 // distance in which colours fade to the horizon's, units

enum { GROUND, WALLS, FRONT, BAR, COLUMN = 6, POST = 8, TABLE = 10, BALL = 12, CRATE, TREE, HILL };

static const double horizon[3] = {0.80, 0.86, 0.92};

// An upright round post about (x, y); its ends are part + 1.
static bool hit_post(const struct ray *ray, double x, double y, double radius, double low,
                     double high, int part, struct hit *hit) {
    struct ray local = *ray;
    local.origin.x -= x;
    local.origin.y -= y;
    return hit_cylinder(&local, radius, low, high, part, hit);
}

static bool passes(const struct ray *ray, struct vec low, struct vec high) {
    struct span span = box_span(ray, low, high);
    return span.begin < span.end && span.end > 0;
}

static void hit_bars(const struct ray *ray, double left, double right, double low, double high,
                     struct hit *hit) {
    for (int i = 0; i < 5; i++)
        hit_post(ray, -2.56 + 1.28 * i, HALF + 0.15, 0.035, low, high, BAR, hit);
    hit_box(ray, (struct vec){left, HALF + 0.13, 1.3}, (struct vec){right, HALF + 0.17, 1.36}, BAR,
            hit);
}

// Left and back walls and the ceiling are whole; the front wall is four boxes about the window.
static void hit_room(const struct ray *ray, struct hit *hit) {
    const double out = HALF + WALL, left = -3.2, right = 3.2, low = -0.2, high = 2.9;
    hit_box(ray, (struct vec){-out, -out, FLOOR}, (struct vec){-HALF, out, CEILING}, WALLS, hit);
    hit_box(ray, (struct vec){-HALF, -out, FLOOR}, (struct vec){out, -HALF, CEILING}, WALLS, hit);
    hit_box(ray, (struct vec){-out, -out, CEILING}, (struct vec){out, out, CEILING + WALL}, WALLS,
            hit);
    hit_box(ray, (struct vec){-HALF, HALF, FLOOR}, (struct vec){left, out, CEILING}, FRONT, hit);
    hit_box(ray, (struct vec){right, HALF, FLOOR}, (struct vec){out, out, CEILING}, FRONT, hit);
    hit_box(ray, (struct vec){left, HALF, FLOOR}, (struct vec){right, out, low}, FRONT, hit);
    hit_box(ray, (struct vec){left, HALF, high}, (struct vec){right, out, CEILING}, FRONT, hit);
    if (passes(ray, (struct vec){left, HALF, low}, (struct vec){right, out, high}))
        hit_bars(ray, left, right, low, high, hit);
    if (passes(ray, (struct vec){HALF - 0.1, -5, FLOOR}, (struct vec){HALF + WALL, 5, CEILING}))
        for (int i = 0; i < 5; i++)
            hit_post(ray, HALF + 0.1, -4.8 + 2.4 * i, 0.12, FLOOR, CEILING, COLUMN, hit);
}

static void hit_furniture(const struct ray *ray, struct hit *hit) {
    hit_cylinder(ray, 1.0, -0.37, -0.27, TABLE, hit);
    hit_cylinder(ray, 0.09, FLOOR, -0.37, TABLE, hit);
    hit_ball(ray, (struct vec){-0.35, 0.2, 0.07}, 0.34, BALL, hit);
    hit_box(ray, (struct vec){0.15, -0.45, -0.27}, (struct vec){0.6, 0, 0.18}, CRATE, hit);
    hit_post(ray, 0.2, 0.55, 0.02, -0.27, 0.95, POST, hit);
    hit_post(ray, 2.3, 1.5, 0.03, FLOOR, 2.2, POST, hit);
    hit_post(ray, -2.4, 0.7, 0.03, FLOOR, 2.6, POST, hit);
    hit_post(ray, 1.1, -2.5, 0.03, FLOOR, 1.4, POST, hit);
}

// Two rows of posts and two trees before the window, a row and a tree beyond the columns.
static void hit_garden(const struct ray *ray, struct hit *hit) {
    if (passes(ray, (struct vec){-4, 8, FLOOR}, (struct vec){4, 52, 0.6}))
        for (int i = 0; i < 8; i++) {
            hit_post(ray, -3.5, 9 + 6 * i, 0.06, FLOOR, 0.6, POST, hit);
            hit_post(ray, 3.5, 9 + 6 * i, 0.06, FLOOR, 0.6, POST, hit);
        }
    if (passes(ray, (struct vec){9, -5, FLOOR}, (struct vec){46, 11, 0.6}))
        for (int i = 0; i < 8; i++)
            hit_post(ray, 10 + 5 * i, -4 + 2 * i, 0.06, FLOOR, 0.6, POST, hit);
    static const struct vec trees[3] = {{7, 26, 2.6}, {-9, 36, 3.4}, {24, -3, 2.8}};
    for (int i = 0; i < 3; i++) {
        hit_post(ray, trees[i].x, trees[i].y, 0.25, FLOOR, trees[i].z, COLUMN, hit);
        hit_ball(ray, trees[i], 2.3, TREE, hit);
    }
}

// Caps of large balls, 150 to 300 units away.
static void hit_hills(const struct ray *ray, struct hit *hit) {
    static const struct {
        struct vec centre;
        double radius;
    } hills[] = {{{-70, 240, -175}, 200},
                 {{60, 210, -130}, 145},
                 {{190, 170, -170}, 192},
                 {{230, 0, -145}, 165},
                 {{210, -130, -185}, 200}};
    for (int i = 0; i < 5; i++)
        hit_ball(ray, hills[i].centre, hills[i].radius, HILL + i, hit);
}

static void place_nearest(const struct ray *ray, struct hit *hit) {
    if (ray->direction.z != 0)
        take_hit(hit, (FLOOR - ray->origin.z) / ray->direction.z,
                 (struct vec){0, 0, ray->direction.z < 0 ? 1 : -1}, GROUND);
    hit_room(ray, hit);
    hit_furniture(ray, hit);
    struct span room = box_span(ray, (struct vec){-HALF, -HALF, FLOOR},
                                (struct vec){HALF + WALL, HALF + WALL, CEILING});
    if (room.begin <= 0 && hit->t < room.end) return; // nothing outside is nearer
    hit_garden(ray, hit);
    hit_hills(ray, hit);
}

// Squares of one unit whose contrast fades with the distance, so that the mean over a pixel
// converges at the horizon too.
static void paint_ground(struct vec point, struct surface *surface) {
    double away = hypot(point.x, point.y), contrast = 0.5 * exp(-away / 40);
    bool light = rn_odd(floor(point.x) + floor(point.y));
    double near_colour[3] = {0.56, 0.50, 0.40};
    for (int i = 0; i < 3; i++)
        near_colour[i] *= 1 + (light ? contrast : -contrast);
    rn_mix(surface, near_colour, horizon, 1 - exp(-away / HAZE));
    surface->ambient = 0.7 + 0.3 * (1 - exp(-away / HAZE));
}

// Striped paper, a picture on the left wall, bricks on the back one.
static void paint_walls(const struct hit *hit, struct vec point, struct surface *surface) {
    if (hit->normal.x > 0.5 && fabs(point.y - 1) < 1.6 && fabs(point.z - 1.4) < 1.0) {
        if (rn_odd(floor(point.y / 0.2) + floor(point.z / 0.2)))
            rn_paint(surface, 0.78, 0.26, 0.20);
        else
            rn_paint(surface, 0.96, 0.88, 0.62);
    } else if (hit->normal.y > 0.5) {
        double row = floor((point.z - FLOOR) / 0.3), across = point.x / 0.75 + 0.5 * rn_odd(row);
        bool mortar = (point.z - FLOOR) / 0.3 - row < 0.14 || across - floor(across) < 0.06;
        if (mortar)
            rn_paint(surface, 0.82, 0.78, 0.72);
        else
            rn_paint(surface, 0.66, 0.34 + 0.08 * rn_odd(floor(across) + 0.5 * row), 0.26);
    } else if (hit->normal.z < -0.5) {
        rn_paint(surface, 0.88, 0.87, 0.84);
    } else if (rn_odd((point.x + point.y) / 0.3)) {
        rn_paint(surface, 0.62, 0.74, 0.70);
    } else {
        rn_paint(surface, 0.82, 0.87, 0.80);
    }
}

static void paint_hill(const struct hit *hit, struct vec point, struct surface *surface) {
    static const double colours[3][3] = {
        {0.30, 0.46, 0.24}, {0.52, 0.58, 0.30}, {0.64, 0.58, 0.36}};
    int field = (int)floor(point.z / 4 + 0.8 * sin(point.x / 17 + hit->part)) + hit->part;
    double away = hypot(point.x, point.y);
    rn_mix(surface, colours[((field % 3) + 3) % 3], horizon, 1 - exp(-away / (3 * HAZE)));
    surface->ambient = 0.65;
}

static void place_describe(const struct hit *hit, struct vec point, struct surface *surface) {
    surface->ambient = 0.7;
    if (hit->part >= HILL) {
        paint_hill(hit, point, surface);
    } else if (hit->part == GROUND) {
        paint_ground(point, surface);
    } else if (hit->part < BAR) {
        paint_walls(hit, point, surface);
    } else if (hit->part < COLUMN) {
        rn_paint(surface, 0.95, 0.95, 0.92);
    } else if (hit->part < POST) {
        rn_paint(surface, 0.80, 0.74, 0.64);
    } else if (hit->part < TABLE) {
        rn_paint(surface, 0.30, 0.13, 0.12);
    } else if (hit->part < BALL) {
        bool ring = rn_odd(hypot(point.x, point.y) / 0.16);
        rn_paint(surface, ring ? 0.50 : 0.66, ring ? 0.30 : 0.44, ring ? 0.16 : 0.26);
    } else if (hit->part == BALL) {
        rn_paint(surface, 0.12, 0.36, 0.66);
        surface->gloss = 0.3;
    } else if (hit->part == CRATE) {
        double stripe = point.x + point.y + point.z;
        rn_paint(surface, 0.93, rn_odd(stripe / 0.09) ? 0.72 : 0.50, 0.18);
    } else {
        bool leaf = rn_odd(floor(point.x / 0.4) + floor(point.y / 0.4) + floor(point.z / 0.4));
        rn_paint(surface, 0.16, leaf ? 0.42 : 0.30, 0.14);
    }
}

static void place_sky(struct vec direction, double rgb[3]) {
    static const double zenith[3] = {0.30, 0.52, 0.84};
    double height = direction.z > 0 ? sqrt(direction.z) : 0;
    double cloud = 0.5 + 0.5 * sin(9 * direction.x + 4 * sin(6 * direction.y)) *
                             sin(40 * direction.z + 3 * direction.x);
    cloud *= cloud * fmin(1, 6 * direction.z) * (direction.z > 0);
    for (int i = 0; i < 3; i++) {
        double blue = horizon[i] + (zenith[i] - horizon[i]) * height;
        rgb[i] = blue + 0.7 * cloud * (0.97 - blue);
    }
}

// The fraction of an additive recurrence: evenly spread over [0, 1).
static double spread(int index, double step, double shift) {
    double x = shift + index * step;
    return x - floor(x);
}

// In the room, around the table, looking at about its middle.
static void around(enum rn_split split, int index, int count, double eye[3], double target[3]) {
    double height = spread(index, 0.7548776662466927, 0.1 + 0.3 * split);
    double away = 3.4 + 0.9 * spread(index, 0.5698402909980532, 0.3 * split);
    double azimuth = 2 * M_PI * (index + 0.33 * split) / count;
    eye[0] = away * cos(azimuth);
    eye[1] = away * sin(azimuth);
    eye[2] = -0.4 + 2.6 * height;
    for (int i = 0; i < 3; i++)
        target[i] = 0.8 * (spread(index, 0.2 * i + 0.38, 0.3 * split) - 0.5);
}

// From a small area at the back of the room towards the window.
static void towards_window(enum rn_split split, int index, int count, double eye[3],
                           double target[3]) {
    (void)count;
    eye[0] = 1.6 * (spread(index, 0.7548776662466927, 0.1 + 0.3 * split) - 0.5);
    eye[1] = -4.2 + 0.3 * (spread(index, 0.4301597090019468, 0.3 * split) - 0.5);
    eye[2] = 0.6 + 1.2 * (spread(index, 0.5698402909980532, 0.3 * split) - 0.5);
    target[0] = 0.4 * eye[0];
    target[1] = HALF;
    target[2] = 0.9;
}

#define PLACE(title, rig, angle, ...)                                                              \
    {                                                                                              \
        .name = title, .radius = INFINITY,                                                         \
        .light = {0.62019197913091, 0.55017030406774, 0.55917309085886}, /* in between columns */  \
            .nearest = place_nearest, .describe = place_describe, .stand = rig, .angle_x = angle,  \
        __VA_ARGS__, .sky = place_sky                                                              \
    }

const struct rn_synth_scene rn_synth_place =
    PLACE("place", around, 0.95, .roam_low = {-2.6, -2.6, FLOOR}, .roam_high = {2.6, 2.6, FLOOR});
const struct rn_synth_scene rn_synth_window =
    PLACE("window", towards_window, 0.85, .roam_low = {-2.6, -1.5, FLOOR},
          .roam_high = {2.6, 5.5, FLOOR});
