// Ray against solid shapes, exactly. Every function finds the nearest entry into the solid beyond
// hit->t_min and nearer than hit->t, and then fills the hit. Internal to the synthetic scenes.
#ifndef RN_COMMON_DATASET_SYNTH_SHAPES_H
#define RN_COMMON_DATASET_SYNTH_SHAPES_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>

struct vec {
    double x, y, z;
};

struct rn_crowd;

struct ray {
    struct vec origin, direction; // direction: unit
    double lamp[2];               // place on the lamp's disc that shadows are cast from, -1..1
    const struct rn_crowd *crowd; // who stands about in this photograph; NULL: nobody
};

struct hit {
    double t_min, t; // searched range; t becomes the distance of the nearest hit
    struct vec normal;
    int part; // which part of the scene was hit
};

static inline struct vec vec_add(struct vec a, double s, struct vec b) { // a + s b
    return (struct vec){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}

static inline struct vec vec_scale(double s, struct vec a) {
    return (struct vec){s * a.x, s * a.y, s * a.z};
}

static inline double vec_dot(struct vec a, struct vec b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline struct vec vec_unit(struct vec a) {
    return vec_scale(1 / sqrt(vec_dot(a, a)), a);
}

static inline struct vec ray_at(const struct ray *ray, double t) {
    return vec_add(ray->origin, t, ray->direction);
}

static inline bool take_hit(struct hit *hit, double t, struct vec normal, int part) {
    if (!(t > hit->t_min && t < hit->t)) return false;
    hit->t = t;
    hit->normal = normal;
    hit->part = part;
    return true;
}

// Both crossings of the sphere |p - centre| = radius, *begin < *end.
static inline bool sphere_span(const struct ray *ray, struct vec centre, double radius,
                               double *begin, double *end) {
    struct vec offset = vec_add(ray->origin, -1, centre);
    double b = vec_dot(offset, ray->direction);
    double root = b * b - vec_dot(offset, offset) + radius * radius;
    if (!(root > 0)) return false;
    root = sqrt(root);
    *begin = -b - root;
    *end = -b + root;
    return true;
}

static inline bool hit_ball(const struct ray *ray, struct vec centre, double radius, int part,
                            struct hit *hit) {
    double begin, end;
    if (!sphere_span(ray, centre, radius, &begin, &end)) return false;
    struct vec normal = vec_scale(1 / radius, vec_add(ray_at(ray, begin), -1, centre));
    return take_hit(hit, begin, normal, part);
}

// A convex solid is cut from the ray one half-space n.p <= d at a time.
struct span {
    double begin, end;
    struct vec normal; // at begin
};

static inline void cut(const struct ray *ray, struct vec normal, double d, struct span *span) {
    double speed = vec_dot(normal, ray->direction), gap = d - vec_dot(normal, ray->origin);
    if (speed == 0) {
        if (gap < 0) span->end = -INFINITY;
        return;
    }
    double t = gap / speed;
    if (speed > 0) {
        if (t < span->end) span->end = t;
    } else if (t > span->begin) {
        span->begin = t;
        span->normal = normal;
    }
}

// Between two planes across one axis; `axis` is its unit vector.
static inline void cut_slab(double origin, double direction, double low, double high,
                            struct vec axis, struct span *span) {
    if (direction == 0) {
        if (origin < low || origin > high) span->end = -INFINITY;
        return;
    }
    double inverse = 1 / direction, t0 = (low - origin) * inverse, t1 = (high - origin) * inverse;
    double begin = direction > 0 ? t0 : t1, end = direction > 0 ? t1 : t0;
    if (end < span->end) span->end = end;
    if (begin <= span->begin) return;
    span->begin = begin;
    span->normal = vec_scale(direction > 0 ? -1 : 1, axis);
}

static inline struct span box_span(const struct ray *ray, struct vec low, struct vec high) {
    const struct vec *o = &ray->origin, *d = &ray->direction;
    struct span span = {.begin = -INFINITY, .end = INFINITY};
    cut_slab(o->x, d->x, low.x, high.x, (struct vec){1, 0, 0}, &span);
    cut_slab(o->y, d->y, low.y, high.y, (struct vec){0, 1, 0}, &span);
    cut_slab(o->z, d->z, low.z, high.z, (struct vec){0, 0, 1}, &span);
    return span;
}

static inline bool hit_span(const struct span *span, int part, struct hit *hit) {
    return span->begin < span->end && take_hit(hit, span->begin, span->normal, part);
}

static inline bool hit_box(const struct ray *ray, struct vec low, struct vec high, int part,
                           struct hit *hit) {
    struct span span = box_span(ray, low, high);
    return hit_span(&span, part, hit);
}

// Upright cylinder about the z axis; its ends are part + 1.
static inline bool hit_cylinder(const struct ray *ray, double radius, double low, double high,
                                int part, struct hit *hit) {
    const struct vec *o = &ray->origin, *d = &ray->direction;
    struct span span = {.begin = -INFINITY, .end = INFINITY};
    cut(ray, (struct vec){0, 0, -1}, -low, &span);
    cut(ray, (struct vec){0, 0, 1}, high, &span);
    double a = d->x * d->x + d->y * d->y, b = o->x * d->x + o->y * d->y;
    double c = o->x * o->x + o->y * o->y - radius * radius, root = b * b - a * c;
    if (!(root > 0)) {
        if (c > 0 || a > 0) return false;
        return hit_span(&span, part + 1, hit);
    }
    double begin = (-b - sqrt(root)) / a, end = (-b + sqrt(root)) / a;
    if (end < span.end) span.end = end;
    if (begin <= span.begin) return hit_span(&span, part + 1, hit);
    span.begin = begin;
    struct vec p = ray_at(ray, begin);
    span.normal = (struct vec){p.x / radius, p.y / radius, 0};
    return hit_span(&span, part, hit);
}

// The wall between two concentric spheres, pierced by cones whose apex is the centre.
struct shell {
    struct vec centre;
    double inner, outer; // radii
    int part;            // part: outside, + 1: inside, + 2: the holes' rims
    // Whether the unit direction lies in a hole (half-angle below 90 degrees); then that hole.
    bool (*hole_at)(const void *holes, struct vec direction, struct vec *axis, double *cosine);
    const void *holes;
};

// First crossing of the cone's surface in (t_min, t_max), for a ray relative to the apex.
static inline bool cone_exit(const struct ray *ray, struct vec axis, double cosine, double t_min,
                             double t_max, double *ret_t) {
    double c2 = cosine * cosine, da = vec_dot(ray->direction, axis);
    double oa = vec_dot(ray->origin, axis);
    double a = da * da - c2, b = da * oa - c2 * vec_dot(ray->direction, ray->origin);
    double c = oa * oa - c2 * vec_dot(ray->origin, ray->origin), root = b * b - a * c;
    if (a == 0 || !(root >= 0)) return false;
    root = sqrt(root);
    double roots[2] = {(-b - root) / a, (-b + root) / a};
    if (roots[0] > roots[1]) {
        double swap = roots[0];
        roots[0] = roots[1];
        roots[1] = swap;
    }
    for (int i = 0; i < 2; i++)
        if (roots[i] > t_min && roots[i] < t_max && oa + roots[i] * da > 0) {
            *ret_t = roots[i];
            return true;
        }
    return false;
}

// One stretch of the ray between the spheres; `ray` is relative to the shell's centre.
static inline bool hit_wall(const struct shell *shell, const struct ray *ray, double begin,
                            double end, bool from_outside, struct hit *hit) {
    if (end <= hit->t_min || begin >= hit->t) return false;
    double start = begin > hit->t_min ? begin : hit->t_min;
    struct vec direction = vec_unit(ray_at(ray, start)), axis;
    double cosine, t;
    if (!shell->hole_at(shell->holes, direction, &axis, &cosine))
        return take_hit(hit, begin, from_outside ? direction : vec_scale(-1, direction),
                        shell->part + !from_outside);
    if (!cone_exit(ray, axis, cosine, start + 1e-9, end, &t)) return false;
    struct vec rim = vec_unit(ray_at(ray, t));
    struct vec normal = vec_unit(vec_add(axis, -vec_dot(axis, rim), rim));
    return take_hit(hit, t, normal, shell->part + 2);
}

static inline bool hit_shell(const struct ray *ray, const struct shell *shell, struct hit *hit) {
    struct ray local = {vec_add(ray->origin, -1, shell->centre), ray->direction, {0}, NULL};
    const struct vec origin = {0, 0, 0};
    double outer_begin, outer_end, inner_begin, inner_end;
    if (!sphere_span(&local, origin, shell->outer, &outer_begin, &outer_end)) return false;
    if (!sphere_span(&local, origin, shell->inner, &inner_begin, &inner_end))
        return hit_wall(shell, &local, outer_begin, outer_end, true, hit);
    return hit_wall(shell, &local, outer_begin, inner_begin, true, hit) ||
           hit_wall(shell, &local, inner_end, outer_end, false, hit);
}

#endif
