// The occupancy grid: densities of cells, their decayed maxima, and the bits and distances that the
// march reads (../occupancy.c and ../train/occupancy.c have the same on the CPU).
#ifndef RN_ENGINE_CUDA_OCCUPANCY_CUH
#define RN_ENGINE_CUDA_OCCUPANCY_CUH

#include "common/math/rng.h"
#include "server/engine/cuda/forward.cuh"
#include "server/engine/field/occupancy.h"

#define RN_OCCUPANCY_PARTS 256 // blocks that sum the grid

// Which cells to measure: those drawn, or list[first + i stride], i < count.
struct rn_cuda_measurement {
    bool drawn;
    uint32_t first, stride, count;
    float level, decay, step;
    uint64_t seed, stream, counter;
};

// What chance gives a cell: where it is measured, and whether, where cells are drawn.
RN_DEVICE struct rn_rng4 rn_cell_draw(const struct rn_cuda_measurement *m, uint32_t cell) {
    return rn_rng_draw(m->seed, m->stream + cell, m->counter);
}

// A random point of a cell.
RN_DEVICE struct rn_sample rn_cell_point(const struct rn_cuda_measurement *m, uint32_t cell,
                                         int cells) {
    struct rn_rng4 draw = rn_cell_draw(m, cell);
    uint32_t n = (uint32_t)cells, at[3] = {cell / n / n, cell / n % n, cell % n};
    float p[3];
    for (int k = 0; k < 3; k++)
        p[k] = ((float)at[k] + rn_rng_unit(draw.v[k])) * 2 / (float)cells - 1;
    struct rn_sample s = {p[0], p[1], p[2], 0, 0, 0, 0};
    return s;
}

RN_DEVICE bool rn_cell_is_set(const struct rn_cuda_occupancy *o, uint32_t cell) {
    int at[3];
    rn_cell_at(cell, o->cells, at);
    return o->words[rn_brick_word(at[0], at[1], at[2], o->cells)] & rn_brick_bit(at[0], at[1]);
}

// Draws the cells to be measured; their order is that of arrival. One thread a cell of the list.
__global__ void __launch_bounds__(256)
    rn_draw_cells_kernel(struct rn_cuda_occupancy o,
                         const __grid_constant__ rn_cuda_measurement m) {
    uint32_t i = blockIdx.x * blockDim.x + threadIdx.x;
    double cells = (double)o.cells * (double)o.cells * (double)o.cells;
    float chance[2];
    if (i >= o.count) return;
    rn_chances_of_cells(cells, (double)o.cells_now->occupied, chance);
    uint32_t cell = o.list[i];
    if (!(rn_rng_unit(rn_cell_draw(&m, cell).v[3]) < chance[rn_cell_is_set(&o, cell)])) return;
    o.drawn[atomicAdd(&o.cells_now->drawn, 1u)] = cell;
}

// Cell i of a measurement of `count`, the last one again behind them.
RN_DEVICE uint32_t rn_measured_cell(const struct rn_cuda_occupancy *o,
                                    const struct rn_cuda_measurement *m, uint32_t count,
                                    uint32_t i) {
    i = i < count ? i : count - 1;
    return m->drawn ? o->drawn[i] : o->list[m->first + i * m->stride];
}

// Sixteen cells a warp: density at a point of each, all at one level.
template <int KT, int WT, bool SHARED, int WORLD>
__global__ void __launch_bounds__(RN_NETWORK_THREADS(SHARED, 1), 1)
    rn_measure_kernel(const __grid_constant__ rn_cuda_scene scene,
                      const __grid_constant__ rn_cuda_measurement m, int staged) {
    const struct rn_cuda_occupancy *o = &scene.occupancy;
    const uint4 *weights = rn_stage(SHARED || staged > 0, (uint4 *)rn_shared_memory(),
                                    scene.forward, scene.base.packed_count);
    rn_stage_finish();
    struct rn_encoder flat = {{0, 0, 0, 0}, ~0u, 0, m.level};
    const struct rn_march_ray none = {};
    uint32_t warp = (blockIdx.x * blockDim.x + threadIdx.x) / RN_LANES;
    uint32_t count = m.drawn ? o->cells_now->drawn : m.count;
    for (uint32_t i = warp * RN_TILE; i < count; i += gridDim.x * blockDim.x / RN_LANES * RN_TILE) {
        uint32_t a[1][KT][4];
        float out[1][2][4], top[2];
        struct rn_sample s[2];
        for (int k = 0; k < 2; k++) {
            uint32_t row = i + (uint32_t)(RN_LANE / 4 + 8 * k);
            s[k] = rn_cell_point(&m, rn_measured_cell(o, &m, count, row), o->cells);
        }
        rn_encode<KT, WORLD>(&scene, &flat, &none, s, a[0], top);
        rn_forward<KT, WT>(&scene.base, weights, a, out);
        float density = rn_density_float(rn_column(out[0], 0));
        uint32_t own = i + (uint32_t)RN_LANE;
        if (RN_LANE >= RN_TILE || own >= count) continue;
        uint32_t cell = rn_measured_cell(o, &m, count, own);
        struct rn_sample p = rn_cell_point(&m, cell, o->cells);
        bool inside = p.x * p.x + p.y * p.y + p.z * p.z <= 1;
        float value = inside ? density * (m.step * (float)RN_DENSITY_UNIT) : 0;
        float old = o->values[cell] * m.decay;
        o->values[cell] = value > old ? value : old;
    }
}

// What is kept of the cells of a place after a round over what they showed. One thread a cell.
__global__ void __launch_bounds__(256)
    rn_seen_kernel(struct rn_cuda_occupancy o, uint32_t *seen, bool all_looked) {
    size_t i = (size_t)blockIdx.x * blockDim.x + threadIdx.x, n = (size_t)o.cells;
    if (i >= n * n * n) return;
    float shown = NAN;
    if (seen[i]) memcpy(&shown, &seen[i], sizeof shown);
    o.values[i] = rn_cell_kept(o.values[i], shown, all_looked);
    seen[i] = 0;
}

// Sums of the values of cells that may hold matter, one a block.
__global__ void __launch_bounds__(256) rn_occupancy_sum_kernel(struct rn_cuda_occupancy o) {
    RN_SHARED double sums[256];
    size_t n = (size_t)o.cells * (size_t)o.cells * (size_t)o.cells;
    size_t part = n / RN_OCCUPANCY_PARTS, begin = blockIdx.x * part;
    double sum = 0;
    for (size_t i = threadIdx.x; i < part; i += 256)
        sum += o.hull[begin + i] ? (double)o.values[begin + i] : 0;
    sums[threadIdx.x] = sum;
    for (unsigned half = 128; half > 0; half /= 2) {
        __syncthreads();
        if (threadIdx.x < half) sums[threadIdx.x] += sums[threadIdx.x + half];
    }
    if (threadIdx.x == 0) o.partial[blockIdx.x] = sums[0];
}

// One thread a word of 32 cells; `distance` gets 0 for bricks that hold an occupied cell.
__global__ void __launch_bounds__(256)
    rn_occupancy_bits_kernel(struct rn_cuda_occupancy o, uint8_t *distance) {
    int bricks = o.cells / RN_BRICK, word = (int)(blockIdx.x * blockDim.x + threadIdx.x);
    if (word >= bricks * bricks * bricks * 16) return;
    double sum = 0;
    for (int i = 0; i < RN_OCCUPANCY_PARTS; i++)
        sum += o.partial[i];
    double mean = sum / ((double)o.cells * (double)o.cells * (double)o.cells);
    float threshold = o.by_sight ? RN_SEEN_LIMIT : (float)(mean < o.limit ? mean : o.limit);
    int brick = word / 16, z = brick % bricks * RN_BRICK + word % 16 / 2;
    int y0 = brick / bricks % bricks * RN_BRICK + word % 2 * 4;
    int x0 = brick / bricks / bricks * RN_BRICK;
    uint32_t bits = 0;
    for (int i = 0; i < 32; i++) {
        int cell[3] = {x0 + i % 8, y0 + i / 8, z};
        size_t at = rn_cell_index(cell[0], cell[1], cell[2], o.cells);
        bool over = o.values[at] > threshold;
        if (o.by_sight && !over) over = rn_cell_ends(o.forward, cell, o.cells, o.cells);
        if (!o.hull[at] || !over) continue;
        bits |= 1u << i;
        for (int k = 0; k < 3; k++) {
            atomicMin(o.box + k, cell[k]);
            atomicMax(o.box + 3 + k, cell[k]);
        }
    }
    o.words[word] = bits;
    if (bits) atomicAdd(&o.cells_now->occupied, (uint32_t)rn_popcount(bits));
    if (bits) distance[brick] = 0;
}

// Chebyshev distance along one axis: the lower envelope of max(|k - q|, from[q]).
__global__ void __launch_bounds__(256)
    rn_distance_kernel(int bricks, int axis, const uint8_t *from, uint8_t *to) {
    int brick = (int)(blockIdx.x * blockDim.x + threadIdx.x);
    if (brick >= bricks * bricks * bricks) return;
    int stride = axis == 0 ? bricks * bricks : axis == 1 ? bricks : 1, best = 255;
    int k = brick / stride % bricks, line = brick - k * stride;
    for (int q = 0; q < bricks; q++) {
        int d = k > q ? k - q : q - k, f = from[line + q * stride], m = d > f ? d : f;
        if (m < best) best = m;
    }
    to[brick] = (uint8_t)best;
}

#endif
