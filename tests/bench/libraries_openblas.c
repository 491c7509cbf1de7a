// The networks with OpenBLAS: a product a layer over all rows.
#include <cblas.h>
#include <stdlib.h>
#include <string.h>

#include "tests/bench/libraries.h"

struct chain {
    struct problem problem;
    float *activation[RN_MLP_MAX_LAYERS + 1]; // [0] borrowed
    float *grad[2], *weight_grad;
};

const char *openblas_version(void) {
    return openblas_get_config();
}

static void *create(const struct candidate *candidate, const struct problem *problem) {
    struct chain *c = zeros(1, sizeof *c);
    const struct rn_mlp_shape *shape = &problem->shape;
    size_t rows = (size_t)problem->rows;
    openblas_set_num_threads(1);
    c->problem = *problem;
    c->activation[0] = (float *)problem->in;
    for (int l = 0; l < shape->layers; l++)
        c->activation[l + 1] = zeros(rows * (size_t)shape->out[l], sizeof(float));
    for (int i = 0; i < 2; i++)
        c->grad[i] = zeros(rows * (size_t)shape->widest, sizeof(float));
    c->weight_grad = zeros(shape->count, sizeof(float));
    return c;
}

static void forward(void *work) {
    struct chain *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    int rows = c->problem.rows;
    for (int l = 0; l < shape->layers; l++) {
        int in = shape->in[l], out = shape->out[l];
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, rows, out, in, 1, c->activation[l],
                    in, c->problem.weights + shape->offset[l], out, 0, c->activation[l + 1], out);
        if (l + 1 < shape->layers) relu((size_t)rows * (size_t)out, c->activation[l + 1]);
    }
}

static void backward(void *work) {
    struct chain *c = work;
    const struct rn_mlp_shape *shape = &c->problem.shape;
    const float *grad = c->problem.out_grad;
    int rows = c->problem.rows;
    for (int l = shape->layers - 1; l >= 0; l--) {
        int in = shape->in[l], out = shape->out[l];
        float *to = c->grad[l & 1];
        cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, in, out, rows, 1, c->activation[l], in,
                    grad, out, 1, c->weight_grad + shape->offset[l], out);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, rows, in, out, 1, grad, out,
                    c->problem.weights + shape->offset[l], out, 0, to, in);
        if (l > 0) mask((size_t)rows * (size_t)in, c->activation[l], to);
        grad = to;
    }
}

static void look(void *work, struct outcome *ret) {
    struct chain *c = work;
    *ret = (struct outcome){.out = c->activation[c->problem.shape.layers],
                            .in_grad = c->grad[0],
                            .weight_grad = c->weight_grad};
}

static void destroy(void *work) {
    struct chain *c = work;
    for (int l = 0; l < c->problem.shape.layers; l++)
        free(c->activation[l + 1]);
    free(c->grad[0]);
    free(c->grad[1]);
    free(c->weight_grad);
    free(c);
}

const struct candidate openblas_candidates[] = {{.name = "OpenBLAS sgemm",
                                                 .create = create,
                                                 .forward = forward,
                                                 .backward = backward,
                                                 .look = look,
                                                 .destroy = destroy},
                                                {0}};
