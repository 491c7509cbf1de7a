// Effects of the camera against what they are by definition: the defocus of a point against the
// circle of confusion, a shutter and a lens against the mean of exact pictures from every instant
// and place, parallel rays against cameras that stand elsewhere, film against its light.
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "server/engine/render/develop.h"
#include "server/engine/render/optics.h"
#include "tests/ops/train_scene.h"

#define SIDE 32 // pixels
#define PICTURE (SIDE * SIDE)

static struct rn_camera camera_at(double x, double y, double z) {
    struct rn_camera camera = {
        .width = SIDE, .height = SIDE, .fx = 40, .fy = 40, .cx = SIDE / 2, .cy = SIDE / 2};
    const double eye[3] = {x, y, z}, middle[3] = {0}, up[3] = {0, 0, 1};
    ck_assert(rn_camera_look_at(eye, middle, up, camera.world_from_camera) == RN_OK);
    return camera;
}

static struct rn_render_result render(struct rn_engine *engine, struct rn_field *field,
                                      const struct rn_camera *camera, const struct rn_shot *shot,
                                      int cones) {
    struct rn_error err;
    struct rn_render_result result;
    struct rn_render_options options = {.camera = *camera,
                                        .outputs =
                                            RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA,
                                        .background = {1, 1, 1},
                                        .settings = {.supersample = cones}};
    if (shot) options.shot = *shot;
    ck_assert_msg(rn_render(engine, field, &options, NULL, NULL, &result, &err) == RN_OK, "%s: %s",
                  err.where, err.text);
    return result;
}

static struct rn_trainer *train(struct rn_engine *engine) {
    struct rn_train_config config = config_for(dataset);
    struct rn_trainer *t = trainer_for(engine, dataset, &config);
    run_to_end(t);
    return t;
}

// A point at the distance d seen from every place on the lens: spread over the disc of confusion,
// evenly, and nowhere else.
START_TEST(a_point_is_blurred_by_the_circle_of_confusion) {
    struct rn_field field = {.bounds = {.radius = 1}};
    struct rn_camera camera = camera_at(0, -4, 0);
    for (int i = 0; i < 40; i++) {
        double aperture = 0.01 * (1 + i % 5), focus = 1 + 0.5 * (i / 5), d = 0.5 + 0.37 * i;
        struct rn_shot shot = {.optics = {.aperture = aperture, .focus = focus}};
        double point[3] = {0.1 * d, d - 4, 0.05 * d}, from[3], sharp[2], squares = 0, most = 0;
        rn_camera_axes(&camera, point, from);
        ck_assert(rn_camera_project(&camera, from, sharp));
        struct rn_viewpoints *v = rn_viewpoints_create(&shot, &camera, &field, SIDE, SIDE);
        double radius = 0.5 * camera.fy * aperture * fabs(d - focus) / (d * focus);
        for (int k = 0; k < RN_OPTICS_VIEWS; k++) {
            double at[2];
            rn_camera_axes(&v->camera[k], point, from);
            ck_assert(rn_camera_project(&v->camera[k], from, at));
            double square = pow(at[0] - sharp[0], 2) + pow(at[1] - sharp[1], 2);
            squares += square / RN_OPTICS_VIEWS;
            most = fmax(most, square);
        }
        ck_assert_double_le(sqrt(most), radius * (1 + 1e-9) + 1e-9);
        ck_assert_double_ge(sqrt(most), 0.96 * radius - 1e-9); // the strata's middles
        ck_assert_double_eq_tol(squares, radius * radius / 2, 0.01 * radius * radius + 1e-12);
        rn_viewpoints_destroy(&v);
    }
}
END_TEST

// Of any pixel, the cones look from places that differ, a quarter of them from each quadrant of the
// lens, half of them in each half of the time.
START_TEST(a_pixel_s_cones_are_spread_evenly) {
    for (int n = 2; n <= 16; n *= 2)
        for (int pixel = 0; pixel < 300; pixel++) {
            bool seen[RN_OPTICS_VIEWS] = {0};
            int block = -1;
            for (int i = 0; i < n * n; i++) {
                int k = rn_viewpoints_choose(pixel % 17, pixel / 17, n, i);
                ck_assert(k >= 0 && k < RN_OPTICS_VIEWS && !seen[k]);
                ck_assert(block < 0 || k / (n * n) == block);
                block = k / (n * n);
                seen[k] = true;
            }
        }
}
END_TEST

static double rms_against_light(const struct rn_picture *picture, const double *light) {
    double squares = 0;
    for (int i = 0; i < 3 * PICTURE; i++) {
        double is = (double)rn_srgb_from_linear((float)light[i]);
        squares += pow((double)picture->values[i] - is, 2) / (3 * PICTURE);
    }
    return sqrt(squares);
}

// The light of the pixels of an exact picture: the means of the cones, each a pixel of a finer one.
static void add_light(struct rn_engine *engine, struct rn_field *field,
                      const struct rn_camera *camera, int cones, double share, double *light) {
    struct rn_camera fine = rn_camera_resized(camera, SIDE * cones, SIDE * cones);
    struct rn_render_result exact = render(engine, field, &fine, NULL, 1);
    share /= cones * cones;
    for (int y = 0; y < SIDE * cones; y++)
        for (int x = 0; x < SIDE * cones; x++)
            for (int c = 0; c < 3; c++)
                light[3 * (y / cones * SIDE + x / cones) + c] +=
                    share *
                    (double)rn_srgb_to_linear(exact.rgb.values[3 * (y * SIDE * cones + x) + c]);
    rn_render_result_finish(&exact);
}

START_TEST(a_shutter_is_the_mean_of_exact_instants) {
    enum { INSTANTS = 32 };
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = train(engine);
    struct rn_field *field = rn_trainer_field(t);
    struct rn_camera instants[INSTANTS];
    static double light[3 * PICTURE];
    for (int i = 0; i < INSTANTS; i++)
        instants[i] = camera_at(0, -4, 0.5),
        instants[i].world_from_camera[0][3] = 0.6 * i / INSTANTS;
    struct rn_shot shot = {
        .optics = {.shutter = 1}, .instants = instants, .instant_count = INSTANTS};
    double before = 1;
    for (int cones = 2; cones <= 16; cones *= 2) {
        memset(light, 0, sizeof light);
        for (int i = 0; i < INSTANTS; i++)
            add_light(engine, field, &instants[i], cones, 1.0 / INSTANTS, light);
        struct rn_render_result is = render(engine, field, &instants[INSTANTS / 2], &shot, cones);
        double off = rms_against_light(&is.rgb, light);
        printf("shutter, %d cones a side: %.4f off\n", cones, off);
        ck_assert_double_lt(off, 0.8 * before); // it converges
        before = off;
        rn_render_result_finish(&is);
    }
    ck_assert_double_lt(before, 0.008);
    struct rn_render_result still = render(engine, field, &instants[INSTANTS / 2], NULL, 8);
    ck_assert_double_gt(rms_against_light(&still.rgb, light), 0.02); // there is something to blur
    rn_render_result_finish(&still);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

START_TEST(a_lens_is_the_mean_of_exact_places) {
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = train(engine);
    struct rn_field *field = rn_trainer_field(t);
    struct rn_camera camera = camera_at(0, -4, 0.5);
    static double light[3 * PICTURE];
    const double aperture = 0.6, focus = 2.5;
    int places = 0;
    memset(light, 0, sizeof light);
    for (int pass = 0; pass < 2; pass++) // count, then add
        for (int i = 0; i < 81; i++) {
            double u = (i % 9 - 4) / 9.0, v = (i / 9 - 4) / 9.0;
            if (hypot(u, v) > 0.5) continue;
            places += pass == 0;
            if (pass == 0) continue;
            struct rn_camera at = camera;
            for (int k = 0; k < 3; k++)
                at.world_from_camera[k][3] += aperture * (u * camera.world_from_camera[k][0] +
                                                          v * camera.world_from_camera[k][1]);
            at.cx += camera.fx * aperture * u / focus;
            at.cy += camera.fy * aperture * v / focus;
            add_light(engine, field, &at, 8, 1.0 / places, light);
        }
    struct rn_shot shot = {.optics = {.aperture = aperture, .focus = focus}};
    struct rn_render_result is = render(engine, field, &camera, &shot, 8);
    double off = rms_against_light(&is.rgb, light);
    printf("lens: %.4f off the mean of %d places\n", off, places);
    ck_assert_double_lt(off, 0.01);
    rn_render_result_finish(&is);
    is = render(engine, field, &camera, NULL, 16);
    ck_assert_double_gt(rms_against_light(&is.rgb, light), 0.03);
    rn_render_result_finish(&is);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

// Along parallel rays nothing gets smaller: from twice as far away it is the same picture, and as
// much deeper. The sphere is as large as it is.
START_TEST(parallel_rays_do_not_depend_on_the_distance) {
    struct rn_engine *engine = engine_with(2);
    struct rn_trainer *t = train(engine);
    struct rn_field *field = rn_trainer_field(t);
    struct rn_camera near = camera_at(0, -4, 0), far = camera_at(0, -9, 0);
    struct rn_shot shot = {.optics = {.ortho_height = 4}};
    struct rn_render_result a = render(engine, field, &near, &shot, 1);
    struct rn_render_result b = render(engine, field, &far, &shot, 1);
    double colour = 0, depth = 0, area = 0;
    for (int i = 0; i < PICTURE; i++) {
        for (int c = 0; c < 3; c++)
            colour =
                fmax(colour, fabs((double)(a.rgb.values[3 * i + c] - b.rgb.values[3 * i + c])));
        if (a.alpha.values[i] > 0.5f)
            depth = fmax(depth, fabs((double)(b.depth.values[i] - a.depth.values[i]) - 5));
        area += (double)a.alpha.values[i];
    }
    struct rn_render_result seen = render(engine, field, &near, NULL, 1);
    printf("parallel rays: colour %.2g, depth %.2g, area %.1f of %d pixels\n", colour, depth, area,
           PICTURE);
    ck_assert_double_lt(colour, 1e-3);
    ck_assert_double_lt(depth, 5e-3);
    ck_assert_double_gt(depth, 0); // not the same picture twice
    ck_assert_double_gt(area, 10);
    rn_render_result_finish(&a);
    rn_render_result_finish(&b);
    rn_render_result_finish(&seen);
    rn_trainer_destroy(&t);
    rn_engine_destroy(&engine);
}
END_TEST

START_TEST(what_cannot_be_is_refused) {
    struct rn_field field = {.bounds = {.radius = 1}};
    struct rn_camera camera = camera_at(0, -4, 0);
    struct rn_error err;
    struct rn_shot no_focus = {.optics = {.aperture = 0.1}}, still = {.optics = {.shutter = 0.5}};
    struct rn_shot lens = {.optics = {.aperture = 0.1, .focus = 2}};
    struct rn_shot parallel = {.optics = {.ortho_height = 2}};
    ck_assert(rn_shot_check(&no_focus, &camera, &field, &err) == RN_ERROR_INVALID);
    ck_assert_str_eq(err.where, "focus");
    ck_assert(rn_shot_check(&still, &camera, &field, &err) == RN_ERROR_INVALID);
    ck_assert(rn_shot_check(&lens, &camera, &field, &err) == RN_OK);
    camera.lens = RN_LENS_FISHEYE;
    ck_assert(rn_shot_check(&lens, &camera, &field, &err) == RN_ERROR_INVALID);
    camera.lens = RN_LENS_PINHOLE;
    ck_assert(rn_shot_check(&parallel, &camera, &field, &err) == RN_OK);
    field.cpu.disparity.on = true;
    ck_assert(rn_shot_check(&parallel, &camera, &field, &err) == RN_ERROR_UNSUPPORTED);
}
END_TEST

START_TEST(film_changes_the_light) {
    const float white[3] = {1, 1, 1};
    struct rn_development none = rn_development_of(0, 0), brighter = rn_development_of(1, 0);
    struct rn_development same = rn_development_of(0, RN_DAYLIGHT_K),
                          warm = rn_development_of(0, 2856);
    float grey[3] = {0.5f, 0.4f, 0.3f}, half[3] = {0.75f, 0.7f, 0.65f}, before[3], lamp[3];
    ck_assert(!none.on);
    memcpy(before, grey, sizeof grey);
    rn_develop(&none, 1, white, grey);
    ck_assert(memcmp(before, grey, sizeof grey) == 0);
    rn_develop(&same, 1, white, grey);
    for (int c = 0; c < 3; c++)
        ck_assert_float_eq_tol(grey[c], before[c], 2e-6f);
    rn_develop(&brighter, 1, white, grey);
    rn_develop(&brighter, 0.5f, white, half); // the same colours, half covering white
    for (int c = 0; c < 3; c++) {
        ck_assert_float_eq_tol(rn_srgb_to_linear(grey[c]), 2 * rn_srgb_to_linear(before[c]), 1e-5f);
        ck_assert_float_eq_tol(half[c], 0.5f * grey[c] + 0.5f, 1e-5f);
    }
    // Standard illuminant A (2856 K) has the chromaticity (0.4476, 0.4074): Bradford's adaptation
    // leaves it grey, as far as the black body's fit goes.
    const double a[3] = {0.4476 / 0.4074, 1, (1 - 0.4476 - 0.4074) / 0.4074};
    const double rgb[3][3] = {{3.2404542, -1.5371385, -0.4985314},
                              {-0.9692660, 1.8760108, 0.0415560},
                              {0.0556434, -0.2040259, 1.0572252}};
    for (int i = 0; i < 3; i++) {
        double light = 0;
        for (int k = 0; k < 3; k++)
            light += 0.3 * rgb[i][k] * a[k];
        lamp[i] = rn_srgb_from_linear((float)light);
    }
    ck_assert_float_gt(lamp[0] - lamp[2], 0.3f);
    rn_develop(&warm, 1, white, lamp);
    ck_assert_float_eq_tol(lamp[0], lamp[1], 0.02f);
    ck_assert_float_eq_tol(lamp[2], lamp[1], 0.03f);
}
END_TEST

// Stored values times the gains, of what is the scene's; the film comes after.
START_TEST(a_photograph_s_exposure_is_put_back) {
    const float white[3] = {1, 1, 1};
    const double gain[3] = {1.5, 1, 0.5}, none[3] = {0};
    float grey[3] = {0.5f, 0.4f, 0.3f}, half[3] = {0.75f, 0.7f, 0.65f},
          film[3] = {0.5f, 0.4f, 0.3f};
    struct rn_development taken = rn_development_of(0, 0), brighter = rn_development_of(1, 0);
    rn_development_expose(&taken, none);
    ck_assert(!taken.on);
    rn_development_expose(&taken, gain);
    rn_development_expose(&brighter, gain);
    rn_develop(&taken, 1, white, grey);
    rn_develop(&taken, 0.5f, white, half); // the same colours, half covering white
    rn_develop(&brighter, 1, white, film);
    const float expected[3] = {0.75f, 0.4f, 0.15f};
    for (int c = 0; c < 3; c++) {
        ck_assert_float_eq_tol(grey[c], expected[c], 2e-6f);
        ck_assert_float_eq_tol(half[c], 0.5f * expected[c] + 0.5f, 2e-6f);
        ck_assert_float_eq_tol(rn_srgb_to_linear(film[c]), 2 * rn_srgb_to_linear(expected[c]),
                               1e-5f);
    }
}
END_TEST

static void add(TCase *tests) {
    tcase_add_test(tests, a_point_is_blurred_by_the_circle_of_confusion);
    tcase_add_test(tests, a_pixel_s_cones_are_spread_evenly);
    tcase_add_test(tests, a_shutter_is_the_mean_of_exact_instants);
    tcase_add_test(tests, a_lens_is_the_mean_of_exact_places);
    tcase_add_test(tests, parallel_rays_do_not_depend_on_the_distance);
    tcase_add_test(tests, what_cannot_be_is_refused);
    tcase_add_test(tests, film_changes_the_light);
    tcase_add_test(tests, a_photograph_s_exposure_is_put_back);
}

int main(void) {
    return run_on_scene("optics", add);
}
