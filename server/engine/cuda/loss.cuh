// The loss of rays that are composited, its gradient back to every sample's outputs, and which
// samples are backpropagated. shade.cuh has the loss of fields that shade whole rays.
#ifndef RN_ENGINE_CUDA_LOSS_CUH
#define RN_ENGINE_CUDA_LOSS_CUH

#include "common/math/rng.h"
#include "server/engine/cuda/forward.cuh"
#include "server/engine/field/loss.h"

// ---- loss -----------------------------------------------------------------------------------

RN_LOSS_FUNCTION(rn_loss_of_lane, struct rn_march_ray, float, float)

// Loss of a pixel of that colour, and its gradient back to the composited colours and opacities of
// its rays. False where the ray takes no part.
RN_DEVICE bool rn_ray_loss(const struct rn_march_ray *ray, const struct rn_cuda_march *march,
                           const float colour[3], float opacity, float ret_grad[4],
                           float *ret_loss) {
    *ret_loss = rn_loss_of_lane(&march->colour, ray, colour, opacity, ret_grad);
    rn_colour_back_lane(&march->colour, ret_grad);
    return opacity > 0 && ray->weight > 0 && *ret_loss < 3e38f;
}

// What a ray's loss adds to the step; `loss` is looked at where the ray takes part.
RN_DEVICE void rn_save_loss(const struct rn_cuda_batch *b, int index, bool takes_part, float weight,
                            float loss, float opacity) {
    b->ray_loss[index] = takes_part ? weight * loss : 0;
    b->ray_weight[index] = takes_part ? weight : 0;
    if (b->ray_error) b->ray_error[index] = takes_part ? loss : 0;
    if (!takes_part) b->ray_samples[index] = 0;
    if (!takes_part && !(opacity <= 0))
        atomicAdd((unsigned long long *)&b->status->nonfinite_rays, 1ull);
}

// What a pixel shows.
struct rn_seen {
    float opacity, colour[3];
};

// The mean over `rays` rays from ray `first` on.
RN_DEVICE struct rn_seen rn_seen_by(const struct rn_cuda_batch *b,
                                    const struct rn_cuda_march *march, int first, int rays) {
    struct rn_seen mean = {0, {0, 0, 0}};
    float share = 1 / (float)rays;
    for (int r = first; r < first + rays; r++) {
        const float *sums = b->ray_sums + (size_t)r * RN_GEOMETRY;
        float seen[3] = {sums[1], sums[2], sums[3]};
        rn_colour_seen_lane(&march->colour, sums[0], seen);
        mean.opacity += share * sums[0];
        for (int c = 0; c < 3; c++)
            mean.colour[c] += share * seen[c];
    }
    return mean;
}

// ---- roulette -------------------------------------------------------------------------------

#define RN_STREAM_ROULETTE 0x6c6f747300000000u
#define RN_CERTAIN (1 << 24) // chances are in units of 2^-24

// Roulette along one ray, by the sizes of its samples' gradients (backward_select of
// cpu/backward.h): below `threshold` a gradient is backpropagated with the chance that its size has
// to it.
struct rn_roulette {
    float threshold; // 0: all are backpropagated
    uint32_t sum;    // of the chances so far, from a random start
};

RN_DEVICE struct rn_roulette rn_roulette_start(const struct rn_cuda_batch *b, int r) {
    const struct rn_cuda_status *s = b->status;
    struct rn_roulette l = {b->roulette * s->gradient_size * s->gradient_scale, 0};
    if (!(l.threshold > 0 && l.threshold < 3e38f)) l.threshold = 0;
    l.sum = rn_rng_draw(b->seed, RN_STREAM_ROULETTE | (uint32_t)r, s->steps).v[0];
    return l;
}

// Whether lane i's sample is backpropagated, and what its gradient is to be multiplied by; lanes
// 0..15. What is not finite always is, to be seen.
RN_DEVICE bool rn_roulette_draw(struct rn_roulette *l, float size, float *ret_factor) {
    int chance = RN_CERTAIN;
    if (size < l->threshold)
        chance = (int)fminf(size * ((float)RN_CERTAIN / l->threshold) + 1, (float)RN_CERTAIN);
    if (size == 0 || RN_LANE >= RN_TILE) chance = 0;
    uint32_t before = l->sum + (uint32_t)rn_sum_before(chance, RN_TILE),
             after = before + (uint32_t)chance;
    l->sum = (uint32_t)rn_shuffle((int)after, RN_TILE - 1);
    *ret_factor = chance > 0 ? (float)RN_CERTAIN / (float)chance : 0;
    return before / RN_CERTAIN != after / RN_CERTAIN;
}

// ---- distortion -----------------------------------------------------------------------------

// What distortion is measured in (reach_of in cpu/crisp.h): how far behind the ray's origin a
// sample lies, or in unbounded space its place. A parameter of the kernels, which without the loss
// do nothing for it.
enum rn_distorts { RN_DISTORTS_NOT, RN_DISTORTS_ALONG, RN_DISTORTS_PLACES };
template <int DISTORTS> RN_DEVICE float rn_reach(float mid) {
    return DISTORTS == RN_DISTORTS_PLACES ? 0.5f * rn_place_of_distance_lane(mid) : mid;
}

// The distortion loss along one ray (distort in cpu/crisp.h), tiles taken from its last to its
// first: sums of the weights, and of weights times reach, of all samples and of those behind.
struct rn_distortion {
    float factor, width; // of the loss; of a sample
    double all, all_moment, behind, behind_moment;
};

template <int DISTORTS>
RN_DEVICE struct rn_distortion rn_distortion_start(const struct rn_cuda_batch *b,
                                                   const struct rn_cuda_march *march, int r) {
    int rays = b->pixel_rays;
    if (!DISTORTS) return rn_distortion{0, 0, 0, 0, 0, 0};
    float weight = b->status->distortion * b->rays[r - r % rays].weight / (float)rays;
    struct rn_distortion d = {
        weight * b->status->gradient_scale, march->step * (float)b->rays[r].stride, 0, 0, 0, 0};
    for (int slot = b->ray_last[r]; slot >= 0; slot = b->tile_previous[slot]) {
        size_t at = (size_t)slot * RN_TILE + RN_LANE % RN_TILE;
        float own = b->weight[at];
        d.all += (double)rn_tile_sum(own);
        d.all_moment += (double)rn_tile_sum(own * rn_reach<DISTORTS>(b->mid[at]));
    }
    return d;
}

// Its part of dL/dw of lane i's sample, scaled; collective.
template <int DISTORTS>
RN_DEVICE float rn_distort(const struct rn_cuda_batch *b, size_t at, struct rn_distortion *d) {
    float weight = b->weight[at], reach = rn_reach<DISTORTS>(b->mid[at]), moment = weight * reach;
    float behind = rn_sum_behind(weight), behind_moment = rn_sum_behind(moment);
    float beyond = (float)(d->all - 2 * (d->behind + (double)behind));
    float beyond_moment = (float)(d->all_moment - 2 * (d->behind_moment + (double)behind_moment));
    d->behind += (double)rn_shuffle(behind + weight, 0);
    d->behind_moment += (double)rn_shuffle(behind_moment + moment, 0);
    float apart = reach * beyond - beyond_moment;
    return weight > 0 ? d->factor * (2 * apart + weight * d->width * (2.0f / 3)) : 0;
}

// ---- back to the samples --------------------------------------------------------------------

// dL/d(density logit) of a tile's samples, lane i (mod 16) sample i's, tiles taken from a ray's
// last to its first: dL/dx_i = after_i g_i - sum behind i of w g. `slope`: g_i = dL/dw_i; `behind`:
// the sum behind the tile, moved to its front.
RN_DEVICE float rn_attenuate_backward(const struct rn_cuda_batch *b, size_t at, float slope,
                                      double *behind) {
    float product = b->weight[at] * slope, rest = rn_sum_behind(product);
    float change = b->after[at] * slope - (float)(*behind + (double)rest);
    *behind += (double)rn_shuffle(rest + product, 0);
    return change * b->depth[at];
}

// Notes which samples of a tile are backpropagated, lane i sample i's answer, and adds them to
// those behind it.
RN_DEVICE void rn_return_tile(const struct rn_cuda_batch *b, int slot, bool returns, int *behind) {
    uint32_t rows = rn_ballot(returns && RN_LANE < RN_TILE);
    *behind += rn_popcount(rows);
    if (RN_LANE > 0) return;
    b->tile_rows[slot] = rows;
    b->tile_behind[slot] = *behind;
}

// dL/d(colour logits) and dL/d(density logit) of the samples of one ray, whose loss has the
// gradient `grad` (rn_ray_loss); g_i = grad[3] + grad . colour_i, and the distortion's. From the
// last tile to the first; those that the roulette takes are backpropagated.
template <int DISTORTS>
RN_DEVICE void rn_composite_backward(const struct rn_cuda_batch *b,
                                     const struct rn_cuda_march *march, int r, const float grad[4],
                                     float scale, struct rn_cuda_return *ret) {
    struct rn_roulette roulette = rn_roulette_start(b, r);
    struct rn_distortion distortion = rn_distortion_start<DISTORTS>(b, march, r);
    double behind = 0;
    for (int slot = b->ray_last[r]; slot >= 0; slot = b->tile_previous[slot]) {
        size_t at = (size_t)slot * RN_TILE + RN_LANE % RN_TILE;
        float weight = b->weight[at], slope = grad[3], size = 0, sigmoid[3], factor;
        for (int c = 0; c < 3; c++) {
            float colour = b->colour[((size_t)slot * 3 + c) * RN_TILE + RN_LANE % RN_TILE];
            sigmoid[c] = weight > 0 ? scale * grad[c] * weight * colour * (1 - colour) : 0;
            slope += weight > 0 ? grad[c] * colour : 0;
            size += fabsf(sigmoid[c]);
        }
        slope *= scale;
        if (DISTORTS) slope += rn_distort<DISTORTS>(b, at, &distortion);
        float logit = rn_attenuate_backward(b, at, slope, &behind);
        size += fabsf(logit);
        rn_return_tile(b, slot, rn_roulette_draw(&roulette, size, &factor), &ret->count);
        ret->size += rn_tile_sum(size);
        ret->gradients += rn_popcount(rn_ballot(RN_LANE < RN_TILE && size != 0));
        if (RN_LANE >= RN_TILE) continue;
        for (int c = 0; c < 3; c++)
            b->colour_grad[((size_t)slot * 3 + c) * RN_TILE + RN_LANE] = factor * sigmoid[c];
        b->logit_grad[at] = factor * logit;
    }
}

// A warp a ray. Each ray of a split pixel has its share of the pixel's weight.
template <int DISTORTS>
__global__ void __launch_bounds__(256) rn_loss_kernel(const __grid_constant__ rn_cuda_batch batch,
                                                      const __grid_constant__ rn_cuda_march march) {
    int rays = march.split ? RN_PIXEL_RAYS : 1, stride = (int)(gridDim.x * blockDim.x / RN_LANES);
    float share = 1 / (float)rays, scale = share * batch.status->gradient_scale;
    for (int r = (int)(blockIdx.x * blockDim.x + threadIdx.x) / RN_LANES;
         r < batch.status->ray_count; r += stride) {
        const struct rn_march_ray *ray = &batch.rays[r];
        struct rn_cuda_return returned = {0, 0, 0, 0};
        struct rn_seen seen = rn_seen_by(&batch, &march, r - r % rays, rays),
                       own = rn_seen_by(&batch, &march, r, 1);
        float grad[4], loss, sum = own.opacity + own.colour[0] + own.colour[1] + own.colour[2];
        bool takes_part = rn_ray_loss(ray, &march, seen.colour, seen.opacity, grad, &loss);
        if (takes_part) rn_composite_backward<DISTORTS>(&batch, &march, r, grad, scale, &returned);
        if (RN_LANE > 0) continue;
        batch.ray_return[r] = returned;
        rn_save_loss(&batch, r, takes_part, share * ray->weight, loss,
                     march.split && isfinite(sum) ? 0 : own.opacity);
    }
}

#endif
