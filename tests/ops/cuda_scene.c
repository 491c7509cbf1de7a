#include "tests/ops/cuda_scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/field/voxels.h"

static float unit(uint64_t i) {
    return rn_rng_unit(rn_rng_draw(99, 1, i).v[0]);
}

struct rn_train_config test_config(enum rn_footprint footprint, int planes, int channels, int width,
                                   int levels) {
    struct rn_error err;
    struct rn_train_config config;
    ck_assert(rn_preset("paper", false, &config, &err) == RN_OK);
    config.field.planes = planes;
    config.field.channels = channels;
    config.field.width = width;
    config.field.levels = levels;
    config.field.footprint = footprint;
    config.field.base = 32;
    config.field.occupancy = 16;
    config.step = 0.05;
    config.stop = 1e-30;
    config.target_samples = 1024;
    config.seed = 7;
    return config;
}

// Planes and weights multiples of 1/1024 below 2, which fp16 holds; the weights twice as large as
// at the start of a training, so that densities and colours differ.
static void fill_parameters(struct test_scene *s) {
    struct rn_parameters *p = &s->field->parameters;
    rn_field_randomise(s->field, 5);
    size_t side = s->config.field.voxels ? (size_t)rn_voxel_side(&s->config.field) : 0;
    size_t zeros = side > 0 ? (size_t)s->config.field.planes * rn_grid_numbers(&s->config.field) +
                                  side * side * side * RN_VOXEL_CHANNELS
                            : p->plane_count; // behind the voxels
    for (size_t i = 0; i < p->plane_count; i++)
        p->values[i] = i < zeros ? floorf(2048 * unit(5000 + i) - 1024) / 1024 : 0;
    for (size_t i = p->plane_count; i < p->count; i++)
        p->values[i] = roundf(p->values[i] * 2 * 1024) / 1024;
    for (size_t i = 0; i < p->plane_count; i++)
        s->reference->planes[i] = (double)p->values[i];
    for (size_t i = 0; i < p->base_count; i++)
        s->reference->base[i] = (double)p->values[p->plane_count + i];
    for (size_t i = 0; i < p->head_count; i++)
        s->reference->head[i] = (double)p->values[p->plane_count + p->base_count + i];
    rn_reference_build(s->reference);
}

static void fill_frames(struct test_scene *s) {
    for (int f = 0; f < FRAMES; f++) {
        struct rn_device_frame *frame = &s->frames[f];
        double angle = 1.7 * f, eye[3] = {3 * cos(angle), 3 * sin(angle), 1.5 - f};
        double focal = f % 2 ? SIDE * 1.4 : SIDE * 2.2;
        frame->camera = (struct rn_camera){.width = SIDE,
                                           .height = SIDE,
                                           .fx = focal,
                                           .fy = focal,
                                           .cx = SIDE / 2.0,
                                           .cy = SIDE / 2.0};
        ck_assert(rn_camera_look_at(eye, (double[3]){0, 0, 0}, (double[3]){0, 0, 1},
                                    frame->camera.world_from_camera) == RN_OK);
        frame->offset = frame->before = (uint64_t)f * SIDE * SIDE;
        frame->loss_weight = 1 + (float)(f % 2);
    }
    for (size_t i = 0; i < sizeof s->rgba; i++)
        s->rgba[i] = (uint8_t)(255 * unit(90000 + i));
}

void test_scene_occupy(struct test_scene *s) {
    size_t cells = (size_t)s->config.field.occupancy;
    for (size_t i = 0; i < cells * cells * cells; i++)
        s->field->occupancy[i] = s->field->hull[i];
    rn_field_refresh(s->field, &s->engine);
    rn_field_refresh_occupancy(s->field);
}

void test_scene_face(struct test_scene *s) {
    struct rn_disparity *box = &s->field->cpu.disparity;
    *box = (struct rn_disparity){.on = true,
                                 .unit = 1.2,
                                 .origin = {0, 0, -1},
                                 .axes = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                                 .scale = {1.8, 1.8, 0},
                                 .shift = {0.05, -0.1, 0},
                                 .half = {1, 0.7, 1},
                                 .near = 1,
                                 .far = 8};
    box->scale[2] = -2 / (1 / box->near - 1 / box->far);
    box->shift[2] = 1 - box->scale[2] / box->far;
    for (int f = 0; f < FRAMES; f++) {
        double eye[3] = {0.3 * f - 0.4, 0.2 - 0.1 * f, -1 - 0.1 * f};
        ck_assert(rn_camera_look_at(eye, (double[3]){0, 0, 3}, (double[3]){0, 1, 0},
                                    s->frames[f].camera.world_from_camera) == RN_OK);
    }
    ck_assert(rn_field_fill(s->field) == RN_OK);
    test_scene_occupy(s);
}

void test_scene_init(struct test_scene *s, const struct rn_train_config *config) {
    struct rn_error err;
    struct rn_bounds bounds = {.centre = {0.1, -0.05, 0}, .radius = 1.2};
    memset(s, 0, sizeof *s);
    s->config = *config;
    s->rays = RAYS;
    s->background_variance = 0.1f;
    s->engine.kernels = rn_kernels_available(0);
    ck_assert(rn_pool_create(1, &s->engine.pool, &err) == RN_OK);
    ck_assert_msg(rn_field_create(config, &bounds, &s->field, &err) == RN_OK, "%s", err.text);
    ck_assert(rn_field_need_levels(s->field, config->field.levels, &err) == RN_OK);
    ck_assert(rn_reference_create(&config->field, config->seed, &s->reference, &err) == RN_OK);
    s->reference->half = true;
    s->reference->distortion_loss = config->distortion_loss;
    fill_parameters(s);
    test_scene_occupy(s);
    ck_assert(rn_engine_prepare(&s->engine, s->field, &err) == RN_OK);
    fill_frames(s);
}

enum rn_status test_scene_upload(struct test_scene *s, size_t budget, struct rn_error *err) {
    struct rn_device_about about;
    const struct rn_field *f = s->field;
    struct rn_device_scene scene = {.config = s->config,
                                    .radius = f->bounds.radius,
                                    .disparity = f->cpu.disparity,
                                    .solid = f->cpu.solid,
                                    .base_shape = f->cpu.base_shape,
                                    .head_shape = f->cpu.head_shape,
                                    .levels = f->cpu.built_levels,
                                    .parameter_count = f->parameters.count,
                                    .parameters = f->parameters.values,
                                    .occupancy = f->occupancy,
                                    .hull = f->hull};
    memcpy(scene.centre, f->bounds.centre, sizeof scene.centre);
    memcpy(scene.finer, s->finer, sizeof scene.finer);
    size_t bytes;
    enum rn_status status = test_backend()->open(0, &s->device, &about, err);
    if (status == RN_OK)
        status = test_backend()->needs(&scene, NULL, NULL, budget ? budget : SIZE_MAX, &bytes, err);
    if (status != RN_OK) return status;
    return test_backend()->field_create(s->device, &scene, &s->on_device, err);
}

static struct rn_colouring colouring_of(const struct test_scene *s) {
    const float *c = s->config.background;
    return (struct rn_colouring){.background = {c[0], c[1], c[2]},
                                 .background_variance = s->background_variance};
}

enum rn_status test_scene_train(struct test_scene *s, bool deterministic, struct rn_error *err) {
    struct rn_device_pixels pixels = {.frames = s->frames,
                                      .rgba = s->rgba,
                                      .frame_count = FRAMES,
                                      .scale_count = 1,
                                      .scale_first = {0, FRAMES},
                                      .scale_pixels = {FRAMES * SIDE * SIDE},
                                      .pixel_count = FRAMES * SIDE * SIDE};
    const struct rn_train_config *config = &s->field->config;
    struct rn_device_training training = {.deterministic = deterministic,
                                          .last_on_chip = s->last_on_chip,
                                          .two_tiles = s->two_tiles,
                                          .next_rays = s->rays,
                                          .gradient_scale = s->gradient_scale,
                                          .march_step = config->step,
                                          .split = s->split,
                                          .colour = colouring_of(s),
                                          .m = s->m,
                                          .v = s->v,
                                          .seen = s->seen};
    return test_backend()->train_begin(s->on_device, &pixels, &training, err);
}

enum rn_status test_render(const struct test_scene *s, const struct rn_camera *camera,
                           const struct rn_march_options *options, enum rn_device_cells cells,
                           int row, int rows, struct rn_pixel *ret_pixels, uint64_t *ret_samples,
                           struct rn_error *err) {
    const struct rn_device_view view = {
        .cameras = camera, .camera_count = 1, .cones = 1, .cells = cells};
    const struct rn_device_places places = {.first = (uint32_t)(row * camera->width),
                                            .count = (size_t)(rows * camera->width)};
    return test_backend()->render(s->on_device, &view, options, &places, ret_pixels, ret_samples,
                                  err);
}

const struct rn_device_step test_step = {.network_rate = 2e-3f, .plane_rate = 2e-2f};

void test_read_back(struct test_scene *s, struct test_numbers *ret) {
    size_t n = s->field->parameters.count;
    ret->parameters = malloc(n * sizeof(float));
    ret->m = malloc(n * sizeof(float));
    ret->v = malloc(n * sizeof(float));
    OK(test_backend()->train_finish(s->on_device, &ret->progress, &err));
    const struct rn_device_numbers all = {.parameters = ret->parameters, .m = ret->m, .v = ret->v};
    OK(test_backend()->download(s->on_device, &all, &err));
}

void test_numbers_finish(struct test_numbers *n) {
    free(n->parameters);
    free(n->m);
    free(n->v);
}

void test_train(struct test_scene *s, int steps, bool deterministic, struct test_numbers *ret) {
    OK(test_scene_upload(s, 0, &err));
    OK(test_scene_train(s, deterministic, &err));
    struct rn_device_step step = test_step;
    step.distortion = (float)s->config.distortion_loss;
    for (int i = 0; i < steps; i++)
        OK(test_backend()->train_step(s->on_device, &step, &err));
    test_read_back(s, ret);
}

void test_scene_finish(struct test_scene *s) {
    if (s->device) {
        test_backend()->field_destroy(&s->on_device);
        test_backend()->close(&s->device);
    }
    rn_block_destroy(s->engine.workspaces);
    rn_field_destroy(&s->field);
    rn_reference_destroy(&s->reference);
    rn_pool_destroy(&s->engine.pool);
}

struct rn_reference_ray test_reference_ray(const struct test_scene *s,
                                           const struct rn_camera *camera, int x, int y,
                                           double jitter) {
    struct rn_ray cone = rn_camera_ray(camera, x + 0.5, y + 0.5);
    struct rn_march_ray ray = rn_march_ray_from(s->field, &cone, s->config.step, jitter);
    double length = ray.length > 0 ? (double)ray.length : 0;
    double width = s->config.step * ray.stride, *mid = calloc(4000, sizeof *mid);
    struct rn_reference_ray out = {.radius = (double)ray.radius, .mid = mid, .width = width};
    bool bent = s->config.field.space == RN_SPACE_UNBOUNDED;
    for (; bent && out.count < (int)(length / (2 * width)); out.count++)
        mid[out.count] =
            (double)ray.near + rn_distance_of_place(2 - length + (2 * out.count + 1) * width);
    while (!bent && (out.count * ray.stride + 0.5) * s->config.step < length) {
        mid[out.count] = (double)ray.near + (out.count + 0.5) * width;
        out.count++;
    }
    for (int i = 0; i < 3; i++) {
        out.direction[i] = (double)ray.direction[i];
        out.origin[i] = (double)ray.origin[i] - out.direction[i] * (double)ray.near;
    }
    out.colour = colouring_of(s);
    return out;
}

void test_scene_rays(const struct test_scene *s, int64_t step, struct rn_reference_ray *rays,
                     int count) {
    int n = s->split ? 2 : 1; // cones a side of a pixel
    s->reference->pixel_rays = n * n;
    for (int r = 0; r < count; r++) {
        uint32_t part = (uint32_t)(r % (n * n)), x = part % 2, y = part / 2;
        uint64_t stream = 0x7261797300000000u;
        struct rn_rng4 of_ray = rn_rng_draw(s->config.seed, stream | (uint32_t)r, (uint64_t)step);
        struct rn_rng4 draw =
            rn_rng_draw(s->config.seed, stream | ((uint32_t)r - part), (uint64_t)step);
        uint64_t wide = (uint64_t)draw.v[0] << 32 | draw.v[1];
        int pixel = (int)((double)(wide >> 11) * 0x1p-53 * (FRAMES * SIDE * SIDE));
        int within = pixel % (SIDE * SIDE);
        const struct rn_device_frame *frame = &s->frames[pixel / (SIDE * SIDE)];
        struct rn_camera fine = rn_camera_resized(&frame->camera, n * SIDE, n * SIDE);
        rays[r] =
            test_reference_ray(s, &fine, n * (within % SIDE) + (int)x, n * (within / SIDE) + (int)y,
                               (double)rn_rng_unit(of_ray.v[2]));
        rays[r].weight = (double)frame->loss_weight;
        const uint8_t *rgba = s->rgba + 4 * pixel;
        rays[r].alpha = rgba[3] / 255.0;
        for (int c = 0; c < 3; c++)
            rays[r].target[c] = rgba[c] / 255.0 * (rgba[3] / 255.0) +
                                (1 - rgba[3] / 255.0) * (double)s->config.background[c];
    }
}

void test_rays_finish(struct rn_reference_ray *rays, int count) {
    for (int r = 0; r < count; r++)
        free((double *)rays[r].mid);
}

void test_add(Suite *suite, const char *name, const TTest *test, int count) {
    TCase *group = tcase_create(name);
    tcase_set_timeout(group, 120);
    tcase_add_loop_test(group, test, 0, count);
    suite_add_tcase(suite, group);
}
