// The tiny networks in fp32: forward layer by layer, backward in blocks of rows. A product's error
// is at most (K + 2) 2^-24, relative to the sum of its terms' magnitudes (the condition number of
// the sum, times its result).
#ifndef RN_ENGINE_CPU_MLP_FP32_H
#define RN_ENGINE_CPU_MLP_FP32_H

#include "server/engine/cpu/gemm.h"
#include "server/engine/cpu/network.h"

// Numbers of a row of hidden activations.
RN_INLINE size_t hidden_stride(int width) {
    return (size_t)width;
}

// Transposed weights for the backward: layer after layer [out][in rounded up to 16].
static void mlp_pack(const struct rn_mlp_shape *shape, const float *weights, float *packed) {
    for (int l = 0; l < shape->layers; l++) {
        int padded = round16(shape->in[l]);
        const float *from = weights + shape->offset[l];
        for (int o = 0; o < shape->out[l]; o++, packed += padded)
            for (int i = 0; i < padded; i++)
                packed[i] = i < shape->in[l] ? from[(size_t)i * shape->out[l] + o] : 0;
    }
}

#define RN_BLOCK_ROWS 48 // that go through all layers before the next ones: they stay in the caches

// Rows [begin, begin + n) through the network.
static void forward_rows(const struct mlp *net, int begin, int n) {
    const struct rn_mlp_shape *shape = net->shape;
    for (int l = 0; l < shape->layers; l++) {
        bool last = l + 1 == shape->layers;
        int stride = l == 0 ? net->in_stride : shape->in[l], out_stride = shape->out[l];
        const float *a = l == 0 ? (const float *)net->in : net->hidden[l - 1];
        float *c = last ? net->out : net->hidden[l];
        struct rn_gemm g = {.a = a + (size_t)begin * stride,
                            .a_row = stride,
                            .a_k = 1,
                            .b = net->weights + shape->offset[l],
                            .b_stride = shape->out[l],
                            .c = c + (size_t)begin * out_stride,
                            .c_stride = out_stride,
                            .relu = !last};
        gemm(&g, n, shape->in[l], shape->out[l]);
    }
}

// The same, in blocks of rows.
static void mlp_forward(const struct mlp *net, int begin, int n) {
    for (int row = 0; row < n; row += RN_BLOCK_ROWS)
        forward_rows(net, begin + row, n - row < RN_BLOCK_ROWS ? n - row : RN_BLOCK_ROWS);
}

// Backward of rows [row, row + n), all layers; `t` is behind the last one's transposed weights.
static void backward_rows(const struct mlp *net, const float *t, const float *out_grad, int row,
                          int n, float *weight_grad, float *ret_grad) {
    const struct rn_mlp_shape *shape = net->shape;
    float *in_grad = net->scratch, *other = in_grad + (size_t)RN_BLOCK_ROWS * shape->widest;
    out_grad += (size_t)row * shape->out[shape->layers - 1];
    for (int l = shape->layers - 1; l >= 0; l--) {
        int stride = l == 0 ? net->in_stride : shape->in[l], padded = round16(shape->in[l]);
        const float *activation =
            (l == 0 ? (const float *)net->in : net->hidden[l - 1]) + (size_t)row * stride;
        struct rn_gemm dw = {.a = activation,
                             .a_row = 1,
                             .a_k = stride,
                             .b = out_grad,
                             .b_stride = shape->out[l],
                             .c = weight_grad + shape->offset[l],
                             .c_stride = shape->out[l],
                             .accumulate = true};
        gemm(&dw, shape->in[l], n, shape->out[l]);
        t -= (size_t)shape->out[l] * padded;
        if (l == 0) in_grad = ret_grad + (size_t)row * padded;
        struct rn_gemm dx = {.a = out_grad,
                             .a_row = shape->out[l],
                             .a_k = 1,
                             .b = t,
                             .b_stride = padded,
                             .c = in_grad,
                             .c_stride = padded,
                             .mask = l > 0 ? activation : NULL,
                             .mask_stride = stride};
        gemm(&dx, n, shape->out[l], padded);
        float *done = in_grad;
        in_grad = other;
        out_grad = other = done;
    }
}

// Backward of rows [0, n) with the outputs' gradient `out_grad`, in blocks of rows through all
// layers. The weights' gradients are added to weight_grad; returns the inputs' ([n][inputs rounded
// up to 16]), in the workspace.
static float *mlp_backward(const struct mlp *net, const float *out_grad, int n,
                           struct rn_workspace *w, float *weight_grad) {
    const float *t = net->packed;
    for (int l = 0; l < net->shape->layers; l++)
        t += (size_t)net->shape->out[l] * round16(net->shape->in[l]);
    for (int row = 0; row < n; row += RN_BLOCK_ROWS)
        backward_rows(net, t, out_grad, row, n - row < RN_BLOCK_ROWS ? n - row : RN_BLOCK_ROWS,
                      weight_grad, w->grad_a);
    return w->grad_a;
}

// One product as the networks make them, for tests.
static void gemm_public(int rows, int k, int n, const float *a, int a_stride, const float *b,
                        int b_stride, float *c, int c_stride) {
    struct rn_gemm g = {.a = a,
                        .a_row = a_stride,
                        .a_k = 1,
                        .b = b,
                        .b_stride = b_stride,
                        .c = c,
                        .c_stride = c_stride};
    gemm(&g, rows, k, n);
}

#endif
