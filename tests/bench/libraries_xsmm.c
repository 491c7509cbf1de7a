// The networks with libxsmm: a product generated for each layer's shape, blocks of rows through
// all layers so that what is between the products stays in the L1 and L2 caches. The bf16 products
// read their left operand as pairs; what prepares operands there is the engine's own.
//
// libxsmm's matrices have columns in memory: its C = A B with A weights, B rows.
#include <libxsmm.h>
#include <stdlib.h>
#include <string.h>

#include "tests/bench/libraries.h"
#ifdef __AVX512BF16__
#include "server/engine/cpu/gemm_bf16.h"
#endif

#define BLOCK 64 // rows that go through all layers together

const char *libxsmm_version(void) {
    return LIBXSMM_VERSION;
}

// ---- fp32 -----------------------------------------------------------------------------------

struct chain {
    struct problem problem;
    float *activation[RN_MLP_MAX_LAYERS + 1]; // [0] borrowed
    float *turned;                            // weights, transposed
    float *columns;                           // a block's activations, transposed
    float *grad[2], *in_grad, *weight_grad;
    libxsmm_smmfunction forward[RN_MLP_MAX_LAYERS], data[RN_MLP_MAX_LAYERS],
        weights[RN_MLP_MAX_LAYERS];
};

static libxsmm_smmfunction kernel(int m, int n, int k, float beta) {
    const float alpha = 1;
    return libxsmm_smmdispatch(m, n, k, NULL, NULL, NULL, &alpha, &beta, NULL, NULL);
}

static void destroy(void *work) {
    struct chain *c = work;
    for (int l = 0; l < c->problem.shape.layers; l++)
        free(c->activation[l + 1]);
    free(c->turned);
    free(c->columns);
    free(c->grad[0]);
    free(c->grad[1]);
    free(c->in_grad);
    free(c->weight_grad);
    free(c);
}

static void *create(const struct candidate *candidate, const struct problem *problem) {
    struct chain *c = zeros(1, sizeof *c);
    const struct rn_mlp_shape *shape = &problem->shape;
    size_t rows = (size_t)problem->rows, widest = (size_t)shape->widest;
    bool all = true;
    c->problem = *problem;
    c->activation[0] = (float *)problem->in;
    for (int l = 0; l < shape->layers; l++) {
        int in = shape->in[l], out = shape->out[l];
        c->activation[l + 1] = zeros(rows * (size_t)out, sizeof(float));
        c->forward[l] = kernel(out, BLOCK, in, 0);
        c->data[l] = kernel(in, BLOCK, out, 0);
        c->weights[l] = kernel(out, in, BLOCK, 1);
        all = all && c->forward[l] && c->data[l] && c->weights[l];
    }
    c->turned = zeros(shape->count, sizeof(float));
    transpose_weights(shape, problem->weights, c->turned);
    c->columns = zeros(widest * BLOCK, sizeof(float));
    for (int i = 0; i < 2; i++)
        c->grad[i] = zeros(widest * BLOCK, sizeof(float));
    c->in_grad = zeros(rows * (size_t)shape->in[0], sizeof(float));
    c->weight_grad = zeros(shape->count, sizeof(float));
    if (all) return c;
    destroy(c);
    return NULL;
}

static void forward(void *work) {
    struct chain *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    for (size_t row = 0; row < (size_t)c->problem.rows; row += BLOCK)
        for (int l = 0; l < shape->layers; l++) {
            float *to = c->activation[l + 1] + row * (size_t)shape->out[l];
            c->forward[l](c->problem.weights + shape->offset[l],
                          c->activation[l] + row * (size_t)shape->in[l], to);
            if (l + 1 < shape->layers) relu(BLOCK * (size_t)shape->out[l], to);
        }
}

static void backward(void *work) {
    struct chain *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    int last = shape->layers - 1;
    for (size_t row = 0; row < (size_t)c->problem.rows; row += BLOCK) {
        const float *grad = c->problem.out_grad + row * (size_t)shape->out[last];
        for (int l = last; l >= 0; l--) {
            const float *activation = c->activation[l] + row * (size_t)shape->in[l];
            int in = shape->in[l];
            float *to = l > 0 ? c->grad[l & 1] : c->in_grad + row * (size_t)in;
            libxsmm_otrans(c->columns, activation, sizeof(float), in, BLOCK, in, BLOCK);
            c->weights[l](grad, c->columns, c->weight_grad + shape->offset[l]);
            c->data[l](c->turned + shape->offset[l], grad, to);
            if (l > 0) mask(BLOCK * (size_t)in, activation, to);
            grad = to;
        }
    }
}

static void look(void *work, struct outcome *ret) {
    struct chain *c = work;
    *ret = (struct outcome){.out = c->activation[c->problem.shape.layers],
                            .in_grad = c->in_grad,
                            .weight_grad = c->weight_grad};
}

// ---- bf16 -----------------------------------------------------------------------------------

#ifdef __AVX512BF16__

struct chain16 {
    struct problem problem;
    uint16_t *activation[RN_MLP_MAX_LAYERS]; // rows of round32(inputs of the layer)
    uint16_t *weights, *turned;              // pairs along the sum
    uint16_t *columns, *pairs, *grad;        // of a block
    float *sums, *out, *in_grad, *weight_grad;
    libxsmm_bsmmfunction forward[RN_MLP_MAX_LAYERS], data[RN_MLP_MAX_LAYERS],
        gradient[RN_MLP_MAX_LAYERS];
};

// Rows lie round32 apart, columns BLOCK apart.
static libxsmm_bsmmfunction kernel16(int m, int n, int k, int b_stride, float beta) {
    const float alpha = 1;
    const libxsmm_blasint ldb = b_stride;
    return libxsmm_bsmmdispatch(m, n, k, NULL, &ldb, NULL, &alpha, &beta, NULL, NULL);
}

// [k][n] to [k / 2][n][k % 2]; k even, n a multiple of 16.
static void pair_up(const float *from, int k, int n, uint16_t *to) {
    for (int row = 0; row < k; row += 2, from += 2 * n)
        for (int i = 0; i < n; i += 16, to += 32)
            _mm512_storeu_si512(to,
                                pair_of(_mm512_loadu_ps(from + i), _mm512_loadu_ps(from + n + i)));
}

static void pair_rows(const uint16_t *from, int stride, int rows, int n, uint16_t *to) {
    for (int row = 0; row < rows; row += 2, from += 2 * stride)
        for (int i = 0; i < n; i += 16, to += 32) {
            __m512i even = _mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i *)(from + i)));
            __m512i odd =
                _mm512_cvtepu16_epi32(_mm256_loadu_si256((const __m256i *)(from + stride + i)));
            _mm512_storeu_si512(to, _mm512_or_si512(even, _mm512_slli_epi32(odd, 16)));
        }
}

// A block's sums as bf16 rows: activations, or their gradient where `active` is positive.
static void round_rows(const float *sums, int n, const uint16_t *active, uint16_t *to) {
    const __m512 zero = _mm512_setzero_ps();
    for (int row = 0; row < BLOCK; row++, sums += n, to += round32(n))
        for (int i = 0; i < n; i += 16) {
            __m512 x = _mm512_loadu_ps(sums + i);
            if (active) {
                const uint16_t *is = active + (size_t)row * (size_t)round32(n) + i;
                __m256i positive = _mm256_loadu_si256((const __m256i *)is);
                x = _mm512_maskz_mov_ps(_mm256_cmpgt_epi16_mask(positive, _mm256_setzero_si256()),
                                        x);
            } else {
                x = _mm512_max_ps(x, zero);
            }
            _mm256_storeu_si256((__m256i *)(to + i), (__m256i)_mm512_cvtneps_pbh(x));
        }
}

static void destroy16(void *work) {
    struct chain16 *c = work;
    for (int l = 0; l < c->problem.shape.layers; l++)
        free(c->activation[l]);
    free(c->weights);
    free(c->turned);
    free(c->columns);
    free(c->pairs);
    free(c->grad);
    free(c->sums);
    free(c->out);
    free(c->in_grad);
    free(c->weight_grad);
    free(c);
}

static void pack16(struct chain16 *c) {
    const struct rn_mlp_shape *shape = &c->problem.shape;
    float *turned = zeros(shape->count, sizeof *turned);
    transpose_weights(shape, c->problem.weights, turned);
    for (int l = 0; l < shape->layers; l++) {
        size_t at = shape->offset[l];
        pair_up(c->problem.weights + at, shape->in[l], shape->out[l], c->weights + at);
        pair_up(turned + at, shape->out[l], shape->in[l], c->turned + at);
    }
    free(turned);
}

static void *create16(const struct candidate *candidate, const struct problem *problem) {
    if (libxsmm_get_target_archid() < LIBXSMM_X86_AVX512_CPX) return NULL;
    struct chain16 *c = zeros(1, sizeof *c);
    const struct rn_mlp_shape *shape = &problem->shape;
    size_t rows = (size_t)problem->rows, widest = (size_t)round32(shape->widest);
    bool all = true;
    c->problem = *problem;
    for (int l = 0; l < shape->layers; l++) {
        int in = shape->in[l], out = shape->out[l];
        c->activation[l] = zeros(rows * (size_t)round32(in), sizeof(uint16_t));
        c->forward[l] = kernel16(out, BLOCK, in, round32(in), 0);
        c->data[l] = kernel16(in, BLOCK, out, round32(out), 0);
        c->gradient[l] = kernel16(out, in, BLOCK, BLOCK, 1);
        all = all && c->forward[l] && c->data[l] && c->gradient[l];
    }
    c->weights = zeros(shape->count, sizeof(uint16_t));
    c->turned = zeros(shape->count, sizeof(uint16_t));
    pack16(c);
    c->columns = zeros(widest * BLOCK, sizeof(uint16_t));
    c->pairs = zeros(widest * BLOCK, sizeof(uint16_t));
    c->grad = zeros(widest * BLOCK, sizeof(uint16_t));
    c->sums = zeros(widest * BLOCK, sizeof(float));
    c->out = zeros(rows * (size_t)shape->out[shape->layers - 1], sizeof(float));
    c->in_grad = zeros(rows * (size_t)shape->in[0], sizeof(float));
    c->weight_grad = zeros(shape->count, sizeof(float));
    if (all) return c;
    destroy16(c);
    return NULL;
}

static uint16_t *rows_of(struct chain16 *c, int l, size_t row) {
    return c->activation[l] + row * (size_t)round32(c->problem.shape.in[l]);
}

static void forward16(void *work) {
    struct chain16 *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    int inputs = shape->in[0], last = shape->layers - 1;
    for (size_t row = 0; row < (size_t)c->problem.rows; row += BLOCK) {
        rows_from(c->problem.in + row * (size_t)inputs, inputs, BLOCK, inputs, rows_of(c, 0, row),
                  round32(inputs));
        for (int l = 0; l <= last; l++) {
            float *to = l < last ? c->sums : c->out + row * (size_t)shape->out[l];
            c->forward[l](c->weights + shape->offset[l], rows_of(c, l, row), to);
            if (l < last) round_rows(to, shape->out[l], NULL, rows_of(c, l + 1, row));
        }
    }
}

static void backward16(void *work) {
    struct chain16 *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    int last = shape->layers - 1, outputs = shape->out[last];
    for (size_t row = 0; row < (size_t)c->problem.rows; row += BLOCK) {
        rows_from(c->problem.out_grad + row * (size_t)outputs, outputs, BLOCK, outputs, c->grad,
                  round32(outputs));
        for (int l = last; l >= 0; l--) {
            int in = shape->in[l], out = shape->out[l];
            float *to = l > 0 ? c->sums : c->in_grad + row * (size_t)in;
            columns_of_rows(rows_of(c, l, row), round32(in), BLOCK, round32(in), c->columns, BLOCK);
            pair_rows(c->grad, round32(out), BLOCK, out, c->pairs);
            c->gradient[l](c->pairs, c->columns, c->weight_grad + shape->offset[l]);
            c->data[l](c->turned + shape->offset[l], c->grad, to);
            if (l > 0) round_rows(to, in, rows_of(c, l, row), c->grad);
        }
    }
}

static void look16(void *work, struct outcome *ret) {
    struct chain16 *c = work;
    *ret = (struct outcome){.out = c->out, .in_grad = c->in_grad, .weight_grad = c->weight_grad};
}

#endif

const struct candidate libxsmm_candidates[] = {{.name = "libxsmm fp32",
                                                .create = create,
                                                .forward = forward,
                                                .backward = backward,
                                                .look = look,
                                                .destroy = destroy},
#ifdef __AVX512BF16__
                                               {.name = "libxsmm bf16",
                                                .bf16 = true,
                                                .create = create16,
                                                .forward = forward16,
                                                .backward = backward16,
                                                .look = look16,
                                                .destroy = destroy16},
#endif
                                               {0}};
