// Pictures whose samples read the nearest level of a pyramid alone, for every kernel set this
// machine can run.
#include <math.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/scene/occupancy.h"
#include "server/engine/scene/scene.h"
#include "tests/support/suite.h"

#define RAYS 40
#define BASE 32
#define FAR 1e4f     // from the camera: a cone is as wide all along a ray
#define APART 0.004f // of colours: features may be rounded to bf16

struct scene {
    struct rn_engine engine;
    struct rn_field *field;
    struct rn_march_ray rays[RAYS];
};

static float unit(uint64_t i) {
    return rn_rng_unit(rn_rng_draw(17, 1, i).v[0]);
}

static void set_up(const struct rn_kernels *kernels, struct scene *s) {
    struct rn_train_config config;
    struct rn_bounds bounds = {.radius = 1};
    ck_assert_int_eq(rn_preset("standard", false, &config, NULL), RN_OK);
    config.field.planes = 3;
    config.field.base = BASE;
    config.field.channels = 8;
    config.field.levels = 4;
    config.field.occupancy = 16;
    config.field.voxels = false;
    config.field.footprint = RN_FOOTPRINT_MIP;
    config.field.mean_level = false;
    config.step = 0.05;
    memset(s, 0, sizeof *s);
    s->engine.kernels = kernels;
    ck_assert_int_eq(rn_pool_create(1, &s->engine.pool, NULL), RN_OK);
    ck_assert_int_eq(rn_field_create(&config, &bounds, &s->field, NULL), RN_OK);
    ck_assert_int_eq(rn_field_need_levels(s->field, config.field.levels, NULL), RN_OK);
    rn_field_randomise(s->field, 5);
    for (size_t i = 0; i < s->field->parameters.plane_count; i++)
        s->field->parameters.values[i] = 4 * unit(1000 + i) - 2;
    for (uint64_t i = 0, n = s->field->hull_cells; n > 0; n -= s->field->hull[i++])
        s->field->occupancy[i] = s->field->hull[i];
    rn_field_refresh_occupancy(s->field);
    rn_field_refresh(s->field, &s->engine);
    ck_assert_int_eq(rn_engine_prepare(&s->engine, s->field, NULL), RN_OK);
    for (int r = 0; r < RAYS; r++) {
        struct rn_ray ray = {.radius = 0.01,
                             .origin = {unit(10 * r) - 0.5, unit(10 * r + 1) - 0.5, -3},
                             .direction = {0, 0, 1}};
        s->rays[r] = rn_march_ray_from(s->field, &ray, config.step, 0.2);
        s->rays[r].near = FAR;
    }
}

static void tear_down(struct scene *s) {
    rn_block_destroy(s->engine.workspaces);
    rn_field_destroy(&s->field);
    rn_pool_destroy(&s->engine.pool);
}

// Of cones that ask for `level` all along.
static void look(struct scene *s, float level, bool whole, struct rn_pixel pixels[RAYS]) {
    struct rn_march_options options = {
        .step = (float)s->field->config.step, .stop_depth = 1e9f, .whole_levels = whole};
    for (int r = 0; r < RAYS; r++)
        s->rays[r].radius = exp2f(level) / (BASE * FAR);
    s->engine.kernels->render(&s->field->cpu, &options, s->rays, RAYS,
                              rn_engine_workspace(&s->engine, 0), pixels);
}

// The largest difference of two pictures' colours.
static float apart(const struct rn_pixel *a, const struct rn_pixel *b) {
    float most = 0;
    for (int i = 0; i < 3 * RAYS; i++)
        most = fmaxf(most, fabsf(a[i / 3].rgb[i % 3] - b[i / 3].rgb[i % 3]));
    return most;
}

START_TEST(the_nearest_level_is_read_alone) {
    const struct rn_kernels *kernels;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++) {
        struct rn_pixel exact[RAYS], between[RAYS], whole[RAYS];
        struct scene s;
        set_up(kernels, &s);
        for (float level = 0; level < 2.6f; level += 0.35f) {
            float nearest = floorf(level + 0.5f);
            look(&s, nearest, false, exact);
            look(&s, level, false, between);
            look(&s, level, true, whole);
            ck_assert_float_le(apart(whole, exact), APART);
            if (fabsf(level - nearest) > 0.2f) ck_assert_float_gt(apart(between, exact), 3 * APART);
        }
        tear_down(&s);
    }
}
END_TEST

int main(void) {
    Suite *suite = suite_create("levels");
    TCase *tests = tcase_create("whole");
    tcase_set_timeout(tests, 120);
    tcase_add_test(tests, the_nearest_level_is_read_alone);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
