// The networks of every kernel set with small integers, of which every product and sum is exact in
// fp32 and in bf16: forward, inputs' and weights' gradients must be the reference's, to the bit.
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/scene/scene.h"
#include "tests/support/suite.h"

#define ROWS 330
#define WIDEST 256

struct subject {
    struct rn_field *field;
    struct rn_workspace *workspace;
    struct rn_group group;
    int rows, heads;
    float (*features)[WIDEST];
};

static int integer(uint64_t stream, uint64_t i, int low, int high) {
    return low + (int)(rn_rng_draw(4, stream, i).v[0] % (uint32_t)(high - low + 1));
}

// Few weights of a layer are not zero, so that activations and gradients stay below 2^8.
static void set_weights(const struct rn_mlp_shape *shape, uint64_t stream, float *weights) {
    for (int l = 0; l < shape->layers; l++)
        for (int i = 0; i < shape->in[l]; i++)
            for (int o = 0; o < shape->out[l]; o++) {
                uint64_t at = (uint64_t)((l * WIDEST + i) * WIDEST + o);
                int most = shape->in[l] > shape->out[l] ? shape->in[l] : shape->out[l];
                bool used = integer(stream, at, 1, most) <= 3;
                weights[shape->offset[l] + (size_t)(i * shape->out[l] + o)] =
                    used ? (float)integer(stream + 1, at, -1, 1) : 0;
            }
}

// What other kernel sets left in the workspace: numbers that are none.
static void leave_rows(const struct rn_cpu_field *cpu, const struct rn_kernels *kernels, int rows,
                       struct rn_workspace *w) {
    const struct rn_kernels *other;
    float none[WIDEST];
    for (int k = 0; k < WIDEST; k++)
        none[k] = NAN;
    for (int k = 0; (other = rn_kernels_available(k)); k++)
        for (int i = 0; i < rows && other != kernels; i++)
            other->parts->put_features(cpu, i, none, w);
}

static void set_up(const struct rn_kernels *kernels, const struct rn_field_config *config, int rows,
                   struct subject *s) {
    struct rn_train_config train = {.field = *config, .step = 0.01};
    struct rn_bounds bounds = {.radius = 1};
    struct rn_error err;
    memset(s, 0, sizeof *s);
    ck_assert(rn_field_create(&train, &bounds, &s->field, &err) == RN_OK);
    const struct rn_cpu_field *cpu = &s->field->cpu;
    struct rn_parameters *p = &s->field->parameters;
    set_weights(&cpu->base_shape, 10, p->values + p->plane_count);
    set_weights(&cpu->head_shape, 20, p->values + p->plane_count + p->base_count);
    rn_field_refresh(s->field, &(struct rn_engine){.kernels = kernels});
    size_t bytes = (rn_workspace_size(cpu, train.step) + 63) / 64 * 64;
    s->workspace = rn_workspace_init(cpu, train.step, aligned_alloc(64, bytes));
    struct rn_workspace *w = s->workspace;
    s->rows = w->count = s->group.slab.count = rows;
    for (int i = 0; i < rows; i++) {
        w->weight[i] = i % 3 != 0; // with sample shading: the rows of the colour network
        s->heads += i % 3 != 0;
    }
    leave_rows(cpu, kernels, rows, w);
    s->features = calloc((size_t)rows, sizeof *s->features);
    for (int i = 0; i < rows; i++) {
        for (int k = 0; k < cpu->features; k++)
            s->features[i][k] = (float)integer(1, (uint64_t)(i * cpu->features + k), -3, 3);
        kernels->parts->put_features(cpu, i, s->features[i], w);
    }
    for (int i = 0; i < s->heads * RN_HEAD_INPUTS; i++)
        w->head_in[i] = (float)integer(2, (uint64_t)i, -3, 3);
    s->group.base_grad = calloc(p->base_count + p->head_count, sizeof(float));
    s->group.head_grad = s->group.base_grad + p->base_count;
}

static void tear_down(struct subject *s) {
    free(s->features);
    free(s->group.base_grad);
    free(s->workspace);
    rn_field_destroy(&s->field);
}

// One network of one row after the other in float64; `out` and `in_grad` of `rows` rows.
struct exact {
    const struct rn_mlp_shape *shape;
    double *weights, *weight_grad, *rows[2][RN_MLP_MAX_LAYERS + 1]; // activations, gradients
};

static void exact_init(const struct rn_mlp_shape *shape, const float *weights, struct exact *e) {
    e->shape = shape;
    e->weights = calloc(2 * shape->count, sizeof(double));
    e->weight_grad = e->weights + shape->count;
    for (size_t i = 0; i < shape->count; i++)
        e->weights[i] = (double)weights[i];
    for (int l = 0; l <= RN_MLP_MAX_LAYERS; l++)
        for (int k = 0; k < 2; k++)
            e->rows[k][l] = calloc(WIDEST, sizeof(double));
}

static void exact_finish(struct exact *e) {
    free(e->weights);
    for (int l = 0; l <= RN_MLP_MAX_LAYERS; l++)
        for (int k = 0; k < 2; k++)
            free(e->rows[k][l]);
}

static void check_row(struct exact *e, const float *in, const float *out, const float *out_grad,
                      const float *in_grad) {
    const struct rn_mlp_shape *shape = e->shape;
    for (int i = 0; i < shape->in[0]; i++)
        e->rows[0][0][i] = (double)in[i];
    rn_mlp_forward(shape, e->weights, e->rows[0]);
    for (int o = 0; o < RN_GEOMETRY; o++) {
        ck_assert_double_eq((double)out[o], e->rows[0][shape->layers][o]);
        e->rows[1][shape->layers][o] = (double)out_grad[o];
    }
    for (int l = 1; l < shape->layers; l++)
        for (int i = 0; i < shape->in[l]; i++)
            ck_assert_double_le(e->rows[0][l][i], 256); // exact in bf16
    rn_mlp_backward(shape, e->weights, e->rows[0], e->rows[1], e->weight_grad);
    for (int i = 0; in_grad && i < shape->in[0]; i++)
        ck_assert_double_eq((double)in_grad[i], e->rows[1][0][i]);
}

static void check_weight_grad(const struct exact *e, const float *weight_grad) {
    for (size_t i = 0; i < e->shape->count; i++)
        ck_assert_double_eq((double)weight_grad[i], e->weight_grad[i]);
}

static void check_networks(const struct rn_kernels *kernels, const struct rn_field_config *config,
                           int rows) {
    struct subject s;
    struct rn_march_options options = {.step = 0.01f};
    struct exact base, head;
    const float *in_grad;
    static float out[ROWS * RN_GEOMETRY], head_out[ROWS * RN_GEOMETRY];
    static float grad[ROWS * RN_GEOMETRY];
    set_up(kernels, config, rows, &s);
    struct rn_workspace *w = s.workspace;
    const struct rn_cpu_field *cpu = &s.field->cpu;
    exact_init(&cpu->base_shape, cpu->base_weights, &base);
    exact_init(&cpu->head_shape, cpu->head_weights, &head);
    kernels->parts->stage(cpu, &options, NULL, 0, RN_STAGE_MLP_FORWARD, w, &s.group, NULL);
    memcpy(out, w->geometry, (size_t)rows * RN_GEOMETRY * sizeof(float));
    memcpy(head_out, w->head_out, (size_t)s.heads * RN_GEOMETRY * sizeof(float));
    for (int i = 0; i < rows * RN_GEOMETRY; i++)
        grad[i] = w->geometry_grad[i] = w->head_out[i] = (float)integer(3, (uint64_t)i, -2, 2);
    memset(w->grad_b, 0xff,
           (size_t)512 * (size_t)cpu->config->width *
               sizeof(float)); // NaN: no scratch is read unwritten
    kernels->parts->stage(cpu, &options, NULL, 0, RN_STAGE_MLP_BACKWARD, w, &s.group, &in_grad);
    for (int i = 0; i < rows; i++)
        check_row(&base, s.features[i], out + i * RN_GEOMETRY, grad + i * RN_GEOMETRY,
                  in_grad + i * cpu->feature_stride);
    for (int i = 0; i < s.heads; i++)
        check_row(&head, w->head_in + i * RN_HEAD_INPUTS, head_out + i * RN_GEOMETRY,
                  grad + i * RN_GEOMETRY, NULL);
    check_weight_grad(&base, s.group.base_grad);
    check_weight_grad(&head, s.group.head_grad);
    exact_finish(&base);
    exact_finish(&head);
    tear_down(&s);
}

static struct rn_field_config config_of(int planes, int channels, int width, int layers) {
    return (struct rn_field_config){.planes = planes,
                                    .base = 16,
                                    .channels = channels,
                                    .levels = 1,
                                    .shading = RN_SHADING_SAMPLE,
                                    .width = width,
                                    .base_layers = layers,
                                    .head_layers = 4 - layers,
                                    .view_dependence = true,
                                    .occupancy = 16};
}

START_TEST(integers_are_exact) {
    static const int rows[] = {1, 31, 32, 33, 63, 64, 65, 128, 129, 200, ROWS};
    static const int inputs[][2] = {{3, 4}, {3, 8}, {3, 16}, {6, 8}, {10, 16}};
    const struct rn_kernels *kernels;
    for (int k = 0; (kernels = rn_kernels_available(k)); k++)
        for (int n = 0, width = 16; width <= WIDEST; n++, width += width < 64 ? 16 : 32) {
            const int *in = inputs[n % 5];
            struct rn_field_config config = config_of(in[0], in[1], width, 1 + n % 3);
            check_networks(kernels, &config, rows[(3 * n) % 11]);
            check_networks(kernels, &config, rows[(3 * n + 5) % 11]);
        }
}
END_TEST

START_TEST(every_number_of_rows) {
    struct rn_field_config config = config_of(3, 8, 48, 2);
    const struct rn_kernels *kernels;
    for (int k = 0; (kernels = rn_kernels_available(k)); k++)
        for (int rows = 1; rows <= 72; rows++)
            check_networks(kernels, &config, rows);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("networks");
    TCase *tests = tcase_create("integers");
    tcase_set_timeout(tests, 120);
    tcase_add_test(tests, integers_are_exact);
    tcase_add_test(tests, every_number_of_rows);
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
