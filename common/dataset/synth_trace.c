// The table of synthetic scenes, and how any of them is lit.
#include <stdio.h>
#include <string.h>

#include "common/dataset/synth_scenes.h"

static const struct rn_synth_scene *const scenes[] = {
    &rn_synth_sphere, &rn_synth_fence, &rn_synth_nested, &rn_synth_place, &rn_synth_window};
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

static bool in_shadow(const struct rn_synth_scene *scene, struct vec point, struct vec normal) {
    struct ray ray = {vec_add(point, 1e-6, normal), scene->light};
    struct hit hit = {.t_min = 1e-6, .t = INFINITY};
    scene->nearest(&ray, &hit);
    return hit.t < INFINITY;
}

static void shade(const struct rn_synth_scene *scene, const struct ray *ray, const struct hit *hit,
                  double rgb[3]) {
    struct vec point = ray_at(ray, hit->t);
    struct surface surface = {.gloss = 0};
    scene->describe(hit, point, &surface);
    double facing = vec_dot(hit->normal, scene->light);
    bool lit = facing > 0 && !in_shadow(scene, point, hit->normal);
    double diffuse = surface.ambient * (0.85 + 0.15 * hit->normal.z), highlight = 0;
    if (lit) {
        struct vec half = vec_unit(vec_add(scene->light, -1, ray->direction)); // Blinn 1977
        diffuse += 0.65 * facing;
        double cosine = vec_dot(hit->normal, half);
        if (surface.gloss > 0 && cosine > 0) highlight = surface.gloss * pow(cosine, 40);
    }
    for (int i = 0; i < 3; i++)
        rgb[i] = fmin(1, surface.colour[i] * diffuse + highlight);
}

bool rn_synth_trace(const struct rn_synth_scene *scene, const struct ray *ray, double rgb[3],
                    double *ret_distance) {
    double begin, end;
    if (!sphere_span(ray, (struct vec){0, 0, 0}, scene->radius, &begin, &end) || end < 0)
        return false;
    struct hit hit = {.t_min = 0, .t = INFINITY};
    scene->nearest(ray, &hit);
    *ret_distance = hit.t;
    if (hit.t < INFINITY)
        shade(scene, ray, &hit, rgb);
    else if (scene->sky)
        scene->sky(ray->direction, rgb);
    else
        return false;
    return true;
}
