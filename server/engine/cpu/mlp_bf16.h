// The tiny networks with bf16 products and fp32 sums, forward and backward in blocks of rows whose
// activations and gradients stay in the L1 cache.
//
// Inputs, activations, weights and gradients are rounded to bf16 when they enter a product (to
// nearest, ties to even: relative error 2^-9 each), everything else is fp32. A product's error is
// at most 2^-8 + 2^-18 + K 2^-24, relative to the sum of its terms' magnitudes.
#ifndef RN_ENGINE_CPU_MLP_BF16_H
#define RN_ENGINE_CPU_MLP_BF16_H

#include "server/engine/cpu/gemm_bf16.h"
#include "server/engine/cpu/network.h"

#define RN_MLP_WIDEST 256 // inputs and outputs of a layer
#define RN_MLP_BLOCK 64   // rows of a backward's block, a multiple of 32

// Numbers of a row of hidden activations: bf16, rounded up to 32.
RN_INLINE size_t hidden_stride(int width) {
    return (size_t)round32(width) / 2;
}

// Numbers of a layer's weights as the forward and as the backward reads them.
RN_INLINE size_t forward_count(const struct rn_mlp_shape *shape, int l) {
    return (size_t)round32(shape->in[l]) * (size_t)shape->out[l];
}
RN_INLINE size_t backward_count(const struct rn_mlp_shape *shape, int l) {
    return (size_t)round32(shape->out[l]) * (size_t)round16(shape->in[l]);
}

// The forward's weights of all layers as pairs [out / 16][in / 32], then the backward's
// [in / 16][out / 32].
static void mlp_pack(const struct rn_mlp_shape *shape, const float *weights, float *packed) {
    uint16_t *to = (uint16_t *)packed;
    _Alignas(64) float turned[RN_MLP_WIDEST * 16];
    for (int l = 0; l < shape->layers; l++) {
        pairs_from(weights + shape->offset[l], shape->in[l], shape->out[l], to);
        to += forward_count(shape, l);
    }
    for (int l = 0; l < shape->layers; l++) {
        const float *from = weights + shape->offset[l];
        int in = shape->in[l], out = shape->out[l];
        for (int first = 0; first < in; first += 16, to += (size_t)round32(out) * 16) {
            for (int o = 0; o < out; o++)
                for (int i = 0; i < 16; i++)
                    turned[o * 16 + i] = first + i < in ? from[(size_t)(first + i) * out + o] : 0;
            pairs_from(turned, out, 16, to);
        }
    }
}

// Activations of layer l, from 1 on, as rows.
RN_INLINE uint16_t *activation(const struct mlp *net, int l, int row) {
    return (uint16_t *)(net->hidden[l - 1] + hidden_stride(net->shape->in[l]) * (size_t)row);
}

// ---- forward --------------------------------------------------------------------------------

// ReLU and rounding of 32 rows of 16 or 32 sums.
RN_INLINE void store_activation(const float *sums, bool wide, uint16_t *to, int stride) {
    const __m512 none = _mm512_setzero_ps();
    for (int i = 0; i < RN_TILES_M; i++, sums += 32, to += stride) {
        __m512i x = bf16_of(_mm512_load_ps(sums), wide ? _mm512_load_ps(sums + 16) : none);
        _mm512_storeu_si512(to, _mm512_max_epi16(x, _mm512_setzero_si512()));
    }
}

// Up to 32 rows through all layers. Fewer pass through memory of their own, so that nothing behind
// them is written.
static void forward_block(const struct mlp *net, int row, int rows) {
    _Alignas(64) uint16_t spare[2][RN_TILES_M * RN_MLP_WIDEST];
    _Alignas(64) float sums[RN_TILES_M * 32];
    const struct rn_mlp_shape *shape = net->shape;
    const uint16_t *weights = (const uint16_t *)net->packed, *a = spare[0];
    rows_from(net->in + (size_t)row * net->in_stride, net->in_stride, rows, shape->in[0], spare[0],
              round32(shape->in[0]));
    for (int l = 0; l < shape->layers; l++) {
        int in = round32(shape->in[l]), out = shape->out[l];
        bool last = l + 1 == shape->layers, whole = rows == RN_TILES_M;
        uint16_t *to = last ? NULL : whole ? activation(net, l + 1, row) : spare[(l + 1) % 2];
        for (int n = 0; n < out; n += 32) {
            bool wide = n + 16 < out, direct = last && whole;
            float *result = net->out + (size_t)row * out + n;
            struct bf16_product p = {.a = a,
                                     .a_stride = in,
                                     .b = weights + (size_t)n * in,
                                     .b_k = RN_TILE,
                                     .b_n = in * 16,
                                     .k = in / RN_TILE_K,
                                     .c = direct ? result : sums,
                                     .c_stride = direct ? out : 32,
                                     .wide = wide};
            product(&p);
            if (!last) store_activation(sums, wide, to + n, round32(out));
            for (int i = 0; last && !whole && i < rows; i++)
                memcpy(result + (size_t)i * out, sums + i * 32, wide ? 128 : 64);
        }
        if (!last && !whole)
            memcpy(activation(net, l + 1, row), to, (size_t)rows * round32(out) * sizeof *to);
        weights += forward_count(shape, l);
        a = to;
    }
}

// Rows [begin, begin + n) through the network.
static void mlp_forward(const struct mlp *net, int begin, int n) {
    if (n <= 0) return;
    products_begin();
    for (int row = 0; row < n; row += RN_TILES_M)
        forward_block(net, begin + row, n - row < RN_TILES_M ? n - row : RN_TILES_M);
    products_end();
}

// ---- backward -------------------------------------------------------------------------------

// One block of the backward: 32 or 64 rows, the last of them perhaps zero.
struct backward_block {
    const struct mlp *net;
    int row, rows, padded;
    _Alignas(64) uint16_t in[RN_MLP_BLOCK * RN_MLP_WIDEST];      // a layer's inputs, rows
    _Alignas(64) uint16_t columns[RN_MLP_BLOCK * RN_MLP_WIDEST]; // the same, columns
    _Alignas(64) uint16_t grad[2][RN_MLP_BLOCK * RN_MLP_WIDEST]; // gradient, rows
    _Alignas(64) uint16_t pairs[RN_MLP_BLOCK * RN_MLP_WIDEST];   // the same, pairs along the rows
    _Alignas(64) float sums[RN_TILES_M * 32];
};

// A layer's inputs as columns, zero behind the rows.
static void take_columns(struct backward_block *b, int l) {
    const struct mlp *net = b->net;
    int in = round32(net->shape->in[l]);
    const uint16_t *from = b->in;
    if (l == 0) {
        rows_from(net->in + (size_t)b->row * net->in_stride, net->in_stride, b->rows,
                  net->shape->in[0], b->in, in);
    } else if (b->rows == b->padded) {
        from = activation(net, l, b->row);
    } else {
        memcpy(b->in, activation(net, l, b->row), (size_t)b->rows * in * sizeof *b->in);
        memset(b->in + (size_t)b->rows * in, 0, (size_t)(b->padded - b->rows) * in * 2);
    }
    columns_of_rows(from, in, b->padded, in, b->columns, RN_MLP_BLOCK);
}

// Adds inputs^T * gradient to the layer's sums, [round32(in)][round32(out)].
static void add_weight_grad(struct backward_block *b, int l, float *sums) {
    int in = round32(b->net->shape->in[l]), out = b->net->shape->out[l];
    for (int i = 0; i < in; i += 32)
        for (int o = 0; o < out; o += 32) {
            struct bf16_product p = {.a = b->columns + i * RN_MLP_BLOCK,
                                     .a_stride = RN_MLP_BLOCK,
                                     .b = b->pairs + o / 16 * RN_TILE,
                                     .b_k = out / 16 * RN_TILE,
                                     .b_n = RN_TILE,
                                     .k = b->padded / RN_TILE_K,
                                     .c = sums + (size_t)i * round32(out) + o,
                                     .c_stride = round32(out),
                                     .accumulate = true,
                                     .wide = o + 16 < out};
            product(&p);
        }
}

// The gradient of 32 rows of 16 or 32 activations: kept where the activation is positive.
RN_INLINE void store_grad(const float *sums, bool wide, const uint16_t *active, uint16_t *to,
                          int stride) {
    const __m512 none = _mm512_setzero_ps();
    for (int i = 0; i < RN_TILES_M; i++, sums += 32, active += stride, to += stride) {
        __m512i x = bf16_of(_mm512_load_ps(sums), wide ? _mm512_load_ps(sums + 16) : none);
        __mmask32 on = _mm512_cmpgt_epi16_mask(_mm512_loadu_si512(active), _mm512_setzero_si512());
        _mm512_storeu_si512(to, _mm512_maskz_mov_epi16(on, x));
    }
}

// gradient * weights^T: the gradient of a layer's inputs, to rows or, from the first layer, to
// `ret_grad` ([row][inputs rounded up to 16]).
static void in_gradient(struct backward_block *b, int l, const uint16_t *weights,
                        const uint16_t *grad, uint16_t *to, float *ret_grad) {
    int in = round16(b->net->shape->in[l]), out = round32(b->net->shape->out[l]);
    for (int row = 0; row < b->padded; row += RN_TILES_M)
        for (int i = 0; i < in; i += 32) {
            float *result = ret_grad + (size_t)(b->row + row) * in + i;
            struct bf16_product p = {.a = grad + (size_t)row * out,
                                     .a_stride = out,
                                     .b = weights + (size_t)i * out,
                                     .b_k = RN_TILE,
                                     .b_n = out * 16,
                                     .k = out / RN_TILE_K,
                                     .c = l == 0 ? result : b->sums,
                                     .c_stride = l == 0 ? in : 32,
                                     .wide = i + 16 < in};
            product(&p);
            int stride = round32(in);
            if (l > 0)
                store_grad(b->sums, p.wide, activation(b->net, l, b->row + row) + i,
                           to + (size_t)row * stride + i, stride);
        }
}

static void backward_rows(struct backward_block *b, const float *out_grad, float *sums_end,
                          float *ret_grad) {
    const struct rn_mlp_shape *shape = b->net->shape;
    int last = shape->layers - 1, outputs = shape->out[last];
    const uint16_t *weights = (const uint16_t *)b->net->packed;
    for (int l = 0; l <= last; l++)
        weights += forward_count(shape, l) + backward_count(shape, l);
    rows_from(out_grad + (size_t)b->row * outputs, outputs, b->rows, outputs, b->grad[last % 2],
              round32(outputs));
    for (int l = last; l >= 0; l--) {
        const uint16_t *grad = b->grad[l % 2];
        weights -= backward_count(shape, l);
        sums_end -= (size_t)round32(shape->in[l]) * round32(shape->out[l]);
        take_columns(b, l);
        pairs_of_rows(grad, round32(shape->out[l]), b->padded, shape->out[l], b->pairs);
        add_weight_grad(b, l, sums_end);
        in_gradient(b, l, weights, grad, b->grad[(l + 1) % 2], ret_grad);
    }
}

// Backward of rows [0, n) with the outputs' gradient `out_grad`. The weights' gradients are added
// to weight_grad; returns the inputs' ([n][inputs rounded up to 16]), in the workspace.
static float *mlp_backward(const struct mlp *net, const float *out_grad, int n,
                           struct rn_workspace *w, float *weight_grad) {
    const struct rn_mlp_shape *shape = net->shape;
    struct backward_block b;
    size_t count = rn_mlp_packed_count(shape);
    if (n <= 0) return w->grad_a;
    b.net = net;
    memset(w->weight_sums, 0, count * sizeof *w->weight_sums);
    products_begin();
    for (b.row = 0; b.row < n; b.row += RN_MLP_BLOCK) {
        b.rows = n - b.row < RN_MLP_BLOCK ? n - b.row : RN_MLP_BLOCK;
        b.padded = round32(b.rows);
        backward_rows(&b, out_grad, w->weight_sums + count, w->grad_a);
    }
    products_end();
    const float *sums = w->weight_sums;
    for (int l = 0; l < shape->layers; l++) {
        float *to = weight_grad + shape->offset[l];
        for (int i = 0; i < shape->in[l]; i++, to += shape->out[l])
            for (int o = 0; o < shape->out[l]; o++)
                to[o] += sums[(size_t)i * round32(shape->out[l]) + o];
        sums += (size_t)round32(shape->in[l]) * round32(shape->out[l]);
    }
    return w->grad_a;
}

// One product as the networks make them, for tests.
static void gemm_public(int rows, int k, int n, const float *a, int a_stride, const float *b,
                        int b_stride, float *c, int c_stride) {
    _Alignas(64) uint16_t left[RN_TILES_M * RN_TILE_K], right[2 * RN_TILE];
    _Alignas(64) float sums[RN_TILES_M * 32], lines[RN_TILE_K * 16];
    products_begin();
    for (int row = 0; row < rows; row += RN_TILES_M)
        for (int column = 0; column < n; column += 16) {
            int here = rows - row < RN_TILES_M ? rows - row : RN_TILES_M;
            struct bf16_product p = {
                .a = left, .a_stride = 32, .b = right, .k = 1, .c = sums, .c_stride = 32};
            for (int from = 0; from < k; from += RN_TILE_K, p.accumulate = true) {
                int part = k - from < RN_TILE_K ? k - from : RN_TILE_K;
                rows_from(a + (size_t)row * a_stride + from, a_stride, here, part, left, 32);
                for (int i = 0; i < part; i++)
                    memcpy(lines + i * 16, b + (size_t)(from + i) * b_stride + column, 64);
                pairs_from(lines, part, 16, right);
                product(&p);
            }
            for (int i = 0; i < here; i++)
                memcpy(c + (size_t)(row + i) * c_stride + column, sums + i * 32, 64);
        }
    products_end();
}

#endif
