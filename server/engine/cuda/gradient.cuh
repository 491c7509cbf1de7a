// Gradients of the networks' weights: for every layer the product of activations transposed with
// gradients, over all tiles. Both operands lie as transposed fragments (network.cuh). A block of
// threads has one layer and one part of the tiles (rn_cuda_chunks), and all of the layer's sums in
// registers; the next tiles are on their way to shared memory while one is multiplied, since what
// bounds this is how many bytes are in flight. The parts' sums are added in order: the same bits
// every time.
#ifndef RN_ENGINE_CUDA_GRADIENT_CUH
#define RN_ENGINE_CUDA_GRADIENT_CUH

#include "server/engine/cuda/network.cuh"

#define RN_GRADIENT_STAGES 6 // tiles in shared memory
// Eight warps share a layer's 16x16 blocks, 2 down and 4 across in turn; most blocks of one warp.
#define RN_GRADIENT_DOWN 2
#define RN_GRADIENT_ACROSS 4
#define RN_GRADIENT_M 5
#define RN_GRADIENT_N 2

// One layer: fragments of both operands, [tile][blocks][lane].
struct rn_gradient_layer {
    const uint4 *into, *out_of;
    int into_blocks, out_blocks;
};

// Fragments of the largest tile of a network's layers.
RN_HD size_t rn_cuda_gradient_stage(const struct rn_cuda_network *n) {
    int k16 = n->inputs16 > n->width16 ? n->inputs16 : n->width16;
    return (size_t)(k16 + n->width16) * RN_LANES;
}

// What a thread copies of every tile: at most so many fragments, each a tile's stride further on.
#define RN_GRADIENT_COPIES 3 // 576 fragments of the widest tile, 256 threads
struct rn_gradient_copy {
    const uint4 *from[RN_GRADIENT_COPIES];
    int stride[RN_GRADIENT_COPIES], count;
};
RN_DEVICE struct rn_gradient_copy rn_gradient_copy_start(const struct rn_gradient_layer *l,
                                                         size_t tile) {
    int into = l->into_blocks * RN_LANES, out_of = l->out_blocks * RN_LANES;
    struct rn_gradient_copy copy;
    copy.count = into + out_of;
    RN_UNROLL
    for (int k = 0; k < RN_GRADIENT_COPIES; k++) {
        int i = (int)(threadIdx.x + (unsigned)k * blockDim.x);
        copy.stride[k] = i < into ? into : out_of;
        copy.from[k] =
            (i < into ? l->into + i : l->out_of + (i - into)) + tile * (size_t)copy.stride[k];
    }
    return copy;
}

// Begins the copy of the next tile, where there is one, as a group of its own.
RN_DEVICE void rn_gradient_load(struct rn_gradient_copy *copy, bool is, uint4 *to) {
    RN_UNROLL
    for (int k = 0; k < RN_GRADIENT_COPIES; k++) {
        int i = (int)(threadIdx.x + (unsigned)k * blockDim.x);
        if (is && i < copy->count) rn_copy_async(to + i, copy->from[k]);
        copy->from[k] += copy->stride[k];
    }
    rn_copy_commit();
}

// The sums of the warp's blocks: block (down + 2 i, across + 4 j) is c[i][j].
struct rn_gradient_sums {
    int down, across;
    float c[RN_GRADIENT_M][RN_GRADIENT_N][2][4];
};

RN_DEVICE void rn_gradient_multiply(const struct rn_gradient_layer *l, const uint4 *tile,
                                    struct rn_gradient_sums *s) {
    uint32_t a[RN_GRADIENT_M][4];
    RN_UNROLL
    for (int i = 0; i < RN_GRADIENT_M; i++) {
        int block = s->down + RN_GRADIENT_DOWN * i;
        uint4 t = block < l->into_blocks ? tile[block * RN_LANES + RN_LANE] : uint4{0, 0, 0, 0};
        a[i][0] = t.x;
        a[i][1] = t.z;
        a[i][2] = t.y;
        a[i][3] = t.w;
    }
    RN_UNROLL
    for (int j = 0; j < RN_GRADIENT_N; j++) {
        int block = s->across + RN_GRADIENT_ACROSS * j;
        if (block >= l->out_blocks) continue;
        uint4 t = tile[(l->into_blocks + block) * RN_LANES + RN_LANE];
        RN_UNROLL
        for (int i = 0; i < RN_GRADIENT_M; i++) {
            if (s->down + RN_GRADIENT_DOWN * i >= l->into_blocks) continue;
            rn_mma(s->c[i][j][0], a[i], t.x, t.y);
            rn_mma(s->c[i][j][1], a[i], t.z, t.w);
        }
    }
}

// To `to`, [block][half][lane][4].
RN_DEVICE void rn_gradient_store(const struct rn_gradient_layer *l,
                                 const struct rn_gradient_sums *s, float4 *to) {
    RN_UNROLL
    for (int i = 0; i < RN_GRADIENT_M; i++)
        RN_UNROLL
    for (int j = 0; j < RN_GRADIENT_N; j++) {
        int m = s->down + RN_GRADIENT_DOWN * i, n = s->across + RN_GRADIENT_ACROSS * j;
        if (m >= l->into_blocks || n >= l->out_blocks) continue;
        float4 *block = to + (m * l->out_blocks + n) * 2 * RN_LANES;
        for (int h = 0; h < 2; h++)
            block[h * RN_LANES + RN_LANE] =
                float4{s->c[i][j][h][0], s->c[i][j][h][1], s->c[i][j][h][2], s->c[i][j][h][3]};
    }
}

// Numbers of a network's gradient in block order, padding included.
RN_HD size_t rn_cuda_gradient_count(const struct rn_cuda_network *n) {
    return (size_t)n->packed_count * 8;
}

// Block (chunk, layer): the layer's gradient over the chunk's tiles, into sums[chunk]. `of_rays`:
// the tiles hold rays, not samples. Shared memory: RN_GRADIENT_STAGES tiles.
__global__ void __launch_bounds__(256, 2)
    rn_gradient_kernel(const __grid_constant__ rn_cuda_network n,
                       const __grid_constant__ rn_cuda_chunks chunks, struct rn_cuda_status *status,
                       uint4 *scratch_block, uint32_t tile_capacity, bool of_rays, float4 *sums) {
    uint4 *room = (uint4 *)rn_shared_memory();
    int layer = 0;
    while ((int)blockIdx.x >= chunks.first[layer + 1])
        layer++;
    int chunk = (int)blockIdx.x - chunks.first[layer];
    size_t parts = (size_t)(chunks.first[layer + 1] - chunks.first[layer]);
    struct rn_cuda_scratch scratch = rn_scratch(&n, scratch_block, tile_capacity);
    struct rn_gradient_layer l = {rn_into(&scratch, layer), rn_out_of(&scratch, layer),
                                  rn_cuda_layer_k16(&n, layer), rn_cuda_layer_n16(&n, layer)};
    size_t tiles = rn_cuda_tiles(of_rays ? (uint32_t)status->ray_count : status->returned);
    size_t begin = tiles * (size_t)chunk / parts, end = tiles * (size_t)(chunk + 1) / parts;
    size_t stage = rn_cuda_gradient_stage(&n);
    int warp = (int)threadIdx.x / RN_LANES;
    struct rn_gradient_sums own = {warp / RN_GRADIENT_ACROSS, warp % RN_GRADIENT_ACROSS, {{{{0}}}}};
    struct rn_gradient_copy copy = rn_gradient_copy_start(&l, begin);
    int count = (int)(end - begin), slot = 0; // of the tile under way
    for (int i = 0; i < RN_GRADIENT_STAGES - 1; i++)
        rn_gradient_load(&copy, i < count, room + i * stage);
    for (int tile = 0; tile < count; tile++) {
        rn_copy_wait<RN_GRADIENT_STAGES - 2>();
        __syncthreads(); // this tile is here, and all have read the one before
        int ahead = slot > 0 ? slot - 1 : RN_GRADIENT_STAGES - 1;
        rn_gradient_load(&copy, tile + RN_GRADIENT_STAGES - 1 < count, room + ahead * stage);
        rn_gradient_multiply(&l, room + slot * stage, &own);
        slot = slot + 1 < RN_GRADIENT_STAGES ? slot + 1 : 0;
    }
    rn_gradient_store(&l, &own,
                      sums + (size_t)chunk * rn_cuda_gradient_count(&n) / 4 +
                          (size_t)n.packed[layer] * 2);
}

#endif
