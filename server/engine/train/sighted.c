// What sparse points say of unbounded space before training: a photograph that saw a point saw
// through all that lies between. Cells that several such lines cross, and near which no point lies,
// begin empty, so that rays skip them from the first step on and no haze settles there.
#include <math.h>
#include <stdlib.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/field/space.h"
#include "server/engine/train/trainer.h"

#define CROSSED 3   // lines that make a cell empty: one may be of a wrong match
#define NEAR 2      // cells to each side of a point that are left alone
#define KEPT 255    // stands for them where lines are counted
#define PLACES 128  // that are looked at along a line
#define MOST 100000 // lines that are followed, evenly of all

struct lines {
    const struct rn_trainer *trainer;
    int cells;
    uint8_t *crossed; // by how many lines, of each cell, or KEPT
};

// Where a point (dataset units) is drawn to in the cells' cube.
static void contract(const struct rn_field *field, const double point[3], double ret[3]) {
    double squares = 0;
    for (int i = 0; i < 3; i++) {
        ret[i] = (point[i] - field->bounds.centre[i]) / field->bounds.radius;
        squares += ret[i] * ret[i];
    }
    double scale = (double)rn_contraction_at((rn_real)sqrt(squares)).scale;
    for (int i = 0; i < 3; i++)
        ret[i] *= scale;
}

static size_t cell_of(const struct lines *lines, const double at[3]) {
    int cell[3];
    for (int i = 0; i < 3; i++)
        cell[i] = rn_cell_of((rn_real)at[i], lines->cells);
    return rn_cell_index(cell[0], cell[1], cell[2], lines->cells);
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

static void follow(const struct lines *lines, const struct rn_camera *camera,
                   const double point[3]) {
    double end[3], reach = 2.0 * (NEAR + 1) / lines->cells;
    size_t last = SIZE_MAX;
    contract(lines->trainer->field, point, end);
    keep_around(lines, end);
    for (int place = 0; place < PLACES; place++) {
        double there[3], at[3], squares = 0;
        for (int i = 0; i < 3; i++) {
            double from = camera->world_from_camera[i][3];
            there[i] = from + (point[i] - from) * place / PLACES;
        }
        contract(lines->trainer->field, there, at);
        for (int i = 0; i < 3; i++)
            squares += (at[i] - end[i]) * (at[i] - end[i]);
        size_t cell = cell_of(lines, at);
        if (squares < reach * reach) return;
        if (cell != last && lines->crossed[cell] < KEPT - 1) lines->crossed[cell]++;
        last = cell;
    }
}

// Cameras of the photographs that are trained on, by photograph; malloc'd.
static const struct rn_camera **list_cameras(const struct rn_trainer *t, size_t *ret_count) {
    size_t count = 0;
    for (int f = 0; f < t->train.frame_count; f++)
        if ((size_t)t->train.frames[f].frame->photo >= count)
            count = (size_t)t->train.frames[f].frame->photo + 1;
    const struct rn_camera **cameras = calloc(count + 1, sizeof *cameras);
    for (int f = 0; cameras && f < t->train.frame_count; f++)
        cameras[t->train.frames[f].frame->photo] = &t->train.frames[f].camera;
    *ret_count = count;
    return cameras;
}

void rn_trainer_carve_sighted(struct rn_trainer *t) {
    const struct rn_points *points = &t->dataset->points;
    size_t side = (size_t)t->field->config.field.occupancy, cells = side * side * side, photos;
    if (points->sighting_count == 0) return;
    struct lines lines = {t, (int)side, calloc(cells, 1)};
    const struct rn_camera **cameras = list_cameras(t, &photos);
    if (lines.crossed && cameras) { // without memory nothing is carved
        size_t stride = points->sighting_count / MOST + 1;
        for (size_t i = 0; i < points->sighting_count; i += stride) {
            const struct rn_sighting *seen = &points->sightings[i];
            if (seen->photo < photos && cameras[seen->photo])
                follow(&lines, cameras[seen->photo], points->items[seen->point].position);
        }
        for (size_t i = 0; i < cells; i++)
            if (lines.crossed[i] >= CROSSED && lines.crossed[i] != KEPT) t->field->occupancy[i] = 0;
    }
    free(lines.crossed);
    free(cameras);
}
