#include "server/engine/scene/choose.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/clock.h"
#include "common/math/rng.h"

#define CHOOSE_ROWS 512
#define CHOOSE_SECONDS 1e-3 // a set
#define CHOOSE_CLOSE 1.2    // times the quickest: as good, and more than a measurement is off

// A field of the same networks whose planes are tiny, and one packet of samples.
struct subject {
    const struct rn_kernels *kernels;
    struct rn_field *field;
    struct rn_workspace *workspace;
    struct rn_group group;
    float *weight_grad;
    int heads;
};

static bool subject_init(const struct rn_kernels *kernels, const struct rn_field_config *config,
                         int rows, struct subject *s) {
    struct rn_train_config train = {.field = *config, .step = 0.01};
    struct rn_bounds bounds = {.radius = 1};
    struct rn_error err;
    *s = (struct subject){.kernels = kernels};
    train.field.base = train.field.occupancy = 16;
    train.field.levels = 1;
    if (rn_field_create(&train, &bounds, &s->field, &err) != RN_OK) return false;
    const struct rn_cpu_field *cpu = &s->field->cpu;
    size_t bytes = (rn_workspace_size(cpu, train.step) + 63) / 64 * 64;
    void *memory = aligned_alloc(64, bytes);
    s->weight_grad = calloc(cpu->base_shape.count + cpu->head_shape.count, sizeof(float));
    if (!memory || !s->weight_grad) {
        free(memory);
        return false;
    }
    s->workspace = rn_workspace_init(cpu, train.step, memory);
    rn_field_randomise(s->field, 1);
    rn_field_refresh(s->field, &(struct rn_engine){.kernels = kernels});
    if (rows > s->workspace->capacity) rows = s->workspace->capacity;
    s->workspace->count = s->group.slab.count = rows;
    for (int i = 0; i < rows; i++) // with sample shading: all of them have a weight
        s->workspace->weight[i] = 1;
    s->heads = config->view_dependence ? (rows + 31) / 32 : 0;
    if (s->heads > RN_PACKET_RAYS) s->heads = RN_PACKET_RAYS;
    s->group.base_grad = s->weight_grad;
    s->group.head_grad = s->weight_grad + cpu->base_shape.count;
    return true;
}

static void subject_finish(struct subject *s) {
    free(s->workspace);
    free(s->weight_grad);
    rn_field_destroy(&s->field);
}

// Values of the size that training has, anew: gradients take their outputs' place.
static void fill(struct subject *s) {
    struct rn_workspace *w = s->workspace;
    const struct rn_cpu_field *cpu = &s->field->cpu;
    for (int i = 0; i < w->count * RN_GEOMETRY; i++)
        w->geometry_grad[i] = rn_rng_unit(rn_rng_draw(1, 2, (uint64_t)i).v[0]) - 0.5f;
    for (int i = 0; i < w->count; i++) {
        float features[RN_MAX_PLANES * 16];
        for (int k = 0; k < cpu->features; k++)
            features[k] =
                rn_rng_unit(rn_rng_draw(1, 1, (uint64_t)(i * cpu->features + k)).v[0]) - 0.5f;
        s->kernels->parts->put_features(cpu, i, features, w);
    }
}

// CPU seconds: a machine that is busy with something else chooses as it does alone.
static double run(struct subject *s, enum rn_stage stage) {
    struct rn_march_options options = {.step = 0.01f};
    int64_t begin = rn_clock_thread_ns();
    s->kernels->parts->stage(&s->field->cpu, &options, NULL, s->heads, stage, s->workspace,
                             &s->group, NULL);
    return (double)(rn_clock_thread_ns() - begin) * 1e-9;
}

// CPU seconds of one thread for CHOOSE_ROWS samples forward and backward through the networks that
// `config` describes (with ray shading one row in 32 goes through the colour network): the least of
// several calls, at least two. INFINITY without memory.
static double time_of(const struct rn_kernels *kernels, const struct rn_field_config *config) {
    struct subject s;
    double forward = INFINITY, backward = INFINITY, spent = 0;
    if (subject_init(kernels, config, CHOOSE_ROWS, &s)) {
        fill(&s);
        for (int i = 0; i < 2 || spent < CHOOSE_SECONDS; i++) {
            double first = run(&s, RN_STAGE_MLP_FORWARD), second = run(&s, RN_STAGE_MLP_BACKWARD);
            forward = fmin(forward, first);
            backward = fmin(backward, second);
            spent += first + second;
        }
        forward *= CHOOSE_ROWS / (double)s.workspace->count;
        backward *= CHOOSE_ROWS / (double)s.workspace->count;
    }
    subject_finish(&s);
    return forward + backward;
}

const struct rn_kernels *rn_choose_kernels(const struct rn_field_config *config) {
    const struct rn_kernels *best = NULL, *k;
    double least = INFINITY;
    for (int i = 0; (k = rn_kernels_available(i)); i++) {
        double seconds = time_of(k, config);
        if (!best || seconds < CHOOSE_CLOSE * least) best = k;
        least = fmin(least, seconds);
    }
    return best;
}
