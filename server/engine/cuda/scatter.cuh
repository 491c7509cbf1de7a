// The fetch's adjoint: feature gradients to the texels they came from. A thread follows a piece of
// a ray on one plane with C channels, 8 where texels have as many, else 4, and holds the sums of
// the texels around it; what it leaves behind goes to memory, so that neighbouring samples' texels
// are written once.
#ifndef RN_ENGINE_CUDA_SCATTER_CUH
#define RN_ENGINE_CUDA_SCATTER_CUH

#include "server/engine/cuda/encode.cuh"
#include "server/engine/cuda/network.cuh"

// fp16 sums of many gradients: this much is taken off them so that the sum does not overflow.
#define RN_SCATTER_HEADROOM 0.0625f
// Fixed point of the deterministic mode: sums of integers do not depend on their order.
#define RN_FIXED_ONE 1073741824.0f

// Gradients of the pyramids, laid out as the texels: fp16, or int64 where `fixed`. `touched`: one
// byte a block of RN_UPDATE texels a side, [plane][row][column].
struct rn_cuda_gradients {
    uint2 *half;
    unsigned long long *fixed;
    uint8_t *touched;
    // Of the voxels: fp32, or int64 too; one byte for RN_VOXELS_A_MARK of them.
    float *voxels;
    unsigned long long *voxels_fixed;
    uint8_t *voxels_touched;
};
#define RN_VOXELS_A_MARK 4 // as many numbers as the CPU's tiles hold (rn_tiling)

// Sums of the four texels of one map around the ray, [row][column][channel]; 0 where it is empty.
#define RN_NOWHERE -4
template <int C> struct rn_nest {
    int x, y; // of texel (0, 0); RN_NOWHERE before there is one
    float sum[2][2][C];
};

// Where one thread scatters.
struct rn_scatter_place {
    const struct rn_cuda_planes *planes;
    const struct rn_cuda_gradients *to;
    int plane, channel;
};

// Marks the blocks of the four texels of a map from (x, y) on: one block, as nearly always.
RN_DEVICE void rn_mark_touched(const struct rn_scatter_place *p, int lx, int ly, int x, int y) {
    int side = p->planes->update_side, last = side * RN_UPDATE - 1;
    int x1 = ((x + 2) << lx) - 1, y1 = ((y + 2) << ly) - 1;
    uint8_t *touched = p->to->touched + (size_t)p->plane * (size_t)(side * side);
    x1 = (x1 < last ? x1 : last) / RN_UPDATE;
    y1 = (y1 < last ? y1 : last) / RN_UPDATE;
    RN_ROLLED
    for (int j = (y << ly) / RN_UPDATE; j <= y1; j++)
        RN_ROLLED
    for (int i = (x << lx) / RN_UPDATE; i <= x1; i++)
        touched[j * side + i] = 1;
}

// Adds sums of gradients to a texel of the fp16 maps.
RN_DEVICE void rn_add_half(const struct rn_cuda_gradients *to, size_t at, const float (&sum)[4]) {
    rn_red_half4(to->half + at / 4,
                 rn_pack(sum[0] * RN_SCATTER_HEADROOM, sum[1] * RN_SCATTER_HEADROOM),
                 rn_pack(sum[2] * RN_SCATTER_HEADROOM, sum[3] * RN_SCATTER_HEADROOM));
}
RN_DEVICE void rn_add_half(const struct rn_cuda_gradients *to, size_t at, const float (&sum)[8]) {
    uint32_t pairs[4];
    RN_UNROLL
    for (int i = 0; i < 4; i++)
        pairs[i] = rn_pack(sum[2 * i] * RN_SCATTER_HEADROOM, sum[2 * i + 1] * RN_SCATTER_HEADROOM);
    rn_red_half8((uint4 *)(to->half + at / 4), pairs);
}

// Adds the sums to texel (x, y) of map (lx, ly) and clears them.
template <bool FIXED, int C>
RN_DEVICE void rn_flush(const struct rn_scatter_place *p, int lx, int ly, int x, int y,
                        float (&sum)[C]) {
    bool some = false;
    RN_UNROLL
    for (int c = 0; c < C; c++)
        some |= !(sum[c] == 0);
    if (!some) return;
    uint32_t texel = (uint32_t)p->plane * p->planes->plane_texels + p->planes->map[ly][lx] +
                     (uint32_t)(y * (p->planes->base >> lx) + x);
    size_t at = (size_t)texel * (size_t)p->planes->channels + (size_t)p->channel;
    if (FIXED) {
        for (int c = 0; c < C; c++)
            atomicAdd(p->to->fixed + at + c,
                      (unsigned long long)(long long)((double)sum[c] * (double)RN_FIXED_ONE));
    } else {
        rn_add_half(p->to, at, sum);
    }
    RN_UNROLL
    for (int c = 0; c < C; c++)
        sum[c] = 0;
}

// Moves a nest to another place of its map, or away from it (`leaves`): what both places share
// stays, what they do not goes to memory.
template <bool FIXED, int C>
RN_DEVICE void rn_move_nest(const struct rn_scatter_place *p, int lx, int ly, bool leaves, int x,
                            int y, struct rn_nest<C> *n) {
    int dx = leaves ? 2 : x - n->x, dy = y - n->y;
    RN_UNROLL
    for (int k = 0; k < 4; k++) {
        bool stays = (unsigned)(k % 2 - dx) < 2 && (unsigned)(k / 2 - dy) < 2;
        if (!stays) rn_flush<FIXED>(p, lx, ly, n->x + k % 2, n->y + k / 2, n->sum[k / 2][k % 2]);
    }
    RN_UNROLL
    for (int i = 0; i < 2 * C; i++) {
        float left = n->sum[i / C][0][i % C], right = n->sum[i / C][1][i % C];
        n->sum[i / C][0][i % C] = dx > 0 ? right : dx < 0 ? 0 : left;
        n->sum[i / C][1][i % C] = dx > 0 ? 0 : dx < 0 ? left : right;
    }
    RN_UNROLL
    for (int i = 0; i < 2 * C; i++) {
        float above = n->sum[0][i / C][i % C], below = n->sum[1][i / C][i % C];
        n->sum[0][i / C][i % C] = dy > 0 ? below : dy < 0 ? 0 : above;
        n->sum[1][i / C][i % C] = dy > 0 ? 0 : dy < 0 ? above : below;
    }
    n->x = x;
    n->y = y;
}

// Four nests, one a corner of the levels, and the levels they are at.
template <int C> struct rn_nests {
    int lx, ly;
    struct rn_nest<C> corner[4];
};

// Adds the adjoint of one query; with `ends` nothing, and all that is held goes to memory. One copy
// of this code serves every sample: unrolled as it is, it is most of the kernel.
template <bool FIXED, int C>
RN_DEVICE void rn_spread(const struct rn_scatter_place *p, const struct rn_query *q,
                         const float (&grad)[C], bool ends, struct rn_nests<C> *n) {
    bool leaves = ends || q->x.level != n->lx || q->y.level != n->ly;
    RN_UNROLL
    for (int c = 0; c < 4; c++) {
        float weight = ends ? 0 : rn_corner_weight(q, p->planes->footprint, c);
        struct rn_nest<C> *nest = &n->corner[c];
        struct rn_corner at = {0, 0, 0, {RN_NOWHERE, 0}, {RN_NOWHERE, 0}};
        if (weight > 0) at = rn_find_corner(p->planes, q, c);
        // One lane of a texel's marks what all of them will leave there.
        if (weight > 0 && p->channel == 0 && (leaves || at.x.low != nest->x || at.y.low != nest->y))
            rn_mark_touched(p, at.lx, at.ly, at.x.low, at.y.low);
        if (leaves || weight > 0)
            rn_move_nest<FIXED>(p, n->lx + (c & 1), n->ly + (c >> 1), leaves, at.x.low, at.y.low,
                                nest);
        if (!(weight > 0)) continue;
        float fx = at.x.fraction, fy = at.y.fraction;
        RN_UNROLL
        for (int k = 0; k < 4; k++) {
            float w = weight * (k & 1 ? fx : 1 - fx) * (k & 2 ? fy : 1 - fy);
            RN_UNROLL
            for (int e = 0; e < C; e++)
                nest->sum[k >> 1][k & 1][e] += w * grad[e];
        }
    }
    n->lx = q->x.level;
    n->ly = q->y.level;
}

// No place yet.
template <int C> RN_DEVICE struct rn_nests<C> rn_nests_start() {
    struct rn_nests<C> n = {};
    for (int c = 0; c < 4; c++)
        n.corner[c].x = n.corner[c].y = RN_NOWHERE;
    return n;
}

// What a thread needs of a backpropagated sample; asked for while the one before is spread.
template <int C>
struct rn_returned_sample {
    float mid;
    uint2 grad[C / 4];
};
template <int C>
RN_DEVICE struct rn_returned_sample<C> rn_load_returned(const struct rn_cuda_batch *b, int kt,
                                                        int k, int t, int place) {
    size_t block = (size_t)(place / RN_TILE) * (size_t)kt + (size_t)k;
    struct rn_returned_sample<C> s;
    s.mid = b->returned_mid[place];
    RN_UNROLL
    for (int i = 0; i < C / 4; i++)
        s.grad[i] = b->feature_grad[block * RN_BLOCK + (size_t)(place % RN_TILE * 4 + t + i)];
    return s;
}

// Follows a piece of a ray on the plane of fragment `k`, from lane part `t` of four on.
template <bool FIXED, int C, int WORLD>
RN_DEVICE void rn_scatter_piece(const struct rn_cuda_scene *scene, const struct rn_cuda_batch *b,
                                const struct rn_cuda_gradients *to, float step,
                                struct rn_cuda_piece piece, int k, int t) {
    const struct rn_cuda_planes *planes = &scene->planes;
    int feature = 16 * k + 4 * t, kt = scene->base.inputs16;
    struct rn_cuda_return returned = b->ray_return[piece.ray];
    int first = returned.first + piece.begin, left = returned.count - piece.begin;
    int count = left < RN_PIECE ? left : RN_PIECE;
    struct rn_scatter_place p = {planes, to, feature / planes->channels,
                                 feature % planes->channels};
    if (p.plane >= planes->planes) return;
    struct rn_march_ray ray = b->rays[piece.ray];
    step *= (float)ray.stride;
    struct rn_forward_line line = {};
    struct rn_footprint_factors f = {};
    if (WORLD == RN_WORLD_FORWARD) line = b->forward[piece.ray].line;
    if (WORLD != RN_WORLD_UNBOUNDED) f = rn_factors(planes->axis[p.plane], ray.direction);
    struct rn_nests<C> nests = rn_nests_start<C>();
    struct rn_returned_sample<C> own, next = rn_load_returned<C>(b, kt, k, t, first);
    for (int i = 0; i <= count; i++) {
        own = next;
        if (i + 1 < count) next = rn_load_returned<C>(b, kt, k, t, first + i + 1);
        float grad[C];
        RN_UNROLL
        for (int c = 0; c < C; c++) {
            uint32_t pair = c % 4 < 2 ? own.grad[c / 4].x : own.grad[c / 4].y;
            grad[c] = c % 2 ? rn_high(pair) : rn_low(pair);
        }
        struct rn_sample s = rn_place<WORLD>(&ray, &line, own.mid, step);
        float lx = 0, ly = 0;
        if (planes->levels > 1) rn_levels<WORLD>(planes, p.plane, &f, &s, &ray, &lx, &ly);
        struct rn_query q = rn_query_plane(planes, p.plane, &s, lx, ly);
        rn_spread<FIXED>(&p, &q, grad, i == count, &nests);
    }
}

// One thread a (piece, fragment, C of its 16 channels).
template <bool FIXED, int C, int WORLD>
__global__ void __launch_bounds__(128)
    rn_scatter_kernel(const __grid_constant__ rn_cuda_scene scene,
                      const __grid_constant__ rn_cuda_batch batch,
                      const __grid_constant__ rn_cuda_gradients to, float step) {
    int parts = 16 / C * scene.base.inputs16, all = (int)batch.status->pieces * parts;
    if (rn_cuda_step_skipped(batch.status)) return;
    for (int i = (int)(blockIdx.x * blockDim.x + threadIdx.x); i < all;
         i += (int)(gridDim.x * blockDim.x))
        rn_scatter_piece<FIXED, C, WORLD>(&scene, &batch, &to, step, batch.pieces[i / parts],
                                          i % parts / (16 / C), i % (16 / C) * (C / 4));
}

// ---- voxels ---------------------------------------------------------------------------------

// Adds the sums to a voxel and clears them; none: -1.
template <bool FIXED>
RN_DEVICE void rn_flush_voxel(const struct rn_cuda_gradients *to, int voxel, float (&sum)[4]) {
    if (voxel < 0) return;
    to->voxels_touched[voxel / RN_VOXELS_A_MARK] = 1;
    for (int c = 0; c < RN_VOXEL_CHANNELS; c++) {
        size_t at = (size_t)voxel * RN_VOXEL_CHANNELS + (size_t)c;
        if (FIXED)
            atomicAdd(to->voxels_fixed + at,
                      (unsigned long long)(long long)((double)sum[c] * (double)RN_FIXED_ONE));
        else
            atomicAdd(to->voxels + at, sum[c]);
        sum[c] = 0;
    }
}

// One thread a (piece, corner of its samples' eight voxels): neighbours on a ray share them.
template <bool FIXED, int WORLD>
__global__ void __launch_bounds__(128)
    rn_scatter_voxels_kernel(const __grid_constant__ rn_cuda_scene scene,
                             const __grid_constant__ rn_cuda_batch batch,
                             const __grid_constant__ rn_cuda_gradients to, float step) {
    int feature = scene.planes.planes * scene.planes.channels, side = scene.voxels.side;
    int all = (int)batch.status->pieces * 8;
    if (rn_cuda_step_skipped(batch.status)) return;
    for (int i = (int)(blockIdx.x * blockDim.x + threadIdx.x); i < all;
         i += (int)(gridDim.x * blockDim.x)) {
        struct rn_cuda_piece piece = batch.pieces[i / 8];
        struct rn_cuda_return returned = batch.ray_return[piece.ray];
        struct rn_march_ray ray = batch.rays[piece.ray];
        struct rn_forward_line line = {};
        if (WORLD == RN_WORLD_FORWARD) line = batch.forward[piece.ray].line;
        int end = returned.first + returned.count, first = returned.first + piece.begin, held = -1;
        float sum[4] = {0, 0, 0, 0};
        for (int place = first; place < end && place < first + RN_PIECE; place++) {
            struct rn_returned_sample<4> own = rn_load_returned<4>(
                &batch, scene.base.inputs16, feature / 16, feature % 16 / 4, place);
            struct rn_sample s = rn_place<WORLD>(&ray, &line, own.mid, step * (float)ray.stride);
            struct rn_voxel_query q = rn_query_voxels(side, &s);
            float weight;
            int voxel = rn_voxel_corner(side, &q, i % 8, &weight);
            if (!(weight > 0)) continue;
            if (voxel != held) rn_flush_voxel<FIXED>(&to, held, sum);
            held = voxel;
            sum[0] += weight * rn_low(own.grad[0].x);
            sum[1] += weight * rn_high(own.grad[0].x);
            sum[2] += weight * rn_low(own.grad[0].y);
            sum[3] += weight * rn_high(own.grad[0].y);
        }
        rn_flush_voxel<FIXED>(&to, held, sum);
    }
}

#endif
