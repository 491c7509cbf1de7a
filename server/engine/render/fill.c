#include "server/engine/render/fill.h"

#include <math.h>
#include <stdlib.h>

#include "server/engine/scene/scene.h"

#define ROWS 16  // of a picture that a thread fills at a time
#define TAPS 4   // of a spline
#define BEFORE 2 // columns in front of the first that a spline may ask for

// Colour and opacity: what is interpolated.
typedef float numbers __attribute__((vector_size(16)));

// Where a pixel lies among those of a smaller picture: the first of TAPS, their weights, the
// nearest.
struct place {
    int first, nearest;
    float weights[TAPS];
};

struct work {
    const struct rn_filling *filling;
    struct rn_render_result *result;
    int width, height;           // in pixels that were rendered
    const struct place *columns; // of a smaller picture, for each of the result's; NULL
    struct rn_pixel *rows;       // a thread's, TAPS rows of `width`: means of points
    numbers *blended;            // a thread's, width + TAPS: between rows of a smaller picture
    _Atomic uint64_t nonfinite;
};

static float finite_or(float value, float other) {
    return isfinite(value) ? value : other;
}

static float clamped(float value) {
    return value < 0 ? 0 : value > 1 ? 1 : value;
}

static bool is_finite(const struct rn_pixel *p) {
    return isfinite(p->rgb[0] + p->rgb[1] + p->rgb[2] + p->depth + p->alpha);
}

// A row of pixels: the lattice's own, or means of its points, written to `room`.
static const struct rn_pixel *pixel_row(const struct work *w, int y, struct rn_pixel *room) {
    const struct rn_lattice *l = w->filling->lattice;
    int n = w->filling->points;
    const struct rn_pixel *first = l->pixels + (size_t)y * n * l->width;
    if (n == 1) return first;
    for (int x = 0; x < w->width; x++, first += n)
        room[x] = rn_cones_mean(
            (struct rn_pixel[]){first[0], first[1], first[l->width], first[l->width + 1]}, n,
            w->filling->straight);
    return room;
}

static void count_nonfinite(struct work *w, const struct rn_pixel *row) {
    uint64_t nonfinite = 0;
    for (int x = 0; x < w->width; x++)
        nonfinite += !is_finite(&row[x]);
    if (nonfinite) w->nonfinite += nonfinite;
}

static void put_row(const struct work *w, int y, const struct rn_pixel *row) {
    const struct rn_render_options *o = w->filling->options;
    struct rn_render_result *result = w->result;
    size_t at = (size_t)y * o->camera.width;
    float scale = (float)w->filling->radius;
    for (int x = 0; x < w->width && result->rgb.values; x++)
        for (int c = 0; c < 3; c++)
            result->rgb.values[3 * (at + x) + c] = finite_or(row[x].rgb[c], o->background[c]);
    for (int x = 0; x < w->width && result->depth.values; x++)
        result->depth.values[at + x] = finite_or(row[x].depth, 0) * scale;
    for (int x = 0; x < w->width && result->alpha.values; x++)
        result->alpha.values[at + x] = finite_or(row[x].alpha, 0);
}

// ---- a picture that was rendered smaller ------------------------------------------------------

// Pixel `i` of `whole` among the `count` that were rendered in their place; Catmull & Rom 1974.
static struct place find_place(int i, int whole, int count) {
    float at = ((float)i + 0.5f) * (float)count / (float)whole - 0.5f;
    float floored = floorf(at), t = at - floored;
    struct place place = {.first = (int)floored - 1,
                          .nearest = (int)lroundf(at),
                          .weights = {0.5f * t * (t * (2 - t) - 1),
                                      0.5f * (t * t * (3 * t - 5) + 2),
                                      0.5f * t * (t * (4 - 3 * t) + 1), 0.5f * t * t * (t - 1)}};
    place.nearest = place.nearest < 0 ? 0 : place.nearest >= count ? count - 1 : place.nearest;
    return place;
}

static int inside(int i, int count) {
    return i < 0 ? 0 : i >= count ? count - 1 : i;
}

// What lies between the rows at `place`; columns at the ends are repeated beyond them.
static void blend_rows(const struct work *w, const struct place *place, struct rn_pixel *room,
                       numbers *ret_blended) {
    const struct rn_pixel *rows[TAPS];
    for (int k = 0; k < TAPS; k++)
        rows[k] = pixel_row(w, inside(place->first + k, w->height), room + (size_t)k * w->width);
    for (int x = 0; x < w->width; x++) {
        numbers sum = {0};
        for (int k = 0; k < TAPS; k++) {
            const struct rn_pixel *p = &rows[k][x];
            sum += place->weights[k] * (numbers){p->rgb[0], p->rgb[1], p->rgb[2], p->alpha};
        }
        ret_blended[x + BEFORE] = sum;
    }
    for (int x = 0; x < BEFORE; x++) {
        ret_blended[x] = ret_blended[BEFORE];
        ret_blended[w->width + BEFORE + x] = ret_blended[w->width + BEFORE - 1];
    }
}

static void enlarge_row(const struct work *w, int y, struct rn_pixel *room, numbers *blended) {
    const struct rn_render_options *o = w->filling->options;
    struct rn_render_result *result = w->result;
    size_t at = (size_t)y * o->camera.width;
    struct place row = find_place(y, o->camera.height, w->height);
    blend_rows(w, &row, room, blended);
    for (int x = 0; x < o->camera.width; x++) {
        const struct place *place = &w->columns[x];
        const numbers *from = blended + place->first + BEFORE;
        numbers sum = {0};
        for (int k = 0; k < TAPS; k++)
            sum += place->weights[k] * from[k];
        for (int c = 0; c < 3 && result->rgb.values; c++)
            result->rgb.values[3 * (at + x) + c] = clamped(finite_or(sum[c], o->background[c]));
        if (result->alpha.values) result->alpha.values[at + x] = clamped(finite_or(sum[3], 0));
    }
    if (!result->depth.values) return;
    const struct rn_pixel *nearest = pixel_row(w, row.nearest, room);
    for (int x = 0; x < o->camera.width; x++)
        result->depth.values[at + x] =
            finite_or(nearest[w->columns[x].nearest].depth, 0) * (float)w->filling->radius;
}

// ---- all of it --------------------------------------------------------------------------------

static void fill_rows(void *context, int index, int thread) {
    struct work *w = context;
    const struct rn_camera *camera = &w->filling->options->camera;
    struct rn_pixel *room = w->rows + (size_t)thread * TAPS * w->width;
    numbers *blended = w->blended + (size_t)thread * (w->width + TAPS);
    int end = (index + 1) * ROWS < camera->height ? (index + 1) * ROWS : camera->height;
    for (int y = index * ROWS; y < end; y++) {
        if (w->columns) {
            enlarge_row(w, y, room, blended);
        } else {
            const struct rn_pixel *row = pixel_row(w, y, room);
            put_row(w, y, row);
            count_nonfinite(w, row);
        }
    }
}

// The mean square distance of four pixels beside each other from their mean, summed up along rows.
static double roughness_of(const struct rn_pixel *row, const struct rn_pixel *next, int width) {
    double sum = 0;
    for (int x = 0; x + 1 < width; x++) {
        float squares = 0;
        for (int c = 0; c < 3; c++) {
            float a = row[x].rgb[c], b = row[x + 1].rgb[c], d = next[x].rgb[c];
            float e = next[x + 1].rgb[c], mean = 0.25f * ((a + b) + (d + e));
            a -= mean, b -= mean, d -= mean, e -= mean;
            squares += (a * a + b * b) + (d * d + e * e);
        }
        sum += (double)finite_or(squares, 0) / 12;
    }
    return sum;
}

// Of a smaller picture, once a row that was rendered.
static void look_at_rows(struct work *w) {
    double sum = 0, places = fmax((double)(w->width - 1) * (w->height - 1), 1);
    for (int y = 0; y < w->height; y++) {
        const struct rn_pixel *row = pixel_row(w, y, w->rows);
        count_nonfinite(w, row);
        if (y + 1 < w->height)
            sum += roughness_of(row, pixel_row(w, y + 1, w->rows + w->width), w->width);
    }
    w->result->stats.roughness = sum / places;
}

static enum rn_status init_pictures(const struct rn_render_options *o,
                                    struct rn_render_result *result, struct rn_error *err) {
    struct rn_picture *pictures[3] = {&result->rgb, &result->depth, &result->alpha};
    const unsigned outputs[3] = {RN_OUTPUT_RGB, RN_OUTPUT_DEPTH, RN_OUTPUT_ALPHA};
    enum rn_status status = RN_OK;
    for (int i = 0; i < 3 && status == RN_OK; i++)
        if (o->outputs & outputs[i])
            status = rn_picture_init(o->camera.width, o->camera.height, i == 0 ? 3 : 1, pictures[i],
                                     err);
    return status;
}

static void fill(struct rn_engine *engine, struct work *w, struct place *columns) {
    const struct rn_camera *camera = &w->filling->options->camera;
    for (int x = 0; x < camera->width && columns; x++)
        columns[x] = find_place(x, camera->width, w->width);
    w->columns = columns;
    rn_pool_run(engine->pool, (camera->height + ROWS - 1) / ROWS, fill_rows, w);
    if (columns) look_at_rows(w);
}

enum rn_status rn_fill_pictures(struct rn_engine *engine, const struct rn_filling *filling,
                                struct rn_render_result *ret_result, struct rn_error *err) {
    const struct rn_render_options *o = filling->options;
    struct work w = {.filling = filling,
                     .result = ret_result,
                     .width = filling->lattice->width / filling->points,
                     .height = filling->lattice->height / filling->points};
    size_t threads = (size_t)rn_pool_threads(engine->pool);
    struct place *columns =
        o->settings.subsample > 1 ? malloc((size_t)o->camera.width * sizeof *columns) : NULL;
    w.rows = malloc(threads * TAPS * (size_t)w.width * sizeof *w.rows);
    w.blended = aligned_alloc(16, threads * (size_t)(w.width + TAPS) * sizeof *w.blended);
    enum rn_status status = init_pictures(o, ret_result, err);
    if (status == RN_OK && (!w.rows || !w.blended || (o->settings.subsample > 1 && !columns)))
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "no memory");
    if (status == RN_OK) fill(engine, &w, columns);
    free(columns);
    free(w.rows);
    free(w.blended);
    ret_result->stats.nonfinite_rays = w.nonfinite;
    return status;
}
