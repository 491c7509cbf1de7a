#include "server/engine/train/sheets.h"

#include <math.h>
#include <stdlib.h>

#define COLUMNS 64  // tiles of a photograph's width
#define PIXELS 8    // of a tile's side that are looked at, at most
#define RANGE 24    // tiles to the farthest point that counts
#define EDGE 16.0f  // grey levels of a channel by which neighbouring tiles differ at an edge
#define OCTANTS 8   // about a tile, of each of which the nearest point counts:
#define LEAST 3     // of them, in as many quadrants
#define ON_PLANE 4  // that make a plane
#define FLAT 0.05   // of its depth, by which they may lie off it
#define TIGHT 0.96f // of the plane's depth,
#define LOOSE 0.85f // of the nearest point's

static int count_rows(const struct rn_camera *camera) {
    int rows = (int)lround((double)COLUMNS * camera->height / camera->width);
    return rows > 0 ? rows : 1;
}

static bool find_tile(const struct rn_camera *camera, const double axes[3], float ret[2]) {
    double at[2];
    if (!rn_camera_project(camera, axes, at)) return false;
    if (!(at[0] >= 0 && at[1] >= 0 && at[0] < camera->width && at[1] < camera->height))
        return false;
    ret[0] = (float)(at[0] / camera->width * COLUMNS);
    ret[1] = (float)(at[1] / camera->height * count_rows(camera));
    return true;
}

bool rn_sheet_place(const struct rn_camera *camera, const double point[3],
                    struct rn_sheet_point *ret_point) {
    double axes[3];
    float at[2];
    rn_camera_axes(camera, point, axes);
    if (!(axes[2] > 0) || !find_tile(camera, axes, at)) return false;
    *ret_point = (struct rn_sheet_point){at[0], at[1], (float)axes[2]};
    return true;
}

bool rn_sheet_sees_through(const struct rn_sheet *sheet, const double point[3]) {
    double axes[3];
    float at[2];
    rn_camera_axes(sheet->camera, point, axes);
    if (!(axes[2] > 0 && axes[2] < (double)sheet->farthest)) return false;
    if (!find_tile(sheet->camera, axes, at)) return false;
    int x = (int)fminf(at[0], (float)sheet->columns - 1);
    int y = (int)fminf(at[1], (float)sheet->rows - 1);
    return axes[2] < (double)sheet->clear[y * sheet->columns + x];
}

// ---- one photograph --------------------------------------------------------------------------

struct tiles {
    int columns, rows;
    float (*mean)[3]; // grey levels of each tile
};

// Of up to PIXELS x PIXELS of its pixels.
static void find_mean(const struct rn_pixels *pixels, const struct rn_pixel_frame *frame,
                      const struct tiles *tiles, int tile, float ret[3]) {
    int size[2] = {frame->camera.width, frame->camera.height};
    int parts[2] = {tiles->columns, tiles->rows}, at[2] = {tile % parts[0], tile / parts[0]};
    int first[2], sides[2], step[2];
    for (int i = 0; i < 2; i++) {
        first[i] = size[i] * at[i] / parts[i];
        sides[i] = size[i] * (at[i] + 1) / parts[i] - first[i];
        if (sides[i] < 1) sides[i] = 1;
        step[i] = (sides[i] + PIXELS - 1) / PIXELS;
    }
    int count = 0;
    ret[0] = ret[1] = ret[2] = 0;
    for (int y = 0; y < sides[1]; y += step[1])
        for (int x = 0; x < sides[0]; x += step[0], count++) {
            const uint8_t *pixel = rn_pixel_at(pixels, frame, first[0] + x, first[1] + y);
            for (int c = 0; c < 3; c++)
                ret[c] += pixel[c];
        }
    for (int c = 0; c < 3; c++)
        ret[c] /= (float)count;
}

// Whether no edge lies on the straight way from the middle of tile (x, y) to what is (dx, dy) from
// it.
static bool is_one_with(const struct tiles *tiles, int x, int y, float dx, float dy) {
    int steps = (int)ceilf(sqrtf(dx * dx + dy * dy));
    const float *last = tiles->mean[y * tiles->columns + x];
    for (int i = 1; i <= steps; i++) {
        float share = (float)i / (float)steps;
        int u = (int)((float)x + 0.5f + share * dx), v = (int)((float)y + 0.5f + share * dy);
        if (u >= tiles->columns || v >= tiles->rows) return false;
        const float *here = tiles->mean[v * tiles->columns + u];
        for (int c = 0; c < 3; c++)
            if (fabsf(here[c] - last[c]) > EDGE) return false;
        last = here;
    }
    return true;
}

// The points about a tile, one an octant at most; x and y from its middle.
struct around {
    int count, quadrants;
    struct rn_sheet_point points[OCTANTS];
};

static struct around look_around(const struct tiles *tiles, int x, int y,
                                 const struct rn_sheet_point *points, size_t count) {
    struct rn_sheet_point nearest[OCTANTS];
    float squares[OCTANTS];
    for (int i = 0; i < OCTANTS; i++)
        squares[i] = RANGE * RANGE;
    for (size_t i = 0; i < count; i++) {
        float dx = points[i].x - ((float)x + 0.5f), dy = points[i].y - ((float)y + 0.5f);
        int octant = (dx > 0) + 2 * (dy > 0) + 4 * (fabsf(dx) > fabsf(dy));
        if (dx * dx + dy * dy >= squares[octant]) continue;
        squares[octant] = dx * dx + dy * dy;
        nearest[octant] = (struct rn_sheet_point){dx, dy, points[i].depth};
    }
    struct around around = {0};
    bool quadrants[4] = {false};
    for (int i = 0; i < OCTANTS; i++) {
        if (squares[i] >= RANGE * RANGE) continue;
        if (!is_one_with(tiles, x, y, nearest[i].x, nearest[i].y)) continue;
        around.points[around.count++] = nearest[i];
        quadrants[i % 4] = true;
    }
    around.quadrants = quadrants[0] + quadrants[1] + quadrants[2] + quadrants[3];
    return around;
}

static double weight_of(const struct rn_sheet_point *point) {
    return 1 / (1 + (double)(point->x * point->x + point->y * point->y));
}

// The depth in a tile's middle of the plane that fits the points about it, nearer ones weighing
// more: a plane's inverse depths are linear over a picture. NAN where they lie on none.
static double plane_depth(const struct around *around) {
    double sum = 0, mean[3] = {0}, xx = 0, xy = 0, yy = 0, xz = 0, yz = 0;
    for (int i = 0; i < around->count; i++) {
        const struct rn_sheet_point *p = &around->points[i];
        double weight = weight_of(p);
        sum += weight;
        mean[0] += weight * (double)p->x;
        mean[1] += weight * (double)p->y;
        mean[2] += weight * (1 / (double)p->depth);
    }
    for (int k = 0; k < 3; k++)
        mean[k] /= sum;
    for (int i = 0; i < around->count; i++) {
        const struct rn_sheet_point *p = &around->points[i];
        double weight = weight_of(p), x = (double)p->x - mean[0], y = (double)p->y - mean[1],
               z = 1 / (double)p->depth - mean[2];
        xx += weight * x * x, xy += weight * x * y, yy += weight * y * y;
        xz += weight * x * z, yz += weight * y * z;
    }
    double determinant = xx * yy - xy * xy;
    if (!(determinant > 1e-9 * xx * yy)) return NAN; // all on a line
    double right = (xz * yy - yz * xy) / determinant, down = (yz * xx - xz * xy) / determinant;
    double here = mean[2] - right * mean[0] - down * mean[1];
    for (int i = 0; i < around->count; i++) {
        const struct rn_sheet_point *p = &around->points[i];
        double fitted = here + right * (double)p->x + down * (double)p->y;
        if (!(fabs(fitted * (double)p->depth - 1) < FLAT)) return NAN;
    }
    return here > 0 ? 1 / here : NAN;
}

static float clear_depth(const struct around *around) {
    if (around->count < LEAST || around->quadrants < LEAST) return 0;
    double plane = around->count < ON_PLANE ? (double)NAN : plane_depth(around);
    if (!isnan(plane)) return TIGHT * (float)plane;
    float nearest = around->points[0].depth;
    for (int i = 1; i < around->count; i++)
        nearest = fminf(nearest, around->points[i].depth);
    return LOOSE * nearest;
}

struct rn_sheet rn_sheet_make(const struct rn_pixels *pixels, const struct rn_pixel_frame *frame,
                              const struct rn_sheet_point *points, size_t count) {
    struct rn_sheet sheet = {
        .camera = &frame->camera, .columns = COLUMNS, .rows = count_rows(&frame->camera)};
    struct tiles tiles = {.columns = sheet.columns, .rows = sheet.rows};
    int all = tiles.columns * tiles.rows;
    tiles.mean = malloc((size_t)all * sizeof *tiles.mean);
    sheet.clear = calloc((size_t)all, sizeof *sheet.clear);
    for (int i = 0; tiles.mean && sheet.clear && i < all; i++)
        find_mean(pixels, frame, &tiles, i, tiles.mean[i]);
    for (int i = 0; tiles.mean && sheet.clear && i < all; i++) {
        struct around around =
            look_around(&tiles, i % tiles.columns, i / tiles.columns, points, count);
        sheet.clear[i] = clear_depth(&around);
        sheet.farthest = fmaxf(sheet.farthest, sheet.clear[i]);
    }
    free(tiles.mean);
    return sheet;
}

void rn_sheet_finish(struct rn_sheet *sheet) {
    free(sheet->clear);
    sheet->clear = NULL;
}
