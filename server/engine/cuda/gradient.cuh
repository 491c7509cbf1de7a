// Gradients of the networks' weights: for every layer the product of activations transposed with
// gradients, over all tiles. Both operands lie as transposed fragments (network.cuh), so a warp
// loads 16 bytes a lane and multiplies; no shared memory. Tiles are cut into RN_CHUNKS parts whose
// sums are added in order: the same bits every time.
#ifndef RN_ENGINE_CUDA_GRADIENT_CUH
#define RN_ENGINE_CUDA_GRADIENT_CUH

#include "server/engine/cuda/network.cuh"

// One warp's part of one layer: up to M x N blocks of 16x16 sums.
struct rn_gradient_part {
    const uint4 *into, *out_of; // [tile][blocks][lane]
    int into_blocks, out_blocks, m, n;
};

// The sums of blocks (m .. m + M, n .. n + N) over tiles [begin, end), to `to` ([block][lane][8]).
template <int M, int N>
RN_DEVICE void rn_gradient_block(const struct rn_gradient_part *p, size_t begin, size_t end,
                                 float4 *to) {
    float c[M][N][2][4] = {{{{0}}}};
    for (size_t tile = begin; tile < end; tile++) {
        uint32_t a[M][4];
        const uint4 *into = p->into + tile * (size_t)p->into_blocks * RN_LANES + RN_LANE;
        const uint4 *out_of = p->out_of + tile * (size_t)p->out_blocks * RN_LANES + RN_LANE;
        RN_UNROLL
        for (int i = 0; i < M; i++) {
            uint4 t = p->m + i < p->into_blocks ? into[(p->m + i) * RN_LANES] : uint4{0, 0, 0, 0};
            a[i][0] = t.x;
            a[i][1] = t.z;
            a[i][2] = t.y;
            a[i][3] = t.w;
        }
        RN_UNROLL
        for (int j = 0; j < N; j++) {
            uint4 t = p->n + j < p->out_blocks ? out_of[(p->n + j) * RN_LANES] : uint4{0, 0, 0, 0};
            RN_UNROLL
            for (int i = 0; i < M; i++) {
                rn_mma(c[i][j][0], a[i], t.x, t.y);
                rn_mma(c[i][j][1], a[i], t.z, t.w);
            }
        }
    }
    RN_UNROLL
    for (int i = 0; i < M; i++)
        RN_UNROLL
        for (int j = 0; j < N; j++) {
            if (p->m + i >= p->into_blocks || p->n + j >= p->out_blocks) continue;
            float4 *block = to + ((size_t)(p->m + i) * (size_t)p->out_blocks + (p->n + j)) * 64;
            for (int h = 0; h < 2; h++)
                block[h * RN_LANES + RN_LANE] =
                    float4{c[i][j][h][0], c[i][j][h][1], c[i][j][h][2], c[i][j][h][3]};
        }
}

// Numbers of a network's gradient in block order, padding included.
RN_HD size_t rn_cuda_gradient_count(const struct rn_cuda_network *n) {
    return (size_t)n->packed_count * 8;
}

// Block (chunk, layer): the layer's gradient over the chunk's tiles, into sums[chunk]. A warp takes
// 4 x 2 blocks of 16x16 at a time. `of_rays`: the tiles hold rays, not samples.
__global__ void __launch_bounds__(256, 1)
    rn_gradient_kernel(const __grid_constant__ rn_cuda_network n, struct rn_cuda_status *status,
                       uint4 *scratch_block, uint32_t tile_capacity, bool of_rays, float4 *sums) {
    enum { M = 4, N = 2 };
    int layers = n.hidden + 1, chunk = (int)blockIdx.x / layers, layer = (int)blockIdx.x % layers;
    struct rn_cuda_scratch scratch = rn_scratch(&n, scratch_block, tile_capacity);
    struct rn_gradient_part part = {scratch.into[layer], scratch.out_of[layer],
                                    rn_cuda_layer_k16(&n, layer), rn_cuda_layer_n16(&n, layer), 0,
                                    0};
    size_t tiles = of_rays ? rn_cuda_ray_tiles(status->ray_count) : status->ordered;
    size_t begin = tiles * (size_t)chunk / RN_CHUNKS, end = tiles * (size_t)(chunk + 1) / RN_CHUNKS;
    float4 *to = sums + (size_t)chunk * rn_cuda_gradient_count(&n) / 4 + (size_t)n.packed[layer] * 2;
    int across = (part.out_blocks + N - 1) / N, down = (part.into_blocks + M - 1) / M;
    for (int i = (int)threadIdx.x / RN_LANES; i < across * down; i += (int)blockDim.x / RN_LANES) {
        part.m = i / across * M;
        part.n = i % across * N;
        rn_gradient_block<M, N>(&part, begin, end, to);
    }
}

#endif
