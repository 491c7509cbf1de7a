// A forward-facing capture: a painted wall 4 units ahead, photographed from 16 places in front of
// it. When it is found, what the fast path makes of a ray, the wall's depth, and that a training
// goes on as it was.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/output.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/reference/exact.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/train/schedule.h"
#include "tests/ops/train_scene.h"

#define VIEWS 16
#define SIDE 48 // pixels
#define WALL 4.0
#define TURNED 14 // the last that is not held out

struct wall {
    struct rn_dataset dataset;
    struct rn_frame frames[VIEWS];
    char paths[VIEWS][128];
};

static uint8_t level_of(double x) {
    return (uint8_t)(127.5 + 127.5 * x);
}

static void photograph(const struct rn_frame *frame) {
    struct rn_image image;
    struct rn_error err;
    ck_assert_int_eq(rn_image_init(SIDE, SIDE, &image, &err), RN_OK);
    for (int i = 0; i < SIDE * SIDE; i++) {
        struct rn_ray ray = rn_camera_ray(&frame->camera, i % SIDE + 0.5, i / SIDE + 0.5);
        double t = (WALL - ray.origin[2]) / ray.direction[2];
        double x = ray.origin[0] + t * ray.direction[0], y = ray.origin[1] + t * ray.direction[1];
        image.pixels[4 * i] = level_of(sin(5 * x) * sin(5 * y));
        image.pixels[4 * i + 1] = level_of(sin(3 * x + 4 * y));
        image.pixels[4 * i + 2] = level_of(cos(7 * y - x));
        image.pixels[4 * i + 3] = 255;
    }
    (void)remove(frame->path);
    ck_assert_int_eq(rn_output_png(&image, frame->path, 1, &err), RN_OK);
    rn_image_finish(&image);
}

// Camera TURNED turned by `angle` degrees to its right; depths given where `depths`.
static void make_wall(double angle, bool depths, struct wall *w) {
    memset(w, 0, sizeof *w);
    w->dataset = (struct rn_dataset){.name = (char *)"wall",
                                     .frames = w->frames,
                                     .frame_count = VIEWS,
                                     .view_count = {[RN_SPLIT_TRAIN] = VIEWS},
                                     .scale_count = 1,
                                     .bounds = {.centre = {0, 0, 4}, .radius = 5}};
    for (int i = 0; i < VIEWS; i++) {
        struct rn_frame *f = &w->frames[i];
        double turn = i == TURNED ? angle / 57.29577951308232 : 0;
        snprintf(w->paths[i], sizeof w->paths[i], "%s/wall_%d.png", folder, i);
        *f = (struct rn_frame){.name = (char *)"wall",
                               .path = w->paths[i],
                               .split = RN_SPLIT_TRAIN,
                               .index = i,
                               .loss_weight = 1,
                               .near = depths ? 2 : 0,
                               .far = depths ? 6 : 0,
                               .camera = {.width = SIDE,
                                          .height = SIDE,
                                          .fx = 1.2 * SIDE,
                                          .fy = 1.2 * SIDE,
                                          .cx = SIDE / 2.0,
                                          .cy = SIDE / 2.0}};
        double pose[3][4] = {{cos(turn), 0, sin(turn), 0.4 * (i % 4) - 0.6},
                             {0, 1, 0, 0.4 * (i / 4) - 0.6},
                             {-sin(turn), 0, cos(turn), 0.05 * (i % 3)}};
        memcpy(f->camera.world_from_camera, pose, sizeof pose);
        photograph(f);
    }
}

static struct rn_train_config wall_config(const struct wall *w) {
    struct rn_train_config config = config_for(&w->dataset);
    config.max_steps = 150;
    config.split_pixels = 0;
    return config;
}

static const struct rn_effect_record *record(const struct rn_trainer *t) {
    return &t->field->effects[RN_EFFECT_FORWARD_FACING];
}

START_TEST(found_by_the_cameras) {
    static const struct {
        double angle;
        bool depths, on;
    } cases[] = {{0, true, true}, {20, true, true}, {0, false, false}, {120, true, false}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct wall w;
        struct rn_engine *engine = engine_with(1);
        make_wall(cases[i].angle, cases[i].depths, &w);
        struct rn_train_config config = wall_config(&w);
        config.split_pixels = 0.4;
        struct rn_trainer *t = trainer_for(engine, &w.dataset, &config);
        const struct rn_effect_record *split = &t->field->effects[RN_EFFECT_SPLIT_PIXELS];
        ck_assert_int_eq(record(t)->on, cases[i].on);
        // A place's pixels are not split, other photographs of one scale are.
        ck_assert(split->on == (t->field->config.split_pixels > 0));
        ck_assert(cases[i].angle > 0 || split->on == !cases[i].on);
        ck_assert_int_eq(t->field->cpu.disparity.on, cases[i].on);
        // One of 14 cameras turned: the mean turns by about a fourteenth of it.
        ck_assert_double_eq_tol(record(t)->number, cases[i].angle * 15 / 16,
                                0.1 * cases[i].angle + 0.01);
        rn_trainer_destroy(&t);
        rn_engine_destroy(&engine);
    }
}
END_TEST

START_TEST(what_was_asked_for_stays_before_a_wall) {
    struct wall w;
    struct rn_engine *engine = engine_with(1);
    make_wall(0, true, &w);
    for (int asked = 0; asked < 2; asked++) {
        struct rn_train_config config = wall_config(&w);
        if (asked) config.step = 0.03, config.distortion_loss = 0.125;
        struct rn_trainer *t = trainer_for(engine, &w.dataset, &config);
        ck_assert(record(t)->on);
        ck_assert_double_eq(t->field->config.step, asked ? 0.03 : 2.0 / 96);
        ck_assert_double_eq(t->field->config.distortion_loss, asked ? 0.125 : 0.005);
        rn_trainer_destroy(&t);
    }
    rn_engine_destroy(&engine);
}
END_TEST

START_TEST(cut_out_scenes_keep_the_ball) {
    struct rn_engine *engine = engine_with(1);
    struct rn_train_config config = config_for(dataset);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    ck_assert(!record(t)->on && !t->field->cpu.disparity.on);
    ck_assert_double_eq(rn_picture_step(t->field), t->field->config.step);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// The vectors' rays against one at a time, and colours, opacity and the opaque end against float64.
static void check_rays(const struct rn_kernels *kernels, struct rn_trainer *t,
                       const struct wall *w) {
    struct rn_march_options options = {
        .step = (float)t->field->config.step, .stop_depth = 1e9f, .colour.background = {1, 0, 1}};
    struct rn_exact *exact;
    struct rn_error err;
    int seen = 0;
    t->engine->kernels = kernels;
    rn_field_refresh(t->field, t->engine);
    ck_assert_int_eq(rn_exact_create(&t->field->cpu, &exact, &err), RN_OK);
    double bound = kernels->unit == RN_PRODUCT_FMA ? 1e-3 : 16 * 0x1p-9;
    struct rn_workspace *workspace = rn_engine_workspace(t->engine, 0);
    for (int i = 0; i < 200; i++) {
        const struct rn_camera *camera = &w->frames[i % VIEWS].camera;
        int x = i * 7 % SIDE, y = i * 11 % SIDE;
        struct rn_view view = rn_field_view(t->field, camera);
        struct rn_ray_place place = {&view, x, y, 0.25f};
        struct rn_ray ray = rn_camera_ray(camera, x + 0.5, y + 0.5);
        struct rn_march_ray got,
            one = rn_march_ray_from(t->field, &ray, (double)options.step, 0.25);
        kernels->rays(&place, 1, (double)options.step, true, &got);
        ck_assert_double_eq_tol(got.length, one.length, 1e-6);
        ck_assert_double_eq_tol(got.near, one.near, 1e-6);
        for (int k = 0; k < 3; k++) {
            ck_assert_double_eq_tol(got.origin[k], one.origin[k], 1e-6);
            ck_assert_double_eq_tol(got.direction[k], one.direction[k], 1e-6);
        }
        struct rn_exact_pixel truth;
        struct rn_pixel pixel;
        kernels->parts->stage(&t->field->cpu, &options, &got, 1, RN_STAGE_MARCH, workspace, NULL,
                              NULL);
        int n = workspace->candidate_count[0];
        rn_exact_render(exact, &options, &got, workspace->candidate, n, &truth);
        kernels->render(&t->field->cpu, &options, &got, 1, workspace, &pixel);
        for (int c = 0; c < 3; c++)
            ck_assert_double_eq_tol(pixel.rgb[c], truth.rgb[c], bound);
        ck_assert_double_eq_tol(pixel.alpha, n > 0, 1e-5);
        seen += n > 0;
    }
    ck_assert_int_gt(seen, 150);
    rn_exact_destroy(&exact);
}

START_TEST(rays_match_float64) {
    struct wall w;
    struct rn_engine *engine = engine_with(1);
    const struct rn_kernels *kernels, *own = engine->kernels;
    make_wall(0, true, &w);
    struct rn_train_config config = wall_config(&w);
    config.max_steps = 30;
    struct rn_trainer *t = trainer_for(engine, &w.dataset, &config);
    run_to_end(t);
    ck_assert_int_eq(rn_engine_prepare(engine, t->field, NULL), RN_OK);
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        check_rays(kernels, t, &w);
    engine->kernels = own;
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

static int compare_floats(const void *a, const void *b) {
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

// The wall is where it stands, in dataset units, before and after the field went through a file.
static void check_depth(struct rn_engine *engine, struct rn_field *field,
                        const struct rn_camera *camera) {
    struct rn_render_options options = {.camera = *camera,
                                        .outputs = RN_OUTPUT_RGB | RN_OUTPUT_DEPTH};
    struct rn_render_result result;
    struct rn_error err;
    float off[SIDE * SIDE];
    ck_assert_int_eq(rn_render(engine, field, &options, NULL, NULL, &result, &err), RN_OK);
    for (int i = 0; i < SIDE * SIDE; i++) {
        struct rn_ray ray = rn_camera_ray(camera, i % SIDE + 0.5, i / SIDE + 0.5);
        double t = (WALL - ray.origin[2]) / ray.direction[2];
        off[i] = (float)(fabs((double)result.depth.values[i] - t) / t);
    }
    qsort(off, SIDE * SIDE, sizeof *off, compare_floats);
    ck_assert_double_lt(off[SIDE * SIDE / 2], 0.1);
    rn_render_result_finish(&result);
}

// What a start shows: the wall, from edge to edge.
static void check_seen(struct rn_engine *engine, struct rn_field *field,
                       const struct rn_camera *start) {
    struct rn_render_options options = {.camera = rn_camera_resized(start, SIDE, SIDE),
                                        .outputs = RN_OUTPUT_RGB | RN_OUTPUT_ALPHA};
    struct rn_render_result result;
    struct rn_error err;
    ck_assert_int_eq(rn_render(engine, field, &options, NULL, NULL, &result, &err), RN_OK);
    for (int i = 0; i < SIDE * SIDE; i++)
        ck_assert_float_gt(result.alpha.values[i], 0.8F);
    rn_render_result_finish(&result);
}

// A training of the wall after its 400 steps.
static struct rn_trainer *trained_wall(struct rn_engine *engine, struct wall *ret_wall) {
    make_wall(0, true, ret_wall);
    struct rn_train_config config = wall_config(ret_wall);
    config.max_steps = 400;
    struct rn_trainer *t = trainer_for(engine, &ret_wall->dataset, &config);
    run_to_end(t);
    return t;
}

START_TEST(depth_in_dataset_units) {
    struct wall w;
    struct rn_error err;
    struct rn_field *field;
    char path[128];
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trained_wall(engine, &w);
    check_depth(engine, rn_trainer_field(t), &w.frames[5].camera);
    snprintf(path, sizeof path, "%s/wall.safetensors", folder);
    ck_assert_int_eq(rn_trainer_save(t, path, &err), RN_OK);
    ck_assert_int_eq(rn_field_load(engine, path, &field, &err), RN_OK);
    check_depth(engine, field, &w.frames[5].camera);
    rn_field_destroy(&field);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// PSNR against the photograph of a picture marched in `step`, 0 as pictures usually are.
static double psnr_at(struct rn_trainer *t, const struct rn_frame *frame, double step) {
    struct rn_render_options options = {.settings.step = step};
    struct rn_view_score score;
    struct rn_error err;
    ck_assert_int_eq(
        rn_evaluate_view(t->engine, t->field, frame, &options, NULL, NULL, &score, &err), RN_OK);
    return score.psnr;
}

static double step_at(const struct rn_trainer *t, int64_t step) {
    struct rn_progress progress = {.step = step};
    return (double)rn_schedule_march(t->field, &progress).step;
}

// Pictures of a place march in half the steps that it was trained in up to the last of the
// schedule, and are the nearer to its photographs; a step that is asked for is taken.
START_TEST(pictures_march_in_half_steps) {
    struct wall w;
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trained_wall(engine, &w);
    double trained = t->field->config.step, half = trained / 2;
    ck_assert_double_eq(rn_picture_step(t->field), half);
    ck_assert_double_eq(step_at(t, 339), (double)(float)trained);
    ck_assert_double_eq(step_at(t, 340), (double)(float)half);
    for (int i = 0; i < VIEWS; i += 5) {
        double usual = psnr_at(t, &w.frames[i], 0);
        ck_assert_double_eq(usual, psnr_at(t, &w.frames[i], half));
        ck_assert_double_gt(usual, psnr_at(t, &w.frames[i], trained));
    }
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Among the cameras, as they look, with their up; a file that tells a start keeps it.
START_TEST(a_file_without_a_start_begins_among_its_cameras) {
    struct wall w;
    struct rn_error err;
    struct rn_field *field;
    struct rn_field_info info;
    struct rn_viewing told = {.bits = 32, .split = "train", .version = "0.1.0"};
    char path[128];
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = trained_wall(engine, &w);
    snprintf(path, sizeof path, "%s/wall.ripscene", folder);
    for (int with = 0; with < 2; with++) {
        told.has_start = with;
        told.start = w.frames[1].camera;
        memcpy(told.up, (double[3]){0, -1, 0}, sizeof told.up);
        ck_assert_int_eq(rn_viewing_write(rn_trainer_field(t), &told, path, &err), RN_OK);
        ck_assert_int_eq(rn_field_load(engine, path, &field, &err), RN_OK);
        rn_field_describe(field, &info);
        const struct rn_viewing *v = &info.viewing;
        ck_assert(v->has_start);
        for (int i = 0; i < 3; i++) {
            const double mean[3] = {0, 0, 0.05 * 15 / 16};
            const double *row = v->start.world_from_camera[i];
            ck_assert_double_eq_tol(row[2], i == 2, 1e-9);
            ck_assert_double_eq_tol(v->up[i], -(i == 1), 1e-9);
            ck_assert_double_eq_tol(
                row[3], with ? w.frames[1].camera.world_from_camera[i][3] : mean[i], 1e-9);
        }
        if (!with) check_seen(engine, field, &v->start);
        rn_field_destroy(&field);
    }
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Interrupted between two rounds over the cells, and with other threads: the same parameters.
START_TEST(goes_on_as_it_was) {
    struct wall w;
    struct rn_error err;
    char path[128], whole[65], parts[65];
    struct rn_engine *engine = engine_with(2);
    make_wall(0, true, &w);
    struct rn_train_config config = wall_config(&w);
    struct rn_trainer *t = trainer_for(engine, &w.dataset, &config);
    run_to_end(t);
    rn_field_sha256(rn_trainer_field(t), whole);
    rn_trainer_destroy(&t);
    t = trainer_for(engine, &w.dataset, &config);
    while (t->progress.step < 53)
        ck_assert_int_eq(rn_trainer_advance(t, 0, &err), RN_OK);
    snprintf(path, sizeof path, "%s/half.safetensors", folder);
    ck_assert_int_eq(rn_trainer_save(t, path, &err), RN_OK);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    engine = engine_with(1);
    ck_assert_int_eq(rn_trainer_restore(engine, &w.dataset, path, 0, &t, &err), RN_OK);
    run_to_end(t);
    rn_field_sha256(rn_trainer_field(t), parts);
    ck_assert_str_eq(whole, parts);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// By a turn that moves each axis; about the origin.
static void turn(const struct wall *w, const double turned[3][3]) {
    for (int f = 0; f < VIEWS; f++) {
        double(*pose)[4] = w->dataset.frames[f].camera.world_from_camera, old[3][4];
        memcpy(old, pose, sizeof old);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 4; j++)
                pose[i][j] =
                    turned[i][0] * old[0][j] + turned[i][1] * old[1][j] + turned[i][2] * old[2][j];
    }
}

static float begins_at(const struct rn_trainer *t, const double point[3]) {
    int cells = t->field->config.field.occupancy, at[3];
    double cube[3];
    ck_assert(rn_field_cube_of(t->field, point, cube));
    for (int i = 0; i < 3; i++)
        at[i] = rn_cell_of((rn_real)cube[i], cells);
    return t->field->occupancy[rn_cell_index(at[0], at[1], at[2], cells)];
}

// Whichever way the cameras look, a point of the box is found in its cell, that cell at the point,
// and a box about the point cuts out that cell and none far from it.
START_TEST(cells_of_a_turned_capture_lie_where_their_points_do) {
    const double turned[3][3] = {{0.36, 0.48, 0.8}, {-0.8, 0.6, 0}, {-0.48, -0.64, 0.6}};
    const double depths[2] = {4, 2.5};
    struct wall w;
    struct rn_engine *engine = engine_with(1);
    make_wall(0, true, &w);
    turn(&w, turned);
    for (int i = 0; i < 3; i++)
        w.dataset.bounds.centre[i] = 4 * turned[i][2];
    struct rn_train_config config = wall_config(&w);
    struct rn_trainer *t = trainer_for(engine, &w.dataset, &config);
    ck_assert(record(t)->on);
    rn_field_refresh_occupancy(t->field);
    struct rn_box box;
    for (int n = 0; n < 2; n++) {
        double point[3], cube[3], again[3];
        for (int i = 0; i < 3; i++)
            point[i] = turned[i][0] * 0.3 + turned[i][1] * -0.2 + turned[i][2] * depths[n];
        ck_assert(rn_field_cube_of(t->field, point, cube));
        rn_field_place_of(t->field, cube, again);
        for (int i = 0; i < 3; i++)
            ck_assert_double_eq_tol(again[i], point[i], 1e-12);
        for (int i = 0; i < 3 && n == 0; i++)
            box.low[i] = point[i] - 0.2, box.high[i] = point[i] + 0.2;
        struct rn_occupancy_bits cut;
        ck_assert_int_eq(rn_occupancy_bits_crop(t->field, &box, &cut), RN_OK);
        int x = rn_cell_of(cube[0], cut.cells), y = rn_cell_of(cube[1], cut.cells),
            z = rn_cell_of(cube[2], cut.cells);
        bool kept = cut.words[rn_brick_word(x, y, z, cut.cells)] & rn_brick_bit(x, y);
        ck_assert(kept == (n == 0));
        rn_occupancy_bits_destroy(&cut);
    }
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Where photographs saw nothing nearer than 4, nothing stands as near as 0.7 of that to the ways
// between their cameras; without points nothing is known.
START_TEST(what_lies_by_cameras_before_a_wall_begins_empty) {
    enum { POINTS = 20 };
    const double near[3] = {0, 0, 2.4}, far[3] = {0, 0, 3.4};
    for (int known = 0; known < 2; known++) {
        struct wall w;
        struct rn_engine *engine = engine_with(1);
        struct rn_point points[POINTS] = {{.error = -1}};
        struct rn_sighting sightings[POINTS * VIEWS];
        make_wall(0, true, &w);
        for (uint32_t i = 0; i < POINTS * VIEWS; i++)
            sightings[i] = (struct rn_sighting){.photo = i % VIEWS, .point = i / VIEWS};
        for (int i = 0; i < POINTS; i++)
            points[i].position[2] = WALL;
        for (int i = 0; i < VIEWS; i++)
            w.frames[i].photo = i;
        w.dataset.points = (struct rn_points){.items = points,
                                              .count = POINTS,
                                              .sightings = sightings,
                                              .sighting_count = known * POINTS * VIEWS};
        struct rn_train_config config = wall_config(&w);
        struct rn_trainer *t = trainer_for(engine, &w.dataset, &config);
        ck_assert(record(t)->on);
        ck_assert_float_eq(begins_at(t, near), known ? 0 : RN_NEVER_SEEN);
        ck_assert_float_eq(begins_at(t, far), RN_NEVER_SEEN);
        ck_assert_float_eq(begins_at(t, points[0].position), RN_NEVER_SEEN);
        rn_trainer_destroy(&t);
        rn_engine_destroy(&engine);
    }
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, found_by_the_cameras);
    tcase_add_test(tests, what_was_asked_for_stays_before_a_wall);
    tcase_add_test(tests, cut_out_scenes_keep_the_ball);
    tcase_add_test(tests, rays_match_float64);
    tcase_add_test(tests, depth_in_dataset_units);
    tcase_add_test(tests, a_file_without_a_start_begins_among_its_cameras);
    tcase_add_test(tests, pictures_march_in_half_steps);
    tcase_add_test(tests, goes_on_as_it_was);
    tcase_add_test(tests, cells_of_a_turned_capture_lie_where_their_points_do);
    tcase_add_test(tests, what_lies_by_cameras_before_a_wall_begins_empty);
}

int main(void) {
    return run_on_scene("forward-facing", add);
}
