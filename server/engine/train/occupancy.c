// The occupancy grid in training: carving from alpha, and the decayed maximum of density.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/ball.h"
#include "common/math/rng.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/volume.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"
#include "server/engine/train/withheld.h"

#define STREAM_OCCUPANCY 0x6f63637570000000u
#define CHUNK 2048     // cells a task
#define CARVE_VIEWS 48 // views carved from, evenly spaced: more remove little

// ---- hull -----------------------------------------------------------------------------------

// Of the hull's bytes, 0 or 1, how many of eight are 1.
static size_t count_eight(const uint8_t *cells) {
    uint64_t eight;
    memcpy(&eight, cells, sizeof eight);
    return (size_t)(eight * 0x0101010101010101u >> 56);
}

enum rn_status rn_trainer_count_hull(struct rn_trainer *t, struct rn_error *err) {
    struct rn_field *field = t->field;
    size_t cells = (size_t)field->config.field.occupancy, n = cells * cells * cells;
    if (!t->hull.before) t->hull.before = malloc(n / RN_HULL_WORD * sizeof *t->hull.before);
    if (!t->hull.before) return rn_error_set(err, RN_ERROR_NO_MEMORY, "occupancy", "out of memory");
    t->hull.count = 0;
    for (size_t i = 0; i < n; i += 8) {
        if (i % RN_HULL_WORD == 0) t->hull.before[i / RN_HULL_WORD] = (uint32_t)t->hull.count;
        t->hull.count += count_eight(field->hull + i);
    }
    field->hull_cells = t->hull.count;
    return RN_OK;
}

size_t rn_hull_cell(const struct rn_trainer *t, size_t i, size_t *word) {
    size_t cells = (size_t)t->field->config.field.occupancy;
    size_t words = cells * cells * cells / RN_HULL_WORD;
    const uint32_t *before = t->hull.before;
    while (*word + 1 < words && before[*word + 1] <= i)
        ++*word;
    const uint8_t *hull = t->field->hull + *word * RN_HULL_WORD, *at = hull;
    size_t skip = i - before[*word], n;
    while ((n = count_eight(at)) <= skip) {
        skip -= n;
        at += 8;
    }
    while (!*at || skip-- > 0)
        at++;
    return (size_t)(at - t->field->hull);
}

// ---- carving --------------------------------------------------------------------------------

// One photograph as the carver sees it: how many pixels with alpha lie above and left of (x, y).
struct silhouette {
    struct rn_ball_viewer viewer;
    uint32_t *table; // (width + 1) * (height + 1)
};

static void fill_table(struct silhouette *s, const uint8_t *rgba) {
    int w = s->viewer.camera->width, h = s->viewer.camera->height;
    memset(s->table, 0, (size_t)(w + 1) * sizeof *s->table);
    for (int y = 0; y < h; y++) {
        uint32_t row = 0, *above = s->table + (size_t)y * (w + 1), *line = above + w + 1;
        line[0] = 0;
        for (int x = 0; x < w; x++) {
            row += rgba[((size_t)y * w + x) * 4 + 3] > 0;
            line[x + 1] = above[x + 1] + row;
        }
    }
}

static int clamp_int(double v, int low, int high) {
    return v < low ? low : v > high ? high : (int)v;
}

// Of the pixels that a ball projects onto, all of them inside the image: how many have alpha.
enum sight { NONE_HAVE, SOME_HAVE, ALL_HAVE };

// The ball lies around a point (dataset units). Anything in doubt is SOME_HAVE.
static enum sight look_at(const struct silhouette *s, const double centre[3], double radius) {
    const struct rn_camera *c = s->viewer.camera;
    struct rn_ball_box box;
    if (rn_ball_image(&s->viewer, centre, radius, &box) != RN_BALL_BOX) return SOME_HAVE;
    if (box.x0 < 0 || box.y0 < 0 || box.x1 > c->width || box.y1 > c->height) return SOME_HAVE;
    int x0 = clamp_int(floor(box.x0), 0, c->width), x1 = clamp_int(ceil(box.x1), 0, c->width);
    int y0 = clamp_int(floor(box.y0), 0, c->height), y1 = clamp_int(ceil(box.y1), 0, c->height);
    size_t stride = (size_t)c->width + 1;
    const uint32_t *top = s->table + (size_t)y0 * stride, *bottom = s->table + (size_t)y1 * stride;
    uint32_t count = bottom[x1] - bottom[x0] - top[x1] + top[x0];
    if (count == 0) return NONE_HAVE;
    return count == (uint32_t)(x1 - x0) * (uint32_t)(y1 - y0) ? ALL_HAVE : SOME_HAVE;
}

struct carving {
    struct rn_trainer *trainer;
    struct silhouette silhouette;
};

static void cell_centre(const struct rn_trainer *t, double x, double y, double z, double ret[3]) {
    double at[3] = {x, y, z}, cells = t->field->config.field.occupancy;
    for (int i = 0; i < 3; i++)
        ret[i] = t->field->bounds.centre[i] + t->field->bounds.radius * (2 * at[i] / cells - 1);
}

// Carves cell by cell what a brick has kept so far.
static void carve_cells(const struct carving *carving, const int first[3]) {
    struct rn_trainer *t = carving->trainer;
    int cells = t->field->config.field.occupancy;
    double radius = 1.7320508 * t->field->bounds.radius / cells, centre[3];
    for (int i = 0; i < RN_BRICK * RN_BRICK * RN_BRICK; i++) {
        int x = first[0] + i / 64, y = first[1] + i / 8 % 8, z = first[2] + i % 8;
        uint8_t *keep = &t->field->hull[rn_cell_index(x, y, z, cells)];
        if (!*keep) continue;
        cell_centre(t, x + 0.5, y + 0.5, z + 0.5, centre);
        if (look_at(&carving->silhouette, centre, radius) == NONE_HAVE) *keep = 0;
    }
}

// Row i along z of a brick: 8 cells.
static uint8_t *row_of(const struct rn_field *field, const int first[3], int i) {
    return field->hull + rn_cell_index(first[0] + i / 8, first[1] + i % 8, first[2],
                                       field->config.field.occupancy);
}

static bool keeps_any(const struct rn_field *field, const int first[3]) {
    uint64_t any = 0, row;
    for (int i = 0; i < RN_BRICK * RN_BRICK; i++) {
        memcpy(&row, row_of(field, first, i), sizeof row);
        any |= row;
    }
    return any;
}

static void carve_all(const struct rn_field *field, const int first[3]) {
    for (int i = 0; i < RN_BRICK * RN_BRICK; i++)
        memset(row_of(field, first, i), 0, RN_BRICK);
}

// Carves the bricks of one layer: as a whole where they are in front of nothing, cell by cell where
// they are not in front of matter alone.
static void carve_layer(void *context, int layer, int thread) {
    (void)thread;
    const struct carving *carving = context;
    struct rn_trainer *t = carving->trainer;
    int bricks = t->field->config.field.occupancy / RN_BRICK;
    double radius = 1.7320508 * t->field->bounds.radius / bricks, centre[3];
    for (int b = 0; b < bricks * bricks; b++) {
        int first[3] = {layer * RN_BRICK, b / bricks * RN_BRICK, b % bricks * RN_BRICK};
        if (!keeps_any(t->field, first)) continue;
        cell_centre(t, first[0] + 4, first[1] + 4, first[2] + 4, centre);
        enum sight sight = look_at(&carving->silhouette, centre, radius);
        if (sight == NONE_HAVE) carve_all(t->field, first);
        if (sight == SOME_HAVE) carve_cells(carving, first);
    }
}

void rn_trainer_carve(struct rn_trainer *t) {
    size_t largest = 0;
    for (int f = 0; f < t->train.frame_count; f++) {
        const struct rn_camera *c = &t->train.frames[f].camera;
        size_t n = (size_t)(c->width + 1) * (size_t)(c->height + 1);
        if (n > largest) largest = n;
    }
    struct carving carving = {.trainer = t};
    carving.silhouette.table = malloc(largest * sizeof(uint32_t));
    if (!carving.silhouette.table) return; // carving only saves time
    int finest = t->train.scale_count > 1 ? t->train.scale_first[1] : t->train.frame_count;
    int views = finest < CARVE_VIEWS ? finest : CARVE_VIEWS;
    for (int f = 0; f < views; f++) {
        const struct rn_pixel_frame *frame = &t->train.frames[f * finest / views];
        bool masked = t->field->config.cut_out && frame->frame->mask_path;
        if (!frame->frame->has_alpha && !masked) continue;
        if (rn_trainer_withholds(t, frame->frame)) continue;
        carving.silhouette.viewer = rn_ball_viewer_init(&frame->camera);
        fill_table(&carving.silhouette, t->train.rgba + 4 * frame->offset);
        rn_pixels_let_go(&t->train);
        rn_pool_run(t->engine->pool, t->field->config.field.occupancy / RN_BRICK, carve_layer,
                    &carving);
    }
    free(carving.silhouette.table);
    int cells = t->field->config.field.occupancy;
    for (size_t i = 0; i < (size_t)cells * cells * cells; i++)
        if (!t->field->hull[i]) t->field->occupancy[i] = 0;
}

// ---- what no camera sees --------------------------------------------------------------------

struct unseen {
    struct rn_trainer *trainer;
    double *edges; // squares of the sizes of what photographs show of the plane z = 1, at most
};

static double square_of_edge(const struct rn_camera *c) {
    struct rn_ball_viewer viewer = rn_ball_viewer_init(c);
    return viewer.terms.omega == 0 && viewer.edge > 0 ? viewer.edge * viewer.edge : INFINITY;
}

// Whether a point (dataset units) projects into a photograph; most that do not are beyond its edge,
// which is quicker to see.
static bool is_in_sight(const struct unseen *u, int f, const double point[3]) {
    const struct rn_camera *c = &u->trainer->train.frames[f].camera;
    double p[3], at[2];
    rn_camera_axes(c, point, p);
    if (isfinite(u->edges[f]) &&
        (p[2] <= 0 || p[0] * p[0] + p[1] * p[1] > u->edges[f] * p[2] * p[2]))
        return false;
    if (!rn_camera_project(c, p, at)) return false;
    return at[0] >= 0 && at[1] >= 0 && at[0] < c->width && at[1] < c->height;
}

// The point (dataset units) that is drawn to `at` (cells).
static void uncontracted_point(const struct rn_trainer *t, const double at[3], double ret[3]) {
    double y[3], size = 0, cells = t->field->config.field.occupancy;
    for (int i = 0; i < 3; i++) {
        y[i] = 2 * at[i] / cells - 1;
        size += y[i] * y[i];
    }
    size = sqrt(size);
    double r = rn_uncontracted(fmin(size, 1 - 1e-6));
    for (int i = 0; i < 3; i++)
        ret[i] =
            t->field->bounds.centre[i] + t->field->bounds.radius * (size > 0 ? y[i] / size * r : 0);
}

#define CLUMP 2 // cells a side that are looked at together

// Whether some photograph shows the middle or a corner of the clump that begins at `first`; `*last`
// is the one that showed the clump before, and likely this one.
static bool is_clump_seen(const struct unseen *u, const int first[3], int *last) {
    const struct rn_trainer *t = u->trainer;
    for (int i = 0; i < 9; i++) {
        double at[3], point[3];
        for (int k = 0; k < 3; k++)
            at[k] = first[k] + (i == 0 ? 0.5 * CLUMP : (i - 1) >> k & 1 ? CLUMP : 0);
        uncontracted_point(t, at, point);
        for (int f = 0; f < t->train.frame_count; f++) {
            int frame = (*last + f) % t->train.frame_count;
            if (!is_in_sight(u, frame, point)) continue;
            *last = frame;
            return true;
        }
    }
    return false;
}

static void carve_clump(struct rn_field *field, const int first[3]) {
    for (int i = 0; i < CLUMP * CLUMP * CLUMP; i++) {
        size_t cell = rn_cell_index(first[0] + i / CLUMP / CLUMP, first[1] + i / CLUMP % CLUMP,
                                    first[2] + i % CLUMP, field->config.field.occupancy);
        field->hull[cell] = 0;
        field->occupancy[cell] = 0;
    }
}

static void carve_unseen_layer(void *context, int layer, int thread) {
    (void)thread;
    const struct unseen *u = context;
    struct rn_field *field = u->trainer->field;
    int clumps = field->config.field.occupancy / CLUMP, last = 0;
    for (int i = 0; i < clumps * clumps; i++) {
        int first[3] = {layer * CLUMP, i / clumps * CLUMP, i % clumps * CLUMP};
        if (!is_clump_seen(u, first, &last)) carve_clump(field, first);
    }
}

void rn_trainer_carve_unseen(struct rn_trainer *t) {
    int frames = t->train.frame_count;
    struct unseen u = {.trainer = t, .edges = malloc((size_t)frames * sizeof *u.edges)};
    if (!u.edges) return; // carving only saves time
    for (int f = 0; f < frames; f++)
        u.edges[f] = square_of_edge(&t->train.frames[f].camera);
    rn_pool_run(t->engine->pool, t->field->config.field.occupancy / CLUMP, carve_unseen_layer, &u);
    free(u.edges);
}

// ---- measuring ------------------------------------------------------------------------------

struct measurement {
    struct rn_trainer *trainer;
    size_t first, stride, count; // cells hull_list[first + i * stride]
    float level, decay;
    struct rn_share share; // of the chunks, that is measured here
    bool sampled;
    float chance[2]; // where sampled, that a cell is measured: an empty one, an occupied one
};

static size_t count_occupied(const struct rn_occupancy_bits *bits) {
    size_t side = (size_t)bits->cells / RN_BRICK, words = side * side * side * 16, n = 0;
    for (size_t i = 0; i < words; i++)
        n += (size_t)__builtin_popcount(bits->words[i]);
    return n;
}

static void draw_cells(const struct rn_field *field, struct measurement *m) {
    m->first = 0;
    m->stride = 1;
    m->decay = (float)RN_OCCUPANCY_DECAY;
    m->sampled = true;
    rn_chances_of_cells(pow(field->config.field.occupancy, 3),
                        (double)count_occupied(&field->coarse), m->chance);
}

static bool is_occupied(const struct rn_occupancy_bits *bits, const int at[3]) {
    size_t word = rn_brick_word(at[0], at[1], at[2], bits->cells);
    return bits->words[word] & rn_brick_bit(at[0], at[1]);
}

// The last word before which no more than i cells are.
static size_t first_word(const struct rn_hull *hull, int cells, size_t i) {
    size_t low = 0, high = (size_t)cells * (size_t)cells * (size_t)cells / RN_HULL_WORD;
    while (high - low > 1) {
        size_t middle = (low + high) / 2;
        if (hull->before[middle] <= i)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static void measure_chunk(void *context, int index, int thread) {
    const struct measurement *m = context;
    struct rn_trainer *t = m->trainer;
    const struct rn_train_config *config = &t->field->config;
    int cells = config->field.occupancy, n = 0;
    uint32_t at[CHUNK];
    float points[CHUNK][3], density[CHUNK];
    size_t begin = (size_t)(m->share.first + index) * CHUNK;
    size_t word = first_word(&t->hull, cells, m->first + begin * m->stride);
    for (size_t i = begin; i < m->count && i < begin + CHUNK; i++) {
        uint32_t cell = at[n] = (uint32_t)rn_hull_cell(t, m->first + i * m->stride, &word);
        struct rn_rng4 draw =
            rn_rng_draw(config->seed, STREAM_OCCUPANCY + cell, (uint64_t)t->progress.step);
        int index3[3];
        rn_cell_at(cell, cells, index3);
        if (m->sampled &&
            !(rn_rng_unit(draw.v[3]) < m->chance[is_occupied(&t->field->coarse, index3)]))
            continue;
        for (int k = 0; k < 3; k++)
            points[n][k] = ((float)index3[k] + rn_rng_unit(draw.v[k])) * 2 / (float)cells - 1;
        n++;
    }
    t->engine->kernels->density(&t->field->cpu, points, n, m->level,
                                rn_engine_workspace(t->engine, thread), density);
    for (int i = 0; i < n; i++) {
        float value = density[i] * (float)(config->step * RN_DENSITY_UNIT);
        float old = t->field->occupancy[at[i]] * m->decay;
        if (!isfinite(old)) old = 0;
        t->field->occupancy[at[i]] = value > old ? value : old;
    }
}

bool rn_trainer_update_occupancy(struct rn_trainer *t) {
    if (t->hull.seen) {
        rn_trainer_update_seen(t);
        return true;
    }
    struct rn_occupancy_turn turn = rn_schedule_occupancy(&t->field->config, t->progress.step);
    struct measurement m = {
        .trainer = t, .first = turn.first, .stride = turn.stride, .decay = turn.decay};
    if (turn.sampled) draw_cells(t->field, &m);
    if (t->hull.count <= m.first) return true;
    m.count = (t->hull.count - m.first + m.stride - 1) / m.stride;
    m.level = rn_level_of_cells(&t->field->config.field);
    m.share = rn_ranks_share(t, (int)((m.count + CHUNK - 1) / CHUNK));
    if (!rn_pool_run_some(t->engine->pool, m.share.count, &t->step.next_chunk, measure_chunk, &m,
                          rn_engine_is_wanted, t->engine))
        return false;
    t->step.next_chunk = 0;
    rn_ranks_tell_cells(t, m.first, m.stride, m.count, CHUNK);
    rn_field_refresh_occupancy(t->field);
    return true;
}
