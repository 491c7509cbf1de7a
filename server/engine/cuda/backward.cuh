// The networks' backward, a warp a tile of samples: the colour network from the colours' gradients
// to the geometry's (shade.cuh has it for whole rays), then the density network from there to the
// features'. Each leaves its layers' activations and gradients for the product that gives the
// weights' gradients.
#ifndef RN_ENGINE_CUDA_BACKWARD_CUH
#define RN_ENGINE_CUDA_BACKWARD_CUH

#include "server/engine/cuda/forward.cuh"

// Tiles by place in `order`; warps take them in a fixed interleaving.
RN_DEVICE uint32_t rn_first_place() {
    return (blockIdx.x * blockDim.x + threadIdx.x) / RN_LANES;
}
RN_DEVICE uint32_t rn_place_stride() {
    return gridDim.x * blockDim.x / RN_LANES;
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

// Stores dL/d(outputs of the density network) of a tile; true on overflow.
RN_DEVICE bool rn_store_geometry_grad(const struct rn_cuda_batch *b, uint32_t place,
                                      const float (&c)[2][4]) {
    bool bad = false;
    for (int i = 0; i < 8; i++)
        bad |= !(fabsf(c[i / 4][i % 4]) <= RN_HALF_MAX);
    b->geometry_grad[(size_t)place * RN_LANES + RN_LANE] =
        uint4{rn_pack(c[0][0], c[0][1]), rn_pack(c[0][2], c[0][3]), rn_pack(c[1][0], c[1][1]),
              rn_pack(c[1][2], c[1][3])};
    return bad;
}

// Puts the numbers that lanes i (mod 16) have of rows i into a column below 8 of a C fragment.
RN_DEVICE void rn_set_column(float (&c)[2][4], int column, float own) {
    for (int i = 0; i < 2; i++) {
        float x = rn_shuffle(own, RN_LANE / 4 + 8 * i);
        if (RN_LANE % 4 == column / 2) c[0][2 * i + column % 2] = x;
    }
}

// Input columns 16..31 of the colour network are the density network's outputs, but for the first:
// there stands dL/d(logit), from the compositing. `x`: gradients of what leaves the first layer.
template <int WT>
RN_DEVICE bool rn_finish_geometry_grad(const struct rn_cuda_batch *b, uint32_t place, int slot,
                                       const uint4 *weights, const uint32_t (&x)[WT][4]) {
    float c[2][4];
    rn_last_layer<WT>(x, weights + WT * RN_LANES, c);
    rn_set_column(c, 0, b->logit_grad[(size_t)slot * RN_TILE + RN_LANE % RN_TILE]);
    return rn_store_geometry_grad(b, place, c);
}

template <int WT>
__global__ void __launch_bounds__(256, 1)
    rn_head_backward_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_batch batch, int staged) {
    uint4 *room = (uint4 *)rn_shared_memory();
    const struct rn_cuda_network *n = &scene.head;
    const uint4 *forward = rn_stage(staged > 0 ? room : NULL,
                                    scene.forward + scene.base.packed_count, n->packed_count);
    const uint4 *backward = rn_stage(staged > 1 ? room + n->packed_count : NULL,
                                     scene.backward + scene.base.packed_count, n->packed_count);
    rn_stage_finish();
    struct rn_cuda_scratch scratch = rn_scratch(n, batch.scratch, batch.tile_capacity);
    bool bad = false;
    for (uint32_t place = rn_first_place(); place < batch.status->ordered;
         place += rn_place_stride()) {
        int slot = (int)batch.order[place];
        struct rn_march_ray ray = batch.rays[batch.tile_ray[slot]];
        uint32_t in[2][4], grad[1][4], x[WT][4], direction[2];
        float colour[3];
        rn_direction(&scene, ray.direction, direction);
        uint4 geometry = batch.geometry[(size_t)slot * RN_LANES + RN_LANE];
        for (int i = 0; i < 4; i++)
            in[0][i] = direction[i / 2];
        in[1][0] = geometry.x;
        in[1][1] = geometry.y;
        in[1][2] = geometry.z;
        in[1][3] = geometry.w;
        for (int c = 0; c < 3; c++)
            colour[c] = batch.colour_grad[((size_t)slot * 3 + c) * RN_TILE + RN_LANE % RN_TILE];
        rn_colour_fragment(colour, grad);
        bad |= rn_backward<2, WT>(n, forward, backward, &scratch, place, in, grad, x);
        bad |= rn_finish_geometry_grad<WT>(&batch, place, slot, backward, x);
    }
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

// dL/d(features), four neighbouring channels a lane, rows g and g + 8.
template <int KT, int WT>
RN_DEVICE bool rn_store_feature_grad(const struct rn_cuda_batch *b, uint32_t place,
                                     const uint4 *weights, const uint32_t (&x)[WT][4]) {
    uint32_t grad[KT][4], unused[(KT + 3) / 4];
    bool bad = rn_layer<WT, KT, RN_LAYER_PLAIN>(x, weights, grad, unused);
    RN_UNROLL
    for (int k = 0; k < KT; k++)
        for (int i = 0; i < 2; i++)
            b->feature_grad[((size_t)place * KT + k) * 64 + i * RN_LANES + RN_LANE] =
                uint2{grad[k][i], grad[k][2 + i]};
    return bad;
}

template <int KT, int WT>
__global__ void __launch_bounds__(256, 1)
    rn_base_backward_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_batch batch, int staged) {
    uint4 *room = (uint4 *)rn_shared_memory();
    const struct rn_cuda_network *n = &scene.base;
    const uint4 *forward = rn_stage(staged > 0 ? room : NULL, scene.forward, n->packed_count);
    const uint4 *backward =
        rn_stage(staged > 1 ? room + n->packed_count : NULL, scene.backward, n->packed_count);
    rn_stage_finish();
    struct rn_cuda_scratch scratch = rn_scratch(n, batch.scratch, batch.tile_capacity);
    bool bad = false;
    for (uint32_t place = rn_first_place(); place < batch.status->ordered;
         place += rn_place_stride()) {
        size_t slot = batch.order[place];
        uint32_t in[KT][4], grad[1][4], x[WT][4];
        RN_UNROLL
        for (int k = 0; k < KT; k++) {
            uint4 f = batch.features[(slot * KT + k) * RN_LANES + RN_LANE];
            in[k][0] = f.x;
            in[k][1] = f.y;
            in[k][2] = f.z;
            in[k][3] = f.w;
        }
        uint4 g = batch.geometry_grad[(size_t)place * RN_LANES + RN_LANE];
        grad[0][0] = g.x;
        grad[0][1] = g.y;
        grad[0][2] = g.z;
        grad[0][3] = g.w;
        bad |= rn_backward<KT, WT>(n, forward, backward, &scratch, place, in, grad, x);
        bad |= rn_store_feature_grad<KT, WT>(&batch, place, backward, x);
    }
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

#endif
