#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/cpu/pool.h"
#include "server/engine/render/silhouette.h"
#include "tests/support/suite.h"

#define WIDTH 90
#define HEIGHT 61
#define SIDE 8 // bricks
#define BRICKS (SIDE * SIDE * SIDE)

static struct rn_engine engine;
static struct rn_field field;
static uint8_t distance[BRICKS + 3];
static uint32_t draws;

static double draw(double low, double high) {
    return low + (high - low) * (double)rn_rng_unit(rn_rng_draw(11, 0, draws++).v[0]);
}

// One brick in `every`, in a ball of radius 2 around (1, 2, 3).
static void occupy(double every) {
    field = (struct rn_field){.bounds = {.centre = {1, 2, 3}, .radius = 2}};
    field.cpu.config = &field.config.field;
    field.cpu.occupancy =
        (struct rn_occupancy_bits){.cells = SIDE * RN_BRICK, .distance = distance};
    for (int i = 0; i < BRICKS; i++)
        distance[i] = draw(0, every) >= 1;
}

// Somewhere between the ball's middle and 5 radii away, looking somewhere near the middle.
static struct rn_camera draw_camera(void) {
    struct rn_camera camera = {.width = WIDTH, .height = HEIGHT, .fx = draw(20, 200)};
    double away = draw(0, 10), axes[3][3], to[3], norm = 0;
    camera.fy = camera.fx * draw(0.8, 1.2);
    camera.cx = WIDTH * draw(0.3, 0.7);
    camera.cy = HEIGHT * draw(0.3, 0.7);
    for (int i = 0; i < 3; i++) {
        to[i] = draw(-1, 1);
        norm += to[i] * to[i];
    }
    for (int i = 0; i < 3; i++)
        axes[2][i] = to[i] / sqrt(norm);
    double across[3] = {axes[2][1], -axes[2][0], 0}, size = hypot(across[0], across[1]);
    for (int i = 0; i < 3; i++)
        axes[0][i] = across[i] / size;
    for (int i = 0; i < 3; i++)
        axes[1][i] = axes[2][(i + 1) % 3] * axes[0][(i + 2) % 3] -
                     axes[2][(i + 2) % 3] * axes[0][(i + 1) % 3];
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++)
            camera.world_from_camera[i][j] = axes[j][i];
        camera.world_from_camera[i][3] = field.bounds.centre[i] - away * axes[2][i] + draw(-1, 1);
    }
    return camera;
}

// Where a point of an occupied brick is seen; false: behind the camera or beside the picture.
static bool see(const struct rn_camera *camera, int brick, int *ret_x, int *ret_y) {
    int at[3] = {brick / SIDE / SIDE, brick / SIDE % SIDE, brick % SIDE};
    double seen[3] = {0};
    for (int i = 0; i < 3; i++) {
        double p = 2 * (at[i] + draw(0, 1)) / SIDE - 1;
        p = field.bounds.centre[i] + field.bounds.radius * p - camera->world_from_camera[i][3];
        for (int j = 0; j < 3; j++)
            seen[j] += camera->world_from_camera[i][j] * p;
    }
    *ret_x = (int)floor(camera->cx + camera->fx * seen[0] / seen[2]);
    *ret_y = (int)floor(camera->cy + camera->fy * seen[1] / seen[2]);
    return seen[2] > 0 && *ret_x >= 0 && *ret_y >= 0 && *ret_x < WIDTH && *ret_y < HEIGHT;
}

START_TEST(whatever_is_seen_lies_inside) {
    struct rn_silhouette silhouette;
    int looked = 0;
    OK(rn_pool_create(2, &engine.pool, &err));
    for (int i = 0; i < 300; i++) {
        occupy(40);
        struct rn_camera camera = draw_camera();
        rn_silhouette_init(&engine, &field, &camera, &silhouette);
        for (int k = 0; k < BRICKS * 8; k++) {
            int x, y;
            if (distance[k % BRICKS] > 0 || !see(&camera, k % BRICKS, &x, &y)) continue;
            looked++;
            ck_assert(rn_silhouette_covers(&silhouette, x, y));
        }
        rn_silhouette_finish(&silhouette);
    }
    ck_assert_int_gt(looked, 1000);
    rn_pool_destroy(&engine.pool);
}
END_TEST

// One brick at the middle, straight ahead and far away: as many blocks as it takes, and one beside.
START_TEST(it_is_no_larger_than_it_needs_to_be) {
    struct rn_silhouette silhouette;
    struct rn_camera camera = {.width = WIDTH, .height = HEIGHT, .fx = 400, .fy = 400};
    int covered = 0;
    occupy(1);
    memset(distance, 1, BRICKS);
    distance[(SIDE / 2 * SIDE + SIDE / 2) * SIDE + SIDE / 2] = 0;
    camera.cx = WIDTH / 2.0, camera.cy = HEIGHT / 2.0;
    for (int i = 0; i < 3; i++) {
        camera.world_from_camera[i][i] = 1;
        camera.world_from_camera[i][3] = field.bounds.centre[i] + 0.25 - (i == 2 ? 10 : 0);
    }
    OK(rn_pool_create(1, &engine.pool, &err));
    rn_silhouette_init(&engine, &field, &camera, &silhouette);
    for (int i = 0; i < silhouette.width * silhouette.height; i++)
        covered += silhouette.marks[i];
    rn_silhouette_finish(&silhouette);
    rn_pool_destroy(&engine.pool);
    int blocks = (int)ceil(400 * 0.5 / 9.75 / RN_SILHOUETTE_BLOCK) + 1; // half a unit, that near
    ck_assert_int_le(covered, blocks * blocks);
    ck_assert_int_ge(covered, (blocks - 1) * (blocks - 1));
}
END_TEST

int main(void) {
    Suite *suite = suite_create("silhouette");
    TCase *cases = tcase_create("silhouette");
    tcase_add_test(cases, whatever_is_seen_lies_inside);
    tcase_add_test(cases, it_is_no_larger_than_it_needs_to_be);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
