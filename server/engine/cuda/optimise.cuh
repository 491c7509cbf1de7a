// The update: AdamW on planes and networks, and what follows from new parameters at once: the
// pyramids' fp16 maps, the networks' fragments (paper, section 3.3; Loshchilov & Hutter 2019).
#ifndef RN_ENGINE_CUDA_OPTIMISE_CUH
#define RN_ENGINE_CUDA_OPTIMISE_CUH

#include "server/engine/cuda/gradient.cuh"
#include "server/engine/cuda/scatter.cuh"

// What the host asks of a step.
struct rn_cuda_rates {
    float network_rate, plane_rate, network_decay, plane_decay, eps;
    double beta2; // of the second moment; the first's is 0.9
    int sparse;   // blocks that no sample touched keep their parameters and moments
    float distortion;
};

// AdamW of a step, for planes or networks.
struct rn_adam {
    float rate;  // over 1 - 0.9^n
    float decay; // times the rate
    float root;  // 1 / sqrt(1 - beta2^n)
    float eps, keep, fresh;
};
struct rn_cuda_update {
    struct rn_adam planes, networks;
    int sparse;
};

struct rn_cuda_optimiser {
    struct rn_cuda_update *update; // of the step under way
    float *m, *v;                  // laid out as the parameters
    struct rn_cuda_gradients gradients;
    float4 *base_sums, *head_sums; // [RN_CHUNKS] gradients of the networks; the total in the first
};

// Of update number `n`.
RN_DEVICE struct rn_adam rn_adam_start(const struct rn_cuda_rates *o, float rate, float decay,
                                       double n) {
    struct rn_adam a = {(float)((double)rate / -expm1(n * log(0.9))),
                        rate * decay,
                        (float)(1 / sqrt(-expm1(n * log(o->beta2)))),
                        o->eps,
                        (float)o->beta2,
                        (float)(1 - o->beta2)};
    return a;
}

// One thread; the rates are a value, so that the host need not wait before it changes them.
__global__ void rn_rates_kernel(struct rn_cuda_rates o, struct rn_cuda_update *to,
                                struct rn_cuda_status *status) {
    if (threadIdx.x != 0) return;
    double n = (double)(status->updates + 1);
    to->planes = rn_adam_start(&o, o.plane_rate, o.plane_decay, n);
    to->networks = rn_adam_start(&o, o.network_rate, o.network_decay, n);
    to->sparse = o.sparse;
    status->distortion = o.distortion;
}

// One number (cpu/kernel_set.c). False where the outcome is not finite: then the parameter stays
// and its moments start anew.
RN_DEVICE bool rn_adamw(const struct rn_adam *a, float grad, float *p, float *m, float *v) {
    float g = fminf(fmaxf(grad, -1.8e19f), 1.8e19f);
    float first = *m * 0.9f + g * 0.1f, second = *v * a->keep + g * g * a->fresh;
    float change = *p * a->decay + rn_divide(a->rate * first, rn_root(second) * a->root + a->eps);
    bool finite = fabsf(*p - change) < 3e38f && second < 3e38f;
    *p = finite ? *p - change : *p;
    *m = finite ? first : 0;
    *v = finite ? second : 0;
    return finite;
}

// ---- planes ---------------------------------------------------------------------------------

// One block of threads: RN_UPDATE^2 texels of a plane, four channels a thread, of 4, 8 or 16. The
// threads of a row of texels are neighbours, so a warp has whole rows.
struct rn_update_block {
    int plane, x, y; // first texel
    int quads;       // of channels
    int texel, quad; // the thread's own, texels row after row
};

RN_DEVICE struct rn_update_block rn_update_block(const struct rn_cuda_planes *p) {
    int side = p->update_side, block = (int)blockIdx.x;
    int quads = p->channels / 4, thread = (int)threadIdx.x, shift = quads / 2; // 1, 2 or 4 quads
    struct rn_update_block b = {
        block / (side * side), block % side * RN_UPDATE, block / side % side * RN_UPDATE, quads,
        thread >> shift,       thread & (quads - 1)};
    return b;
}

// First number of four channels of a texel in the fp16 pyramids.
RN_DEVICE size_t rn_texel_at(const struct rn_cuda_planes *p, const struct rn_update_block *b,
                             int lx, int ly, int x, int y, int quad) {
    uint32_t texel =
        (uint32_t)b->plane * p->plane_texels + p->map[ly][lx] + (uint32_t)(y * (p->base >> lx) + x);
    return (size_t)texel * (size_t)p->channels + (size_t)(4 * quad);
}

// The gradient of four channels of a texel of some map.
template <bool FIXED>
RN_DEVICE void rn_load_gradient(const struct rn_cuda_gradients *g, size_t at, float ret[4]) {
    if (FIXED) {
        for (int c = 0; c < 4; c++)
            ret[c] = (float)((double)(long long)g->fixed[at + c] / (double)RN_FIXED_ONE);
    } else {
        rn_add_texel(g->half[at / 4], 1 / RN_SCATTER_HEADROOM, ret);
    }
}

// The base texel's gradient: every map's texel above it hands down 2^-(lx + ly) of its own. The
// maps of two levels by four are asked for before one is used, those of the last level again where
// there are no more.
template <bool FIXED>
RN_DEVICE void rn_pull_down(const struct rn_cuda_planes *p, const struct rn_cuda_gradients *g,
                            const struct rn_update_block *b, int x, int y, int quad, float sum[4]) {
    int top = p->levels - 1;
    float weight_y = 1;
    for (int first_y = 0; first_y <= top; first_y += 2, weight_y *= 0.25f) {
        float weight_x = weight_y;
        for (int first_x = 0; first_x <= top; first_x += 4, weight_x *= 0.0625f) {
            float found[8][4] = {};
            RN_UNROLL
            for (int k = 0; k < 8; k++) {
                int lx = first_x + k % 4 < top ? first_x + k % 4 : top;
                int ly = first_y + k / 4 < top ? first_y + k / 4 : top;
                rn_load_gradient<FIXED>(g, rn_texel_at(p, b, lx, ly, x >> lx, y >> ly, quad),
                                        found[k]);
            }
            RN_UNROLL
            for (int k = 0; k < 8; k++) {
                int lx = first_x + k % 4, ly = first_y + k / 4;
                bool exists = lx <= top && ly <= top && rn_cuda_map_exists(p->footprint, lx, ly);
                float weight = weight_x / (float)(1 << (k % 4 + k / 4));
                for (int c = 0; c < 4; c++)
                    sum[c] += exists ? weight * found[k][c] : 0;
            }
        }
    }
}

// Where a block's pooled parameters go. `read`: the gradients that the block has read, and no other
// block reads, are cleared on the way.
struct rn_pool {
    const struct rn_cuda_scene *scene;
    const struct rn_cuda_gradients *gradients;
    struct rn_update_block block;
    bool read;
};

// Four channels of a texel of a fine map, (x, y) within the block.
template <bool FIXED>
RN_DEVICE void rn_put_texel(const struct rn_pool *to, int lx, int ly, int x, int y, int quad,
                            const float value[4]) {
    const struct rn_update_block *b = &to->block;
    size_t at =
        rn_texel_at(&to->scene->planes, b, lx, ly, (b->x >> lx) + x, (b->y >> ly) + y, quad);
    *(uint2 *)(to->scene->texels + at) =
        uint2{rn_pack(value[0], value[1]), rn_pack(value[2], value[3])};
    for (int c = 0; FIXED && to->read && c < 4; c++)
        to->gradients->fixed[at + c] = 0;
    if (!FIXED && to->read) to->gradients->half[at / 4] = uint2{0, 0};
}

// Four neighbouring numbers at once, 16-byte aligned as texels of four channels are.
RN_DEVICE void rn_load4(const float *from, float to[4]) {
    float4 v = *(const float4 *)from;
    to[0] = v.x;
    to[1] = v.y;
    to[2] = v.z;
    to[3] = v.w;
}
RN_DEVICE void rn_store4(const float from[4], float *to) {
    *(float4 *)to = float4{from[0], from[1], from[2], from[3]};
}

// The block's rows, pooled along x: of every row the columns of level 0, 1, 2 and 3 one after the
// other, [row][column][channel].
#define RN_COLUMNS (2 * RN_UPDATE - 1)
RN_DEVICE int rn_first_column(int lx) {
    return 2 * RN_UPDATE - (2 * RN_UPDATE >> lx);
}
RN_DEVICE float *rn_block_rows() {
    RN_SHARED __align__(16) float rows[RN_UPDATE * RN_COLUMNS * 16];
    return rows;
}

// Pools one column of those rows along y into the maps of the fine levels. One thread four channels
// of a column.
template <bool FIXED> RN_DEVICE void rn_pool_column(const struct rn_pool *to) {
    const struct rn_cuda_planes *p = &to->scene->planes;
    int quads = to->block.quads, column = to->block.texel, quad = to->block.quad;
    int lx = 0;
    while (lx < RN_FINE_LEVELS && column >= rn_first_column(lx + 1))
        lx++;
    if (lx >= RN_FINE_LEVELS || lx >= p->levels) return;
    int x = column - rn_first_column(lx);
    float mean[RN_UPDATE][4];
    RN_UNROLL
    for (int y = 0; y < RN_UPDATE; y++)
        rn_load4(rn_block_rows() + ((y * RN_COLUMNS + column) * quads + quad) * 4, mean[y]);
    RN_UNROLL
    for (int ly = 1; ly < RN_FINE_LEVELS; ly++)
        RN_UNROLL
    for (int y = 0; y < (RN_UPDATE >> ly); y++) {
        for (int c = 0; c < 4; c++)
            mean[y][c] = 0.5f * (mean[2 * y][c] + mean[2 * y + 1][c]);
        if (ly < p->levels && rn_cuda_map_exists(p->footprint, lx, ly))
            rn_put_texel<FIXED>(to, lx, ly, x, y, quad, mean[y]);
    }
}

// Pools the block's parameters into the maps of the fine levels: rows by shuffles, then columns.
// `value`: the thread's own.
template <bool FIXED> RN_DEVICE void rn_pool_block(const struct rn_pool *to, const float value[4]) {
    const struct rn_cuda_planes *p = &to->scene->planes;
    int quads = to->block.quads, texel = to->block.texel, quad = to->block.quad;
    int x = texel % RN_UPDATE, y = texel / RN_UPDATE;
    float row[RN_FINE_LEVELS][4];
    RN_UNROLL
    for (int lx = 0; lx < RN_FINE_LEVELS; lx++) {
        for (int c = 0; c < 4; c++) {
            row[lx][c] = lx == 0 ? value[c] : row[lx - 1][c];
            if (lx > 0)
                row[lx][c] = 0.5f * (row[lx][c] + rn_shuffle_xor(row[lx][c], quads << (lx - 1)));
        }
        int column = y * RN_COLUMNS + rn_first_column(lx) + (x >> lx);
        if ((x & ((1 << lx) - 1)) == 0)
            rn_store4(row[lx], rn_block_rows() + (column * quads + quad) * 4);
    }
    __syncthreads(); // and all have read their gradients
    RN_UNROLL
    for (int lx = 0; lx < RN_FINE_LEVELS; lx++)
        if (lx < p->levels && rn_cuda_map_exists(p->footprint, lx, 0) && (x & ((1 << lx) - 1)) == 0)
            rn_put_texel<FIXED>(to, lx, 0, x >> lx, y, quad, row[lx]);
    if (p->levels > 1) rn_pool_column<FIXED>(to);
}

// The parameters of one thread: index of the first of four channels.
RN_DEVICE size_t rn_parameter_at(const struct rn_cuda_planes *p, const struct rn_update_block *b) {
    int texel = b->texel;
    size_t row = (size_t)b->plane * (size_t)p->base + (size_t)(b->y + texel / RN_UPDATE);
    return (row * (size_t)p->base + (size_t)(b->x + texel % RN_UPDATE)) * (size_t)p->channels +
           (size_t)(4 * b->quad);
}

// Four parameters of a texel and their moments, asked for before their gradient is.
struct rn_update_texel {
    size_t at;
    float value[4], m[4], v[4];
};
RN_DEVICE struct rn_update_texel rn_load_texel(const struct rn_cuda_scene *scene,
                                               const struct rn_cuda_optimiser *o, size_t at) {
    struct rn_update_texel t;
    t.at = at;
    rn_load4(scene->parameters + at, t.value);
    rn_load4(o->m + at, t.m);
    rn_load4(o->v + at, t.v);
    return t;
}

// AdamW; a gradient that overflowed is left out.
RN_DEVICE void rn_update_texel(const struct rn_cuda_scene *scene, const struct rn_cuda_optimiser *o,
                               struct rn_cuda_status *status, float grad[4],
                               struct rn_update_texel *t) {
    float scale = 1 / (status->gradient_scale * (float)status->weight);
    struct rn_adam adam = o->update->planes;
    for (int c = 0; c < 4; c++) {
        if (!(fabsf(grad[c]) < 3e38f)) {
            grad[c] = 0;
            status->overflowed = 1;
        }
        if (!rn_adamw(&adam, grad[c] * scale, &t->value[c], &t->m[c], &t->v[c]))
            atomicAdd((unsigned long long *)&status->nonfinite_numbers, 1ull);
    }
    rn_store4(t->value, scene->parameters + t->at);
    rn_store4(t->m, o->m + t->at);
    rn_store4(t->v, o->v + t->at);
}

// Pull-down, AdamW and pooling of one block a block of threads; 64 threads times channels / 4.
template <bool FIXED>
__global__ void __launch_bounds__(256, 4)
    rn_update_planes_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_optimiser o,
                            struct rn_cuda_status *status) {
    const struct rn_cuda_planes *p = &scene.planes;
    struct rn_update_block b = rn_update_block(p);
    bool touched = o.gradients.touched[blockIdx.x] != 0, sparse = o.update->sparse != 0;
    if (rn_cuda_step_skipped(status) | (sparse & !touched)) return; // all asked for at once
    int texel = b.texel, quad = b.quad;
    float grad[4] = {0, 0, 0, 0};
    struct rn_update_texel own = rn_load_texel(&scene, &o, rn_parameter_at(p, &b));
    if (touched)
        rn_pull_down<FIXED>(p, &o.gradients, &b, b.x + texel % RN_UPDATE, b.y + texel / RN_UPDATE,
                            quad, grad);
    rn_update_texel(&scene, &o, status, grad, &own);
    struct rn_pool to = {&scene, &o.gradients, b, touched};
    rn_pool_block<FIXED>(&to, own.value);
    if (touched && threadIdx.x == 0) o.gradients.touched[blockIdx.x] = 0;
}

// Pooling alone, for parameters that came from elsewhere.
__global__ void __launch_bounds__(256)
    rn_build_kernel(const __grid_constant__ rn_cuda_scene scene) {
    struct rn_update_block b = rn_update_block(&scene.planes);
    size_t at = rn_parameter_at(&scene.planes, &b);
    float value[4];
    rn_load4(scene.parameters + at, value);
    struct rn_pool to = {&scene, NULL, b, false};
    rn_pool_block<false>(&to, value);
}

// Draws the texels of one colour of a chessboard towards their neighbours, all of the other one
// (cpu/smooth.h). One thread four channels of a texel.
__global__ void __launch_bounds__(256)
    rn_smooth_kernel(const __grid_constant__ rn_cuda_scene scene, float share, int odd) {
    const struct rn_cuda_planes *p = &scene.planes;
    int quads = p->channels / 4, side = p->base, half = (side + 1) / 2;
    int i = (int)(blockIdx.x * blockDim.x + threadIdx.x), quad = i % quads;
    int y = i / quads / half % side, x = 2 * (i / quads % half) + (y + odd) % 2;
    int plane = i / quads / half / side;
    if (plane >= p->planes || x >= side) return;
    float4 *at = (float4 *)scene.parameters + ((size_t)plane * side + y) * side * quads;
    at += x * quads + quad;
    float4 left = at[x > 0 ? -quads : 0], right = at[x + 1 < side ? quads : 0];
    float4 above = at[y > 0 ? -side * quads : 0], below = at[y + 1 < side ? side * quads : 0];
    float4 here = *at;
    here.x += share * ((above.x + below.x) + (left.x + right.x) - 4 * here.x);
    here.y += share * ((above.y + below.y) + (left.y + right.y) - 4 * here.y);
    here.z += share * ((above.z + below.z) + (left.z + right.z) - 4 * here.z);
    here.w += share * ((above.w + below.w) + (left.w + right.w) - 4 * here.w);
    *at = here;
}

// Maps beyond the fine levels, from the coarsest fine map that reaches as far; clears their
// gradients where there are any. One thread four channels of a texel.
template <bool FIXED>
__global__ void __launch_bounds__(256)
    rn_coarse_kernel(const __grid_constant__ rn_cuda_scene scene,
                     const __grid_constant__ rn_cuda_gradients g) {
    const struct rn_cuda_planes *p = &scene.planes;
    int quads = p->channels / 4, top = RN_FINE_LEVELS - 1;
    for (int map = 0; map < p->levels * p->levels; map++) {
        int lx = map % p->levels, ly = map / p->levels, w = p->base >> lx, h = p->base >> ly;
        if (!rn_cuda_map_exists(p->footprint, lx, ly) || (lx <= top && ly <= top)) continue;
        int dx = lx > top ? lx - top : 0, dy = ly > top ? ly - top : 0;
        for (int i = (int)(blockIdx.x * blockDim.x + threadIdx.x); i < p->planes * w * h * quads;
             i += (int)(gridDim.x * blockDim.x)) {
            int quad = i % quads, x = i / quads % w, y = i / quads / w % h;
            struct rn_update_block b = {i / quads / w / h, 0, 0, quads};
            float sum[4] = {0, 0, 0, 0}, weight = 1 / (float)(1 << (dx + dy));
            for (int k = 0; k < 1 << (dx + dy); k++) {
                size_t from =
                    rn_texel_at(p, &b, lx - dx, ly - dy, (x << dx) + (k & ((1 << dx) - 1)),
                                (y << dy) + (k >> dx), quad);
                rn_add_texel(*(const uint2 *)(scene.texels + from), weight, sum);
            }
            size_t at = rn_texel_at(p, &b, lx, ly, x, y, quad);
            *(uint2 *)(scene.texels + at) = uint2{rn_pack(sum[0], sum[1]), rn_pack(sum[2], sum[3])};
            for (int c = 0; FIXED && g.fixed && c < 4; c++)
                g.fixed[at + c] = 0;
            if (!FIXED && g.half) g.half[at / 4] = uint2{0, 0};
        }
    }
}

// ---- voxels ---------------------------------------------------------------------------------

// AdamW of the voxels, and of the zeros behind them; one thread one. A warp has whole marks.
template <bool FIXED>
__global__ void __launch_bounds__(256)
    rn_update_voxels_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_optimiser o,
                            struct rn_cuda_status *status, size_t first, int count) {
    int i = (int)(blockIdx.x * blockDim.x + threadIdx.x);
    bool is = i < count, touched = is && o.gradients.voxels_touched[i / RN_VOXELS_A_MARK] != 0;
    __syncwarp(); // all have read the mark
    if (rn_cuda_step_skipped(status) || !is || (o.update->sparse && !touched)) return;
    size_t own = (size_t)i * RN_VOXEL_CHANNELS, at = first + own;
    float scale = 1 / (status->gradient_scale * (float)status->weight), value[4], m[4], v[4];
    float grad[4] = {0, 0, 0, 0};
    struct rn_adam adam = o.update->planes;
    rn_load4(scene.parameters + at, value);
    rn_load4(o.m + at, m);
    rn_load4(o.v + at, v);
    for (int c = 0; c < 4 && touched; c++) {
        if (FIXED) {
            long long fixed = (long long)o.gradients.voxels_fixed[own + c];
            grad[c] = (float)((double)fixed / (double)RN_FIXED_ONE);
            o.gradients.voxels_fixed[own + c] = 0;
        } else {
            grad[c] = o.gradients.voxels[own + c];
            o.gradients.voxels[own + c] = 0;
        }
    }
    for (int c = 0; c < 4; c++)
        if (!rn_adamw(&adam, grad[c] * scale, &value[c], &m[c], &v[c]))
            atomicAdd((unsigned long long *)&status->nonfinite_numbers, 1ull);
    rn_store4(value, scene.parameters + at);
    rn_store4(m, o.m + at);
    rn_store4(v, o.v + at);
    if (touched) o.gradients.voxels_touched[i / RN_VOXELS_A_MARK] = 0;
}

// Draws the voxels of one colour of a chessboard towards their six neighbours (smooth_voxels of
// cpu/voxels.h). One thread a voxel.
__global__ void __launch_bounds__(256)
    rn_smooth_voxels_kernel(float4 *voxels, int side, float share, int odd) {
    int i = (int)(blockIdx.x * blockDim.x + threadIdx.x), slice = side * side;
    int x = i % side, y = i / side % side, z = i / slice;
    if (z >= side || (x + y + z) % 2 != odd) return;
    float4 *at = voxels + i, here = *at;
    const float4 around[6] = {at[x > 0 ? -1 : 0],     at[x + 1 < side ? 1 : 0],
                              at[y > 0 ? -side : 0],  at[y + 1 < side ? side : 0],
                              at[z > 0 ? -slice : 0], at[z + 1 < side ? slice : 0]};
    float4 sum = {0, 0, 0, 0};
    RN_UNROLL
    for (int k = 0; k < 6; k++) {
        sum.x += around[k].x;
        sum.y += around[k].y;
        sum.z += around[k].z;
        sum.w += around[k].w;
    }
    here.x += share * (sum.x - 6 * here.x);
    here.y += share * (sum.y - 6 * here.y);
    here.z += share * (sum.z - 6 * here.z);
    here.w += share * (sum.w - 6 * here.w);
    *at = here;
}

// ---- networks -------------------------------------------------------------------------------

// Layer of number i of a network's gradient.
RN_DEVICE int rn_layer_of(const struct rn_cuda_network *n, size_t i) {
    int layer = n->hidden;
    while (layer > 0 && i < (size_t)n->packed[layer] * 8)
        layer--;
    return layer;
}

// Adds the chunks' sums in order into the first; a sum that is not finite rejects the step.
__global__ void __launch_bounds__(256)
    rn_reduce_kernel(const __grid_constant__ rn_cuda_network n,
                     const __grid_constant__ rn_cuda_chunks chunks, float *sums,
                     struct rn_cuda_status *status) {
    size_t count = rn_cuda_gradient_count(&n);
    for (size_t i = blockIdx.x * blockDim.x + threadIdx.x; i < count; i += gridDim.x * blockDim.x) {
        int layer = rn_layer_of(&n, i), parts = chunks.first[layer + 1] - chunks.first[layer];
        float sum = 0;
        RN_UNROLL_8
        for (int chunk = 0; chunk < parts; chunk++)
            sum += sums[(size_t)chunk * count + i];
        if (!(fabsf(sum) < 3e38f)) status->rejected = 1;
        sums[i] = sum;
    }
}

RN_DEVICE void rn_store_half(uint4 *fragments, size_t at, float value) {
    ((uint16_t *)fragments)[at] = (uint16_t)rn_pack(value, 0);
}

// Number i of a network's gradient: its layer, and the index of its parameter; -1 for padding.
RN_DEVICE int rn_network_element(const struct rn_cuda_network *n, bool head, bool per_ray, size_t i,
                                 int *ret_layer, int *ret_k, int *ret_n) {
    int layer = rn_layer_of(n, i);
    rn_cuda_gradient_element(i - (size_t)n->packed[layer] * 8, rn_cuda_layer_n16(n, layer), ret_k,
                             ret_n);
    *ret_layer = layer;
    return rn_cuda_weight_index(n, head, per_ray, layer, *ret_k, *ret_n);
}

// AdamW (where `o.m` is not NULL) and the fragments of one network. One thread a number.
__global__ void __launch_bounds__(256)
    rn_update_network_kernel(const __grid_constant__ rn_cuda_scene scene,
                             const __grid_constant__ rn_cuda_optimiser o,
                             struct rn_cuda_status *status, bool head) {
    const struct rn_cuda_network *n = head ? &scene.head : &scene.base;
    size_t first = scene.plane_count, packed = head ? scene.base.packed_count : 0;
    if (head)
        first +=
            scene.base.source[scene.base.hidden] + (size_t)(scene.base.width * scene.base.outputs);
    if (o.m && rn_cuda_step_skipped(status)) return;
    const float *sums = (const float *)(head ? o.head_sums : o.base_sums);
    for (size_t i = blockIdx.x * blockDim.x + threadIdx.x; i < rn_cuda_gradient_count(n);
         i += gridDim.x * blockDim.x) {
        int layer, k, column;
        int index = rn_network_element(n, head, scene.per_ray, i, &layer, &k, &column);
        if (index < 0) continue;
        size_t at = first + (size_t)index;
        float value = scene.parameters[at];
        if (o.m) {
            float scale = 1 / (status->gradient_scale * (float)status->weight);
            struct rn_adam adam = o.update->networks;
            if (!rn_adamw(&adam, sums[i] * scale, &value, o.m + at, o.v + at))
                atomicAdd((unsigned long long *)&status->nonfinite_numbers, 1ull);
            scene.parameters[at] = value;
        }
        uint4 *forward = scene.forward + packed + n->packed[layer];
        uint4 *backward = scene.backward + packed + n->packed[layer];
        rn_store_half(forward, rn_cuda_fragment_place(k, column, rn_cuda_layer_k16(n, layer)),
                      value);
        rn_store_half(backward, rn_cuda_fragment_place(column, k, rn_cuda_layer_n16(n, layer)),
                      value);
    }
}

#endif
