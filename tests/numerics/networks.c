// Case 5: the tiny networks of every kernel set, forward and backward, against float64 with a bound
// that is carried along: every number has its truth and how far rounding may have taken it. A sum
// of products is off by at most what its operands are off, times the other ones, and rho times the
// sum of its terms' sizes (its condition number times the result): rho = (K + 2) 2^-24 for K terms
// in fp32, and 2^-7 + 2^-16 more where both operands are rounded to bf16. Where a hidden unit lies
// within its error of 0 its slope may be either.
#include <string.h>

#include "server/engine/scene/scene.h"
#include "tests/support/numerics.h"

#define ROWS 200
#define WIDEST 160

// A number and the bound of its error.
struct near {
    double truth, error;
};

struct network {
    const struct rn_mlp_shape *shape;
    const float *weights;
    bool bf16;
    struct near rows[RN_MLP_MAX_LAYERS + 1][ROWS][WIDEST]; // inputs, then sums before ReLU
    struct near grads[ROWS][WIDEST];                       // of the layer under way
    struct near weight_grads[WIDEST * WIDEST * 3];
};

static double rho(const struct network *n, int terms) {
    return (terms + 2) * 0x1p-24 + (n->bf16 ? 0x1p-7 + 0x1p-16 : 0);
}

static void add_product(struct near *sum, struct near a, struct near b, double rho) {
    double most = (fabs(a.truth) + a.error) * (fabs(b.truth) + b.error);
    sum->truth += a.truth * b.truth;
    sum->error += most - fabs(a.truth * b.truth) + rho * most + 1e-36; // bf16 has no denormals
}

static struct near weight_of(const struct network *n, int l, int i, int o) {
    size_t at = n->shape->offset[l] + (size_t)(i * n->shape->out[l] + o);
    return (struct near){(double)n->weights[at], 0};
}

// Input i of layer l: ReLU makes no error larger.
static struct near input_of(const struct network *n, int l, int row, int i) {
    struct near a = n->rows[l][row][i];
    if (l > 0) a.truth = fmax(a.truth, 0);
    return a;
}

static void forward(struct network *n, int rows, const float *in, int stride) {
    for (int r = 0; r < rows; r++)
        for (int i = 0; i < n->shape->in[0]; i++)
            n->rows[0][r][i] = (struct near){(double)in[r * stride + i], 0};
    for (int l = 0; l < n->shape->layers; l++)
        for (int at = 0; at < rows * n->shape->out[l]; at++) {
            int r = at / n->shape->out[l], o = at % n->shape->out[l];
            struct near sum = {0, 0};
            for (int i = 0; i < n->shape->in[l]; i++)
                add_product(&sum, input_of(n, l, r, i), weight_of(n, l, i, o),
                            rho(n, n->shape->in[l]));
            n->rows[l + 1][r][o] = sum;
        }
}

// The slope of a hidden unit: 1, 0, or either when its sum may have either sign.
static struct near masked(struct near z, struct near grad) {
    if (z.truth > z.error) return grad;
    if (z.truth < -z.error) return (struct near){0, 0};
    struct near either = {z.truth > 0 ? grad.truth : 0, fabs(grad.truth) + grad.error};
    return either;
}

static void backward(struct network *n, int rows, const float *out_grad, int outputs) {
    const struct rn_mlp_shape *s = n->shape;
    memset(n->weight_grads, 0, sizeof n->weight_grads);
    for (int at = 0; at < rows * outputs; at++)
        n->grads[at / outputs][at % outputs] = (struct near){(double)out_grad[at], 0};
    for (int l = s->layers - 1; l >= 0; l--)
        for (int r = 0; r < rows; r++) {
            struct near in[WIDEST];
            for (int i = 0; i < s->in[l]; i++) {
                struct near sum = {0, 0}, a = input_of(n, l, r, i);
                for (int o = 0; o < s->out[l]; o++) {
                    add_product(&sum, n->grads[r][o], weight_of(n, l, i, o), rho(n, s->out[l]));
                    add_product(&n->weight_grads[s->offset[l] + (size_t)(i * s->out[l] + o)], a,
                                n->grads[r][o], rho(n, rows));
                }
                in[i] = l > 0 ? masked(n->rows[l][r][i], sum) : sum;
            }
            memcpy(n->grads[r], in, sizeof in);
        }
}

// ---- the kernels' side ------------------------------------------------------------------------

struct subject {
    struct rn_field *field;
    struct rn_workspace *workspace;
    struct rn_group group;
    int rows, heads;
    float features[ROWS][WIDEST], out[2][ROWS * RN_GEOMETRY], grad[ROWS * RN_GEOMETRY], *in_grad;
};

static float signed_spread(struct numerics_random *random, double low, double high) {
    double size = numerics_spread(random, low, high);
    return (float)(numerics_uniform(random, 0, 1) < 0.5 ? -size : size);
}

// Weights as large as training makes them, features and gradients of any size.
static void set_up(const struct rn_kernels *kernels, const struct rn_field_config *config, int rows,
                   double gradient, struct numerics_random *random, struct subject *s) {
    struct rn_train_config train = {.field = *config, .step = 0.01};
    struct rn_bounds bounds = {.radius = 1};
    memset(s, 0, sizeof *s);
    if (rn_field_create(&train, &bounds, &s->field, NULL) != RN_OK) exit(1);
    const struct rn_cpu_field *cpu = &s->field->cpu;
    struct rn_parameters *p = &s->field->parameters;
    for (size_t i = p->plane_count; i < p->count; i++)
        p->values[i] = signed_spread(random, 1e-3, 1);
    rn_field_refresh(s->field, &(struct rn_engine){.kernels = kernels});
    size_t bytes = (rn_workspace_size(cpu, train.step) + 63) / 64 * 64;
    void *memory = aligned_alloc(64, bytes);
    s->group.base_grad = calloc(p->base_count + p->head_count, sizeof(float));
    if (!memory || !s->group.base_grad) exit(1);
    s->group.head_grad = s->group.base_grad + p->base_count;
    struct rn_workspace *w = s->workspace = rn_workspace_init(cpu, train.step, memory);
    s->rows = s->heads = w->count = s->group.slab.count = rows;
    for (int i = 0; i < rows; i++)
        w->weight[i] = 1; // every sample has a row of the colour network
    for (int i = 0; i < rows; i++) {
        for (int k = 0; k < cpu->features; k++)
            s->features[i][k] = signed_spread(random, 1e-4, 1);
        kernels->parts->put_features(cpu, i, s->features[i], w);
    }
    for (int i = 0; i < rows * RN_HEAD_INPUTS; i++)
        w->head_in[i] = signed_spread(random, 1e-4, 1);
    for (int i = 0; i < rows * RN_GEOMETRY; i++)
        s->grad[i] = signed_spread(random, 1e-3 * gradient, gradient);
}

static void run(const struct rn_kernels *kernels, struct subject *s) {
    struct rn_march_options options = {.step = 0.01f};
    struct rn_workspace *w = s->workspace;
    size_t bytes = (size_t)(s->rows * RN_GEOMETRY) * sizeof(float);
    const float *in_grad;
    kernels->parts->stage(&s->field->cpu, &options, NULL, 0, RN_STAGE_MLP_FORWARD, w, &s->group,
                          NULL);
    memcpy(s->out[0], w->geometry, bytes);
    memcpy(s->out[1], w->head_out, bytes);
    memcpy(w->geometry_grad, s->grad, bytes);
    memcpy(w->head_out, s->grad, bytes);
    kernels->parts->stage(&s->field->cpu, &options, NULL, 0, RN_STAGE_MLP_BACKWARD, w, &s->group,
                          &in_grad);
    s->in_grad = (float *)in_grad;
}

static void tear_down(struct subject *s) {
    free(s->group.base_grad);
    free(s->workspace);
    rn_field_destroy(&s->field);
}

// ---- held against each other --------------------------------------------------------------------

// Each number within its bound; the outputs also together: root mean square error over root mean
// square (a slope that is the other one of two makes no such bound for gradients).
struct both {
    struct numerics_case bound, size;
};

static void see_all(struct both *c, const struct network *n, const char *what, int rows,
                    int columns, const float *got, int stride, const struct near *want,
                    int want_stride) {
    double squares = 0, all = 0;
    for (int at = 0; at < rows * columns; at++) {
        struct near w = want[at / columns * want_stride + at % columns];
        double number = (double)got[at / columns * stride + at % columns];
        double error = fabs(number - w.truth);
        numerics_see(&c->bound, error > 0 ? error / w.error : 0, "%s, width %d, row %d, column %d",
                     what, n->shape->out[0], at / columns, at % columns);
        squares += error * error;
        all += w.truth * w.truth;
    }
    if (strstr(what, "gradients")) return;
    numerics_see(&c->size, sqrt(squares / all), "%s, width %d, %d rows", what, n->shape->out[0],
                 rows);
}

static void see_network(struct both *c, struct network *n, const struct subject *s, bool head) {
    const struct rn_cpu_field *cpu = &s->field->cpu;
    const struct rn_workspace *w = s->workspace;
    n->shape = head ? &cpu->head_shape : &cpu->base_shape;
    n->weights = head ? cpu->head_weights : cpu->base_weights;
    forward(n, s->rows, head ? w->head_in : s->features[0], head ? RN_HEAD_INPUTS : WIDEST);
    see_all(c, n, head ? "colour" : "density", s->rows, RN_GEOMETRY, s->out[head], RN_GEOMETRY,
            n->rows[n->shape->layers][0], WIDEST);
    backward(n, s->rows, s->grad, RN_GEOMETRY);
    see_all(c, n, head ? "colour, weights' gradients" : "density, weights' gradients", 1,
            (int)n->shape->count, head ? s->group.head_grad : s->group.base_grad, 0,
            n->weight_grads, 0);
    if (!head)
        see_all(c, n, "density, inputs' gradients", s->rows, cpu->features, s->in_grad,
                cpu->feature_stride, n->grads[0], WIDEST);
}

static int check_set(const struct rn_kernels *kernels, struct numerics_random *random) {
    static struct network network;
    static struct subject s;
    static const int rows[] = {1, 33, 64, 97, ROWS}, widths[] = {16, 48, 64, 128};
    char names[2][80];
    bool bf16 = rn_kernels_bf16(kernels);
    const char *range = "widths 16..128, 1..200 rows, gradients of 1e-30..1e20, weights to 1";
    snprintf(names[0], sizeof names[0], "5 networks and their gradients, %s", kernels->name);
    snprintf(names[1], sizeof names[1], "5 networks' outputs together, %s", kernels->name);
    struct both c = {{names[0], range,
                      bf16 ? "of the bound carried along, 2^-7 a product"
                           : "of the bound carried along, (K + 2) 2^-24 a product",
                      1, 0, ""},
                     {names[1], range, "relative, root mean square", bf16 ? 0x1p-5 : 2e-6, 0, ""}};
    for (int trial = 0; trial < 8; trial++) {
        int layers = 1 + trial % 3;
        struct rn_field_config config = {.planes = trial % 2 ? 10 : 3,
                                         .base = 16,
                                         .channels = trial % 2 ? 16 : 8,
                                         .levels = 1,
                                         .shading = RN_SHADING_SAMPLE,
                                         .width = widths[trial % 4],
                                         .base_layers = layers,
                                         .head_layers = 4 - layers,
                                         .view_dependence = true,
                                         .occupancy = 16};
        set_up(kernels, &config, rows[trial % 5], numerics_spread(random, 1e-30, 1e20), random, &s);
        network.bf16 = bf16;
        run(kernels, &s);
        see_network(&c, &network, &s, false);
        see_network(&c, &network, &s, true);
        tear_down(&s);
    }
    return numerics_close(&c.bound) + numerics_close(&c.size);
}

int main(void) {
    struct numerics_random random = numerics_random();
    const struct rn_kernels *kernels;
    int failed = 0;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        failed += check_set(kernels, &random);
    return failed > 0;
}
