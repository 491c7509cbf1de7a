// Three objects on stands: a perforated sphere, a fence, shells within shells.
#include "common/dataset/synth_scenes.h"

// ---- sphere: a perforated sphere around a ball, on a striped stand

#define HOLE_ROWS 9
#define HOLE_COSINE 0.99144486137381041 // cos 7.5 degrees

static const struct vec sphere_centre = {0, 0, 0.2};
enum { SPHERE_OUTSIDE, SPHERE_INSIDE, SPHERE_RIM, SPHERE_BALL, SPHERE_STAND, SPHERE_TOP };

// Holes stand in rows of equal latitude; a row's are as far apart as the rows.
static bool perforation(const void *holes, struct vec direction, struct vec *axis, double *cosine) {
    static const double sines[HOLE_ROWS] = {0.17364817766693036, 0.5, 0.76604444311897804,
                                            0.93969262078590838, 1,   0.93969262078590838,
                                            0.76604444311897804, 0.5, 0.17364817766693036};
    double polar = acos(direction.z > 1 ? 1 : direction.z < -1 ? -1 : direction.z);
    int row = (int)(polar * (HOLE_ROWS / M_PI));
    if (row == HOLE_ROWS) row--;
    double row_polar = (row + 0.5) * M_PI / HOLE_ROWS;
    if (fabs(polar - row_polar) > 0.14) return false;
    double sine = sines[row], count = floor(2 * HOLE_ROWS * sine + 0.5);
    double step = 2 * M_PI / count, shift = 0.5 * (row & 1) * step;
    double azimuth = shift + step * floor((atan2(direction.y, direction.x) - shift) / step + 0.5);
    *axis = (struct vec){sine * cos(azimuth), sine * sin(azimuth), cos(row_polar)};
    *cosine = HOLE_COSINE;
    return vec_dot(*axis, direction) > HOLE_COSINE;
}

static void sphere_nearest(const struct ray *ray, struct hit *hit) {
    static const struct shell shell = {.centre = {0, 0, 0.2},
                                       .inner = 0.66,
                                       .outer = 0.72,
                                       .part = SPHERE_OUTSIDE,
                                       .hole_at = perforation};
    hit_shell(ray, &shell, hit);
    hit_ball(ray, sphere_centre, 0.3, SPHERE_BALL, hit);
    hit_cylinder(ray, 0.62, -0.95, -0.5, SPHERE_STAND, hit);
}

static void sphere_describe(const struct hit *hit, struct vec point, struct surface *surface) {
    static const double low[3] = {0.05, 0.36, 0.55}, high[3] = {0.16, 0.72, 0.62};
    surface->ambient = 0.55;
    switch (hit->part) {
    case SPHERE_OUTSIDE:
        rn_mix(surface, low, high, 0.5 + (point.z - sphere_centre.z) / 1.44);
        surface->gloss = 0.35;
        break;
    case SPHERE_INSIDE:
        rn_paint(surface, 0.93, 0.62, 0.22);
        break;
    case SPHERE_RIM:
        rn_paint(surface, 0.98, 0.82, 0.42);
        break;
    case SPHERE_BALL:
        rn_paint(surface, 0.88, 0.22, 0.24);
        surface->gloss = 0.25;
        break;
    case SPHERE_STAND:
        if (rn_odd(atan2(point.y, point.x) * 24 / M_PI))
            rn_paint(surface, 0.95, 0.83, 0.60);
        else
            rn_paint(surface, 0.15, 0.18, 0.36);
        break;
    default:
        if (rn_odd(hypot(point.x, point.y) / 0.0775))
            rn_paint(surface, 0.95, 0.83, 0.60);
        else
            rn_paint(surface, 0.15, 0.18, 0.36);
    }
}

// A hue circle of muted, saturated colours.
static void rainbow(struct surface *surface, double turn) {
    for (int i = 0; i < 3; i++)
        surface->colour[i] = 0.52 + 0.38 * cos(2 * M_PI * (turn - i / 3.0));
}

// ---- fence: pickets around a ball on a checkerboard

#define FENCE_HALF 0.65
#define PICKETS 9 // a side
#define PICKET_STEP (2 * FENCE_HALF / PICKETS)
#define GROUND -0.27

enum { FENCE_GROUND = 0, FENCE_BALL = 1, FENCE_RAIL = 2, FENCE_PICKET = 3 };

// A box with a pointed top about x = centre, in the plane of one side.
static void hit_picket(const struct ray *ray, double centre, int part, struct hit *hit) {
    const double half = 0.042, shoulder = GROUND + 0.52, slope = 0.70710678118654752;
    struct vec low = {centre - half, -FENCE_HALF - 0.014, GROUND};
    struct vec high = {centre + half, -FENCE_HALF + 0.014, shoulder + half};
    struct span span = box_span(ray, low, high);
    cut(ray, (struct vec){slope, 0, slope}, slope * (centre + half + shoulder), &span);
    cut(ray, (struct vec){-slope, 0, slope}, slope * (-centre + half + shoulder), &span);
    hit_span(&span, part, hit);
}

// The side at y = -FENCE_HALF.
static void hit_side(const struct ray *ray, int side, struct hit *hit) {
    const double half = FENCE_HALF + 0.02;
    struct vec low = {-half, -half, GROUND}, high = {half, -FENCE_HALF + 0.05, GROUND + 0.57};
    struct span span = box_span(ray, low, high);
    if (!(span.begin < span.end) || span.end < hit->t_min || span.begin > hit->t) return;
    for (int rail = 0; rail < 2; rail++) {
        double z = GROUND + (rail ? 0.42 : 0.14);
        hit_box(ray, (struct vec){-FENCE_HALF, -FENCE_HALF + 0.014, z},
                (struct vec){FENCE_HALF, -FENCE_HALF + 0.036, z + 0.05}, FENCE_RAIL, hit);
    }
    double x0 = ray_at(ray, span.begin).x, x1 = ray_at(ray, span.end).x;
    int first = (int)floor((fmin(x0, x1) + FENCE_HALF) / PICKET_STEP);
    int last = (int)floor((fmax(x0, x1) + FENCE_HALF) / PICKET_STEP);
    for (int i = first < 0 ? 0 : first; i <= last && i < PICKETS; i++)
        hit_picket(ray, -FENCE_HALF + (i + 0.5) * PICKET_STEP, FENCE_PICKET + side * PICKETS + i,
                   hit);
}

static void fence_nearest(const struct ray *ray, struct hit *hit) {
    hit_box(ray, (struct vec){-0.84, -0.84, GROUND - 0.08}, (struct vec){0.84, 0.84, GROUND},
            FENCE_GROUND, hit);
    hit_ball(ray, (struct vec){0, 0, GROUND + 0.3}, 0.3, FENCE_BALL, hit);
    struct ray turned = *ray;
    for (int side = 0; side < 4; side++) {
        double before = hit->t;
        hit_side(&turned, side, hit);
        for (int i = 0; hit->t < before && i < side; i++) // back to the scene's axes
            hit->normal = (struct vec){-hit->normal.y, hit->normal.x, hit->normal.z};
        turned.origin = (struct vec){turned.origin.y, -turned.origin.x, turned.origin.z};
        turned.direction =
            (struct vec){turned.direction.y, -turned.direction.x, turned.direction.z};
    }
}

static void fence_describe(const struct hit *hit, struct vec point, struct surface *surface) {
    surface->ambient = 0.55;
    if (hit->part >= FENCE_PICKET) {
        rainbow(surface, (hit->part - FENCE_PICKET) / (4.0 * PICKETS));
    } else if (hit->part == FENCE_RAIL) {
        rn_paint(surface, 0.45, 0.33, 0.25);
    } else if (hit->part == FENCE_BALL) {
        if (rn_odd(7 * (point.z - GROUND) / 0.6))
            rn_paint(surface, 0.95, 0.80, 0.35);
        else
            rn_paint(surface, 0.80, 0.22, 0.30);
    } else if (hit->normal.z > 0.5 && rn_odd(floor(point.x / 0.12) + floor(point.y / 0.12))) {
        rn_paint(surface, 0.93, 0.86, 0.70);
    } else {
        rn_paint(surface, 0.20, 0.27, 0.40);
    }
}

// ---- nested: shells within shells, each open in other directions

struct openings {
    int count;
    double cosine;
    struct vec axes[4];
};

static bool opening_at(const void *holes, struct vec direction, struct vec *axis, double *cosine) {
    const struct openings *openings = holes;
    for (int i = 0; i < openings->count; i++)
        if (vec_dot(openings->axes[i], direction) > openings->cosine) {
            *axis = openings->axes[i];
            *cosine = openings->cosine;
            return true;
        }
    return false;
}

#define NESTED_CORE 9

static void nested_nearest(const struct ray *ray, struct hit *hit) {
    static const struct openings outer = {
        4,
        0.79863551004729283, // 37 degrees; axes 25 degrees up, 120 apart, and the bottom
        {{0.90630778703664996, 0, 0.42261826174069944},
         {-0.45315389351832498, 0.78488556573017303, 0.42261826174069944},
         {-0.45315389351832498, -0.78488556573017303, 0.42261826174069944},
         {0, 0, -1}}};
    static const struct openings middle = {
        4,
        0.77714596145697090, // 39 degrees; between the outer ones, and the top
        {{-0.93969262078590838, 0, -0.34202014332566871},
         {0.46984631039295419, 0.81379768134937369, -0.34202014332566871},
         {0.46984631039295419, -0.81379768134937369, -0.34202014332566871},
         {0, 0, 1}}};
    static const struct openings inner = {2,
                                          0.64278760968653933, // 50 degrees
                                          {{0.76604444311897801, 0.0, 0.64278760968653936},
                                           {-0.76604444311897801, 0.0, 0.64278760968653936}}};
    static const struct shell shells[3] = {
        {.inner = 0.98, .outer = 1.05, .part = 0, .hole_at = opening_at, .holes = &outer},
        {.inner = 0.67, .outer = 0.74, .part = 3, .hole_at = opening_at, .holes = &middle},
        {.inner = 0.38, .outer = 0.44, .part = 6, .hole_at = opening_at, .holes = &inner}};
    for (int i = 0; i < 3; i++)
        hit_shell(ray, &shells[i], hit);
    hit_ball(ray, (struct vec){0, 0, 0}, 0.2, NESTED_CORE, hit);
}

static void nested_describe(const struct hit *hit, struct vec point, struct surface *surface) {
    static const double colours[10][3] = {
        {0.50, 0.36, 0.74}, {0.66, 0.52, 0.86}, {0.84, 0.74, 0.96}, // outside, inside, rim
        {0.86, 0.42, 0.16}, {0.96, 0.62, 0.30}, {0.99, 0.80, 0.52}, {0.06, 0.48, 0.46},
        {0.22, 0.66, 0.58}, {0.55, 0.86, 0.76}, {0.93, 0.78, 0.25},
    };
    double stripe = 0;
    if (hit->part < 3)
        stripe = rn_odd(asin(fmax(-1, fmin(1, point.z / sqrt(vec_dot(point, point))))) * 24 / M_PI);
    else if (hit->part < 6)
        stripe = rn_odd(atan2(point.y, point.x) * 16 / M_PI);
    else if (hit->part < 9)
        stripe = rn_odd(floor(point.x / 0.09) + floor(point.y / 0.09) + floor(point.z / 0.09));
    const double *colour = colours[hit->part];
    bool rim = hit->part % 3 == 2;
    double shade = stripe && !rim ? 0.72 : 1;
    rn_paint(surface, shade * colour[0], shade * colour[1], shade * colour[2]);
    surface->ambient = 0.6;
}

// ---- as scenes

#define OBJECT(title, reach)                                                                       \
    {                                                                                              \
        .name = #title, .radius = reach, .light = RN_SYNTH_LAMP, .nearest = title##_nearest,       \
        .describe = title##_describe, .stand = rn_synth_orbit, .angle_x = RN_SYNTH_ANGLE_X         \
    }

const struct rn_synth_scene rn_synth_sphere = OBJECT(sphere, 1.15);
const struct rn_synth_scene rn_synth_fence = OBJECT(fence, 1.25);
const struct rn_synth_scene rn_synth_nested = OBJECT(nested, 1.06);
