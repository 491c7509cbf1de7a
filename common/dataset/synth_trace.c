// The table of synthetic scenes, and how any of them is lit.
#include <stdio.h>
#include <string.h>

#include "common/dataset/synth_scenes.h"

static const struct rn_synth_scene *const scenes[] = {&rn_synth_sphere, &rn_synth_fence,
                                                      &rn_synth_nested, &rn_synth_place,
                                                      &rn_synth_window, &rn_synth_still_life};
#define SCENES (sizeof scenes / sizeof *scenes)

const struct rn_synth_scene *rn_synth_find(const char *name) {
    for (size_t i = 0; i < SCENES; i++)
        if (strcmp(name, scenes[i]->name) == 0) return scenes[i];
    return NULL;
}

void rn_synth_names(char *names, size_t size) {
    size_t used = 0;
    names[0] = 0;
    for (size_t i = 0; i < SCENES && used < size; i++)
        used += (size_t)snprintf(names + used, size - used, "%s%s", i ? ", " : "", scenes[i]->name);
}

void rn_synth_orbit(enum rn_split split, int index, int count, double eye[3], double target[3]) {
    static const double low[RN_SPLIT_COUNT] = {-0.3, -0.2, -0.22},
                        high[RN_SPLIT_COUNT] = {0.97, 0.9, 0.93}, shift[RN_SPLIT_COUNT] = {0, 2, 4};
    double z = low[split] + (high[split] - low[split]) * (index + 0.5) / count;
    double azimuth = shift[split] + index * M_PI * (3 - sqrt(5));
    double across = RN_SYNTH_DISTANCE * sqrt(1 - z * z);
    eye[0] = across * cos(azimuth);
    eye[1] = across * sin(azimuth);
    eye[2] = RN_SYNTH_DISTANCE * z;
    target[0] = target[1] = target[2] = 0;
}

// Towards the ray's place on the lamp.
static struct vec towards_lamp(const struct rn_synth_scene *scene, const struct ray *ray) {
    struct vec l = scene->light;
    if (scene->lamp == 0) return l;
    struct vec across = vec_unit((struct vec){-l.y, l.x, 0});
    struct vec up = {-l.z * across.y, l.z * across.x, l.x * across.y - l.y * across.x};
    l = vec_add(l, scene->lamp * ray->lamp[0], across);
    return vec_unit(vec_add(l, scene->lamp * ray->lamp[1], up));
}

// The parts of mover i: its body, the body's ends, its head.
enum { MOVER = 1000, MOVER_PARTS = 3 };

static void nearest(const struct rn_synth_scene *scene, const struct ray *ray, struct hit *hit) {
    scene->nearest(ray, hit);
    for (int i = 0; ray->crowd && i < ray->crowd->count; i++) {
        const struct rn_mover *mover = &ray->crowd->movers[i];
        int part = MOVER + MOVER_PARTS * i;
        struct ray local = *ray;
        local.origin.x -= mover->x;
        local.origin.y -= mover->y;
        local.origin.z -= ray->crowd->floor;
        hit_cylinder(&local, 0.25, 0, 1.2, part, hit);
        hit_ball(&local, (struct vec){0, 0, 1.4}, 0.2, part + 2, hit);
    }
}

static void describe(const struct rn_synth_scene *scene, const struct ray *ray,
                     const struct hit *hit, struct vec point, struct surface *surface) {
    if (hit->part < MOVER) {
        scene->describe(hit, point, surface);
        return;
    }
    const struct rn_mover *mover = &ray->crowd->movers[(hit->part - MOVER) / MOVER_PARTS];
    double share = rn_odd(point.z / 0.15) ? 1 : 0.6;
    surface->ambient = 0.7;
    rn_paint(surface, share * mover->colour[0], share * mover->colour[1], share * mover->colour[2]);
}

static bool in_shadow(const struct rn_synth_scene *scene, const struct ray *seen, struct vec point,
                      struct vec normal, struct vec light) {
    struct ray ray = {vec_add(point, 1e-6, normal), light, {0}, seen->crowd};
    struct hit hit = {.t_min = 1e-6, .t = INFINITY};
    nearest(scene, &ray, &hit);
    return hit.t < INFINITY;
}

// The surface that a ray hits, and its colour but for reflections.
static struct surface shade(const struct rn_synth_scene *scene, const struct ray *ray,
                            const struct hit *hit, double rgb[3]) {
    struct vec point = ray_at(ray, hit->t), light = towards_lamp(scene, ray);
    struct surface surface = {.gloss = 0};
    describe(scene, ray, hit, point, &surface);
    double facing = vec_dot(hit->normal, light);
    bool lit = facing > 0 && !in_shadow(scene, ray, point, hit->normal, light);
    double diffuse = surface.ambient * (0.85 + 0.15 * hit->normal.z), highlight = 0;
    if (lit) {
        struct vec half = vec_unit(vec_add(light, -1, ray->direction)); // Blinn 1977
        diffuse += 0.65 * facing;
        double cosine = vec_dot(hit->normal, half);
        if (surface.gloss > 0 && cosine > 0) highlight = surface.gloss * pow(cosine, 40);
    }
    for (int i = 0; i < 3; i++)
        rgb[i] = fmin(1, surface.colour[i] * diffuse + highlight);
    return surface;
}

// Adds what the surface reflects, by Schlick's approximation of Fresnel's equations (1994).
static void reflect(const struct rn_synth_scene *scene, const struct ray *ray,
                    const struct hit *hit, const struct surface *surface, double rgb[3]) {
    double cosine = -vec_dot(hit->normal, ray->direction), seen[3];
    double share = surface->mirror + 0.5 * (1 - surface->mirror) * pow(1 - cosine, 5);
    struct ray turned = *ray;
    turned.origin = vec_add(ray_at(ray, hit->t), 1e-6, hit->normal);
    turned.direction = vec_unit(vec_add(ray->direction, 2 * cosine, hit->normal));
    struct hit other = {.t_min = 1e-6, .t = INFINITY};
    nearest(scene, &turned, &other);
    if (other.t < INFINITY)
        shade(scene, &turned, &other, seen);
    else
        scene->mirrored(turned.direction, seen);
    for (int i = 0; i < 3; i++)
        rgb[i] += share * (seen[i] - rgb[i]);
}

bool rn_synth_trace(const struct rn_synth_scene *scene, const struct ray *ray, double rgb[3],
                    double *ret_distance) {
    double begin, end;
    if (!sphere_span(ray, (struct vec){0, 0, 0}, scene->radius, &begin, &end) || end < 0)
        return false;
    struct hit hit = {.t_min = 0, .t = INFINITY};
    nearest(scene, ray, &hit);
    *ret_distance = hit.t;
    if (hit.t < INFINITY) {
        struct surface surface = shade(scene, ray, &hit, rgb);
        if (surface.mirror > 0) reflect(scene, ray, &hit, &surface, rgb);
    } else if (scene->sky) {
        scene->sky(ray->direction, rgb);
    } else {
        return false;
    }
    return true;
}
