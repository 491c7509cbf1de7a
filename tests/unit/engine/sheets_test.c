// What a photograph sees through between its points: surfaces with a known depth, one tile a pixel.
#include <math.h>
#include <string.h>

#include "server/engine/train/sheets.h"
#include "tests/support/suite.h"

#define WIDTH 64
#define HEIGHT 48
#define SPACING 8 // pixels between points
#define MOST 64

static uint8_t rgba[4 * WIDTH * HEIGHT];
static struct rn_pixel_frame frame;
static const struct rn_pixels pixels = {.frames = &frame, .frame_count = 1, .rgba = rgba};
static struct rn_sheet_point points[MOST];
static size_t count;

// A grey photograph, one unit of width wide at a unit's distance.
static void setup(void) {
    memset(rgba, 128, sizeof rgba);
    frame = (struct rn_pixel_frame){.camera = {.width = WIDTH,
                                               .height = HEIGHT,
                                               .fx = WIDTH,
                                               .fy = WIDTH,
                                               .cx = WIDTH / 2.0,
                                               .cy = HEIGHT / 2.0}};
    for (int i = 0; i < 3; i++)
        frame.camera.world_from_camera[i][i] = 1;
    count = 0;
}

// A grid of points of which depth(x, y) is at pixel (x, y); 0: there is none.
static struct rn_sheet sheet_of(double (*depth)(double x, double y)) {
    for (int y = SPACING; y < HEIGHT; y += SPACING)
        for (int x = SPACING; x < WIDTH; x += SPACING) {
            double z = depth(x, y);
            if (z <= 0) continue;
            const double at[3] = {z * (x - WIDTH / 2.0) / WIDTH, z * (y - HEIGHT / 2.0) / WIDTH, z};
            ck_assert(rn_sheet_place(&frame.camera, at, &points[count]));
            ck_assert_double_eq_tol((double)points[count].x, x, 1e-4);
            ck_assert_double_eq_tol((double)points[count].y, y, 1e-4);
            count++;
        }
    return rn_sheet_make(&pixels, &frame, points, count);
}

static double clear_at(const struct rn_sheet *sheet, int x, int y) {
    return (double)sheet->clear[y * sheet->columns + x];
}

// A floor, whose inverse depth grows downwards.
static double floor_depth(double x, double y) {
    (void)x;
    return 1 / (0.1 + 0.01 * y);
}

START_TEST(a_floor_is_seen_to_its_plane) {
    struct rn_sheet sheet = sheet_of(floor_depth);
    ck_assert_int_eq(sheet.columns, WIDTH);
    ck_assert_int_eq(sheet.rows, HEIGHT);
    for (int y = 10; y < 38; y += 3)
        for (int x = 10; x < 54; x += 3)
            ck_assert_double_eq_tol(clear_at(&sheet, x, y) / floor_depth(x, y + 0.5), 0.96, 1e-4);
    ck_assert_double_eq(clear_at(&sheet, 0, 0), 0); // points to one side alone
    ck_assert_double_eq(clear_at(&sheet, 63, 47), 0);
    rn_sheet_finish(&sheet);
}
END_TEST

START_TEST(what_is_nearer_is_seen_through) {
    struct rn_sheet sheet = sheet_of(floor_depth);
    double far = floor_depth(32, 24.5);
    const double before[3] = {0, 0.5 / WIDTH, 0.95 * far}, behind[3] = {0, 0.5 / WIDTH, 0.97 * far},
                 back[3] = {0, 0, -1}, beside[3] = {2, 0, 1}, corner[3] = {-0.49, -0.37, 1};
    ck_assert(rn_sheet_sees_through(&sheet, before));
    ck_assert(!rn_sheet_sees_through(&sheet, behind));
    ck_assert(!rn_sheet_sees_through(&sheet, back));
    ck_assert(!rn_sheet_sees_through(&sheet, beside));
    ck_assert(!rn_sheet_sees_through(&sheet, corner));
    struct rn_sheet_point point;
    ck_assert(!rn_sheet_place(&frame.camera, back, &point));
    ck_assert(!rn_sheet_place(&frame.camera, beside, &point));
    rn_sheet_finish(&sheet);
}
END_TEST

// A bare thing before the floor, without a point of its own: its outline parts it from the points.
static double bare_depth(double x, double y) {
    return x > 20 && x < 44 && y > 14 && y < 34 ? 0 : floor_depth(x, y);
}

START_TEST(an_edge_parts_a_thing_from_what_is_behind) {
    for (int y = 14; y < 34; y++)
        for (int x = 20; x < 44; x++)
            rgba[4 * (y * WIDTH + x) + 1] = 128 - 17; // one channel is enough
    struct rn_sheet sheet = sheet_of(bare_depth);
    for (int y = 14; y < 34; y++)
        for (int x = 20; x < 44; x++)
            ck_assert_double_eq(clear_at(&sheet, x, y), 0);
    ck_assert_double_gt(clear_at(&sheet, 12, 24), 0);
    rn_sheet_finish(&sheet);
    setup(); // without the outline it is a part of the floor
    sheet = sheet_of(bare_depth);
    ck_assert_double_eq_tol(clear_at(&sheet, 32, 24) / floor_depth(32, 24.5), 0.96, 1e-4);
    rn_sheet_finish(&sheet);
}
END_TEST

// Rows of points, one near, one far.
static double uneven_depth(double x, double y) {
    (void)x;
    return (int)y / SPACING % 2 ? 2 : 3;
}

START_TEST(what_is_no_plane_is_seen_to_its_nearest_point) {
    struct rn_sheet sheet = sheet_of(uneven_depth);
    for (int x = 10; x < 54; x++)
        ck_assert_double_eq_tol(clear_at(&sheet, x, 20), 0.85 * 2, 1e-5);
    rn_sheet_finish(&sheet);
    count = 0;
    sheet = rn_sheet_make(&pixels, &frame, points, 0); // nothing is known
    ck_assert_double_eq((double)sheet.farthest, 0);
    rn_sheet_finish(&sheet);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("sheets");
    TCase *tests = tcase_create("sheets");
    tcase_add_checked_fixture(tests, setup, NULL);
    tcase_add_test(tests, a_floor_is_seen_to_its_plane);
    tcase_add_test(tests, what_is_nearer_is_seen_through);
    tcase_add_test(tests, an_edge_parts_a_thing_from_what_is_behind);
    tcase_add_test(tests, what_is_no_plane_is_seen_to_its_nearest_point);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
