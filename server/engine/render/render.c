// Rendering: tiles of rays, front to back, over the engine's threads.
#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "server/engine/effects/effects.h"
#include "server/engine/render/develop.h"
#include "server/engine/render/fill.h"
#include "server/engine/render/inspect.h"
#include "server/engine/render/silhouette.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"

#define TILE 16               // cones a side; a tile fills two packets
#define SPARSE 2              // times as many where a pass takes every second pixel a side
#define TIMED_CONES (1 << 18) // cones a device renders between two looks at the clock
#define BAND_CONES (1 << 20)  // between two looks at keep_going alone
#define TOGETHER (1 << 18)    // cones of pictures that a device traces in one call
#define SPREAD 4096           // points that a thread puts into the lattice at a time
#define FINE_POINTS (1 << 23) // of a lattice finer than the pixels, at most
#define LOOK_NS 4000000       // between two looks at keep_going
#define WHOLE_LEVELS 0.1      // tolerance above which a sample reads the nearest level alone
#define TIMED_TOLERANCE 1e-9  // of a frame by a deadline, until it is known what there is time for

// Points that a device is to trace, of all frames that it traces in one call, numbers of the first
// one's points and on; and what it made of them.
struct trace {
    uint32_t *listed;
    struct rn_pixel *traced;
    _Atomic uint32_t listed_count;
};

struct frame {
    struct rn_engine *engine;
    struct rn_field *field;
    struct rn_render_options options;
    struct rn_march_options march;
    struct rn_camera camera; // at the lattice's resolution
    int points;              // of the lattice, a side of a pixel
    int cones;               // a side of a point
    int tile;                // points a side
    int tiles_x, pass;
    struct rn_lattice lattice;
    struct rn_silhouette silhouette;
    struct rn_pixel nothing;          // what shows outside of it
    struct rn_viewpoints *viewpoints; // of a camera that is no pinhole at one instant; NULL
    struct rn_development development;
    bool on_device;   // the field's copy there has the levels
    double tolerance; // the largest of the passes
    int64_t late_ns;  // when tracing ends, to leave the rest of a deadline for filling; 0: never
    uint16_t *costs;  // of the lattice's points, where they are asked for
    int together;     // this frame and those behind it that the device traces in one call
    uint32_t first_point; // of theirs
    struct trace *trace;
    struct rn_occupancy_bits before, cells; // that the march reads: uncropped, and for this frame
    _Atomic uint64_t rays, samples;
    _Atomic uint64_t interpolation; // in 2^-32, so that it is the same in any order
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

// Points that nothing can be seen at are the background; the others stay in the list.
static int drop_empty(struct frame *f, struct rn_spot *spots, int n) {
    int kept = 0;
    for (int i = 0; i < n; i++) {
        struct rn_spot s = spots[i];
        if (rn_silhouette_covers(&f->silhouette, s.x, s.y))
            spots[kept++] = s;
        else
            f->lattice.pixels[(size_t)s.y * f->lattice.width + s.x] = f->nothing;
    }
    return kept;
}

// A tile that nothing can be seen in.
static void fill_empty_tile(struct frame *f, struct rn_tile tile) {
    int apart = rn_lattice_passes(&f->lattice) > 1 ? 2 : 1;
    if (f->pass > 0) return;
    for (int y = tile.y0; y < tile.y1; y++)
        for (int x = tile.x0; x < tile.x1; x++)
            f->lattice.pixels[(size_t)y * f->lattice.width + x] = f->nothing;
    int columns = (tile.x1 - tile.x0 + apart - 1) / apart;
    f->rays += (uint64_t)columns * ((tile.y1 - tile.y0 + apart - 1) / apart) * f->cones * f->cones;
}

// Whether anything can be seen in a tile.
static bool is_reached(const struct frame *f, struct rn_tile tile) {
    return rn_silhouette_reaches(&f->silhouette, tile.x0, tile.y0, tile.x1, tile.y1);
}

static void render_tile(void *context, int index, int thread) {
    struct frame *f = context;
    struct rn_tile tile = tile_at(f, index);
    if (!is_reached(f, tile)) {
        fill_empty_tile(f, tile);
        return;
    }
    struct rn_spot spots[TILE * TILE * SPARSE];
    struct rn_pixel pixels[TILE * TILE * SPARSE];
    uint16_t costs[TILE * TILE * SPARSE];
    struct rn_lattice lattice = f->lattice;
    lattice.late = is_late(f);
    double interpolation = 0;
    int n = rn_lattice_choose(&lattice, f->pass, tile, spots, &interpolation);
    if (isfinite(interpolation)) f->interpolation += (uint64_t)(interpolation * 0x1p32);
    f->rays += (uint64_t)n * f->cones * f->cones;
    n = drop_empty(f, spots, n);
    struct rn_cones cones = {f->engine, f->field, &f->march, &f->camera, f->viewpoints, f->cones};
    f->samples += rn_cones_render(&cones, spots, n, thread, pixels, f->costs ? costs : NULL);
    for (int i = 0; i < n; i++)
        f->lattice.pixels[(size_t)spots[i].y * lattice.width + spots[i].x] = pixels[i];
    for (int i = 0; i < n && f->costs; i++)
        f->costs[(size_t)spots[i].y * lattice.width + spots[i].x] = costs[i];
}

// A tile's points that the device is to trace.
static void list_tile(void *context, int index, int thread) {
    struct frame *f = context;
    struct rn_spot spots[TILE * TILE * SPARSE];
    struct rn_lattice lattice = f->lattice;
    lattice.late = is_late(f);
    double interpolation = 0;
    int n = rn_lattice_choose(&lattice, f->pass, tile_at(f, index), spots, &interpolation);
    if (isfinite(interpolation)) f->interpolation += (uint64_t)(interpolation * 0x1p32);
    f->rays += (uint64_t)n * f->cones * f->cones;
    uint32_t first = atomic_fetch_add(&f->trace->listed_count, (uint32_t)n);
    for (int i = 0; i < n; i++)
        f->trace->listed[first + i] =
            f->first_point + (uint32_t)(spots[i].y * lattice.width + spots[i].x);
    (void)thread;
}

static void put_traced(void *context, int index, int thread) {
    struct frame *f = context;
    const struct trace *t = f->trace;
    uint32_t begin = (uint32_t)index * SPREAD, end = begin + SPREAD;
    for (uint32_t i = begin; i < end && i < t->listed_count; i++)
        f->lattice.pixels[t->listed[i]] = t->traced[i];
    (void)thread;
}

static enum rn_status check_options(const struct rn_field *field, struct rn_render_options *o,
                                    struct rn_error *err) {
    enum rn_status status = rn_camera_check(&o->camera, "camera", err);
    if (status != RN_OK) return status;
    if (!(o->outputs & RN_OUTPUTS_ALL))
        return rn_error_set(err, RN_ERROR_INVALID, "output", "must be one of those there are");
    if (o->outputs & RN_OUTPUTS_OF_SURFACES && rn_shot_needs_viewpoints(&o->shot))
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "output",
                            "normals, levels and footprints are of a pinhole's picture: leave out "
                            "aperture, shutter and parallel rays");
    o->outputs |= rn_inspect_needs(o->outputs);
    status = rn_settings_check(&rn_render_settings, &o->settings, err);
    return status ? status : rn_shot_check(&o->shot, &o->camera, field, err);
}

// Pyramid levels that this camera may touch; the training's own when rays are shorter.
static int levels_of(const struct frame *f) {
    struct rn_camera cones =
        rn_camera_resized(&f->camera, f->camera.width * f->cones, f->camera.height * f->cones);
    const struct rn_shot *shot = &f->options.shot;
    int levels = rn_levels_for_camera(f->field, &cones, (double)f->march.step);
    for (int i = 0; i < shot->instant_count && shot->optics.shutter > 0; i++) {
        struct rn_camera then = rn_shot_camera(shot, &shot->instants[i], f->field);
        then = rn_camera_resized(&then, cones.width, cones.height);
        int more = rn_levels_for_camera(f->field, &then, (double)f->march.step);
        if (more > levels) levels = more;
    }
    return levels;
}

// Whether the device's copy can make what is asked for, of a frame with so many levels.
static bool is_for_device(const struct frame *f, int levels) {
    const struct rn_render_options *o = &f->options;
    bool looks_inside = (o->outputs & (RN_OUTPUT_COST | RN_OUTPUTS_OF_SURFACES)) != 0;
    return f->field->on_device && levels <= f->field->device_levels &&
           !rn_shot_needs_viewpoints(&o->shot) && !looks_inside && !o->crop && !o->appearance.own;
}

// Cells that the march reads, on the CPU or on the device.
static void choose_cells(struct frame *f, int levels) {
    rn_field_choose_cells(f->field, levels, exp(-(double)f->march.stop_depth));
    f->before = f->cells = f->field->cpu.occupancy;
}

static enum rn_status prepare(struct frame *f, struct rn_error *err) {
    int levels = levels_of(f);
    enum rn_status status =
        f->field->rests ? rn_field_put_to_render(f->engine, f->field, err) : RN_OK;
    if (status != RN_OK) return status;
    f->on_device = is_for_device(f, levels);
    if (!f->on_device) status = rn_field_fetch(f->field, NULL, err);
    if (!f->on_device && status == RN_OK)
        status = rn_field_make_ready(f->field, f->engine, levels, err);
    if (status == RN_OK) choose_cells(f, levels);
    if (status != RN_OK || !f->options.crop) return status;
    status = rn_occupancy_bits_crop(f->field, f->options.crop, &f->cells);
    if (status != RN_OK) return rn_error_set(err, status, "crop", "no memory for its cells");
    f->field->cpu.occupancy = f->cells;
    return RN_OK;
}

// What the march reads is no longer cut off.
static void put_back(struct frame *f) {
    if (f->on_device || !f->options.crop) return;
    f->field->cpu.occupancy = f->before;
    rn_occupancy_bits_destroy(&f->cells);
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
    struct frame *frame;
    int64_t look_ns; // when the next look is due
};

// Whoever is asked may render the field meanwhile, as it likes, over the same threads: never asked
// in the midst of a run of theirs.
static bool must_stop(void *context) {
    const struct poll *poll = context;
    struct frame *f = poll->frame;
    bool stop = poll->keep_going && !poll->keep_going(poll->context);
    f->field->cpu.occupancy = f->cells;
    return stop;
}

// The frame's pass, and how many tiles it has.
static int begin_pass(struct frame *f, int pass) {
    f->pass = pass;
    f->tile = (rn_lattice_passes(&f->lattice) > 1 ? SPARSE : 1) * TILE / f->cones;
    f->tiles_x = (f->camera.width + f->tile - 1) / f->tile;
    return f->tiles_x * ((f->camera.height + f->tile - 1) / f->tile);
}

static bool is_time_to_look(void *context) {
    return rn_clock_ns() >= ((const struct poll *)context)->look_ns;
}

// Points of the frames' lattices on the device; given up at `late_ns`, if that is not 0.
static enum rn_status trace_there(struct frame *f, const uint32_t *numbers, size_t count,
                                  struct poll *poll, int64_t late_ns, struct rn_pixel *ret,
                                  struct rn_error *err) {
    struct rn_camera cameras[RN_DEVICE_CAMERAS];
    for (int i = 0; i < f->together; i++)
        cameras[i] = f[i].camera;
    const struct rn_device_view view = {.cameras = cameras,
                                        .camera_count = f->together,
                                        .cones = f->cones,
                                        .halves = !(f->options.outputs & RN_OUTPUT_DEPTH)};
    size_t cones = (size_t)(f->cones * f->cones);
    size_t band = (size_t)(f->late_ns ? TIMED_CONES : BAND_CONES) / cones;
    for (size_t at = 0; at < count; at += band) {
        struct rn_device_places places = {.numbers = numbers ? numbers + at : NULL,
                                          .first = (uint32_t)at,
                                          .count = count - at < band ? count - at : band};
        uint64_t samples;
        if (must_stop(poll)) return stopped(err);
        if (late_ns && rn_clock_ns() >= late_ns) return too_late(err);
        enum rn_status status =
            rn_cones_render_there(f->field, &f->march, &view, &places, ret + at, &samples, err);
        if (status != RN_OK) return status;
        f->samples += samples;
    }
    return RN_OK;
}

// A pass whose points the device traces: all of them as they lie, or the tiles' lists.
static enum rn_status render_pass_there(struct frame *f, int pass, struct poll *poll,
                                        int64_t late_ns, struct rn_error *err) {
    size_t all = (size_t)f->lattice.width * (size_t)f->lattice.height;
    struct trace *t = f->trace;
    if (rn_lattice_passes(&f->lattice) == 1) {
        for (int i = 0; i < f->together; i++)
            f[i].rays = (uint64_t)all * (uint64_t)(f->cones * f->cones);
        return trace_there(f, NULL, (size_t)f->together * all, poll, late_ns, f->lattice.pixels,
                           err);
    }
    t->listed_count = 0;
    for (int i = 0; i < f->together; i++)
        rn_pool_run(f->engine->pool, begin_pass(&f[i], pass), list_tile, &f[i]);
    enum rn_status status =
        trace_there(f, t->listed, t->listed_count, poll, late_ns, t->traced, err);
    if (status == RN_OK)
        rn_pool_run(f->engine->pool, (int)(t->listed_count / SPREAD + 1), put_traced, f);
    return status;
}

// All tiles of a pass, over the engine's threads; given up at `late_ns`, if that is not 0.
static enum rn_status render_pass(struct frame *f, int pass, struct poll *poll, int64_t late_ns,
                                  struct rn_error *err) {
    int tiles = begin_pass(f, pass), next = 0;
    if (f->on_device) return render_pass_there(f, pass, poll, late_ns, err);
    for (;;) {
        if (must_stop(poll)) return stopped(err);
        int64_t now_ns = rn_clock_ns();
        if (late_ns && now_ns >= late_ns) return too_late(err);
        poll->look_ns = poll->keep_going ? now_ns + LOOK_NS : INT64_MAX;
        if (late_ns && late_ns < poll->look_ns) poll->look_ns = late_ns;
        if (rn_pool_run_some(f->engine->pool, tiles, &next, render_tile, f, is_time_to_look, poll))
            return RN_OK;
    }
}

static enum rn_status render_tiles(struct frame *f, struct poll *poll, struct rn_error *err) {
    enum rn_status status = RN_OK;
    int passes = rn_lattice_passes(&f->lattice);
    for (int pass = 0; pass < passes && status == RN_OK; pass++)
        status = render_pass(f, pass, poll, 0, err);
    return status;
}

// ---- by a deadline --------------------------------------------------------------------------

#define GROWTH 1.5      // of the points traced from pass to pass, about
#define SPEND 0.95      // of the time left, what is planned for
#define FILL_NS 4.0     // of a picture's pixel, for one thread
#define ENLARGE_NS 8.0  // the same where it is enlarged
#define LEAST_TIMED 256 // points, for their time to say what the next ones take
#define CENSUS 4000     // points that a census asks, about

// What points of the frame's next pass there are, from some of its tiles; `ret_share` of all. In
// tiles that nothing can be seen in none is traced.
static struct rn_lattice_census take_census(const struct frame *f, int tiles, double *ret_share) {
    struct rn_lattice_census census = {0};
    int apart = tiles * TILE * TILE / CENSUS, taken = 0;
    for (int i = 0; i < tiles; i += 1 + apart, taken++) {
        uint32_t empty = census.empty;
        rn_lattice_count(&f->lattice, f->pass, tile_at(f, i), &census);
        if (!is_reached(f, tile_at(f, i))) census.empty = empty;
    }
    *ret_share = (double)taken / tiles;
    return census;
}

// Of the time left, what the pass may take when so many more come, each of which traces more.
static double share_of_pass(int passes_left) {
    double all = 0;
    for (int i = 0; i < passes_left; i++)
        all += pow(GROWTH, i);
    return SPEND / all;
}

// Each pass tells what a point that sees something costs here and now; of the next one as many are
// traced as there is time for, those first whose neighbours disagree most.
static enum rn_status render_timed(struct frame *f, struct poll *poll, struct rn_error *err) {
    int passes = rn_lattice_passes(&f->lattice);
    int64_t began_ns = rn_clock_ns();
    // The first pass is traced whole: all the others can be made from it.
    enum rn_status status = render_pass(f, 0, poll, f->options.first_ns, err);
    double point_ns = 0, spent_ns = (double)(rn_clock_ns() - began_ns), missed = 0;
    uint64_t before = 0;
    for (int pass = 1; pass < passes && status == RN_OK; pass++) {
        double share, points = (double)(f->rays - before) / (f->cones * f->cones);
        struct rn_lattice_census census = take_census(f, begin_pass(f, pass), &share);
        if (pass == 1) missed = points * census.unseen / fmax(census.points, 1);
        points -= (1 - RN_LATTICE_MISS) * fmin(missed, points);
        if (pass == 1 || points >= LEAST_TIMED) point_ns = spent_ns / points;
        missed = census.empty / share;
        before = f->rays;
        began_ns = rn_clock_ns();
        double left_ns = share_of_pass(passes - pass) * (double)(f->late_ns - began_ns);
        f->lattice.earlier = pass == 1 ? 0 : is_late(f) ? 1 : f->lattice.tolerance;
        f->lattice.tolerance = rn_lattice_tolerance_for(&census, share * left_ns / point_ns);
        f->tolerance = fmax(f->tolerance, (double)f->lattice.tolerance);
        status = render_pass(f, pass, poll, 0, err);
        spent_ns = (double)(rn_clock_ns() - began_ns);
    }
    return status;
}

static enum rn_status fill_pictures(struct frame *f, struct rn_render_result *result,
                                    struct rn_error *err) {
    struct rn_filling filling = {.lattice = &f->lattice,
                                 .points = f->points,
                                 .straight = f->march.straight ? f->march.colour.background : NULL,
                                 .options = &f->options,
                                 .radius = f->field->bounds.radius};
    return rn_fill_pictures(f->engine, &filling, result, err);
}

// The outputs that colour, depth and opacity do not tell.
static enum rn_status inspect(struct frame *f, struct rn_render_result *result,
                              struct rn_error *err) {
    if (!(f->options.outputs & (RN_OUTPUT_COST | RN_OUTPUTS_OF_SURFACES))) return RN_OK;
    struct rn_inspection inspection = {.engine = f->engine,
                                       .field = f->field,
                                       .options = &f->options,
                                       .lattice = &f->lattice,
                                       .costs = f->costs,
                                       .points = f->points,
                                       .cones = f->cones * f->points,
                                       .step = (double)f->march.step};
    return rn_inspect(&inspection, result, err);
}

// What is kept of a deadline to make pictures of the lattice.
static int64_t fill_ns(const struct frame *f) {
    const struct rn_render_options *o = &f->options;
    double pixels = (double)o->camera.width * o->camera.height;
    double pixel_ns = o->settings.subsample > 1 ? ENLARGE_NS : FILL_NS;
    return (int64_t)(pixels * pixel_ns / rn_pool_threads(f->engine->pool));
}

// What is asked for, as it is rendered.
static void init_frame(struct frame *f) {
    const struct rn_render_options *o = &f->options;
    const struct rn_train_config *config = &f->field->config;
    int n = o->settings.subsample > 1 ? o->settings.subsample : 1;
    f->camera = rn_shot_camera(&o->shot, &o->camera, f->field);
    f->camera = rn_camera_resized(&f->camera, (o->camera.width + n - 1) / n,
                                  (o->camera.height + n - 1) / n);
    f->cones = o->settings.supersample > 0 ? o->settings.supersample
               : n > 1                     ? 1
                                           : rn_cones_for_camera(f->field, &f->camera);
    if (rn_optics_spreads(&o->shot.optics) && !o->settings.supersample && n == 1 &&
        f->cones < RN_OPTICS_CONES)
        f->cones = RN_OPTICS_CONES;
    f->development = rn_development_of(o->shot.optics.exposure, o->shot.optics.white_balance);
    rn_development_expose(&f->development, o->shot.gain);
    f->march = rn_effects_march_pictures(f->field);
    f->march.step = (float)fmax(o->settings.step, (double)f->march.step);
    f->march.stop_depth = (float)-log(
        o->settings.stop > 0 ? o->settings.stop : fmax(config->stop, o->settings.tolerance));
    f->tolerance = o->deadline_ns ? TIMED_TOLERANCE : o->settings.tolerance;
    f->late_ns = o->deadline_ns ? o->deadline_ns - fill_ns(f) : 0;
    memcpy(f->march.colour.background, o->background, sizeof f->march.colour.background);
    f->march.straight = o->straight;
    if (o->appearance.own) f->march.appearances = o->appearance.code;
    f->march.whole_levels = o->settings.tolerance > WHOLE_LEVELS;
}

// Where pixels are several cones and may be interpolated, that is done between parts of pixels: a
// part beside an edge is traced, the rest of its pixel need not be.
static void init_lattice(struct frame *f) {
    const struct rn_render_options *o = &f->options;
    size_t fine = 4 * (size_t)f->camera.width * (size_t)f->camera.height;
    bool finer = f->tolerance > 0 && f->cones > 1 && !rn_optics_spreads(&o->shot.optics);
    f->points = finer && fine <= FINE_POINTS ? 2 : 1;
    f->cones /= f->points;
    f->camera =
        rn_camera_resized(&f->camera, f->points * f->camera.width, f->points * f->camera.height);
    f->lattice = (struct rn_lattice){.width = f->camera.width,
                                     .height = f->camera.height,
                                     .outputs = o->outputs,
                                     .tolerance = (float)f->tolerance,
                                     .dense = rn_lattice_is_dense(f->field, &f->camera)};
}

// Room for a pass on the device: half of the points at most, as all but one take every second.
static enum rn_status make_room_there(struct frame *f, struct rn_error *err) {
    size_t most = ((size_t)f->lattice.width + 1) / 2 * (size_t)f->lattice.height;
    struct trace *t = f->trace;
    if (!f->on_device || rn_lattice_passes(&f->lattice) == 1) return RN_OK;
    most *= (size_t)f->together;
    t->listed = malloc(most * sizeof *t->listed);
    t->traced = malloc(most * sizeof *t->traced);
    if (t->listed && t->traced) return RN_OK;
    return rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "no memory");
}

// The lattices' pixels, one behind the other.
static enum rn_status make_lattices(struct frame *f, struct rn_error *err) {
    int width = f->camera.width, height = f->camera.height;
    size_t points = (size_t)width * (size_t)height, bytes = points * sizeof *f->lattice.pixels;
    struct rn_pixel *pixels = malloc((size_t)f->together * bytes);
    if (!pixels)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "a %dx%d picture needs %zu MiB",
                            width, height, bytes >> 20);
    for (int i = 0; i < f->together; i++) {
        f[i].first_point = (uint32_t)((size_t)i * points);
        f[i].lattice.pixels = pixels + (size_t)i * points;
    }
    return RN_OK;
}

// Takes the lattices' pixels, their costs and the places that cones are seen from.
static enum rn_status make_room(struct frame *f, struct rn_error *err) {
    const struct rn_render_options *o = &f->options;
    int width = f->camera.width, height = f->camera.height;
    enum rn_status status = make_lattices(f, err);
    if (status != RN_OK) return status;
    if (o->outputs & RN_OUTPUT_COST) {
        f->costs = calloc((size_t)width * (size_t)height, sizeof *f->costs);
        if (!f->costs) return rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "no memory");
    }
    if (!rn_shot_needs_viewpoints(&o->shot)) return make_room_there(f, err);
    f->viewpoints =
        rn_viewpoints_create(&o->shot, &o->camera, f->field, width * f->cones, height * f->cones);
    return f->viewpoints ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "no memory");
}

// What a pixel is whose cones meet nothing, as rn_cones_render would have it.
static struct rn_pixel pixel_of_nothing(const struct frame *f) {
    const float *background = f->march.colour.background;
    struct rn_pixel cones[RN_CONES_BLOCK];
    int n = f->cones;
    for (int i = 0; i < n * n; i++)
        cones[i] = (struct rn_pixel){{background[0], background[1], background[2]}, 0, 0};
    return n == 1 ? cones[0] : rn_cones_mean(cones, n, f->march.straight ? background : NULL);
}

static void develop_row(void *context, int index, int thread) {
    struct frame *f = context;
    struct rn_pixel *row = f->lattice.pixels + (size_t)index * f->lattice.width;
    (void)thread;
    for (struct rn_pixel *p = row; p < row + f->lattice.width; p++)
        rn_develop(&f->development, p->alpha, f->march.colour.background, p->rgb);
}

// ---- one frame, or several together ---------------------------------------------------------

_Static_assert(RN_RENDER_TOGETHER == RN_DEVICE_CAMERAS, "all go to the backend");

static enum rn_status begin_frame(struct frame *f, struct rn_engine *engine, struct rn_field *field,
                                  const struct rn_render_options *options, struct rn_error *err) {
    *f = (struct frame){.engine = engine, .field = field, .options = *options, .together = 1};
    enum rn_status status = check_options(field, &f->options, err);
    if (status == RN_OK) init_frame(f);
    return status;
}

// How many such frames a device traces in one call.
static int count_together(const struct frame *f) {
    double cones = (double)f->camera.width * f->camera.height * f->cones * f->cones;
    bool one = f->late_ns || f->options.crop || rn_shot_needs_viewpoints(&f->options.shot);
    return one ? 1 : (int)fmin(fmax(TOGETHER / cones, 1), RN_DEVICE_CAMERAS);
}

// Another frame beside `first`, which the device makes; false: it cannot be traced with it.
static bool join(struct frame *f, const struct frame *first,
                 const struct rn_render_options *options) {
    const struct rn_render_options *o = &f->options;
    const float *one = first->options.background, *other = o->background;
    struct rn_error unused; // its own turn tells
    if (begin_frame(f, first->engine, first->field, options, &unused) != RN_OK) return false;
    int cones = f->cones, levels = levels_of(f);
    if (!(f->on_device = is_for_device(f, levels)) || count_together(f) == 1) return false;
    init_lattice(f);
    choose_cells(f, levels);
    return f->cells.words == first->cells.words && cones == first->cones * first->points &&
           f->camera.width == first->camera.width && f->camera.height == first->camera.height &&
           o->outputs == first->options.outputs && o->straight == first->options.straight &&
           one[0] == other[0] && one[1] == other[1] && one[2] == other[2] &&
           f->tolerance == first->tolerance && f->march.step == first->march.step &&
           f->march.stop_depth == first->march.stop_depth;
}

// Pictures of what was traced.
static enum rn_status finish_frame(struct frame *f, struct rn_render_result *result,
                                   struct rn_error *err) {
    if (f->development.on) rn_pool_run(f->engine->pool, f->lattice.height, develop_row, f);
    enum rn_status status = fill_pictures(f, result, err);
    if (status == RN_OK) status = inspect(f, result, err);
    result->stats.cones = f->cones * f->points;
    result->stats.tolerance = f->tolerance;
    result->stats.rays = f->rays;
    result->stats.samples = f->samples;
    result->stats.interpolation =
        (double)f->interpolation * 0x1p-32 / ((double)f->lattice.width * f->lattice.height);
    result->stats.on_device = f->on_device;
    return status;
}

// Traces them all, then makes their pictures in turn.
static enum rn_status make_frames(struct frame *f, bool (*keep_going)(void *context), void *context,
                                  struct rn_render_result *results, struct rn_error *err) {
    struct poll poll = {.keep_going = keep_going, .context = context, .frame = f};
    enum rn_status status = make_room(f, err);
    if (status == RN_OK && !f->on_device && !f->viewpoints) {
        rn_silhouette_init(f->engine, f->field, &f->camera, &f->silhouette);
        f->nothing = pixel_of_nothing(f);
    }
    if (status == RN_OK) status = (f->late_ns ? render_timed : render_tiles)(f, &poll, err);
    uint64_t samples = f->samples / (uint64_t)f->together;
    for (int i = 0; i < f->together && status == RN_OK; i++) {
        f[i].samples = samples;
        status = finish_frame(&f[i], &results[i], err);
    }
    return status;
}

// As many frames as f->together says are ready; nothing of them is left.
static enum rn_status run_frames(struct frame *f, int64_t begin_ns, bool (*keep_going)(void *),
                                 void *context, struct rn_render_result *ret_results,
                                 struct rn_error *err) {
    struct rn_render_result results[RN_DEVICE_CAMERAS] = {0};
    struct trace trace = {0};
    f->trace = &trace;
    for (int i = 1; i < f->together; i++)
        f[i].trace = &trace;
    enum rn_status status = make_frames(f, keep_going, context, results, err);
    put_back(f);
    free(f->lattice.pixels);
    rn_viewpoints_destroy(&f->viewpoints);
    rn_silhouette_finish(&f->silhouette);
    free(f->costs);
    free(trace.listed);
    free(trace.traced);
    double each_ms = (double)(rn_clock_ns() - begin_ns) * 1e-6 / f->together;
    for (int i = 0; i < f->together; i++) {
        results[i].stats.render_ms = each_ms;
        if (status == RN_OK)
            ret_results[i] = results[i];
        else
            rn_render_result_finish(&results[i]);
    }
    return status;
}

// A frame that is rendered by itself, or the first of some.
static enum rn_status ready_first(struct frame *f, struct rn_engine *engine, struct rn_field *field,
                                  const struct rn_render_options *options, struct rn_error *err) {
    enum rn_status status = begin_frame(f, engine, field, options, err);
    if (status == RN_OK) status = prepare(f, err);
    if (status == RN_OK) init_lattice(f);
    return status;
}

enum rn_status rn_render(struct rn_engine *engine, struct rn_field *field,
                         const struct rn_render_options *options, bool (*keep_going)(void *context),
                         void *context, struct rn_render_result *ret_result, struct rn_error *err) {
    int64_t begin_ns = rn_clock_ns();
    struct frame f;
    enum rn_status status = ready_first(&f, engine, field, options, err);
    return status ? status : run_frames(&f, begin_ns, keep_going, context, ret_result, err);
}

int rn_render_fit(struct rn_engine *engine, struct rn_field *field,
                  const struct rn_render_options *options) {
    struct frame f;
    struct rn_error unused;
    if (!engine->backend || begin_frame(&f, engine, field, options, &unused)) return 1;
    return count_together(&f);
}

enum rn_status rn_render_together(struct rn_engine *engine, struct rn_field *field,
                                  const struct rn_render_options *options, int count,
                                  bool (*keep_going)(void *context), void *context,
                                  struct rn_render_result *ret_results, int *ret_count,
                                  struct rn_error *err) {
    int64_t begin_ns = rn_clock_ns();
    struct frame *f = malloc((size_t)count * sizeof *f);
    if (!f) return rn_error_set(err, RN_ERROR_NO_MEMORY, "camera", "out of memory");
    enum rn_status status = ready_first(f, engine, field, options, err);
    int most = status == RN_OK && f->on_device ? count_together(f) : 1;
    while (f->together < count && f->together < most &&
           join(&f[f->together], f, &options[f->together]))
        f->together++;
    if (status == RN_OK) status = run_frames(f, begin_ns, keep_going, context, ret_results, err);
    if (status == RN_OK) *ret_count = f->together;
    free(f);
    return status;
}

int rn_render_cones(const struct rn_field *field, const struct rn_camera *camera) {
    return rn_cones_for_camera(field, camera);
}

void rn_render_result_finish(struct rn_render_result *result) {
    rn_picture_finish(&result->rgb);
    rn_picture_finish(&result->depth);
    rn_picture_finish(&result->alpha);
    rn_picture_finish(&result->normal);
    rn_picture_finish(&result->cost);
    rn_picture_finish(&result->level);
    rn_picture_finish(&result->footprint);
}
