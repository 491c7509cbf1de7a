// The CUDA backend against the float64 reference and the CPU's kernels, every kernel of it. On a
// machine without a GPU the same source runs under the emulator (cuda_emulator/).
//
// Bounds: the kernels multiply fp16 numbers of 11 bits and add in fp32; the parameters here are
// fp16 numbers, so what is measured is the rounding of features, activations and gradients.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/cuda/layout.h"
#include "tests/ops/cuda_emulator/knobs.h"
#include "tests/ops/cuda_scene.h"
#include "tests/support/suite.h"

#define GRADIENT_BOUND 2e-3 // of the largest number of its kind
#define GRADIENT_OFF 2e-2
#define GRADIENT_RMS 2e-2

static const struct rn_backend *backend;

// Error of a gradient; after one step the first moment is a tenth of it. A sample whose hidden unit
// lies within fp32's rounding of 0 has another gradient on either side: that happens to one sample
// in a thousand, so what is bounded is the root mean square and the share of numbers that are off.
struct error {
    double rms; // of the differences over that of the reference
    double off; // share of numbers that differ by more than GRADIENT_BOUND of the largest
};
static struct error gradient_error(const float *m, const double *exact, size_t n) {
    double largest = 0, squares = 0, all = 0;
    size_t off = 0;
    for (size_t i = 0; i < n; i++)
        largest = fmax(largest, fabs(exact[i]));
    for (size_t i = 0; i < n; i++) {
        double d = 10 * (double)m[i] - exact[i];
        ck_assert(isfinite(m[i]));
        squares += d * d;
        all += exact[i] * exact[i];
        off += fabs(d) > GRADIENT_BOUND * largest;
    }
    ck_assert_double_gt(all, 0);
    return (struct error){sqrt(squares / all), (double)off / (double)n};
}

// AdamW's first step from the moments it left: parameter - rate (m / 0.1) / (sqrt(v / 0.001) +
// eps).
static void check_update(const struct test_scene *s, const struct test_numbers *n) {
    const struct rn_parameters *p = &s->field->parameters;
    for (size_t i = 0; i < p->count; i++) {
        double rate = (double)(i < p->plane_count ? test_step.plane_rate : test_step.network_rate);
        double decay = i < p->plane_count && s->config.sparse ? 0 : s->config.weight_decay;
        double old = (double)p->values[i], m = (double)n->m[i] / 0.1;
        double v = (double)n->v[i] / (1 - 0.999);
        double expected = old - old * rate * decay - rate * m / (sqrt(v) + 1e-15);
        ck_assert_double_eq_tol(n->parameters[i], expected, 2e-6);
        ck_assert_double_eq_tol(v, m * m, 1e-5 * m * m + 1e-36);
    }
}

static void check_tiles(const struct rn_train_config *config, int count, bool deterministic,
                        bool split, bool two_tiles) {
    struct test_scene s;
    struct test_numbers n;
    struct rn_reference_ray rays[MOST_RAYS];
    double loss;
    bool per_ray = config->field.shading == RN_SHADING_RAY;
    test_scene_init(&s, config);
    s.rays = count;
    if (per_ray) s.rays -= split ? 8 : 7; // their last tile is not full
    s.split = split;
    s.two_tiles = two_tiles;
    // What ends opaque shows all of its colours, too large here for fp16 with the usual scale.
    if (per_ray && config->field.space == RN_SPACE_UNBOUNDED) s.gradient_scale = 64;
    test_scene_rays(&s, 0, rays, s.rays);
    OK(rn_reference_loss(s.reference, rays, s.rays, &loss));
    test_train(&s, 1, deterministic, &n);
    const struct rn_parameters *p = &s.field->parameters;
    const double *exact[3] = {s.reference->plane_grad, s.reference->base_grad,
                              s.reference->head_grad};
    const size_t counts[3] = {p->plane_count, p->base_count, p->head_count};
    printf("%d planes x %d, width %d, %s, %d levels, %s shading%s, %llu samples: loss %.1e",
           config->field.planes, config->field.channels, config->field.width,
           rn_footprint_names[config->field.footprint], config->field.levels,
           per_ray ? "ray" : "sample", split ? ", split" : "",
           (unsigned long long)n.progress.samples, fabs(n.progress.loss - loss) / loss);
    for (size_t i = 0, at = 0; i < 3; at += counts[i++]) {
        if (i == 2 && per_ray && !config->field.view_dependence) {
            for (size_t k = 0; k < counts[i]; k++)
                ck_assert(n.m[at + k] == 0); // the colour network takes no part
            continue;
        }
        struct error e = gradient_error(n.m + at, exact[i], counts[i]);
        printf(", %s %.1e (%.2f %% off)",
               i == 0   ? "planes"
               : i == 1 ? "base"
                        : "head",
               e.rms, 100 * e.off);
        ck_assert_double_lt(e.rms, GRADIENT_RMS);
        ck_assert_double_lt(e.off, GRADIENT_OFF);
    }
    printf("\n");
    ck_assert_int_eq(n.progress.steps_rejected, 0);
    ck_assert_int_eq(n.progress.updates, 1);
    ck_assert_uint_eq(n.progress.samples_returned, n.progress.samples); // no padding among them
    // The reference's loss is with the distortion's, the device's without.
    if (config->distortion_loss == 0) ck_assert_double_eq_tol(n.progress.loss, loss, 1e-3 * loss);
    check_update(&s, &n);
    test_numbers_finish(&n);
    test_rays_finish(rays, s.rays);
    test_scene_finish(&s);
}

static void check_training(const struct rn_train_config *config, int count, bool deterministic,
                           bool split) {
    check_tiles(config, count, deterministic, split, false);
}

// _i: 1: pixels are split; 2: warps take two tiles at a time.
START_TEST(gradients_match_reference) {
    struct rn_train_config configs[] = {
        test_config(RN_FOOTPRINT_RIP, 4, 16, 32, 4), test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3),
        test_config(RN_FOOTPRINT_POINT, 6, 4, 32, 1), test_config(RN_FOOTPRINT_RIP, 3, 16, 32, 6)};
    configs[1].field.head_layers = 1;
    configs[1].field.base_layers = 1;
    configs[0].weight_decay = 0.1;
    configs[1].cone_step = true;
    configs[2].field.base_layers = 3;
    configs[2].weight_decay = 0.1;
    configs[2].sparse = true;
    configs[3].field.view_dependence = false;
    for (size_t i = 0; i < (_i == 1 ? 2 : sizeof configs / sizeof *configs); i++)
        check_tiles(&configs[i], RAYS, i % 2, _i == 1, _i == 2);
}
END_TEST

// _i: whether pixels are split.
START_TEST(gradients_of_whole_rays_match_reference) {
    struct rn_train_config configs[] = {
        test_config(RN_FOOTPRINT_RIP, 4, 16, 32, 4), test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3),
        test_config(RN_FOOTPRINT_POINT, 6, 4, 128, 1), test_config(RN_FOOTPRINT_MIP, 3, 16, 32, 3)};
    configs[1].field.head_layers = 1;
    configs[1].field.base_layers = 1;
    configs[1].cone_step = true;
    configs[2].background[0] = 0.25f;
    configs[3].field.view_dependence = false;
    for (size_t i = 0; i < sizeof configs / sizeof *configs; i++) {
        configs[i].field.shading = RN_SHADING_RAY;
        check_training(&configs[i], RAYS, i % 2, _i);
    }
}
END_TEST

// Unbounded space: contraction, steps that grow, levels, the opaque end of rays that are shaded as
// a whole, distortion. _i: the shading.
START_TEST(places_match_reference) {
    struct rn_train_config configs[] = {
        test_config(RN_FOOTPRINT_RIP, 3, 16, 32, 3), test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3),
        test_config(RN_FOOTPRINT_POINT, 4, 8, 16, 1), test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1)};
    configs[1].distortion_loss = 0.5;
    configs[2].field.voxels = true;
    configs[3].distortion_loss = 0.5;
    for (size_t i = 0; i < sizeof configs / sizeof *configs; i++) {
        configs[i].field.space = RN_SPACE_UNBOUNDED;
        configs[i].field.shading = (enum rn_shading)_i;
        check_training(&configs[i], RAYS / 2, i % 2, i == 3);
    }
}
END_TEST

// Planes whose levels do not halve evenly, or not into blocks of texels.
START_TEST(uneven_planes_match_reference) {
    static const int bases[] = {37, 27, 30, 36};
    struct rn_train_config configs[] = {
        test_config(RN_FOOTPRINT_RIP, 4, 16, 32, 4), test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3),
        test_config(RN_FOOTPRINT_RIP, 6, 4, 16, 4), test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1)};
    for (size_t i = 0; i < sizeof configs / sizeof *configs; i++) {
        configs[i].field.base = bases[i];
        configs[i].field.base_layers = configs[i].field.head_layers = 1; // no unit to be near 0
        check_training(&configs[i], RAYS, i % 2, false);
    }
}
END_TEST

// _i: the shading.
START_TEST(voxels_match_reference) {
    struct rn_train_config configs[] = {test_config(RN_FOOTPRINT_RIP, 3, 16, 32, 3),
                                        test_config(RN_FOOTPRINT_MIP, 6, 4, 16, 3)};
    for (size_t i = 0; i < sizeof configs / sizeof *configs; i++) {
        configs[i].field.voxels = true;
        configs[i].field.shading = (enum rn_shading)_i;
        configs[i].distortion_loss = i == 1 ? 0.5 : 0;
        check_training(&configs[i], RAYS, i % 2, false);
    }
}
END_TEST

// The second step has other rays, fewer of them, and finds what the first one left. With rates of 0
// its gradients are what the moments changed by. _i: the shading; planes that halve evenly, or not.
START_TEST(second_steps_match_reference) {
    static const struct rn_device_step still = {.network_rate = 0};
    struct rn_train_config config = test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3);
    struct test_scene s;
    struct test_numbers first, second;
    struct rn_reference_ray rays[RAYS];
    double loss;
    config.field.shading = (enum rn_shading)(_i % 2);
    if (_i / 2) config.field.base = 27;
    config.field.voxels = true;
    config.target_samples = 2000;
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    OK(test_scene_train(&s, false, &err));
    OK(backend->train_step(s.on_device, &still, &err));
    test_read_back(&s, &first);
    int count = first.progress.next_rays;
    ck_assert(count < RAYS && count % 16 != 0);
    OK(backend->train_step(s.on_device, &still, &err));
    test_read_back(&s, &second);
    test_scene_rays(&s, 1, rays, count);
    OK(rn_reference_loss(s.reference, rays, count, &loss));
    ck_assert_double_eq_tol(second.progress.loss, loss, 1e-3 * loss);
    uint64_t seen = 0;
    for (int l = 0; l < RN_MAX_LEVELS; l++)
        seen += second.progress.level_samples[l];
    ck_assert_uint_eq(seen, second.progress.samples); // none twice
    const struct rn_parameters *p = &s.field->parameters;
    for (size_t i = 0; i < p->count; i++)
        second.m[i] -= 0.9f * first.m[i];
    const double *exact[3] = {s.reference->plane_grad, s.reference->base_grad,
                              s.reference->head_grad};
    const size_t counts[3] = {p->plane_count, p->base_count, p->head_count};
    for (size_t i = 0, at = 0; i < 3; at += counts[i++])
        ck_assert_double_lt(gradient_error(second.m + at, exact[i], counts[i]).rms, GRADIENT_RMS);
    test_numbers_finish(&first);
    test_numbers_finish(&second);
    test_rays_finish(rays, count);
    test_scene_finish(&s);
}
END_TEST

// The gradient of the second step where nothing moves, and the share of its samples that went back.
struct second_step {
    double *gradient, share;
    size_t count, head; // numbers, and those before the colour network's
};
static struct second_step second_step(const struct rn_train_config *config) {
    static const struct rn_device_step still = {.network_rate = 0};
    struct test_scene s;
    struct test_numbers first, second;
    test_scene_init(&s, config);
    OK(test_scene_upload(&s, 0, &err));
    OK(test_scene_train(&s, true, &err));
    OK(backend->train_step(s.on_device, &still, &err));
    test_read_back(&s, &first);
    OK(backend->train_step(s.on_device, &still, &err));
    test_read_back(&s, &second);
    const struct rn_parameters *p = &s.field->parameters;
    struct second_step out = {.gradient = malloc(p->count * sizeof(double)),
                              .count = p->count,
                              .head = p->count - p->head_count};
    for (size_t i = 0; i < p->count; i++)
        out.gradient[i] = 10 * ((double)second.m[i] - 0.9 * (double)first.m[i]);
    ck_assert_uint_eq(first.progress.samples_returned, first.progress.samples);
    out.share = (double)(second.progress.samples_returned - first.progress.samples_returned) /
                (double)(second.progress.samples - first.progress.samples);
    test_numbers_finish(&first);
    test_numbers_finish(&second);
    test_scene_finish(&s);
    return out;
}

// Over many seeds the mean of the gradients with a roulette is the gradient without, and none of
// them is far from it; a colour network that whole rays train takes no part. _i: which threshold
// and shading.
START_TEST(roulette_has_no_bias) {
    enum { SEEDS = 8 };
    static const double thresholds[] = {1, 4, 1}, spreads[] = {0.05, 0.25, 0.1};
    static const double shares[] = {0.8, 0.4, 0.8};
    enum rn_shading shading = _i < 2 ? RN_SHADING_RAY : RN_SHADING_SAMPLE;
    double bias[SEEDS], mean = 0, variance = 0, worst = 0, most = 0;
    for (int seed = 0; seed < SEEDS; seed++) {
        struct rn_train_config config = test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3);
        double product = 0, square = 0, difference = 0;
        config.field.shading = shading;
        config.seed = (uint64_t)seed + 1;
        struct second_step exact = second_step(&config);
        config.roulette = thresholds[_i];
        struct second_step drawn = second_step(&config);
        ck_assert(exact.share == 1);
        size_t played = shading == RN_SHADING_RAY ? exact.head : exact.count;
        for (size_t i = 0; i < played; i++) {
            double d = drawn.gradient[i] - exact.gradient[i];
            product += d * exact.gradient[i];
            square += exact.gradient[i] * exact.gradient[i];
            difference += d * d;
        }
        for (size_t i = played; i < exact.count; i++)
            ck_assert(drawn.gradient[i] == exact.gradient[i]);
        bias[seed] = product / square;
        mean += bias[seed] / SEEDS;
        worst = fmax(worst, sqrt(difference / square));
        most = fmax(most, drawn.share);
        free(exact.gradient);
        free(drawn.gradient);
    }
    for (int seed = 0; seed < SEEDS; seed++)
        variance += (bias[seed] - mean) * (bias[seed] - mean) / (SEEDS - 1);
    printf("roulette, %s shading, threshold %.0f: %.0f %% at most go back, bias %.1e (standard "
           "error %.1e), "
           "spread at most %.1e\n",
           rn_shading_names[shading], thresholds[_i], 100 * most, mean, sqrt(variance / SEEDS),
           worst);
    ck_assert_double_lt(most, shares[_i]);
    ck_assert_double_lt(worst, spreads[_i]);
    ck_assert_double_lt(fabs(mean), 4 * sqrt(variance / SEEDS));
}
END_TEST

// _i: whether warps take two tiles at a time.
START_TEST(papers_networks_match_reference) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_RIP, 10, 16, 128, 4);
    config.field.base = 16;
    config.step = 0.1;
    check_tiles(&config, RAYS, false, false, _i);
}
END_TEST

// The same where a block has as little shared memory as on other cards: one network staged, or
// none. _i: which card, and the shading.
START_TEST(smaller_cards_match_reference) {
    static const size_t shared[] = {163 << 10, 99 << 10};
    struct rn_train_config config = test_config(RN_FOOTPRINT_MIP, 10, 16, 128, 2);
    rn_emulator_shared(shared[_i / 2]);
    config.field.base = 16;
    config.step = 0.2;
    config.field.shading = (enum rn_shading)(_i % 2);
    check_training(&config, RAYS / 2, false, false);
    rn_emulator_shared(227 << 10);
}
END_TEST

// More rays than the list of samples takes at once.
START_TEST(many_rays_match_reference) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    config.field.shading = (enum rn_shading)_i;
    config.field.view_dependence = _i == RN_SHADING_SAMPLE; // else colours are too large for fp16
    config.step = 0.2;
    check_training(&config, MOST_RAYS, false, false);
}
END_TEST

// Rays of more samples than one thread scatters.
START_TEST(long_rays_match_reference) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_MIP, 3, 8, 16, 3);
    config.field.shading = (enum rn_shading)_i;
    config.step = 0.01;
    check_training(&config, 24, true, false);
}
END_TEST

// A step that ends with smoothing leaves what the same step leaves and the CPU then smooths, in the
// parameters and in the maps that pictures are made from.
START_TEST(planes_are_smoothed_as_on_the_cpu) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_RIP, 3, 8, 16, 4);
    struct rn_device_step smooth = test_step;
    struct rn_march_options options = {.step = (float)config.step, .stop_depth = 1e9f};
    struct rn_pixel pixels[2][SIDE];
    struct test_numbers rough, after;
    struct test_scene s, fresh;
    uint64_t samples;
    smooth.smoothing = 0.2f;
    test_scene_init(&fresh, &config);
    test_train(&fresh, 1, true, &rough);
    test_scene_finish(&fresh);
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    OK(test_scene_train(&s, true, &err));
    OK(backend->train_step(s.on_device, &smooth, &err));
    test_read_back(&s, &after);
    OK(test_render(&s, &s.frames[0].camera, &options, RN_CELLS_OF_TRAINING, SIDE / 2, 1, pixels[0],
                   &samples, &err));
    size_t side = (size_t)config.field.base, plane = side * side * 8;
    double largest = 0, moved = 0;
    for (size_t p = 0; p < 3; p++)
        s.engine.kernels->smooth(rough.parameters + p * plane, config.field.base, 8, 0.2f);
    for (size_t i = 0; i < s.field->parameters.count; i++) {
        largest = fmax(largest, fabs((double)after.parameters[i]));
        moved = fmax(moved, fabs((double)(after.parameters[i] - s.field->parameters.values[i])));
        ck_assert_double_eq_tol(after.parameters[i], rough.parameters[i], 8 * 0x1p-23 * largest);
    }
    ck_assert_double_gt(moved, 0.1 * largest);
    test_scene_init(&fresh, &config);
    memcpy(fresh.field->parameters.values, after.parameters,
           s.field->parameters.count * sizeof(float));
    OK(test_scene_upload(&fresh, 0, &err));
    OK(test_render(&fresh, &s.frames[0].camera, &options, RN_CELLS_OF_TRAINING, SIDE / 2, 1,
                   pixels[1], &samples, &err));
    ck_assert_mem_eq(pixels[0], pixels[1], sizeof pixels[0]);
    test_numbers_finish(&rough);
    test_numbers_finish(&after);
    test_scene_finish(&fresh);
    test_scene_finish(&s);
}
END_TEST

static void run_steps(enum rn_shading shading, int order, bool deterministic,
                      struct test_numbers *ret) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_RIP, 3, 8, 16, 3);
    struct test_scene s;
    config.field.shading = shading;
    test_scene_init(&s, &config);
    s.background_variance = 0;
    rn_emulator_order(order, (uint64_t)order + 1);
    test_train(&s, 3, deterministic, ret);
    rn_emulator_order(0, 0);
    test_scene_finish(&s);
}

// Which warp takes which ray changes with the order of the threads; in the deterministic mode the
// bytes do not. They are the orders that a missing barrier shows in, too.
static void check_orders(enum rn_shading shading) {
    struct test_numbers first;
    run_steps(shading, 0, true, &first);
    size_t n = (size_t)3 * 32 * 32 * 8;
    for (int order = 1; order < 4; order++) {
        struct test_numbers other;
        run_steps(shading, order, true, &other);
        ck_assert(memcmp(first.parameters, other.parameters, n * sizeof(float)) == 0);
        ck_assert(memcmp(first.v, other.v, n * sizeof(float)) == 0);
        ck_assert(first.progress.loss == other.progress.loss);
        test_numbers_finish(&other);
        run_steps(shading, order, false, &other);
        for (size_t i = 0; i < n; i++)
            ck_assert_double_eq_tol(first.m[i], other.m[i], 2e-4);
        test_numbers_finish(&other);
    }
    test_numbers_finish(&first);
}

START_TEST(deterministic_mode_gives_the_same_bytes) {
    check_orders((enum rn_shading)_i);
}
END_TEST

// Gradients that fp16 cannot hold: no step is taken until the scale is low enough.
START_TEST(overflow_skips_the_step) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct test_scene s;
    struct test_numbers n;
    config.field.shading = (enum rn_shading)_i;
    test_scene_init(&s, &config);
    const struct rn_parameters *p = &s.field->parameters;
    for (int f = 0; f < FRAMES; f++)
        s.frames[f].loss_weight = 1e5f;
    test_train(&s, 1, false, &n);
    ck_assert_int_eq(n.progress.steps_rejected, 1);
    ck_assert_int_eq(n.progress.updates, 0);
    ck_assert(memcmp(n.parameters, p->values, p->count * sizeof(float)) == 0);
    for (size_t i = 0; i < p->count; i++)
        ck_assert(n.m[i] == 0 && n.v[i] == 0);
    test_numbers_finish(&n);
    for (int i = 0; i < 20; i++)
        OK(backend->train_step(s.on_device, &test_step, &err));
    test_read_back(&s, &n);
    ck_assert_int_gt(n.progress.updates, 0);
    for (size_t i = 0; i < p->count; i++)
        ck_assert(isfinite(n.parameters[i]));
    test_numbers_finish(&n);
    test_scene_finish(&s);
}
END_TEST

// Texels that fp16 cannot hold: the rays that meet them are left out, the others train.
START_TEST(rays_that_are_not_finite_are_left_out) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct test_scene s;
    struct test_numbers n;
    config.field.shading = (enum rn_shading)_i;
    test_scene_init(&s, &config);
    size_t middle = ((size_t)16 * 32 + 10) * 8;
    s.field->parameters.values[middle] = 1e9f;
    test_train(&s, 1, false, &n);
    ck_assert_uint_gt(n.progress.nonfinite_rays, 0);
    ck_assert_uint_lt(n.progress.nonfinite_rays, RAYS / 2);
    ck_assert_int_eq(n.progress.steps_rejected, 0);
    ck_assert_int_eq(n.progress.updates, 1);
    for (size_t i = 0; i < s.field->parameters.count; i++)
        ck_assert(isfinite(n.m[i]));
    test_numbers_finish(&n);
    test_scene_finish(&s);
}
END_TEST

// More samples than there is room for: the step is not taken, the next has half the rays.
START_TEST(crowded_steps_are_skipped) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct test_scene s;
    struct test_numbers n;
    config.step = 0.004;
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    struct rn_device_pixels pixels = {.frames = s.frames,
                                      .rgba = s.rgba,
                                      .frame_count = FRAMES,
                                      .scale_count = 1,
                                      .scale_first = {0, FRAMES},
                                      .scale_pixels = {FRAMES * SIDE * SIDE},
                                      .pixel_count = FRAMES * SIDE * SIDE};
    struct rn_device_training training = {.next_rays = 400, .step = 1, .march_step = config.step};
    OK(backend->train_begin(s.on_device, &pixels, &training, &err));
    OK(backend->train_step(s.on_device, &test_step, &err));
    test_read_back(&s, &n);
    const struct rn_parameters *p = &s.field->parameters;
    ck_assert_int_eq(n.progress.steps_rejected, 0); // nothing was wrong with its numbers
    ck_assert_int_eq(n.progress.updates, 0);
    ck_assert_int_eq(n.progress.next_rays, 200);
    ck_assert(memcmp(n.parameters, p->values, p->count * sizeof(float)) == 0);
    test_numbers_finish(&n);
    test_scene_finish(&s);
}
END_TEST

START_TEST(it_learns_without_allocating) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_RIP, 3, 8, 16, 3);
    struct test_scene s;
    struct rn_device_progress first, last;
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    OK(test_scene_train(&s, false, &err));
    long allocations = rn_emulator_allocations();
    OK(backend->train_step(s.on_device, &test_step, &err));
    OK(backend->train_finish(s.on_device, &first, &err));
    for (int i = 0; i < 30; i++)
        OK(backend->train_step(s.on_device, &test_step, &err));
    OK(backend->train_finish(s.on_device, &last, &err));
    printf("loss %.4f, after 30 steps %.4f\n", first.loss, last.loss);
    ck_assert_double_lt(last.loss, 0.6 * first.loss);
    ck_assert_int_eq(rn_emulator_allocations(), allocations);
    ck_assert_int_eq(last.steps, 31);
    ck_assert_uint_gt(last.level_samples[0] + last.level_samples[1] + last.level_samples[2], 1000);
    test_scene_finish(&s);
    ck_assert_uint_eq(rn_emulator_memory_used(), 0);
}
END_TEST

START_TEST(memory_is_counted_before_it_is_taken) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_RIP, 4, 16, 32, 3);
    struct test_scene s;
    struct rn_error err;
    config.field.base = 128;
    test_scene_init(&s, &config);
    ck_assert(test_scene_upload(&s, 4 << 20, &err) == RN_ERROR_LIMIT);
    ck_assert_msg(strstr(err.text, "needs") && strstr(err.text, "would fit"), "%s", err.text);
    ck_assert_uint_eq(rn_emulator_memory_used(), 0);
    backend->close(&s.device);
    if (test_is_emulated()) {
        rn_emulator_memory(4 << 20);
        ck_assert(test_scene_upload(&s, 1 << 30, &err) == RN_ERROR_NO_MEMORY);
        rn_emulator_memory((size_t)2 << 30);
    }
    test_scene_finish(&s);
}
END_TEST

START_TEST(a_broken_device_says_so) {
    struct rn_train_config config = test_config(RN_FOOTPRINT_POINT, 3, 8, 16, 1);
    struct test_scene s;
    struct rn_error said;
    struct rn_device_progress progress;
    test_scene_init(&s, &config);
    OK(test_scene_upload(&s, 0, &err));
    OK(test_scene_train(&s, false, &err));
    rn_emulator_fail(700);
    ck_assert(backend->train_step(s.on_device, &test_step, &said) == RN_ERROR_UNAVAILABLE);
    ck_assert(backend->train_finish(s.on_device, &progress, &said) == RN_ERROR_UNAVAILABLE);
    rn_emulator_fail(0);
    test_scene_finish(&s);
}
END_TEST

START_TEST(what_it_cannot_do_is_refused) {
    struct rn_train_config configs[2] = {test_config(RN_FOOTPRINT_RIP, 3, 8, 16, 7),
                                         test_config(RN_FOOTPRINT_RIP, 3, 8, 144, 3)};
    const char *const where[2] = {"levels", "width"};
    for (int i = 0; i < 2; i++) {
        struct test_scene s;
        struct rn_error err;
        test_scene_init(&s, &configs[i]);
        ck_assert(test_scene_upload(&s, 0, &err) == RN_ERROR_UNSUPPORTED);
        ck_assert_str_eq(err.where, where[i]);
        test_scene_finish(&s);
    }
}
END_TEST

// Every number of a layer has one place among the fragments, and the gradient's places are where
// the products leave them.
START_TEST(fragments_hold_every_number_once) {
    enum { K = 48, N = 32 };
    static int seen[K * N], back[K * N];
    for (int k = 0; k < K; k++)
        for (int n = 0; n < N; n++) {
            seen[rn_cuda_fragment_place(k, n, K / 16)]++;
            back[rn_cuda_fragment_place(n, k, N / 16)]++;
        }
    for (int i = 0; i < K * N; i++) {
        ck_assert_int_eq(seen[i], 1);
        ck_assert_int_eq(back[i], 1);
    }
    memset(seen, 0, sizeof seen);
    for (size_t i = 0; i < K * N; i++) {
        int k, n;
        rn_cuda_gradient_element(i, N / 16, &k, &n);
        seen[k * N + n]++;
    }
    for (int i = 0; i < K * N; i++)
        ck_assert_int_eq(seen[i], 1);
    for (int per_ray = 0; per_ray < 2; per_ray++) {
        int inputs[32] = {0};
        for (int k = 0; k < 32; k++)
            inputs[rn_cuda_head_input(k, per_ray)]++;
        for (int k = 0; k < 32; k++)
            ck_assert_int_eq(inputs[k], 1);
    }
}
END_TEST

int main(void) {
    setvbuf(stdout, NULL, _IOLBF, 0);
    backend = test_backend();
    if (!backend) {
        printf("there is no GPU here\n");
        return 77; // skipped
    }
    Suite *suite = suite_create("cuda kernels");
    int shadings = RN_SHADING_RAY + 1;
    test_add(suite, "layout", fragments_hold_every_number_once, 1);
    test_add(suite, "gradients", gradients_match_reference, 3);
    test_add(suite, "rays", gradients_of_whole_rays_match_reference, 2);
    test_add(suite, "second", second_steps_match_reference, 2 * shadings);
    test_add(suite, "roulette", roulette_has_no_bias, 3);
    test_add(suite, "paper", papers_networks_match_reference, 2);
    if (test_is_emulated()) test_add(suite, "cards", smaller_cards_match_reference, 4);
    test_add(suite, "many", many_rays_match_reference, shadings);
    test_add(suite, "many", long_rays_match_reference, shadings);
    test_add_pictures(suite);
    test_add(suite, "smoothing", planes_are_smoothed_as_on_the_cpu, 1);
    test_add_choices(suite);
    test_add(suite, "unbounded", places_match_reference, shadings);
    test_add(suite, "uneven", uneven_planes_match_reference, 1);
    test_add(suite, "voxels", voxels_match_reference, shadings);
    test_add_places(suite);
    test_add(suite, "order", deterministic_mode_gives_the_same_bytes, shadings);
    test_add(suite, "guards", overflow_skips_the_step, shadings);
    test_add(suite, "guards", rays_that_are_not_finite_are_left_out, shadings);
    test_add(suite, "guards", crowded_steps_are_skipped, 1);
    test_add(suite, "guards", memory_is_counted_before_it_is_taken, 1);
    if (test_is_emulated()) test_add(suite, "guards", a_broken_device_says_so, 1);
    test_add(suite, "guards", what_it_cannot_do_is_refused, 1);
    test_add(suite, "learning", it_learns_without_allocating, 1);
    return run_suite(suite);
}
