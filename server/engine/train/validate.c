// Held-out evaluation, cut into blocks like training.
#include <math.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/engine/render/cones.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"

#define WIDE 16384 // weights of the density network

struct validate_block {
    struct rn_trainer *trainer;
    const struct rn_pixel_frame *frame;
    struct rn_validate_grid grid;
    size_t first, count; // of the grid
    struct rn_march_options march;
    int cones; // a side of a pixel
    int piece; // pixels between two looks at whether another thread waits
};

// As many pixels as a picture can wait for, in the fog of the first steps too, which is up to 400
// samples a pixel: of networks as wide as the paper's few.
static int pixels_of_piece(const struct rn_field *field) {
    return field->cpu.base_shape.count > WIDE ? RN_VALIDATE_LEAST : RN_PACKET_RAYS;
}

static void validate_piece(void *context, int index, int thread) {
    struct validate_block *b = context;
    struct rn_trainer *t = b->trainer;
    struct rn_spot spots[RN_PACKET_RAYS] = {{0, 0}};
    struct rn_pixel pixels[RN_PACKET_RAYS];
    struct rn_cones cones = {t->engine, t->field, &b->march, &b->frame->camera, NULL, b->cones};
    size_t first = b->first + (size_t)index * (size_t)b->piece;
    int n = 0;
    for (; n < b->piece && first + (size_t)n < b->first + b->count; n++)
        spots[n] = rn_validate_spot(&b->grid, first + (size_t)n);
    rn_cones_render(&cones, spots, n, thread, pixels, NULL);
    struct rn_validated sum = {0};
    for (int i = 0; i < n; i++) {
        if (!rn_pixel_is_used(&t->held, b->frame, spots[i].x, spots[i].y)) continue;
        rn_pixel_add_error(&t->held, b->frame, spots[i].x, spots[i].y, t->field->config.background,
                           pixels[i].rgb, &sum.squares);
        sum.pixels++;
    }
    t->validation.pieces[index] = sum;
}

// The frame under way is done: its PSNR.
static void finish_frame(struct rn_trainer *t) {
    struct rn_validation *v = &t->validation;
    double pixels = v->sum.pixels ? (double)v->sum.pixels : 1;
    v->psnr_sum += -10 * log10(fmax(v->sum.squares / (3 * pixels), 1e-10));
    v->sum = (struct rn_validated){0};
    v->pixel = 0;
    v->frame++;
    rn_pixels_let_go(&t->held);
}

// Rows of a frame that is too large for one call.
static enum rn_status validate_part(struct rn_trainer *t, struct rn_error *err) {
    struct rn_validation *v = &t->validation;
    const struct rn_pixel_frame *frame = &t->held.frames[v->frame];
    int width = frame->camera.width, height = frame->camera.height;
    int row = (int)(v->pixel / (size_t)width), rows = height - row < 64 ? height - row : 64;
    enum rn_status status =
        rn_trainer_validate_rows(t, v->frame, 1, row, rows, &v->sum.squares, err);
    v->pixel += (size_t)rows * (size_t)width;
    if (row + rows < height) return status;
    v->sum.pixels = rn_pixels_used(&t->held, frame);
    finish_frame(t);
    return status;
}

// Small frames do not fill a device: as many as do in one call.
static enum rn_status validate_on_device(struct rn_trainer *t, struct rn_error *err) {
    struct rn_validation *v = &t->validation;
    int first = v->frame, count = rn_trainer_validate_together(t, first);
    double squares[RN_DEVICE_CAMERAS] = {0};
    if (count == 0) return validate_part(t, err);
    int height = t->held.frames[first].camera.height;
    enum rn_status status = rn_trainer_validate_rows(t, first, count, 0, height, squares, err);
    for (int i = 0; i < count && status == RN_OK; i++) {
        v->sum.squares = squares[i];
        v->sum.pixels = rn_pixels_used(&t->held, &t->held.frames[first + i]);
        finish_frame(t);
    }
    return status;
}

// One block, or what is left of one that was cut short.
static void validate_next(struct rn_trainer *t) {
    struct rn_validation *v = &t->validation;
    struct validate_block b = {.trainer = t, .frame = &t->held.frames[v->frame], .first = v->pixel};
    bool last = t->progress.done || rn_trainer_figure(t) == RN_FIGURE_LAST;
    b.grid = rn_validate_grid(b.frame->camera.width, b.frame->camera.height,
                              rn_validate_most(last, t->held.frame_count));
    size_t pixels = (size_t)b.grid.width * (size_t)b.grid.height;
    b.count = pixels - v->pixel < RN_VALIDATE_BLOCK ? pixels - v->pixel : RN_VALIDATE_BLOCK;
    b.march = rn_effects_march_pictures(t->field);
    b.march.straight = rn_field_averages_straight(t->field, b.frame->frame);
    b.cones = rn_cones_for_camera(t->field, &b.frame->camera);
    b.piece = pixels_of_piece(t->field);
    int pieces = (int)((b.count + (size_t)b.piece - 1) / (size_t)b.piece);
    if (!rn_pool_run_some(t->engine->pool, pieces, &v->next_piece, validate_piece, &b,
                          rn_engine_is_wanted, t->engine))
        return;
    v->next_piece = 0;
    for (int i = 0; i < pieces; i++) {
        v->sum.squares += v->pieces[i].squares;
        v->sum.pixels += v->pieces[i].pixels;
    }
    v->pixel += b.count;
    if (v->pixel == pixels) finish_frame(t);
}

enum rn_status rn_trainer_validate(struct rn_trainer *t, double budget_ms, bool *ret_done,
                                   struct rn_error *err) {
    int64_t begin = rn_clock_ns(), until = begin + (int64_t)(budget_ms * 1e6);
    struct rn_validation *v = &t->validation;
    *ret_done = rn_trainer_figure(t) == RN_FIGURE_NONE;
    if (*ret_done) return RN_OK;
    enum rn_status status = t->field->on_device ? RN_OK : rn_trainer_agree(t, err);
    if (status == RN_OK && !t->field->on_device) status = rn_trainer_enter(t, err);
    if (status != RN_OK) return status;
    if (!v->active) *v = (struct rn_validation){.active = true};
    do {
        if (t->field->on_device)
            status = validate_on_device(t, err);
        else
            validate_next(t);
    } while (status == RN_OK && v->frame < t->held.frame_count && rn_clock_ns() < until &&
             !rn_engine_is_wanted(t->engine));
    if (status != RN_OK) return status;
    if (v->frame == t->held.frame_count) {
        t->field->psnr = t->progress.psnr = v->psnr_sum / t->held.frame_count;
        t->progress.psnr_step = t->progress.step;
        rn_schedule_note_figure(&t->field->config, &t->progress);
        v->active = false;
        *ret_done = true;
    }
    t->progress.evaluate_seconds += (double)(rn_clock_ns() - begin) * 1e-9;
    return RN_OK;
}
