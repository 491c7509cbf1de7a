// The kernel sets' tiny networks beside libraries that multiply matrices.
//
//   libraries [seconds=2] [only=]
//
// The density and the colour network of `standard` and `paper`, forward and backward, one thread:
// every kernel set that this machine has, OpenBLAS, oneDNN and libxsmm, each where it was found
// when this was built. Every candidate's outputs and gradients are compared with float64 first; one
// that is off by more than its bound is reported and not timed. Candidates then run in turns,
// `seconds` for each network and number of rows, and the best of a candidate's turns counts, in the
// thread's CPU time. `only` is a part of the names of the candidates that are wanted. Libraries
// obey their own environment variables (OPENBLAS_CORETYPE, ONEDNN_MAX_CPU_ISA, LIBXSMM_TARGET). No
// test: a tool to measure with.
#include "tests/bench/libraries.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "common/math/rng.h"
#include "server/engine/kernels/kernels.h"

#define CANDIDATES 32
#define BATCHES 5
#define ROUNDS 3         // at least
#define ROWS_A_TURN 4096 // at least, of a candidate's turn; one call more comes before it

// On the norm of the error over the reference's, of the outputs and of the gradients. Activations
// next to zero may be cut off or not, and one that is not carries its whole gradient.
struct bound {
    double out, grad;
};
static const struct bound fp32_bound = {1e-5, 2e-3}, bf16_bound = {0.02, 0.15};

static const int batches[BATCHES] = {64, 256, 1024, 4096, 32768};
static const struct {
    const char *name;
    int inputs, width, hidden;
} networks[] = {{"density network of `standard`", 48, 64, 1},
                {"colour network of `standard`", RN_HEAD_INPUTS, 64, 1},
                {"density network of `paper`", 160, 128, 2},
                {"colour network of `paper`", RN_HEAD_INPUTS, 128, 4}};

// ---- what candidates share ------------------------------------------------------------------

void *zeros(size_t count, size_t size) {
    size_t bytes = (count * size + 64 + 63) / 64 * 64; // room for a vector beyond
    void *block = aligned_alloc(64, bytes);
    if (!block) {
        fprintf(stderr, "libraries: out of memory\n");
        exit(1);
    }
    return memset(block, 0, bytes);
}

void transpose_weights(const struct rn_mlp_shape *shape, const float *weights, float *ret) {
    for (int l = 0; l < shape->layers; l++)
        for (int i = 0; i < shape->in[l]; i++)
            for (int o = 0; o < shape->out[l]; o++)
                ret[shape->offset[l] + (size_t)o * (size_t)shape->in[l] + (size_t)i] =
                    weights[shape->offset[l] + (size_t)i * (size_t)shape->out[l] + (size_t)o];
}

// The widest vectors that the machine has.
#ifdef __x86_64__
#define WIDE __attribute__((target_clones("default", "avx2", "avx512f")))
#else
#define WIDE
#endif

WIDE void relu(size_t n, float *x) {
    for (size_t i = 0; i < n; i++)
        x[i] = x[i] > 0 ? x[i] : 0;
}

WIDE void mask(size_t n, const float *restrict activation, float *restrict grad) {
    for (size_t i = 0; i < n; i++)
        grad[i] = activation[i] > 0 ? grad[i] : 0;
}

WIDE void mask16(size_t n, const int16_t *restrict activation, int16_t *restrict grad) {
    for (size_t i = 0; i < n; i++)
        grad[i] = (int16_t)(activation[i] > 0 ? grad[i] : 0);
}

WIDE void add(size_t n, const float *restrict x, float *restrict sum) {
    for (size_t i = 0; i < n; i++)
        sum[i] += x[i];
}

// ---- the kernel sets ------------------------------------------------------------------------

// A field that consists of the one network, in the density network's place, and a workspace with
// room for all rows.
struct own {
    const struct problem *problem;
    const struct rn_kernels *kernels;
    struct rn_field_config config;
    struct rn_cpu_field field;
    struct rn_workspace *workspace;
    struct rn_group group;
    float *packed;
    const float *in_grad;
};

static void own_destroy(void *work) {
    struct own *own = work;
    free(own->workspace);
    free(own->packed);
    free(own->group.base_grad);
    free(own);
}

static void own_take_rows(struct own *own) {
    for (int i = 0; i < own->problem->rows; i++)
        own->kernels->parts->put_features(
            &own->field, i, own->problem->in + i * own->field.features, own->workspace);
}

static void *own_create(const struct candidate *candidate, const struct problem *problem) {
    struct own *own = zeros(1, sizeof *own);
    const struct rn_mlp_shape *shape = &problem->shape;
    struct rn_cpu_field *field = &own->field;
    double step = 2 * 1.7320508 / (problem->rows - 2 * RN_ROUND); // a ray of as many samples
    size_t rows = (size_t)problem->rows;
    own->problem = problem;
    own->kernels = candidate->which;
    own->config = (struct rn_field_config){.planes = 1,
                                           .shading = RN_SHADING_RAY,
                                           .width = shape->out[0],
                                           .base_layers = shape->layers - 1};
    field->config = &own->config;
    field->base_shape = *shape;
    field->features = field->feature_stride = shape->in[0];
    field->base_weights = problem->weights;
    field->base_packed = own->packed = zeros(rn_mlp_packed_count(shape), sizeof(float));
    own->kernels->pack(shape, problem->weights, own->packed);
    own->workspace = rn_workspace_init(field, step, zeros(rn_workspace_size(field, step), 1));
    own->group.base_grad = zeros(shape->count, sizeof(float));
    own->group.slab.count = own->workspace->count = problem->rows;
    memcpy(own->workspace->geometry_grad, problem->out_grad, rows * RN_GEOMETRY * sizeof(float));
    if (own->workspace->capacity >= problem->rows) {
        own_take_rows(own);
        return own;
    }
    own_destroy(own);
    return NULL;
}

static void own_forward(void *work) {
    struct own *own = work;
    if (rn_kernels_bf16(own->kernels))
        own_take_rows(own); // rounding is part of the libraries' work
    own->kernels->parts->stage(&own->field, NULL, NULL, 0, RN_STAGE_MLP_FORWARD, own->workspace,
                               &own->group, NULL);
}

static void own_backward(void *work) {
    struct own *own = work;
    own->kernels->parts->stage(&own->field, NULL, NULL, 0, RN_STAGE_MLP_BACKWARD, own->workspace,
                               &own->group, &own->in_grad);
}

static void own_look(void *work, struct outcome *ret) {
    struct own *own = work;
    *ret = (struct outcome){.out = own->workspace->geometry,
                            .in_grad = own->in_grad,
                            .weight_grad = own->group.base_grad};
}

// ---- float64 --------------------------------------------------------------------------------

struct exact {
    double *activation[RN_MLP_MAX_LAYERS + 1], *grad[RN_MLP_MAX_LAYERS + 1], *weight_grad;
};

static void exact_layer(const struct problem *p, int l, const double *from, double *to) {
    int in = p->shape.in[l], out = p->shape.out[l];
    const float *weights = p->weights + p->shape.offset[l];
    for (int i = 0; i < in; i++)
        for (int o = 0; o < out; o++)
            to[o] += from[i] * (double)weights[i * out + o];
    for (int o = 0; o < out && l + 1 < p->shape.layers; o++)
        to[o] = to[o] > 0 ? to[o] : 0;
}

static void exact_layer_backward(const struct problem *p, int l, const double *activation,
                                 const double *grad, double *to, double *weight_grad) {
    int in = p->shape.in[l], out = p->shape.out[l];
    const float *weights = p->weights + p->shape.offset[l];
    for (int i = 0; i < in; i++) {
        double sum = 0;
        for (int o = 0; o < out; o++) {
            sum += grad[o] * (double)weights[i * out + o];
            weight_grad[i * out + o] += activation[i] * grad[o];
        }
        to[i] = l > 0 && !(activation[i] > 0) ? 0 : sum;
    }
}

static void exact_init(const struct problem *p, struct exact *exact) {
    const struct rn_mlp_shape *shape = &p->shape;
    size_t rows = (size_t)p->rows, in = (size_t)shape->in[0], outputs;
    int last = shape->layers;
    outputs = (size_t)shape->out[last - 1];
    for (int l = 0; l <= last; l++) {
        size_t width = (size_t)(l < last ? shape->in[l] : shape->out[last - 1]);
        exact->activation[l] = zeros(rows * width, sizeof(double));
        exact->grad[l] = zeros(rows * width, sizeof(double));
    }
    exact->weight_grad = zeros(shape->count, sizeof(double));
    for (size_t i = 0; i < rows * in; i++)
        exact->activation[0][i] = (double)p->in[i];
    for (size_t i = 0; i < rows * outputs; i++)
        exact->grad[last][i] = (double)p->out_grad[i];
    for (size_t row = 0; row < rows; row++) {
        for (int l = 0; l < last; l++)
            exact_layer(p, l, exact->activation[l] + row * (size_t)shape->in[l],
                        exact->activation[l + 1] + row * (size_t)shape->out[l]);
        for (int l = last - 1; l >= 0; l--)
            exact_layer_backward(p, l, exact->activation[l] + row * (size_t)shape->in[l],
                                 exact->grad[l + 1] + row * (size_t)shape->out[l],
                                 exact->grad[l] + row * (size_t)shape->in[l],
                                 exact->weight_grad + shape->offset[l]);
    }
}

static void exact_finish(const struct problem *p, struct exact *exact) {
    for (int l = 0; l <= p->shape.layers; l++) {
        free(exact->activation[l]);
        free(exact->grad[l]);
    }
    free(exact->weight_grad);
}

// Norm of the difference over that of the reference.
static double off(size_t n, const float *x, const double *reference) {
    double difference = 0, norm = 0;
    for (size_t i = 0; i < n; i++) {
        difference += ((double)x[i] - reference[i]) * ((double)x[i] - reference[i]);
        norm += reference[i] * reference[i];
    }
    return isfinite(difference) ? sqrt(difference / norm) : INFINITY;
}

// Of one forward and backward, the first since the work was created.
static struct bound check(const struct candidate *candidate, void *work, const struct problem *p,
                          const struct exact *exact) {
    struct outcome outcome;
    size_t rows = (size_t)p->rows;
    int last = p->shape.layers;
    size_t inputs = rows * (size_t)p->shape.in[0], outputs = rows * (size_t)p->shape.out[last - 1];
    candidate->forward(work);
    candidate->backward(work);
    candidate->look(work, &outcome);
    return (struct bound){.out = off(outputs, outcome.out, exact->activation[last]),
                          .grad =
                              fmax(off(inputs, outcome.in_grad, exact->grad[0]),
                                   off(p->shape.count, outcome.weight_grad, exact->weight_grad))};
}

static bool within(const struct bound *error, bool bf16) {
    return error->out <= (bf16 ? bf16_bound : fp32_bound).out &&
           error->grad <= (bf16 ? bf16_bound : fp32_bound).grad;
}

// ---- timing ---------------------------------------------------------------------------------

// Seconds of one call; NAN: not there or wrong.
struct times {
    double forward[BATCHES], backward[BATCHES];
    struct bound error; // the largest
    bool there;
};

// Of this thread: what others do meanwhile does not count.
static double thread_seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

static void take_turn(void (*work)(void *work), void *context, int calls, double *best) {
    work(context); // what it reads is in the caches, as in training
    double begin = thread_seconds();
    for (int i = 0; i < calls; i++)
        work(context);
    double seconds = (thread_seconds() - begin) / calls;
    if (!(seconds >= *best)) *best = seconds;
}

static void measure(const struct problem *p, const struct candidate *candidates, int count,
                    int batch, double seconds, struct times *times) {
    void *works[CANDIDATES];
    struct exact exact;
    int calls = (ROWS_A_TURN + p->rows - 1) / p->rows;
    exact_init(p, &exact);
    for (int i = 0; i < count; i++) {
        times[i].forward[batch] = times[i].backward[batch] = NAN;
        works[i] = candidates[i].create(&candidates[i], p);
        if (!works[i]) continue;
        struct bound error = check(&candidates[i], works[i], p, &exact);
        times[i].there = true;
        times[i].error.out = fmax(times[i].error.out, error.out);
        times[i].error.grad = fmax(times[i].error.grad, error.grad);
        if (within(&error, candidates[i].bf16)) continue;
        candidates[i].destroy(works[i]);
        works[i] = NULL;
    }
    exact_finish(p, &exact);
    double end = thread_seconds() + seconds;
    for (int round = 0; round < ROUNDS || thread_seconds() < end; round++)
        for (int i = 0; i < count; i++) {
            if (!works[i]) continue;
            take_turn(candidates[i].forward, works[i], calls, &times[i].forward[batch]);
            take_turn(candidates[i].backward, works[i], calls, &times[i].backward[batch]);
        }
    for (int i = 0; i < count; i++)
        if (works[i]) candidates[i].destroy(works[i]);
}

// Weights as a network begins, inputs of either sign.
static void fill(const struct rn_mlp_shape *shape, int rows, uint64_t seed, struct problem *p) {
    float *weights = zeros(shape->count, sizeof *weights);
    size_t inputs = (size_t)rows * (size_t)shape->in[0];
    size_t outputs = (size_t)rows * (size_t)shape->out[shape->layers - 1];
    float *in = zeros(inputs, sizeof *in), *out_grad = zeros(outputs, sizeof *out_grad);
    for (int l = 0; l < shape->layers; l++) {
        float most = sqrtf(6.0f / (float)(shape->in[l] + shape->out[l]));
        size_t count = (size_t)shape->in[l] * (size_t)shape->out[l];
        for (size_t i = shape->offset[l]; i < shape->offset[l] + count; i++)
            weights[i] = most * (2 * (float)rn_rng_unit(rn_rng_draw(seed, 0, i).v[0]) - 1);
    }
    for (size_t i = 0; i < inputs; i++)
        in[i] = 2 * (float)rn_rng_unit(rn_rng_draw(seed, 1, i).v[0]) - 1;
    for (size_t i = 0; i < outputs; i++)
        out_grad[i] = 2 * (float)rn_rng_unit(rn_rng_draw(seed, 2, i).v[0]) - 1;
    *p = (struct problem){
        .shape = *shape, .rows = rows, .weights = weights, .in = in, .out_grad = out_grad};
}

static void print_row(const char *name, const struct times *t, double factor[BATCHES],
                      bool inverse) {
    printf("%-24s %7.0e %7.0e", name, t->error.out, t->error.grad);
    for (int way = 0; way < 2; way++)
        for (int b = 0; b < BATCHES; b++) {
            double seconds = way == 0 ? t->forward[b] : t->backward[b];
            double value = inverse ? factor[b] * (1 + way) / seconds : seconds * factor[b];
            if (isnan(value))
                printf(" %8s", "-");
            else
                printf(" %8.1f", value);
        }
    printf("\n");
}

static void print_heading(void) {
    printf("%-24s %7s %7s", "", "out", "grad");
    for (int way = 0; way < 2; way++)
        for (int b = 0; b < BATCHES; b++)
            printf(" %c %6d", way == 0 ? 'f' : 'b', batches[b]);
    printf("\n");
}

// Columns: the errors of outputs and gradients, then forward (f) and backward (b) of so many rows.
static void print_tables(const char *name, const struct rn_mlp_shape *shape,
                         const struct candidate *candidates, int count, const struct times *times) {
    double thousands[BATCHES], products[BATCHES];
    for (int b = 0; b < BATCHES; b++) {
        thousands[b] = 1e9 / batches[b];
        products[b] = 1e-9 * batches[b] * (double)shape->count;
    }
    printf("\n%s, %zu multiply-adds a row: us per 1,000 rows\n", name, shape->count);
    print_heading();
    for (int i = 0; i < count; i++)
        if (times[i].there) print_row(candidates[i].name, &times[i], thousands, false);
    printf("\nthe same: GMAC/s, of which a backward has twice as many\n");
    print_heading();
    for (int i = 0; i < count; i++)
        if (times[i].there) print_row(candidates[i].name, &times[i], products, true);
}

// ---- main -----------------------------------------------------------------------------------

static int list_candidates(const char *only, struct candidate *list) {
    struct candidate all[CANDIDATES] = {{0}};
    const struct rn_kernels *kernels;
    int n = 0, kept = 0;
    for (int i = 0; (kernels = rn_kernels_available(i)); i++)
        all[n++] = (struct candidate){.name = kernels->name,
                                      .bf16 = rn_kernels_bf16(kernels),
                                      .which = kernels,
                                      .create = own_create,
                                      .forward = own_forward,
                                      .backward = own_backward,
                                      .look = own_look,
                                      .destroy = own_destroy};
#ifdef HAVE_OPENBLAS
    printf("%s\n", openblas_version());
    for (int i = 0; openblas_candidates[i].name; i++)
        all[n++] = openblas_candidates[i];
#else
    printf("OpenBLAS: not built in\n");
#endif
#ifdef HAVE_ONEDNN
    printf("oneDNN %s\n", onednn_version());
    for (int i = 0; onednn_candidates[i].name; i++)
        all[n++] = onednn_candidates[i];
#else
    printf("oneDNN: not built in\n");
#endif
#ifdef HAVE_LIBXSMM
    printf("libxsmm %s\n", libxsmm_version());
#if defined __x86_64__ // there its file is compiled for AVX-512 BF16
    if (!__builtin_cpu_supports("avx512bf16"))
        printf("libxsmm: built for instructions that this machine lacks\n");
    else
#endif
        for (int i = 0; libxsmm_candidates[i].name; i++)
            all[n++] = libxsmm_candidates[i];
#else
    printf("libxsmm: not built in\n");
#endif
    for (int i = 0; i < n; i++)
        if (strstr(all[i].name, only)) list[kept++] = all[i];
    return kept;
}

// Libraries ask for the number of threads when they are loaded.
static void be_one_thread(char **argv) {
    const char *threads = getenv("OMP_NUM_THREADS");
    if (threads && strcmp(threads, "1") == 0) return;
    setenv("OMP_NUM_THREADS", "1", 1);
    setenv("OPENBLAS_NUM_THREADS", "1", 1);
    execv("/proc/self/exe", argv);
}

int main(int argc, char **argv) {
    struct candidate candidates[CANDIDATES];
    const char *only = "";
    double seconds = 2;
    be_one_thread(argv);
    for (int i = 1; i < argc; i++) {
        if (strncmp(argv[i], "seconds=", 8) == 0) {
            seconds = atof(argv[i] + 8);
        } else if (strncmp(argv[i], "only=", 5) == 0) {
            only = argv[i] + 5;
        } else {
            fprintf(stderr, "usage: libraries [seconds=2] [only=]\n");
            return 2;
        }
    }
    setvbuf(stdout, NULL, _IOLBF, 0);
    int count = list_candidates(only, candidates);
    for (size_t n = 0; n < sizeof networks / sizeof *networks; n++) {
        struct rn_mlp_shape shape =
            rn_mlp_shape(networks[n].inputs, networks[n].width, networks[n].hidden, RN_GEOMETRY);
        struct times times[CANDIDATES] = {{.there = false}};
        for (int b = 0; b < BATCHES; b++) {
            struct problem problem;
            fill(&shape, batches[b], 1 + n, &problem);
            measure(&problem, candidates, count, b, seconds, times);
            free((void *)problem.weights);
            free((void *)problem.in);
            free((void *)problem.out_grad);
        }
        print_tables(networks[n].name, &shape, candidates, count, times);
    }
    return 0;
}
