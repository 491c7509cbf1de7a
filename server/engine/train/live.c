// Which pixels can see the hull at all: rays are drawn from these only. The others march through
// empty space, take no part in the loss, and would cost a quarter of the march.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/train/trainer.h"

struct bricks {
    double (*centre)[3]; // dataset units, of the bricks that hold a hull cell
    int count;
    double radius;
};

static enum rn_status list_bricks(const struct rn_trainer *t, struct bricks *ret) {
    int cells = t->field->config.field.occupancy, n = cells / RN_BRICK;
    const struct rn_bounds *bounds = &t->field->bounds;
    uint8_t *held = calloc((size_t)n * n * n, 1);
    ret->centre = malloc((size_t)n * n * n * sizeof *ret->centre);
    ret->count = 0;
    ret->radius = 1.7320508 * bounds->radius / n;
    if (!held || !ret->centre) {
        free(held);
        return RN_ERROR_NO_MEMORY;
    }
    for (size_t i = 0; i < t->hull_count; i++) {
        uint32_t cell = t->hull_list[i], c = (uint32_t)cells;
        uint32_t z = cell % c / RN_BRICK, y = cell / c % c / RN_BRICK, x = cell / c / c / RN_BRICK;
        size_t brick = ((size_t)x * (size_t)n + y) * (size_t)n + z;
        if (held[brick]) continue;
        held[brick] = 1;
        const uint32_t at[3] = {x, y, z};
        for (int k = 0; k < 3; k++)
            ret->centre[ret->count][k] =
                bounds->centre[k] + bounds->radius * (2 * (at[k] + 0.5) / n - 1);
        ret->count++;
    }
    free(held);
    return RN_OK;
}

static int clamp_block(double pixel, int last) {
    double block = floor(pixel / RN_LIVE_BLOCK);
    return block < 0 ? 0 : block > last ? last : (int)block;
}

// Marks the blocks of pixels that a brick's image may reach.
static void mark_brick(const struct rn_camera *c, const double centre[3], double radius,
                       int columns, int rows, uint8_t *marks) {
    double p[3];
    for (int i = 0; i < 3; i++) {
        p[i] = 0;
        for (int j = 0; j < 3; j++)
            p[i] += c->world_from_camera[j][i] * (centre[j] - c->world_from_camera[j][3]);
    }
    if (p[2] + radius <= 0) return;
    double nearest = p[2] - radius;
    if (nearest <= radius) { // around the camera: everywhere
        memset(marks, 1, (size_t)columns * (size_t)rows);
        return;
    }
    double x = p[0] / p[2] * c->fx + c->cx, y = p[1] / p[2] * c->fy + c->cy;
    double slope = sqrt(1 + (p[0] * p[0] + p[1] * p[1]) / (p[2] * p[2]));
    double rx = c->fx * radius * slope / nearest + 1, ry = c->fy * radius * slope / nearest + 1;
    if (x + rx < 0 || y + ry < 0 || x - rx > c->width || y - ry > c->height) return;
    int x0 = clamp_block(x - rx, columns - 1), x1 = clamp_block(x + rx, columns - 1);
    for (int row = clamp_block(y - ry, rows - 1); row <= clamp_block(y + ry, rows - 1); row++)
        memset(marks + (size_t)row * (size_t)columns + x0, 1, (size_t)(x1 - x0 + 1));
}

static size_t blocks_of(const struct rn_camera *c, int *ret_columns, int *ret_rows) {
    *ret_columns = (c->width + RN_LIVE_BLOCK - 1) / RN_LIVE_BLOCK;
    *ret_rows = (c->height + RN_LIVE_BLOCK - 1) / RN_LIVE_BLOCK;
    return (size_t)*ret_columns * (size_t)*ret_rows;
}

// Appends a frame's live blocks to the list.
static void list_frame(struct rn_trainer *t, int frame, const struct bricks *bricks,
                       uint8_t *marks) {
    const struct rn_camera *camera = &t->train.frames[frame].frame->camera;
    int columns, rows;
    size_t n = blocks_of(camera, &columns, &rows);
    memset(marks, 0, n);
    for (int b = 0; b < bricks->count; b++)
        mark_brick(camera, bricks->centre[b], bricks->radius, columns, rows, marks);
    for (size_t i = 0; i < n; i++)
        if (marks[i])
            t->live[t->live_count++] =
                (struct rn_live_block){.frame = (uint32_t)frame,
                                       .x = (uint16_t)(i % (size_t)columns * RN_LIVE_BLOCK),
                                       .y = (uint16_t)(i / (size_t)columns * RN_LIVE_BLOCK)};
}

void rn_trainer_share_out(struct rn_trainer *t, bool weigh) {
    for (int scale = 0; scale < t->train.scale_count && t->importance.count > 0; scale++) {
        size_t first = t->live_first[scale], count = t->live_first[scale + 1] - first;
        if (weigh) rn_importance_weigh(&t->importance, first, count);
        rn_importance_lay_out(&t->importance, first, count);
    }
}

static enum rn_status prepare_importance(struct rn_trainer *t, struct rn_error *err) {
    rn_importance_finish(&t->importance);
    if (!t->field->config.draw_by_error || t->live_count == 0) return RN_OK;
    enum rn_status status = rn_importance_init(t->live_count, &t->importance, err);
    if (status == RN_OK) rn_trainer_share_out(t, false);
    return status;
}

enum rn_status rn_trainer_list_live(struct rn_trainer *t, struct rn_error *err) {
    struct bricks bricks = {0};
    size_t total = 0, largest = 0;
    int columns, rows;
    for (int f = 0; f < t->train.frame_count; f++) {
        size_t n = blocks_of(&t->train.frames[f].frame->camera, &columns, &rows);
        total += n;
        if (n > largest) largest = n;
    }
    rn_block_destroy(t->live);
    t->live = rn_block_create((total + 1) * sizeof *t->live);
    t->live_count = 0;
    uint8_t *marks = malloc(largest + 1);
    enum rn_status status = RN_ERROR_NO_MEMORY;
    if (t->live && marks) status = list_bricks(t, &bricks);
    for (int scale = 0; status == RN_OK && scale < t->train.scale_count; scale++) {
        int first = t->train.scale_first[scale];
        int end = scale + 1 < t->train.scale_count ? t->train.scale_first[scale + 1]
                                                   : t->train.frame_count;
        t->live_first[scale] = t->live_count;
        for (int f = first; f < end; f++)
            list_frame(t, f, &bricks, marks);
        t->live_first[scale + 1] = t->live_count;
    }
    free(bricks.centre);
    free(marks);
    if (status != RN_OK) return rn_error_set(err, status, "pixels", "out of memory");
    return prepare_importance(t, err);
}
