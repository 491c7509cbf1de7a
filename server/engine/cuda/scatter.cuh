// The fetch's adjoint: feature gradients to the texels they came from. A thread follows a piece of
// a ray on one plane and one corner of its levels, and holds the sums of the four texels around it;
// what it leaves behind goes to memory, so that neighbouring samples' texels are written once.
#ifndef RN_ENGINE_CUDA_SCATTER_CUH
#define RN_ENGINE_CUDA_SCATTER_CUH

#include "server/engine/cuda/encode.cuh"
#include "server/engine/cuda/network.cuh"

#define RN_AHEAD 2 // samples that are asked for before it is their turn
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

// The four texels of a map around a ray and their sums, [row][column][channel], each in the place
// of its coordinates' parities: where the ray comes to texels that it shares with those before,
// they are where they were.
#define RN_NOWHERE -4
struct rn_nest {
    int lx, ly, x[2], y[2]; // of the map; of texels; RN_NOWHERE before there is one
    int marked[2];          // blocks of the first and the last texel (rn_mark_touched)
    float sum[2][2][4];
};

// Where one thread scatters.
struct rn_scatter_place {
    const struct rn_cuda_planes *planes;
    const struct rn_cuda_gradients *to;
    int plane, channel;
};

// Marks the blocks of the four texels of a map from (x, y) on, which are one, as nearly always;
// not again while they stay those of `marked`, the first and the last.
RN_DEVICE void rn_mark_touched(const struct rn_scatter_place *p, int lx, int ly, int x, int y,
                               int (&marked)[2]) {
    int side = p->planes->update_side, last = side * RN_UPDATE - 1;
    int x0 = (x << lx) / RN_UPDATE, y0 = (y << ly) / RN_UPDATE;
    int x1 = ((x + 2) << lx) - 1, y1 = ((y + 2) << ly) - 1;
    uint8_t *touched = p->to->touched + (size_t)p->plane * (size_t)(side * side);
    x1 = (x1 < last ? x1 : last) / RN_UPDATE;
    y1 = (y1 < last ? y1 : last) / RN_UPDATE;
    if (marked[0] == y0 * side + x0 && marked[1] == y1 * side + x1) return;
    marked[0] = y0 * side + x0;
    marked[1] = y1 * side + x1;
    RN_ROLLED
    for (int j = y0; j <= y1; j++)
        RN_ROLLED
    for (int i = x0; i <= x1; i++)
        touched[j * side + i] = 1;
}

// Adds sums of gradients to four channels of a texel of the fp16 maps.
RN_DEVICE void rn_add_half(const struct rn_cuda_gradients *to, size_t at, const float (&sum)[4]) {
    rn_red_half4(to->half + at / 4,
                 rn_pack(sum[0] * RN_SCATTER_HEADROOM, sum[1] * RN_SCATTER_HEADROOM),
                 rn_pack(sum[2] * RN_SCATTER_HEADROOM, sum[3] * RN_SCATTER_HEADROOM));
}

// Adds the sums to texel (x, y) of map (lx, ly) and clears them.
template <bool FIXED>
RN_DEVICE void rn_flush(const struct rn_scatter_place *p, int lx, int ly, int x, int y,
                        float (&sum)[4]) {
    bool some = false;
    RN_UNROLL
    for (int c = 0; c < 4; c++)
        some |= !(sum[c] == 0);
    if (!some) return;
    uint32_t texel = (uint32_t)p->plane * p->planes->plane_texels + p->planes->map[ly][lx] +
                     (uint32_t)(y * (p->planes->base >> lx) + x);
    size_t at = (size_t)texel * (size_t)p->planes->channels + (size_t)p->channel;
    if (FIXED) {
        for (int c = 0; c < 4; c++)
            atomicAdd(p->to->fixed + at + c,
                      (unsigned long long)(long long)((double)sum[c] * (double)RN_FIXED_ONE));
    } else {
        rn_add_half(p->to, at, sum);
    }
    RN_UNROLL
    for (int c = 0; c < 4; c++)
        sum[c] = 0;
}

// The even and the odd one of two neighbouring coordinates.
RN_DEVICE void rn_by_parity(int low, int (&ret)[2]) {
    ret[0] = low + (low & 1);
    ret[1] = low + 1 - (low & 1);
}

// Adds the adjoint of one corner of a query; with `ends` nothing, and all that is held goes to
// memory.
template <bool FIXED>
RN_DEVICE void rn_spread(const struct rn_scatter_place *p, const struct rn_query *q, int corner,
                         const float (&grad)[4], bool ends, struct rn_nest *n) {
    float weight = ends ? 0 : rn_corner_weight(q, p->planes->footprint, corner);
    bool takes = weight > 0, moved = false;
    if (!takes && !ends) return;
    struct rn_corner at = rn_find_corner(p->planes, q, takes ? corner : 0);
    bool leaves = ends || at.lx != n->lx || at.ly != n->ly;
    int x[2], y[2];
    rn_by_parity(at.x.low, x);
    rn_by_parity(at.y.low, y);
    RN_UNROLL
    for (int k = 0; k < 4; k++) {
        bool stays = !leaves && x[k & 1] == n->x[k & 1] && y[k >> 1] == n->y[k >> 1];
        if (!stays)
            rn_flush<FIXED>(p, n->lx, n->ly, n->x[k & 1], n->y[k >> 1], n->sum[k >> 1][k & 1]);
        moved |= !stays;
    }
    if (!takes) return;
    // One lane of a texel's marks what all of them will leave there.
    if (moved && p->channel == 0) rn_mark_touched(p, at.lx, at.ly, at.x.low, at.y.low, n->marked);
    n->lx = at.lx;
    n->ly = at.ly;
    RN_UNROLL
    for (int k = 0; k < 2; k++) {
        n->x[k] = x[k];
        n->y[k] = y[k];
    }
    RN_UNROLL
    for (int k = 0; k < 4; k++) {
        float fx = x[k & 1] == at.x.low ? 1 - at.x.fraction : at.x.fraction;
        float fy = y[k >> 1] == at.y.low ? 1 - at.y.fraction : at.y.fraction;
        float w = weight * fx * fy;
        RN_UNROLL
        for (int e = 0; e < 4; e++)
            n->sum[k >> 1][k & 1][e] += w * grad[e];
    }
}

// No place yet.
RN_DEVICE struct rn_nest rn_nest_start() {
    struct rn_nest n = {};
    n.lx = n.ly = n.x[0] = n.x[1] = n.y[0] = n.y[1] = n.marked[0] = n.marked[1] = RN_NOWHERE;
    return n;
}

// The gradients of four features from `feature` on, of a backpropagated sample.
RN_DEVICE uint2 rn_load_returned(const struct rn_cuda_batch *b, int kt, int feature, int place) {
    struct rn_cuda_feature_place at = rn_cuda_place_of_features(feature);
    size_t block = (size_t)(place / RN_TILE) * (size_t)kt + (size_t)at.fragment;
    return b->feature_grad[block * RN_BLOCK + (size_t)(place % RN_TILE * 4 + at.part)];
}

// Where the backpropagated samples look on the planes, [sample][plane]: coordinates, and levels.
// One thread one of them: what is found here once is needed once a corner.
template <int WORLD>
__global__ void __launch_bounds__(256)
    rn_queries_kernel(const __grid_constant__ rn_cuda_scene scene,
                      const __grid_constant__ rn_cuda_batch b, float step) {
    const struct rn_cuda_planes *p = &scene.planes;
    int i = (int)(blockIdx.x * blockDim.x + threadIdx.x), place = i / p->planes;
    int plane = i - place * p->planes;
    if (rn_cuda_step_skipped(b.status) || place >= (int)b.status->returned) return;
    int index = b.tile_ray[b.returned[place] / RN_TILE];
    struct rn_march_ray ray = b.rays[index];
    struct rn_forward_line line = {};
    struct rn_footprint_factors f = {};
    if (WORLD == RN_WORLD_FORWARD) line = b.forward[index].line;
    if (WORLD != RN_WORLD_UNBOUNDED) f = rn_factors(p->axis[plane], ray.direction);
    struct rn_sample s =
        rn_place<WORLD>(&ray, &line, b.returned_mid[place], step * (float)ray.stride);
    float lx = 0, ly = 0;
    if (p->levels > 1) rn_levels<WORLD>(p, plane, &f, &s, &ray, &lx, &ly);
    struct rn_query q = rn_query_plane(p, plane, &s, 0, 0);
    b.queries[i] = float4{q.x.p, q.y.p, lx, ly};
}

// What is known of a sample before it is its turn.
struct rn_returned_sample {
    float4 query;
    uint2 gradient;
};

// Follows a piece of a ray with four channels of a plane, on one corner's maps.
template <bool FIXED>
RN_DEVICE void rn_scatter_piece(const struct rn_scatter_place *p, const struct rn_cuda_batch *b,
                                int kt, struct rn_cuda_piece piece, int corner) {
    struct rn_cuda_return returned = b->ray_return[piece.ray];
    int first = returned.first + piece.begin, left = returned.count - piece.begin;
    int count = left < RN_PIECE ? left : RN_PIECE, planes = p->planes->planes;
    int feature = p->plane * p->planes->channels + p->channel;
    const float4 *queries = b->queries + (size_t)first * (size_t)planes + p->plane;
    struct rn_nest nest = rn_nest_start();
    struct rn_returned_sample ahead[RN_AHEAD];
    RN_UNROLL
    for (int k = 0; k < RN_AHEAD; k++) {
        int i = k < count ? k : count - 1;
        ahead[k].query = queries[(size_t)i * (size_t)planes];
        ahead[k].gradient = rn_load_returned(b, kt, feature, first + i);
    }
    RN_ROLLED
    for (int begin = 0; begin <= count; begin += RN_AHEAD) {
        RN_UNROLL
        for (int k = 0; k < RN_AHEAD; k++) {
            struct rn_returned_sample own = ahead[k];
            int i = begin + k, next = i + RN_AHEAD;
            if (next < count) {
                ahead[k].query = queries[(size_t)next * (size_t)planes];
                ahead[k].gradient = rn_load_returned(b, kt, feature, first + next);
            }
            if (i > count) break;
            const float grad[4] = {rn_low(own.gradient.x), rn_high(own.gradient.x),
                                   rn_low(own.gradient.y), rn_high(own.gradient.y)};
            float4 at = own.query;
            struct rn_query q = rn_query_at(at.x, at.y, at.z, at.w);
            rn_spread<FIXED>(p, &q, corner, grad, i == count, &nest);
        }
    }
}

// One thread a (corner, piece, plane, four of its channels): a warp has one corner, neighbouring
// lanes a texel.
template <bool FIXED>
__global__ void __launch_bounds__(128)
    rn_scatter_kernel(const __grid_constant__ rn_cuda_scene scene,
                      const __grid_constant__ rn_cuda_batch batch,
                      const __grid_constant__ rn_cuda_gradients to) {
    const struct rn_cuda_planes *planes = &scene.planes;
    int parts = planes->channels / 4, of_piece = planes->planes * parts;
    int of_corner = (int)batch.status->pieces * of_piece;
    int all = of_corner * (planes->levels > 1 ? 4 : 1);
    if (rn_cuda_step_skipped(batch.status)) return;
    for (int i = (int)(blockIdx.x * blockDim.x + threadIdx.x); i < all;
         i += (int)(gridDim.x * blockDim.x)) {
        int corner = i / of_corner, of = i - corner * of_corner, piece = of / of_piece;
        int part = of - piece * of_piece;
        if (planes->footprint == RN_FOOTPRINT_MIP && (corner == 1 || corner == 2)) continue;
        struct rn_scatter_place place = {planes, &to, part / parts, part % parts * 4};
        rn_scatter_piece<FIXED>(&place, &batch, scene.base.inputs16, batch.pieces[piece], corner);
    }
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
            uint2 own = rn_load_returned(&batch, scene.base.inputs16, feature, place);
            struct rn_sample s =
                rn_place<WORLD>(&ray, &line, batch.returned_mid[place], step * (float)ray.stride);
            struct rn_voxel_query q = rn_query_voxels(side, &s);
            float weight;
            int voxel = rn_voxel_corner(side, &q, i % 8, &weight);
            if (!(weight > 0)) continue;
            if (voxel != held) rn_flush_voxel<FIXED>(&to, held, sum);
            held = voxel;
            sum[0] += weight * rn_low(own.x);
            sum[1] += weight * rn_high(own.x);
            sum[2] += weight * rn_low(own.y);
            sum[3] += weight * rn_high(own.y);
        }
        rn_flush_voxel<FIXED>(&to, held, sum);
    }
}

#endif
