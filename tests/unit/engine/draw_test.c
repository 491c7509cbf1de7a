#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include "server/engine/train/importance.h"
#include "tests/support/suite.h"

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

#define BLOCKS 3000
#define BEFORE 500 // blocks of another list, in front

// Importance whose blocks' errors span six decades, a tenth of them not seen yet.
static struct rn_importance uneven(void) {
    struct rn_importance im;
    struct rn_error err;
    ck_assert_int_eq(rn_importance_init(BEFORE + BLOCKS, 2, &im, &err), RN_OK);
    for (size_t i = 0; i < BEFORE + BLOCKS; i++)
        for (int times = 0; times < 3 && i % 10 != 0; times++)
            rn_importance_note(&im, i, pow(10, -6.0 * (double)(i * 7 % 1000) / 1000));
    for (int list = 0; list < 2; list++) {
        size_t first = list ? BEFORE : 0, count = list ? BLOCKS : BEFORE;
        rn_importance_weigh(&im, first, count);
        rn_importance_lay_out(&im, list, first, count);
    }
    return im;
}

// Rays of a block that is drawn oftener weigh less: over many turns any mean over the blocks is as
// without importance, here to 1e-3 of it after 200 turns a block; a block is drawn as often as its
// share says, but for 4 turns of the 60 to 600; no share is below the even part.
START_TEST(importance_is_unbiased) {
    struct rn_importance im = uneven();
    static double visits[BLOCKS];
    double weighted[3] = {0}, plain[3] = {0}, most = 0, least = 1e9;
    uint64_t turns = 200 * BLOCKS;
    for (uint64_t turn = 0; turn < turns; turn++) {
        float weight;
        struct rn_live_pixel p = rn_importance_pixel(&im, 1, BEFORE, BLOCKS, 3, 99 + turn, &weight);
        if (p.block >= BLOCKS) ck_abort_msg("block %d", (int)p.block);
        visits[p.block]++;
        weighted[0] += (double)weight;
        weighted[1] += (double)weight * (double)p.block;
        weighted[2] += (double)weight * sin((double)p.block);
    }
    for (int b = 0; b < BLOCKS; b++) {
        double expected = (double)im.share[BEFORE + b] * (double)turns / BLOCKS;
        plain[1] += b;
        plain[2] += sin(b);
        ck_assert(fabs(visits[b] - expected) <= 4);
        most = fmax(most, visits[b]);
        least = fmin(least, visits[b]);
    }
    ck_assert(fabs(weighted[0] / (double)turns - 1) < 1e-3);
    ck_assert(fabs(weighted[1] / (double)turns / (plain[1] / BLOCKS) - 1) < 1e-3);
    ck_assert(fabs(weighted[2] / (double)turns - plain[2] / BLOCKS) < 1e-3);
    ck_assert(most > 4 * least && least >= RN_IMPORTANCE_EVEN * 200 - 4);
    rn_importance_finish(&im);
}
END_TEST

// A block's pixels take turns however often it is drawn: 100 visits leave out one in a hundred,
// none is there more than three times. Independent draws would leave out a fifth.
START_TEST(importance_takes_other_pixels) {
    struct rn_importance im = uneven();
    static uint8_t seen[BLOCKS][PIXELS];
    static int visits[BLOCKS];
    int left_out = 0;
    float weight;
    for (uint64_t turn = 0; turn < 400 * BLOCKS; turn++) {
        struct rn_live_pixel p = rn_importance_pixel(&im, 1, BEFORE, BLOCKS, 8, turn, &weight);
        if (p.x < 0 || p.x >= RN_LIVE_BLOCK || p.y < 0 || p.y >= RN_LIVE_BLOCK)
            ck_abort_msg("pixel (%d, %d) of block %d", p.x, p.y, (int)p.block);
        if (visits[p.block]++ < 100) seen[p.block][p.y * RN_LIVE_BLOCK + p.x]++;
    }
    for (int b = 0; b < BLOCKS; b++)
        for (int i = 0; i < PIXELS; i++) {
            if (visits[b] < 100 || seen[b][i] > 3) ck_abort_msg("block %d, pixel %d", b, i);
            left_out += seen[b][i] == 0;
        }
    ck_assert_int_lt(100 * left_out, BLOCKS * PIXELS);
    rn_importance_finish(&im);
}
END_TEST

// What is kept once a run of blocks says what the sums before every block would: the same blocks,
// pixels and weights, at places that blocks begin at too, in lists of any length.
START_TEST(runs_find_what_all_sums_would) {
    for (size_t count = 1; count < 120; count += count < 40 ? 1 : 13) {
        struct rn_importance im;
        struct rn_error err;
        size_t first = count * 7 % 31;
        double begin[121] = {0}, total = 0;
        ck_assert_int_eq(rn_importance_init(first + count, 2, &im, &err), RN_OK);
        for (size_t i = 0; i < first + count; i++)
            im.share[i] = (float)pow(10, -5.0 * (double)(i * i % 17) / 17);
        if (first) rn_importance_lay_out(&im, 0, 0, first);
        rn_importance_lay_out(&im, 1, first, count);
        for (size_t i = 0; i < count; total += (double)im.share[first + i++])
            begin[i] = total;
        for (size_t i = 0; i < count; i++)
            begin[i] /= total;
        begin[count] = 1;
        for (uint64_t turn = 0; turn < 50 * count; turn++) {
            float weight;
            double at = rn_golden_place(5, turn);
            uint64_t block = count - 1;
            while (begin[block] > at)
                block--;
            struct rn_live_pixel is = rn_importance_pixel(&im, 1, first, count, 5, turn, &weight);
            struct rn_live_pixel be =
                rn_pixel_of_block(block, (uint32_t)((at - begin[block]) /
                                                    (begin[block + 1] - begin[block]) * PIXELS));
            ck_assert_uint_eq(is.block, be.block);
            ck_assert(is.x == be.x && is.y == be.y && weight == 1 / im.share[first + block]);
        }
        rn_importance_finish(&im);
    }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("draw");
    TCase *tests = tcase_create("pixels");
    tcase_set_timeout(tests, 60);
    tcase_add_test(tests, rounds_lie_evenly_over_the_blocks);
    tcase_add_test(tests, rounds_take_other_pixels);
    tcase_add_test(tests, scales_take_turns);
    tcase_add_test(tests, importance_is_unbiased);
    tcase_add_test(tests, importance_takes_other_pixels);
    tcase_add_test(tests, runs_find_what_all_sums_would);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
