#include "server/engine/render/cones.h"

#include <math.h>
#include <stdlib.h>

#include "server/engine/render/develop.h"
#include "server/engine/scene/device.h"

int rn_cones_for_camera(const struct rn_field *field, const struct rn_camera *camera) {
    double finest = field->finest_cone;
    if (!field->config.supersample || !(finest > 0)) return 1;
    double ratio = rn_cone_at_centre(field, camera) / finest;
    int n = 1;
    while (n < RN_CONES_MOST && ratio > n * RN_CONES_RATIO)
        n *= 2;
    return n;
}

bool rn_field_averages_straight(const struct rn_field *field, const struct rn_frame *frame) {
    return field->effects[RN_EFFECT_STRAIGHT_ALPHA].on && frame->scale > 0;
}

static void close_ended(const struct rn_field *field, const struct rn_march_options *march,
                        struct rn_pixel *pixels, size_t count) {
    float ended = rn_ended_opacity(march->stop_depth, field->config.stop);
    for (struct rn_pixel *p = pixels; p < pixels + count; p++)
        rn_close_ended(ended, march->colour.background, p);
}

static const float *straight_over(const struct rn_march_options *march) {
    return march->straight ? march->colour.background : NULL;
}

// The picture's camera of n x n as many pixels.
struct looking {
    const struct rn_cones *cones;
    struct rn_view fine;
};

static void cut_parallel(const struct rn_cones *c, const struct rn_spot *spots, int count,
                         struct rn_march_ray *rays, float *moved) {
    int n = c->n;
    for (int i = 0; i < count * n * n; i++) {
        struct rn_spot s = spots[i / (n * n)];
        int j = i % (n * n), x = s.x * n + j % n, y = s.y * n + j / n;
        int from = rn_viewpoints_choose(s.x, s.y, n, j);
        rays[i] = rn_viewpoints_ray(c->viewpoints, c->field, from, x, y, (double)c->march->step,
                                    &moved[i]);
    }
}

// Cones that are seen from several places, as their colours are: light, until they are averaged.
static void mean_of_light(struct rn_pixel *cones, int n, struct rn_pixel *ret_pixel) {
    for (int i = 0; i < 3 * n * n; i++)
        cones[i / 3].rgb[i % 3] = rn_srgb_to_linear(cones[i / 3].rgb[i % 3]);
    *ret_pixel = rn_cones_mean(cones, n, NULL);
    for (int c = 0; c < 3; c++)
        ret_pixel->rgb[c] = rn_srgb_from_linear(ret_pixel->rgb[c]);
}

// At most RN_CONES_BLOCK cones.
static uint64_t render_block(const struct looking *l, const struct rn_spot *spots, int count,
                             int thread, struct rn_pixel *ret_pixels, uint16_t *ret_costs) {
    struct rn_ray_place places[RN_CONES_BLOCK] = {{0}};
    struct rn_march_ray rays[RN_CONES_BLOCK];
    struct rn_pixel cones[RN_CONES_BLOCK];
    float moved[RN_CONES_BLOCK];
    const struct rn_cones *c = l->cones;
    const struct rn_viewpoints *from = c->viewpoints;
    int n = c->n, total = count * n * n;
    for (int i = 0; i < total; i++) {
        struct rn_spot s = spots[i / (n * n)];
        int j = i % (n * n);
        places[i] = (struct rn_ray_place){&l->fine, s.x * n + j % n, s.y * n + j / n, 0};
        if (from) places[i].view = &from->view[rn_viewpoints_choose(s.x, s.y, n, j)];
    }
    if (from && from->parallel)
        cut_parallel(c, spots, count, rays, moved);
    else
        c->engine->kernels->rays(places, total, (double)c->march->step, c->field->config.cone_step,
                                 rays);
    struct rn_pixel *seen = n == 1 ? ret_pixels : cones;
    uint16_t samples_of[RN_CONES_BLOCK] = {0};
    struct rn_march_options counting = *c->march;
    if (ret_costs) counting.samples = samples_of;
    uint64_t samples = c->engine->kernels->render(&c->field->cpu, &counting, rays, total,
                                                  rn_engine_workspace(c->engine, thread), seen);
    close_ended(c->field, c->march, seen, (size_t)total);
    for (int i = 0; from && from->parallel && i < total; i++)
        if (seen[i].alpha > 0) seen[i].depth -= moved[i];
    for (int i = 0; i < count && n > 1; i++)
        if (from && from->spread)
            mean_of_light(cones + i * n * n, n, &ret_pixels[i]);
        else
            ret_pixels[i] = rn_cones_mean(cones + i * n * n, n, straight_over(c->march));
    for (int i = 0; i < total && ret_costs; i++) {
        if (i % (n * n) == 0) ret_costs[i / (n * n)] = 0;
        ret_costs[i / (n * n)] += samples_of[i];
    }
    return samples;
}

uint64_t rn_cones_render(const struct rn_cones *cones, const struct rn_spot *spots, int count,
                         int thread, struct rn_pixel *ret_pixels, uint16_t *ret_costs) {
    const struct rn_camera *camera = cones->camera;
    int n = cones->n;
    struct rn_camera fine = rn_camera_resized(camera, camera->width * n, camera->height * n);
    struct looking looking = {cones, rn_field_view(cones->field, &fine)};
    uint64_t samples = 0;
    for (int i = 0, block = RN_CONES_BLOCK / (n * n); i < count; i += block)
        samples += render_block(&looking, spots + i, count - i < block ? count - i : block, thread,
                                ret_pixels + i, ret_costs ? ret_costs + i : NULL);
    return samples;
}

// Which cells the CPU's march would read (rn_field_choose_cells).
static enum rn_device_cells chosen_cells(const struct rn_field *field) {
    const uint32_t *words = field->cpu.occupancy.words;
    return words == field->fine.words   ? RN_CELLS_FINE
           : words == field->firm.words ? RN_CELLS_FIRM
                                        : RN_CELLS_OF_TRAINING;
}

enum rn_status rn_cones_render_there(struct rn_field *field, const struct rn_march_options *march,
                                     const struct rn_device_view *view,
                                     const struct rn_device_places *places,
                                     struct rn_pixel *ret_pixels, uint64_t *ret_samples,
                                     struct rn_error *err) {
    struct rn_device_view chosen = *view;
    chosen.cells = chosen_cells(field);
    return field->backend->render(field->on_device, &chosen, march, places, ret_pixels, ret_samples,
                                  err);
}
