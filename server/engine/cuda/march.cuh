// Marching by a warp: which samples of a ray lie in occupied cells, sixteen at a time (cpu/march.h
// has the same walk by vectors).
#ifndef RN_ENGINE_CUDA_MARCH_CUH
#define RN_ENGINE_CUDA_MARCH_CUH

#include "server/engine/cuda/space.cuh"

// A walk along one ray; the same in all lanes. `bits` are the samples found and not yet taken, of
// the window of 32 steps that begins at `window`.
struct rn_walk {
    int k, end, window, shift;
    uint32_t bits;
};

// First march index whose middle lies at or behind `s`.
RN_DEVICE int rn_index_at(float s, float inverse_step) {
    float k = s * inverse_step - 0.5f;
    return k <= 0 ? 0 : k < 1e6f ? (int)k + 1 : 1000000;
}

// Restricts the walk to the box around all occupied cells.
RN_DEVICE void rn_walk_clip(const struct rn_cuda_occupancy *o, const struct rn_march_ray *ray,
                            float inverse_step, struct rn_walk *w) {
    float enter = 0, leave = ray->length;
    for (int i = 0; i < 3; i++) {
        float d = ray->direction[i], at = ray->origin[i], side = 2.0f / (float)o->cells;
        float low = (float)o->box[i] * side - 1, high = (float)(o->box[3 + i] + 1) * side - 1;
        if (d > 1e-12f || d < -1e-12f) {
            float inverse = 1 / d, a = (low - at) * inverse, b = (high - at) * inverse;
            enter = fmaxf(enter, fminf(a, b));
            leave = fminf(leave, fmaxf(a, b));
        } else if (at < low || at > high) {
            leave = -1;
        }
    }
    w->k = leave > enter ? rn_index_at(enter, inverse_step) - 1 : w->end;
    if (w->k < 0) w->k = 0;
    int last = rn_index_at(leave, inverse_step) + 1;
    if (last < w->end) w->end = last;
}

template <int WORLD>
RN_DEVICE struct rn_walk rn_walk_start(const struct rn_cuda_occupancy *o,
                                       const struct rn_march_ray *ray, float step) {
    struct rn_walk w = {0, 0, 0, rn_lowest((uint32_t)ray->stride), 0};
    if (!(ray->length > 0) || o->box[0] > o->box[3]) return w;
    bool bent = WORLD == RN_WORLD_UNBOUNDED;
    w.end = bent ? (int)(ray->length / (2 * step)) : rn_index_at(ray->length, 1 / step);
    if (w.end > 65535) w.end = 65535;
    if (!bent) rn_walk_clip(o, ray, 1 / step, &w);
    return w;
}

// Distance along one axis from `at` to the face of [low, high] that the ray leaves through.
RN_DEVICE float rn_axis_exit(float at, float direction, float low, float high) {
    if (direction > 1e-12f) return (high - at) / direction;
    if (direction < -1e-12f) return (low - at) / direction;
    return 1e30f;
}

// The brick of a point in the cube, its number, and how many bricks away the next one is that holds
// an occupied cell.
RN_DEVICE int rn_brick_of(const struct rn_cuda_occupancy *o, const float at[3], int ret_brick[3]) {
    int bricks = o->cells / RN_BRICK, index = 0;
    for (int i = 0; i < 3; i++) {
        float b = (at[i] + 1) * 0.5f * (float)bricks;
        ret_brick[i] = b > 0 ? (b < (float)bricks ? (int)b : bricks - 1) : 0;
        index = index * bricks + ret_brick[i];
    }
    return o->distance[index];
}

// Through unbounded space rays are bent: as far as they come however they bend.
RN_DEVICE int rn_skip_bent(const struct rn_cuda_occupancy *o, const struct rn_march_ray *ray, int k,
                           float step) {
    float s = rn_middle<RN_WORLD_UNBOUNDED>(ray, k, step), scale = rn_lengths_at(ray, s).scale;
    float at[3], side = 2.0f / (float)(o->cells / RN_BRICK), margin = 1e30f, across = 0;
    int brick[3];
    for (int i = 0; i < 3; i++) {
        at[i] = (ray->origin[i] + ray->direction[i] * s) * scale;
        across += ray->origin[i] * ray->origin[i];
    }
    int distance = rn_brick_of(o, at, brick);
    for (int i = 0; i < 3; i++) {
        float low = (float)(brick[i] - distance + 1) * side - 1;
        margin = fminf(margin, fminf(at[i] - low, low + (float)(2 * distance - 1) * side - at[i]));
    }
    float steps = margin * 0.999f / (step * rn_root(rn_squared_pace(across)));
    return distance > 0 && steps > 1 ? k + (int)fminf(steps, 65535) : k;
}

// Index of the first sample behind the run of empty bricks around sample k; k where there is none.
RN_DEVICE int rn_skip_straight(const struct rn_cuda_occupancy *o, const struct rn_march_ray *ray,
                               int k, float step) {
    float at[3], s = ((float)k + 0.5f) * step, leave = 1e30f;
    float side = 2.0f / (float)(o->cells / RN_BRICK);
    int brick[3];
    for (int i = 0; i < 3; i++)
        at[i] = ray->origin[i] + ray->direction[i] * s;
    int distance = rn_brick_of(o, at, brick);
    if (distance == 0) return k;
    for (int i = 0; i < 3; i++) {
        float low = (float)(brick[i] - distance + 1) * side - 1;
        float high = low + (float)(2 * distance - 1) * side;
        leave = fminf(leave, rn_axis_exit(at[i], ray->direction[i], low, high));
    }
    int next = leave < 1e6f ? rn_index_at(s + leave, 1 / step) : 1000000;
    return next > k ? next : k + 1;
}

// The same of a bent ray; k too where it is no more than what is looked at at once, `least` steps.
template <int WORLD>
RN_DEVICE int rn_skip_empty(const struct rn_cuda_occupancy *o, const struct rn_march_ray *ray,
                            int k, float step, int least) {
    if (WORLD != RN_WORLD_UNBOUNDED) return rn_skip_straight(o, ray, k, step);
    int next = rn_skip_bent(o, ray, k, step);
    return next - k > least ? next : k;
}

// Tiles that a ray may have, counted brick by brick by one thread; 0: it meets no brick with an
// occupied cell, and the warp's walk would find nothing.
template <int WORLD>
RN_DEVICE int rn_tiles_ahead(const struct rn_cuda_occupancy *o, const struct rn_march_ray *ray,
                             float step) {
    struct rn_walk w = rn_walk_start<WORLD>(o, ray, step);
    int tiles = 0;
    while (w.k < w.end) {
        int next = rn_skip_empty<WORLD>(o, ray, w.k, step, RN_TILE << w.shift);
        tiles += next == w.k;
        w.k = next == w.k ? w.k + (RN_TILE << w.shift) : next;
    }
    return tiles;
}

// Whether step k lies in an occupied cell.
template <int WORLD>
RN_DEVICE bool rn_cell_occupied(const struct rn_cuda_occupancy *o, const struct rn_march_ray *ray,
                                int k, float step) {
    float s = rn_middle<WORLD>(ray, k, step), half = 0.5f * (float)o->cells;
    float scale = WORLD == RN_WORLD_UNBOUNDED ? rn_lengths_at(ray, s).scale : 1;
    int cell[3], bricks = o->cells / RN_BRICK;
    for (int i = 0; i < 3; i++) {
        float p = ray->direction[i] * s + ray->origin[i];
        if (WORLD == RN_WORLD_UNBOUNDED) p *= scale;
        cell[i] = (int)fminf(fmaxf(p * half + half, 0), (float)(o->cells - 1));
    }
    int brick = ((cell[0] >> 3) * bricks + (cell[1] >> 3)) * bricks + (cell[2] >> 3);
    uint32_t word = o->words[brick * 16 + (cell[2] & 7) * 2 + ((cell[1] >> 2) & 1)];
    return word >> ((cell[1] & 3) * 8 + (cell[0] & 7)) & 1;
}

// Steps in the lowest bit of each group of 1 << shift: a sample is there when any of its steps is.
RN_DEVICE uint32_t rn_merge_steps(uint32_t bits, int shift) {
    if (shift > 0) bits = (bits | bits >> 1) & 0x55555555u;
    if (shift > 1) bits = (bits | bits >> 2) & 0x11111111u;
    if (shift > 2) bits = (bits | bits >> 4) & 0x01010101u;
    return bits;
}

// Position of the n-th set bit, n from 0 and below the number of set bits.
RN_DEVICE int rn_nth_bit(uint32_t bits, int n) {
    int at = 0;
    for (int width = 16; width > 0; width /= 2) {
        int below = rn_popcount(bits & ((1u << width) - 1));
        if (n >= below) {
            n -= below;
            bits >>= width;
            at += width;
        }
    }
    return at;
}

// The next samples, at most RN_TILE: lane i gets the march index of the i-th, in units of the ray's
// stride. Returns how many there are; 0 at the ray's end. Ends: every turn advances k.
template <int WORLD>
RN_DEVICE int rn_walk_next(const struct rn_cuda_occupancy *o, const struct rn_march_ray *ray,
                           float step, struct rn_walk *w, int *ret_index) {
    int count = 0;
    *ret_index = 0;
    while (count < RN_TILE && (w->bits || w->k < w->end)) {
        if (!w->bits) {
            int next = rn_skip_empty<WORLD>(o, ray, w->k, step, RN_LANES);
            if (next != w->k) {
                w->k = next;
                continue;
            }
            w->window = w->k & -(1 << w->shift);
            int mine = w->window + RN_LANE;
            bool hit = mine < w->end && rn_cell_occupied<WORLD>(o, ray, mine, step);
            w->bits = rn_merge_steps(rn_ballot(hit), w->shift);
            w->k = w->window + RN_LANES;
        }
        int found = rn_popcount(w->bits), slot = RN_LANE - count;
        if (slot >= 0 && slot < found && RN_LANE < RN_TILE)
            *ret_index = (w->window + rn_nth_bit(w->bits, slot)) >> w->shift;
        int taken = found < RN_TILE - count ? found : RN_TILE - count;
        for (int i = 0; i < taken; i++)
            w->bits &= w->bits - 1;
        count += taken;
    }
    return count;
}

// ---- which ray comes next ---------------------------------------------------------------------

// Puts the lanes' rays on the lists of their lengths, those that have no tile on none; all lanes.
RN_DEVICE void rn_queue_ray(const struct rn_cuda_batch *b, int r, int tiles) {
    int length = tiles >= 16 ? 0 : tiles >= 8 ? 1 : tiles >= 4 ? 2 : 3;
    RN_UNROLL
    for (int l = 0; l < RN_LENGTHS; l++) {
        uint32_t mine = rn_ballot(tiles > 0 && length == l);
        int first = 0;
        if (RN_LANE == 0 && mine)
            first = (int)atomicAdd(&b->status->queued[l], (uint32_t)rn_popcount(mine));
        first = rn_shuffle(first, 0);
        if (mine >> RN_LANE & 1)
            b->queue[l * b->ray_capacity + first + rn_popcount(mine & ((1u << RN_LANE) - 1))] = r;
    }
}

// The next ray, for a whole warp; -1: there is none.
RN_DEVICE int rn_next_ray(const struct rn_cuda_batch *b) {
    int ray = -1;
    if (RN_LANE == 0) {
        uint32_t at = atomicAdd(&b->status->queue, 1u), count = 0;
        int l = 0;
        while (l < RN_LENGTHS && at >= (count = b->status->queued[l])) {
            at -= count;
            l++;
        }
        if (l < RN_LENGTHS) ray = b->queue[l * b->ray_capacity + (int)at];
    }
    return rn_shuffle(ray, 0);
}

#endif
