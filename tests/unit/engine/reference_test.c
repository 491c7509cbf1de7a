// The float64 reference of the field: its gradients by finite differences, its linear parts by
// their adjoints, and what is known in closed form.
#include <string.h>

#include "tests/unit/engine/field_samples.h"
#include "tests/support/suite.h"

#define SAMPLES 6
#define RAYS 4

static const double mids[SAMPLES] = {0.9, 1.3, 1.7, 2.1, 2.5, 3.3}; // the last is outside the ball

static double appearances[RAYS * RN_APPEARANCE], appearance_grads[RAYS * RN_APPEARANCE];

// Rays through the ball, cones wide enough for several levels; the last ray has no samples.
static void sample_rays(struct rn_reference_ray rays[RAYS]) {
    for (int r = 0; r < RAYS; r++) {
        rays[r] = (struct rn_reference_ray){.mid = mids, .width = 0.4};
        double eye[3], norm = 0;
        for (int i = 0; i < 3; i++) {
            eye[i] = sample_number(10, (uint64_t)(3 * r + i));
            norm += eye[i] * eye[i];
        }
        for (int i = 0; i < 3; i++) {
            rays[r].direction[i] = -eye[i] / sqrt(norm);
            rays[r].origin[i] =
                -1.8 * rays[r].direction[i] + 0.2 * sample_number(11, (uint64_t)(3 * r + i));
            rays[r].colour.background[i] =
                (float)(0.5 + 0.5 * sample_number(12, (uint64_t)(3 * r + i)));
            rays[r].target[i] = r == 1 ? 3 : 0.5; // ray 1: the straight part of the loss
        }
        rays[r].alpha = 0.3 * r;
        rays[r].colour.background_variance = r == 1 ? 0 : 0.1f;
        rays[r].radius = 0.03 * (r + 1);
        rays[r].count = r + 1 < RAYS ? SAMPLES : 0;
        rays[r].weight = r == 2 ? 4 : 1;
        rays[r].appearance = appearances + r * RN_APPEARANCE;
        rays[r].appearance_grad = appearance_grads + r * RN_APPEARANCE;
    }
}

static double loss_of(struct rn_reference *ref) {
    struct rn_reference_ray rays[RAYS];
    sample_rays(rays);
    rn_reference_build(ref);
    double loss;
    ck_assert_int_eq(rn_reference_loss(ref, rays, RAYS, &loss), RN_OK);
    return loss;
}

// Central differences for every `stride`-th parameter of one group, relative to the group's largest
// slope. Truncation (h^2) and rounding (1e-16 / h) stay well below the tolerance, and h is small
// enough that no ReLU changes side in between.
static void check_group(struct rn_reference *ref, const char *name, double *parameters,
                        const double *grad, size_t count, size_t stride) {
    double largest = 0, h = 1e-6;
    size_t nonzero = 0;
    for (size_t i = 0; i < count; i++) {
        largest = fmax(largest, fabs(grad[i]));
        nonzero += grad[i] != 0;
    }
    ck_assert_msg(nonzero > count / 10, "%s: %zu of %zu slopes", name, nonzero, count);
    for (size_t i = 0; i < count; i += stride) {
        double kept = parameters[i];
        parameters[i] = kept + h;
        double above = loss_of(ref);
        parameters[i] = kept - h;
        double slope = (above - loss_of(ref)) / (2 * h);
        parameters[i] = kept;
        ck_assert_msg(fabs(slope - grad[i]) <= 1e-5 * largest, "%s[%zu]: %.12g, differences %.12g",
                      name, i, grad[i], slope);
    }
}

static void check_gradients(const struct rn_field_config *config, int pixel_rays) {
    struct rn_reference *ref = sample_field(config);
    ref->pixel_rays = pixel_rays;
    memset(appearance_grads, 0, sizeof appearance_grads);
    loss_of(ref);
    double of_appearances[RAYS * RN_APPEARANCE];
    memcpy(of_appearances, appearance_grads, sizeof of_appearances);
    size_t total = ref->plane_count + ref->base_shape.count + ref->head_shape.count;
    double *grad = malloc(total * sizeof *grad);
    ck_assert_ptr_nonnull(grad);
    double *base = grad + ref->plane_count, *head = base + ref->base_shape.count;
    memcpy(grad, ref->plane_grad, ref->plane_count * sizeof *grad);
    memcpy(base, ref->base_grad, ref->base_shape.count * sizeof *grad);
    memcpy(head, ref->head_grad, ref->head_shape.count * sizeof *grad);
    check_group(ref, "planes", ref->planes, grad, ref->plane_count, 7);
    check_group(ref, "base", ref->base, base, ref->base_shape.count, 5);
    if (config->view_dependence || config->shading == RN_SHADING_SAMPLE)
        check_group(ref, "head", ref->head, head, ref->head_shape.count, 5);
    else
        for (size_t i = 0; i < ref->head_shape.count; i++)
            ck_assert(head[i] == 0);
    if (config->appearances > 0)
        check_group(ref, "appearances", appearances, of_appearances, RAYS * RN_APPEARANCE, 1);
    free(grad);
    rn_reference_destroy(&ref);
}

// _i: footprint (3) x shading (2) x view dependence (2) x base (8, 7).
START_TEST(gradients_match_finite_differences) {
    struct rn_field_config config = sample_config();
    config.footprint = (enum rn_footprint)(_i % 3);
    config.shading = (enum rn_shading)(_i / 3 % 2);
    config.view_dependence = _i / 6 % 2 == 0;
    config.base = _i / 12 % 2 == 0 ? 8 : 7;
    check_gradients(&config, 1);
}
END_TEST

START_TEST(gradients_match_on_every_solid_and_many_layers) {
    static const int planes[] = {4, 6, 10};
    struct rn_field_config config = sample_config();
    config.planes = planes[_i];
    config.base = 5;
    config.base_layers = 2;
    config.head_layers = 4;
    check_gradients(&config, 1);
}
END_TEST

// _i: in a ball, in all of space; texels of 4 and 8 channels, so that voxels end within a row.
START_TEST(gradients_match_with_voxels) {
    struct rn_field_config config = sample_config();
    config.voxels = true;
    config.space = _i % 2 ? RN_SPACE_UNBOUNDED : RN_SPACE_BALL;
    config.channels = _i / 2 ? 8 : 4;
    config.base = 9;
    check_gradients(&config, 1);
}
END_TEST

// _i: a colour a sample, a colour a ray.
START_TEST(gradients_match_in_photographs_own_light) {
    struct rn_field_config config = sample_config();
    config.shading = (enum rn_shading)_i;
    config.appearances = RAYS;
    for (int i = 0; i < RAYS * RN_APPEARANCE; i++)
        appearances[i] = sample_number(13, (uint64_t)i);
    check_gradients(&config, 1);
}
END_TEST

START_TEST(gradients_match_where_rays_share_pixels) {
    struct rn_field_config config = sample_config();
    config.shading = (enum rn_shading)(_i % 2);
    check_gradients(&config, _i / 2 ? RAYS : 2);
}
END_TEST

// <A x, y> = <x, A^T y> for the pyramid of every plane, any base size.
START_TEST(pull_down_is_the_adjoint_of_build) {
    static const int bases[] = {2, 3, 5, 7, 8, 12, 13, 31};
    struct rn_field_config config = sample_config();
    config.base = bases[_i];
    config.levels = 5;
    struct rn_reference *ref = sample_field(&config);
    double forward = 0, backward = 0, scale = 0;
    for (size_t i = 0; i < ref->map_count; i++) {
        ref->map_grad[i] = sample_number(20, i);
        forward += ref->map_grad[i] * ref->maps[i];
        scale += fabs(ref->map_grad[i] * ref->maps[i]);
    }
    rn_reference_pull_down(ref);
    for (size_t i = 0; i < ref->plane_count; i++)
        backward += ref->plane_grad[i] * ref->planes[i];
    ck_assert_msg(fabs(forward - backward) <= 1e-14 * scale, "%.17g, %.17g", forward, backward);
    for (size_t i = 0; i < ref->map_count; i++)
        ck_assert(ref->map_grad[i] == 0);
    rn_reference_destroy(&ref);
}
END_TEST

// A spike gives each neighbour its share, and takes its part of what they then are; planes stay in
// their range, those of one number as they are.
START_TEST(smoothing_draws_neighbours_together) {
    struct rn_field_config config = sample_config();
    config.base = 5;
    struct rn_reference *ref = sample_field(&config);
    size_t n = ref->plane_count, row = 5 * (size_t)config.channels,
           column = (size_t)config.channels;
    double low = 1e9, high = -1e9;
    for (size_t i = 0; i < n; i++) {
        low = fmin(low, ref->planes[i]);
        high = fmax(high, ref->planes[i]);
    }
    for (int pass = 0; pass < 100; pass++)
        rn_reference_smooth(ref, 0.25);
    for (size_t i = 0; i < n; i++)
        ck_assert(ref->planes[i] >= low && ref->planes[i] <= high);
    for (size_t i = 0; i < n; i++)
        ref->planes[i] = 0.5;
    rn_reference_smooth(ref, 0.125);
    for (size_t i = 0; i < n; i++)
        ck_assert_double_eq(ref->planes[i], 0.5);
    double *spike = ref->planes + 5 * row + 2 * row + 2 * column + 1; // second plane, its middle
    *spike = 8.5;
    rn_reference_smooth(ref, 0.125);
    ck_assert_double_eq(*spike, 0.5 + 8 * 0.5); // u + v is even: before its neighbours
    ck_assert_double_eq(spike[column], 0.5 + 4 * 0.125);
    ck_assert_double_eq(*(spike - column), 0.5 + 4 * 0.125);
    ck_assert_double_eq(spike[row], 0.5 + 4 * 0.125);
    ck_assert_double_eq(*(spike - row), 0.5 + 4 * 0.125);
    double sum = 0;
    for (size_t i = 0; i < n; i++)
        sum += ref->planes[i] - 0.5;
    ck_assert_double_eq_tol(sum, 4 + 4 * 0.5, 1e-12);
    rn_reference_destroy(&ref);
}
END_TEST

START_TEST(query_backward_is_the_adjoint_of_query) {
    struct rn_field_config config = sample_config();
    config.footprint = (enum rn_footprint)(_i % 3);
    config.base = _i / 3 == 0 ? 8 : 11;
    struct rn_reference *ref = sample_field(&config);
    for (uint64_t n = 0; n < 200; n++) {
        int plane = (int)(n % 3);
        double at[4]; // u, v beyond the plane's edges and levels beyond both ends too
        for (uint64_t i = 0; i < 4; i++)
            at[i] =
                i < 2 ? 1.2 * sample_number(21, 4 * n + i) : 1 + 1.5 * sample_number(21, 4 * n + i);
        if (config.footprint == RN_FOOTPRINT_MIP) at[3] = at[2];
        double features[4], grad[4], forward = 0, backward = 0;
        rn_reference_query(ref, plane, at[0], at[1], at[2], at[3], features);
        for (uint64_t c = 0; c < 4; c++) {
            grad[c] = sample_number(22, 4 * n + c);
            forward += grad[c] * features[c];
        }
        memset(ref->map_grad, 0, ref->map_count * sizeof(double));
        rn_reference_query_backward(ref, plane, at[0], at[1], at[2], at[3], grad);
        for (size_t i = 0; i < ref->map_count; i++)
            backward += ref->map_grad[i] * ref->maps[i];
        ck_assert_double_eq_tol(forward, backward, 1e-14);
    }
    rn_reference_destroy(&ref);
}
END_TEST

// A mipmap's level, where it is the mean of the levels that a ripmap would be read at.
START_TEST(mean_level_is_the_mean_of_both) {
    struct rn_field_config config = sample_config();
    struct rn_reference *rip = sample_field(&config);
    config.footprint = RN_FOOTPRINT_MIP;
    struct rn_reference *ball = sample_field(&config);
    config.mean_level = true;
    struct rn_reference *mean = sample_field(&config);
    struct rn_reference_ray rays[RAYS];
    sample_rays(rays);
    bool differs = false;
    for (int r = 0; r < RAYS; r++)
        for (int s = 0; s < SAMPLES; s++) {
            double l[2], m[2], b[2];
            rn_reference_levels(rip, &rays[r], r % 3, mids[s], &l[0], &l[1]);
            rn_reference_levels(mean, &rays[r], r % 3, mids[s], &m[0], &m[1]);
            rn_reference_levels(ball, &rays[r], r % 3, mids[s], &b[0], &b[1]);
            ck_assert(m[0] == (l[0] + l[1]) / 2 && m[1] == m[0]);
            differs = differs || (fabs(m[0] - b[0]) > 0.1 && fabs(l[0] - l[1]) > 0.1);
        }
    ck_assert(differs);
    rn_reference_destroy(&rip);
    rn_reference_destroy(&ball);
    rn_reference_destroy(&mean);
}
END_TEST

// The pyramid keeps constants: any query of a constant plane gives the constant, whatever the
// size, the position and the level.
START_TEST(constant_planes_query_to_the_constant) {
    struct rn_field_config config = sample_config();
    config.base = _i + 2;
    config.levels = 6;
    struct rn_reference *ref = sample_field(&config);
    for (size_t i = 0; i < ref->plane_count; i++)
        ref->planes[i] = 0.75;
    rn_reference_build(ref);
    for (uint64_t n = 0; n < 100; n++) {
        double f[4];
        rn_reference_query(ref, 1, 1.5 * sample_number(23, 4 * n), sample_number(23, 4 * n + 1),
                           3 * sample_number(23, 4 * n + 2) + 2, 5 * sample_number(23, 4 * n + 3),
                           f);
        ck_assert_double_eq_tol(f[3], 0.75, 1e-15);
    }
    rn_reference_destroy(&ref);
}
END_TEST

// Features of an elongated Gaussian at the origin, its long axis along `axis`.
static void ellipsoid_features(const struct rn_reference *ref, const double axis[3],
                               double *features) {
    struct rn_reference_ray ray = {.radius = 0.01, .width = 0.8, .count = 1};
    double mid = 2;
    double norm = sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2]);
    // The frustum's mean, not its middle, comes to lie on the origin: mid (1 + 2q / (3 + q)).
    double q = pow(0.5 * ray.width / mid, 2), mean = mid * (1 + 2 * q / (3 + q));
    for (int i = 0; i < 3; i++) {
        ray.direction[i] = axis[i] / norm;
        ray.origin[i] = -mean * ray.direction[i];
    }
    rn_reference_encode(ref, &ray, mid, features);
}

// The paper's figure: two ellipsoids at the origin along different body diagonals of the cube.
// Every plane of the cube sees the same footprint of both; other solids tell them apart.
START_TEST(ellipsoids_along_body_diagonals) {
    static const int planes[] = {3, 4, 6, 10};
    static const double diagonals[4][3] = {{1, 1, 1}, {1, 1, -1}, {1, -1, 1}, {-1, 1, 1}};
    struct rn_field_config config = sample_config();
    config.planes = planes[_i];
    config.base = 32;
    config.levels = 6;
    struct rn_reference *ref = sample_field(&config);
    double first[4 * 10], other[4 * 10];
    ellipsoid_features(ref, diagonals[0], first);
    for (int d = 1; d < 4; d++) {
        ellipsoid_features(ref, diagonals[d], other);
        double difference = 0;
        for (int i = 0; i < config.planes * config.channels; i++)
            difference = fmax(difference, fabs(first[i] - other[i]));
        if (config.planes == 3)
            ck_assert_msg(difference <= 1e-13, "diagonal %d: %g", d, difference);
        else
            ck_assert_msg(difference >= 1e-2, "diagonal %d: %g", d, difference);
    }
    rn_reference_destroy(&ref);
}
END_TEST

// All-zero parameters are fog of density exp(-1) and grey: opacity, colour and depth are known.
START_TEST(uniform_fog_has_its_closed_form) {
    struct rn_field_config config = sample_config();
    config.shading = (enum rn_shading)_i;
    struct rn_reference *ref = NULL;
    ck_assert_int_eq(rn_reference_create(&config, 1, &ref, NULL), RN_OK);
    double mid[4] = {0.6, 0.8, 1.0, 1.2};
    struct rn_reference_ray ray = {.origin = {0, 0, -0.9},
                                   .direction = {0, 0, 1},
                                   .radius = 0.001,
                                   .count = 4,
                                   .mid = mid,
                                   .width = 0.2,
                                   .colour.background = {1, 0, 0.25f}};
    double rgb[3], opacity, depth, x = exp(-1) * 0.2 * 1.5, expected_depth = 0;
    ck_assert_int_eq(rn_reference_render(ref, &ray, rgb, &opacity, &depth), RN_OK);
    for (int i = 0; i < 4; i++)
        expected_depth += exp(-x * i) * (1 - exp(-x)) * mid[i];
    ck_assert_double_eq_tol(opacity, 1 - exp(-4 * x), 1e-15);
    ck_assert_double_eq_tol(depth, expected_depth, 1e-15);
    for (int c = 0; c < 3; c++) {
        double background = (double)ray.colour.background[c];
        ck_assert_double_eq_tol(rgb[c], 0.5 * opacity + (1 - opacity) * background, 1e-15);
    }
    rn_reference_destroy(&ref);
}
END_TEST

// The loss is that of the rendered colours; rays without samples do not count.
START_TEST(loss_is_that_of_the_rendered_colours) {
    struct rn_field_config config = sample_config();
    struct rn_reference *ref = sample_field(&config);
    struct rn_reference_ray rays[RAYS];
    sample_rays(rays);
    double sum = 0, weights = 0, rgb[3], opacity, depth;
    for (int r = 0; r < RAYS - 1; r++) {
        ck_assert_int_eq(rn_reference_render(ref, &rays[r], rgb, &opacity, &depth), RN_OK);
        weights += rays[r].weight;
        for (int c = 0; c < 3; c++) {
            double d = fabs(rgb[c] - rays[r].target[c]);
            sum += rays[r].weight * (d < 1 ? d * d / 2 : d - 0.5);
        }
        double excess = opacity - rays[r].alpha;
        sum += rays[r].weight * 1.5 * rays[r].colour.background_variance * excess * excess;
    }
    ck_assert_double_eq_tol(loss_of(ref), sum / weights, 1e-14);
    rn_reference_destroy(&ref);
}
END_TEST

// A pixel's colour and opacity are the means of its rays'; one that met nothing shows its
// background.
START_TEST(split_pixels_are_means) {
    struct rn_field_config config = sample_config();
    struct rn_reference *ref = sample_field(&config);
    struct rn_reference_ray rays[RAYS];
    sample_rays(rays);
    double sum = 0, weights = 0;
    for (int r = 0; r < RAYS; r += 2) {
        double rgb[2][3], opacity[2], depth;
        for (int i = 0; i < 2; i++)
            ck_assert_int_eq(rn_reference_render(ref, &rays[r + i], rgb[i], &opacity[i], &depth),
                             RN_OK);
        if (rays[r + 1].count == 0) {
            for (int c = 0; c < 3; c++)
                rgb[1][c] = (double)rays[r + 1].colour.background[c];
            opacity[1] = 0;
        }
        for (int c = 0; c < 3; c++) {
            double d = fabs((rgb[0][c] + rgb[1][c]) / 2 - rays[r].target[c]);
            sum += rays[r].weight * (d < 1 ? d * d / 2 : d - 0.5);
        }
        double excess = (opacity[0] + opacity[1]) / 2 - rays[r].alpha;
        double variance = (double)rays[r].colour.background_variance;
        sum += rays[r].weight * 1.5 * variance * excess * excess;
        weights += rays[r].weight;
    }
    ref->pixel_rays = 2;
    ck_assert_double_eq_tol(loss_of(ref), sum / weights, 1e-14);
    rn_reference_destroy(&ref);
}
END_TEST

// Over black and over white, half of each, the loss and its gradients are those over grey with the
// variance of such a choice.
START_TEST(random_backgrounds_are_averaged) {
    struct rn_field_config config = sample_config();
    config.shading = (enum rn_shading)_i;
    struct rn_reference *ref = sample_field(&config);
    size_t count = ref->plane_count;
    double mean = 0, loss, *grads = calloc(count, sizeof *grads);
    ck_assert_ptr_nonnull(grads);
    rn_reference_build(ref);
    for (int both = 0; both < 3; both++) { // black, white, then both at once
        struct rn_reference_ray rays[RAYS];
        sample_rays(rays);
        for (int r = 0; r < RAYS; r++) {
            rays[r].colour.background_variance = both == 2 ? 0.25f : 0;
            for (int c = 0; c < 3; c++) {
                float background = both == 2 ? 0.5f : (float)both;
                rays[r].colour.background[c] = background;
                rays[r].target[c] = 0.2 * c + (1 - rays[r].alpha) * (double)background;
            }
        }
        memset(ref->plane_grad, 0, count * sizeof *grads);
        ck_assert_int_eq(rn_reference_loss(ref, rays, RAYS, &loss), RN_OK);
        if (both == 2) break;
        mean += loss / 2;
        for (size_t i = 0; i < count; i++)
            grads[i] += ref->plane_grad[i] / 2;
    }
    ck_assert_double_eq_tol(loss, mean, 1e-14);
    double largest = 0;
    for (size_t i = 0; i < count; i++)
        largest = fmax(largest, fabs(grads[i]));
    ck_assert_double_gt(largest, 1e-4);
    for (size_t i = 0; i < count; i++)
        ck_assert_double_eq_tol(ref->plane_grad[i], grads[i], 1e-12 * largest);
    free(grads);
    rn_reference_destroy(&ref);
}
END_TEST

START_TEST(create_refuses_planes_of_no_solid) {
    struct rn_field_config config = sample_config();
    config.planes = 5;
    struct rn_reference *ref = NULL;
    struct rn_error err;
    ck_assert_int_eq(rn_reference_create(&config, 1, &ref, &err), RN_ERROR_INVALID);
    ck_assert_ptr_null(ref);
    ck_assert_str_eq(err.where, "planes");
}
END_TEST

// AdamW against the same recurrence in long double, from step 1 and from step 1e7.
START_TEST(adamw_matches_long_double) {
    double p = 0.3, m = 0, v = 0;
    long double lp = p, lm = 0, lv = 0, worst = 0;
    int64_t start = _i == 0 ? 1 : 10000000;
    for (int64_t step = start; step < start + 50; step++) {
        double g = sample_number(30, (uint64_t)step) * pow(10, (double)(step % 7) - 3);
        rn_reference_adamw(1, &p, &g, &m, &v, 0.02, 1e-5, 1e-15, step);
        lm = (long double)0.9 * lm + (long double)0.1 * g;
        lv = (long double)0.999 * lv + (long double)0.001 * g * g;
        long double mean = lm / (1 - powl((long double)0.9, (long double)step));
        long double square = lv / (1 - powl((long double)0.999, (long double)step));
        lp -= 0.02 * ((long double)1e-5 * lp + mean / (sqrtl(square) + 1e-15L));
        worst = fmaxl(worst, fabsl(p - lp) / fmaxl(fabsl(lp), 0.01L));
    }
    ck_assert_msg(worst <= 1e-13L, "relative %Lg", worst);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("reference");
    TCase *tcase = tcase_create("reference");
    tcase_set_timeout(tcase, 60);
    tcase_add_loop_test(tcase, gradients_match_finite_differences, 0, 24);
    tcase_add_loop_test(tcase, gradients_match_on_every_solid_and_many_layers, 0, 3);
    tcase_add_loop_test(tcase, gradients_match_with_voxels, 0, 4);
    tcase_add_loop_test(tcase, gradients_match_where_rays_share_pixels, 0, 4);
    tcase_add_loop_test(tcase, gradients_match_in_photographs_own_light, 0, 2);
    tcase_add_test(tcase, split_pixels_are_means);
    tcase_add_loop_test(tcase, pull_down_is_the_adjoint_of_build, 0, 8);
    tcase_add_test(tcase, smoothing_draws_neighbours_together);
    tcase_add_loop_test(tcase, query_backward_is_the_adjoint_of_query, 0, 6);
    tcase_add_test(tcase, mean_level_is_the_mean_of_both);
    tcase_add_loop_test(tcase, constant_planes_query_to_the_constant, 0, 20);
    tcase_add_loop_test(tcase, ellipsoids_along_body_diagonals, 0, 4);
    tcase_add_loop_test(tcase, uniform_fog_has_its_closed_form, 0, 2);
    tcase_add_test(tcase, loss_is_that_of_the_rendered_colours);
    tcase_add_loop_test(tcase, random_backgrounds_are_averaged, 0, 2);
    tcase_add_test(tcase, create_refuses_planes_of_no_solid);
    tcase_add_loop_test(tcase, adamw_matches_long_double, 0, 2);
    suite_add_tcase(suite, tcase);
    return run_suite(suite);
}
