// Planes whose levels do not halve evenly (field/ripmap.h): what a texel of the base gives to each
// level stands in a table. A thread a texel, none of them together: slower than blocks of texels.
#ifndef RN_ENGINE_CUDA_UNEVEN_CUH
#define RN_ENGINE_CUDA_UNEVEN_CUH

#include "server/engine/cuda/optimise.cuh"

// Four channels of a texel; one a thread.
struct rn_uneven_texel {
    int plane, x, y, quad;
};
// The i-th of a map of `width` x `height`, of all planes; plane after the last: there is none.
RN_DEVICE struct rn_uneven_texel rn_uneven_texel(const struct rn_cuda_planes *p, int i, int width,
                                                 int height) {
    int quads = p->channels / 4, texel = i / quads;
    struct rn_uneven_texel t = {texel / width / height, texel % width, texel / width % height,
                                i % quads};
    return t;
}

RN_DEVICE const struct rn_cuda_share *rn_shares_of(const struct rn_cuda_planes *p, int level) {
    return p->shares + (size_t)level * (size_t)p->base;
}

// Adds what a map hands down to a texel of the base.
template <bool FIXED>
RN_DEVICE void rn_pull_down_uneven(const struct rn_cuda_planes *p,
                                   const struct rn_cuda_gradients *g,
                                   const struct rn_uneven_texel *t, int lx, int ly, float sum[4]) {
    struct rn_cuda_share x = rn_shares_of(p, lx)[t->x], y = rn_shares_of(p, ly)[t->y];
    struct rn_update_block b = {t->plane, 0, 0, p->channels / 4, 0, 0};
    for (int k = 0; k < 4; k++) {
        float weight = x.weight[k % 2] * y.weight[k / 2], found[4] = {0, 0, 0, 0};
        if (!(weight > 0)) continue;
        rn_load_gradient<FIXED>(
            g, rn_texel_at(p, &b, lx, ly, x.first + k % 2, y.first + k / 2, t->quad), found);
        for (int c = 0; c < 4; c++)
            sum[c] += weight * found[c];
    }
}

// Pull-down and AdamW of every texel, as on the CPU: these planes have no tiles. The gradients stay
// until the maps are made: other texels read them too.
template <bool FIXED>
__global__ void __launch_bounds__(256)
    rn_update_uneven_kernel(const __grid_constant__ rn_cuda_scene scene,
                            const __grid_constant__ rn_cuda_optimiser o,
                            struct rn_cuda_status *status) {
    const struct rn_cuda_planes *p = &scene.planes;
    int i = (int)(blockIdx.x * blockDim.x + threadIdx.x);
    struct rn_uneven_texel t = rn_uneven_texel(p, i, p->base, p->base);
    float grad[4] = {0, 0, 0, 0};
    if (t.plane >= p->planes || rn_cuda_step_skipped(status)) return;
    for (int map = 0; map < p->levels * p->levels; map++)
        if (rn_cuda_map_exists(p->footprint, map % p->levels, map / p->levels))
            rn_pull_down_uneven<FIXED>(p, &o.gradients, &t, map % p->levels, map / p->levels, grad);
    struct rn_update_texel own = rn_load_texel(&scene, &o, 4 * (size_t)i);
    rn_update_texel(&scene, &o, status, grad, &own);
}

// The weight of a texel of the base in texel `of` of a level.
RN_DEVICE float rn_weight_in(const struct rn_cuda_share *share, int of) {
    return share->first == of ? share->weight[0] : share->first + 1 == of ? share->weight[1] : 0;
}

// All maps, from the parameters themselves; clears the gradients that were read, where there are
// any and the step was taken.
template <bool FIXED>
__global__ void __launch_bounds__(256)
    rn_maps_uneven_kernel(const __grid_constant__ rn_cuda_scene scene,
                          const __grid_constant__ rn_cuda_gradients g,
                          const struct rn_cuda_status *status, int lx, int ly) {
    const struct rn_cuda_planes *p = &scene.planes;
    int i = (int)(blockIdx.x * blockDim.x + threadIdx.x), quads = p->channels / 4;
    struct rn_uneven_texel t = rn_uneven_texel(p, i, p->base >> lx, p->base >> ly);
    if (t.plane >= p->planes || (status && rn_cuda_step_skipped(status))) return;
    int x1 = (t.x + 2) << lx, y1 = (t.y + 2) << ly;
    float sum[4] = {0, 0, 0, 0}, value[4];
    for (int y = t.y << ly; y < y1 && y < p->base; y++) {
        float down = rn_weight_in(rn_shares_of(p, ly) + y, t.y);
        for (int x = t.x << lx; x < x1 && x < p->base && down > 0; x++) {
            float weight = down * rn_weight_in(rn_shares_of(p, lx) + x, t.x);
            size_t texel = ((size_t)t.plane * (size_t)p->base + (size_t)y) * (size_t)p->base;
            if (!(weight > 0)) continue;
            rn_load4(scene.parameters + ((texel + (size_t)x) * (size_t)quads + (size_t)t.quad) * 4,
                     value);
            for (int c = 0; c < 4; c++)
                sum[c] += weight * value[c];
        }
    }
    struct rn_update_block b = {t.plane, 0, 0, quads, 0, 0};
    size_t at = rn_texel_at(p, &b, lx, ly, t.x, t.y, t.quad);
    *(uint2 *)(scene.texels + at) = uint2{rn_pack(sum[0], sum[1]), rn_pack(sum[2], sum[3])};
    for (int c = 0; FIXED && g.fixed && c < 4; c++)
        g.fixed[at + c] = 0;
    if (!FIXED && g.half) g.half[at / 4] = uint2{0, 0};
}

#endif
