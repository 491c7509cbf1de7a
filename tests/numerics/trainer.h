// A small scene to train on, for the cases that need whole training steps.
#ifndef RN_TESTS_NUMERICS_TRAINER_H
#define RN_TESTS_NUMERICS_TRAINER_H

#include <string.h>
#include <unistd.h>

#include "common/base/file.h"
#include "server/engine/engine.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/train/schedule.h"
#include "server/engine/train/trainer.h"
#include "tests/support/numerics.h"

#define STEPS 60

static char folder[] = "/tmp/ripnerf-numerics-XXXXXX";

static inline void must(enum rn_status status, const struct rn_error *err) {
    if (status == RN_OK) return;
    fprintf(stderr, "%s: %s\n", err->where, err->text);
    exit(1);
}

static inline struct rn_dataset *read_views(int views) {
    struct rn_error err = {0};
    struct rn_dataset *dataset;
    struct rn_synth_options options = {.size = 24, .views = views, .threads = 1, .samples = 4};
    static int count;
    char path[64];
    snprintf(path, sizeof path, "%s/%d", folder, count++);
    must(rn_mkdirs(path, 0755, &err), &err);
    must(rn_synthesise("sphere", &options, path, NULL, NULL, &err), &err);
    must(rn_dataset_read(path, NULL, &dataset, &err), &err);
    return dataset;
}

static inline struct rn_trainer *make_trainer(struct rn_engine *engine,
                                              const struct rn_dataset *dataset, double rate) {
    struct rn_error err = {0};
    struct rn_train_config config;
    struct rn_trainer *trainer;
    must(rn_preset("standard", false, &config, &err), &err);
    config.field.base = 32;
    config.grow_to = 64; // at 35 % of the steps
    config.field.occupancy = 32;
    config.target_samples = 8192;
    config.initial_rays = 1024;
    config.learning_rate *= rate;
    config.max_seconds = 0;
    config.max_steps = STEPS;
    must(rn_trainer_create(engine, dataset, &config, 0, &trainer, &err), &err);
    return trainer;
}

// One whole step; whether training goes on.
static inline bool advance(struct rn_trainer *t) {
    struct rn_error err;
    int64_t step = t->progress.step;
    enum rn_status status = RN_OK;
    while (status == RN_OK && t->progress.step == step && step < STEPS)
        status = rn_trainer_advance(t, 0, &err);
    return status == RN_OK && t->progress.step < STEPS;
}

static inline double count_wild(const float *numbers, size_t n) {
    double wild = 0;
    for (size_t i = 0; i < n; i++)
        wild += !isfinite(numbers[i]);
    return wild;
}

static uint64_t replaced; // rays of the last picture, by its own count

// Non-finite numbers in a picture with its depths and opacities.
static inline double count_rendered(struct rn_engine *engine, struct rn_trainer *t,
                                    const struct rn_camera *camera) {
    struct rn_error err = {0};
    struct rn_render_options options = {
        .camera = *camera, .outputs = RN_OUTPUT_RGB | RN_OUTPUT_DEPTH | RN_OUTPUT_ALPHA};
    struct rn_render_result result;
    must(rn_render(engine, rn_trainer_field(t), &options, NULL, NULL, &result, &err), &err);
    size_t pixels = (size_t)result.rgb.width * (size_t)result.rgb.height;
    double wild = count_wild(result.rgb.values, 3 * pixels) +
                  count_wild(result.depth.values, pixels) + count_wild(result.alpha.values, pixels);
    replaced = result.stats.nonfinite_rays;
    rn_render_result_finish(&result);
    return wild;
}

// Non-finite numbers in the parameters, in a rendered picture and in a checkpoint read again.
static inline double count_left(struct rn_engine *engine, struct rn_trainer *t) {
    struct rn_error err = {0};
    char path[64];
    double wild = count_wild(t->field->parameters.values, t->field->parameters.count);
    wild += count_rendered(engine, t, &t->dataset->frames[0].camera);
    snprintf(path, sizeof path, "%s/checkpoint", folder);
    must(rn_trainer_save(t, path, &err), &err);
    struct rn_field *field;
    if (rn_field_load(engine, path, &field, &err) != RN_OK) return wild + 1;
    rn_field_destroy(&field);
    return wild;
}

// ---- planted numbers ------------------------------------------------------------------------

#define PLANTS 7
static const char *const plant_names[PLANTS] = {
    "NaN in a texel",          "infinity in the density network",    "NaN in the colour network",
    "NaN in a texel's slope",  "NaN in a first moment of a network", "NaN in a second moment",
    "NaN in all of the planes"};

// A texel that the steps read often: of 256 random ones that with the largest second moment.
static inline size_t busy_texel(const struct rn_trainer *t, struct numerics_random *random) {
    size_t best = 0;
    for (int i = 0; i < 256; i++) {
        size_t at = (size_t)numerics_uniform(random, 0, (double)t->field->parameters.plane_count);
        if (i == 0 || t->optimiser.v[at] > t->optimiser.v[best]) best = at;
    }
    return best;
}

// At a random place: of such a texel, in the density network's first layer, in the weights of a
// colour.
static inline void plant(struct rn_trainer *t, int what, struct numerics_random *random) {
    const struct rn_parameters *p = &t->field->parameters;
    const struct rn_mlp_shape *base = &t->field->cpu.base_shape, *head = &t->field->cpu.head_shape;
    int last = head->layers - 1;
    size_t texel = busy_texel(t, random), colours = p->plane_count + p->base_count;
    size_t weight =
        p->plane_count + (size_t)numerics_uniform(random, 0, (double)(base->in[0] * base->out[0]));
    size_t input = (size_t)numerics_uniform(random, 0, (double)head->in[last]);
    colours += head->offset[last] + input * (size_t)head->out[last] + random->count % 3;
    if (what == 0) p->values[texel] = NAN;
    if (what == 1) p->values[weight] = INFINITY;
    if (what == 2) p->values[colours] = NAN;
    if (what == 3) t->optimiser.grad[texel] = NAN;
    if (what == 4) t->optimiser.m[weight] = NAN;
    if (what == 5) t->optimiser.v[weight] = NAN;
    for (size_t i = 0; i < p->plane_count && what == 6; i++)
        p->values[i] = NAN;
}

#endif
