// A warp follows a ray: sixteen samples at a time are found, encoded, given density and colour, and
// composited, until nothing behind can be seen. Rendering ends there; training also leaves tiles of
// samples for the backward, and the ray's colour for loss.cuh. Where the field shades whole rays,
// the ray's sums are left for shade.cuh in place of its colour.
#ifndef RN_ENGINE_CUDA_FORWARD_CUH
#define RN_ENGINE_CUDA_FORWARD_CUH

#include "server/engine/cuda/encode.cuh"
#include "server/engine/cuda/march.cuh"
#include "server/engine/cuda/network.cuh"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/sh.h"

// ---- pieces ---------------------------------------------------------------------------------

// The direction that the colour network is told of a ray whose own is `own`; each number chosen,
// not the place of all three, which would have to lie in memory.
RN_DEVICE void rn_look(const struct rn_cuda_march *march, const float own[3], float ret[3]) {
    for (int i = 0; i < 3; i++)
        ret[i] = march->turned ? march->look[i] : own[i];
}

// The own one of ray r.
RN_DEVICE const float *rn_direction_of(const struct rn_cuda_batch *b, int r) {
    return b->looks + (size_t)r * (size_t)b->look_stride;
}

// The direction's spherical harmonics as columns 0..15 of the colour network's input: words for
// columns 2t, 2t + 1 and 2t + 8, 2t + 9, the same in all rows.
RN_DEVICE void rn_direction(const struct rn_cuda_scene *scene, const float d[3], uint32_t ret[2]) {
    double direction[3] = {(double)d[0], (double)d[1], (double)d[2]}, sh[RN_SH_COUNT];
    float mine[4] = {0, 0, 0, 0};
    rn_sh_encode(direction, sh);
    RN_UNROLL
    for (int k = 0; k < RN_SH_COUNT; k++)
        if (k % 8 / 2 == RN_LANE % 4) mine[2 * (k / 8) + k % 2] = (float)sh[k];
    for (int i = 0; i < 2; i++)
        ret[i] = scene->view_dependence ? rn_pack(mine[2 * i], mine[2 * i + 1]) : 0;
}

// Column `column` of row i of the 16 outputs, for lane i (mod 16).
RN_DEVICE float rn_column(const float (&c)[2][4], int column) {
    int row = RN_LANE % RN_TILE, from = (row & 7) * 4 + column % 8 / 2;
    float low = rn_shuffle(c[column / 8][column % 2], from);
    float high = rn_shuffle(c[column / 8][2 + column % 2], from);
    return row < 8 ? low : high;
}

// The number that lane i (mod 16) has of row i, from a number a row in a fragment: x[0] of rows g,
// x[1] of rows g + 8.
RN_DEVICE float rn_of_row(const float (&x)[2]) {
    float low = rn_shuffle(x[0], RN_LANE % 8 * 4), high = rn_shuffle(x[1], RN_LANE % 8 * 4);
    return RN_LANE % RN_TILE < 8 ? low : high;
}

// The density network's outputs as input columns 16..31 of the colour network: 1 in the logit's
// place.
RN_DEVICE void rn_geometry(const float (&c)[2][4], uint32_t ret[4]) {
    bool first = RN_LANE % 4 == 0;
    ret[0] = rn_pack(first ? 1 : c[0][0], c[0][1]);
    ret[1] = rn_pack(first ? 1 : c[0][2], c[0][3]);
    ret[2] = rn_pack(c[1][0], c[1][1]);
    ret[3] = rn_pack(c[1][2], c[1][3]);
}

RN_DEVICE float rn_density_float(float logit) {
    return expf(fminf(fmaxf(logit - RN_DENSITY_SHIFT, -RN_DENSITY_CLAMP), RN_DENSITY_CLAMP));
}

// Opacity of one interval of optical depth x (field/volume.h).
RN_DEVICE float rn_alpha_float(float x) {
    return -expm1f(-x);
}

// Lanes 0..15 hold the samples of a tile.
struct rn_shaded {
    float x;             // optical depth
    float weight, after; // and transmittance behind
    float before;        // optical depth in front
};

// Sum over the lanes behind this one, of 16.
RN_DEVICE float rn_sum_behind(float x) {
    float sum = x;
    for (int d = 1; d < RN_TILE; d *= 2) {
        float other = rn_shuffle(sum, RN_LANE + d);
        if (RN_LANE % RN_TILE + d < RN_TILE) sum += other;
    }
    float behind = rn_shuffle(sum, RN_LANE + 1);
    return RN_LANE % RN_TILE == RN_TILE - 1 ? 0 : behind;
}

// Weights of a tile that begins at optical depth *depth, which moves to its end. Samples behind the
// early stop weigh nothing (field/volume.h).
RN_DEVICE void rn_attenuate(float stop_depth, double *depth, struct rn_shaded *s) {
    float inside = rn_sum_before(s->x, RN_TILE), before = (float)(*depth + (double)inside);
    float t = before <= stop_depth ? expf(-before) : 0;
    s->before = before;
    s->weight = t * rn_alpha_float(s->x);
    s->after = t * expf(-s->x);
    *depth += (double)rn_shuffle(inside + s->x, RN_TILE - 1);
}

// ---- a ray ----------------------------------------------------------------------------------

struct rn_trace {
    const struct rn_cuda_scene *scene;
    const struct rn_cuda_march *march;
    const struct rn_cuda_batch *batch;
    const uint4 *base, *head; // fragments
    struct rn_march_ray ray;
    struct rn_forward_line line; // of a forward-facing space
    int index;                   // of the ray
    uint32_t direction[2];
    // sums over the lane's own samples: colour, opacity, opacity times distance
    float colour[3], opacity, distance;
    float sums[4]; // of columns 2t, 2t + 1, 2t + 8 and 2t + 9, where a ray is shaded as a whole
    int last_tile, samples, evaluated;
};

// Stores a tile but for its colours; its slot, or -1 where there is no room: the step is then
// rejected as a whole. Before the colour network, which wants the features' registers.
template <int KT>
RN_DEVICE int rn_save_tile(struct rn_trace *t, const uint32_t (&features)[KT][4],
                           const uint32_t geometry[4], const struct rn_shaded *s, float mid) {
    const struct rn_cuda_batch *b = t->batch;
    int slot = 0;
    if (RN_LANE == 0) slot = (int)atomicAdd(&b->status->tiles, 1u);
    slot = rn_shuffle(slot, 0);
    if ((uint32_t)slot >= b->tile_capacity) return -1;
    RN_UNROLL
    for (int k = 0; k < KT; k++)
        rn_store_rows(features[k], b->features + ((size_t)slot * KT + k) * RN_BLOCK);
    rn_store_rows(geometry, b->geometry + (size_t)slot * RN_BLOCK);
    if (RN_LANE < RN_TILE) {
        size_t at = (size_t)slot * RN_TILE + RN_LANE;
        b->mid[at] = mid;
        b->depth[at] = s->x;
        b->weight[at] = s->weight;
        b->after[at] = s->after;
    }
    if (RN_LANE == 0) {
        b->tile_ray[slot] = t->index;
        b->tile_previous[slot] = t->last_tile;
    }
    t->last_tile = slot;
    return slot;
}

// Counts samples by their largest level; `top` as rn_encode leaves it, lane i counts sample i.
RN_DEVICE void rn_count_levels(struct rn_cuda_status *status, float (&top)[2], bool counts) {
    for (int i = 0; i < 2; i++)
        for (int mask = 1; mask < 4; mask *= 2)
            top[i] = fmaxf(rn_shuffle_xor(top[i], mask), top[i]);
    int level = (int)rn_of_row(top);
    for (int l = 0; l < RN_MAX_LEVELS; l++) {
        uint32_t bits = rn_ballot(counts && level == l);
        if (bits && RN_LANE == 0)
            atomicAdd((unsigned long long *)&status->level_samples[l],
                      (unsigned long long)rn_popcount(bits));
    }
}

// ---- ray shading ----------------------------------------------------------------------------

// The density network's outputs as what a ray sums (field/mlp.h): 1 in the logit's place, diffuse
// colours, features.
RN_DEVICE void rn_activate(float (&out)[2][4]) {
    for (int i = 0; i < 4; i++) {
        int column = 2 * (RN_LANE % 4) + i % 2;
        if (column < 4) out[0][i] = column == 0 ? 1 : 1 / (1 + expf(-out[0][i]));
    }
}

// Adds a tile to the ray's sums. `weight`: lane i has sample i's.
RN_DEVICE void rn_add_sums(struct rn_trace *t, const float (&values)[2][4], float weight) {
    float low = rn_shuffle(weight, RN_LANE / 4), high = rn_shuffle(weight, RN_LANE / 4 + 8);
    for (int i = 0; i < 4; i++) {
        float a = values[i / 2][i % 2], b = values[i / 2][2 + i % 2];
        t->sums[i] += (low != 0 ? low * a : 0) + (high != 0 ? high * b : 0);
    }
}

// Leaves the sums of a whole ray; its colour is the diffuse one.
RN_DEVICE void rn_save_sums(struct rn_trace *t) {
    float *to = t->batch->ray_sums + (size_t)t->index * RN_GEOMETRY + 2 * (RN_LANE % 4);
    for (int i = 0; i < 4; i++) {
        for (int mask = 4; mask < RN_LANES; mask *= 2)
            t->sums[i] += rn_shuffle_xor(t->sums[i], mask);
        if (RN_LANE < 4) to[8 * (i / 2) + i % 2] = t->sums[i];
    }
    for (int c = 0; c < 3; c++)
        t->colour[c] = rn_shuffle(t->sums[(c + 1) % 2], (c + 1) / 2);
}

// ---- the end of a place ---------------------------------------------------------------------

// Sum of lanes 0..15, in all lanes.
RN_DEVICE float rn_tile_sum(float x) {
    return rn_warp_sum(RN_LANE < RN_TILE ? x : 0);
}

// Whether a world is a place (rn_is_place).
template <int WORLD> RN_DEVICE constexpr bool rn_ends() {
    return WORLD == RN_WORLD_UNBOUNDED || WORLD == RN_WORLD_FORWARD;
}

// Where rays are shaded as a whole nothing shines through the end of a place (rn_ends_opaque): the
// last of a ray's samples, number `last` of a tile, takes what shines through the others.
RN_DEVICE void rn_close_end(float stop_depth, double depth, int last, struct rn_shaded *s) {
    float all = rn_tile_sum(s->x);
    if (depth + (double)all <= (double)stop_depth && RN_LANE == last) s->x = RN_OPAQUE;
}

// Notes what the cell of a lane's sample showed; in any order the same. What is hidden showed
// nothing.
RN_DEVICE void rn_note_seen(const struct rn_cuda_batch *b, int cells, const struct rn_sample *at,
                            const struct rn_shaded *s) {
    const float p[3] = {at->x, at->y, at->z};
    float half = 0.5f * (float)cells, weight = fmaxf(s->weight, RN_SEEN_LEAST);
    int cell[3], bits;
    if (!(s->before <= RN_HIDDEN_DEPTH)) return;
    for (int i = 0; i < 3; i++)
        cell[i] = (int)rn_clamp_lane(p[i] * half + half, 0, (float)(cells - 1));
    memcpy(&bits, &weight, sizeof bits); // of numbers that are not negative, ordered as they are
    atomicMax((int *)b->seen + rn_cell_index(cell[0], cell[1], cell[2], cells), bits);
}

// ---- a tile ---------------------------------------------------------------------------------

// One tile: `n` samples at march indices `index` (lane i: sample i); `last`: of the ray.
template <int KT, int WT, bool TRAIN, int WORLD>
RN_DEVICE void rn_trace_tile(struct rn_trace *t, const struct rn_encoder *encoder, int n, int index,
                             bool last, double *depth) {
    const struct rn_cuda_scene *scene = t->scene;
    uint32_t a[1][KT][4], head_in[1][2][4];
    float out[1][2][4], top[2], mid = rn_middle<WORLD>(&t->ray, index, encoder->step);
    struct rn_sample s[2];
    for (int i = 0; i < 2; i++)
        s[i] =
            rn_place<WORLD>(&t->ray, &t->line, rn_shuffle(mid, RN_LANE / 4 + 8 * i), encoder->step);
    rn_encode<KT, WORLD>(scene, encoder, &t->ray, s, a[0], top);
    rn_forward<KT, WT>(&scene->base, t->base, a, out);
    struct rn_sample own = rn_place<WORLD>(&t->ray, &t->line, mid, encoder->step);
    bool inside = rn_is_inside<WORLD>(&own) && RN_LANE % RN_TILE < n;
    struct rn_shaded shaded;
    float density = rn_density_float(rn_column(out[0], 0));
    shaded.x = inside ? density * (encoder->step * (float)RN_DENSITY_UNIT) : 0;
    if (rn_ends<WORLD>() && last) rn_close_end(t->march->stop_depth, *depth, n - 1, &shaded);
    rn_attenuate(t->march->stop_depth, depth, &shaded);
    if (TRAIN && rn_ends<WORLD>() && RN_LANE < n)
        rn_note_seen(t->batch, scene->occupancy.cells, &own, &shaded);
    uint32_t seen = rn_ballot(shaded.weight > 0 && RN_LANE < RN_TILE);
    // A number that is not finite is seen too: it must reach the pixel, and be counted there.
    uint32_t strange = rn_ballot(!(shaded.weight >= 0) && RN_LANE < RN_TILE);
    t->evaluated += n;
    if (!(seen | strange)) return;
    if (scene->per_ray) rn_activate(out[0]);
    rn_geometry(out[0], head_in[0][1]);
    int slot = -1;
    if constexpr (TRAIN) {
        slot = rn_save_tile<KT>(t, a[0], head_in[0][1], &shaded, mid);
        rn_count_levels(t->batch->status, top, shaded.weight > 0 && RN_LANE < RN_TILE);
    }
    t->opacity += shaded.weight;
    t->distance += shaded.weight * (WORLD == RN_WORLD_FORWARD ? own.t : t->ray.near + mid);
    t->samples += rn_popcount(seen);
    if (scene->per_ray) {
        rn_add_sums(t, out[0], shaded.weight);
        return;
    }
    for (int i = 0; i < 4; i++)
        head_in[0][0][i] = t->direction[i / 2];
    rn_forward<2, WT>(&scene->head, t->head, head_in, out);
    for (int c = 0; c < 3; c++) {
        float colour = 1 / (1 + expf(-rn_column(out[0], c)));
        t->colour[c] += shaded.weight != 0 ? shaded.weight * colour : 0;
        if (TRAIN && slot >= 0 && RN_LANE < RN_TILE)
            t->batch->colour[((size_t)slot * 3 + c) * RN_TILE + RN_LANE] = colour;
    }
}

// The ray's samples, tile by tile; where its last one is another than the others it is found before
// it is looked at.
template <int KT, int WT, bool TRAIN, int WORLD>
RN_DEVICE void rn_trace_tiles(struct rn_trace *t, const struct rn_encoder *encoder,
                              struct rn_walk *walk) {
    double depth = 0;
    int n, index;
    auto next_tile = [&](int *ret_index) {
        return rn_walk_next<WORLD>(&t->scene->occupancy, &t->ray, t->march->step, walk, ret_index);
    };
    if constexpr (rn_ends<WORLD>()) {
        int next = 0, next_index = 0;
        n = next_tile(&index);
        for (; depth <= (double)t->march->stop_depth && n > 0; n = next, index = next_index) {
            next = next_tile(&next_index);
            bool last = next == 0 && t->scene->per_ray;
            rn_trace_tile<KT, WT, TRAIN, WORLD>(t, encoder, n, index, last, &depth);
        }
    } else {
        while (depth <= (double)t->march->stop_depth && (n = next_tile(&index)) > 0)
            rn_trace_tile<KT, WT, TRAIN, WORLD>(t, encoder, n, index, false, &depth);
    }
}

// Follows the ray; afterwards the sums are those of the whole ray, in all lanes.
template <int KT, int WT, bool TRAIN, int WORLD> RN_DEVICE void rn_trace_ray(struct rn_trace *t) {
    const struct rn_cuda_scene *scene = t->scene;
    t->last_tile = -1;
    t->samples = t->evaluated = 0;
    t->colour[0] = t->colour[1] = t->colour[2] = t->opacity = t->distance = 0;
    t->sums[0] = t->sums[1] = t->sums[2] = t->sums[3] = 0;
    struct rn_walk walk = rn_walk_start<WORLD>(&scene->occupancy, &t->ray, t->march->step);
    if (walk.k >= walk.end) return;
    if (WORLD == RN_WORLD_FORWARD) t->line = t->batch->forward[t->index].line;
    struct rn_encoder encoder =
        rn_encoder_start<WORLD>(&scene->planes, &t->ray, &t->line, t->march->step);
    float look[3];
    if constexpr (WORLD == RN_WORLD_FORWARD)
        rn_look(t->march, rn_direction_of(t->batch, t->index), look);
    else
        rn_look(t->march, t->ray.direction, look);
    rn_direction(scene, look, t->direction);
    rn_trace_tiles<KT, WT, TRAIN, WORLD>(t, &encoder, &walk);
    for (int c = 0; c < 3; c++)
        t->colour[c] = rn_tile_sum(t->colour[c]);
    t->opacity = rn_tile_sum(t->opacity);
    t->distance = rn_tile_sum(t->distance);
}

RN_COLOUR_FUNCTIONS(rn_colour_seen_lane, rn_colour_back_lane, float)

RN_DEVICE void rn_store_pixel(const struct rn_trace *t) {
    struct rn_pixel pixel;
    for (int c = 0; c < 3; c++)
        pixel.rgb[c] = t->colour[c];
    // What is shaded by the ray gets the network's part first (rn_shade_pixel), if it meets
    // anything.
    bool waits = t->scene->per_ray && t->scene->view_dependence && t->opacity != 0;
    if (!waits) rn_colour_seen_lane(&t->march->colour, t->opacity, pixel.rgb);
    pixel.alpha = fminf(t->opacity, 1);
    pixel.depth = t->opacity > 0 ? t->distance / t->opacity : 0;
    t->batch->pixels[t->index] = pixel;
}

// ---- training -------------------------------------------------------------------------------

// Leaves what the loss is made from: the ray's samples and tiles, its colour and opacity in the
// first of its sums, unless all of them are there.
RN_DEVICE void rn_leave_ray(const struct rn_trace *t) {
    const struct rn_cuda_batch *b = t->batch;
    float *sums = b->ray_sums + (size_t)t->index * RN_GEOMETRY;
    if (RN_LANE > 0) return;
    b->ray_samples[t->index] = t->samples;
    b->ray_last[t->index] = t->last_tile;
    if (t->scene->per_ray) return;
    sums[0] = t->opacity;
    for (int c = 0; c < 3; c++)
        sums[1 + c] = t->colour[c];
}

// ---- kernels --------------------------------------------------------------------------------

// Rays of the batch that may see something, each by the warp that comes first. Shared memory: the
// two networks' fragments, as far as `staged` says (0 none, 1 the density network, 2 both, as where
// SHARED).
#define RN_FORWARD_THREADS 384
template <int KT, int WT, bool TRAIN, bool SHARED, int WORLD>
__global__ void __launch_bounds__(RN_FORWARD_THREADS, 1)
    rn_forward_kernel(const __grid_constant__ rn_cuda_scene scene,
                      const __grid_constant__ rn_cuda_batch batch,
                      const __grid_constant__ rn_cuda_march march, int staged) {
    uint4 *room = (uint4 *)rn_shared_memory();
    struct rn_trace t;
    t.scene = &scene;
    t.march = &march;
    t.batch = &batch;
    t.base = rn_stage(SHARED || staged > 0, room, scene.forward, scene.base.packed_count);
    t.head = rn_stage(SHARED || staged > 1, room + scene.base.packed_count,
                      scene.forward + scene.base.packed_count, scene.head.packed_count);
    rn_stage_finish();
    unsigned long long evaluated = 0;
    for (;;) {
        t.index = rn_next_ray(&batch);
        if (t.index < 0) break;
        t.ray = batch.rays[t.index];
        rn_trace_ray<KT, WT, TRAIN, WORLD>(&t);
        evaluated += (unsigned long long)t.evaluated;
        if (scene.per_ray) rn_save_sums(&t);
        if (TRAIN)
            rn_leave_ray(&t);
        else if (RN_LANE == 0)
            rn_store_pixel(&t);
    }
    if (RN_LANE == 0) atomicAdd(&batch.status->evaluated, evaluated);
}

#endif
