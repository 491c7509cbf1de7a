// Rendering: tiles of rays, front to back, over the engine's threads.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/engine/render/lattice.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"

#define TILE 16               // cones a side; a tile fills two packets
#define SPARSE 2              // times as many where a pass takes every second pixel a side
#define BAND 256              // rows a device renders between two looks at keep_going
#define ROWS 16               // of a picture that a thread fills at a time
#define FINE_POINTS (1 << 23) // of a lattice finer than the pixels, at most
#define TIMED_TOLERANCE 1e-9  // of a frame by a deadline, until it is known what there is time for

struct frame {
    struct rn_engine *engine;
    struct rn_field *field;
    const struct rn_render_options *options;
    struct rn_march_options march;
    struct rn_camera camera; // at the lattice's resolution
    int points;              // of the lattice, a side of a pixel
    int cones;               // a side of a point
    int tile;                // points a side
    int tiles_x, pass;
    struct rn_lattice lattice;
    bool on_device;   // the field's copy there has the levels
    double tolerance; // the largest of the passes
    int64_t late_ns;  // when tracing ends, to leave the rest of a deadline for filling; 0: never
    _Atomic uint64_t rays, samples, nonfinite;
};

static struct rn_tile tile_at(const struct frame *f, int index) {
    int width = f->lattice.width, height = f->lattice.height;
    struct rn_tile tile = {.x0 = index % f->tiles_x * f->tile, .y0 = index / f->tiles_x * f->tile};
    tile.x1 = tile.x0 + f->tile < width ? tile.x0 + f->tile : width;
    tile.y1 = tile.y0 + f->tile < height ? tile.y0 + f->tile : height;
    return tile;
}

static bool is_late(const struct frame *f) {
    return f->late_ns && rn_clock_ns() >= f->late_ns;
}

static void render_tile(void *context, int index, int thread) {
    struct frame *f = context;
    struct rn_spot spots[TILE * TILE * SPARSE];
    struct rn_pixel pixels[TILE * TILE * SPARSE];
    struct rn_lattice lattice = f->lattice;
    lattice.late = is_late(f);
    int n = rn_lattice_choose(&lattice, f->pass, tile_at(f, index), spots);
    f->samples += rn_cones_render(f->engine, f->field, &f->march, &f->camera, f->cones, spots, n,
                                  thread, pixels);
    f->rays += (uint64_t)n * f->cones * f->cones;
    for (int i = 0; i < n; i++)
        f->lattice.pixels[(size_t)spots[i].y * lattice.width + spots[i].x] = pixels[i];
}

static float finite_or(float value, float other) {
    return isfinite(value) ? value : other;
}

// What lies between the middles of two pixels of a row or column: the first one's place, whether
// there is a second, and how far towards that.
struct between {
    int first, step;
    float weight;
};

// Pictures to fill from a frame's points.
struct filling {
    struct frame *frame;
    struct rn_render_result *result;
    struct between
        *columns; // of a picture that was rendered smaller, for each of its columns; NULL
};

static struct rn_pixel mean_of_points(const struct frame *f, int x, int y) {
    int n = f->points, width = f->lattice.width;
    const struct rn_pixel *first = f->lattice.pixels + (size_t)y * n * width + (size_t)x * n;
    if (n == 1) return *first;
    return rn_cones_mean((struct rn_pixel[]){first[0], first[1], first[width], first[width + 1]}, n,
                         f->march.straight ? f->march.background : NULL);
}

// Pixel `i` of `whole`, among the `count` that were rendered in their place.
static struct between find_between(int i, int whole, int count) {
    float place = ((float)i + 0.5f) * (float)count / (float)whole - 0.5f;
    place = fminf(fmaxf(place, 0), (float)(count - 1));
    int first = (int)place;
    return (struct between){first, first + 1 < count, place - (float)first};
}

static struct rn_pixel mix(const struct rn_pixel *a, const struct rn_pixel *b, float weight) {
    struct rn_pixel mean;
    for (int c = 0; c < 3; c++)
        mean.rgb[c] = a->rgb[c] + weight * (b->rgb[c] - a->rgb[c]);
    mean.alpha = a->alpha + weight * (b->alpha - a->alpha);
    mean.depth = weight < 0.5f ? a->depth : b->depth;
    return mean;
}

// A pixel of a picture that was rendered smaller: colour and opacity between the four nearest, the
// nearest one's depth.
static struct rn_pixel enlarged(const struct frame *f, struct between x, struct between y) {
    const struct rn_pixel a = mean_of_points(f, x.first, y.first),
                          b = mean_of_points(f, x.first + x.step, y.first),
                          c = mean_of_points(f, x.first, y.first + y.step),
                          d = mean_of_points(f, x.first + x.step, y.first + y.step);
    const struct rn_pixel upper = mix(&a, &b, x.weight), lower = mix(&c, &d, x.weight);
    return mix(&upper, &lower, y.weight);
}

static bool is_finite(struct rn_pixel p) {
    return isfinite(p.rgb[0] + p.rgb[1] + p.rgb[2] + p.depth + p.alpha);
}

static void fill_rows(void *context, int index, int thread) {
    (void)thread;
    const struct filling *filling = context;
    struct frame *f = filling->frame;
    struct rn_render_result *result = filling->result;
    const struct rn_render_options *o = f->options;
    int end = (index + 1) * ROWS, height = f->lattice.height / f->points;
    int n = o->settings.subsample > 1 ? o->settings.subsample : 1;
    uint64_t nonfinite = 0;
    for (int y = index * ROWS; y < end && y < o->camera.height; y++) {
        struct between row = find_between(y, o->camera.height, height);
        for (int x = 0; x < o->camera.width; x++) {
            struct rn_pixel p =
                filling->columns ? enlarged(f, filling->columns[x], row) : mean_of_points(f, x, y);
            size_t at = (size_t)y * o->camera.width + x;
            bool first = y % n + x % n == 0;
            nonfinite += first && !is_finite(n > 1 ? mean_of_points(f, x / n, y / n) : p);
            if (result->rgb.values)
                for (int c = 0; c < 3; c++)
                    result->rgb.values[3 * at + c] = finite_or(p.rgb[c], o->background[c]);
            if (result->depth.values)
                result->depth.values[at] = finite_or(p.depth, 0) * (float)f->field->bounds.radius;
            if (result->alpha.values) result->alpha.values[at] = finite_or(p.alpha, 0);
        }
    }
    f->nonfinite += nonfinite;
}

// Spreads the rendered pixels over the pictures asked for; counts those that are not finite.
static enum rn_status fill_pictures(struct frame *f, struct rn_render_result *result,
                                    struct rn_error *err) {
    const struct rn_render_options *o = f->options;
    struct rn_picture *pictures[3] = {&result->rgb, &result->depth, &result->alpha};
    const unsigned outputs[3] = {RN_OUTPUT_RGB, RN_OUTPUT_DEPTH, RN_OUTPUT_ALPHA};
    for (int i = 0; i < 3; i++) {
        if (!(o->outputs & outputs[i])) continue;
        enum rn_status status =
            rn_picture_init(o->camera.width, o->camera.height, i == 0 ? 3 : 1, pictures[i], err);
        if (status != RN_OK) return status;
    }
    struct filling filling = {f, result, NULL};
    int width = f->lattice.width / f->points;
    if (o->settings.subsample > 1) {
        filling.columns = malloc((size_t)o->camera.width * sizeof *filling.columns);
        if (!filling.columns) return rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "no memory");
        for (int x = 0; x < o->camera.width; x++)
            filling.columns[x] = find_between(x, o->camera.width, width);
    }
    rn_pool_run(f->engine->pool, (o->camera.height + ROWS - 1) / ROWS, fill_rows, &filling);
    free(filling.columns);
    return RN_OK;
}

static enum rn_status check_options(struct rn_render_options *o, struct rn_error *err) {
    enum rn_status status = rn_camera_check(&o->camera, "camera", err);
    if (status != RN_OK) return status;
    if (!(o->outputs & (RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA)))
        return rn_error_set(err, RN_ERROR_INVALID, "output", "must be rgb, depth or alpha");
    return rn_settings_check(&rn_render_settings, &o->settings, err);
}

// Pyramid levels that this camera may touch; the training's own when rays are shorter.
static enum rn_status prepare(struct frame *f, struct rn_error *err) {
    struct rn_camera cones =
        rn_camera_resized(&f->camera, f->camera.width * f->cones, f->camera.height * f->cones);
    int levels = rn_levels_for_camera(f->field, &cones, (double)f->march.step);
    enum rn_status status =
        f->field->rests ? rn_field_put_to_render(f->engine, f->field, err) : RN_OK;
    if (status != RN_OK) return status;
    f->on_device = f->field->on_device && levels <= f->field->device_levels;
    if (f->on_device) return RN_OK;
    status = rn_field_fetch(f->field, NULL, NULL, err);
    if (status == RN_OK) status = rn_field_make_ready(f->field, f->engine, levels, err);
    if (status == RN_OK) rn_field_choose_cells(f->field, levels);
    return status;
}

static enum rn_status stopped(struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_CANCELLED, "render", "stopped on request");
}

static enum rn_status too_late(struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_LIMIT, "deadline", "there was no time for a first picture");
}

struct poll {
    bool (*keep_going)(void *context);
    void *context;
    const struct frame *frame;
};

static bool must_stop(void *context) {
    const struct poll *poll = context;
    return poll->keep_going && !poll->keep_going(poll->context);
}

// The frame's pass, and how many tiles it has.
static int begin_pass(struct frame *f, int pass) {
    f->pass = pass;
    f->tile = (rn_lattice_passes(&f->lattice) > 1 ? SPARSE : 1) * TILE / f->cones;
    f->tiles_x = (f->camera.width + f->tile - 1) / f->tile;
    return f->tiles_x * ((f->camera.height + f->tile - 1) / f->tile);
}

// All tiles of a pass, over the engine's threads.
static enum rn_status render_pass(struct frame *f, int pass, struct poll *poll,
                                  struct rn_error *err) {
    int tiles = begin_pass(f, pass), next = 0;
    if (must_stop(poll) ||
        !rn_pool_run_some(f->engine->pool, tiles, &next, render_tile, f, must_stop, poll))
        return stopped(err);
    return RN_OK;
}

static enum rn_status render_tiles(struct frame *f, struct poll *poll, struct rn_error *err) {
    enum rn_status status = RN_OK;
    int passes = rn_lattice_passes(&f->lattice);
    for (int pass = 0; pass < passes && status == RN_OK; pass++)
        status = render_pass(f, pass, poll, err);
    return status;
}

// ---- by a deadline --------------------------------------------------------------------------

#define GROWTH 1.5      // of the points traced from pass to pass, about
#define SPEND 0.95      // of the time left, what is planned for
#define MISS_COST 0.1   // of a ray that sees nothing, in rays that see something
#define FILL_NS 4.0     // of a picture's pixel
#define LEAST_TIMED 256 // points, for their time to say what the next ones take
#define CENSUS 4000     // points that a census asks, about

// What points of the frame's next pass there are, from some of its tiles; `ret_share` of all.
static struct rn_lattice_census take_census(const struct frame *f, int tiles, double *ret_share) {
    struct rn_lattice_census census = {0};
    int apart = tiles * TILE * TILE / CENSUS, taken = 0;
    for (int i = 0; i < tiles; i += 1 + apart, taken++)
        rn_lattice_count(&f->lattice, f->pass, tile_at(f, i), &census);
    *ret_share = (double)taken / tiles;
    return census;
}

static bool must_give_up(void *context) {
    const struct poll *poll = context;
    return must_stop(context) || rn_clock_ns() >= poll->frame->options->first_ns;
}

// The first pass is traced whole: all the others can be made from it.
static enum rn_status render_first(struct frame *f, struct poll *poll, struct rn_error *err) {
    int tiles = begin_pass(f, 0), next = 0;
    if (!must_give_up(poll) &&
        rn_pool_run_some(f->engine->pool, tiles, &next, render_tile, f, must_give_up, poll))
        return RN_OK;
    return must_stop(poll) ? stopped(err) : too_late(err);
}

// Of the time left, what the pass may take when so many more come, each of which traces more.
static double share_of_pass(int passes_left) {
    double all = 0;
    for (int i = 0; i < passes_left; i++)
        all += pow(GROWTH, i);
    return SPEND / all;
}

// Each pass tells what a point costs here and now; of the next one as many are traced as there is
// time for, those first whose neighbours disagree most.
static enum rn_status render_timed(struct frame *f, struct poll *poll, struct rn_error *err) {
    int passes = rn_lattice_passes(&f->lattice);
    int64_t began_ns = rn_clock_ns();
    enum rn_status status = render_first(f, poll, err);
    double point_ns = 0, spent_ns = (double)(rn_clock_ns() - began_ns);
    uint64_t before = 0;
    for (int pass = 1; pass < passes && status == RN_OK; pass++) {
        double share, points = (double)(f->rays - before) / (f->cones * f->cones);
        struct rn_lattice_census census = take_census(f, begin_pass(f, pass), &share);
        double unseen = pass == 1 ? (double)census.unseen / fmax(census.points, 1) : 0;
        if (pass == 1 || points >= LEAST_TIMED)
            point_ns = spent_ns / (points * (1 - unseen + MISS_COST * unseen));
        before = f->rays;
        began_ns = rn_clock_ns();
        double left_ns = share_of_pass(passes - pass) * (double)(f->late_ns - began_ns);
        f->lattice.tolerance = rn_lattice_tolerance_for(&census, share * left_ns / point_ns);
        f->tolerance = fmax(f->tolerance, (double)f->lattice.tolerance);
        status = render_pass(f, pass, poll, err);
        spent_ns = (double)(rn_clock_ns() - began_ns);
    }
    return status;
}

// Bands of BAND rows of cones on the device instead of tiles here: every pixel.
static enum rn_status render_bands(struct frame *f, struct poll *poll, struct rn_error *err) {
    int band = BAND / f->cones, width = f->camera.width;
    for (int row = 0; row < f->camera.height; row += band) {
        int rows = f->camera.height - row < band ? f->camera.height - row : band;
        uint64_t samples;
        if (must_stop(poll)) return stopped(err);
        if (is_late(f)) return too_late(err);
        enum rn_status status =
            rn_field_render_rows(f->field, &f->camera, &f->march, f->cones, row, rows,
                                 f->lattice.pixels + (size_t)row * width, &samples, err);
        if (status != RN_OK) return status;
        f->rays += (uint64_t)rows * width * f->cones * f->cones;
        f->samples += samples;
    }
    return RN_OK;
}

// What is asked for, as it is rendered.
static void init_frame(struct frame *f) {
    const struct rn_render_options *o = f->options;
    const struct rn_train_config *config = &f->field->config;
    int n = o->settings.subsample > 1 ? o->settings.subsample : 1;
    f->camera = rn_camera_resized(&o->camera, (o->camera.width + n - 1) / n,
                                  (o->camera.height + n - 1) / n);
    f->cones = o->settings.supersample > 0 ? o->settings.supersample
               : n > 1                     ? 1
                                           : rn_cones_for_camera(f->field, &f->camera);
    f->march.step =
        (float)(o->settings.step > 0 ? fmax(o->settings.step, config->step) : config->step);
    f->march.stop_depth = (float)-log(
        o->settings.stop > 0 ? o->settings.stop : fmax(config->stop, o->settings.tolerance));
    f->tolerance = o->deadline_ns ? TIMED_TOLERANCE : o->settings.tolerance;
    f->late_ns = o->deadline_ns
                     ? o->deadline_ns - (int64_t)(FILL_NS * o->camera.width * o->camera.height)
                     : 0;
    memcpy(f->march.background, o->background, sizeof f->march.background);
    f->march.straight = o->straight;
}

// Where pixels are several cones and may be interpolated, that is done between parts of pixels: a
// part beside an edge is traced, the rest of its pixel need not be.
static void init_lattice(struct frame *f) {
    const struct rn_render_options *o = f->options;
    size_t fine = 4 * (size_t)f->camera.width * (size_t)f->camera.height;
    f->points = f->tolerance > 0 && f->cones > 1 && !f->on_device && fine <= FINE_POINTS ? 2 : 1;
    f->cones /= f->points;
    f->camera =
        rn_camera_resized(&f->camera, f->points * f->camera.width, f->points * f->camera.height);
    f->lattice = (struct rn_lattice){.width = f->camera.width,
                                     .height = f->camera.height,
                                     .outputs = o->outputs,
                                     .tolerance = (float)f->tolerance,
                                     .dense = rn_lattice_is_dense(f->field, &f->camera)};
}

enum rn_status rn_render(struct rn_engine *engine, struct rn_field *field,
                         const struct rn_render_options *options, bool (*keep_going)(void *context),
                         void *context, struct rn_render_result *ret_result, struct rn_error *err) {
    int64_t begin = rn_clock_ns();
    struct rn_render_options checked = *options;
    enum rn_status status = check_options(&checked, err);
    if (status != RN_OK) return status;
    struct frame f = {.engine = engine, .field = field, .options = &checked};
    init_frame(&f);
    status = prepare(&f, err);
    if (status != RN_OK) return status;
    init_lattice(&f);
    size_t bytes = (size_t)f.camera.width * (size_t)f.camera.height * sizeof *f.lattice.pixels;
    f.lattice.pixels = malloc(bytes);
    if (!f.lattice.pixels)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "a %dx%d picture needs %zu MiB",
                            f.camera.width, f.camera.height, bytes >> 20);
    struct rn_render_result result = {0};
    struct poll poll = {keep_going, context, &f};
    status = (f.on_device ? render_bands : f.late_ns ? render_timed : render_tiles)(&f, &poll, err);
    if (status == RN_OK) status = fill_pictures(&f, &result, err);
    result.stats = (struct rn_render_stats){.cones = f.cones * f.points,
                                            .tolerance = f.on_device ? 0 : f.tolerance,
                                            .rays = f.rays,
                                            .samples = f.samples,
                                            .nonfinite_rays = f.nonfinite};
    free(f.lattice.pixels);
    if (status != RN_OK) {
        rn_render_result_finish(&result);
        return status;
    }
    result.stats.render_ms = (double)(rn_clock_ns() - begin) * 1e-6;
    *ret_result = result;
    return RN_OK;
}

int rn_render_cones(const struct rn_field *field, const struct rn_camera *camera) {
    return rn_cones_for_camera(field, camera);
}

void rn_render_result_finish(struct rn_render_result *result) {
    rn_picture_finish(&result->rgb);
    rn_picture_finish(&result->depth);
    rn_picture_finish(&result->alpha);
}
