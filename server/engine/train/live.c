// Which pixels can see the hull at all: rays are drawn from these only. The others march through
// empty space, take no part in the loss, and would cost a quarter of the march.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/ball.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

#define CLUMP 2 // cells a side

// Clumps of cells that hold a cell of the hull, and of whose neighbours one does not: a ray that
// meets another one meets one of these first.
struct clumps {
    double (*centre)[3]; // dataset units
    int count;
    double radius;
};

struct clump_grid {
    uint8_t *held; // [x][y][z]
    size_t side;
};

static bool is_inner(const struct clump_grid *g, size_t x, size_t y, size_t z) {
    size_t n = g->side, at = (x * n + y) * n + z;
    if (x == 0 || y == 0 || z == 0 || x + 1 == n || y + 1 == n || z + 1 == n) return false;
    return g->held[at - 1] && g->held[at + 1] && g->held[at - n] && g->held[at + n] &&
           g->held[at - n * n] && g->held[at + n * n];
}

// Clumps that hold a cell of the hull.
static uint8_t *find_held(const struct rn_trainer *t, size_t n) {
    size_t cells = (size_t)t->field->config.field.occupancy;
    uint8_t *held = calloc(n * n * n, 1);
    for (size_t cell = 0; held && cell < cells * cells * cells; cell++) {
        if (!t->field->hull[cell]) continue;
        size_t z = cell % cells / CLUMP, y = cell / cells % cells / CLUMP;
        held[(cell / cells / cells / CLUMP * n + y) * n + z] = 1;
    }
    return held;
}

static bool is_outer(const struct clump_grid *g, size_t i) {
    size_t n = g->side;
    return g->held[i] && !is_inner(g, i / n / n, i / n % n, i % n);
}

static enum rn_status list_clumps(const struct rn_trainer *t, struct clumps *ret) {
    size_t n = (size_t)t->field->config.field.occupancy / CLUMP, count = 0;
    const struct rn_bounds *bounds = &t->field->bounds;
    struct clump_grid grid = {find_held(t, n), n};
    for (size_t i = 0; grid.held && i < n * n * n; i++)
        count += is_outer(&grid, i);
    ret->centre = malloc((count + 1) * sizeof *ret->centre);
    ret->count = 0;
    ret->radius = 1.7320508 * bounds->radius / (double)n;
    if (!grid.held || !ret->centre) {
        free(grid.held);
        return RN_ERROR_NO_MEMORY;
    }
    for (size_t i = 0; i < n * n * n; i++) {
        const size_t at[3] = {i / n / n, i / n % n, i % n};
        if (!is_outer(&grid, i)) continue;
        for (int k = 0; k < 3; k++)
            ret->centre[ret->count][k] =
                bounds->centre[k] + bounds->radius * (2 * ((double)at[k] + 0.5) / (double)n - 1);
        ret->count++;
    }
    free(grid.held);
    return RN_OK;
}

static int clamp_block(double pixel, int last) {
    double block = floor(pixel / RN_LIVE_BLOCK);
    return block < 0 ? 0 : block > last ? last : (int)block;
}

// Marks the blocks of pixels that a clump's image may reach.
static void mark_clump(const struct rn_ball_viewer *viewer, const double centre[3], double radius,
                       int columns, int rows, uint8_t *marks) {
    const struct rn_camera *c = viewer->camera;
    struct rn_ball_box box;
    enum rn_ball_image image = rn_ball_image(viewer, centre, radius, &box);
    if (image == RN_BALL_UNSEEN) return;
    if (image == RN_BALL_AROUND) {
        memset(marks, 1, (size_t)columns * (size_t)rows);
        return;
    }
    if (box.x1 < 0 || box.y1 < 0 || box.x0 > c->width || box.y0 > c->height) return;
    int x0 = clamp_block(box.x0, columns - 1), x1 = clamp_block(box.x1, columns - 1);
    for (int row = clamp_block(box.y0, rows - 1); row <= clamp_block(box.y1, rows - 1); row++)
        memset(marks + (size_t)row * (size_t)columns + x0, 1, (size_t)(x1 - x0 + 1));
}

static size_t blocks_of(const struct rn_camera *c, int *ret_columns, int *ret_rows) {
    *ret_columns = (c->width + RN_LIVE_BLOCK - 1) / RN_LIVE_BLOCK;
    *ret_rows = (c->height + RN_LIVE_BLOCK - 1) / RN_LIVE_BLOCK;
    return (size_t)*ret_columns * (size_t)*ret_rows;
}

// One byte a block of every frame: whether it is live.
struct marks {
    const struct rn_pixels *pixels;
    const struct clumps *clumps;
    uint8_t *all;
    const uint32_t *first; // of a frame's
    bool all_live;         // in unbounded space every pixel sees something
};

static void mark_frame(void *context, int index, int thread) {
    (void)thread;
    const struct marks *m = context;
    const struct rn_camera *camera = &m->pixels->frames[index].camera;
    int columns, rows;
    size_t blocks = blocks_of(camera, &columns, &rows);
    if (m->all_live) memset(m->all + m->first[index], 1, blocks);
    struct rn_ball_viewer viewer = rn_ball_viewer_init(camera);
    for (int i = 0; i < m->clumps->count; i++)
        mark_clump(&viewer, m->clumps->centre[i], m->clumps->radius, columns, rows,
                   m->all + m->first[index]);
}

// Whether masks leave any pixel of the block in.
static bool is_used(const struct rn_pixels *pixels, const struct rn_pixel_frame *frame, int left,
                    int top) {
    if (!pixels->used) return true;
    for (int y = top; y < top + RN_LIVE_BLOCK && y < frame->camera.height; y++)
        for (int x = left; x < left + RN_LIVE_BLOCK && x < frame->camera.width; x++)
            if (rn_pixel_is_used(pixels, frame, x, y)) return true;
    return false;
}

size_t rn_trainer_live_bytes(size_t blocks) {
    return blocks / 64 * (sizeof(uint64_t) + sizeof(uint32_t)) +
           blocks / RN_LIVE_STRIDE * sizeof(uint32_t);
}

// The number of the live block that `live` others are before.
static uint32_t number_of(const struct rn_sampler *s, size_t live) {
    uint32_t low = s->live_guide[live / RN_LIVE_STRIDE],
             high = s->live_guide[live / RN_LIVE_STRIDE + 1] + 1;
    while (high - low > 1) {
        uint32_t middle = low + (high - low) / 2;
        if (s->live_before[middle] <= live)
            low = middle;
        else
            high = middle;
    }
    uint64_t word = s->live[low];
    for (size_t skip = live - s->live_before[low]; skip > 0; skip--)
        word &= word - 1;
    return low * 64 + (uint32_t)__builtin_ctzll(word);
}

struct rn_live_block rn_trainer_live(const struct rn_trainer *t, size_t live) {
    const uint32_t *first = t->sampler.first, block = number_of(&t->sampler, live);
    int low = 0, high = t->train.frame_count, columns, rows;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (first[middle] <= block)
            low = middle;
        else
            high = middle;
    }
    blocks_of(&t->train.frames[low].camera, &columns, &rows);
    int within = (int)(block - first[low]);
    return (struct rn_live_block){low, within % columns * RN_LIVE_BLOCK,
                                  within / columns * RN_LIVE_BLOCK};
}

// Notes a frame's live blocks.
static void list_frame(struct rn_trainer *t, int frame, const uint8_t *marks) {
    int columns, rows;
    size_t n = blocks_of(&t->train.frames[frame].camera, &columns, &rows);
    if (rn_trainer_withholds(t, t->train.frames[frame].frame)) return;
    for (size_t i = 0; i < n; i++) {
        size_t number = t->sampler.first[frame] + i;
        if ((!marks[i] && !t->field->cpu.disparity.on) ||
            !is_used(&t->train, &t->train.frames[frame], (int)i % columns * RN_LIVE_BLOCK,
                     (int)i / columns * RN_LIVE_BLOCK))
            continue;
        t->sampler.live[number / 64] |= (uint64_t)1 << number % 64;
        t->sampler.live_count++;
    }
    rn_pixels_let_go(&t->train);
}

void rn_trainer_share_out(struct rn_trainer *t, bool weigh) {
    for (int scale = 0; scale < t->train.scale_count && t->sampler.importance.count > 0; scale++) {
        size_t first = t->sampler.live_first[scale],
               count = t->sampler.live_first[scale + 1] - first;
        if (weigh) rn_importance_weigh(&t->sampler.importance, first, count);
        rn_importance_lay_out(&t->sampler.importance, scale, first, count);
    }
}

static enum rn_status prepare_importance(struct rn_trainer *t, struct rn_error *err) {
    rn_importance_finish(&t->sampler.importance);
    if (!t->field->config.draw_by_error || t->sampler.live_count == 0) return RN_OK;
    enum rn_status status = rn_importance_init(t->sampler.live_count, t->train.scale_count,
                                               &t->sampler.importance, err);
    if (status == RN_OK) rn_trainer_share_out(t, false);
    return status;
}

// The frames of one scale after another.
static void list_frames(struct rn_trainer *t, const struct marks *marks) {
    t->sampler.live_count = 0;
    for (int scale = 0; scale < t->train.scale_count; scale++) {
        int first = t->train.scale_first[scale];
        int end = scale + 1 < t->train.scale_count ? t->train.scale_first[scale + 1]
                                                   : t->train.frame_count;
        t->sampler.live_first[scale] = t->sampler.live_count;
        for (int f = first; f < end; f++)
            list_frame(t, f, marks->all + marks->first[f]);
        t->sampler.live_first[scale + 1] = t->sampler.live_count;
    }
}

// So that they are found by how many are before them.
static void count_live(struct rn_sampler *s, size_t words) {
    uint32_t count = 0;
    size_t next = 0; // of the guide
    for (size_t word = 0; word < words; word++) {
        s->live_before[word] = count;
        count += (uint32_t)__builtin_popcountll(s->live[word]);
        for (; next * RN_LIVE_STRIDE < count; next++)
            s->live_guide[next] = (uint32_t)word;
    }
    s->live_guide[next] = (uint32_t)(words - 1);
}

static bool make_list(struct rn_sampler *s, size_t words) {
    rn_block_destroy(s->live);
    rn_block_destroy(s->live_before);
    rn_block_destroy(s->live_guide);
    s->live = rn_block_create(words * sizeof *s->live);
    s->live_before = rn_block_create(words * sizeof *s->live_before);
    s->live_guide = rn_block_create((words * 64 / RN_LIVE_STRIDE + 2) * sizeof *s->live_guide);
    s->live_count = 0;
    return s->live && s->live_before && s->live_guide;
}

size_t rn_trainer_blocks(const struct rn_camera *camera) {
    int columns, rows;
    return blocks_of(camera, &columns, &rows);
}

// Numbers all blocks of all frames, one frame after the other.
static enum rn_status number_blocks(struct rn_trainer *t, size_t *ret_total, struct rn_error *err) {
    size_t total = 0;
    free(t->sampler.first);
    t->sampler.first = malloc(((size_t)t->train.frame_count + 1) * sizeof *t->sampler.first);
    if (!t->sampler.first) return rn_error_set(err, RN_ERROR_NO_MEMORY, "pixels", "out of memory");
    for (int f = 0; f < t->train.frame_count; f++) {
        t->sampler.first[f] = (uint32_t)total;
        total += rn_trainer_blocks(&t->train.frames[f].camera);
    }
    if (total > UINT32_MAX)
        return rn_error_set(err, RN_ERROR_LIMIT, t->dataset->name,
                            "has %zu blocks of pixels and %u can be trained on; import it with a "
                            "smaller --max-size, or train with --train-scale",
                            total, UINT32_MAX);
    *ret_total = total;
    return RN_OK;
}

enum rn_status rn_trainer_list_live(struct rn_trainer *t, struct rn_error *err) {
    struct clumps clumps = {0};
    struct marks marks = {.pixels = &t->train, .clumps = &clumps};
    marks.all_live = t->field->config.field.space == RN_SPACE_UNBOUNDED;
    size_t total = 0;
    enum rn_status status = number_blocks(t, &total, err);
    if (status != RN_OK) return status;
    marks.first = t->sampler.first;
    marks.all = calloc(total + 1, 1);
    bool made = make_list(&t->sampler, total / 64 + 1);
    status = RN_ERROR_NO_MEMORY;
    if (made && marks.all) status = marks.all_live ? RN_OK : list_clumps(t, &clumps);
    if (status == RN_OK) {
        rn_pool_run(t->engine->pool, t->train.frame_count, mark_frame, &marks);
        list_frames(t, &marks);
        count_live(&t->sampler, total / 64 + 1);
    }
    free(clumps.centre);
    free(marks.all);
    if (status != RN_OK) return rn_error_set(err, status, "pixels", "out of memory");
    return prepare_importance(t, err);
}
