// Does a device compute here what the CPU does? Small fields of random numbers: pixels beside the
// CPU's kernels, and the gradient of a training step against what the loss does along it.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/math/rng.h"
#include "server/engine/field/voxels.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"

#define SIDE 12
#define FRAMES 2
#define RAYS 128          // of a step
#define FEW_RAYS 24       // of one that a runner's start waits for
#define GROUPS 4          // of parameters: planes, voxels, density network, colour network
#define STRIDE 0.02       // how far the loss is moved, of the loss
#define UNIT (1.0 / 1024) // by which numbers are moved

struct subject {
    struct rn_engine *engine;
    const struct rn_kernels *kernels; // of the CPU: in fp32
    struct rn_train_config config;
    struct rn_field *field;
    int rays; // of a step
    struct rn_device_frame frames[FRAMES];
    uint8_t rgba[4 * FRAMES * SIDE * SIDE];
};

static float unit(uint64_t stream, size_t i) {
    return rn_rng_unit(rn_rng_draw(99, stream, i).v[0]);
}

// The paper's networks and footprints; those that shade rays as a whole; the same in all of space,
// with voxels beside the planes.
enum kind { OF_SAMPLES, OF_RAYS, OF_A_PLACE, KINDS };

static enum rn_status describe(enum kind kind, struct rn_train_config *ret, struct rn_error *err) {
    enum rn_status status = rn_preset("paper", false, ret, err);
    bool per_ray = kind != OF_SAMPLES;
    if (status != RN_OK) return status;
    ret->field.voxels = kind == OF_A_PLACE;
    if (kind == OF_A_PLACE) ret->field.space = RN_SPACE_UNBOUNDED;
    ret->field.planes = per_ray ? 3 : 10;
    ret->field.width = per_ray ? 64 : 128;
    ret->field.footprint = per_ray ? RN_FOOTPRINT_MIP : RN_FOOTPRINT_RIP;
    ret->field.shading = per_ray ? RN_SHADING_RAY : RN_SHADING_SAMPLE;
    ret->field.channels = ret->field.base = ret->field.occupancy = 16;
    ret->field.levels = 2;
    ret->step = 0.2;
    ret->stop = 1e-30;
    ret->target_samples = 1024;
    ret->roulette = 0;
    return RN_OK;
}

// Numbers that fp16 holds, the networks' twice as large as at a training's start.
static void fill_field(struct subject *s) {
    struct rn_parameters *p = &s->field->parameters;
    const struct rn_field_config *c = &s->config.field;
    rn_field_randomise(s->field, 5);
    for (size_t i = 0; i < p->plane_count; i++)
        p->values[i] = floorf(2048 * unit(1, i) - 1024) / 1024;
    for (size_t i = p->plane_count; i < p->count; i++)
        p->values[i] = roundf(p->values[i] * 2048) / 1024;
    for (size_t i = 0; i < (size_t)c->occupancy * c->occupancy * c->occupancy; i++)
        s->field->occupancy[i] = s->field->hull[i];
    rn_field_refresh(s->field, &(struct rn_engine){.kernels = s->kernels, .pool = s->engine->pool});
    rn_field_refresh_occupancy(s->field);
}

static enum rn_status fill_frames(struct subject *s, struct rn_error *err) {
    for (int f = 0; f < FRAMES; f++) {
        double eye[3] = {3 * cos(1.7 * f), 3 * sin(1.7 * f), 1.5 - f};
        struct rn_camera *camera = &s->frames[f].camera;
        *camera = (struct rn_camera){.width = SIDE,
                                     .height = SIDE,
                                     .fx = 1.8 * SIDE,
                                     .fy = 1.8 * SIDE,
                                     .cx = SIDE / 2.0,
                                     .cy = SIDE / 2.0};
        enum rn_status status = rn_camera_look_at(eye, (double[3]){0, 0, 0}, (double[3]){0, 0, 1},
                                                  camera->world_from_camera);
        if (status != RN_OK) return rn_error_set(err, status, "device", "no camera to check with");
        s->frames[f].offset = s->frames[f].before = (uint64_t)f * SIDE * SIDE;
        s->frames[f].loss_weight = 1;
    }
    for (size_t i = 0; i < sizeof s->rgba; i++)
        s->rgba[i] = (uint8_t)(255 * unit(2, i));
    return RN_OK;
}

static enum rn_status subject_init(struct rn_engine *e, enum kind kind, struct subject *s,
                                   struct rn_error *err) {
    const struct rn_bounds bounds = {.radius = 1};
    *s = (struct subject){.engine = e, .kernels = rn_kernels_find("generic")};
    enum rn_status status = describe(kind, &s->config, err);
    if (status == RN_OK) status = rn_field_create(&s->config, &bounds, &s->field, err);
    if (status == RN_OK) status = rn_field_need_levels(s->field, s->config.field.levels, err);
    if (status == RN_OK) status = rn_engine_prepare(e, s->field, err);
    if (status == RN_OK) status = fill_frames(s, err);
    if (status == RN_OK) fill_field(s);
    return status;
}

static enum rn_status put(const struct subject *s, const float *parameters,
                          struct rn_device_field **ret, struct rn_error *err) {
    struct rn_device_scene scene = rn_device_scene_of(s->field, s->config.field.levels);
    scene.parameters = parameters;
    return s->engine->backend->field_create(s->engine->device, &scene, ret, err);
}

// The largest difference of a pixel, of the largest number among them.
static enum rn_status compare_pixels(struct subject *s, double *ret_worst, struct rn_error *err) {
    const struct rn_backend *backend = s->engine->backend;
    const struct rn_camera *camera = &s->frames[0].camera;
    const struct rn_device_view view = {
        .cameras = camera, .camera_count = 1, .cones = 1, .cells = RN_CELLS_OF_TRAINING};
    const struct rn_device_places all = {.count = SIDE * SIDE};
    struct rn_march_options options = {.step = (float)s->config.step, .stop_depth = 1e9f};
    struct rn_pixel there[SIDE * SIDE], here[SIDE * SIDE];
    struct rn_march_ray rays[SIDE * SIDE];
    struct rn_device_field *field = NULL;
    double worst = 0, largest = 1;
    uint64_t samples;
    enum rn_status status = put(s, s->field->parameters.values, &field, err);
    if (status == RN_OK)
        status = backend->render(field, &view, &options, &all, there, &samples, err);
    backend->field_destroy(&field);
    if (status != RN_OK) return status;
    for (int i = 0; i < SIDE * SIDE; i++) {
        struct rn_ray ray = rn_camera_ray(camera, i % SIDE + 0.5, i / SIDE + 0.5);
        rays[i] = rn_march_ray_from(s->field, &ray, s->config.step, 0);
    }
    s->kernels->render(&s->field->cpu, &options, rays, SIDE * SIDE,
                       rn_engine_workspace(s->engine, 0), here);
    for (int i = 0; i < 3 * SIDE * SIDE; i++) {
        double a = (double)there[i / 3].rgb[i % 3], b = (double)here[i / 3].rgb[i % 3];
        worst = isfinite(a) ? fmax(worst, fabs(a - b)) : INFINITY;
        largest = fmax(largest, fabs(b));
    }
    *ret_worst = worst / largest;
    return RN_OK;
}

// The loss of the first step's rays; its gradient in `ret_gradient`, where not NULL.
static enum rn_status loss_of(const struct subject *s, const float *parameters, double *ret_loss,
                              float *ret_gradient, struct rn_error *err) {
    const struct rn_backend *backend = s->engine->backend;
    const struct rn_device_pixels pixels = {.frames = s->frames,
                                            .rgba = s->rgba,
                                            .frame_count = FRAMES,
                                            .scale_count = 1,
                                            .scale_first = {0, FRAMES},
                                            .scale_pixels = {FRAMES * SIDE * SIDE},
                                            .pixel_count = FRAMES * SIDE * SIDE};
    const struct rn_device_training training = {
        .deterministic = true,
        .next_rays = s->rays,
        .march_step = s->config.step,
        .gradient_scale = 64}; // large enough for fp16, and nothing overflows
    const struct rn_device_step still = {.network_rate = 0};
    struct rn_device_progress progress;
    struct rn_device_field *field = NULL;
    size_t count = s->field->parameters.count;
    enum rn_status status = put(s, parameters, &field, err);
    if (status == RN_OK) status = backend->train_begin(field, &pixels, &training, err);
    if (status == RN_OK) status = backend->train_step(field, &still, err);
    if (status == RN_OK) status = backend->train_finish(field, &progress, err);
    const struct rn_device_numbers moments = {.m = ret_gradient};
    if (status == RN_OK) status = backend->download(field, &moments, err);
    backend->field_destroy(&field);
    for (size_t i = 0; i < count && ret_gradient && status == RN_OK; i++)
        ret_gradient[i] *= 10; // the first moment after one step is a tenth of it
    if (status == RN_OK) *ret_loss = progress.updates == 1 ? progress.loss : NAN;
    return status;
}

// Moves some numbers of a group against or along the signs of their gradients, by a unit that fp16
// holds: as many as change the loss by `change`. What the gradient says that they do.
static double move(const float *gradient, size_t first, size_t count, double change, bool back,
                   float *moved) {
    double all = 0, said = 0;
    for (size_t i = first; i < first + count; i++)
        all += fabs((double)gradient[i]);
    double share = change / (UNIT * all);
    for (size_t i = first; i < first + count; i++) {
        if (!((double)unit(3, i) < share)) continue;
        moved[i] += (float)(back ? -UNIT : UNIT) * (float)((gradient[i] > 0) - (gradient[i] < 0));
        said += UNIT * fabs((double)gradient[i]);
    }
    return all > 0 ? said : NAN;
}

static void count_groups(const struct subject *s, size_t ret[GROUPS]) {
    const struct rn_parameters *p = &s->field->parameters;
    const struct rn_field_config *c = &s->config.field;
    ret[1] = c->voxels ? rn_grid_numbers(c) : 0;
    ret[0] = p->plane_count - ret[1];
    ret[2] = p->base_count;
    ret[3] = p->head_count;
}

// |1 - what the loss changes by / what the gradient says| where the groups of parameters from
// `first` on, before `end`, move, of which each is to change it by as much.
static enum rn_status follow(const struct subject *s, const float *gradient, double loss, int first,
                             int end, float *moved, double *ret_error, struct rn_error *err) {
    const struct rn_parameters *p = &s->field->parameters;
    double said = 0, losses[2] = {NAN, NAN};
    enum rn_status status = RN_OK;
    size_t counts[GROUPS];
    count_groups(s, counts);
    if (end == first + 1 && counts[first] == 0) return RN_OK; // of a field without voxels
    for (int back = 0; back < 2 && status == RN_OK; back++) {
        memcpy(moved, p->values, p->count * sizeof *moved);
        size_t at = 0;
        for (int i = 0; i < end; at += counts[i++])
            if (i >= first && counts[i] > 0)
                said += move(gradient, at, counts[i], STRIDE * loss / (end - first), back, moved);
        status = loss_of(s, moved, &losses[back], NULL, err);
    }
    double error = fabs(1 - (losses[0] - losses[1]) / said);
    if (!(error <= *ret_error)) *ret_error = isnan(error) ? INFINITY : error;
    return status;
}

// One group after the other, or `together`, which takes less than half as long.
static enum rn_status check_gradient(const struct subject *s, bool together, double *ret_worst,
                                     struct rn_error *err) {
    const struct rn_parameters *p = &s->field->parameters;
    float *gradient = malloc(p->count * sizeof *gradient),
          *moved = malloc(p->count * sizeof *moved);
    double loss = NAN;
    enum rn_status status = RN_OK;
    int each = together ? GROUPS : 1;
    *ret_worst = 0;
    if (!gradient || !moved)
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "device", "out of memory");
    if (status == RN_OK) status = loss_of(s, p->values, &loss, gradient, err);
    for (int i = 0; i < GROUPS && status == RN_OK; i += each)
        status = follow(s, gradient, loss, i, i + each, moved, ret_worst, err);
    free(gradient);
    free(moved);
    return status;
}

enum rn_status rn_device_check(struct rn_engine *e, bool whole, struct rn_device_agreement *ret,
                               struct rn_error *err) {
    struct rn_device_agreement out = {0};
    int64_t begin = rn_clock_ns();
    enum rn_status status = RN_OK;
    for (int kind = 0; kind < KINDS && status == RN_OK; kind++) {
        struct subject s;
        double pixels = 0, gradient = 0;
        status = subject_init(e, (enum kind)kind, &s, err);
        if (status == RN_OK) status = compare_pixels(&s, &pixels, err);
        bool together = !whole && kind != OF_RAYS;
        s.rays = together ? FEW_RAYS : RAYS;
        if (status == RN_OK) status = check_gradient(&s, together, &gradient, err);
        if (status == RN_ERROR_NO_MEMORY && !whole && pixels > 0) { // beside others' scenes
            gradient = NAN;
            status = RN_OK;
        }
        rn_field_destroy(&s.field);
        out.pixels = fmax(out.pixels, pixels);
        if (!isnan(out.gradient))
            out.gradient = isnan(gradient) ? NAN : fmax(out.gradient, gradient);
    }
    out.ms = (double)(rn_clock_ns() - begin) * 1e-6;
    if (status != RN_OK) return status;
    *ret = out;
    if (out.pixels <= RN_DEVICE_PIXELS && !(out.gradient > RN_DEVICE_GRADIENT)) return RN_OK;
    return rn_error_set(err, RN_ERROR_NUMERIC, "device",
                        "%s computes otherwise than the CPU: pixels differ by %.1e (at most %.1e), "
                        "the loss leaves its gradient by %.0f %% (at most %.0f %%); use --device "
                        "cpu",
                        e->info.device, out.pixels, RN_DEVICE_PIXELS, 100 * out.gradient,
                        100 * RN_DEVICE_GRADIENT);
}
