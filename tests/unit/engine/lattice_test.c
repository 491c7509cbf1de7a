#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/render/lattice.h"
#include "tests/support/naive_spline.h"
#include "tests/support/suite.h"

#define WIDTH 37
#define HEIGHT 26
#define ALL (RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA)

static struct rn_pixel truth[HEIGHT][WIDTH], picture[HEIGHT][WIDTH];
static double interpolation;      // of the last picture
static int traced[HEIGHT][WIDTH]; // the pass in which a pixel was traced, from 1; 0: it was not

static struct rn_lattice lattice(double tolerance, unsigned outputs) {
    return (struct rn_lattice){picture[0],       WIDTH, HEIGHT, outputs,
                               (float)tolerance, 0,     true,   false};
}

// A picture in tiles of `side` pixels, the last one first where `backwards`.
static int draw(const struct rn_lattice *l, int side, bool backwards) {
    struct rn_spot spots[WIDTH * HEIGHT];
    int across = (WIDTH + side - 1) / side, tiles = across * ((HEIGHT + side - 1) / side);
    int total = 0;
    memset(picture, 0xff, sizeof picture); // NaN: not written yet
    memset(traced, 0, sizeof traced);
    interpolation = 0;
    for (int pass = 0; pass < rn_lattice_passes(l); pass++)
        for (int i = 0; i < tiles; i++) {
            int at = backwards ? tiles - 1 - i : i, x = at % across * side, y = at / across * side;
            struct rn_tile tile = {x, y, x + side < WIDTH ? x + side : WIDTH,
                                   y + side < HEIGHT ? y + side : HEIGHT};
            int n = rn_lattice_choose(l, pass, tile, spots, &interpolation);
            ck_assert_int_le(n, side * side / (rn_lattice_passes(l) > 1 ? 2 : 1));
            for (int j = 0; j < n; j++) {
                picture[spots[j].y][spots[j].x] = truth[spots[j].y][spots[j].x];
                ck_assert_int_eq(traced[spots[j].y][spots[j].x], 0);
                traced[spots[j].y][spots[j].x] = pass + 1;
            }
            total += n;
        }
    return total;
}

static void fill(float slope, float noise) {
    for (uint32_t i = 0; i < WIDTH * HEIGHT; i++) {
        struct rn_pixel *p = &truth[i / WIDTH][i % WIDTH];
        float ramp = slope * (float)(i % WIDTH + i / WIDTH);
        for (uint32_t c = 0; c < 3; c++)
            p->rgb[c] = ramp + noise * rn_rng_unit(rn_rng_draw(7, 0, i).v[c]);
        p->alpha = 0.5f;
        p->depth = 3;
    }
}

// Root mean square distance of four numbers from their mean, the plain way.
static double distance(double a, double b, double c, double d) {
    double m = (a + b + c + d) / 4;
    return sqrt(((a - m) * (a - m) + (b - m) * (b - m) + (c - m) * (c - m) + (d - m) * (d - m)) /
                4);
}

static double spline(int x, int y, int c) {
    const ptrdiff_t right = sizeof(struct rn_pixel) / sizeof(float);
    return naive_spline(&picture[y][x].rgb[c], right, WIDTH * right);
}

static double mean(const struct rn_pixel *const n[4], int c) {
    return ((double)n[0]->rgb[c] + (double)n[1]->rgb[c] + (double)n[2]->rgb[c] +
            (double)n[3]->rgb[c]) /
           4;
}

// The definition, pixel by pixel: which are traced, and what the others are.
static void check_picture(double tolerance) {
    double all = 0;
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            bool odd_x = x & 1, odd_y = y & 1;
            bool border = x == 0 || y == 0 || x == WIDTH - 1 || y == HEIGHT - 1;
            if ((!odd_x && !odd_y) || border) {
                ck_assert_int_eq(traced[y][x], 1 + (odd_x && odd_y) + 2 * (odd_x != odd_y));
                continue;
            }
            int d = odd_x && odd_y;
            const struct rn_pixel *n[4] = {&picture[y - 1][x - d], &picture[y + 1][x + d],
                                           &picture[y - d][x + 1], &picture[y + d][x - 1]};
            double squares = 0;
            for (int c = 0; c < 3; c++)
                squares += pow(distance((double)n[0]->rgb[c], (double)n[1]->rgb[c],
                                        (double)n[2]->rgb[c], (double)n[3]->rgb[c]),
                               2);
            double off = sqrt(squares / 3), limit = (d ? 0.7 : 1.4) * tolerance;
            bool inside = x >= 3 && y >= 3 && x + 3 < WIDTH && y + 3 < HEIGHT;
            if (fabs(off - limit) > 1e-5) ck_assert_int_eq(traced[y][x] == 0, off < limit);
            if (traced[y][x] != 0) continue;
            bool beside_traced = sqrt(2 * squares / 3) > 0.7 * tolerance;
            all += (d ? 0.275 : beside_traced ? 0.15 : 0.33) * pow(squares / 3, 0.75);
            for (int c = 0; c < 3; c++)
                ck_assert_float_eq_tol(picture[y][x].rgb[c],
                                       (float)(!d && inside ? spline(x, y, c) : mean(n, c)), 1e-6f);
        }
    ck_assert(all > 0);
    ck_assert_double_eq_tol(interpolation, all, 1e-4 * all);
}

START_TEST(a_pixel_is_traced_or_lies_between_neighbours_that_agree) {
    struct rn_pixel before[HEIGHT][WIDTH];
    int last = WIDTH * HEIGHT;
    fill(0.01f, 0.2f);
    for (double tolerance = 0.02; tolerance < 0.2; tolerance *= 2) {
        struct rn_lattice l = lattice(tolerance, RN_OUTPUT_RGB);
        int rays = draw(&l, 8, false);
        ck_assert_int_lt(rays, last);
        last = rays;
        check_picture(tolerance);
        memcpy(before, picture, sizeof before);
        ck_assert_int_eq(draw(&l, 12, true), rays);
        ck_assert(memcmp(before, picture, sizeof before) == 0);
    }
}
END_TEST

START_TEST(without_a_tolerance_every_pixel_is_traced_row_by_row) {
    struct rn_lattice l = lattice(0, ALL);
    struct rn_spot spots[64];
    fill(0, 0);
    ck_assert_int_eq(rn_lattice_passes(&l), 1);
    ck_assert_int_eq(draw(&l, 16, false), WIDTH * HEIGHT);
    ck_assert_int_eq(
        rn_lattice_choose(&l, 0, (struct rn_tile){8, 16, 16, 24}, spots, &interpolation), 64);
    for (int i = 0; i < 64; i++)
        ck_assert(spots[i].x == 8 + i % 8 && spots[i].y == 16 + i / 8);
}
END_TEST

// Of a picture that is the same everywhere but in one output, at a point of the lattice.
START_TEST(only_what_is_asked_for_has_to_agree) {
    static const unsigned outputs[3] = {RN_OUTPUT_RGB, RN_OUTPUT_ALPHA, RN_OUTPUT_DEPTH};
    for (int odd = 0; odd < 3; odd++)
        for (int asked = 0; asked < 3; asked++) {
            struct rn_lattice l = lattice(0.05, outputs[asked]);
            fill(0, 0);
            struct rn_pixel *p = &truth[10][10];
            *(odd == 0 ? &p->rgb[1] : odd == 1 ? &p->alpha : &p->depth) += 0.4f;
            draw(&l, 8, false);
            ck_assert_int_eq(traced[11][11] != 0, odd == asked);
            ck_assert_int_eq(traced[13][13], 0);
        }
}
END_TEST

START_TEST(an_interpolated_depth_is_weighted_by_opacity) {
    struct rn_lattice l = lattice(0.05, RN_OUTPUT_RGB);
    fill(0, 0);
    truth[10][10].depth = 5;
    truth[10][10].alpha = 1;
    draw(&l, 8, false);
    ck_assert_int_eq(traced[11][11], 0);
    ck_assert_float_eq_tol(picture[11][11].alpha, 2.5f / 4, 1e-6f);
    ck_assert_float_eq_tol(picture[11][11].depth, (1 * 5 + 3 * 0.5f * 3) / 2.5f, 1e-5f);
}
END_TEST

START_TEST(emptiness_is_believed_where_nothing_fits_between) {
    struct rn_lattice l = lattice(0.5, ALL);
    fill(0, 0);
    for (int i = 0; i < WIDTH * HEIGHT; i++)
        truth[i / WIDTH][i % WIDTH].alpha = 0;
    int dense = draw(&l, 8, false);
    ck_assert_int_eq(traced[11][11], 0);
    ck_assert_int_lt(dense, WIDTH * HEIGHT / 2);
    l.dense = false;
    ck_assert_int_eq(draw(&l, 8, false), WIDTH * HEIGHT);
}
END_TEST

// The census of a whole picture, pass by pass, says how many points a tolerance has traced.
START_TEST(a_census_knows_what_a_tolerance_costs) {
    struct rn_tile whole = {0, 0, WIDTH, HEIGHT};
    struct rn_spot spots[WIDTH * HEIGHT];
    fill(0.01f, 0.2f);
    struct rn_lattice l = lattice(0.5, RN_OUTPUT_RGB);
    draw(&l, 8, false);
    for (int pass = 1; pass < 3; pass++)
        for (double rays = 60; rays < WIDTH * HEIGHT; rays *= 1.5) {
            struct rn_lattice_census census = {0};
            rn_lattice_count(&l, pass, whole, &census);
            l.tolerance = rn_lattice_tolerance_for(&census, rays);
            int rays_cast = rn_lattice_choose(&l, pass, whole, spots, &interpolation);
            bool least = l.tolerance >= 0.5f; // the border alone may be more than that
            ck_assert(least ? rays_cast >= (int)census.always : rays_cast <= rays);
            ck_assert(l.tolerance > 0 && l.tolerance <= 0.5f);
            l.tolerance = 0.5f;
        }
}
END_TEST

// Between neighbours that see nothing points are traced, too, where something may be hidden; ten of
// them count as one, so that they leave room for those that see something.
START_TEST(a_census_knows_what_sees_nothing) {
    struct rn_tile whole = {0, 0, WIDTH, HEIGHT};
    struct rn_spot spots[WIDTH * HEIGHT];
    fill(0, 0.2f);
    for (int i = 0; i < WIDTH * HEIGHT; i++)
        if (i % WIDTH > WIDTH / 2) truth[i / WIDTH][i % WIDTH] = (struct rn_pixel){.alpha = 0};
    struct rn_lattice l = lattice(0.5, RN_OUTPUT_RGB);
    l.dense = false;
    draw(&l, 8, false);
    for (double rays = 80; rays < 400; rays *= 1.3) {
        struct rn_lattice_census census = {0};
        rn_lattice_count(&l, 2, whole, &census);
        ck_assert(census.empty == census.unseen && census.empty > 150);
        l.tolerance = rn_lattice_tolerance_for(&census, rays);
        int seen = -(int)census.empty + rn_lattice_choose(&l, 2, whole, spots, &interpolation);
        ck_assert(l.tolerance >= 0.5f || seen + 0.1 * census.empty <= rays);
        ck_assert(l.tolerance <= 0.25f); // half as many of those that see something
        l.tolerance = 0.5f;
    }
    struct rn_lattice_census census = {0};
    l.dense = true;
    rn_lattice_count(&l, 2, whole, &census);
    ck_assert(census.empty == 0 && census.unseen > 150);
}
END_TEST

START_TEST(when_it_is_late_nothing_more_is_traced) {
    fill(0.01f, 0.2f);
    struct rn_lattice l = lattice(1e-9, RN_OUTPUT_RGB);
    l.late = true;
    ck_assert_int_eq(draw(&l, 8, false), (WIDTH + 1) / 2 * ((HEIGHT + 1) / 2));
    for (int i = 0; i < WIDTH * HEIGHT; i++)
        ck_assert(isfinite(picture[i / WIDTH][i % WIDTH].rgb[0]));
}
END_TEST

START_TEST(beside_what_is_not_finite_pixels_are_traced) {
    for (int i = 0; i < 3; i++) {
        struct rn_lattice l = lattice(0.5, ALL);
        fill(0, 0);
        struct rn_pixel *p = &truth[10][10];
        *(i == 0 ? &p->rgb[1] : i == 1 ? &p->alpha : &p->depth) = i == 2 ? INFINITY : NAN;
        draw(&l, 8, false);
        ck_assert(traced[9][9] && traced[9][11] && traced[11][9] && traced[11][11]);
        ck_assert(traced[10][9] && traced[10][11] && traced[9][10] && traced[11][10]);
        ck_assert(!traced[13][13] && isfinite(picture[12][11].alpha));
    }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("lattice");
    TCase *tests = tcase_create("lattice");
    tcase_add_test(tests, a_census_knows_what_a_tolerance_costs);
    tcase_add_test(tests, a_census_knows_what_sees_nothing);
    tcase_add_test(tests, when_it_is_late_nothing_more_is_traced);
    tcase_add_test(tests, a_pixel_is_traced_or_lies_between_neighbours_that_agree);
    tcase_add_test(tests, without_a_tolerance_every_pixel_is_traced_row_by_row);
    tcase_add_test(tests, only_what_is_asked_for_has_to_agree);
    tcase_add_test(tests, an_interpolated_depth_is_weighted_by_opacity);
    tcase_add_test(tests, emptiness_is_believed_where_nothing_fits_between);
    tcase_add_test(tests, beside_what_is_not_finite_pixels_are_traced);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
