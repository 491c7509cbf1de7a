// The tiny networks on tensor cores: a warp takes one tile of 16 rows, or T of them, through all
// layers, activations staying in registers as fragments; fp16 products, fp32 sums (field/mlp.h has
// the mathematics).
#ifndef RN_ENGINE_CUDA_NETWORK_CUH
#define RN_ENGINE_CUDA_NETWORK_CUH

#include "server/engine/cuda/scene.cuh"

#define RN_HALF_MAX 65504.0f

// One hidden layer: the results of two neighbouring 8-column products are the next layer's A
// fragment as they are.
enum rn_layer_mode {
    RN_LAYER_RELU,   // keep the positive ones, and remember them in `mask`
    RN_LAYER_MASKED, // backward: keep those in `mask`
    RN_LAYER_PLAIN,
};

// Of each of a warp's T tiles: out[16 rows][16 NT] = a[16][16 KT] times the fragments at w
// ([NT][KT][lane]), each of which is loaded once for all. Bit 8 (j % 4) + i of mask[j / 4] belongs
// to number i of fragment j. True when a number does not fit fp16.
template <int KT, int NT, rn_layer_mode MODE, int T>
RN_DEVICE bool rn_layer(const uint32_t (&a)[T][KT][4], const uint4 *w, uint32_t (&out)[T][NT][4],
                        uint32_t (&mask)[T][(NT + 3) / 4]) {
    bool bad = false;
    w += RN_LANE;
    RN_UNROLL
    for (int j = 0; j < NT; j++) {
        float c[T][2][4] = {{{0}}};
        RN_UNROLL
        for (int k = 0; k < KT; k++) {
            uint4 b = w[(j * KT + k) * RN_LANES];
            RN_UNROLL
            for (int t = 0; t < T; t++) {
                rn_mma(c[t][0], a[t][k], b.x, b.y);
                rn_mma(c[t][1], a[t][k], b.z, b.w);
            }
        }
        RN_UNROLL
        for (int t = 0; t < T; t++) {
            uint32_t bits = 0;
            RN_UNROLL
            for (int i = 0; i < 8; i++) {
                float &x = c[t][i / 4][i % 4];
                if (MODE == RN_LAYER_RELU) {
                    bits |= (uint32_t)(x > 0) << i;
                    x = x < 0 ? 0 : x;
                } else {
                    bool kept = mask[t][j / 4] >> (8 * (j % 4) + i) & 1;
                    if (MODE == RN_LAYER_MASKED && !kept) x = 0;
                    bad |= !(fabsf(x) <= RN_HALF_MAX);
                }
            }
            if (MODE == RN_LAYER_RELU)
                mask[t][j / 4] = (j % 4 == 0 ? 0 : mask[t][j / 4]) | bits << (8 * (j % 4));
            RN_UNROLL
            for (int i = 0; i < 4; i++)
                out[t][j][i] = rn_pack(c[t][i / 2][2 * (i % 2)], c[t][i / 2][2 * (i % 2) + 1]);
        }
    }
    return bad;
}

// The last layer: 16 outputs of each row as the two fragments of C.
template <int KT, int T>
RN_DEVICE void rn_last_layer(const uint32_t (&a)[T][KT][4], const uint4 *w, float (&c)[T][2][4]) {
    RN_UNROLL
    for (int i = 0; i < 8 * T; i++)
        c[i / 8][i / 4 % 2][i % 4] = 0;
    w += RN_LANE;
    RN_UNROLL
    for (int k = 0; k < KT; k++) {
        uint4 b = w[k * RN_LANES];
        RN_UNROLL
        for (int t = 0; t < T; t++) {
            rn_mma(c[t][0], a[t][k], b.x, b.y);
            rn_mma(c[t][1], a[t][k], b.z, b.w);
        }
    }
}

template <int NT, int T>
RN_DEVICE void rn_move(uint32_t (&to)[T][NT][4], const uint32_t (&from)[T][NT][4]) {
    RN_UNROLL
    for (int i = 0; i < 4 * NT * T; i++)
        to[i / (4 * NT)][i / 4 % NT][i % 4] = from[i / (4 * NT)][i / 4 % NT][i % 4];
}

// A fragment of A in memory by rows: [row][lane % 4], four numbers a lane, so that rows from
// anywhere can be put together.
#define RN_BLOCK (RN_TILE * 4)
RN_DEVICE void rn_store_rows(const uint32_t a[4], uint2 *to) {
    for (int i = 0; i < 2; i++)
        to[i * RN_LANES + RN_LANE] = uint2{a[i], a[2 + i]};
}
// Row g (i = 0) or g + 8 (i = 1) of a fragment from `row` of a block.
RN_DEVICE void rn_load_row(const uint2 *block, uint32_t row, int i, uint32_t (&a)[4]) {
    uint2 words = block[row * 4 + RN_LANE % 4];
    a[i] = words.x;
    a[2 + i] = words.y;
}

// Stores fragments transposed, [NT][lane], as the product A^T G wants both of its operands.
template <int NT> RN_DEVICE void rn_keep_transposed(const uint32_t (&a)[NT][4], uint4 *to) {
    RN_UNROLL
    for (int j = 0; j < NT; j++) {
        uint4 t;
        t.x = rn_transpose(a[j][0]);
        t.y = rn_transpose(a[j][1]);
        t.z = rn_transpose(a[j][2]);
        t.w = rn_transpose(a[j][3]);
        to[j * RN_LANES + RN_LANE] = t;
    }
}

// Forward of T tiles. `a`: inputs.
template <int KT, int WT, int T>
RN_DEVICE void rn_forward(const struct rn_cuda_network *n, const uint4 *weights,
                          const uint32_t (&a)[T][KT][4], float (&out)[T][2][4]) {
    uint32_t x[T][WT][4], y[T][WT][4], mask[T][(WT + 3) / 4];
    rn_layer<KT, WT, RN_LAYER_RELU>(a, weights, x, mask);
    for (int l = 1; l < n->hidden; l++) {
        rn_layer<WT, WT, RN_LAYER_RELU>(x, weights + n->packed[l], y, mask);
        rn_move<WT>(x, y);
    }
    rn_last_layer<WT>(x, weights + n->packed[n->hidden], out);
}

// What the backward of one network leaves for the weights' gradients, in one block: of layer after
// layer the activations that enter it, then the gradients of what leaves it; [tile][16-column
// block][lane], every 8x8 part transposed.
struct rn_cuda_scratch {
    uint4 *block;
    size_t stride; // from one 16-column block to the next: of all tiles
    int inputs16, width16;
};
RN_HD size_t rn_cuda_scratch_fragments(const struct rn_cuda_network *n) {
    return (size_t)(n->inputs16 + 2 * n->width16 * n->hidden + 1);
}
RN_DEVICE struct rn_cuda_scratch rn_scratch(const struct rn_cuda_network *n, uint4 *block,
                                            size_t tiles) {
    return rn_cuda_scratch{block, tiles * RN_LANES, n->inputs16, n->width16};
}
RN_DEVICE uint4 *rn_into(const struct rn_cuda_scratch *s, int layer) {
    int before = layer > 0 ? s->inputs16 + (2 * layer - 1) * s->width16 : 0;
    return s->block + s->stride * (size_t)before;
}
RN_DEVICE uint4 *rn_out_of(const struct rn_cuda_scratch *s, int layer) {
    return s->block + s->stride * (size_t)(s->inputs16 + 2 * layer * s->width16);
}

// Where a block sums the last layer's weights' gradient itself: its warps' activations before that
// layer and gradients behind it in shared memory, [warp][WT + 1][lane], transposed; warp m of the
// first WT has the sums of activations 16 m and on.
struct rn_cuda_on_chip {
    uint4 *exchange;
    float sums[2][4];
};
RN_HD size_t rn_cuda_on_chip_fragments(const struct rn_cuda_network *n, int threads) {
    return (size_t)threads * (size_t)(n->width16 + 1);
}

// A tile of each of the block's warps, all of which come here as often.
template <int WT>
RN_DEVICE void rn_sum_on_chip(struct rn_cuda_on_chip *c, const uint32_t (&x)[WT][4],
                              const uint32_t (&grad)[1][4]) {
    int warp = (int)threadIdx.x / RN_LANES, warps = (int)blockDim.x / RN_LANES;
    uint4 *own = c->exchange + warp * (WT + 1) * RN_LANES;
    __syncthreads(); // all have read the tiles before
    rn_keep_transposed<WT>(x, own);
    rn_keep_transposed<1>(grad, own + WT * RN_LANES);
    __syncthreads(); // all are there
    for (int w = 0; w < warps && warp < WT; w++) {
        const uint4 *tile = c->exchange + w * (WT + 1) * RN_LANES + RN_LANE;
        uint4 t = tile[warp * RN_LANES], g = tile[WT * RN_LANES];
        uint32_t of_x[4] = {t.x, t.z, t.y, t.w};
        rn_mma(c->sums[0], of_x, g.x, g.y);
        rn_mma(c->sums[1], of_x, g.z, g.w);
    }
}

// Of a warp's tiles, those that are there, at `place` and on: their blocks of a layer.
template <int NT, int T>
RN_DEVICE void rn_keep_tiles(const uint32_t (&a)[T][NT][4], int there, uint4 *layer, size_t place) {
    RN_UNROLL
    for (int t = 0; t < T; t++)
        if (t < there) rn_keep_transposed<NT>(a[t], layer + (place + (size_t)t) * NT * RN_LANES);
}

// Backward of T tiles through all layers but the first: the forward again, keeping activations and
// the signs, then dL/d(outputs) `grad` back to dL/d(what leaves the first layer), in `x`, masked.
// What the weights' gradients need of the first `there` tiles goes to `place` and on of the
// scratch; of the last layer with ON_CHIP to the sums at `c` instead. True on overflow.
template <int KT, int WT, bool ON_CHIP, int T>
RN_DEVICE bool rn_backward(const struct rn_cuda_network *n, const uint4 *forward,
                           const uint4 *backward, const struct rn_cuda_scratch *s, size_t place,
                           int there, const uint32_t (&a)[T][KT][4],
                           const uint32_t (&grad)[T][1][4], uint32_t (&x)[T][WT][4],
                           struct rn_cuda_on_chip *c = nullptr) {
    constexpr int WORDS = (WT + 3) / 4;
    uint32_t y[T][WT][4], mask[T][WORDS], masks[RN_MLP_MAX_LAYERS][T][WORDS];
    rn_keep_tiles<KT>(a, there, rn_into(s, 0), place);
    rn_layer<KT, WT, RN_LAYER_RELU>(a, forward, x, mask);
    for (int l = 1;; l++) {
        for (int i = 0; i < T * WORDS; i++)
            masks[l - 1][i / WORDS][i % WORDS] = mask[i / WORDS][i % WORDS];
        if (!(ON_CHIP && l == n->hidden)) rn_keep_tiles<WT>(x, there, rn_into(s, l), place);
        if (l == n->hidden) break;
        rn_layer<WT, WT, RN_LAYER_RELU>(x, forward + n->packed[l], y, mask);
        rn_move<WT>(x, y);
    }
    if constexpr (ON_CHIP)
        rn_sum_on_chip<WT>(c, x[0], grad[0]);
    else
        rn_keep_tiles<1>(grad, there, rn_out_of(s, n->hidden), place);
    bool bad = rn_layer<1, WT, RN_LAYER_MASKED>(grad, backward + n->packed[n->hidden], x, mask);
    rn_keep_tiles<WT>(x, there, rn_out_of(s, n->hidden - 1), place);
    for (int l = n->hidden - 1; l > 0; l--) {
        for (int i = 0; i < T * WORDS; i++)
            mask[i / WORDS][i % WORDS] = masks[l - 1][i / WORDS][i % WORDS];
        bad |= rn_layer<WT, WT, RN_LAYER_MASKED>(x, backward + n->packed[l], y, mask);
        rn_move<WT>(x, y);
        rn_keep_tiles<WT>(x, there, rn_out_of(s, l - 1), place);
    }
    return bad;
}

// Threads a block of the kernels behind the forward: what is known to lie in shared memory leaves
// registers for more, a second tile a warp needs them.
#define RN_NETWORK_THREADS(shared, tiles) ((shared) && (tiles) == 1 ? 384 : 256)

// Copies a network's fragments to the block's shared memory, asynchronously; where it does not fit
// the kernels read them through the caches. Kernels have a parameter SHARED: all that they stage
// fits, so that the compiler knows where it lies.
RN_DEVICE const uint4 *rn_stage(bool fits, uint4 *to, const uint4 *from, uint32_t count) {
    if (!fits) return from;
    for (uint32_t i = threadIdx.x; i < count; i += blockDim.x)
        rn_copy_async(to + i, from + i);
    return to;
}
// Every thread's copies have arrived and all threads may read them.
RN_DEVICE void rn_stage_finish() {
    rn_copy_commit();
    rn_copy_wait<0>();
    __syncthreads();
}

#endif
