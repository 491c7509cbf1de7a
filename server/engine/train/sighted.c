// What sparse points say of a place before training: a photograph that saw a point saw through all
// that lies between, and what photographs beside each other both saw, a camera between them would
// see too. Cells that several such lines cross, cells that lie about cameras and the ways between
// them, far nearer than anything these saw, and near none of which a point lies, begin empty, and
// so do those that several photographs see through between their points (train/sheets.h): rays skip
// them from the first step on, and no haze settles there. Bare walls and floors look the same from
// wherever it hangs, and it hides things from places between the cameras. Of a disparity box only
// the cells about the ways do: more gained nothing there (tests/bench/captures.md).
#include <math.h>
#include <stdlib.h>

#include "common/math/nearest.h"
#include "common/math/numbers.h"
#include "common/math/vector.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/train/sheets.h"
#include "server/engine/train/trainer.h"

#define CROSSED 3  // lines that make a cell empty: one may be of a wrong match
#define NEAR 1     // cells to each side of a point that are left alone,
#define SHORT 2.0  // and before it at the end of its lines
#define KEPT 255   // stands for them where lines are counted
#define PLACES 128 // that are looked at along a line
#define MOST 50000 // sightings that are followed, of points evenly among all
#define SLICES 64  // of these, that threads follow

#define NEIGHBOURS 4 // photographs of the same point that are nearest to one,
#define WIDE 1.0     // but no farther from it than this times the point is
#define BETWEEN 5    // places on the way there, from which the point would be seen

#define FELLOWS 8    // cameras nearest to one, to which the way is free,
#define CLEAR 0.7    // and all about it that is no farther than this times what they saw nearest:
#define NEAREST 0.05 // such a share of a photograph's points is nearer: wrong matches
#define ENOUGH 20    // points without which a photograph says nothing of that

#define SHEETS 96   // photographs, evenly among all, that are asked what they see through:
#define THROUGH 3   // of them make a cell empty,
#define OVERRULED 5 // one beside a point, which is then a wrong match

struct lines {
    struct rn_trainer *trainer;
    int cells;
    uint8_t *crossed;                 // by how many lines, of each cell, or KEPT
    const struct rn_camera **cameras; // of the photographs that are trained on; NULL for others
    size_t photos;
    struct view *views; // point by point
    size_t count;
};

static size_t cell_of(const struct lines *lines, const double at[3]) {
    int cell[3];
    for (int i = 0; i < 3; i++)
        cell[i] = rn_cell_of((rn_real)at[i], lines->cells);
    return rn_cell_index(cell[0], cell[1], cell[2], lines->cells);
}

// Of a cell, in dataset units; false where the field has none.
static bool middle_of(const struct lines *lines, size_t index, double ret[3]) {
    const struct rn_field *field = lines->trainer->field;
    int cell[3];
    double middle[3];
    rn_cell_at(index, lines->cells, cell);
    for (int k = 0; k < 3; k++)
        middle[k] = (2 * cell[k] + 1.0) / lines->cells - 1;
    if (!field->cpu.disparity.on && !(rn_dot(middle, middle) < 1)) return false;
    rn_field_place_of(field, middle, ret);
    return true;
}

static void keep_around(const struct lines *lines, const double at[3]) {
    int side = 2 * NEAR + 1;
    for (int i = 0; i < side * side * side; i++) {
        const int step[3] = {i / side / side - NEAR, i / side % side - NEAR, i % side - NEAR};
        double there[3];
        for (int k = 0; k < 3; k++)
            there[k] = at[k] + 2.0 * step[k] / lines->cells;
        lines->crossed[cell_of(lines, there)] = KEPT;
    }
}

// Counts to CROSSED, and perhaps a line of each other thread's more.
static void cross(uint8_t *crossed) {
    if (__atomic_load_n(crossed, __ATOMIC_RELAXED) < CROSSED)
        __atomic_fetch_add(crossed, 1, __ATOMIC_RELAXED);
}

static void follow(const struct lines *lines, const double camera[3], const double point[3]) {
    double end[3], reach = 2.0 * SHORT / lines->cells;
    size_t last = SIZE_MAX;
    rn_field_cube_of(lines->trainer->field, point, end);
    for (int place = 0; place < PLACES; place++) {
        double there[3], at[3];
        for (int i = 0; i < 3; i++)
            there[i] = camera[i] + (point[i] - camera[i]) * place / PLACES;
        rn_field_cube_of(lines->trainer->field, there, at);
        size_t cell = cell_of(lines, at);
        if (rn_square_apart(at, end) < reach * reach) return;
        if (cell != last) cross(&lines->crossed[cell]);
        last = cell;
    }
}

// Without memory: NULL.
static void list_cameras(struct lines *lines) {
    const struct rn_pixels *train = &lines->trainer->train;
    for (int f = 0; f < train->frame_count; f++)
        if ((size_t)train->frames[f].frame->photo >= lines->photos)
            lines->photos = (size_t)train->frames[f].frame->photo + 1;
    lines->cameras = calloc(lines->photos + 1, sizeof *lines->cameras);
    for (int f = 0; lines->cameras && f < train->frame_count; f++)
        lines->cameras[train->frames[f].frame->photo] = &train->frames[f].camera;
}

// That the photograph of a camera saw a point.
struct view {
    uint32_t point, photo;
    double camera[3];
};

static int compare_views(const void *a, const void *b) {
    const struct view *x = a, *y = b;
    if (x->point != y->point) return x->point < y->point ? -1 : 1;
    return (x->photo > y->photo) - (x->photo < y->photo);
}

// Of every so-manyth point all views by photographs that are trained on. Without memory: NULL.
static void list_views(struct lines *lines) {
    const struct rn_points *points = &lines->trainer->dataset->points;
    size_t stride = points->sighting_count / MOST + 1;
    struct view *views = lines->views = malloc(points->sighting_count * sizeof *views);
    for (size_t i = 0; views && i < points->sighting_count; i++) {
        const struct rn_sighting *seen = &points->sightings[i];
        if (seen->photo >= lines->photos || !lines->cameras[seen->photo]) continue;
        if (seen->point % stride) continue;
        struct view view = {.point = seen->point, .photo = seen->photo};
        rn_camera_place(lines->cameras[seen->photo], view.camera);
        views[lines->count++] = view;
    }
    if (views) qsort(views, lines->count, sizeof *views, compare_views);
}

// From places on the way from each camera to the NEIGHBOURS nearest that saw the same point. Not of
// a point that few photographs saw: it may be a wrong match.
static void follow_between(const struct lines *lines, const struct view *views, size_t count,
                           const double point[3]) {
    for (size_t i = 0; i < count && count >= CROSSED; i++) {
        double most = WIDE * WIDE * rn_square_apart(views[i].camera, point);
        struct rn_nearest nearest = {.most = NEIGHBOURS};
        for (size_t k = 0; k < count; k++) {
            double square = rn_square_apart(views[k].camera, views[i].camera);
            if (square > 0 && square <= most) rn_nearest_offer(&nearest, square, k);
        }
        for (int n = 0; n < nearest.count * BETWEEN; n++) {
            const double *other = views[nearest.which[n / BETWEEN]].camera;
            double there[3], share = (n % BETWEEN + 1.0) / (BETWEEN + 1);
            for (int k = 0; k < 3; k++)
                there[k] = views[i].camera[k] + share * (other[k] - views[i].camera[k]);
            follow(lines, there, point);
        }
    }
}

static size_t slice_begin(const struct lines *lines, int slice) {
    size_t i = lines->count * (size_t)slice / SLICES;
    while (i > 0 && i < lines->count && lines->views[i].point == lines->views[i - 1].point)
        i++;
    return i;
}

// Of a slice of the points.
static void follow_slice(void *context, int slice, int thread) {
    (void)thread;
    const struct lines *lines = context;
    const struct view *views = lines->views;
    size_t stop = slice_begin(lines, slice + 1);
    for (size_t first = slice_begin(lines, slice), end; first < stop; first = end) {
        const double *point = lines->trainer->dataset->points.items[views[first].point].position;
        for (end = first; end < stop && views[end].point == views[first].point; end++)
            follow(lines, views[end].camera, point);
        follow_between(lines, views + first, end - first, point);
    }
}

// ---- where cameras stand --------------------------------------------------------------------

struct way {
    double along[3]; // from the camera to a fellow; dataset units
    double clear;    // about it
};

// A camera whose photograph is trained on and saw enough, and the ways from it.
struct stand {
    double place[3], nearest; // of what it saw
    double reach;             // beyond which no way's surroundings lie
    int way_count;
    struct way ways[1 + FELLOWS]; // that to itself first
};

struct stands {
    const struct lines *lines;
    struct stand *items;
    size_t count;
};

// Of a photograph: its camera and how far from it the nearest of its points are, NAN where too
// little is known. `distances` has room for one of each view.
static struct stand stand_of(const struct lines *lines, uint32_t photo, double *distances) {
    const struct rn_point *points = lines->trainer->dataset->points.items;
    struct stand stand = {.nearest = NAN};
    size_t seen = 0;
    rn_camera_place(lines->cameras[photo], stand.place);
    for (const struct view *view = lines->views; view < lines->views + lines->count; view++)
        if (view->photo == photo)
            distances[seen++] = rn_square_apart(stand.place, points[view->point].position);
    if (seen >= ENOUGH) stand.nearest = sqrt(rn_numbers_quantile(distances, seen, NEAREST));
    return stand;
}

// The ways to itself and to the FELLOWS nearest others that are no farther than what it saw
// nearest.
static void find_ways(const struct stands *stands, struct stand *from) {
    struct rn_nearest nearest = {.most = 1 + FELLOWS};
    for (size_t i = 0; i < stands->count; i++) {
        double square = rn_square_apart(from->place, stands->items[i].place);
        if (square <= from->nearest * from->nearest) rn_nearest_offer(&nearest, square, i);
    }
    from->way_count = nearest.count;
    for (int i = 0; i < nearest.count; i++) {
        const struct stand *to = &stands->items[nearest.which[i]];
        from->ways[i].clear = CLEAR * fmin(from->nearest, to->nearest);
        from->reach = fmax(from->reach, sqrt(nearest.apart[i]) + from->ways[i].clear);
        for (int k = 0; k < 3; k++)
            from->ways[i].along[k] = to->place[k] - from->place[k];
    }
}

// All photographs' of which enough is known; items malloc'd, NULL without memory.
static struct stands list_stands(const struct lines *lines) {
    double *distances = malloc((lines->count + 1) * sizeof *distances);
    struct stands stands = {.lines = lines,
                            .items = calloc(lines->photos + 1, sizeof *stands.items)};
    for (size_t i = 0; distances && stands.items && i < lines->photos; i++) {
        if (!lines->cameras[i]) continue;
        struct stand stand = stand_of(lines, (uint32_t)i, distances);
        if (stand.nearest > 0) stands.items[stands.count++] = stand;
    }
    for (size_t i = 0; i < stands.count; i++)
        find_ways(&stands, &stands.items[i]);
    free(distances);
    return stands;
}

static bool lies_by(const struct stand *stand, const double point[3]) {
    double to[3];
    for (int k = 0; k < 3; k++)
        to[k] = point[k] - stand->place[k];
    if (rn_dot(to, to) > stand->reach * stand->reach) return false;
    for (int i = 0; i < stand->way_count; i++) {
        const struct way *way = &stand->ways[i];
        double dot = rn_dot(way->along, to), passed[3];
        double share = dot > 0 ? fmin(dot / rn_dot(way->along, way->along), 1) : 0;
        for (int k = 0; k < 3; k++)
            passed[k] = share * way->along[k];
        if (rn_square_apart(to, passed) <= way->clear * way->clear) return true;
    }
    return false;
}

// Of a layer of cells, those whose middles lie by a way.
static void clear_layer(void *context, int layer, int thread) {
    (void)thread;
    const struct stands *stands = context;
    size_t side = (size_t)stands->lines->cells, first = (size_t)layer * side * side;
    for (size_t i = first; i < first + side * side; i++) {
        double at[3];
        if (stands->lines->crossed[i] == KEPT || !middle_of(stands->lines, i, at)) continue;
        for (size_t s = 0; s < stands->count; s++)
            if (lies_by(&stands->items[s], at)) {
                stands->lines->crossed[i] = CROSSED;
                break;
            }
    }
}

// ---- what photographs see through between their points ---------------------------------------

struct sheets {
    const struct lines *lines;
    struct rn_sheet *items;
    size_t count, stride; // of the photographs
};

static void make_sheet(void *context, int index, int thread) {
    (void)thread;
    const struct sheets *sheets = context;
    const struct lines *lines = sheets->lines;
    const struct rn_pixels *pixels = &lines->trainer->train;
    const struct rn_pixel_frame *frame = &pixels->frames[(size_t)index * sheets->stride];
    const struct rn_point *points = lines->trainer->dataset->points.items;
    struct rn_sheet_point *placed = malloc((lines->count + 1) * sizeof *placed);
    size_t count = 0;
    for (size_t i = 0; placed && i < lines->count; i++)
        if (lines->views[i].photo == (uint32_t)frame->frame->photo)
            count += rn_sheet_place(&frame->camera, points[lines->views[i].point].position,
                                    &placed[count]);
    sheets->items[index] = rn_sheet_make(pixels, frame, placed, count);
    rn_pixels_let_go(pixels);
    free(placed);
}

// Of a layer of cells, those that enough photographs see through.
static void see_through_layer(void *context, int layer, int thread) {
    (void)thread;
    const struct sheets *sheets = context;
    const struct lines *lines = sheets->lines;
    size_t area = (size_t)lines->cells * (size_t)lines->cells, first = (size_t)layer * area;
    for (size_t i = first; i < first + area; i++) {
        double at[3];
        bool kept = lines->crossed[i] == KEPT;
        int through = 0, enough = kept ? OVERRULED : THROUGH;
        if (lines->trainer->field->occupancy[i] == 0) continue;
        if ((lines->crossed[i] >= CROSSED && !kept) || !middle_of(lines, i, at)) continue;
        for (size_t s = 0; s < sheets->count && through < enough; s++)
            through += rn_sheet_sees_through(&sheets->items[s], at);
        if (through == enough) lines->crossed[i] = CROSSED;
    }
}

// Without memory: nothing more is known.
static void see_through(const struct lines *lines) {
    struct rn_trainer *t = lines->trainer;
    size_t finest =
        (size_t)(t->train.scale_count > 1 ? t->train.scale_first[1] : t->train.frame_count);
    struct sheets sheets = {.lines = lines, .stride = (finest + SHEETS - 1) / SHEETS};
    sheets.count = (finest + sheets.stride - 1) / sheets.stride;
    sheets.items = calloc(sheets.count, sizeof *sheets.items);
    if (!sheets.items) return;
    rn_pool_run(t->engine->pool, (int)sheets.count, make_sheet, &sheets);
    rn_pool_run(t->engine->pool, lines->cells, see_through_layer, &sheets);
    for (size_t i = 0; i < sheets.count; i++)
        rn_sheet_finish(&sheets.items[i]);
    free(sheets.items);
}

static void carve(struct lines *lines) {
    struct rn_trainer *t = lines->trainer;
    const struct rn_points *points = &t->dataset->points;
    size_t cells = (size_t)lines->cells * (size_t)lines->cells * (size_t)lines->cells;
    for (size_t i = 0; i < points->count; i++) { // those too whose lines are left out
        double at[3];
        if (rn_field_cube_of(t->field, points->items[i].position, at)) keep_around(lines, at);
    }
    bool lines_tell = !t->field->cpu.disparity.on;
    if (lines_tell) rn_pool_run(t->engine->pool, SLICES, follow_slice, lines);
    struct stands stands = list_stands(lines);
    if (stands.items) rn_pool_run(t->engine->pool, lines->cells, clear_layer, &stands);
    free(stands.items);
    if (lines_tell) see_through(lines);
    for (size_t i = 0; i < cells; i++)
        if (lines->crossed[i] >= CROSSED && lines->crossed[i] != KEPT) t->field->occupancy[i] = 0;
}

void rn_trainer_carve_sighted(struct rn_trainer *t) {
    size_t side = (size_t)t->field->config.field.occupancy;
    if (t->dataset->points.sighting_count == 0) return;
    struct lines lines = {
        .trainer = t, .cells = (int)side, .crossed = calloc(side * side * side, 1)};
    list_cameras(&lines);
    if (lines.cameras) list_views(&lines);
    if (lines.crossed && lines.views) carve(&lines); // else nothing is carved
    free(lines.crossed);
    free(lines.cameras);
    free(lines.views);
}
