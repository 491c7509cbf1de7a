// What sparse points say of unbounded space before training: which cells begin empty.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/occupancy.h"
#include "server/engine/field/space.h"
#include "server/engine/train/trainer.h"
#include "tests/ops/train_scene.h"
#include "tests/support/suite.h"

static struct rn_train_config config_of_place(void) {
    struct rn_train_config config = config_for(dataset);
    config.auto_effects = false;
    config.field.space = RN_SPACE_UNBOUNDED;
    config.cone_step = false;
    return config;
}

// The cell of a point that lies `share` of the way from a frame's camera to the bounds' centre.
static float begins_at(const struct rn_trainer *t, const struct rn_camera *camera, double share) {
    int cells = t->field->config.field.occupancy, at[3];
    double x[3], squares = 0;
    for (int i = 0; i < 3; i++) {
        double from = camera->world_from_camera[i][3], to = t->field->bounds.centre[i];
        x[i] = (from + share * (to - from) - to) / t->field->bounds.radius;
        squares += x[i] * x[i];
    }
    for (int i = 0; i < 3; i++)
        at[i] = rn_cell_of(
            (rn_real)(x[i] * (double)rn_contraction_at((rn_real)sqrt(squares)).scale), cells);
    return t->field->occupancy[rn_cell_index(at[0], at[1], at[2], cells)];
}

// Of unbounded space, what several photographs' sight lines of one sparse point cross begins empty;
// not the point itself, nor what one line alone crosses.
START_TEST(what_points_are_seen_through_begins_empty) {
    struct rn_train_config config = config_of_place();
    struct rn_engine *engine = engine_with(1);
    dataset->points = (struct rn_points){.items = calloc(1, sizeof(struct rn_point)),
                                         .count = 1,
                                         .sightings = calloc(5, sizeof(struct rn_sighting)),
                                         .sighting_count = 5};
    const struct rn_camera *cameras[2] = {NULL, NULL};
    for (size_t f = 0; f < dataset->frame_count; f++) {
        dataset->frames[f].photo = (int)f;
        if (dataset->frames[f].split != RN_SPLIT_TRAIN || cameras[1]) continue;
        int n = cameras[0] ? 1 : 0;
        cameras[n] = &dataset->frames[f].camera;
        for (int i = n ? 4 : 0; i < (n ? 5 : 4); i++)
            dataset->points.sightings[i].photo = (uint32_t)f;
    }
    struct rn_trainer *trainer = trainer_for(engine, dataset, &config);
    memcpy(dataset->points.items[0].position, trainer->field->bounds.centre, 3 * sizeof(double));
    rn_trainer_destroy(&trainer); // made again, the point in the bounds' middle
    trainer = trainer_for(engine, dataset, &config);
    ck_assert_float_eq(begins_at(trainer, cameras[0], 0.5), 0);
    ck_assert_float_eq(begins_at(trainer, cameras[0], 1), RN_NEVER_SEEN);
    ck_assert_float_eq(begins_at(trainer, cameras[1], 0.5), RN_NEVER_SEEN);
    rn_trainer_destroy(&trainer);
    rn_engine_destroy(&engine);
}
END_TEST

// From between two photographs a point that they and a third one saw would be seen as well; of a
// point that two alone saw, nothing is known.
START_TEST(what_neighbours_see_through_begins_empty) {
    struct rn_train_config config = config_of_place();
    for (size_t seen = 2; seen <= 3; seen++) {
        struct rn_engine *engine = engine_with(1);
        struct rn_dataset as = *dataset;
        struct rn_frame frames[3];
        struct rn_point point = {.error = -1};
        struct rn_sighting sightings[3] = {{.photo = 0}, {.photo = 1}, {.photo = 2}};
        for (int i = 0; i < 3; i++) { // a twentieth of the way around from one to the next
            frames[i] = dataset->frames[0];
            frames[i].split = RN_SPLIT_TRAIN;
            frames[i].photo = i;
            frames[i].camera.world_from_camera[0][3] = 3 * cos(i * 0.3);
            frames[i].camera.world_from_camera[1][3] = 3 * sin(i * 0.3);
            frames[i].camera.world_from_camera[2][3] = 0;
        }
        as.frames = frames;
        as.frame_count = 3;
        as.bounds.source = RN_BOUNDS_GIVEN;
        memset(as.bounds.centre, 0, sizeof as.bounds.centre);
        as.points = (struct rn_points){
            .items = &point, .count = 1, .sightings = sightings, .sighting_count = seen};
        struct rn_trainer *trainer = trainer_for(engine, &as, &config);
        struct rn_camera between = frames[0].camera;
        for (int i = 0; i < 2; i++)
            between.world_from_camera[i][3] = 0.5 * (frames[0].camera.world_from_camera[i][3] +
                                                     frames[1].camera.world_from_camera[i][3]);
        ck_assert_float_eq(begins_at(trainer, &between, 0.4), seen < 3 ? RN_NEVER_SEEN : 0);
        ck_assert_float_eq(begins_at(trainer, &between, 1), RN_NEVER_SEEN);
        rn_trainer_destroy(&trainer);
        rn_engine_destroy(&engine);
    }
}
END_TEST

// Of two photographs that saw nothing nearer than 3 but for one of 20 points, nothing stands as
// near as 0.7 of that to the way from one camera to the other; of fewer points, nothing is known.
START_TEST(what_lies_by_cameras_begins_empty) {
    enum { POINTS = 20 };
    struct rn_train_config config = config_of_place();
    for (int known = 0; known < 2; known++) {
        struct rn_engine *engine = engine_with(1);
        struct rn_dataset as = *dataset;
        struct rn_frame frames[2] = {dataset->frames[0], dataset->frames[0]};
        struct rn_point points[POINTS] = {{.error = -1}};
        struct rn_sighting sightings[2 * POINTS];
        for (uint32_t i = 0; i < 2 * POINTS; i++)
            sightings[i] = (struct rn_sighting){.photo = i % 2, .point = i / 2};
        points[0].position[0] = 3; // a wrong match
        points[0].position[2] = -1;
        for (int i = 4; i < POINTS; i++)
            points[i].position[0] = -9;
        for (int i = 0; i < 2; i++) {
            frames[i].split = RN_SPLIT_TRAIN;
            frames[i].photo = i;
            const double poses[3][4] = {{0, 0, -1, 3}, {1, 0, 0, 0.6 * i}, {0, -1, 0, 0}};
            memcpy(frames[i].camera.world_from_camera, poses, sizeof poses);
        }
        as.frames = frames;
        as.frame_count = 2;
        as.bounds.source = RN_BOUNDS_GIVEN;
        memset(as.bounds.centre, 0, sizeof as.bounds.centre);
        as.points = (struct rn_points){.items = points,
                                       .count = POINTS,
                                       .sightings = sightings,
                                       .sighting_count = 2 * (POINTS - 1) + 2 * (size_t)known};
        struct rn_trainer *trainer = trainer_for(engine, &as, &config);
        struct rn_camera before = frames[0].camera; // of the way's middle
        before.world_from_camera[1][3] = 0.3;
        before.world_from_camera[2][3] = 0.4;
        before.world_from_camera[0][3] = 3 - 1.9;
        ck_assert_float_eq(begins_at(trainer, &before, 0), known ? 0 : RN_NEVER_SEEN);
        before.world_from_camera[0][3] = 3 - 2.2;
        ck_assert_float_eq(begins_at(trainer, &before, 0), RN_NEVER_SEEN);
        rn_trainer_destroy(&trainer);
        rn_engine_destroy(&engine);
    }
}
END_TEST

// Between the points of a bare wall photographs see as far as the wall: from three of them on what
// lies before it begins empty, and from five others on what lies by a point that one alone saw in
// mid-air.
START_TEST(what_photographs_see_through_begins_empty) {
    enum { SIDE = 3, WALL = SIDE * SIDE, MOST = 6 };
    struct rn_train_config config = config_of_place();
    struct rn_error err;
    char path[128];
    const struct rn_camera *seen_by = &dataset->frames[0].camera;
    struct rn_image grey = {.width = seen_by->width, .height = seen_by->height};
    size_t bytes = 4 * (size_t)grey.width * (size_t)grey.height;
    grey.pixels = malloc(bytes);
    memset(grey.pixels, 128, bytes);
    for (size_t i = 3; i < bytes; i += 4)
        grey.pixels[i] = 255;
    snprintf(path, sizeof path, "%s/grey.png", folder);
    ck_assert(rn_image_write_png(&grey, path, 4, &err) == RN_OK);
    free(grey.pixels);
    double spacing = 0.7 * 5 * seen_by->cx / seen_by->fx;
    for (uint32_t photos = 2; photos <= MOST; photos++) {
        struct rn_engine *engine = engine_with(1);
        struct rn_dataset as = *dataset;
        struct rn_frame frames[MOST];
        struct rn_point points[WALL + 1] = {{.error = -1}};
        struct rn_sighting sightings[WALL * MOST + 1];
        for (uint32_t i = 0; i < photos; i++) {
            frames[i] = dataset->frames[0];
            frames[i].split = RN_SPLIT_TRAIN;
            frames[i].path = path;
            frames[i].photo = (int)i;
            const double poses[3][4] = {{0, 0, -1, 3}, {1, 0, 0, 0.02 * i}, {0, -1, 0, 0}};
            memcpy(frames[i].camera.world_from_camera, poses, sizeof poses);
            for (uint32_t k = 0; k < WALL; k++)
                sightings[i * WALL + k] = (struct rn_sighting){.point = k, .photo = i};
        }
        for (int k = 0; k < WALL; k++) {
            points[k].position[0] = -2;
            points[k].position[1] = spacing * (k % SIDE - 1);
            points[k].position[2] = spacing * (k / SIDE - 1);
        }
        struct rn_camera at = frames[0].camera; // between the points
        for (int i = 0; i < 3; i++)
            points[WALL].position[i] = i == 0 ? 0.5 : -spacing / 4;
        sightings[photos * WALL] = (struct rn_sighting){.point = WALL};
        as.frames = frames;
        as.frame_count = photos;
        as.bounds.source = RN_BOUNDS_GIVEN;
        memset(as.bounds.centre, 0, sizeof as.bounds.centre);
        as.points = (struct rn_points){.items = points,
                                       .count = WALL + 1,
                                       .sightings = sightings,
                                       .sighting_count = photos * WALL + 1};
        struct rn_trainer *trainer = trainer_for(engine, &as, &config);
        at.world_from_camera[0][3] = -1;
        at.world_from_camera[1][3] = at.world_from_camera[2][3] = 0.4 * spacing;
        ck_assert_float_eq(begins_at(trainer, &at, 0), photos < 3 ? RN_NEVER_SEEN : 0);
        for (int i = 0; i < 3; i++)
            at.world_from_camera[i][3] = points[WALL].position[i];
        ck_assert_float_eq(begins_at(trainer, &at, 0), photos < 6 ? RN_NEVER_SEEN : 0);
        rn_trainer_destroy(&trainer);
        rn_engine_destroy(&engine);
    }
}
END_TEST

static void add_tests(TCase *tests) {
    tcase_add_test(tests, what_points_are_seen_through_begins_empty);
    tcase_add_test(tests, what_neighbours_see_through_begins_empty);
    tcase_add_test(tests, what_lies_by_cameras_begins_empty);
    tcase_add_test(tests, what_photographs_see_through_begins_empty);
}

int main(void) {
    return run_on_scene("sighted", add_tests);
}
