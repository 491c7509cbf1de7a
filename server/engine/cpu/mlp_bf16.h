// The tiny networks with bf16 products and fp32 sums, forward and backward in blocks of rows whose
// activations and gradients stay in the L1 cache.
//
// Inputs (features when they are fetched), activations, weights and gradients are rounded to bf16
// (to nearest, ties to even: relative error 2^-8 each), everything else is fp32. A product's error
// is at most 2^-7 + 2^-16 + (K + 2) 2^-24, relative to the sum of its terms' magnitudes.
#ifndef RN_ENGINE_CPU_MLP_BF16_H
#define RN_ENGINE_CPU_MLP_BF16_H

#include "server/engine/cpu/gemm_bf16.h"
#include "server/engine/cpu/network.h"

#define RN_MLP_WIDEST 256    // inputs and outputs of a layer
#define RN_FORWARD_ROWS 64   // of a block; more than 32, a multiple of that
#define RN_BACKWARD_ROWS 128 // of a block, a quarter for networks that then stay in L1

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

// Inputs of layer l as rows: of those that are kept so, the first layer's only with net->ready.
RN_INLINE uint16_t *inputs_at(const struct mlp *net, int l, int row) {
    uint16_t *first = l == 0 ? (uint16_t *)net->in : (uint16_t *)net->hidden[l - 1];
    return first + (size_t)round32(net->shape->in[l]) * (size_t)row;
}

// ---- blocks ---------------------------------------------------------------------------------

// What follows a product of 32 rows: its 16 or 32 sums a row become activations (ReLU) or their
// gradient (where the activation is positive), in bf16.
struct finish {
    const float *sums;
    bool wide;
    const uint16_t *active; // of a gradient: the activations, rows
    uint16_t *to;           // rows; NULL: nothing to do
    int stride;             // of `active` and `to`
    uint16_t *pairs;        // of a gradient: the same, pairs along the rows
};

RN_INLINE __m512i take_sums(const float *sums, const bool WIDE) {
    return bf16_of(_mm512_load_ps(sums), WIDE ? _mm512_load_ps(sums + 16) : _mm512_setzero_ps());
}

RN_INLINE __m512i take_grad(const float *sums, const uint16_t *active, const bool WIDE) {
    __m512i is = _mm512_loadu_si512(active);
    return _mm512_maskz_mov_epi16(_mm512_cmpgt_epi16_mask(is, _mm512_setzero_si512()),
                                  take_sums(sums, WIDE));
}

RN_INLINE void finish_activation(struct finish f, const bool WIDE) {
#pragma GCC unroll 4
    for (int i = 0; i < RN_TILES_M; i++, f.sums += 32, f.to += f.stride)
        _mm512_storeu_si512(f.to,
                            _mm512_max_epi16(take_sums(f.sums, WIDE), _mm512_setzero_si512()));
}

RN_INLINE void finish_grad(struct finish f, const bool WIDE) {
#pragma GCC unroll 4
    for (int i = 0; i < RN_TILES_M; i += 2, f.sums += 64, f.pairs += 32) {
        __m512i even = take_grad(f.sums, f.active, WIDE);
        __m512i odd = take_grad(f.sums + 32, f.active + f.stride, WIDE);
        _mm512_storeu_si512(f.to, even);
        _mm512_storeu_si512(f.to + f.stride, odd);
        store_pairs(even, odd, WIDE, f.pairs);
        f.to += 2 * f.stride;
        f.active += 2 * f.stride;
    }
}

static void finish(struct finish *next) {
    const struct finish f = *next;
    next->to = NULL;
    if (!f.to) return;
    if (f.active && f.wide)
        finish_grad(f, true);
    else if (f.active)
        finish_grad(f, false);
    else if (f.wide)
        finish_activation(f, true);
    else
        finish_activation(f, false);
}

// Rows on their way through the layers. A product's sums are finished after the next product is
// begun, which has stored them.
struct block {
    const struct mlp *net;
    int row, rows, padded; // first row, their number, and that rounded up to 32
    struct products products;
    struct finish next;
    int turn; // of `sums`
    _Alignas(64) float sums[PRODUCT_SUMS][RN_TILES_M * 32];
    uint16_t *first, *second;  // gradients or activations of two layers in turn, rows
    uint16_t *columns, *pairs; // backward: a layer's inputs, and their outputs' gradient
};

static void block_init(const struct mlp *net, int rows, struct block *b) {
    size_t count = (size_t)rows * round32(net->shape->widest);
    b->net = net;
    b->next.to = NULL;
    b->turn = 0;
    b->first = net->scratch;
    b->second = b->first + count;
    b->columns = b->second + count;
    b->pairs = b->columns + count;
    products_begin(&b->products);
}

RN_INLINE void block_rows(struct block *b, int row, int rows) {
    b->row = row;
    b->rows = rows;
    b->padded = round32(rows);
}

static void block_product(struct block *b, const struct bf16_product *p) {
    product(&b->products, p);
    finish(&b->next);
}

static void block_flush(struct block *b) {
    products_flush(&b->products);
    finish(&b->next);
}

RN_INLINE float *next_sums(struct block *b) {
    b->turn = (b->turn + 1) % PRODUCT_SUMS;
    return b->sums[b->turn];
}

// The network's fp32 inputs as rows.
static void take_inputs(const struct block *b, uint16_t *to) {
    const struct mlp *net = b->net;
    int in = net->shape->in[0];
    rows_from((const float *)net->in + (size_t)b->row * net->in_stride, net->in_stride, b->rows, in,
              to, round32(in));
}

// ---- forward --------------------------------------------------------------------------------

// Rows [row, row + 32) of the block through layer l.
static void forward_layer(struct block *b, int l, int row, const uint16_t *weights,
                          const uint16_t *from, uint16_t *to) {
    const struct rn_mlp_shape *shape = b->net->shape;
    int in = round32(shape->in[l]), out = shape->out[l], left = b->rows - row;
    bool last = l + 1 == shape->layers, direct = last && left >= RN_TILES_M;
    for (int n = 0; n < out; n += 32) {
        float *sums = next_sums(b), *result = b->net->out + (size_t)(b->row + row) * out + n;
        struct bf16_product p = {.a = from + (size_t)row * in,
                                 .a_stride = in,
                                 .b = weights + (size_t)n * in,
                                 .b_k = RN_TILE,
                                 .b_n = in * 16,
                                 .k = round16(shape->in[l]),
                                 .rows = RN_TILES_M,
                                 .c = direct ? result : sums,
                                 .c_stride = direct ? out : 32,
                                 .wide = n + 16 < out};
        block_product(b, &p);
        if (!last)
            b->next = (struct finish){.sums = sums,
                                      .wide = p.wide,
                                      .to = to + (size_t)row * round32(out) + n,
                                      .stride = round32(out)};
        if (!last || direct) continue;
        block_flush(b);
        for (int i = 0; i < left; i++)
            memcpy(result + (size_t)i * out, sums + i * 32, p.wide ? 128 : 64);
    }
}

// A block of rows through all layers. One that is not whole passes through memory of its own, so
// that nothing behind it is written.
static void forward_rows(struct block *b) {
    const struct rn_mlp_shape *shape = b->net->shape;
    const uint16_t *weights = (const uint16_t *)b->net->packed;
    const uint16_t *from = b->net->ready ? inputs_at(b->net, 0, b->row) : b->first;
    if (!b->net->ready) take_inputs(b, b->first);
    for (int l = 0; l < shape->layers; l++) {
        bool last = l + 1 == shape->layers, whole = b->rows == b->padded;
        uint16_t *hidden = last ? NULL : inputs_at(b->net, l + 1, b->row);
        uint16_t *to = last || whole ? hidden : l % 2 ? b->first : b->second;
        for (int row = 0; row < b->rows; row += RN_TILES_M)
            forward_layer(b, l, row, weights, from, to);
        // Else the next layer's first product, of other rows than the last, is in time.
        if (!whole || b->rows == RN_TILES_M) block_flush(b);
        if (to != hidden) memcpy(hidden, to, (size_t)b->rows * round32(shape->out[l]) * sizeof *to);
        weights += forward_count(shape, l);
        from = to;
    }
}

// Rows [begin, begin + n) through the network.
static void mlp_forward(const struct mlp *net, int begin, int n) {
    struct block b;
    if (n <= 0) return;
    block_init(net, RN_FORWARD_ROWS, &b);
    for (int row = 0; row < n; row += RN_FORWARD_ROWS) {
        block_rows(&b, begin + row, n - row < RN_FORWARD_ROWS ? n - row : RN_FORWARD_ROWS);
        forward_rows(&b);
    }
    products_end(&b.products);
}

// ---- backward -------------------------------------------------------------------------------

// A layer's inputs as columns, zero behind the rows; `spare` is overwritten.
static void take_columns(struct block *b, int l, uint16_t *spare) {
    int in = round32(b->net->shape->in[l]);
    const uint16_t *from = spare;
    if (l == 0 && !b->net->ready) {
        take_inputs(b, spare);
    } else if (b->rows == b->padded) {
        from = inputs_at(b->net, l, b->row);
    } else {
        memcpy(spare, inputs_at(b->net, l, b->row), (size_t)b->rows * in * sizeof *spare);
        memset(spare + (size_t)b->rows * in, 0, (size_t)(b->padded - b->rows) * in * sizeof *spare);
    }
    columns_of_rows(from, in, b->padded, in, b->columns, b->padded);
}

// Adds inputs^T * gradient to the layer's sums, [round32(in)][round32(out)].
static void add_weight_grad(struct block *b, int l, float *sums) {
    int in = round16(b->net->shape->in[l]), out = b->net->shape->out[l];
    for (int i = 0; i < in; i += RN_TILES_M)
        for (int o = 0; o < out; o += 32) {
            struct bf16_product p = {.a = b->columns + i * b->padded,
                                     .a_stride = b->padded,
                                     .b = b->pairs + o / 16 * RN_TILE,
                                     .b_k = out / 16 * RN_TILE,
                                     .b_n = RN_TILE,
                                     .k = b->padded,
                                     .rows = in - i < RN_TILES_M ? in - i : RN_TILES_M,
                                     .c = sums + (size_t)i * round32(out) + o,
                                     .c_stride = round32(out),
                                     .accumulate = true,
                                     .wide = o + 16 < out};
            block_product(b, &p);
        }
}

// gradient * weights^T: the gradient of a layer's inputs, to rows and pairs or, of the first layer,
// to `ret_grad` ([row][inputs rounded up to 16]).
static void take_in_grad(struct block *b, int l, const uint16_t *weights, const uint16_t *grad,
                         uint16_t *to, float *ret_grad) {
    int in = round16(b->net->shape->in[l]), out = round32(b->net->shape->out[l]);
    for (int row = 0; row < b->padded; row += RN_TILES_M)
        for (int i = 0; i < in; i += 32) {
            float *sums = next_sums(b), *result = ret_grad + (size_t)(b->row + row) * in + i;
            struct bf16_product p = {.a = grad + (size_t)row * out,
                                     .a_stride = out,
                                     .b = weights + (size_t)i * out,
                                     .b_k = RN_TILE,
                                     .b_n = out * 16,
                                     .k = b->net->shape->out[l],
                                     .rows = RN_TILES_M,
                                     .c = l == 0 ? result : sums,
                                     .c_stride = l == 0 ? in : 32,
                                     .wide = i + 16 < in};
            block_product(b, &p);
            if (l == 0) continue;
            b->next = (struct finish){.sums = sums,
                                      .wide = p.wide,
                                      .active = inputs_at(b->net, l, b->row + row) + i,
                                      .to = to + (size_t)row * round32(in) + i,
                                      .stride = round32(in),
                                      .pairs = b->pairs + (size_t)row * in + i * 32};
        }
    if (l > 0) block_flush(b);
}

// The outputs' gradient as rows and pairs.
static void take_out_grad(struct block *b, const float *out_grad, int outputs, uint16_t *to) {
    int stride = round32(outputs);
    rows_from(out_grad + (size_t)b->row * outputs, outputs, b->rows, outputs, to, stride);
    for (int row = 0; row < b->padded; row += 2)
        for (int i = 0; i < outputs; i += 32) {
            const uint16_t *from = to + row * stride + i;
            uint16_t *line = b->pairs + (row / 32 * (outputs / 16) + i / 16) * RN_TILE;
            store_pairs(_mm512_loadu_si512(from), _mm512_loadu_si512(from + stride),
                        i + 16 < outputs, line + row % 32 * 16);
        }
}

static void backward_rows(struct block *b, const float *out_grad, float *sums_end,
                          float *ret_grad) {
    const struct rn_mlp_shape *shape = b->net->shape;
    const uint16_t *weights = (const uint16_t *)b->net->packed;
    uint16_t *grad = b->first, *to = b->second;
    int last = shape->layers - 1;
    for (int l = 0; l <= last; l++)
        weights += forward_count(shape, l) + backward_count(shape, l);
    take_out_grad(b, out_grad, shape->out[last], grad);
    for (int l = last; l >= 0; l--) {
        weights -= backward_count(shape, l);
        sums_end -= (size_t)round32(shape->in[l]) * round32(shape->out[l]);
        take_columns(b, l, to);
        add_weight_grad(b, l, sums_end);
        take_in_grad(b, l, weights, grad, to, ret_grad);
        uint16_t *swap = grad;
        grad = to;
        to = swap;
    }
}

// Adds a packet's sums to the weights' gradients.
static void add_sums(const struct rn_mlp_shape *shape, const float *sums, float *weight_grad) {
    for (int l = 0; l < shape->layers; l++) {
        float *to = weight_grad + shape->offset[l];
        int out = shape->out[l];
        for (int i = 0; i < shape->in[l]; i++, to += out)
            for (int o = 0; o < out; o += 16)
                _mm512_storeu_ps(
                    to + o, _mm512_add_ps(_mm512_loadu_ps(to + o),
                                          _mm512_loadu_ps(sums + (size_t)i * round32(out) + o)));
        sums += (size_t)round32(shape->in[l]) * round32(out);
    }
}

// Backward of rows [0, n) with the outputs' gradient `out_grad`. The weights' gradients are added
// to weight_grad; returns the inputs' ([n][inputs rounded up to 16]), in the workspace.
static float *mlp_backward(const struct mlp *net, const float *out_grad, int n,
                           struct rn_workspace *w, float *weight_grad) {
    size_t count = rn_mlp_packed_count(net->shape);
    int rows = net->shape->widest <= 32 ? RN_BACKWARD_ROWS / 4 : RN_BACKWARD_ROWS;
    struct block b;
    if (n <= 0) return w->grad_a;
    memset(w->weight_sums, 0, count * sizeof *w->weight_sums);
    block_init(net, rows, &b);
    for (int row = 0; row < n; row += rows) {
        block_rows(&b, row, n - row < rows ? n - row : rows);
        backward_rows(&b, out_grad, w->weight_sums + count, w->grad_a);
    }
    products_end(&b.products);
    add_sums(net->shape, w->weight_sums, weight_grad);
    return w->grad_a;
}

// One product as the networks make them, for tests.
static void gemm_public(int rows, int k, int n, const float *a, int a_stride, const float *b,
                        int b_stride, float *c, int c_stride) {
    _Alignas(64) uint16_t left[RN_TILES_M * RN_TILE_K], right[2 * RN_TILE];
    _Alignas(64) float sums[RN_TILES_M * 32], lines[RN_TILE_K * 16];
    struct products products;
    products_begin(&products);
    for (int row = 0; row < rows; row += RN_TILES_M)
        for (int column = 0; column < n; column += 16) {
            int here = rows - row < RN_TILES_M ? rows - row : RN_TILES_M;
            struct bf16_product p = {.a = left,
                                     .a_stride = 32,
                                     .b = right,
                                     .k = RN_TILE_K,
                                     .rows = RN_TILES_M,
                                     .c = sums,
                                     .c_stride = 32};
            for (int from = 0; from < k; from += RN_TILE_K, p.accumulate = true) {
                int part = k - from < RN_TILE_K ? k - from : RN_TILE_K;
                rows_from(a + (size_t)row * a_stride + from, a_stride, here, part, left, 32);
                for (int i = 0; i < part; i++)
                    memcpy(lines + i * 16, b + (size_t)(from + i) * b_stride + column, 64);
                pairs_from(lines, part, 16, right);
                product(&products, &p);
                products_flush(&products);
            }
            for (int i = 0; i < here; i++)
                memcpy(c + (size_t)(row + i) * c_stride + column, sums + i * 32, 64);
        }
    products_end(&products);
}

#endif
