// Training on a device: the host keeps the schedule and the counters, the device does the steps.
#include "server/engine/scene/device.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/render/cones.h"
#include "server/engine/train/guard.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

#define QUEUED 16        // steps between two looks at the counters
#define MOST_REJECTED 40 // steps in a row, the gradients' scale halved at each

// The arrays that are copied to the device, once.
struct packed_pixels {
    struct rn_device_pixels pixels;
    struct rn_device_frame *frames;
    struct rn_device_block *live;
    uint32_t *used;
};

static void pack_scales(const struct rn_trainer *t, struct rn_device_pixels *p) {
    p->rgba = t->train.rgba;
    p->frame_count = t->train.frame_count;
    p->scale_count = t->train.scale_count;
    p->pixel_count = t->train.pixel_count;
    p->live_count = t->sampler.live_count;
    for (int s = 0; s < p->scale_count; s++) {
        p->scale_first[s] = t->train.scale_first[s];
        p->scale_pixels[s] = t->train.scale_pixels[s];
    }
    p->scale_first[p->scale_count] = p->frame_count;
    for (int s = 0; s <= p->scale_count; s++)
        p->live_first[s] = t->sampler.live_first[s];
}

static void pack_used(const struct rn_trainer *t, uint32_t *ret) {
    for (int f = 0; f < t->train.frame_count; f++) {
        const struct rn_pixel_frame *frame = &t->train.frames[f];
        size_t at = frame->offset;
        for (int y = 0; y < frame->camera.height; y++)
            for (int x = 0; x < frame->camera.width; x++, at++)
                if (rn_trainer_is_drawn(t, frame, x, y)) ret[at / 32] |= 1u << at % 32;
        rn_pixels_let_go(&t->train);
    }
}

static void free_packed(struct packed_pixels *packed) {
    free(packed->frames);
    free(packed->live);
    free(packed->used);
}

static enum rn_status pack_pixels(const struct rn_trainer *t, struct packed_pixels *ret,
                                  struct rn_error *err) {
    ret->frames = calloc((size_t)t->train.frame_count + 1, sizeof *ret->frames);
    ret->live = calloc(t->sampler.live_count + 1, sizeof *ret->live);
    if (rn_trainer_leaves_out(t))
        ret->used = calloc(rn_device_used_words(t->train.pixel_count), sizeof *ret->used);
    if (!ret->frames || !ret->live || (!ret->used && rn_trainer_leaves_out(t)))
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    for (int f = 0; f < t->train.frame_count; f++) {
        const struct rn_pixel_frame *from = &t->train.frames[f];
        ret->frames[f] = (struct rn_device_frame){.camera = from->camera,
                                                  .offset = from->offset,
                                                  .before = from->before,
                                                  .loss_weight = (float)from->frame->loss_weight};
    }
    for (size_t i = 0; i < t->sampler.live_count; i++) {
        struct rn_live_block block = rn_trainer_live(t, i);
        ret->live[i] = (struct rn_device_block){
            .frame = (uint32_t)block.frame, .x = (uint16_t)block.x, .y = (uint16_t)block.y};
    }
    pack_scales(t, &ret->pixels);
    ret->pixels.frames = ret->frames;
    ret->pixels.live = ret->live;
    if (ret->used) pack_used(t, ret->used);
    ret->pixels.used = ret->used;
    if (t->sampler.importance.count > 0) {
        ret->pixels.shares = rn_importance_shares(&t->sampler.importance);
        ret->pixels.block_error = t->sampler.importance.error;
    }
    return RN_OK;
}

// The field and all of its training on the device.
static enum rn_status put_training(struct rn_trainer *t, struct rn_error *err) {
    struct packed_pixels packed = {.frames = NULL};
    rn_trainer_take_march(t);
    struct rn_device_training training = {.deterministic = t->engine->deterministic,
                                          .last_on_chip = t->engine->last_on_chip,
                                          .two_tiles = t->engine->two_tiles,
                                          .next_rays = t->next_rays,
                                          .step = t->progress.step,
                                          .updates = t->optimiser.updates,
                                          .gradient_scale = t->device.gradient_scale,
                                          .good_steps = t->device.good_steps,
                                          .gradient_size = t->device.gradient_size,
                                          .rays = t->progress.rays,
                                          .march_step = (double)t->step.march.step,
                                          .split = t->step.march.split,
                                          .colour = t->step.march.colour,
                                          .m = t->optimiser.m,
                                          .v = t->optimiser.v,
                                          .seen = t->hull.seen};
    enum rn_status status = pack_pixels(t, &packed, err);
    if (status == RN_OK)
        status =
            rn_field_put(t->engine, t->field, t->optimiser.levels, &packed.pixels, &training, err);
    free_packed(&packed);
    return status;
}

enum rn_status rn_trainer_fetch(struct rn_trainer *t, struct rn_error *err) {
    const struct rn_device_numbers training = {.m = t->optimiser.m,
                                               .v = t->optimiser.v,
                                               .seen = t->hull.seen,
                                               .block_error = t->sampler.importance.error};
    return rn_field_fetch(t->field, &training, err);
}

enum rn_status rn_trainer_put(struct rn_trainer *t, struct rn_error *err) {
    struct rn_engine *e = t->engine;
    const char *kernels = e->kernels->name;
    enum rn_status status = RN_OK;
    t->device.counted =
        (struct rn_device_progress){.steps = t->progress.step, .rays = t->progress.rays};
    if (e->backend) status = put_training(t, err);
    if (status == RN_ERROR_UNSUPPORTED && e->device_optional) status = RN_OK;
    if (t->field->on_device) kernels = e->device_kernels;
    snprintf(t->field->kernels, sizeof t->field->kernels, "%s", kernels);
    return status;
}

int rn_trainer_validate_together(const struct rn_trainer *t, int first) {
    const struct rn_pixel_frame *frame = &t->held.frames[first];
    int width = frame->camera.width, height = frame->camera.height, count = 0;
    int cones = rn_cones_for_camera(t->field, &frame->camera);
    bool straight = rn_field_averages_straight(t->field, frame->frame);
    size_t all = (size_t)width * (size_t)height * (size_t)cones * (size_t)cones;
    while (first + count < t->held.frame_count && count < RN_DEVICE_CAMERAS &&
           all * (size_t)(count + 1) <= RN_VALIDATE_CONES) {
        const struct rn_pixel_frame *f = &t->held.frames[first + count];
        if (f->camera.width != width || f->camera.height != height) break;
        if (rn_cones_for_camera(t->field, &f->camera) != cones) break;
        if (rn_field_averages_straight(t->field, f->frame) != straight) break;
        count++;
    }
    return count;
}

enum rn_status rn_trainer_validate_rows(struct rn_trainer *t, int first, int count, int row,
                                        int rows, double *ret_squares, struct rn_error *err) {
    const struct rn_train_config *config = &t->field->config;
    const struct rn_pixel_frame *frames = &t->held.frames[first];
    struct rn_camera cameras[RN_DEVICE_CAMERAS];
    for (int i = 0; i < count; i++)
        cameras[i] = frames[i].camera;
    size_t width = (size_t)cameras->width, each = width * (size_t)rows;
    struct rn_march_options march = rn_effects_march_pictures(t->field);
    const struct rn_device_view view = {.cameras = cameras,
                                        .camera_count = count,
                                        .cones = rn_cones_for_camera(t->field, cameras),
                                        .halves = true};
    const struct rn_device_places places = {.first = (uint32_t)row * (uint32_t)width,
                                            .count = each * (size_t)count};
    uint64_t samples;
    struct rn_pixel *pixels = malloc(places.count * sizeof *pixels);
    if (!pixels) return rn_error_set(err, RN_ERROR_NO_MEMORY, "trainer", "out of memory");
    march.straight = rn_field_averages_straight(t->field, frames->frame);
    enum rn_status status =
        rn_cones_render_there(t->field, &march, &view, &places, pixels, &samples, err);
    for (size_t i = 0; i < places.count && status == RN_OK; i++) {
        const struct rn_pixel_frame *frame = &frames[i / each];
        int x = (int)(i % width), y = row + (int)(i % each / width);
        if (rn_pixel_is_used(&t->held, frame, x, y))
            rn_pixel_add_error(&t->held, frame, x, y, config->background, pixels[i].rgb,
                               &ret_squares[i / each]);
    }
    free(pixels);
    return status;
}

static struct rn_device_step next_step(const struct rn_trainer *t) {
    const struct rn_train_config *config = &t->field->config;
    double rate = rn_schedule_rate(config, &t->progress);
    struct rn_occupancy_turn turn = rn_schedule_occupancy(config, t->progress.step);
    struct rn_march_options march = rn_schedule_march(t->field, &t->progress);
    struct rn_seen_round seen = rn_trainer_seen_round(t);
    if (turn.sampled) turn.decay = (float)RN_OCCUPANCY_DECAY;
    return (struct rn_device_step){.network_rate = (float)rate,
                                   .plane_rate = (float)(rate * config->plane_rate),
                                   .measure = turn.due,
                                   .measure_drawn = turn.sampled,
                                   .measure_first = turn.first,
                                   .measure_stride = turn.stride,
                                   .measure_decay = turn.decay,
                                   .seen_counts = seen.counts,
                                   .all_looked = seen.all_looked,
                                   .distortion = march.distortion_loss,
                                   .smoothing = rn_schedule_smoothing(config, &t->progress)};
}

static void take_progress(struct rn_trainer *t, const struct rn_device_progress *p,
                          const struct rn_device_progress *before) {
    struct rn_progress *to = &t->progress;
    t->window.samples += p->samples - before->samples;
    t->window.rays += p->rays - before->rays;
    to->samples += p->samples - before->samples;
    to->rays += p->rays - before->rays;
    to->nonfinite_rays += p->nonfinite_rays - before->nonfinite_rays;
    to->steps_rejected += p->steps_rejected - before->steps_rejected;
    for (int l = 0; l < RN_MAX_LEVELS; l++)
        to->level_samples[l] += p->level_samples[l] - before->level_samples[l];
    if (p->loss > 0 && isfinite(p->loss)) to->loss = p->loss;
    t->optimiser.updates = p->updates;
    t->next_rays = p->next_rays;
    t->optimiser.rejected = p->rejected_in_a_row;
    t->device.gradient_scale = p->gradient_scale;
    t->device.good_steps = p->good_steps;
    t->device.gradient_size = p->gradient_size;
}

// As on the CPU, but back to what was last known here, and onto the device again.
static enum rn_status roll_back(struct rn_trainer *t, struct rn_error *err) {
    enum rn_status status = rn_trainer_enter(t, err);
    if (status != RN_OK) return status;
    rn_trainer_redraw(t);
    rn_trainer_roll_back(t);
    t->device.gradient_scale = 0;
    t->device.good_steps = 0;
    t->device.gradient_size = 0;
    return rn_trainer_put(t, err);
}

static bool shares_are_due(const struct rn_trainer *t) {
    return t->sampler.importance.count > 0 && t->progress.step > 0 &&
           t->progress.step % RN_IMPORTANCE_EVERY == 0;
}

// Which blocks the next rays come from, by the errors that the device has noted.
static enum rn_status share_out(struct rn_trainer *t, struct rn_error *err) {
    const struct rn_device_numbers errors = {.block_error = t->sampler.importance.error};
    struct rn_device_field *on = t->field->on_device;
    enum rn_status status = t->field->backend->download(on, &errors, err);
    if (status != RN_OK) return status;
    rn_trainer_share_out(t, true);
    struct rn_shares shares = rn_importance_shares(&t->sampler.importance);
    return t->field->backend->train_share(on, &shares, err);
}

enum rn_status rn_trainer_run_device(struct rn_trainer *t, struct rn_error *err) {
    struct rn_device_field *on = t->field->on_device;
    struct rn_device_progress p;
    enum rn_status status = shares_are_due(t) ? share_out(t, err) : RN_OK;
    t->field->behind = t->field->moments_behind = true;
    for (int i = 0; i < QUEUED && status == RN_OK; i++) {
        struct rn_device_step step = next_step(t);
        status = t->field->backend->train_step(on, &step, err);
        t->field->steps = ++t->progress.step;
        if (rn_trainer_turn_due(t) || shares_are_due(t) ||
            rn_schedule_done(&t->field->config, &t->progress) >= 1)
            break;
    }
    if (status == RN_OK) status = t->field->backend->train_finish(on, &p, err);
    if (status != RN_OK) return status;
    take_progress(t, &p, &t->device.counted);
    t->device.counted = p;
    return p.rejected_in_a_row < MOST_REJECTED ? RN_OK : roll_back(t, err);
}

enum rn_status rn_trainer_time_device(struct rn_trainer *t,
                                      struct rn_device_stage ret_stages[RN_DEVICE_STAGES],
                                      int *ret_count, struct rn_error *err) {
    struct rn_device_step step = next_step(t);
    t->field->behind = t->field->moments_behind = true;
    t->field->steps = ++t->progress.step;
    return t->field->backend->train_timed(t->field->on_device, &step, ret_stages, ret_count, err);
}
