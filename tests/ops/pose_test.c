// Cameras that are sought by what they photographed: the derivatives against float64, and whole
// trainings on photographs whose poses are wrong.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/reference/exact.h"
#include "server/engine/scene/occupancy.h"
#include "tests/ops/train_scene.h"

#define POSE RN_EFFECT_POSE_REFINEMENT
#define MOST_STEPS 4096
#define SIGHTS 24 // whose derivatives are held against float64

// The sphere's photographs with poses that are as if found by a program, not rendered.
struct capture {
    struct rn_dataset dataset;
    struct rn_frame *frames;
};

// Each camera turned and moved by about `pixels` pixels.
static struct capture off_by(double pixels) {
    struct capture c = {.dataset = *dataset};
    c.dataset.frames = c.frames = malloc(dataset->frame_count * sizeof *c.frames);
    c.dataset.bounds.source = RN_BOUNDS_GIVEN;
    for (size_t f = 0; f < dataset->frame_count; f++) {
        double by[RN_POSE_UNKNOWNS] = {0};
        c.frames[f] = dataset->frames[f];
        for (int k = 0; k < RN_POSE_FOCAL; k++)
            by[k] = pixels / c.frames[f].camera.fx *
                    (2 * (double)rn_rng_unit(rn_rng_draw(7, f, (uint64_t)k).v[0]) - 1);
        c.frames[f].camera = rn_pose_move(&dataset->frames[f].camera, by, 1);
        ck_assert_int_eq(rn_camera_check(&c.frames[f].camera, "", NULL), RN_OK);
    }
    return c;
}

static struct rn_train_config config_of(const struct capture *c) {
    struct rn_train_config config = config_for(&c->dataset);
    config.max_steps = 400;
    config.split_pixels = 0;
    return config;
}

// ---- derivatives ----

// A pixel in float64, all steps of its ray evaluated.
static void render_exactly(struct rn_exact *exact, const struct rn_pose_looker *l,
                           const struct rn_camera *camera, const struct rn_pose_sight *sight,
                           double rgb[3]) {
    struct rn_ray cone = rn_camera_ray(camera, sight->x + 0.5, sight->y + 0.5);
    double step = (double)l->march.step;
    struct rn_march_ray ray = rn_march_ray_from(l->field, &cone, step, 0);
    uint16_t k[MOST_STEPS];
    struct rn_exact_pixel pixel;
    int n = 0;
    while (n < MOST_STEPS && (n + 0.5) * step * ray.stride < (double)ray.length)
        k[n] = (uint16_t)n, n++;
    rn_exact_render(exact, &l->march, &ray, k, n, &pixel);
    memcpy(rgb, pixel.rgb, sizeof pixel.rgb);
}

static double exact_slope(struct rn_exact *exact, const struct rn_pose_looker *l,
                          const struct rn_camera *camera, const struct rn_pose_sight *sight, int k,
                          double step, double ret[3]) {
    double by[RN_POSE_UNKNOWNS] = {0}, there[3], back[3], size = 0;
    for (int side = 0; side < 2; side++) {
        by[k] = side ? step : -step;
        struct rn_camera moved = rn_pose_move(camera, by, l->field->bounds.radius);
        render_exactly(exact, l, &moved, sight, side ? there : back);
    }
    for (int c = 0; c < 3; c++) {
        ret[c] = (there[c] - back[c]) / (2 * step);
        size += ret[c] * ret[c];
    }
    return size;
}

// Of a field after some steps, all of whose cells are marched through.
START_TEST(slopes_are_those_of_float64) {
    struct capture c = off_by(0);
    struct rn_train_config config = config_of(&c);
    config.max_steps = 100;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = trainer_for(engine, &c.dataset, &config);
    run_to_end(t);
    for (size_t i = 0, n = (size_t)config.field.occupancy; i < n * n * n; i++)
        t->field->occupancy[i] = t->field->hull[i] = 1;
    rn_field_refresh_occupancy(t->field);
    struct rn_exact *exact;
    ck_assert_int_eq(rn_exact_create(&t->field->cpu, &exact, NULL), RN_OK);
    const struct rn_pixel_frame *frame = &t->train.frames[0];
    struct rn_pose_photo photo = {.rgba = t->train.rgba + 4 * frame->offset,
                                  .camera = frame->camera};
    struct rn_pose_looker looker = {engine, t->field, 0, rn_effects_march_trained(t->field)};
    struct rn_pose_sights sights;
    static float slopes[RN_POSE_UNKNOWNS][RN_POSE_SIGHTS][3];
    looker.march.stop_depth = 1e9f;
    struct rn_pose_draw draw = {.part = RN_POSE_WHOLE,
                                .side = 1,
                                .wanted = SIGHTS,
                                .background = looker.march.colour.background,
                                .seed = 1,
                                .stream = 2,
                                .counter = 3};
    rn_pose_draw(&photo, &draw, &sights);
    ck_assert_int_eq(sights.count, SIGHTS);
    rn_pose_slopes(&looker, &frame->camera, &sights, slopes);
    double apart = 0, size = 0, half = 0.5 / frame->camera.fx;
    for (int k = 0; k < RN_POSE_SHIFT; k++)
        for (int i = 0; i < sights.count; i++) {
            double same[3];
            size += exact_slope(exact, &looker, &frame->camera, &sights.at[i], k, half, same);
            for (int channel = 0; channel < 3; channel++)
                apart += pow((double)slopes[k][i][channel] - same[channel], 2);
        }
    printf("slopes: RMS %.3g, from float64 %.3g of it\n", sqrt(size / (9 * SIGHTS)),
           sqrt(apart / size));
    ck_assert_double_gt(size, 0);
    ck_assert_double_lt(sqrt(apart / size), 0.02);
    rn_exact_destroy(&exact);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    free(c.frames);
}
END_TEST

// ---- trainings ----

static double angle_between(const struct rn_camera *a, const struct rn_camera *b) {
    double trace = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            trace += a->world_from_camera[i][j] * b->world_from_camera[i][j];
    return acos(fmax(-1, fmin(1, (trace - 1) / 2)));
}

// Mean angle between training cameras, as they are now or as they were given, and the true ones;
// what all of them turned by together is no error.
static double mean_error(const struct rn_trainer *t, bool now) {
    double sum = 0, count = 0;
    for (int f = 0; f < t->train.frame_count; f++)
        for (int g = 0; g < f; g++, count++) {
            const struct rn_pixel_frame *a = &t->train.frames[f], *b = &t->train.frames[g];
            const struct rn_frame *first =
                rn_dataset_frame(dataset, a->frame->split, a->frame->index, 0);
            const struct rn_frame *second =
                rn_dataset_frame(dataset, b->frame->split, b->frame->index, 0);
            double is = angle_between(now ? &a->camera : &a->frame->camera,
                                      now ? &b->camera : &b->frame->camera);
            sum += fabs(is - angle_between(&first->camera, &second->camera));
        }
    return sum / count;
}

// By how much all cameras turned together, radians.
static double common_turn(const struct rn_trainer *t) {
    double mean[3] = {0};
    for (int f = 0; f < t->train.frame_count; f++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                mean[i] += t->train.frames[f].frame->camera.world_from_camera[i][j] *
                           (double)t->poses.moves[f][RN_POSE_TURN + j] / t->train.frame_count;
    return sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]);
}

static struct rn_trainer *train_with(struct rn_engine *engine, const struct capture *c,
                                     enum rn_effect_choice choice) {
    struct rn_train_config config = config_of(c);
    config.effect[POSE] = choice;
    struct rn_trainer *t = trainer_for(engine, &c->dataset, &config);
    run_to_end(t);
    return t;
}

// By the truth: what pictures gain by it differs from one kernel set to another by more than all of
// it, as so short a training does.
START_TEST(wrong_poses_are_put_right) {
    struct capture c = off_by(3);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = train_with(engine, &c, RN_EFFECT_AUTO);
    const struct rn_effect_record *r = &t->field->effects[POSE];
    double given = mean_error(t, false), found = mean_error(t, true);
    printf("off by 3 pixels: %s; angles between cameras off by %.4f, refined %.4f rad\n", r->reason,
           given, found);
    ck_assert_msg(r->on && r->decided && r->number > r->threshold, "%s", r->reason);
    ck_assert_double_lt(found, 0.95 * given);
    ck_assert_double_lt(common_turn(t), 1e-6);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    free(c.frames);
}
END_TEST

START_TEST(right_poses_are_left_alone) {
    struct capture c = off_by(0);
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *without = train_with(engine, &c, RN_EFFECT_UNWANTED);
    struct rn_trainer *with = train_with(engine, &c, RN_EFFECT_AUTO);
    char hash[2][65];
    const struct rn_effect_record *r = &with->field->effects[POSE];
    printf("right poses: %s\n", r->reason);
    ck_assert_msg(!r->on && r->decided && isfinite(r->number), "%s", r->reason);
    ck_assert_int_gt(with->held.frame_count, 3);
    ck_assert_int_eq(with->poses.view_count, 3); // so short a training is measured by a few
    rn_field_sha256(without->field, hash[0]);
    rn_field_sha256(with->field, hash[1]);
    ck_assert_str_eq(hash[0], hash[1]);
    rn_trainer_destroy(&without);
    rn_trainer_destroy(&with);
    rn_engine_destroy(&engine);
    free(c.frames);
}
END_TEST

// Of a time: half as many rays as are trained on. Of a number of steps: as ever.
START_TEST(moves_take_a_share_of_the_time) {
    struct capture c = off_by(3);
    struct rn_train_config config = config_of(&c);
    config.effect[POSE] = RN_EFFECT_WANTED;
    config.max_steps = 0;
    config.max_seconds = 100;
    struct rn_engine *engine = engine_with(1);
    struct rn_trainer *t = trainer_for(engine, &c.dataset, &config);
    double turn = (double)t->train.frame_count * 192 * 15; // rays
    t->progress.train_seconds = 84;
    t->progress.rays = (uint64_t)(3.5 * turn / 0.5 * 0.84);
    t->poses.turns = 2;
    ck_assert(rn_trainer_poses_due(t));
    t->poses.turns = 3;
    ck_assert(!rn_trainer_poses_due(t));
    t->progress.rays *= 10;
    ck_assert(rn_trainer_poses_due(t));
    t->progress.rays /= 10;
    t->field->config.max_seconds = 0;
    t->field->config.max_steps = 100;
    t->progress.step = 84;
    ck_assert(rn_trainer_poses_due(t));
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
    free(c.frames);
}
END_TEST

static void look_at_turns(const struct rn_trainer *t, bool restored) {
    ck_assert_int_gt(t->poses.turns, restored ? 0 : 10);
}

START_TEST(refined_poses_go_on_from_a_checkpoint) {
    struct capture c = off_by(3);
    struct rn_train_config config = config_of(&c);
    config.effect[POSE] = RN_EFFECT_WANTED;
    config.max_steps = 120;
    check_goes_on(&c.dataset, &config, look_at_turns);
    free(c.frames);
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, slopes_are_those_of_float64);
    tcase_add_test(tests, wrong_poses_are_put_right);
    tcase_add_test(tests, right_poses_are_left_alone);
    tcase_add_test(tests, moves_take_a_share_of_the_time);
    tcase_add_test(tests, refined_poses_go_on_from_a_checkpoint);
}

int main(void) {
    return run_on_scene("poses", add);
}
