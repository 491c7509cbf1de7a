#include <check.h>
#include <stdbool.h>
#include <stdlib.h>

#include "server/engine/train/draw.h"

#define PIXELS (RN_LIVE_BLOCK * RN_LIVE_BLOCK)

// As many turns as there are blocks, from anywhere on, reach four fifths of them, none more than
// twice; three times as many reach all. Independent draws would leave out e^-1 and e^-3 of them.
START_TEST(rounds_lie_evenly_over_the_blocks) {
    for (uint64_t count = 40; count < 100000; count = 3 * count + 1)
        for (uint64_t seed = 0; seed < 3; seed++) {
            int *visits = calloc(count, sizeof *visits);
            uint64_t reached = 0, most = 0;
            ck_assert_ptr_nonnull(visits);
            for (uint64_t i = 0; i < 3 * count; i++) {
                if (i == count) ck_assert(5 * reached >= 4 * count && most <= 2);
                struct rn_live_pixel p = rn_live_pixel(seed, 7919 * seed + i, count);
                ck_assert_uint_lt(p.block, count);
                reached += visits[p.block]++ == 0;
                if (visits[p.block] > (int)most) most++;
            }
            ck_assert_uint_eq(reached, count);
            free(visits);
        }
}
END_TEST

// 64 rounds reach every pixel of a block that every round reaches.
START_TEST(rounds_take_other_pixels) {
    bool seen[PIXELS] = {false};
    for (uint64_t turn = 0; turn < PIXELS; turn++) {
        struct rn_live_pixel p = rn_live_pixel(5, turn, 1);
        ck_assert(p.x >= 0 && p.x < RN_LIVE_BLOCK && p.y >= 0 && p.y < RN_LIVE_BLOCK);
        ck_assert(!seen[p.y * RN_LIVE_BLOCK + p.x]);
        seen[p.y * RN_LIVE_BLOCK + p.x] = true;
    }
}
END_TEST

// Every scale's turns are counted without gaps; one in RN_SCALE_TURNS for each but the finest.
START_TEST(scales_take_turns) {
    for (int scales = 1; scales <= RN_SCALE_TURNS; scales++) {
        uint64_t turns[RN_SCALE_TURNS] = {0}, rounds = 100;
        for (uint64_t i = 0; i < rounds * RN_SCALE_TURNS; i++) {
            struct rn_scale_turn at = rn_scale_turn(i, scales);
            ck_assert(at.scale >= 0 && at.scale < scales);
            ck_assert_uint_eq(at.turn, turns[at.scale]);
            turns[at.scale]++;
        }
        for (int s = 1; s < scales; s++)
            ck_assert_uint_eq(turns[s], rounds);
    }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("draw");
    TCase *tests = tcase_create("pixels");
    tcase_add_test(tests, rounds_lie_evenly_over_the_blocks);
    tcase_add_test(tests, rounds_take_other_pixels);
    tcase_add_test(tests, scales_take_turns);
    suite_add_tcase(suite, tests);
    SRunner *runner = srunner_create(suite);
    srunner_run_all(runner, CK_NORMAL);
    int failed = srunner_ntests_failed(runner);
    srunner_free(runner);
    return failed != 0;
}
