#include <math.h>
#include <stdlib.h>

#include "server/engine/cpu/pool.h"
#include "server/engine/render/fill.h"
#include "server/engine/scene/scene.h"
#include "tests/support/suite.h"

#define WIDTH 61 // of the picture
#define HEIGHT 46
#define APART 3 // pixels of it for one that was rendered
#define SMALL_WIDTH ((WIDTH + APART - 1) / APART)
#define SMALL_HEIGHT ((HEIGHT + APART - 1) / APART)
#define ALL (RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA)

static struct rn_pixel points[SMALL_HEIGHT][SMALL_WIDTH];
static struct rn_engine engine;

// A parabola over the picture, in places of [0, 1] on both axes.
static float parabola(double x, double y) {
    return (float)(0.2 + 0.3 * x * x + 0.1 * x * y + 0.2 * y * y);
}

static void fill_points(void) {
    for (int y = 0; y < SMALL_HEIGHT; y++)
        for (int x = 0; x < SMALL_WIDTH; x++) {
            float v = parabola((x + 0.5) / SMALL_WIDTH, (y + 0.5) / SMALL_HEIGHT);
            points[y][x] =
                (struct rn_pixel){{v, 0.5f * v, 1 - v}, 0.9f * v, (float)(y * SMALL_WIDTH + x)};
        }
}

static struct rn_render_result fill(void) {
    struct rn_lattice lattice = {.pixels = points[0], .width = SMALL_WIDTH, .height = SMALL_HEIGHT};
    struct rn_render_options options = {.camera = {.width = WIDTH, .height = HEIGHT},
                                        .outputs = ALL,
                                        .background = {0.25f, 0.5f, 0.75f},
                                        .settings = {.subsample = APART}};
    struct rn_filling filling = {
        .lattice = &lattice, .points = 1, .options = &options, .radius = 2};
    struct rn_render_result result = {0};
    OK(rn_pool_create(3, &engine.pool, &err));
    OK(rn_fill_pictures(&engine, &filling, &result, &err));
    rn_pool_destroy(&engine.pool);
    return result;
}

// Pixels so far from the border that no point is missing on either side.
static bool is_inner(int x, int y) {
    return x > 2 * APART && y > 2 * APART && x < WIDTH - 2 * APART && y < HEIGHT - 2 * APART;
}

START_TEST(what_bends_is_enlarged_without_loss) {
    fill_points();
    struct rn_render_result result = fill();
    ck_assert_uint_eq(result.stats.nonfinite_rays, 0);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            int at = y * WIDTH + x, column = x * SMALL_WIDTH / WIDTH,
                row = y * SMALL_HEIGHT / HEIGHT;
            float v = parabola((x + 0.5) / WIDTH, (y + 0.5) / HEIGHT);
            // At the border the spline sees a last point twice.
            float off = is_inner(x, y) ? 2e-6f : 0.02f;
            ck_assert_float_eq_tol(result.rgb.values[3 * at], v, off);
            ck_assert_float_eq_tol(result.rgb.values[3 * at + 1], 0.5f * v, off);
            ck_assert_float_eq_tol(result.rgb.values[3 * at + 2], 1 - v, off);
            ck_assert_float_eq_tol(result.alpha.values[at], 0.9f * v, off);
            float depth = result.depth.values[at] / 2;
            ck_assert_int_le(abs((int)depth % SMALL_WIDTH - column), 1);
            ck_assert_int_le(abs((int)depth / SMALL_WIDTH - row), 1);
        }
    rn_render_result_finish(&result);
}
END_TEST

// Beside an edge a spline overshoots.
START_TEST(no_value_leaves_its_range) {
    int ends = 0;
    fill_points();
    for (int y = 0; y < SMALL_HEIGHT; y++)
        for (int x = 0; x < SMALL_WIDTH; x++)
            points[y][x].rgb[0] = points[y][x].alpha = x < SMALL_WIDTH / 2 ? 0 : 1;
    struct rn_render_result result = fill();
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        ck_assert(result.rgb.values[3 * i] >= 0 && result.rgb.values[3 * i] <= 1);
        ck_assert(result.alpha.values[i] >= 0 && result.alpha.values[i] <= 1);
        ends += result.alpha.values[i] > 0 && result.alpha.values[i] < 1;
    }
    ck_assert_int_gt(ends, HEIGHT);
    rn_render_result_finish(&result);
}
END_TEST

// Columns of 0 and 1 in one channel of three: four beside each other are 1/2 from their mean.
START_TEST(roughness_is_of_four_pixels_beside_each_other) {
    fill_points();
    for (int y = 0; y < SMALL_HEIGHT; y++)
        for (int x = 0; x < SMALL_WIDTH; x++)
            points[y][x] = (struct rn_pixel){{(float)(x & 1), 0.5f, 0.25f}, 1, 0};
    struct rn_render_result result = fill();
    ck_assert_double_eq_tol(result.stats.roughness, 0.25 / 3, 1e-9);
    rn_render_result_finish(&result);
}
END_TEST

START_TEST(what_is_no_number_is_counted_once_and_replaced) {
    int replaced = 0;
    fill_points();
    points[7][9].rgb[1] = NAN;
    points[7][9].alpha = INFINITY;
    struct rn_render_result result = fill();
    ck_assert_uint_eq(result.stats.nonfinite_rays, 1);
    for (int i = 0; i < WIDTH * HEIGHT; i++) {
        for (int c = 0; c < 3; c++)
            ck_assert(isfinite(result.rgb.values[3 * i + c]));
        ck_assert(isfinite(result.alpha.values[i]));
        replaced += result.rgb.values[3 * i + 1] == 0.5f;
    }
    ck_assert_int_ge(replaced, APART * APART);
    rn_render_result_finish(&result);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("fill");
    TCase *all = tcase_create("all");
    tcase_add_test(all, what_bends_is_enlarged_without_loss);
    tcase_add_test(all, roughness_is_of_four_pixels_beside_each_other);
    tcase_add_test(all, no_value_leaves_its_range);
    tcase_add_test(all, what_is_no_number_is_counted_once_and_replaced);
    suite_add_tcase(suite, all);
    return run_suite(suite);
}
