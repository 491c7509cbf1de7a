// The networks' backward, a warp a tile of samples: the colour network from the colours' gradients
// to the geometry's (shade.cuh has it for whole rays), then the density network from there to the
// features'. Each leaves its layers' activations and gradients for the product that gives the
// weights' gradients.
#ifndef RN_ENGINE_CUDA_BACKWARD_CUH
#define RN_ENGINE_CUDA_BACKWARD_CUH

#include "server/engine/cuda/forward.cuh"
#include "server/engine/cuda/gradient.cuh"

// Tiles of samples that are backpropagated; warps take them in a fixed interleaving.
RN_DEVICE uint32_t rn_first_tile() {
    return (blockIdx.x * blockDim.x + threadIdx.x) / RN_LANES;
}
RN_DEVICE uint32_t rn_tile_stride() {
    return gridDim.x * blockDim.x / RN_LANES;
}

// How many of a warp's T tiles from `tile` on there are; the first is.
template <int T> RN_DEVICE int rn_tiles_there(uint32_t tile, uint32_t tiles) {
    return T > 1 && tiles - tile < T ? (int)(tiles - tile) : T;
}

// Sample at a place of the list of the `count` backpropagated ones; none behind its end.
#define RN_NO_SAMPLE 0xffffffffu
RN_DEVICE uint32_t rn_returned(const struct rn_cuda_batch *b, uint32_t count, uint32_t place) {
    return place < count ? b->returned[place] : RN_NO_SAMPLE;
}
// The samples of rows g and g + 8 of a tile of them.
RN_DEVICE void rn_returned_rows(const struct rn_cuda_batch *b, uint32_t count, uint32_t tile,
                                uint32_t ret[2]) {
    for (int i = 0; i < 2; i++)
        ret[i] = rn_returned(b, count, tile * RN_TILE + (uint32_t)(RN_LANE / 4 + 8 * i));
}

// Three gradients of colours, lane i (mod 16) having row i's, as the A fragment of 16 outputs, 13
// of them 0.
RN_DEVICE void rn_colour_fragment(const float own[3], uint32_t (&a)[1][4]) {
    for (int i = 0; i < 2; i++) {
        int row = RN_LANE / 4 + 8 * i, t = RN_LANE % 4;
        float red = rn_shuffle(own[0], row), green = rn_shuffle(own[1], row);
        float blue = rn_shuffle(own[2], row);
        a[0][i] = t == 0 ? rn_pack(red, green) : t == 1 ? rn_pack(blue, 0) : 0;
        a[0][2 + i] = 0;
    }
}

// Stores dL/d(outputs of the density network) of rows that may come from anywhere; true on
// overflow.
RN_DEVICE bool rn_store_geometry_grad(const struct rn_cuda_batch *b, const uint32_t samples[2],
                                      const float (&c)[2][4]) {
    bool bad = false;
    for (int i = 0; i < 2; i++) {
        if (samples[i] == RN_NO_SAMPLE) continue;
        for (int k = 0; k < 4; k++)
            bad |= !(fabsf(c[k / 2][2 * i + k % 2]) <= RN_HALF_MAX);
        b->geometry_grad[(size_t)samples[i] * 4 + RN_LANE % 4] =
            uint2{rn_pack(c[0][2 * i], c[0][2 * i + 1]), rn_pack(c[1][2 * i], c[1][2 * i + 1])};
    }
    return bad;
}

// Puts the numbers that lanes i (mod 16) have of rows i into a column below 8 of a C fragment.
RN_DEVICE void rn_set_column(float (&c)[2][4], int column, float own) {
    for (int i = 0; i < 2; i++) {
        float x = rn_shuffle(own, RN_LANE / 4 + 8 * i);
        if (RN_LANE % 4 == column / 2) c[0][2 * i + column % 2] = x;
    }
}

// The colour network's inputs of two rows: the directions' harmonics, the density network's
// outputs.
RN_DEVICE void rn_sample_inputs(const struct rn_cuda_scene *scene, const struct rn_cuda_batch *b,
                                const uint32_t samples[2], uint32_t (&in)[2][4]) {
    for (int i = 0; i < 2; i++) {
        uint32_t direction[2] = {0, 0};
        in[1][i] = in[1][2 + i] = 0;
        if (samples[i] != RN_NO_SAMPLE) {
            int ray = b->tile_ray[samples[i] / RN_TILE];
            rn_direction(scene, rn_direction_of(b, ray), direction);
            rn_load_row(b->geometry, samples[i], i, in[1]);
        }
        in[0][i] = direction[0];
        in[0][2 + i] = direction[1];
    }
}

// Input columns 16..31 of the colour network are the density network's outputs, but for the first:
// there stands dL/d(logit), from the compositing, which lane i (mod 16) has of row i. `x`:
// gradients of what leaves the first layer.
template <int WT, int T>
RN_DEVICE bool rn_finish_geometry_grad(const struct rn_cuda_batch *b,
                                       const uint32_t (&samples)[T][2], const float (&logit)[T],
                                       const uint4 *weights, const uint32_t (&x)[T][WT][4]) {
    float c[T][2][4];
    bool bad = false;
    rn_last_layer<WT>(x, weights + WT * RN_LANES, c);
    RN_UNROLL
    for (int t = 0; t < T; t++) {
        rn_set_column(c[t], 0, logit[t]);
        bad |= rn_store_geometry_grad(b, samples[t], c[t]);
    }
    return bad;
}

// Of the sample at a place, dL/d(logit) and dL/d(colours); 0 where there is none.
RN_DEVICE void rn_load_colour_grad(const struct rn_cuda_batch *b, uint32_t own, float *ret_logit,
                                   float ret_colour[3]) {
    bool is = own != RN_NO_SAMPLE;
    *ret_logit = is ? b->logit_grad[own] : 0;
    for (int c = 0; c < 3; c++)
        ret_colour[c] =
            is ? b->colour_grad[((size_t)(own / RN_TILE) * 3 + c) * RN_TILE + own % RN_TILE] : 0;
}

// T: tiles that a warp takes at a time, neighbours in the list.
template <int WT, bool SHARED, int T>
__global__ void __launch_bounds__(RN_NETWORK_THREADS(SHARED, T), 1)
    rn_head_backward_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_batch batch, int staged) {
    uint4 *room = (uint4 *)rn_shared_memory();
    const struct rn_cuda_network *n = &scene.head;
    const uint4 *forward = rn_stage(SHARED || staged > 0, room,
                                    scene.forward + scene.base.packed_count, n->packed_count);
    const uint4 *backward = rn_stage(SHARED || staged > 1, room + n->packed_count,
                                     scene.backward + scene.base.packed_count, n->packed_count);
    rn_stage_finish();
    struct rn_cuda_scratch scratch = rn_scratch(n, batch.scratch, batch.tile_capacity);
    uint32_t count = batch.status->returned, tiles = rn_cuda_tiles(count);
    bool bad = false;
    for (uint32_t tile = T * rn_first_tile(); tile < tiles; tile += T * rn_tile_stride()) {
        uint32_t samples[T][2], in[T][2][4], grad[T][1][4], x[T][WT][4];
        float logit[T];
        RN_UNROLL
        for (int t = 0; t < T; t++) {
            uint32_t place = (tile + t) * RN_TILE + (uint32_t)(RN_LANE % RN_TILE);
            float colour[3];
            rn_returned_rows(&batch, count, tile + t, samples[t]);
            rn_sample_inputs(&scene, &batch, samples[t], in[t]);
            rn_load_colour_grad(&batch, rn_returned(&batch, count, place), &logit[t], colour);
            rn_colour_fragment(colour, grad[t]);
        }
        int there = rn_tiles_there<T>(tile, tiles);
        bad |= rn_backward<2, WT, false>(n, forward, backward, &scratch, tile, there, in, grad, x);
        bad |= rn_finish_geometry_grad<WT>(&batch, samples, logit, backward, x);
    }
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

// dL/d(features), four neighbouring channels a lane, rows g and g + 8, of the tiles that are there.
template <int KT, int WT, int T>
RN_DEVICE bool rn_store_feature_grad(const struct rn_cuda_batch *b, uint32_t tile, int there,
                                     const uint4 *weights, const uint32_t (&x)[T][WT][4]) {
    uint32_t grad[T][KT][4], unused[T][(KT + 3) / 4];
    bool bad = rn_layer<WT, KT, RN_LAYER_PLAIN>(x, weights, grad, unused);
    RN_UNROLL
    for (int t = 0; t < T; t++) {
        RN_UNROLL
        for (int k = 0; k < KT && t < there; k++)
            rn_store_rows(grad[t][k], b->feature_grad + ((size_t)(tile + t) * KT + k) * RN_BLOCK);
    }
    return bad;
}

// The sums of the block, as one part of the last layer's (gradient.cuh).
template <int WT>
RN_DEVICE void rn_store_on_chip(const struct rn_cuda_network *n, const struct rn_cuda_on_chip *c,
                                float4 *sums) {
    int warp = (int)threadIdx.x / RN_LANES;
    float4 *part = sums + (size_t)blockIdx.x * rn_cuda_gradient_count(n) / 4 +
                   ((size_t)n->packed[n->hidden] + (size_t)warp * RN_LANES) * 2;
    for (int h = 0; h < 2 && warp < WT; h++)
        part[h * RN_LANES + RN_LANE] =
            float4{c->sums[h][0], c->sums[h][1], c->sums[h][2], c->sums[h][3]};
}

// Features and dL/d(outputs) of two rows; 0 where there is no sample.
template <int KT>
RN_DEVICE void rn_load_sample(const struct rn_cuda_batch *b, const uint32_t samples[2],
                              uint32_t (&in)[KT][4], uint32_t (&grad)[1][4]) {
    for (int i = 0; i < 2; i++) {
        size_t slot = samples[i] / RN_TILE;
        if (samples[i] == RN_NO_SAMPLE) continue;
        RN_UNROLL
        for (int k = 0; k < KT; k++)
            rn_load_row(b->features + (slot * KT + k) * RN_BLOCK, samples[i] % RN_TILE, i, in[k]);
        rn_load_row(b->geometry_grad, samples[i], i, grad[0]);
    }
}

// ON_CHIP: the last layer's weights' gradient is summed here, into `sums`; a block's warps take as
// many tiles each then, some of them without samples. T as above.
template <int KT, int WT, bool SHARED, bool ON_CHIP, int T>
__global__ void __launch_bounds__(RN_NETWORK_THREADS(SHARED, T), 1)
    rn_base_backward_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_batch batch, int staged, float4 *sums) {
    static_assert(T == 1 || !ON_CHIP, "a block exchanges a tile of each of its warps");
    uint4 *room = (uint4 *)rn_shared_memory();
    const struct rn_cuda_network *n = &scene.base;
    const uint4 *forward = rn_stage(SHARED || staged > 0, room, scene.forward, n->packed_count);
    const uint4 *backward =
        rn_stage(SHARED || staged > 1, room + n->packed_count, scene.backward, n->packed_count);
    rn_stage_finish();
    struct rn_cuda_scratch scratch = rn_scratch(n, batch.scratch, batch.tile_capacity);
    struct rn_cuda_on_chip chip = {room + 2 * n->packed_count, {{0}}};
    uint32_t count = batch.status->returned, tiles = rn_cuda_tiles(count);
    uint32_t ahead = ON_CHIP ? threadIdx.x / RN_LANES : 0; // of the block's first
    bool bad = false;
    for (uint32_t tile = T * rn_first_tile(); tile - ahead < tiles; tile += T * rn_tile_stride()) {
        uint32_t samples[2], in[T][KT][4] = {{{0}}}, grad[T][1][4] = {{{0}}}, x[T][WT][4];
        RN_UNROLL
        for (int t = 0; t < T; t++) {
            rn_returned_rows(&batch, count, tile + t, samples);
            rn_load_sample<KT>(&batch, samples, in[t], grad[t]);
        }
        int there = ON_CHIP ? (int)(tile < tiles) : rn_tiles_there<T>(tile, tiles);
        bad |= rn_backward<KT, WT, ON_CHIP>(n, forward, backward, &scratch, tile, there, in, grad,
                                            x, &chip);
        bad |= rn_store_feature_grad<KT>(&batch, tile, there, backward, x);
    }
    if (ON_CHIP) rn_store_on_chip<WT>(n, &chip, sums);
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

#endif
