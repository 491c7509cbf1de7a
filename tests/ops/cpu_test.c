// The CPU kernels against the float64 reference: pixels, loss and every gradient, for every kernel
// set this machine can run.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/field/space.h"
#include "server/engine/field/voxels.h"
#include "server/engine/reference/reference.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/scene/scene.h"
#include "server/engine/train/step.h"
#include "tests/support/suite.h"

#define RAYS 24

struct setup {
    struct rn_engine engine;
    struct rn_field *field;
    struct rn_reference *reference;
    struct rn_march_ray rays[RAYS];
    struct rn_reference_ray exact[RAYS];
    double *mid[RAYS];
    struct rn_march_options options;
    struct rn_group group;
    struct rn_workspace *workspace;
    float *memory;
};

static struct rn_train_config small_config(void) {
    struct rn_error err;
    struct rn_train_config config;
    ck_assert(rn_preset("standard", false, &config, &err) == RN_OK);
    config.field.planes = 3;
    config.field.base = 32;
    config.field.channels = 8;
    config.field.levels = 4;
    config.field.width = 16;
    config.field.base_layers = config.field.head_layers = 2;
    config.field.voxels = false;
    config.field.occupancy = 16;
    config.step = 0.05;
    config.seed = 7;
    return config;
}

static float unit(uint64_t i) {
    return rn_rng_unit(rn_rng_draw(99, 1, i).v[0]);
}

static void copy_parameters(struct setup *s) {
    const struct rn_parameters *p = &s->field->parameters;
    for (size_t i = 0; i < p->plane_count; i++)
        s->reference->planes[i] = p->values[i];
    for (size_t i = 0; i < p->base_count; i++)
        s->reference->base[i] = p->values[p->plane_count + i];
    for (size_t i = 0; i < p->head_count; i++)
        s->reference->head[i] = p->values[p->plane_count + p->base_count + i];
    rn_reference_build(s->reference);
}

static bool config_is_ball(const struct setup *s) {
    return s->field->config.field.space == RN_SPACE_BALL;
}

// All samples of a ray: the distances of their middles; returns how many.
static int list_samples(const struct setup *s, const struct rn_march_ray *ray, double *ret_mid) {
    double length = ray->length > 0 ? (double)ray->length : 0, step = (double)s->options.step;
    int n = 0;
    if (!config_is_ball(s)) {
        for (; n < (int)(length / (2 * step)); n++)
            ret_mid[n] = (double)ray->near + rn_distance_of_place(2 - length + (2 * n + 1) * step);
        return n;
    }
    for (; (n * ray->stride + 0.5) * step < length; n++)
        ret_mid[n] = (double)ray->near + (n + 0.5) * step * ray->stride;
    return n;
}

// Rays through the ball from outside; some wide cones, so that levels differ.
static void make_rays(struct setup *s) {
    for (int r = 0; r < RAYS; r++) {
        struct rn_ray ray = {.radius = r % 3 == 0 ? 0.1 : 0.01};
        double norm = 0;
        for (int i = 0; i < 3; i++) {
            ray.origin[i] = 2.0 * unit(10 * r + i) - 1 + (i == 2 ? -3 : 0);
            ray.direction[i] = 0.6 * unit(10 * r + 3 + i) - 0.3 - 0.3 * ray.origin[i] * (i < 2);
        }
        ray.direction[2] = 1;
        for (int i = 0; i < 3; i++)
            norm += ray.direction[i] * ray.direction[i];
        for (int i = 0; i < 3; i++)
            ray.direction[i] /= sqrt(norm);
        s->rays[r] = rn_march_ray_from(s->field, &ray, (double)s->options.step, 0.2);
        s->rays[r].stride = r % 4 == 1 && config_is_ball(s) ? 2 : 1;
        s->rays[r].weight = 1 + (float)(r % 2);
        s->rays[r].id = (uint32_t)r;
        struct rn_reference_ray *e = &s->exact[r];
        s->mid[r] = calloc(1000, sizeof(double));
        double step = (double)s->options.step * s->rays[r].stride;
        int n = list_samples(s, &s->rays[r], s->mid[r]);
        *e = (struct rn_reference_ray){.radius = s->rays[r].radius,
                                       .count = n,
                                       .mid = s->mid[r],
                                       .width = step,
                                       .weight = s->rays[r].weight};
        for (int i = 0; i < 3; i++) {
            e->direction[i] = s->rays[r].direction[i];
            e->origin[i] = (double)s->rays[r].origin[i] - e->direction[i] * (double)s->rays[r].near;
            s->rays[r].target[i] = unit(1000 + 10 * r + i);
            e->target[i] = s->rays[r].target[i];
        }
        e->alpha = s->rays[r].alpha = unit(1000 + 10 * r + 3);
        e->colour = s->options.colour;
    }
}

static void set_up(struct setup *s, const struct rn_kernels *kernels,
                   const struct rn_train_config *config) {
    struct rn_error err;
    struct rn_bounds bounds = {.radius = 1};
    memset(s, 0, sizeof *s);
    s->engine.kernels = kernels;
    ck_assert(rn_pool_create(1, &s->engine.pool, &err) == RN_OK);
    ck_assert(rn_field_create(config, &bounds, &s->field, &err) == RN_OK);
    ck_assert(rn_field_need_levels(s->field, config->field.levels, &err) == RN_OK);
    rn_field_randomise(s->field, 5);
    for (size_t i = 0; i < s->field->parameters.plane_count; i++)
        s->field->parameters.values[i] = 2 * unit(5000 + i) - 1;
    for (uint64_t i = 0, n = s->field->hull_cells; n > 0; i++) {
        s->field->occupancy[i] = s->field->hull[i];
        n -= s->field->hull[i];
    }
    rn_field_refresh_occupancy(s->field);
    rn_field_refresh(s->field, &s->engine);
    ck_assert(rn_engine_prepare(&s->engine, s->field, &err) == RN_OK);
    s->workspace = rn_engine_workspace(&s->engine, 0);
    ck_assert(rn_reference_create(&config->field, config->seed, &s->reference, &err) == RN_OK);
    copy_parameters(s);
    s->options = (struct rn_march_options){
        .step = (float)config->step,
        .stop_depth = 1e9f,
        .colour = {.background = {1, 0.5f, 0.25f}, .background_variance = 0.1f},
        .distortion_loss = (float)config->distortion_loss};
    s->reference->distortion_loss = config->distortion_loss;
    make_rays(s);
}

static void prepare_group(struct setup *s) {
    int capacity = 12 * s->workspace->capacity;
    s->memory = calloc(rn_group_numbers(&s->field->cpu, capacity), sizeof *s->memory);
    rn_group_lay_out(&s->field->cpu, capacity, s->memory, &s->group);
    s->group.end = RAYS;
}

static void tear_down(struct setup *s) {
    for (int r = 0; r < RAYS; r++)
        free(s->mid[r]);
    free(s->memory);
    rn_block_destroy(s->engine.workspaces);
    rn_field_destroy(&s->field);
    rn_reference_destroy(&s->reference);
    rn_pool_destroy(&s->engine.pool);
}

// Error bounds against float64: of the loss (relative), of pixels and depth (absolute), and of
// gradients (relative to the largest number; with bf16 products of the norm). bf16 products round
// every operand, a relative error up to 2^-8 = 0.004 each, on random parameters without structure.
struct bounds {
    double loss, colour, depth, gradient;
};
// Where space ends opaque, one sample's colour is most of a ray's, and its rounding most of a
// loss's.
static struct bounds bounds_of(const struct rn_kernels *kernels, const struct rn_field_config *c) {
    bool opaque = c->space == RN_SPACE_UNBOUNDED && c->shading == RN_SHADING_RAY;
    if (rn_kernels_bf16(kernels)) return (struct bounds){opaque ? 2e-3 : 1e-3, 5e-3, 2e-3, 0.2};
    return (struct bounds){2e-5, 2e-5, 1e-4, 1e-4};
}

// The norm of the difference over the reference's. A sample whose activation lies within a
// rounding of zero may be cut on one side only: single numbers then differ by their own size.
static double distance(const float *fast, const double *exact, size_t n, double scale) {
    double norm = 1e-60, difference = 0;
    for (size_t i = 0; i < n; i++) {
        double d = (double)fast[i] * scale - exact[i];
        norm += exact[i] * exact[i];
        difference += d * d;
    }
    return sqrt(difference / norm);
}

// Largest difference relative to the largest magnitude of the reference.
static double worst(const float *fast, const double *exact, size_t n, double scale) {
    double largest = 1e-30, difference = 0;
    for (size_t i = 0; i < n; i++) {
        largest = fmax(largest, fabs(exact[i]));
        difference = fmax(difference, fabs((double)fast[i] * scale - exact[i]));
    }
    return difference / largest;
}

// No texel has a gradient whose tile is not marked.
static void check_marks(const struct rn_field_config *c, int levels,
                        struct rn_map (*grads)[RN_MAX_LEVELS], const uint8_t *touched) {
    struct rn_tiling tiling = rn_tiling(c->base, c->channels, levels);
    int missed = 0, marked = 0;
    for (int y = 0; y < c->base; y++)
        for (int x = 0; x < c->base; x++) {
            const float *g =
                grads[0][0].texels + ((size_t)y * c->base + (size_t)x) * (size_t)c->channels;
            bool mark = touched[(y >> tiling.shift_y) * tiling.columns + (x >> tiling.shift_x)];
            marked += mark;
            for (int k = 0; k < c->channels; k++)
                missed += g[k] != 0 && !mark;
        }
    ck_assert_int_gt(marked, 0);
    if (c->base % (1 << (levels - 1)) == 0) ck_assert_int_eq(missed, 0);
}

// Rays end, as the engine's do, behind the first sample that makes them as opaque as
// `options.stop_depth` says.
static void stop_early(struct setup *s, float stop_depth) {
    int cut = 0;
    s->options.stop_depth = stop_depth;
    for (int r = 0; r < RAYS; r++) {
        struct rn_reference_ray *ray = &s->exact[r];
        double rgb[3], opacity = 0, depth;
        int all = ray->count;
        ray->cut = true;
        for (ray->count = 0; ray->count < all && -log1p(-opacity) <= (double)stop_depth;) {
            ray->count++;
            ck_assert(rn_reference_render(s->reference, ray, rgb, &opacity, &depth) == RN_OK);
        }
        ray->cut = -log1p(-opacity) > (double)stop_depth;
        cut += all - ray->count;
    }
    ck_assert_int_gt(cut, 2 * RAYS);
}

static void check_step(const struct rn_kernels *kernels, const struct rn_train_config *config,
                       bool split, float stop_depth) {
    struct bounds bounds = bounds_of(kernels, &config->field);
    struct setup s;
    set_up(&s, kernels, config);
    prepare_group(&s);
    if (split) { // one of a pixel's rays meets nothing
        s.options.split = true;
        s.reference->pixel_rays = RN_PIXEL_RAYS;
        s.rays[2].length = 0;
        s.exact[2].count = 0;
    }
    if (stop_depth < 1) stop_early(&s, stop_depth);
    while (rn_group_is_open(&s.group, s.workspace))
        kernels->train(&s.field->cpu, &s.options, s.rays, s.workspace, &s.group);
    ck_assert_int_eq(s.group.cursor, RAYS);
    double loss, weight = s.group.weight;
    ck_assert(rn_reference_loss(s.reference, s.exact, RAYS, &loss) == RN_OK);
    if (config->distortion_loss == 0) // what is told of a step is how far its pixels are off
        ck_assert_double_eq_tol(s.group.loss / weight, loss, bounds.loss * loss);

    const struct rn_field_config *c = &config->field;
    size_t count = s.field->parameters.plane_count;
    float *grad = calloc(count + 64, 4);
    float *pyramid = calloc(rn_pyramid_count(c, c->levels) * (size_t)c->planes + 64, 4);
    struct rn_map maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS];
    bool leveled = c->footprint != RN_FOOTPRINT_POINT, mip = c->footprint == RN_FOOTPRINT_MIP;
    int levels = leveled ? c->levels : 1, unit = 1 << (levels - 1);
    struct rn_tiling tiling = rn_tiling(c->base, c->channels, 1); // at least as many as with levels
    uint8_t *touched = calloc((size_t)tiling.columns, (size_t)tiling.rows);
    rn_pyramid_lay_out(c, c->levels, grad, pyramid, maps);
    for (int p = 0; p < rn_grid_count(c); p++) {
        bool pooled = leveled && p < c->planes;
        int middle = c->base % unit == 0 ? c->base / unit / 2 * unit : 0; // bands, as threads do
        kernels->scatter(&s.field->cpu, &s.group.slab, p, levels, 0, middle, maps[p], touched);
        kernels->scatter(&s.field->cpu, &s.group.slab, p, levels, middle, c->base, maps[p],
                         touched);
        if (pooled) kernels->pull_down(maps[p], levels, mip, c->channels);
        check_marks(c, pooled ? levels : 1, maps[p], touched);
        memset(touched, 0, (size_t)tiling.columns * (size_t)tiling.rows);
    }
    double (*const error)(const float *, const double *, size_t, double) =
        rn_kernels_bf16(kernels) ? distance : worst;
    double planes = error(grad, s.reference->plane_grad, count, 1 / weight);
    double base =
        error(s.group.base_grad, s.reference->base_grad, s.reference->base_shape.count, 1 / weight);
    double head =
        error(s.group.head_grad, s.reference->head_grad, s.reference->head_shape.count, 1 / weight);
    printf("%s %d planes%s %s %s%s%s: gradients planes %.1e base %.1e head %.1e\n", kernels->name,
           c->planes, c->voxels ? " and voxels" : "", rn_footprint_names[c->footprint],
           c->shading == RN_SHADING_RAY ? "ray" : "sample", split ? " split" : "",
           stop_depth < 1 ? " stopped" : "", planes, base, head);
    ck_assert_double_lt(planes, bounds.gradient);
    ck_assert_double_lt(base, bounds.gradient);
    ck_assert_double_lt(head, bounds.gradient);
    free(grad);
    free(pyramid);
    free(touched);
    tear_down(&s);
}

static void check_training(const struct rn_kernels *kernels, const struct rn_train_config *config) {
    check_step(kernels, config, false, 1e9f);
    check_step(kernels, config, true, 1e9f);
    check_step(kernels, config, false, 0.5f);
}

static void check_rendering(const struct rn_kernels *kernels,
                            const struct rn_train_config *config) {
    struct bounds bounds = bounds_of(kernels, &config->field);
    struct setup s;
    set_up(&s, kernels, config);
    struct rn_pixel pixels[RAYS];
    kernels->render(&s.field->cpu, &s.options, s.rays, RAYS, s.workspace, pixels);
    for (int r = 0; r < RAYS; r++) {
        double rgb[3], opacity, depth;
        ck_assert(rn_reference_render(s.reference, &s.exact[r], rgb, &opacity, &depth) == RN_OK);
        for (int c = 0; c < 3; c++)
            ck_assert_double_eq_tol(pixels[r].rgb[c], rgb[c], bounds.colour);
        ck_assert_double_eq_tol(pixels[r].alpha, opacity, bounds.colour);
        if (opacity > 1e-3)
            ck_assert_double_eq_tol(pixels[r].depth, depth / opacity,
                                    bounds.depth * fmax(1, depth / opacity));
    }
    tear_down(&s);
}

// Many rays, misses among them, pass each other in the places of a packet: what each alone gives.
// Rays share a lookup with levels when any of them needs one: not the same bytes.
static void check_many(const struct rn_kernels *kernels, const struct rn_train_config *config) {
    enum { MANY = 40 * RAYS };
    static struct rn_march_ray rays[MANY];
    static struct rn_pixel pixels[MANY];
    struct setup s;
    set_up(&s, kernels, config);
    s.options.stop_depth = 0.5f; // rays end early and late
    uint64_t samples = 0;
    for (int i = 0; i < MANY; i++) {
        rays[i] = s.rays[(i * 7 + i / RAYS) % RAYS];
        if (i % 5 == 3) rays[i].length = 0;
        if (i % 11 == 4) rays[i].length *= 0.1f;
    }
    uint64_t together = kernels->render(&s.field->cpu, &s.options, rays, MANY, s.workspace, pixels);
    for (int i = 0; i < MANY; i++) {
        struct rn_pixel alone;
        samples += kernels->render(&s.field->cpu, &s.options, &rays[i], 1, s.workspace, &alone);
        for (int c = 0; c < 3; c++)
            ck_assert_double_eq_tol(pixels[i].rgb[c], alone.rgb[c], 2e-5);
        ck_assert_double_eq_tol(pixels[i].alpha, alone.alpha, 2e-5);
        ck_assert_double_eq_tol(pixels[i].depth, alone.depth, 1e-4);
        if (!(rays[i].length > 0)) ck_assert_double_eq(pixels[i].alpha, 0);
    }
    ck_assert_uint_eq(together, samples);
    tear_down(&s);
}

static void each_case(void (*check)(const struct rn_kernels *, const struct rn_train_config *)) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        for (int f = RN_FOOTPRINT_RIP; f <= RN_FOOTPRINT_POINT; f++)
            for (int shading = RN_SHADING_SAMPLE; shading <= RN_SHADING_RAY; shading++) {
                struct rn_train_config config = small_config();
                config.field.footprint = (enum rn_footprint)f;
                config.field.shading = (enum rn_shading)shading;
                config.field.planes = f == RN_FOOTPRINT_RIP ? 4 : 3;
                config.field.channels = f == RN_FOOTPRINT_MIP ? 4 : f == RN_FOOTPRINT_RIP ? 16 : 8;
                check(kernels, &config);
            }
}

START_TEST(gradients_match_reference) {
    each_case(check_training);
}
END_TEST
// The rays of one pixel have more samples than a packet is filled to.
START_TEST(pixels_larger_than_a_packet_match_reference) {
    const struct rn_kernels *kernels;
    struct rn_train_config config = small_config();
    config.field.width = 128;
    config.field.base_layers = 3;
    config.step = 0.003;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        check_step(kernels, &config, true, 1e9f);
}
END_TEST
START_TEST(pixels_match_reference) {
    each_case(check_rendering);
}
END_TEST

START_TEST(many_pixels_match_one) {
    each_case(check_many);
}
END_TEST

// Views to look through: in the ball, around it, far away.
static struct rn_camera make_camera(int i) {
    struct rn_camera camera = {.width = 64, .height = 48, .fx = 60, .fy = 64, .cx = 31, .cy = 25.5};
    double far = (const double[]){0.5, 2.5, 40, 1e6}[i % 4];
    double eye[3], target[3], up[3] = {0.1, 0.2, 1};
    for (int k = 0; k < 3; k++) {
        eye[k] = (unit(3000 + 7 * i + k) - 0.5) * far + (k == i % 3 ? far : 0);
        target[k] = 0.2 * unit(4000 + 7 * i + k);
    }
    camera.fx *= far / 2.5;
    camera.fy *= far / 2.5;
    ck_assert(rn_camera_look_at(eye, target, up, camera.world_from_camera) == RN_OK);
    return camera;
}

// Rays of many places at once, views changing and absent ones among them, against
// rn_march_ray_from: fp32 numbers at most one apart, and what float64 loses with distance.
static void check_rays(const struct rn_kernels *kernels, enum rn_space space, bool cone_step) {
    enum { VIEWS = 8, PLACES = 403 };
    struct rn_train_config config = small_config();
    struct rn_bounds bounds = {.centre = {0.1, -0.2, 0.3}, .radius = 1.25};
    struct rn_field *field;
    struct rn_camera cameras[VIEWS];
    struct rn_view views[VIEWS];
    struct rn_ray_place places[PLACES];
    struct rn_march_ray rays[PLACES];
    int hits = 0, strides = 0;
    config.cone_step = cone_step;
    config.field.space = space;
    ck_assert(rn_field_create(&config, &bounds, &field, NULL) == RN_OK);
    for (int i = 0; i < VIEWS; i++) {
        cameras[i] = make_camera(i);
        if (i == 5) cameras[i].fx = cameras[i].fy = 12; // wide cones
        views[i] = rn_field_view(field, &cameras[i]);
    }
    for (int i = 0; i < PLACES; i++) {
        int view = i < 64 ? i / 16 : i * 5 % VIEWS;
        places[i] = (struct rn_ray_place){&views[view], i * 37 % 64, i * 11 % 48, unit(i)};
        if (i % 50 == 49) places[i].view = NULL;
    }
    kernels->rays(places, PLACES, 0.01, cone_step, rays);
    for (int i = 0; i < PLACES; i++) {
        const struct rn_ray_place *p = &places[i];
        if (!p->view) {
            ck_assert_double_eq(rays[i].length, 0);
            continue;
        }
        const struct rn_camera *camera = &cameras[p->view - views];
        struct rn_ray ray = rn_camera_ray(camera, p->x + 0.5, p->y + 0.5);
        struct rn_march_ray exact = rn_march_ray_from(field, &ray, 0.01, p->jitter);
        double allowed = 0x1p-23 + 0x1p-48 * fabsf(exact.near),
               condition = 1 + 1 / fmax(exact.length, 0.1);
        ck_assert_int_eq(rays[i].length > 0, exact.length > 0);
        ck_assert_int_eq(rays[i].stride, exact.stride);
        ck_assert_double_eq_tol(rays[i].near, exact.near, 0x1p-23 * fabsf(exact.near) + allowed);
        ck_assert_double_eq_tol(rays[i].length, exact.length, allowed * condition);
        ck_assert_double_eq_tol(rays[i].radius, exact.radius, 0x1p-23 * exact.radius);
        ck_assert_double_eq(rays[i].weight, 1);
        for (int k = 0; k < 3; k++) {
            ck_assert_double_eq_tol(rays[i].direction[k], exact.direction[k], 0x1p-24);
            ck_assert_double_eq_tol(rays[i].origin[k], exact.origin[k], allowed);
        }
        hits += exact.length > 0;
        strides += exact.stride > 1;
    }
    ck_assert_int_gt(hits, PLACES / 3);
    if (space == RN_SPACE_BALL) ck_assert_int_lt(hits, PLACES - PLACES / 50 - 10);
    ck_assert(strides > 0 || !cone_step);
    rn_field_destroy(&field);
}

START_TEST(rays_match_float64) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        for (int cone_step = 0; cone_step < 2; cone_step++)
            check_rays(kernels, RN_SPACE_BALL, cone_step);
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        check_rays(kernels, RN_SPACE_UNBOUNDED, false);
}
END_TEST

// Bent rays with contracted footprints, over all pairs of whose samples the distortion loss goes.
START_TEST(unbounded_space_matches_reference) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        for (int variant = 0; variant < 6; variant++) {
            struct rn_train_config config = small_config();
            config.field.space = RN_SPACE_UNBOUNDED;
            config.cone_step = false;
            config.field.footprint = (enum rn_footprint)(variant % 3);
            config.field.shading = variant < 3 ? RN_SHADING_RAY : RN_SHADING_SAMPLE;
            check_rendering(kernels, &config);
            check_training(kernels, &config);
            config.distortion_loss = 0.05;
            check_training(kernels, &config);
        }
}
END_TEST

// Voxels beside planes, with and without levels, with texels of each width; the grid's bands end
// within rows of voxels.
START_TEST(voxels_match_reference) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        for (int variant = 0; variant < 3; variant++) {
            struct rn_train_config config = small_config();
            config.field.voxels = true;
            config.field.channels = 4 << variant;
            config.field.space = variant < 2 ? RN_SPACE_BALL : RN_SPACE_UNBOUNDED;
            config.cone_step = variant < 2;
            config.field.footprint = variant == 1 ? RN_FOOTPRINT_MIP : RN_FOOTPRINT_POINT;
            config.field.shading = variant == 1 ? RN_SHADING_SAMPLE : RN_SHADING_RAY;
            check_rendering(kernels, &config);
            check_step(kernels, &config, false, 1e9f);
        }
}
END_TEST

// A mipmap read at the mean of the levels that a ripmap would be.
START_TEST(mean_levels_match_reference) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        for (int space = RN_SPACE_BALL; space <= RN_SPACE_UNBOUNDED; space++) {
            struct rn_train_config config = small_config();
            config.field.space = (enum rn_space)space;
            config.cone_step = space == RN_SPACE_BALL;
            config.field.footprint = RN_FOOTPRINT_MIP;
            config.field.mean_level = true;
            check_rendering(kernels, &config);
            check_training(kernels, &config);
        }
}
END_TEST

// One plane with its gradients and moments.
struct plane_state {
    float *texels, *block, *grads, *grad_block, *m, *v;
    struct rn_map maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS];
    struct rn_map grad_maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS];
    size_t count, pyramid;
};

static void plane_create(const struct rn_field_config *c, struct plane_state *s) {
    s->count = (size_t)c->base * (size_t)c->base * (size_t)c->channels;
    s->pyramid = rn_pyramid_count(c, c->levels);
    float **all[] = {&s->texels, &s->grads, &s->m, &s->v, &s->block, &s->grad_block};
    for (int k = 0; k < 6; k++) {
        size_t n = k < 4 ? s->count : s->pyramid;
        *all[k] = calloc(n + 64, sizeof(float));
        for (size_t i = 0; i < n && k != 4; i++)
            (*all[k])[i] = (k == 3 ? 0.5f : 0) + unit(((uint64_t)k << 32) + i) - 0.5f;
    }
    rn_pyramid_lay_out(c, c->levels, s->texels, s->block, s->maps);
    rn_pyramid_lay_out(c, c->levels, s->grads, s->grad_block, s->grad_maps);
    // What a fetch may read behind a map's last texel is no gradient, and a mip map's chain is
    // pooled through maps that take none.
    bool mip = c->footprint == RN_FOOTPRINT_MIP;
    for (int y = 0; y < c->levels; y++)
        for (int x = 0; x < c->levels; x++) {
            struct rn_map *map = &s->grad_maps[0][y][x];
            if (!rn_map_exists(mip, x, y)) continue;
            size_t n = (size_t)map->width * (size_t)map->height * (size_t)c->channels;
            if (mip && x != y) memset(map->texels, 0, n * sizeof(float));
        }
}

static void plane_destroy(struct plane_state *s) {
    float *all[] = {s->texels, s->grads, s->m, s->v, s->block, s->grad_block};
    for (int k = 0; k < 6; k++)
        free(all[k]);
}

static void ck_maps_eq(const struct rn_field_config *c, const struct plane_state *a,
                       const struct plane_state *b) {
    bool mip = c->footprint == RN_FOOTPRINT_MIP;
    for (int y = 0; y < c->levels; y++)
        for (int x = 0; x < c->levels; x++) {
            const struct rn_map *map = &a->maps[0][y][x], *grad = &a->grad_maps[0][y][x];
            if (!rn_map_exists(mip, x, y) || (mip && x != y)) continue;
            size_t n = (size_t)map->width * (size_t)map->height * (size_t)c->channels;
            ck_assert_mem_eq(map->texels, b->maps[0][y][x].texels, n * sizeof(float));
            size_t left = 0;
            for (size_t i = 0; i < n; i++)
                left += grad->texels[i] != 0;
            ck_assert_uint_eq(left, 0);
        }
}

// The update by tiles against pulling down, AdamW and building on the whole plane: the same
// bytes; and tiles that are not marked stay as they are.
static void check_update(const struct rn_kernels *kernels, const struct rn_field_config *c) {
    struct plane_state whole, tiled;
    bool mip = c->footprint == RN_FOOTPRINT_MIP;
    struct rn_adamw o = {.scale = 0.5f,
                         .rate = 0.01f,
                         .decay = 0.001f,
                         .eps = 1e-15f,
                         .keep = 0.99f,
                         .fresh = 0.01f,
                         .correction1 = 0.5f,
                         .correction2 = 0.25f};
    plane_create(c, &whole);
    plane_create(c, &tiled);
    kernels->pull_down(whole.grad_maps[0], c->levels, mip, c->channels);
    ck_assert(kernels->adamw(&o, whole.count, whole.texels, whole.grads, whole.m, whole.v));
    kernels->build(whole.maps[0], c->levels, mip, c->channels);
    struct rn_plane_update u = {.options = &o,
                                .maps = tiled.maps[0],
                                .grad_maps = tiled.grad_maps[0],
                                .m = tiled.m,
                                .v = tiled.v,
                                .levels = c->levels,
                                .channels = c->channels,
                                .mip = mip};
    int middle = c->base / 3 * 2;
    ck_assert(kernels->update(&u, 0, middle) && kernels->update(&u, middle, c->base));
    ck_maps_eq(c, &tiled, &whole);
    ck_assert_mem_eq(tiled.m, whole.m, whole.count * sizeof(float));

    struct rn_tiling tiling = rn_tiling(c->base, c->channels, c->levels);
    size_t tiles = (size_t)tiling.columns * (size_t)tiling.rows;
    u.touched = calloc(tiles, 1);
    u.touched[tiling.columns + 1] = 1; // one tile, not at the edge
    for (size_t i = 0; i < whole.count; i++)
        tiled.grads[i] = 1;
    ck_assert(kernels->update(&u, 0, c->base));
    size_t wrong = 0;
    for (size_t i = 0; i < whole.count; i++) {
        int x = (int)(i / (size_t)c->channels) % c->base >> tiling.shift_x;
        int y = (int)(i / (size_t)c->channels) / c->base >> tiling.shift_y;
        wrong += (tiled.texels[i] != whole.texels[i]) != (x == 1 && y == 1);
    }
    ck_assert_uint_eq(wrong, 0);
    ck_assert_int_eq(u.touched[tiling.columns + 1], 0);
    tiled.texels[0] = NAN;
    u.touched[0] = 1;
    ck_assert(!kernels->update(&u, 0, c->base));
    free(u.touched);
    plane_destroy(&whole);
    plane_destroy(&tiled);
}

START_TEST(tiles_match_whole_planes) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        for (int channels = 4; channels <= 16; channels *= 2)
            for (int levels = 1; levels <= 5; levels += 2)
                for (int f = RN_FOOTPRINT_RIP; f <= RN_FOOTPRINT_MIP; f++) {
                    struct rn_field_config c = small_config().field;
                    c.base = 48;
                    c.channels = channels;
                    c.levels = levels;
                    c.footprint = (enum rn_footprint)f;
                    check_update(kernels, &c);
                }
}
END_TEST

START_TEST(odd_base_matches_reference) {
    struct rn_train_config config = small_config();
    config.field.base = 37;
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        check_training(kernels, &config);
}
END_TEST

START_TEST(other_solids_and_no_view_dependence_match_reference) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        for (int n = 0; n < 4; n++) {
            struct rn_train_config config = small_config();
            config.field.planes = n < 2 ? 6 : 10;
            config.field.view_dependence = n == 3;
            config.field.shading = n % 2 ? RN_SHADING_RAY : RN_SHADING_SAMPLE;
            config.field.base_layers = 1 + n % 3;
            config.field.head_layers = 4 - n;
            check_training(kernels, &config);
            check_rendering(kernels, &config);
        }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("cpu kernels");
    TCase *tests = tcase_create("reference");
    tcase_set_timeout(tests, 120);
    tcase_add_test(tests, gradients_match_reference);
    tcase_add_test(tests, pixels_larger_than_a_packet_match_reference);
    tcase_add_test(tests, pixels_match_reference);
    tcase_add_test(tests, many_pixels_match_one);
    tcase_add_test(tests, rays_match_float64);
    tcase_add_test(tests, unbounded_space_matches_reference);
    tcase_add_test(tests, voxels_match_reference);
    tcase_add_test(tests, mean_levels_match_reference);
    tcase_add_test(tests, tiles_match_whole_planes);
    tcase_add_test(tests, odd_base_matches_reference);
    tcase_add_test(tests, other_solids_and_no_view_dependence_match_reference);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
