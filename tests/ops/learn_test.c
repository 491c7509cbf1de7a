// What training makes of photographs: what it carves away, backgrounds and smoothing in their time,
// a field that has learnt and is rendered in all ways.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/field/voxels.h"
#include "server/engine/scene/occupancy.h"
#include "tests/ops/train_scene.h"

static struct rn_render_result render(struct rn_engine *engine, struct rn_field *field,
                                      struct rn_camera camera, struct rn_render_options options) {
    struct rn_error err;
    struct rn_render_result result;
    options.camera = camera;
    ck_assert_msg(rn_render(engine, field, &options, NULL, NULL, &result, &err) == RN_OK, "%s",
                  err.text);
    return result;
}

static struct rn_render_result render_all(struct rn_engine *engine, struct rn_field *field,
                                          struct rn_camera camera, int supersample) {
    struct rn_render_options options = {.background = {1, 1, 1},
                                        .settings.supersample = supersample};
    options.outputs = RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA;
    return render(engine, field, camera, options);
}

static void finish_three(struct rn_render_result *a, struct rn_render_result *b,
                         struct rn_render_result *c) {
    rn_render_result_finish(a);
    rn_render_result_finish(b);
    rn_render_result_finish(c);
}

// `given` is `fine` averaged over n x n pixels, depths by their opacity. Worst difference.
static double averaging_error(const struct rn_render_result *given,
                              const struct rn_render_result *fine, int n) {
    double worst = 0;
    int width = given->rgb.width, height = given->rgb.height;
    ck_assert_int_eq(fine->rgb.width, width * n);
    for (int i = 0; i < width * height; i++) {
        double rgb[3] = {0, 0, 0}, alpha = 0, depth = 0;
        for (int j = 0; j < n * n; j++) {
            int at = (i / width * n + j / n) * width * n + i % width * n + j % n;
            for (int c = 0; c < 3; c++)
                rgb[c] += (double)fine->rgb.values[3 * at + c] / (n * n);
            alpha += (double)fine->alpha.values[at] / (n * n);
            depth += (double)fine->depth.values[at] * (double)fine->alpha.values[at] / (n * n);
        }
        for (int c = 0; c < 3; c++)
            worst = fmax(worst, fabs(rgb[c] - (double)given->rgb.values[3 * i + c]));
        worst = fmax(worst, fabs(alpha - (double)given->alpha.values[i]));
        worst = fmax(worst, fabs(depth - alpha * (double)given->depth.values[i]));
    }
    return worst;
}

// A pixel of several cones is their mean; a view of the finest scale takes one cone a pixel, one
// with pixels k times as wide k by k.
static void check_supersampling(struct rn_engine *engine, struct rn_field *field,
                                const struct rn_frame *finest) {
    struct rn_camera camera = finest->camera;
    struct rn_render_result fine = render_all(engine, field, camera, 0);
    ck_assert_int_eq(fine.stats.cones, 1);
    for (int n = 2; n <= 4; n *= 2) {
        struct rn_camera coarse = rn_camera_resized(&camera, camera.width / n, camera.height / n);
        struct rn_render_result mean = render_all(engine, field, coarse, 0);
        struct rn_render_result given = render_all(engine, field, coarse, n);
        struct rn_render_result one = render_all(engine, field, coarse, 1);
        ck_assert_int_eq(mean.stats.cones, n);
        ck_assert_uint_eq(mean.stats.rays, fine.stats.rays);
        ck_assert(averaging_error(&mean, &fine, n) < 1e-5);
        ck_assert(averaging_error(&given, &mean, 1) == 0);
        ck_assert(averaging_error(&one, &fine, n) > 1e-3); // else this test shows nothing
        finish_three(&mean, &given, &one);
    }
    rn_render_result_finish(&fine);
}

static struct rn_render_result render_quickly(struct rn_field *field, const struct rn_frame *frame,
                                              struct rn_render_options options, int threads) {
    struct rn_engine *engine = engine_with(threads);
    struct rn_render_result result = render(engine, field, frame->camera, options);
    rn_engine_destroy(&engine);
    return result;
}

// With a tolerance fewer rays are traced, on any number of threads the same; the more, the nearer
// to the full picture, which none at all gives.
static void check_tolerance(struct rn_field *field, const struct rn_frame *frame) {
    struct rn_render_options options = {.outputs = RN_OUTPUT_RGB, .background = {1, 1, 1}};
    struct rn_render_result full = render_quickly(field, frame, options, 2);
    size_t count = (size_t)full.rgb.width * (size_t)full.rgb.height * 3;
    double last = 0;
    ck_assert_uint_eq(full.stats.rays, count / 3);
    for (double tolerance = 0.01; tolerance < 0.2; tolerance *= 3) {
        options.settings.tolerance = tolerance;
        struct rn_render_result one = render_quickly(field, frame, options, 1);
        struct rn_render_result two = render_quickly(field, frame, options, 2);
        double squares = 0;
        for (size_t i = 0; i < count; i++)
            squares += pow((double)full.rgb.values[i] - (double)one.rgb.values[i], 2);
        double off = sqrt(squares / (double)count);
        printf("tolerance %.2f: %.3f of the rays, %.4f from the full picture\n", tolerance,
               (double)one.stats.rays / (double)full.stats.rays, off);
        ck_assert(memcmp(one.rgb.values, two.rgb.values, count * sizeof(float)) == 0);
        ck_assert_uint_eq(one.stats.rays, two.stats.rays);
        ck_assert(one.stats.rays < full.stats.rays && one.stats.samples < full.stats.samples);
        ck_assert(2 * one.stats.rays > full.stats.rays); // cells are narrower than pixels here
        ck_assert(off > last && off < tolerance);
        last = off;
        rn_render_result_finish(&one);
        rn_render_result_finish(&two);
    }
    // Eight times the pixels a side are narrower than occupancy cells: emptiness is believed.
    struct rn_frame fine = *frame;
    fine.camera = rn_camera_resized(&frame->camera, 8 * full.rgb.width, 8 * full.rgb.height);
    options.settings.tolerance = 0.03;
    struct rn_render_result dense = render_quickly(field, &fine, options, 2);
    double share = (double)dense.stats.rays / (64 * (double)(count / 3));
    printf("eight times as fine: %.3f of the rays\n", share);
    ck_assert(share > 0.25 && share < 0.5);
    rn_render_result_finish(&dense);
    rn_render_result_finish(&full);
}

// Of a field that has learnt a sphere: what a pixel cost, and what its surface is like. Looking
// changes no pixel.
static void check_inspection(struct rn_field *field, const struct rn_frame *frame) {
    const unsigned inside =
        RN_OUTPUT_NORMAL | RN_OUTPUT_COST | RN_OUTPUT_LEVEL | RN_OUTPUT_FOOTPRINT;
    struct rn_render_options options = {
        .outputs = RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA, .background = {1, 1, 1}};
    for (int cones = 1; cones <= 2; cones++) {
        options.settings.supersample = cones;
        options.settings.tolerance = cones == 2 ? 0.05 : 0;
        options.outputs &= ~inside;
        struct rn_render_result plain = render_quickly(field, frame, options, 2);
        options.outputs |= inside;
        struct rn_render_result seen = render_quickly(field, frame, options, 2);
        int width = plain.rgb.width, count = width * plain.rgb.height, surfaces = 0;
        double cost = 0, along = 0, cone = rn_camera_cone(&frame->camera) / cones;
        ck_assert(memcmp(plain.rgb.values, seen.rgb.values, 3 * (size_t)count * sizeof(float)) ==
                  0);
        ck_assert_ptr_null(plain.cost.values);
        ck_assert_uint_eq(plain.stats.samples, seen.stats.samples);
        for (int i = 0; i < count; i++) {
            const float *n = seen.normal.values + 3 * (ptrdiff_t)i;
            double size = 0, towards = 0, far = 0, distance = (double)seen.depth.values[i];
            cost += (double)seen.cost.values[i];
            if (seen.footprint.values[i] == 0) continue;
            struct rn_ray ray = rn_camera_ray(&frame->camera, i % width + 0.5, i / width + 0.5);
            ck_assert_double_eq_tol((double)seen.footprint.values[i], 2 * cone * distance,
                                    0.02 * cone * distance);
            ck_assert(seen.level.values[i] >= 0 && seen.level.values[i] < RN_MAX_LEVELS);
            for (int k = 0; k < 3; k++) { // the sphere is around the origin
                size += pow((double)n[k], 2);
                double at = ray.origin[k] + ray.direction[k] * distance;
                towards += (double)n[k] * at;
                far += at * at;
            }
            if (size == 0) continue;
            ck_assert_double_eq_tol(size, 1, 1e-5);
            along += towards / sqrt(far);
            surfaces++;
        }
        printf("%d cones: %d surfaces, normals along the sphere's by %.3f\n", cones, surfaces,
               along / surfaces);
        ck_assert_double_eq(cost, (double)seen.stats.samples);
        ck_assert_int_gt(surfaces, count / 10);
        ck_assert_double_gt(along / surfaces, 0.5); // after 50 steps
        rn_render_result_finish(&plain);
        rn_render_result_finish(&seen);
    }
}

// Pixels of several cones are interpolated by parts: not whole pixels' rays, nearer to the full
// picture than the tolerance, on any number of threads the same.
static void check_parts(struct rn_field *field, const struct rn_frame *frame) {
    struct rn_render_options options = {.outputs = RN_OUTPUT_RGB | RN_OUTPUT_ALPHA,
                                        .background = {1, 1, 1}};
    for (int cones = 2; cones <= 4; cones *= 2) {
        struct rn_frame given = *frame;
        given.camera = rn_camera_resized(&frame->camera, frame->camera.width / cones,
                                         frame->camera.height / cones);
        options.settings.supersample = cones;
        options.settings.tolerance = 0;
        struct rn_render_result full = render_quickly(field, &given, options, 2);
        options.settings.tolerance = 0.05;
        struct rn_render_result one = render_quickly(field, &given, options, 1);
        struct rn_render_result two = render_quickly(field, &given, options, 2);
        size_t count = (size_t)given.camera.width * (size_t)given.camera.height * 3;
        double squares = 0, alpha = 0;
        for (size_t i = 0; i < count; i++)
            squares += pow((double)full.rgb.values[i] - (double)one.rgb.values[i], 2);
        for (size_t i = 0; i < count / 3; i++)
            alpha += pow((double)full.alpha.values[i] - (double)one.alpha.values[i], 2);
        printf("%d cones, tolerance 0.05: %.3f of the rays, %.4f from the full picture\n", cones,
               (double)one.stats.rays / (double)full.stats.rays, sqrt(squares / (double)count));
        ck_assert_uint_eq(full.stats.rays, count / 3 * (size_t)(cones * cones));
        ck_assert_int_eq(one.stats.cones, cones);
        ck_assert(one.stats.rays < full.stats.rays);
        ck_assert(sqrt(squares / (double)count) < 0.05 && sqrt(alpha / (double)count * 3) < 0.05);
        ck_assert(memcmp(one.rgb.values, two.rgb.values, count * sizeof(float)) == 0);
        ck_assert(memcmp(one.alpha.values, two.alpha.values, count / 3 * sizeof(float)) == 0);
        finish_three(&full, &one, &two);
    }
}

static bool count_down(void *context) {
    int *left = context;
    return --*left > 0;
}

// Whether to go on is asked every few milliseconds: the picture is given up at the first answer
// that says not to.
static void check_giving_up(struct rn_engine *engine, struct rn_field *field,
                            const struct rn_frame *frame) {
    struct rn_error err;
    struct rn_render_options options = {.camera = rn_camera_resized(&frame->camera, 768, 768),
                                        .outputs = RN_OUTPUT_RGB};
    struct rn_render_result result;
    int left = 1000000;
    ck_assert(rn_render(engine, field, &options, count_down, &left, &result, &err) == RN_OK);
    rn_render_result_finish(&result);
    int polls = 1000000 - left;
    ck_assert_int_ge(polls, 8);
    left = 4;
    ck_assert(rn_render(engine, field, &options, count_down, &left, &result, &err) ==
              RN_ERROR_CANCELLED);
    ck_assert_int_le(-left, rn_pool_threads(engine->pool)); // other threads may ask once more
}

// Rays that end earlier than in training are opaque, whatever lies behind them, and near to the
// full picture.
static void check_early_stop(struct rn_field *field, const struct rn_frame *frame, int cones) {
    struct rn_render_options options = {.outputs = RN_OUTPUT_RGB | RN_OUTPUT_ALPHA,
                                        .background = {1, 1, 1},
                                        .settings.supersample = cones};
    struct rn_render_result full = render_quickly(field, frame, options, 2);
    options.settings.stop = 0.2;
    struct rn_render_result white = render_quickly(field, frame, options, 2);
    memset(options.background, 0, sizeof options.background);
    struct rn_render_result black = render_quickly(field, frame, options, 2);
    size_t count = (size_t)full.rgb.width * (size_t)full.rgb.height, opaque = 0;
    double squares = 0;
    ck_assert(white.stats.samples < full.stats.samples);
    for (size_t i = 0; i < count; i++) {
        for (size_t c = 3 * i; c < 3 * i + 3; c++) {
            squares += pow((double)full.rgb.values[c] - (double)white.rgb.values[c], 2);
            if (white.alpha.values[i] == 1)
                ck_assert(fabsf(white.rgb.values[c] - black.rgb.values[c]) < 1e-5f);
        }
        opaque += white.alpha.values[i] == 1;
        if (cones == 1) ck_assert(white.alpha.values[i] == 1 || white.alpha.values[i] < 0.8f);
    }
    printf("stop 0.2, %d cones: %zu of %zu pixels opaque, %.4f from the full picture\n", cones,
           opaque, count, sqrt(squares / (3 * (double)count)));
    ck_assert_uint_gt(opaque, count / 20);
    ck_assert(sqrt(squares / (3 * (double)count)) < 0.02);
    finish_three(&full, &white, &black);
}

// Whether all pixels up to `reach` beside a point's image are inside it and without alpha.
static bool empty_around(const struct rn_trainer *t, const struct rn_pixel_frame *frame,
                         const double point[3], double reach) {
    const struct rn_camera *c = &frame->frame->camera;
    double at[3] = {0};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            at[i] += c->world_from_camera[j][i] * (point[j] - c->world_from_camera[j][3]);
    double x = at[0] / at[2] * c->fx + c->cx, y = at[1] / at[2] * c->fy + c->cy;
    if (!(at[2] > 0) || x < reach || y < reach) return false;
    for (int row = (int)(y - reach); row <= (int)(y + reach); row++)
        for (int column = (int)(x - reach); column <= (int)(x + reach); column++)
            if (row >= c->height || column >= c->width ||
                rn_pixel_at(&t->train, frame, column, row)[3] > 0)
                return false;
    return true;
}

// Pixels that the ball around a cell may reach beside its centre's image; 0: it is too near.
static double reach_of(const struct rn_camera *c, const double centre[3], double radius) {
    double away[3], depth = 0, squares = 0;
    for (int i = 0; i < 3; i++) {
        away[i] = centre[i] - c->world_from_camera[i][3];
        depth += away[i] * c->world_from_camera[i][2];
        squares += away[i] * away[i];
    }
    if (depth <= 2 * radius) return 0;
    return fmax(c->fx, c->fy) * radius * sqrt(squares) / depth / (depth - radius) + 2.5;
}

// A carved cell is seen to be empty, all its corners in one photograph; of one that is kept no
// photograph shows its surroundings to be.
START_TEST(what_is_carved_is_seen_to_be_empty) {
    struct rn_train_config config = config_for(dataset);
    config.field.occupancy = 64; // some bricks are in front of matter alone
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    const struct rn_bounds *b = &t->field->bounds;
    int cells = config.field.occupancy, carved = 0, kept = 0;
    for (int cell = 0; cell < cells * cells * cells; cell++) {
        int at[3] = {cell / cells / cells, cell / cells % cells, cell % cells};
        double corner[8][3], centre[3], from_middle = 0, radius = b->radius * sqrt(3) / cells;
        for (int i = 0; i < 3; i++) {
            double unit = 2 * (at[i] + 0.5) / cells - 1;
            from_middle += unit * unit;
            centre[i] = b->centre[i] + b->radius * unit;
            for (int k = 0; k < 8; k++)
                corner[k][i] = centre[i] + (k >> i & 1 ? 0.999 : -0.999) * b->radius / cells;
        }
        bool keep = t->field->hull[cell], empty = false;
        if (from_middle > 1) continue;
        for (int f = 0; f < t->train.frame_count && !empty; f++) {
            const struct rn_pixel_frame *frame = &t->train.frames[f];
            double reach = keep ? reach_of(&frame->frame->camera, centre, radius) : 0;
            if (keep) {
                empty = reach > 0 && empty_around(t, frame, centre, reach);
                continue;
            }
            empty = true;
            for (int k = 0; k < 8; k++)
                empty &= empty_around(t, frame, corner[k], 0);
        }
        ck_assert_msg(empty != keep, "cell %d %d %d is %s", at[0], at[1], at[2],
                      keep ? "kept, and seen to be empty" : "carved, and not seen to be empty");
        kept += keep;
        carved += !keep;
    }
    ck_assert_msg(carved > kept && kept > 500, "%d cells carved, %d kept", carved, kept);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Whether the cone's middle passes through a cell that may hold matter.
static bool sees_hull(const struct rn_trainer *t, const struct rn_pixel_frame *frame, int x,
                      int y) {
    const struct rn_field *field = t->field;
    int cells = field->config.field.occupancy;
    double step = 0.5 / cells; // a quarter of a cell
    struct rn_march_ray ray = rn_trainer_ray(t, &t->train, frame, x, y, step, 0);
    for (int k = 0; (k + 0.5) * step < (double)ray.length; k++) {
        int cell[3];
        for (int i = 0; i < 3; i++)
            cell[i] = rn_cell_of(
                (double)ray.origin[i] + (double)ray.direction[i] * (k + 0.5) * step, cells);
        if (field->hull[(cell[0] * cells + cell[1]) * cells + cell[2]]) return true;
    }
    return false;
}

// Rays are drawn from all pixels that see the hull, and from few others.
START_TEST(pixels_that_see_the_hull_are_live) {
    struct rn_train_config config = config_for(scaled);
    config.field.occupancy = 64;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, scaled, &config);
    int seen = 0, live = 0, all = 0;
    for (int f = 0; f < t->train.frame_count; f += 5) {
        const struct rn_pixel_frame *frame = &t->train.frames[f];
        for (int y = 0; y < frame->frame->camera.height; y++)
            for (int x = 0; x < frame->frame->camera.width; x++, all++) {
                bool sees = sees_hull(t, frame, x, y), is = is_live(t, f, x, y);
                ck_assert_msg(is || !sees, "frame %d, pixel %d, %d is not live", f, x, y);
                seen += sees;
                live += is;
            }
    }
    printf("of %d pixels %d see the hull, %d are live\n", all, seen, live);
    ck_assert_int_gt(seen, all / 20);
    ck_assert_int_lt(live, all / 10 * 9);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Mean difference of rendered from photographed alpha over a training view, after training on
// photographs that are as white as the background.
static double alpha_error_of_white(double random_background) {
    struct rn_train_config config = config_for(dataset);
    config.max_steps = 150;
    config.random_background = random_background;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    for (size_t i = 0; i < t->train.pixel_count; i++)
        memset(t->train.rgba + 4 * i, 255, 3);
    run_to_end(t);
    const struct rn_pixel_frame *frame = &t->train.frames[0];
    struct rn_camera camera = frame->frame->camera;
    struct rn_render_result seen = render_all(engine, t->field, camera, 1);
    double error = 0;
    for (int i = 0; i < camera.width * camera.height; i++) {
        double alpha = rn_pixel_at(&t->train, frame, i % camera.width, i / camera.width)[3] / 255.0;
        error += fabs((double)seen.alpha.values[i] - alpha);
    }
    rn_render_result_finish(&seen);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    return error / (camera.width * camera.height);
}

// What has the background's colour cannot be told from it, but by its alpha over other backgrounds.
START_TEST(white_matter_on_white_is_seen_over_random_backgrounds) {
    double with = alpha_error_of_white(0.4), without = alpha_error_of_white(0);
    printf("white on white, alpha is off by %.4f, over white alone by %.4f\n", with, without);
    ck_assert_double_lt(with, 0.05);
    ck_assert_double_gt(without, 0.1);
}
END_TEST

// Random backgrounds end where the schedule says, and are not for photographs that show none.
START_TEST(random_backgrounds_have_their_time) {
    struct rn_train_config config = config_for(dataset);
    config.max_steps = 10;
    config.random_background = 0.4;
    config.background[1] = 0.75f;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    for (; t->progress.step < 10; t->progress.step++) {
        struct rn_march_options march = rn_schedule_march(t->field, &t->progress);
        bool first = t->progress.step < 4;
        ck_assert_float_eq(march.colour.background[1], first ? 0.5f : 0.75f);
        ck_assert_float_eq_tol(march.colour.background_variance, first ? 0.25f : 0, 1e-9f);
    }
    memset(t->train.rgba, 255, 4 * t->train.pixel_count);
    rn_trainer_detect_effects(t);
    ck_assert(!t->field->effects[RN_EFFECT_BACKGROUND].on);
    ck_assert_double_eq(t->field->config.random_background, 0);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

static void advance_to(struct rn_trainer *t, int64_t step) {
    struct rn_error err;
    while (t->progress.step < step)
        ck_assert(rn_trainer_advance(t, 1, &err) == RN_OK);
}

// Ray r goes through the quarter of its pixel that is its turn, the same pixel as the three others.
static void check_part(const struct rn_trainer *t, int r) {
    int x, y, first_x, first_y;
    const struct rn_pixel_frame *frame = rn_trainer_place(t, r, &x, &y);
    ck_assert(rn_trainer_place(t, r - r % 4, &first_x, &first_y) == frame);
    if (!frame) return;
    ck_assert(x == first_x && y == first_y);
    struct rn_ray whole = rn_camera_ray(&frame->frame->camera, x + 0.25 + 0.5 * (r % 2),
                                        y + 0.25 + 0.5 * (r % 4 / 2));
    for (int i = 0; i < 3; i++)
        ck_assert_double_eq_tol((double)t->step.rays[r].direction[i], whole.direction[i], 1e-6);
    ck_assert_double_eq_tol((double)t->step.rays[r].radius, whole.radius / 2, 1e-4 * whole.radius);
}

// Rays at fault are found one by one, though four of them are a pixel.
static void check_incident(struct rn_trainer *t) {
    struct rn_incident incident;
    t->field->parameters.values[t->field->parameters.plane_count] = NAN;
    rn_field_refresh(t->field, t->engine);
    rn_trainer_note(t, RN_INCIDENT_REJECTED);
    ck_assert(rn_trainer_take_incident(t, &incident));
    ck_assert_int_gt(incident.ray_count, 0);
    ck_assert_int_eq(incident.rays[0].fault, RN_FAULT_COLOUR);
}

// Pixels are split where the schedule says, and then rendered as they were trained; photographs of
// several scales are not split.
START_TEST(pixels_are_split_in_their_time) {
    struct rn_train_config config = config_for(dataset);
    config.max_steps = 10;
    config.split_pixels = 0.4;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    const struct rn_camera *camera = &t->train.frames[0].frame->camera;
    double cone = t->field->finest_cone;
    for (int step = 1; step <= 10; step++) {
        advance_to(t, step);
        bool split = step > 6;
        ck_assert_int_eq(t->step.march.split, split);
        ck_assert_double_eq_tol(t->field->finest_cone, split ? cone / 2 : cone, 1e-15);
        struct rn_render_result seen = render_all(engine, t->field, *camera, 0);
        ck_assert_int_eq(seen.stats.cones, split ? 2 : 1);
        rn_render_result_finish(&seen);
        for (int r = 0; r < t->step.ray_count && split; r++)
            check_part(t, r);
    }
    check_incident(t);
    rn_trainer_destroy(&t);
    t = trainer_for(engine, scaled, &config);
    ck_assert_double_eq(t->field->config.split_pixels, 0);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

static void ck_planes_eq(const struct rn_trainer *a, const struct rn_trainer *b) {
    const struct rn_parameters *p = &a->field->parameters;
    ck_assert_mem_eq(p->values, b->field->parameters.values, p->plane_count * sizeof(float));
}

// The end of every 32nd step smooths the planes by what is left of the share, and their maps
// follow.
START_TEST(planes_are_smoothed_in_their_turn) {
    struct rn_train_config config = config_for(_i ? scaled : dataset);
    config.max_steps = 64;
    config.grow_to = 0;
    config.smoothing = 0.2;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *smooth = trainer_for(engine, _i ? scaled : dataset, &config);
    config.smoothing = 0;
    struct rn_trainer *rough = trainer_for(engine, _i ? scaled : dataset, &config);
    advance_to(smooth, 31);
    advance_to(rough, 31);
    ck_planes_eq(smooth, rough);
    double factor = exp(-3.0 * (31.0 / 64 - 0.2) / 0.8);
    float share = rn_schedule_smoothing(&smooth->field->config, &smooth->progress);
    ck_assert_double_eq_tol((double)share, 0.2 * factor * factor, 1e-6);
    ck_assert_float_eq_tol(rn_schedule_smoothing(&rough->field->config, &rough->progress), 0,
                           1e-9f);
    advance_to(smooth, 32);
    advance_to(rough, 32);
    const struct rn_field_config *c = &rough->field->config.field;
    for (int p = 0; p < c->planes; p++)
        engine->kernels->smooth(rough->field->cpu.maps[p][0][0].texels, c->base, c->channels,
                                share);
    for (int i = 0, side = rn_voxel_side(c); i < 2 * side; i++)
        engine->kernels->smooth_voxels(rough->field->cpu.maps[c->planes][0][0].texels, side,
                                       i % side, i >= side, share * (4.0f / 6));
    ck_planes_eq(smooth, rough);
    rn_field_refresh(rough->field, engine);
    for (int p = 0; p < c->planes; p++)
        for (int l = 1; l < smooth->field->fresh_levels; l++) {
            const struct rn_map *a = &smooth->field->cpu.maps[p][l][l];
            const struct rn_map *b = &rough->field->cpu.maps[p][l][l];
            for (int i = 0; i < a->width * a->height * c->channels; i++)
                ck_assert_float_eq_tol(a->texels[i], b->texels[i], 1e-6f);
        }
    ck_assert_int_eq(smooth->field->fresh_levels > 1, _i);
    rn_trainer_destroy(&smooth);
    rn_trainer_destroy(&rough);
    rn_engine_destroy(&engine);
}
END_TEST

// ---- a field at rest ------------------------------------------------------------------------

static double rms_difference(const struct rn_picture *a, const struct rn_picture *b) {
    int n = a->width * a->height * a->channels;
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += pow((double)(a->values[i] - b->values[i]), 2);
    return sqrt(sum / n);
}

static double worst_difference(const struct rn_picture *a, const struct rn_picture *b) {
    double worst = 0;
    for (int i = 0; i < a->width * a->height * a->channels; i++)
        worst = fmax(worst, fabs((double)(a->values[i] - b->values[i])));
    return worst;
}

// For rays that end early: `chosen` cells spare the haze of `cells`, and the picture is as near.
static void check_cells(struct rn_engine *engine, struct rn_field *field, struct rn_camera camera,
                        struct rn_occupancy_bits *chosen, struct rn_occupancy_bits cells) {
    struct rn_render_options early = {.outputs = RN_OUTPUT_RGB, .background = {1, 1, 1}};
    early.settings = (struct rn_render_settings){.stop = 0.1, .supersample = 1};
    struct rn_occupancy_bits kept = *chosen;
    struct rn_render_result full = render_all(engine, field, camera, 0);
    struct rn_render_result quick = render(engine, field, camera, early);
    *chosen = cells;
    struct rn_render_result slow = render(engine, field, camera, early);
    *chosen = kept;
    double share = (double)quick.stats.samples / (double)slow.stats.samples;
    double off = rms_difference(&quick.rgb, &full.rgb), was = rms_difference(&slow.rgb, &full.rgb);
    printf("fewer cells: %.0f %% of the samples, rms %.5f for %.5f\n", 100 * share, off, was);
    ck_assert_double_lt(share, 0.97);
    ck_assert_double_lt(off, was + 0.005);
    finish_three(&full, &quick, &slow);
}

// Finer cells leave out samples that hardly show: pictures stay as they are, and do not depend on
// the number of threads.
static void check_refinement(struct rn_engine *engine, struct rn_field *field,
                             const struct rn_frame *frame) {
    struct rn_engine *alone = engine_with(1);
    rn_field_refresh_occupancy(field);
    ck_assert_ptr_null(field->fine.words);
    struct rn_render_result coarse = render_all(engine, field, frame->camera, 0);
    rn_field_refine_occupancy(field, engine);
    struct rn_render_result fine = render_all(engine, field, frame->camera, 0);
    ck_assert_int_eq(field->cpu.occupancy.cells, 2 * field->config.field.occupancy);
    for (int quick = 0; quick < 2; quick++) {
        rn_field_choose_cells(field, field->fine_levels + 1 + 3 * quick, 0.1 * quick);
        ck_assert_int_eq(field->cpu.occupancy.cells, field->config.field.occupancy);
    }
    check_cells(engine, field, frame->camera, &field->firm, field->fine);
    for (int above = 1; above <= 3; above++) { // cones two to eight times as wide
        struct rn_occupancy_bits *chosen = above > 1 ? &field->fine : &field->firm;
        struct rn_camera wide = rn_camera_resized(&frame->camera, 48 >> above, 48 >> above);
        rn_field_choose_cells(field, field->fine_levels + above, 0.1);
        ck_assert_ptr_eq(field->cpu.occupancy.words, chosen->words);
        check_cells(engine, field, wide, chosen, field->coarse);
    }
    rn_field_refine_occupancy(field, alone);
    struct rn_render_result same = render_all(engine, field, frame->camera, 0);
    ck_assert(averaging_error(&fine, &same, 1) == 0 && fine.stats.samples == same.stats.samples);
    double error = fmax(worst_difference(&fine.rgb, &coarse.rgb),
                        worst_difference(&fine.alpha, &coarse.alpha));
    double rms = rms_difference(&fine.rgb, &coarse.rgb);
    double share = (double)fine.stats.samples / (double)coarse.stats.samples;
    field->config.refine_at_rest = false;
    rn_field_refine_occupancy(field, alone);
    ck_assert_ptr_null(field->fine.words);
    printf("finer cells: %.0f %% of the samples, off by %.4f, rms %.5f\n", 100 * share, error, rms);
    ck_assert_double_lt(rms, 0.002); // of eight seeds at most 0.0013; the worst pixel 0.067
    ck_assert_double_lt(error, 0.1);
    ck_assert_double_lt(share, 0.97);
    finish_three(&coarse, &fine, &same);
    rn_engine_destroy(&alone);
}

// Where nearly all cells are occupied, and where none is, there is nothing to gain.
START_TEST(full_and_empty_fields_are_not_refined) {
    struct rn_train_config config = config_for(scaled);
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *trainer = trainer_for(engine, scaled, &config);
    struct rn_field *field = rn_trainer_finish(&trainer);
    size_t side = (size_t)field->config.field.occupancy, cells = side * side * side;
    for (int full = 0; full < 2; full++) {
        memset(field->hull, 1, cells);
        for (size_t i = 0; i < cells; i++)
            field->occupancy[i] = (float)full;
        rn_field_refresh_occupancy(field);
        rn_field_refine_occupancy(field, engine);
        ck_assert_ptr_null(field->fine.words);
        ck_assert_ptr_eq(field->cpu.occupancy.words, field->coarse.words);
    }
    rn_field_destroy(&field);
    rn_engine_destroy(&engine);
}
END_TEST

START_TEST(it_learns_and_a_loaded_field_renders_the_same) {
    struct rn_error err;
    struct rn_train_config config = config_for(scaled);
    config.max_steps = 400;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *trainer = trainer_for(engine, scaled, &config);
    double before = held_out_psnr(trainer);
    run_to_end(trainer);
    double after = held_out_psnr(trainer);
    printf("held-out PSNR %.2f -> %.2f dB\n", before, after);
    ck_assert_double_gt(after, before + 8);
    char path[128], trained[65], loaded[65];
    snprintf(path, sizeof path, "%s/learned.safetensors", folder);
    ck_assert(rn_trainer_save(trainer, path, &err) == RN_OK);
    struct rn_field *field;
    ck_assert_msg(rn_field_load(engine, path, &field, &err) == RN_OK, "%s", err.text);
    rn_field_sha256(rn_trainer_field(trainer), trained);
    rn_field_sha256(field, loaded);
    ck_assert_str_eq(trained, loaded);
    const struct rn_frame *frame = rn_dataset_frame(scaled, RN_SPLIT_TEST, 0, 0);
    struct rn_view_score a, b;
    struct rn_render_options options = {.background = {1, 1, 1}};
    struct rn_field *kept = rn_trainer_finish(&trainer);
    ck_assert(rn_evaluate_view(engine, kept, frame, &options, NULL, NULL, &a, &err) == RN_OK);
    ck_assert(rn_evaluate_view(engine, field, frame, &options, NULL, NULL, &b, &err) == RN_OK);
    ck_assert(a.psnr == b.psnr && a.ssim == b.ssim);
    check_supersampling(engine, field, frame);
    check_tolerance(field, frame);
    check_parts(field, frame);
    check_inspection(field, frame);
    check_early_stop(field, frame, 1);
    check_early_stop(field, frame, 2);
    check_refinement(engine, kept, frame);
    check_giving_up(engine, field, frame);
    rn_field_destroy(&field);
    rn_field_destroy(&kept);
    rn_engine_destroy(&engine);
}
END_TEST

static void add_tests(TCase *tests) {
    tcase_add_test(tests, what_is_carved_is_seen_to_be_empty);
    tcase_add_test(tests, pixels_that_see_the_hull_are_live);
    tcase_add_test(tests, white_matter_on_white_is_seen_over_random_backgrounds);
    tcase_add_test(tests, random_backgrounds_have_their_time);
    tcase_add_test(tests, pixels_are_split_in_their_time);
    tcase_add_loop_test(tests, planes_are_smoothed_in_their_turn, 0, 2);
    tcase_add_test(tests, full_and_empty_fields_are_not_refined);
    tcase_add_test(tests, it_learns_and_a_loaded_field_renders_the_same);
}

int main(void) {
    return run_on_scene("learning", add_tests);
}
