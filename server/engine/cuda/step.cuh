// The ends of a step: its rays, the order of its tiles, its sums, and what the next one is to be.
#ifndef RN_ENGINE_CUDA_STEP_CUH
#define RN_ENGINE_CUDA_STEP_CUH

#ifdef __x86_64__
#include <immintrin.h>
#endif

#include "common/math/rng.h"
#include "server/engine/cuda/march.cuh"
#include "server/engine/kernels/draw.h"
#include "server/engine/kernels/ray.h"

#define RN_STREAM_RAYS 0x7261797300000000u // as train/step.c
#define RN_ORDER_THREADS 1024
#define RN_FEWEST_RAYS 64
#define RN_SCALE_PATIENCE 2000 // good steps before the gradients' scale is doubled
#define RN_SCALE_FIRST 4096.0f
#define RN_SCALE_MOST 65536.0f
#define RN_SCALE_LEAST 0.0009765625f

// ---- rays -----------------------------------------------------------------------------------

// Pixels in device memory, and how rays are drawn from them.
struct rn_cuda_source {
    struct rn_device_pixels pixels;
    struct rn_cuda_cut cut;
    struct rn_colouring colour;
    uint64_t seed;
    bool favour_finest, split;
};

// A camera's cone as the kernels want it (rn_march_ray_from).
template <int WORLD>
RN_DEVICE struct rn_march_ray rn_cut_cone(const struct rn_cuda_cut *c, const struct rn_ray *ray,
                                          double jitter) {
    if (WORLD == RN_WORLD_UNBOUNDED)
        return rn_ray_cut_unbounded(c->centre, c->radius, ray, c->step, jitter);
    if (WORLD == RN_WORLD_FORWARD) {
        struct rn_ray seen = *ray;
        rn_disparity_seen(&c->disparity, ray->origin, seen.origin);
        rn_disparity_turn(&c->disparity, ray->direction, seen.direction);
        return rn_ray_cut_forward(&c->disparity, &seen, c->step, jitter);
    }
    return rn_ray_cut(c->centre, c->radius, c->cone_step, ray, c->step, jitter);
}

// What a ray was, in a forward-facing space; zeros where it misses.
template <int WORLD>
RN_DEVICE void rn_keep_forward(const struct rn_cuda_batch *b, const struct rn_cuda_cut *cut, int r,
                               const struct rn_march_ray *ray) {
    struct rn_cuda_forward out = {};
    if (WORLD != RN_WORLD_FORWARD) return;
    if (ray->length > 0) {
        struct rn_forward_ray was = rn_forward_ray(&cut->disparity, ray);
        for (int i = 0; i < 3; i++)
            out.view[i] = (float)was.view[i];
        out.line = rn_forward_line(&cut->disparity, ray, &was);
    }
    b->forward[r] = out;
}

// Uniform in [0, n) from 64 random bits, n < 2^53.
RN_DEVICE uint64_t rn_below(const struct rn_rng4 *draw, uint64_t n) {
    uint64_t wide = (uint64_t)draw->v[0] << 32 | draw->v[1];
    return (uint64_t)((double)(wide >> 11) * 0x1p-53 * (double)n);
}

// Where a ray comes from: its pixel, of no frame where there is none; its weight in the loss.
struct rn_cuda_place {
    int frame, x, y;
    float weight;
    int block; // of the live ones; -1: of none
};

// A pixel drawn uniformly over all scales.
RN_DEVICE struct rn_cuda_place rn_draw_pixel(const struct rn_device_pixels *p,
                                             const struct rn_rng4 *draw) {
    int scale = 0;
    uint64_t pixel = rn_below(draw, p->pixel_count);
    while (pixel >= p->scale_pixels[scale])
        pixel -= p->scale_pixels[scale++];
    int low = p->scale_first[scale], high = p->scale_first[scale + 1];
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (p->frames[middle].before <= pixel)
            low = middle;
        else
            high = middle;
    }
    uint64_t within = pixel - p->frames[low].before, width = (uint64_t)p->frames[low].camera.width;
    return rn_cuda_place{low, (int)(within % width), (int)(within / width),
                         p->frames[low].loss_weight, -1};
}

// A pixel of the scale that turn `turn` falls to, of the blocks that may see the hull.
RN_DEVICE struct rn_cuda_place rn_draw_live(const struct rn_cuda_source *s, uint64_t turn) {
    const struct rn_device_pixels *p = &s->pixels;
    struct rn_cuda_place out = {-1, 0, 0, 1, -1};
    struct rn_scale_turn from = rn_scale_turn(turn, p->scale_count);
    uint64_t first = p->live_first[from.scale], count = p->live_first[from.scale + 1] - first;
    if (count == 0) return out;
    struct rn_live_pixel pixel =
        p->shares.share
            ? rn_shared_pixel(&p->shares, from.scale, first, count, s->seed, from.turn, &out.weight)
            : rn_live_pixel(s->seed, from.turn, count);
    const struct rn_device_block *block = &p->live[first + pixel.block];
    out.x = block->x + pixel.x;
    out.y = block->y + pixel.y;
    const struct rn_camera *c = &p->frames[block->frame].camera;
    if (out.x >= c->width || out.y >= c->height) return out;
    out.frame = (int)block->frame;
    out.block = (int)(first + pixel.block);
    return out;
}

// The ray of part `part` of a pixel that is split 2 x 2.
RN_DEVICE struct rn_ray rn_part_ray(const struct rn_camera *camera, int x, int y, int part) {
    struct rn_camera fine = rn_camera_resized(camera, 2 * camera->width, 2 * camera->height);
    return rn_camera_ray(&fine, 2 * x + part % 2 + 0.5, 2 * y + part / 2 + 0.5);
}

// Whether rays are drawn from a pixel of `rgba`.
RN_DEVICE bool rn_is_used(const struct rn_device_pixels *p, uint64_t pixel) {
    return !p->used || p->used[pixel / 32] >> pixel % 32 & 1;
}

// Notes which block ray r is of, on its block's list of the step's rays. The first of a split
// pixel's does it for all.
RN_DEVICE void rn_note_block(const struct rn_cuda_batch *b, int r, int block) {
    if (!b->block_error) return;
    b->ray_block[r] = r % b->pixel_rays ? -1 : block;
    if (b->ray_block[r] >= 0) b->ray_before[r] = atomicExch(&b->block_ray[block], r + 1);
}

// Ray r of a step; `first_ray`: rays of all steps before. The rays of a split pixel have one turn.
template <int WORLD>
RN_DEVICE struct rn_march_ray rn_draw_ray(const struct rn_cuda_source *s, uint64_t step,
                                          uint64_t first_ray, int r, int *ret_block) {
    const struct rn_device_pixels *p = &s->pixels;
    int rays = s->split ? RN_PIXEL_RAYS : 1, part = r % rays;
    struct rn_rng4 draw = rn_rng_draw(s->seed, RN_STREAM_RAYS | (uint32_t)r, step);
    struct rn_rng4 of_pixel =
        part ? rn_rng_draw(s->seed, RN_STREAM_RAYS | (uint32_t)(r - part), step) : draw;
    uint64_t turn = (first_ray + (uint64_t)(r - part)) / (uint64_t)rays;
    struct rn_cuda_place at =
        s->favour_finest ? rn_draw_live(s, turn) : rn_draw_pixel(p, &of_pixel);
    struct rn_march_ray out = {{0, 0, 0}, {0, 0, 0}, 0, 0, 0, 1, {0, 0, 0}, 0, 0, (uint32_t)r};
    *ret_block = -1;
    if (at.frame < 0) return out;
    const struct rn_device_frame *f = &p->frames[at.frame];
    uint64_t pixel = f->offset + (uint64_t)at.y * (uint64_t)f->camera.width + (uint64_t)at.x;
    if (!rn_is_used(p, pixel)) return out;
    *ret_block = at.block;
    struct rn_ray ray = s->split ? rn_part_ray(&f->camera, at.x, at.y, part)
                                 : rn_camera_ray(&f->camera, at.x + 0.5, at.y + 0.5);
    out = rn_cut_cone<WORLD>(&s->cut, &ray, (double)rn_rng_unit(draw.v[2]));
    const uint8_t *rgba = p->rgba + 4 * pixel;
    float alpha = (float)rgba[3] * (1 / 255.0f);
    for (int c = 0; c < 3; c++)
        out.target[c] =
            (float)rgba[c] * (1 / 255.0f) * alpha + (1 - alpha) * s->colour.background[c];
    out.alpha = alpha;
    out.weight = ray.radius > 0 ? at.weight : 0;
    out.id = (uint32_t)r;
    return out;
}

// What the forward would leave of a ray that meets nothing.
RN_DEVICE void rn_leave_empty(const struct rn_cuda_batch *b, int r) {
    b->ray_samples[r] = 0;
    b->ray_last[r] = -1;
    for (int i = 0; i < RN_GEOMETRY; i++)
        b->ray_sums[(size_t)r * RN_GEOMETRY + i] = 0;
}

// One thread a ray; those that may see something are queued for the forward. The rays of
// the paper's step are 83 blocks, fewer than there are processors: a thread may have more registers
// than would let two blocks share one.
template <int WORLD>
__global__ void __launch_bounds__(256, 1)
    rn_rays_kernel(const __grid_constant__ rn_cuda_source source,
                   const __grid_constant__ rn_cuda_scene scene,
                   const __grid_constant__ rn_cuda_batch batch) {
    int r = (int)(blockIdx.x * blockDim.x + threadIdx.x), tiles = 0, block;
    if (r < batch.status->ray_count) {
        struct rn_march_ray ray =
            rn_draw_ray<WORLD>(&source, batch.status->steps, batch.status->rays, r, &block);
        batch.rays[r] = ray;
        rn_note_block(&batch, r, block);
        rn_keep_forward<WORLD>(&batch, &source.cut, r, &ray);
        tiles = rn_tiles_ahead<WORLD>(&scene.occupancy, &ray, (float)source.cut.step);
        if (tiles == 0) rn_leave_empty(&batch, r);
    }
    rn_queue_ray(&batch, r, tiles);
}

// Rays of pixels: the i-th one's, cones x cones of them, are rays from i * cones^2 on.
struct rn_cuda_view {
    const struct rn_camera *cameras; // of the cones; all of one size
    const uint32_t *places;          // of the pixels (rn_device_places); NULL: from `first` on
    uint32_t first;
    int width, height, cones; // in pixels; a side of one
    int count;                // rays
    struct rn_cuda_cut cut;
    bool counts_anew; // of the samples: the first pixels of a picture
    bool straight;    // rn_march_options
    bool halves;      // rn_device_view
    float ended;      // rn_close_ended
};

// A pixel that sees nothing.
RN_DEVICE void rn_leave_background(const struct rn_cuda_batch *b, const struct rn_cuda_march *march,
                                   bool per_ray, int r) {
    const float *c = march->colour.background;
    b->pixels[r] = rn_pixel{{c[0], c[1], c[2]}, 0, 0};
    for (int i = 0; i < RN_GEOMETRY && per_ray; i++)
        b->ray_sums[(size_t)r * RN_GEOMETRY + i] = 0;
}

// One thread a pixel; those that may see something are queued for the forward.
template <int WORLD>
__global__ void __launch_bounds__(256) rn_view_kernel(const __grid_constant__ rn_cuda_view view,
                                                      const __grid_constant__ rn_cuda_scene scene,
                                                      const __grid_constant__ rn_cuda_batch batch,
                                                      const __grid_constant__ rn_cuda_march march) {
    int r = (int)(blockIdx.x * blockDim.x + threadIdx.x), tiles = 0;
    if (r < view.count) {
        int n = view.cones, pixel = r / (n * n), cone = r % (n * n);
        int place = (int)(view.places ? view.places[pixel] : view.first + (uint32_t)pixel);
        int x = place % view.width, y = place / view.width % view.height;
        const struct rn_camera *camera = &view.cameras[place / view.width / view.height];
        struct rn_ray camera_ray =
            rn_camera_ray(camera, x * n + cone % n + 0.5, y * n + cone / n + 0.5);
        struct rn_march_ray ray = rn_cut_cone<WORLD>(&view.cut, &camera_ray, 0);
        batch.rays[r] = ray;
        rn_keep_forward<WORLD>(&batch, &view.cut, r, &ray);
        tiles = rn_tiles_ahead<WORLD>(&scene.occupancy, &ray, march.step);
        if (tiles == 0) rn_leave_background(&batch, &march, scene.per_ray, r);
    }
    rn_queue_ray(&batch, r, tiles);
    if (r > 0) return;
    batch.status->ray_count = view.count;
    batch.status->queue = 0;
    if (view.counts_anew) batch.status->evaluated = 0;
}

// Colour and opacity of a pixel on their way to the host.
struct alignas(8) rn_cuda_halves {
    uint32_t pairs[2];
};

// Exact.
static inline float rn_from_half(uint32_t half) {
    uint32_t size = half & 0x7fff, bits = (size << 13) + (112u << 23),
             small = size << 13 | 113u << 23;
    float value, denormal;
    bits += size >= 0x7c00 ? 112u << 23 : 0; // infinity, NaN
    memcpy(&value, &bits, sizeof value);
    memcpy(&denormal, &small, sizeof denormal);
    value = size < 0x400 ? denormal - 6.103515625e-05f : value;
    return half & 0x8000 ? -value : value;
}

static inline struct rn_pixel rn_pixel_of_halves(const struct rn_cuda_halves *from) {
    uint32_t first = from->pairs[0], second = from->pairs[1];
    struct rn_pixel pixel = {
        {rn_from_half(first & 0xffff), rn_from_half(first >> 16), rn_from_half(second & 0xffff)},
        rn_from_half(second >> 16),
        0};
    return pixel;
}

#ifdef __x86_64__
// Four numbers at once, where the processor has the instruction: while a picture comes the host
// does little else.
__attribute__((target("f16c"))) static void
rn_take_halves_f16c(const struct rn_cuda_halves *from, size_t count, struct rn_pixel *ret) {
    for (size_t i = 0; i < count; i++) {
        float four[4];
        _mm_storeu_ps(four, _mm_cvtph_ps(_mm_loadl_epi64((const __m128i *)(const void *)&from[i])));
        ret[i] = rn_pixel{{four[0], four[1], four[2]}, four[3], 0};
    }
}
#endif

// Pixels that have arrived.
static inline void rn_take_pixels(const void *staged, size_t count, bool halves,
                                  struct rn_pixel *ret) {
    const struct rn_cuda_halves *from = (const struct rn_cuda_halves *)staged;
    if (!halves) {
        memcpy(ret, staged, count * sizeof *ret);
        return;
    }
#ifdef __x86_64__
    if (__builtin_cpu_supports("f16c")) {
        rn_take_halves_f16c(from, count, ret);
        return;
    }
#endif
    for (size_t i = 0; i < count; i++)
        ret[i] = rn_pixel_of_halves(&from[i]);
}

// From cones to pixels, one thread a pixel: to `to`, as rn_pixel or, where `view` says so, as
// rn_cuda_halves.
__global__ void __launch_bounds__(256)
    rn_develop_kernel(const __grid_constant__ rn_cuda_view view,
                      const __grid_constant__ rn_cuda_march march, struct rn_pixel *cones,
                      void *to) {
    int i = (int)(blockIdx.x * blockDim.x + threadIdx.x), n = view.cones;
    if (i >= view.count / (n * n)) return;
    struct rn_pixel *own = cones + (size_t)i * (size_t)(n * n);
    for (int k = 0; k < n * n; k++)
        rn_close_ended(view.ended, march.colour.background, &own[k]);
    struct rn_pixel p =
        n == 1 ? *own : rn_cones_mean(own, n, view.straight ? march.colour.background : NULL);
    if (view.halves)
        ((struct rn_cuda_halves *)to)[i] =
            rn_cuda_halves{{rn_pack(p.rgb[0], p.rgb[1]), rn_pack(p.rgb[2], p.alpha)}};
    else
        ((struct rn_pixel *)to)[i] = p;
}

// ---- order and sums -------------------------------------------------------------------------

// What the rays of a step come to.
struct rn_sums {
    double loss, weight;
    uint64_t samples;
    float size; // of `gradients` samples
    uint32_t gradients, returned, pieces;
};
RN_DEVICE void rn_sums_add(struct rn_sums *to, const struct rn_sums *other) {
    to->loss += other->loss;
    to->weight += other->weight;
    to->size += other->size;
    to->samples += other->samples;
    to->returned += other->returned;
    to->gradients += other->gradients;
    to->pieces += other->pieces;
}

// A warp's part of the rays; its lanes take them in turn.
struct rn_ray_part {
    int begin, end;
};
RN_DEVICE struct rn_ray_part rn_ray_part(int count) {
    int warp = (int)threadIdx.x / RN_LANES, warps = RN_ORDER_THREADS / RN_LANES;
    struct rn_ray_part p = {(int)((int64_t)count * warp / warps),
                            (int)((int64_t)count * (warp + 1) / warps)};
    return p;
}

RN_DEVICE struct rn_sums rn_sum_rays(const struct rn_cuda_batch *b, struct rn_ray_part part) {
    struct rn_sums sums = {0, 0, 0, 0, 0, 0, 0};
    for (int r = part.begin + RN_LANE; r < part.end; r += RN_LANES) {
        struct rn_cuda_return back = b->ray_return[r];
        struct rn_sums ray = {(double)b->ray_loss[r],
                              (double)b->ray_weight[r],
                              (uint64_t)b->ray_samples[r],
                              back.size,
                              (uint32_t)back.gradients,
                              (uint32_t)back.count,
                              (uint32_t)rn_cuda_pieces(back.count)};
        rn_sums_add(&sums, &ray);
    }
    return sums;
}

// What becomes of a step of which all rays are known.
RN_DEVICE void rn_take_sums(const struct rn_cuda_batch *b, const struct rn_sums *all) {
    struct rn_cuda_status *s = b->status;
    int count = s->ray_count;
    s->loss = all->loss;
    s->weight = all->weight;
    s->samples += all->samples;
    s->rays += (uint64_t)count;
    s->crowded = s->tiles > b->tile_capacity;
    s->rejected |= s->crowded || !(all->loss < 1e300);
    s->returned = s->rejected ? 0 : all->returned;
    s->pieces = all->pieces;
    s->samples_returned += s->returned;
    float size = all->gradients > 0 ? all->size / (float)all->gradients / s->gradient_scale : 0;
    s->gradient_size = size < 1e30f ? size : 0;
    double next = (double)count * s->target_samples / (double)all->samples + 1;
    if (s->crowded) next = count / 2;
    if (all->samples == 0) next = count;
    next = next < RN_FEWEST_RAYS ? RN_FEWEST_RAYS : next;
    s->next_rays = next < b->ray_capacity ? (int)next : b->ray_capacity;
    s->next_rays -= s->next_rays % b->pixel_rays;
}

// The place of every ray's samples in the list of those that are backpropagated, the pieces of
// rays, and the step's sums; one block. Ray after ray, so that nothing depends on which warp came
// first.
__global__ void __launch_bounds__(RN_ORDER_THREADS, 1)
    rn_order_kernel(const __grid_constant__ rn_cuda_batch b) {
    RN_SHARED struct rn_sums sums[RN_ORDER_THREADS / RN_LANES][RN_LANES + 1]; // no bank twice
    int warp = (int)threadIdx.x / RN_LANES;
    struct rn_ray_part part = rn_ray_part(b.status->ray_count);
    sums[warp][RN_LANE] = rn_sum_rays(&b, part);
    __syncthreads();
    if (warp == 0) { // lane i sums what warp i found
        for (int k = 1; k < RN_LANES; k++)
            rn_sums_add(&sums[RN_LANE][0], &sums[RN_LANE][k]);
        __syncwarp();
        if (RN_LANE == 0) {
            struct rn_sums all = {0, 0, 0, 0, 0, 0, 0};
            for (int i = 0; i < RN_LANES; i++) {
                uint32_t before = all.returned, pieces = all.pieces;
                rn_sums_add(&all, &sums[i][0]);
                sums[i][0].returned = before;
                sums[i][0].pieces = pieces;
            }
            rn_take_sums(&b, &all);
        }
    }
    __syncthreads();
    int first = (int)sums[warp][0].returned, piece = (int)sums[warp][0].pieces;
    for (int r = part.begin; r < part.end; r += RN_LANES) {
        int own = r + RN_LANE, count = own < part.end ? b.ray_return[own].count : 0;
        int before = rn_sum_before(count, RN_LANES), pieces = rn_cuda_pieces(count);
        int pieces_before = rn_sum_before(pieces, RN_LANES);
        if (own < part.end) b.ray_return[own].first = first + before;
        for (int i = 0; i < pieces; i++)
            b.pieces[piece + pieces_before + i] = rn_cuda_piece{own, i * RN_PIECE};
        first += rn_shuffle(before + count, RN_LANES - 1);
        piece += rn_shuffle(pieces_before + pieces, RN_LANES - 1);
    }
}

// Every backpropagated sample to its place. One thread a sample.
__global__ void __launch_bounds__(256) rn_place_kernel(const __grid_constant__ rn_cuda_batch b) {
    uint32_t sample = blockIdx.x * blockDim.x + threadIdx.x, slot = sample / RN_TILE;
    if (b.status->rejected || slot >= b.status->tiles) return;
    struct rn_cuda_return ray = b.ray_return[b.tile_ray[slot]];
    if (ray.count == 0) return; // its tiles say nothing
    uint32_t rows = b.tile_rows[slot], bit = 1u << sample % RN_TILE;
    if (!(rows & bit)) return;
    int place = ray.first + ray.count - b.tile_behind[slot] + rn_popcount(rows & (bit - 1));
    b.returned[place] = sample;
    b.returned_mid[place] = b.mid[sample];
}

// The errors of the blocks after the losses of a step's rays, in the rays' order, whatever order
// they came in; nothing of a step that is rejected. One thread a ray: that which came last of its
// block does it for all.
__global__ void __launch_bounds__(256) rn_errors_kernel(const __grid_constant__ rn_cuda_batch b) {
    int r = (int)(blockIdx.x * blockDim.x + threadIdx.x), done = -1;
    int block = r < b.status->ray_count ? b.ray_block[r] : -1;
    if (block < 0 || b.block_ray[block] != r + 1) return;
    float error = b.block_error[block];
    for (;;) {
        int next = b.ray_capacity;
        for (int i = r; i >= 0; i = b.ray_before[i] - 1)
            if (i > done && i < next) next = i;
        if (next == b.ray_capacity) break;
        error = rn_block_error(error, b.ray_error[next]);
        done = next;
    }
    if (!b.status->rejected) b.block_error[block] = error;
    b.block_ray[block] = 0;
}

// Counts the step and makes ready for the next; one thread.
__global__ void rn_finish_kernel(struct rn_cuda_status *s) {
    if (threadIdx.x != 0) return;
    // Rays that are not finite are left out; where no other is left, that is the step's fault.
    if (!(s->weight > 0) && s->nonfinite_rays > s->nonfinite_before) s->rejected = 1;
    s->nonfinite_before = s->nonfinite_rays;
    bool overflow = s->overflowed || (s->rejected && !s->crowded);
    s->steps++;
    if (!s->crowded) {
        s->steps_rejected += (uint64_t)(s->rejected != 0);
        s->rejected_in_a_row = s->rejected ? s->rejected_in_a_row + 1 : 0;
    }
    s->updates += (uint64_t)!rn_cuda_step_skipped(s);
    s->good_steps = overflow ? 0 : s->good_steps + 1;
    float scale = overflow ? s->gradient_scale * 0.5f : s->gradient_scale;
    if (s->good_steps == RN_SCALE_PATIENCE) {
        scale *= 2;
        s->good_steps = 0;
    }
    s->gradient_scale = fminf(fmaxf(scale, RN_SCALE_LEAST), RN_SCALE_MOST);
    s->ray_count = s->next_rays;
    s->queue = s->tiles = 0;
    for (int l = 0; l < RN_LENGTHS; l++)
        s->queued[l] = 0;
    s->rejected = s->crowded = s->overflowed = 0;
    s->evaluated = 0;
}

#endif
