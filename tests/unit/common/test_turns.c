// Whose turn the cores are: made times, no clock.
#include <stdlib.h>

#include "common/base/turns.h"
#include "tests/support/suite.h"

#define MS 1000000ll
#define MOST (10 * MS)

static struct rn_turns turns;
static int64_t now_ns, worked_ns, longest_ns; // longest: that a picture waited for the work

static void set_up(void) {
    turns = (struct rn_turns){0};
    now_ns = 1000 * MS;
    worked_ns = longest_ns = 0;
}

// The work goes on for so long where it may, and a picture that is asked for then comes.
static void picture_after(int64_t gap_ns, int64_t takes_ns) {
    int64_t asked_ns = now_ns + gap_ns;
    while (now_ns < asked_ns || rn_turns_at(&turns, now_ns) == RN_TURN_OWN) {
        int64_t next_ns = rn_turns_next_ns(&turns, now_ns);
        if (next_ns > asked_ns && now_ns < asked_ns) next_ns = asked_ns;
        ck_assert(next_ns > now_ns);
        if (rn_turns_at(&turns, now_ns) != RN_TURN_WAITS) worked_ns += next_ns - now_ns;
        now_ns = next_ns;
    }
    if (now_ns - asked_ns > longest_ns) longest_ns = now_ns - asked_ns;
    int64_t began_ns = now_ns;
    now_ns += takes_ns;
    rn_turns_end(&turns, began_ns, now_ns, MOST);
}

START_TEST(the_work_has_its_share_however_close_pictures_follow) {
    static const int64_t takes_ns[] = {MS, 5 * MS, 22 * MS, 89 * MS};
    for (int i = 0; i < 4; i++) {
        set_up();
        for (int k = 0; k < 1000; k++)
            picture_after(0, takes_ns[i]);
        double share = (double)worked_ns / (double)(now_ns - 1000 * MS);
        ck_assert_double_ge(share, 0.99 * RN_TURNS_SHARE);
        ck_assert_double_le(share, 1.2 * RN_TURNS_SHARE);
        ck_assert_int_le(longest_ns, MOST);
    }
}
END_TEST

// Of pictures that take longer a tenth would be long to wait for: it has `most` after each.
START_TEST(no_picture_waits_for_long) {
    for (int k = 0; k < 10; k++)
        picture_after(0, 5000 * MS);
    ck_assert_int_eq(worked_ns, 8 * MOST); // after the second to the ninth
    ck_assert_int_eq(longest_ns, MOST);
}
END_TEST

// As somebody drags: it stands still in the second half of each gap, and no picture waits.
START_TEST(a_picture_finds_the_cores_free) {
    for (int k = 0; k < 10; k++) {
        picture_after(20 * MS, 10 * MS);
        if (k == 0) continue; // nothing was known then
        ck_assert_int_eq(rn_turns_at(&turns, now_ns), RN_TURN_OWN);
        ck_assert_int_eq(rn_turns_at(&turns, now_ns + 9 * MS), RN_TURN_FREE);
        ck_assert_int_eq(rn_turns_at(&turns, now_ns + 11 * MS), RN_TURN_WAITS);
        ck_assert_int_eq(rn_turns_at(&turns, now_ns + 49 * MS), RN_TURN_WAITS);
        ck_assert_int_eq(rn_turns_at(&turns, now_ns + 50 * MS), RN_TURN_FREE);
    }
    ck_assert_int_eq(longest_ns, 0);
}
END_TEST

// Pictures that do not follow one another, and the first of any: nothing stands still.
START_TEST(a_picture_alone_holds_nothing_up) {
    for (int k = 0; k < 10; k++) {
        picture_after(51 * MS, 10 * MS);
        ck_assert_int_eq(rn_turns_at(&turns, now_ns), RN_TURN_FREE);
        ck_assert(rn_turns_next_ns(&turns, now_ns) == INT64_MAX);
    }
    ck_assert_int_eq(worked_ns, 10 * 51 * MS);
}
END_TEST

// A picture of the daemon's is over only when it is sent: until then it is under way.
START_TEST(until_it_is_there_the_work_waits) {
    picture_after(0, 10 * MS);
    rn_turns_end(&turns, now_ns, now_ns + 2 * MS, MOST);
    ck_assert_int_eq(rn_turns_at(&turns, now_ns + MS), RN_TURN_WAITS);
    ck_assert(rn_turns_next_ns(&turns, now_ns) == now_ns + 2 * MS);
    ck_assert_int_eq(rn_turns_at(&turns, now_ns + 2 * MS), RN_TURN_OWN);
}
END_TEST

static int64_t ready_ns; // when somebody asks for the next picture

// The work, or nothing, goes on for so long; pictures that come meanwhile are made within.
static void pass(int64_t left_ns, int64_t gap_ns) {
    while (ready_ns - now_ns < left_ns) {
        left_ns -= ready_ns - now_ns;
        rn_turns_end(&turns, ready_ns, ready_ns + 10 * MS, MOST);
        now_ns = ready_ns + 10 * MS;
        ready_ns = now_ns + gap_ns;
    }
    now_ns += left_ns;
}

// Of pieces that take 30 ms, each begun as soon as it may, beside pictures.
static double share_of_pieces(int64_t gap_ns) {
    int64_t begin_ns = now_ns;
    ready_ns = now_ns + gap_ns;
    while (now_ns < begin_ns + 10000 * MS) {
        int64_t rest_ns = rn_turns_rest_ns(&turns, now_ns);
        if (rest_ns > 0) {
            pass(rest_ns < ready_ns - now_ns ? rest_ns : ready_ns - now_ns + 1, gap_ns);
            continue;
        }
        pass(30 * MS, gap_ns);
        worked_ns += 30 * MS;
        rn_turns_worked(&turns, 30 * MS, now_ns);
    }
    return (double)worked_ns / (double)(now_ns - begin_ns);
}

START_TEST(pieces_have_their_share_beside_pictures) {
    double share = share_of_pieces(5 * MS);
    ck_assert_double_ge(share, 0.8 * RN_TURNS_SHARE); // what pictures took within is not theirs
    ck_assert_double_le(share, RN_TURNS_SHARE);
}
END_TEST

START_TEST(pieces_go_on_where_pictures_are_not_near) {
    ck_assert_int_eq(rn_turns_rest_ns(&turns, now_ns), 0);
    ck_assert_double_ge(share_of_pieces(60 * MS), 0.8);
    set_up();
    picture_after(0, 10 * MS);
    picture_after(0, 10 * MS);
    rn_turns_worked(&turns, 1000 * MS, now_ns);
    ck_assert_int_eq(rn_turns_rest_ns(&turns, now_ns), RN_TURNS_NEAR_NS);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("turns");
    TCase *cases = tcase_create("turns");
    tcase_add_checked_fixture(cases, set_up, NULL);
    tcase_add_test(cases, the_work_has_its_share_however_close_pictures_follow);
    tcase_add_test(cases, no_picture_waits_for_long);
    tcase_add_test(cases, a_picture_finds_the_cores_free);
    tcase_add_test(cases, a_picture_alone_holds_nothing_up);
    tcase_add_test(cases, until_it_is_there_the_work_waits);
    tcase_add_test(cases, pieces_have_their_share_beside_pictures);
    tcase_add_test(cases, pieces_go_on_where_pictures_are_not_near);
    suite_add_tcase(suite, cases);
    return run_suite(suite);
}
