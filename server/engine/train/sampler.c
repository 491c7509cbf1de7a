// Which pixels a step's rays go through, and the rays.
#include "server/engine/train/sampler.h"

#include <stdlib.h>

#include "common/math/rng.h"
#include "server/engine/train/trainer.h"

#define STREAM_RAYS 0x7261797300000000u // random numbers of the ray batch, one stream a step

enum rn_status rn_sampler_allocate_rays(struct rn_sampler *s, struct rn_error *err) {
    s->ray_loss = malloc(RN_MAX_RAYS * sizeof *s->ray_loss);
    s->ray_block = malloc(RN_MAX_RAYS * sizeof *s->ray_block);
    s->ray_photograph = malloc(RN_MAX_RAYS * sizeof *s->ray_photograph);
    if (s->ray_loss && s->ray_block && s->ray_photograph) return RN_OK;
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
}

void rn_sampler_free_rays(struct rn_sampler *s) {
    free(s->ray_loss);
    free(s->ray_block);
    free(s->ray_photograph);
    s->ray_loss = NULL;
    s->ray_block = NULL;
    s->ray_photograph = NULL;
}

void rn_sampler_finish(struct rn_sampler *s) {
    rn_sampler_free_rays(s);
    rn_block_destroy(s->live);
    rn_block_destroy(s->live_before);
    rn_block_destroy(s->live_guide);
    free(s->first);
    rn_importance_finish(&s->importance);
}

void rn_trainer_rays(const struct rn_trainer *t, const struct rn_pixels *pixels,
                     const struct rn_trainer_place *places, int count, double step,
                     struct rn_march_ray *ret_rays) {
    struct rn_ray_place lanes[RN_TRAINER_RAYS] = {{0}};
    for (int i = 0; i < count; i++) {
        const struct rn_trainer_place *p = &places[i];
        if (!p->frame) continue;
        lanes[i] = (struct rn_ray_place){&p->frame->view, p->x, p->y, p->jitter};
        if (!p->part) continue;
        lanes[i].view = &p->frame->fine;
        lanes[i].x = 2 * p->x + (p->part - 1) % 2;
        lanes[i].y = 2 * p->y + (p->part - 1) / 2;
    }
    t->engine->kernels->rays(lanes, count, step, t->field->config.cone_step, ret_rays);
    const struct rn_colouring *colour = &t->step.march.colour;
    const float *background =
        colour->background_variance > 0 ? colour->background : t->field->config.background;
    for (int i = 0; i < count; i++) {
        const struct rn_trainer_place *p = &places[i];
        if (!p->frame) {
            ret_rays[i].weight = 0;
            continue;
        }
        ret_rays[i].alpha = rn_pixel_over(rn_pixel_at(pixels, p->frame, p->x, p->y), background,
                                          ret_rays[i].target);
    }
    rn_pixels_let_go(pixels);
}

struct rn_march_ray rn_trainer_ray(const struct rn_trainer *t, const struct rn_pixels *pixels,
                                   const struct rn_pixel_frame *frame, int x, int y, double step,
                                   double jitter) {
    struct rn_trainer_place place = {.frame = frame, .x = x, .y = y, .jitter = (float)jitter};
    struct rn_march_ray ray;
    rn_trainer_rays(t, pixels, &place, 1, step, &ray);
    return ray;
}

// The frame of a scale that holds the scale's i-th pixel.
static const struct rn_pixel_frame *frame_of(const struct rn_pixels *p, int scale, size_t i) {
    int low = p->scale_first[scale];
    int high = scale + 1 < p->scale_count ? p->scale_first[scale + 1] : p->frame_count;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (p->frames[middle].before <= i)
            low = middle;
        else
            high = middle;
    }
    return &p->frames[low];
}

// Uniform in [0, n) from 64 random bits, n < 2^53.
static size_t below(uint64_t wide, size_t n) {
    return (size_t)((double)(wide >> 11) * 0x1p-53 * (double)n);
}

// A pixel drawn uniformly over all scales: to the letter of the paper, dead ones too.
static const struct rn_pixel_frame *draw_pixel(const struct rn_trainer *t, struct rn_rng4 draw,
                                               int *ret_x, int *ret_y) {
    int scale = 0;
    size_t pixel = below((uint64_t)draw.v[0] << 32 | draw.v[1], t->train.pixel_count);
    while (pixel >= t->train.scale_pixels[scale])
        pixel -= t->train.scale_pixels[scale++];
    const struct rn_pixel_frame *frame = frame_of(&t->train, scale, pixel);
    size_t within = pixel - frame->before, width = (size_t)frame->camera.width;
    *ret_x = (int)(within % width);
    *ret_y = (int)(within / width);
    return frame;
}

// A pixel of the scale that ray r's turn falls to, of the blocks that may see the hull: which
// block, and where in it. The rays of a split pixel have one turn.
static void draw_live_pixel(const struct rn_trainer *t, int r, struct rn_trainer_place *ret) {
    uint64_t turn = (t->step.first_ray + (uint64_t)r) / (uint64_t)rn_pixel_rays(&t->step.march);
    struct rn_scale_turn from = rn_scale_turn(turn, t->train.scale_count);
    size_t first = t->sampler.live_first[from.scale],
           count = t->sampler.live_first[from.scale + 1] - first;
    uint64_t seed = t->field->config.seed;
    if (count == 0) return;
    struct rn_live_pixel pixel =
        t->sampler.importance.count > 0
            ? rn_importance_pixel(&t->sampler.importance, from.scale, first, count, seed, from.turn,
                                  &ret->weight)
            : rn_live_pixel(seed, from.turn, count);
    ret->x = pixel.x;
    ret->y = pixel.y;
    ret->block = (int32_t)(first + pixel.block);
}

bool rn_trainer_is_drawn(const struct rn_trainer *t, const struct rn_pixel_frame *frame, int x,
                         int y) {
    return rn_pixel_is_used(&t->train, frame, x, y) && !rn_trainer_is_outlier(t, frame, x, y);
}

bool rn_trainer_leaves_out(const struct rn_trainer *t) {
    const struct rn_effect_record *outliers = &t->field->effects[RN_EFFECT_ROBUST_LOSS];
    return t->train.used || outliers->on || !outliers->decided;
}

// From a place in a block to that in the block's image. No frame where the block reaches over the
// image's edge, or a mask leaves the pixel out.
static void settle(const struct rn_trainer *t, struct rn_trainer_place *place) {
    if (place->block < 0) return;
    struct rn_live_block block = rn_trainer_live(t, (size_t)place->block);
    const struct rn_pixel_frame *frame = &t->train.frames[block.frame];
    place->x += block.x;
    place->y += block.y;
    if (place->x < frame->camera.width && place->y < frame->camera.height &&
        rn_trainer_is_drawn(t, frame, place->x, place->y))
        place->frame = frame;
    if (!place->frame || place->part > 1) place->block = -1; // a pixel's error is noted once
}

static struct rn_rng4 draw_of(const struct rn_trainer *t, int r) {
    return rn_rng_draw(t->step.march.seed, STREAM_RAYS | (uint32_t)r, t->step.march.counter);
}

// Where ray r of a step starts, but for settle().
static struct rn_trainer_place draw_place(const struct rn_trainer *t, int r) {
    int part = r % rn_pixel_rays(&t->step.march);
    struct rn_rng4 draw = draw_of(t, r), of_pixel = part ? draw_of(t, r - part) : draw;
    struct rn_trainer_place place = {.jitter = rn_rng_unit(draw.v[2]),
                                     .part = t->step.march.split ? part + 1 : 0,
                                     .weight = 1,
                                     .block = -1};
    if (t->field->config.favour_finest) {
        draw_live_pixel(t, r - part, &place);
    } else {
        place.frame = draw_pixel(t, of_pixel, &place.x, &place.y);
        place.weight = (float)place.frame->frame->loss_weight;
        if (!rn_trainer_is_drawn(t, place.frame, place.x, place.y)) place.frame = NULL;
    }
    return place;
}

const struct rn_pixel_frame *rn_trainer_place(const struct rn_trainer *t, int r, int *ret_x,
                                              int *ret_y) {
    struct rn_trainer_place place = draw_place(t, r);
    settle(t, &place);
    *ret_x = place.x;
    *ret_y = place.y;
    return place.frame;
}

// All places first: blocks and pixels lie anywhere in memory.
void rn_trainer_draw(struct rn_trainer *t, int begin, int end) {
    struct rn_trainer_place places[32];
    for (; begin < end; begin += 32) {
        int n = end - begin < 32 ? end - begin : 32;
        struct rn_march_ray *rays = t->step.rays + begin;
        for (int i = 0; i < n; i++)
            places[i] = draw_place(t, begin + i);
        for (int i = 0; i < n; i++) {
            settle(t, &places[i]);
            if (places[i].frame)
                rn_pixels_expect(&t->train, places[i].frame, places[i].x, places[i].y);
        }
        rn_trainer_rays(t, &t->train, places, n, (double)t->step.march.step, rays);
        for (int i = 0; i < n; i++) {
            if (rays[i].weight > 0) rays[i].weight = places[i].weight;
            rays[i].id = (uint32_t)(begin + i);
            t->sampler.ray_block[begin + i] = places[i].block;
            t->sampler.ray_loss[begin + i] = 0;
            if (places[i].frame && t->field->config.field.appearances)
                t->sampler.ray_photograph[begin + i] =
                    (uint32_t)(places[i].frame->frame - t->dataset->frames);
        }
    }
}

void rn_trainer_note_losses(struct rn_trainer *t) {
    for (int r = 0; r < t->step.ray_count && t->sampler.importance.count > 0; r++)
        if (t->sampler.ray_block[r] >= 0)
            rn_importance_note(&t->sampler.importance, (size_t)t->sampler.ray_block[r],
                               (double)t->sampler.ray_loss[r]);
}
