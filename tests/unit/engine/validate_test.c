// Which pixels of a held-out view are rendered.
#include "server/engine/train/validate.h"
#include "tests/support/suite.h"

enum { MOST = 1 << 20 };

static const int sizes[][2] = {{1, 1},       {400, 400},   {800, 800},   {1024, 1024},
                               {1025, 1024}, {1080, 1920}, {4000, 3000}, {3001, 4003},
                               {16384, 3},   {16384, 65},  {16384, 8192}};

// Every pixel of what is small enough; of what is larger as many as may be, all in the picture, a
// step apart, and no wider border left out.
START_TEST(pixels_of_a_view_are_spread_evenly) {
    int width = sizes[_i][0], height = sizes[_i][1];
    struct rn_validate_grid grid = rn_validate_grid(width, height, MOST);
    size_t all = (size_t)width * (size_t)height, count = (size_t)grid.width * (size_t)grid.height;
    ck_assert_uint_le(count, MOST);
    if (all <= MOST)
        ck_assert_uint_eq(count, all);
    else
        ck_assert_uint_ge(count, MOST / 4);
    bool even = true;
    for (size_t i = 0; i < count; i++) {
        struct rn_spot spot = rn_validate_spot(&grid, i);
        even &= spot.x >= 0 && spot.x < width && spot.y >= 0 && spot.y < height;
        even &= spot.x % grid.apart == grid.apart / 2 && spot.y % grid.apart == grid.apart / 2;
        even &= (size_t)(spot.y / grid.apart * grid.width + spot.x / grid.apart) == i;
    }
    ck_assert(even);
    struct rn_spot last = rn_validate_spot(&grid, count - 1);
    ck_assert_int_lt(width - 1 - last.x, 2 * grid.apart);
    ck_assert_int_lt(height - 1 - last.y, 2 * grid.apart);
}
END_TEST

// The figure that is kept is of as many pixels as one may wait for, those on the way of an eighth.
START_TEST(the_last_round_looks_at_more) {
    for (int views = 1; views <= 4096; views *= 8) {
        size_t on_the_way = rn_validate_most(false, views), last = rn_validate_most(true, views);
        ck_assert_uint_eq(on_the_way * (size_t)views, 1 << 18);
        ck_assert_uint_eq(last, 8 * on_the_way);
    }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("validate");
    TCase *cases = tcase_create("validate");
    tcase_add_loop_test(cases, pixels_of_a_view_are_spread_evenly, 0,
                        (int)(sizeof sizes / sizeof *sizes));
    tcase_add_test(cases, the_last_round_looks_at_more);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
