#include "server/engine/scene/occupancy.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/field/volume.h"

// ---- bits -----------------------------------------------------------------------------------

enum rn_status rn_occupancy_bits_create(int cells, enum rn_space space,
                                        struct rn_occupancy_bits *ret) {
    size_t side = (size_t)cells / RN_BRICK, bricks = side * side * side;
    *ret = (struct rn_occupancy_bits){.cells = cells,
                                      .space = space,
                                      .words = rn_block_create(bricks * 16 * sizeof(uint32_t)),
                                      .distance = rn_block_create(bricks + 3)};
    if (ret->words && ret->distance) return RN_OK;
    rn_occupancy_bits_destroy(ret);
    return RN_ERROR_NO_MEMORY;
}

void rn_occupancy_bits_destroy(struct rn_occupancy_bits *bits) {
    rn_block_destroy(bits->words);
    rn_block_destroy(bits->distance);
    *bits = (struct rn_occupancy_bits){0};
}

// Bits that are being built, and the first and last cell set so far.
struct building {
    struct rn_occupancy_bits *bits;
    int first[3], last[3];
};

static struct building begin(struct rn_occupancy_bits *bits) {
    size_t side = (size_t)bits->cells / RN_BRICK, bricks = side * side * side;
    int n = bits->cells;
    memset(bits->words, 0, bricks * 16 * sizeof *bits->words);
    memset(bits->distance, 255, bricks);
    return (struct building){bits, {n, n, n}, {-1, -1, -1}};
}

// Sets those of the 8 cells from (x, y, z) on, whose bits are in `set`.
static void put_row(struct building *b, int x, int y, int z, unsigned set) {
    size_t word = rn_brick_word(x, y, z, b->bits->cells);
    uint32_t bit = rn_brick_bit(x, y);
    if (!set) return;
    for (int k = 0; k < RN_BRICK; k++)
        if (set >> k & 1) b->bits->words[word + 2 * (size_t)k] |= bit;
    b->bits->distance[word / 16] = 0;
    int low[3] = {x, y, z + __builtin_ctz(set)}, high[3] = {x, y, z + 31 - __builtin_clz(set)};
    for (int i = 0; i < 3; i++) {
        if (low[i] < b->first[i]) b->first[i] = low[i];
        if (high[i] > b->last[i]) b->last[i] = high[i];
    }
}

// The least over a line's bricks of the larger of what stands there and the way to there.
static void spread_along(uint8_t *line, size_t stride, int bricks) {
    uint8_t out[512];
    for (int to = 0; to < bricks; to++) {
        int least = 255;
        for (int from = 0; from < bricks; from++) {
            int way = abs(to - from), there = line[(size_t)from * stride];
            int longer = way > there ? way : there;
            if (longer < least) least = longer;
        }
        out[to] = (uint8_t)least;
    }
    for (int to = 0; to < bricks; to++)
        line[(size_t)to * stride] = out[to];
}

// Chebyshev distance, one axis after the other.
static void spread_distance(uint8_t *distance, int bricks) {
    size_t strides[3] = {(size_t)bricks * bricks, (size_t)bricks, 1};
    for (int axis = 0; axis < 3; axis++) {
        size_t a = strides[(axis + 1) % 3], b = strides[(axis + 2) % 3];
        for (int i = 0; i < bricks; i++)
            for (int j = 0; j < bricks; j++)
                spread_along(distance + (size_t)i * a + (size_t)j * b, strides[axis], bricks);
    }
}

static void end(struct building *b) {
    struct rn_occupancy_bits *bits = b->bits;
    float cells = (float)bits->cells;
    for (int i = 0; i < 3; i++) {
        bits->low[i] = b->last[i] < 0 ? 2 : 2.0f * (float)b->first[i] / cells - 1;
        bits->high[i] = b->last[i] < 0 ? -2 : 2.0f * (float)(b->last[i] + 1) / cells - 1;
    }
    spread_distance(bits->distance, bits->cells / RN_BRICK);
}

// ---- as training measures it ----------------------------------------------------------------

// Whether any of 8 cells in a row may hold matter.
static bool any_of_8(const uint8_t *hull) {
    uint64_t all;
    memcpy(&all, hull, sizeof all);
    return all != 0;
}

// The mean over all cells; outside the hull they are zero.
static double occupancy_threshold(const struct rn_field *field) {
    size_t cells = (size_t)field->config.field.occupancy, n = cells * cells * cells;
    double sum = 0;
    for (size_t i = 0; i < n; i += RN_BRICK) {
        if (!any_of_8(field->hull + i)) continue;
        float part[RN_BRICK];
        for (int k = 0; k < RN_BRICK; k++)
            part[k] = field->hull[i + k] ? field->occupancy[i + k] : 0;
        sum += (double)(((part[0] + part[4]) + (part[1] + part[5])) +
                        ((part[2] + part[6]) + (part[3] + part[7])));
    }
    double mean = sum / (double)n, limit = field->config.occupancy_limit > 0
                                               ? field->config.occupancy_limit
                                               : RN_OCCUPANCY_LIMIT;
    return mean < limit ? mean : limit;
}

// Whether a cell lies where a place ends.
static bool is_at_end(const struct rn_field *field, int x, int y, int z, int cells) {
    return rn_is_place(&field->cpu) && rn_cell_ends(field->cpu.disparity.on, (int[3]){x, y, z},
                                                    cells, field->config.field.occupancy);
}

// Of the 8 cells from (x, y, z) on, those over the threshold.
static unsigned row_over(const struct rn_field *field, float threshold, int x, int y, int z) {
    int cells = field->config.field.occupancy;
    size_t at = rn_cell_index(x, y, z, cells);
    unsigned set = 0;
    if (!any_of_8(field->hull + at)) return 0;
    for (int k = 0; k < RN_BRICK; k++) {
        bool over = field->occupancy[at + k] > threshold;
        if (!over) over = is_at_end(field, x, y, z + k, cells);
        set |= (unsigned)(field->hull[at + k] && over) << k;
    }
    return set;
}

float rn_level_of_cells(const struct rn_field_config *config) {
    float level = log2f((float)config->base / (float)config->occupancy);
    return level > 0 ? level : 0;
}

void rn_field_refresh_occupancy(struct rn_field *field) {
    int cells = field->config.field.occupancy;
    bool by_sight = rn_is_place(&field->cpu);
    float threshold = by_sight ? RN_SEEN_LIMIT : (float)occupancy_threshold(field);
    struct building b = begin(&field->coarse);
    for (int x = 0; x < cells; x++)
        for (int y = 0; y < cells; y++)
            for (int z = 0; z < cells; z += RN_BRICK)
                put_row(&b, x, y, z, row_over(field, threshold, x, y, z));
    end(&b);
    rn_occupancy_bits_destroy(&field->fine);
    rn_occupancy_bits_destroy(&field->firm);
    field->cpu.occupancy = field->coarse;
}

// ---- finer, of a field at rest --------------------------------------------------------------

#define FINEST 256     // cells a side
#define CHUNK 2048     // cells a task
#define POINTS 8       // of a cell, 2 x 2 x 2
#define SPARSE 0.125   // of all cells, that are occupied at most
#define EARLY_LEVELS 3 // more of the pyramid that finer cells do for where rays end early

enum matter { NONE, HAZE, FIRM };

// Cells of the finer grid that are not known to be firm yet, and of a turn: what is there.
struct search {
    const struct rn_field *field;
    struct rn_engine *engine;
    int cells, turn;
    float level; // of the pyramid, in this turn
    size_t count;
    uint32_t *cell;
    uint8_t *found;
};

static void look(void *context, int index, int thread) {
    const struct search *s = context;
    const struct rn_field *field = s->field;
    size_t from = (size_t)index * CHUNK;
    int n = s->count - from < CHUNK ? (int)(s->count - from) : CHUNK;
    float points[CHUNK][3], density[CHUNK], width = 2 / (float)s->cells;
    float quarter[3] = {s->turn & 1 ? 0.75f : 0.25f, s->turn & 2 ? 0.75f : 0.25f,
                        s->turn & 4 ? 0.75f : 0.25f};
    for (int i = 0; i < n; i++) {
        int at[3];
        rn_cell_at(s->cell[from + (size_t)i], s->cells, at);
        for (int k = 0; k < 3; k++)
            points[i][k] = ((float)at[k] + quarter[k]) * width - 1;
    }
    s->engine->kernels->density(&field->cpu, points, n, s->level,
                                rn_engine_workspace(s->engine, thread), density);
    for (int i = 0; i < n; i++) {
        float depth = density[i] * width * (float)RN_DENSITY_UNIT;
        int at[3];
        rn_cell_at(s->cell[from + (size_t)i], s->cells, at);
        bool firm = depth > RN_OCCUPANCY_FIRM || is_at_end(field, at[0], at[1], at[2], s->cells);
        s->found[from + (size_t)i] = firm ? FIRM : depth > RN_OCCUPANCY_SEEN ? HAZE : NONE;
    }
}

static bool bit_of(const struct rn_occupancy_bits *bits, int x, int y, int z) {
    return bits->words[rn_brick_word(x, y, z, bits->cells)] & rn_brick_bit(x, y);
}

// Lists the finer cells of all occupied ones; returns their count, or counts only where there is no
// list.
static size_t list_cells(const struct rn_occupancy_bits *coarse, uint32_t *ret_cell) {
    int cells = coarse->cells;
    size_t count = 0;
    for (int x = 0; x < cells; x++)
        for (int y = 0; y < cells; y++)
            for (int z = 0; z < cells; z++) {
                if (!bit_of(coarse, x, y, z)) continue;
                for (int k = 0; k < 8 && ret_cell; k++)
                    ret_cell[count + (size_t)k] = (uint32_t)rn_cell_index(
                        2 * x + (k >> 2), 2 * y + (k >> 1 & 1), 2 * z + (k & 1), 2 * cells);
                count += 8;
            }
    return count;
}

static void put_cell(struct building *b, const int at[3]) {
    put_row(b, at[0], at[1], at[2] & ~(RN_BRICK - 1), 1u << at[2] % RN_BRICK);
}

// Looks at one point of every cell that is left; firm ones leave the list.
static void take_turn(struct search *s, struct building *all, struct building *firm) {
    size_t left = 0;
    rn_pool_run(s->engine->pool, (int)((s->count + CHUNK - 1) / CHUNK), look, s);
    for (size_t i = 0; i < s->count; i++) {
        int at[3];
        rn_cell_at(s->cell[i], s->cells, at);
        if (s->found[i] != NONE) put_cell(all, at);
        if (s->found[i] == FIRM)
            put_cell(firm, at);
        else
            s->cell[left++] = s->cell[i];
    }
    s->count = left;
}

static bool create_both(struct rn_field *field, int cells) {
    enum rn_space space = field->config.field.space;
    if (rn_occupancy_bits_create(cells, space, &field->fine) != RN_OK) return false;
    if (rn_occupancy_bits_create(cells, space, &field->firm) == RN_OK) return true;
    rn_occupancy_bits_destroy(&field->fine);
    return false;
}

void rn_field_refine_occupancy(struct rn_field *field, struct rn_engine *engine) {
    struct rn_error unused;
    int cells = 2 * field->config.field.occupancy;
    struct search s = {.field = field, .engine = engine, .cells = cells};
    // Cameras like the training's look up the base maps alone where there is no pyramid.
    bool pyramid = field->effects[RN_EFFECT_SCALE_PYRAMID].on;
    float level = pyramid ? rn_level_of_cells(&field->config.field) : 0;
    rn_occupancy_bits_destroy(&field->fine);
    rn_occupancy_bits_destroy(&field->firm);
    field->cpu.occupancy = field->coarse;
    if (!field->config.refine_at_rest || cells > FINEST) return;
    s.count = list_cells(&field->coarse, NULL);
    if (s.count == 0 || (double)s.count > SPARSE * cells * cells * cells) return;
    s.cell = malloc(s.count * sizeof *s.cell);
    s.found = malloc(s.count);
    field->fine_levels = (int)ceilf(level) + 1;
    if (s.cell && s.found &&
        rn_field_make_ready(field, engine, field->fine_levels, &unused) == RN_OK &&
        create_both(field, cells)) {
        struct building all = begin(&field->fine), firm = begin(&field->firm);
        list_cells(&field->coarse, s.cell);
        for (s.turn = 0; s.turn < POINTS; s.turn++) {
            s.level = __builtin_parity((unsigned)s.turn) ? level : 0;
            take_turn(&s, &all, &firm);
        }
        end(&all);
        end(&firm);
    }
    free(s.cell);
    free(s.found);
}

void rn_field_choose_cells(struct rn_field *field, int levels, double stop) {
    bool early = stop >= (double)RN_OCCUPANCY_FIRM;
    int above = levels - field->fine_levels;
    bool fine = field->fine.words && above <= (early ? EARLY_LEVELS : 0);
    bool firm = early && above <= 1;
    field->cpu.occupancy = !fine ? field->coarse : firm ? field->firm : field->fine;
}

// ---- of a box -------------------------------------------------------------------------------

static bool is_kept(const struct rn_field *field, const struct rn_box *box, int cells, int x, int y,
                    int z) {
    double q[3] = {(2.0 * x + 1) / cells - 1, (2.0 * y + 1) / cells - 1, (2.0 * z + 1) / cells - 1};
    double p[3];
    rn_field_place_of(field, q, p);
    for (int i = 0; i < 3; i++)
        if (!(p[i] >= box->low[i] && p[i] <= box->high[i])) return false;
    return true;
}

// A brick's rows of 8 cells along z.
static void crop_brick(const struct rn_field *field, const struct rn_box *box, struct building *b,
                       int x0, int y0, int z0) {
    const struct rn_occupancy_bits *from = &field->cpu.occupancy;
    for (int x = x0; x < x0 + RN_BRICK; x++)
        for (int y = y0; y < y0 + RN_BRICK; y++) {
            unsigned set = 0;
            for (int k = 0; k < RN_BRICK; k++)
                if (bit_of(from, x, y, z0 + k) && is_kept(field, box, from->cells, x, y, z0 + k))
                    set |= 1u << k;
            put_row(b, x, y, z0, set);
        }
}

enum rn_status rn_occupancy_bits_crop(const struct rn_field *field, const struct rn_box *box,
                                      struct rn_occupancy_bits *ret_bits) {
    const struct rn_occupancy_bits *from = &field->cpu.occupancy;
    int n = from->cells, bricks = n / RN_BRICK;
    if (rn_occupancy_bits_create(n, from->space, ret_bits) != RN_OK) return RN_ERROR_NO_MEMORY;
    struct building b = begin(ret_bits);
    for (int i = 0; i < bricks * bricks * bricks; i++)
        if (from->distance[i] == 0)
            crop_brick(field, box, &b, i / bricks / bricks * RN_BRICK,
                       i / bricks % bricks * RN_BRICK, i % bricks * RN_BRICK);
    end(&b);
    return RN_OK;
}
