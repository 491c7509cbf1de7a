// A scene's own numbers: parameters, cameras, levels, and the colours of some of its rays on every
// kernel set against float64 on the same samples.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/doctor/cases.h"
#include "server/engine/effects/effects.h"
#include "server/engine/reference/exact.h"

#define CAMERAS 32                 // looked at, evenly spaced
#define PIXELS 64                  // of each: rays checked
#define RAYS 96                    // compared with float64
#define QUARTER_LEVEL (1.0 / 1020) // of an 8-bit picture
#define OPEN_END 1e9f              // no early stop: every sample is compared

struct examination {
    const struct rn_doctor_options *options;
    struct rn_engine *engine;
    struct rn_field *field;
    struct rn_march_options march;
    int ray_count;
    struct rn_march_ray rays[RAYS];
};

static void count_wild(struct rn_doctor_result *result, const char *name, const float *numbers,
                       size_t n) {
    struct rn_doctor_case *c = rn_doctor_open(result, name, "", 0, "non-finite numbers");
    double wild = 0;
    for (size_t i = 0; i < n; i++)
        wild += !isfinite(numbers[i]);
    rn_doctor_see(c, wild, "%zu numbers", n);
    rn_doctor_close(result, c);
}

static const struct rn_camera *camera_at(const struct rn_doctor_options *o, size_t i, size_t of) {
    return &o->cameras[o->camera_count * i / of];
}

static size_t cameras_seen(const struct rn_doctor_options *o) {
    return o->camera_count < CAMERAS ? o->camera_count : CAMERAS;
}

// The ray through a pixel, drawn.
static struct rn_ray draw_ray(const struct rn_camera *camera, struct rn_doctor_random *random) {
    double x = floor(rn_doctor_uniform(random, 0, camera->width)) + 0.5;
    double y = floor(rn_doctor_uniform(random, 0, camera->height)) + 0.5;
    return rn_camera_ray(camera, x, y);
}

// Directions of unit length to what float64 allows (and poses are orthonormal to what files hold).
static void check_cameras(struct examination *e, struct rn_doctor_random *random,
                          struct rn_doctor_result *result) {
    struct rn_doctor_case *c =
        rn_doctor_open(result, "directions of the scene's rays", "", 1e-5, "off unit length");
    struct rn_doctor_case wild = {.bound = 0};
    size_t seen = cameras_seen(e->options);
    for (size_t i = 0; i < seen; i++)
        for (int n = 0; n < PIXELS; n++) {
            struct rn_ray ray = draw_ray(camera_at(e->options, i, seen), random);
            double norm = 0, sum = ray.radius;
            for (int k = 0; k < 3; k++) {
                norm += ray.direction[k] * ray.direction[k];
                sum += ray.origin[k];
            }
            struct rn_march_ray march = rn_march_ray_from(e->field, &ray, (double)e->march.step, 0);
            rn_doctor_see(c, fabs(sqrt(norm) - 1), "camera %zu of %zu", i, seen);
            bool finite = isfinite(sum) && ray.radius > 0 && isfinite(march.length);
            rn_doctor_see(&wild, !finite, "camera %zu of %zu", i, seen);
        }
    rn_doctor_close(result, c);
    c = rn_doctor_open(result, "the scene's rays", "", 0, "non-finite rays");
    c->worst = wild.worst;
    memcpy(c->where, wild.where, sizeof c->where);
    rn_doctor_close(result, c);
}

// Rays that meet the ball, drawn from all cameras in turn.
static void draw_rays(struct examination *e, struct rn_doctor_random *random) {
    size_t seen = cameras_seen(e->options);
    for (int n = 0; n < 64 * RAYS && seen > 0 && e->ray_count < RAYS; n++) {
        struct rn_ray ray = draw_ray(camera_at(e->options, (size_t)n % seen, seen), random);
        struct rn_march_ray march = rn_march_ray_from(e->field, &ray, (double)e->march.step, 0);
        if (march.length > 0) e->rays[e->ray_count++] = march;
    }
}

static void compare(struct examination *e, struct rn_exact *exact, int r,
                    struct rn_doctor_case *colour, struct rn_doctor_case *opacity,
                    double *ret_level) {
    struct rn_workspace *w = rn_engine_workspace(e->engine, 0);
    const struct rn_kernels *k = e->engine->kernels;
    struct rn_exact_pixel truth;
    struct rn_pixel pixel;
    k->parts->stage(&e->field->cpu, &e->march, &e->rays[r], 1, RN_STAGE_MARCH, w, NULL, NULL);
    int n = w->candidate_count[0];
    rn_exact_render(exact, &e->march, &e->rays[r], w->candidate, n, &truth);
    k->render(&e->field->cpu, &e->march, &e->rays[r], 1, w, &pixel);
    for (int c = 0; c < 3; c++)
        rn_doctor_see(colour, fabs((double)pixel.rgb[c] - truth.rgb[c]),
                      "ray %d of %d, %d samples, colour %.4f", r, e->ray_count, n, truth.rgb[c]);
    rn_doctor_see(opacity, fabs((double)pixel.alpha - truth.alpha),
                  "ray %d of %d, %d samples, opacity %.4f", r, e->ray_count, n, truth.alpha);
    *ret_level = fmax(*ret_level, truth.level);
}

// The factors of bf16 products are rounded to 2^-9 of themselves, through every layer.
static double colour_bound(const struct rn_kernels *kernels) {
    return kernels->unit == RN_PRODUCT_FMA ? QUARTER_LEVEL : 16 * 0x1p-9;
}

static enum rn_status check_rays(struct examination *e, const struct rn_kernels *kernels,
                                 struct rn_doctor_result *result, struct rn_error *err) {
    struct rn_exact *exact = NULL;
    struct rn_doctor_case opacity = {.bound = 0};
    double level = 0, bound = colour_bound(kernels);
    e->engine->kernels = kernels;
    rn_field_refresh(e->field, e->engine);
    enum rn_status status = rn_exact_create(&e->field->cpu, &exact, err);
    if (status != RN_OK) return status;
    struct rn_doctor_case *c =
        rn_doctor_open(result, "colours of the scene's rays", kernels->name, bound, "of white");
    for (int r = 0; r < e->ray_count; r++)
        compare(e, exact, r, c, &opacity, &level);
    rn_doctor_close(result, c);
    c = rn_doctor_open(result, "opacities of the scene's rays", kernels->name, bound, "of 1");
    c->worst = opacity.worst;
    memcpy(c->where, opacity.where, sizeof c->where);
    rn_doctor_close(result, c);
    rn_exact_destroy(&exact);
    if (e->march.counter++ > 0) return RN_OK; // the levels are the same for every set
    double most = e->field->config.field.levels - 1;
    c = rn_doctor_open(result, "largest ripmap level of these rays", "", most, "levels");
    rn_doctor_see(c, level, "%d of %d levels are built", e->field->cpu.built_levels,
                  e->field->config.field.levels);
    rn_doctor_close(result, c);
    return RN_OK;
}

// Levels that the cameras may ask for, as rendering builds them.
static enum rn_status need_levels(struct examination *e, struct rn_error *err) {
    int levels = 1;
    for (size_t i = 0; i < e->options->camera_count; i++) {
        int need = rn_levels_for_camera(e->field, &e->options->cameras[i], (double)e->march.step);
        if (need > levels) levels = need;
    }
    return rn_field_need_levels(e->field, levels, err);
}

enum rn_status rn_doctor_scene(const struct rn_doctor_options *options,
                               struct rn_doctor_random *random, struct rn_engine *engine,
                               struct rn_field *field, struct rn_doctor_result *result,
                               struct rn_error *err) {
    struct examination e = {.options = options, .engine = engine, .field = field};
    const struct rn_kernels *kernels;
    size_t side = (size_t)field->config.field.occupancy;
    count_wild(result, "the scene's parameters", field->parameters.values, field->parameters.count);
    count_wild(result, "the scene's occupancy", field->occupancy, side * side * side);
    if (options->camera_count == 0) return RN_OK;
    e.march = rn_effects_march_trained(field);
    e.march.stop_depth = OPEN_END;
    check_cameras(&e, random, result);
    draw_rays(&e, random);
    enum rn_status status = need_levels(&e, err);
    if (status == RN_OK) status = rn_engine_prepare(engine, field, err);
    for (int i = 0; status == RN_OK && (kernels = rn_kernels_available(i)); i++)
        status = check_rays(&e, kernels, result, err);
    return status;
}
