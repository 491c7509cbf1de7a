// Pictures made in one call: each unit gets its own, in any mix of sizes, none is made twice or
// lost, and what is kept has a bound.
#include "server/runner/field/ahead.h"

#include <stdlib.h>
#include <string.h>

#include "tests/support/suite.h"

enum { UNITS = 300 };

// Stands for the engine: a picture is one number, its unit's; sizes go by the unit.
static struct {
    int fit, sizes;         // pictures a call; sizes in turn
    int stops_at;           // a unit that is made in no call with others, -1: none
    int made[UNITS], calls; // how often a unit was rendered
    int lost;               // pictures that were made and not freed
    bool there[UNITS];      // of an earlier attempt
    enum rn_status fails;
    double lent_ms;
} now;

static int side_of(size_t unit) {
    return 32 << (int)(unit % (size_t)now.sizes);
}
static struct rn_render_options options_of(size_t unit) {
    int side = side_of(unit);
    return (struct rn_render_options){
        .camera = {.width = side, .height = side, .fx = (double)unit}};
}
static struct rn_render_result made(const struct rn_render_options *o) {
    int unit = (int)o->camera.fx;
    struct rn_render_result result = {.rgb.values = calloc(1, sizeof(float))};
    result.rgb.values[0] = (float)unit;
    result.stats.render_ms = 10;
    now.made[unit]++;
    now.lost++;
    return result;
}

int rn_render_fit(struct rn_engine *engine, struct rn_field *field,
                  const struct rn_render_options *options) {
    (void)engine, (void)field, (void)options;
    return now.fit;
}
enum rn_status rn_render_together(struct rn_engine *engine, struct rn_field *field,
                                  const struct rn_render_options *options, int count,
                                  bool (*keep_going)(void *context), void *context,
                                  struct rn_render_result *ret_results, int *ret_count,
                                  struct rn_error *err) {
    (void)engine, (void)field, (void)keep_going, (void)context;
    ck_assert(count >= 1 && count <= now.fit);
    if (now.fails) return rn_error_set(err, now.fails, "render", "stopped on request");
    int n = 0;
    do
        ret_results[n] = made(&options[n]);
    while (++n < count && (int)options[n].camera.fx != now.stops_at &&
           options[n].camera.width == options[0].camera.width);
    now.calls++;
    now.lent_ms += 4;
    *ret_count = n;
    return RN_OK;
}
enum rn_status rn_work_render(struct rn_work *work, struct rn_field *field,
                              const struct rn_render_options *options,
                              struct rn_render_result *ret_result, struct rn_error *err) {
    (void)work, (void)field, (void)err;
    now.calls++;
    *ret_result = made(options);
    return RN_OK;
}
bool rn_work_keep_going(void *work) {
    (void)work;
    return true;
}
double rn_work_lent_ms(const struct rn_work *work) {
    (void)work;
    return now.lent_ms;
}
void rn_render_result_finish(struct rn_render_result *result) {
    if (result->rgb.values) now.lost--;
    free(result->rgb.values);
    result->rgb.values = NULL;
}

static bool describe(void *context, size_t unit, struct rn_render_options *ret_options) {
    (void)context;
    if (now.there[unit]) return false;
    *ret_options = options_of(unit);
    return true;
}

static struct rn_host host;
static struct rn_work work = {.total = UNITS, .host = &host};
static struct rn_ahead ahead;

static void begin(int fit, int sizes) {
    rn_ahead_drop(&ahead);
    memset(&now, 0, sizeof now);
    now.fit = fit, now.sizes = sizes, now.stops_at = -1;
    ahead = (struct rn_ahead){0};
    work.done = 0;
}

// Unit work->done, as the kinds of jobs do it; its time.
static double do_unit(void) {
    struct rn_render_result result;
    struct rn_render_options options = options_of(work.done);
    OK(rn_ahead_render(&ahead, &work, NULL, &options, describe, NULL, &result, &err));
    ck_assert(result.rgb.values[0] == (float)work.done);
    rn_render_result_finish(&result);
    work.done++;
    return result.stats.render_ms;
}

// _i: so many a call; sizes in turn as of an evaluation on so many scales.
START_TEST(every_unit_gets_its_own) {
    for (int fit = 1; fit <= 32; fit += _i ? 31 : 6) {
        size_t most = 0;
        begin(fit, 1 + _i);
        while (work.done < UNITS) {
            do_unit();
            most = ahead.count > most ? ahead.count : most;
        }
        for (int i = 0; i < UNITS; i++)
            ck_assert_int_eq(now.made[i], 1);
        ck_assert_int_eq(now.lost, 0);
        ck_assert_uint_le(most, RN_AHEAD_MOST);
        // As many calls as it takes, but where there was no room for more.
        int calls = (1 + _i) * ((UNITS / (1 + _i) + fit - 1) / fit);
        ck_assert_int_ge(now.calls, calls);
        ck_assert_int_le(now.calls, fit == 1 || !_i ? calls : 2 * calls);
    }
}
END_TEST

// Units of an earlier attempt are not made; one that comes to be there meanwhile is let go; so is
// all that is left when the job ends.
START_TEST(what_is_there_is_not_made) {
    begin(8, 1);
    for (size_t i = 0; i < UNITS; i += 2)
        now.there[i + 1] = true;
    do_unit(); // 0, and 2, 4, .. 14
    ck_assert(now.made[14] == 1 && now.made[16] == 0 && now.made[1] == 0);
    work.done = 5; // somebody else made 2 and 4
    do_unit();
    ck_assert_int_eq(now.made[5], 1);
    for (int i = 6; i <= 14; i += 2)
        ck_assert_int_eq(now.made[i], 1); // it is kept already
    ck_assert_int_eq(now.made[16], 1);
    ck_assert_uint_le(ahead.count, 5 + 8);
    for (size_t i = 0; i < ahead.count; i++)
        ck_assert_uint_gt(ahead.pictures[i].unit, 5);
    rn_ahead_drop(&ahead);
    ck_assert_int_eq(now.lost, 0);
}
END_TEST

// One that the device does not make with the others waits for its turn; a failed call leaves
// nothing.
START_TEST(calls_that_end_early) {
    begin(8, 1);
    now.stops_at = 3;
    do_unit();
    ck_assert(now.made[2] == 1 && now.made[3] == 0 && ahead.count == 2);
    do_unit(), do_unit(), do_unit();
    ck_assert(now.made[3] == 1 && now.made[10] == 1 && ahead.count == 7);
    while (ahead.count > 0)
        do_unit();
    now.fails = RN_ERROR_CANCELLED;
    struct rn_render_result result;
    struct rn_render_options options = options_of(work.done);
    struct rn_error err;
    ck_assert(rn_ahead_render(&ahead, &work, NULL, &options, describe, NULL, &result, &err) ==
              RN_ERROR_CANCELLED);
    ck_assert(now.lost == 0 && ahead.count == 0);
}
END_TEST

// What interactive pictures took within a call is nobody's time; pictures that are kept are at most
// so many pixels, however many sizes there are.
START_TEST(time_and_room) {
    begin(4, 1);
    for (int i = 0; i < 4; i++)
        ck_assert_double_eq(do_unit(), 10 - 4 / 4.0);
    begin(32, 5); // up to 512 pixels a side
    while (work.done < UNITS) {
        size_t pixels = 0;
        do_unit();
        for (size_t i = 0; i < ahead.count; i++)
            pixels += ahead.pictures[i].pixels;
        ck_assert_uint_le(pixels, 1 << 20);
    }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("ahead");
    TCase *group = tcase_create("ahead");
    tcase_add_loop_test(group, every_unit_gets_its_own, 0, 4);
    tcase_add_test(group, what_is_there_is_not_made);
    tcase_add_test(group, calls_that_end_early);
    tcase_add_test(group, time_and_room);
    suite_add_tcase(suite, group);
    return run_suite(suite);
}
