// What is kept free of a deadline, by what pictures before needed: made figures, no clock.
#include <stdlib.h>

#include "server/runner/field/pace.h"
#include "tests/support/suite.h"

static struct rn_pace_end end;

static void note(int count, double needed_ms) {
    for (int i = 0; i < count; i++)
        rn_pace_note(&end, needed_ms);
}

static void expect(double asked_ms, double kept_ms) {
    ck_assert_double_eq_tol(rn_pace_keep_ms(&end, asked_ms), kept_ms + RN_PACE_AWAY_MS, 1e-12);
}

START_TEST(what_one_picture_needed_is_kept_for_all_that_are_remembered) {
    end = (struct rn_pace_end){0};
    note(200, 0.7);
    expect(50, 0.7);
    note(1, 2.5);
    expect(50, 2.5);
    note(RN_PACE_MEMORY - 1, 0.7);
    expect(50, 2.5);
    note(1, 0.7);
    expect(50, 0.7);
}
END_TEST

START_TEST(before_much_is_known_more_is_kept) {
    end = (struct rn_pace_end){0};
    double first_ms = rn_pace_keep_ms(&end, 50) - RN_PACE_AWAY_MS;
    ck_assert(first_ms > 1 && first_ms < 5);
    note(10, 0.7);
    expect(50, first_ms);
    note(1, first_ms + 1);
    expect(50, first_ms + 1);
    note(200, 0.7);
    expect(50, 0.7);
}
END_TEST

START_TEST(most_of_the_time_is_for_the_picture) {
    end = (struct rn_pace_end){0};
    note(200, 40);
    expect(1000, 40);
    ck_assert(rn_pace_keep_ms(&end, 10) < 5);
    note(200, -30); // that ended long before: something is kept all the same
    ck_assert(rn_pace_keep_ms(&end, 10) > 0);
}
END_TEST

// Of pictures that need a time drawn from one distribution, one of 129 needs more than was kept.
START_TEST(one_of_129_is_late) {
    uint32_t state = 1;
    int late = 0;
    end = (struct rn_pace_end){0};
    for (int i = 0; i < 100000; i++) {
        state = state * 1664525 + 1013904223;
        double needed_ms = 1 + 0.5 * (double)state / 4294967296.0;
        late += i >= RN_PACE_MEMORY && needed_ms > rn_pace_keep_ms(&end, 100) - RN_PACE_AWAY_MS;
        rn_pace_note(&end, needed_ms);
    }
    ck_assert_int_le(abs(late - 100000 / 129), 100);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("pace");
    TCase *tests = tcase_create("pace");
    tcase_add_test(tests, what_one_picture_needed_is_kept_for_all_that_are_remembered);
    tcase_add_test(tests, before_much_is_known_more_is_kept);
    tcase_add_test(tests, most_of_the_time_is_for_the_picture);
    tcase_add_test(tests, one_of_129_is_late);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
