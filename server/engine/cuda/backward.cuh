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
template <int WT>
RN_DEVICE bool rn_finish_geometry_grad(const struct rn_cuda_batch *b, const uint32_t samples[2],
                                       float logit, const uint4 *weights,
                                       const uint32_t (&x)[WT][4]) {
    float c[2][4];
    rn_last_layer<WT>(x, weights + WT * RN_LANES, c);
    rn_set_column(c, 0, logit);
    return rn_store_geometry_grad(b, samples, c);
}

template <int WT, bool SHARED>
__global__ void __launch_bounds__(RN_NETWORK_THREADS(SHARED), 1)
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
    uint32_t count = batch.status->returned;
    bool bad = false;
    for (uint32_t tile = rn_first_tile(); tile < rn_cuda_tiles(count); tile += rn_tile_stride()) {
        uint32_t samples[2], in[2][4], grad[1][4], x[WT][4];
        uint32_t own = rn_returned(&batch, count, tile * RN_TILE + (uint32_t)(RN_LANE % RN_TILE));
        float colour[3] = {0, 0, 0}, logit = 0;
        rn_returned_rows(&batch, count, tile, samples);
        rn_sample_inputs(&scene, &batch, samples, in);
        if (own != RN_NO_SAMPLE) {
            logit = batch.logit_grad[own];
            for (int c = 0; c < 3; c++)
                colour[c] =
                    batch.colour_grad[((size_t)(own / RN_TILE) * 3 + c) * RN_TILE + own % RN_TILE];
        }
        rn_colour_fragment(colour, grad);
        bad |= rn_backward<2, WT>(n, forward, backward, &scratch, tile, in, grad, x);
        bad |= rn_finish_geometry_grad<WT>(&batch, samples, logit, backward, x);
    }
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

// dL/d(features), four neighbouring channels a lane, rows g and g + 8.
template <int KT, int WT>
RN_DEVICE bool rn_store_feature_grad(const struct rn_cuda_batch *b, uint32_t tile,
                                     const uint4 *weights, const uint32_t (&x)[WT][4]) {
    uint32_t grad[KT][4], unused[(KT + 3) / 4];
    bool bad = rn_layer<WT, KT, RN_LAYER_PLAIN>(x, weights, grad, unused);
    RN_UNROLL
    for (int k = 0; k < KT; k++)
        rn_store_rows(grad[k], b->feature_grad + ((size_t)tile * KT + k) * RN_BLOCK);
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

// ON_CHIP: the last layer's weights' gradient is summed here, into `sums`; a block's warps take as
// many tiles each then, some of them without samples.
template <int KT, int WT, bool SHARED, bool ON_CHIP>
__global__ void __launch_bounds__(RN_NETWORK_THREADS(SHARED), 1)
    rn_base_backward_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_batch batch, int staged, float4 *sums) {
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
    for (uint32_t tile = rn_first_tile(); tile - ahead < tiles; tile += rn_tile_stride()) {
        uint32_t samples[2], in[KT][4] = {{0}}, grad[1][4] = {{0}}, x[WT][4];
        rn_returned_rows(&batch, count, tile, samples);
        for (int i = 0; i < 2; i++) {
            if (samples[i] == RN_NO_SAMPLE) continue;
            size_t slot = samples[i] / RN_TILE;
            RN_UNROLL
            for (int k = 0; k < KT; k++)
                rn_load_row(batch.features + (slot * KT + k) * RN_BLOCK, samples[i] % RN_TILE, i,
                            in[k]);
            rn_load_row(batch.geometry_grad, samples[i], i, grad[0]);
        }
        size_t place = ON_CHIP && tile >= tiles ? RN_NO_PLACE : tile;
        bad |=
            rn_backward<KT, WT, ON_CHIP>(n, forward, backward, &scratch, place, in, grad, x, &chip);
        if (!ON_CHIP || tile < tiles)
            bad |= rn_store_feature_grad<KT, WT>(&batch, tile, backward, x);
    }
    if (ON_CHIP) rn_store_on_chip<WT>(n, &chip, sums);
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

#endif
