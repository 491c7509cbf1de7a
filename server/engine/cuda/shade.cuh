// Fields that shade whole rays (field/mlp.h, ray shading): the colour network for sixteen rays a
// tile, from the sums that the forward left. Rendering adds its colour to the pixels; training
// takes the loss back through it to the sums, and from there to every sample of the ray.
#ifndef RN_ENGINE_CUDA_SHADE_CUH
#define RN_ENGINE_CUDA_SHADE_CUH

#include "server/engine/cuda/backward.cuh"
#include "server/engine/cuda/loss.cuh"

// ---- the colour network ---------------------------------------------------------------------

// The network's inputs of a tile of rays; 0 behind the last one.
RN_DEVICE void rn_ray_inputs(const struct rn_cuda_scene *scene, const struct rn_cuda_batch *b,
                             const struct rn_cuda_march *march, uint32_t tile,
                             uint32_t (&in)[2][4]) {
    for (int i = 0; i < 2; i++) {
        int r = (int)tile * RN_TILE + RN_LANE / 4 + 8 * i;
        uint32_t direction[2] = {0, 0}, sums[2] = {0, 0};
        if (r < b->status->ray_count) {
            const float *from = b->ray_sums + (size_t)r * RN_GEOMETRY + 2 * (RN_LANE % 4);
            float look[3];
            rn_look(march, rn_direction_of(b, r), look);
            rn_direction(scene, look, direction);
            for (int k = 0; k < 2; k++)
                sums[k] = rn_pack(from[8 * k], from[8 * k + 1]);
        }
        for (int k = 0; k < 2; k++) {
            in[0][i + 2 * k] = direction[k];
            in[1][i + 2 * k] = sums[k];
        }
    }
}

// Clears the rows of a fragment that are not in `rows`, one bit each.
RN_DEVICE void rn_keep_rows(uint32_t (&a)[2][4], uint32_t rows) {
    for (int i = 0; i < 8; i++)
        if (!(rows >> (RN_LANE / 4 + 8 * (i % 2)) & 1)) a[i / 4][i % 4] = 0;
}

// Adds the network's part to the pixel of lane i's ray, if that meets anything.
RN_DEVICE void rn_shade_pixel(const struct rn_cuda_batch *b, const struct rn_cuda_march *march,
                              int r, const float colour[3]) {
    if (RN_LANE >= RN_TILE || r >= b->status->ray_count) return;
    float opacity = b->ray_sums[(size_t)r * RN_GEOMETRY], *rgb = b->pixels[r].rgb;
    if (opacity == 0) return;
    for (int c = 0; c < 3; c++)
        rgb[c] += opacity * colour[c];
    rn_colour_seen_lane(&march->colour, opacity, rgb);
}

// ---- training -------------------------------------------------------------------------------

// What the loss of lane i's ray asks, scaled; 0 where it takes no part.
struct rn_ray_gradient {
    bool takes_part;
    float colour[3];           // of the network's outputs
    float opacity, diffuse[3]; // of these sums, but for what comes through the network
};

// The mean over the rays of a pixel, which are in neighbouring lanes.
RN_DEVICE struct rn_seen rn_pixel_mean(struct rn_seen s) {
    for (int mask = 1; mask < RN_PIXEL_RAYS; mask *= 2) {
        s.opacity = 0.5f * (s.opacity + rn_shuffle_xor(s.opacity, mask));
        for (int c = 0; c < 3; c++)
            s.colour[c] = 0.5f * (s.colour[c] + rn_shuffle_xor(s.colour[c], mask));
    }
    return s;
}

RN_DEVICE struct rn_ray_gradient rn_ray_gradient(const struct rn_cuda_batch *b,
                                                 const struct rn_cuda_march *march, int r,
                                                 const float out[3]) {
    struct rn_ray_gradient g = {};
    bool is = RN_LANE < RN_TILE && r < b->status->ray_count;
    float opacity = is ? b->ray_sums[(size_t)r * RN_GEOMETRY] : 0, colour[3] = {0, 0, 0};
    for (int c = 0; c < 3 && is && opacity != 0; c++)
        colour[c] = b->ray_sums[(size_t)r * RN_GEOMETRY + 1 + c] + opacity * out[c];
    rn_colour_seen_lane(&march->colour, opacity, colour);
    struct rn_seen seen = {opacity, {colour[0], colour[1], colour[2]}};
    float share = march->split ? 1.0f / RN_PIXEL_RAYS : 1;
    if (march->split) seen = rn_pixel_mean(seen);
    if (!is) return g;
    float grad[4], loss, scale = b->status->gradient_scale * share;
    g.takes_part = rn_ray_loss(&b->rays[r], march, seen.colour, seen.opacity, grad, &loss);
    bool sound = isfinite(opacity + colour[0] + colour[1] + colour[2]) && march->split;
    rn_save_loss(b, r, g.takes_part, b->rays[r].weight * share, loss, sound ? 0 : opacity);
    if (g.takes_part) g.opacity = scale * grad[3];
    for (int c = 0; c < 3 && g.takes_part; c++) {
        g.diffuse[c] = scale * grad[c];
        g.colour[c] = g.diffuse[c] * opacity;
        g.opacity += g.diffuse[c] * out[c];
    }
    return g;
}

// Puts dL/d(sums) in the sums' place. `c`: the part that came through the network.
RN_DEVICE void rn_store_sums_grad(const struct rn_cuda_batch *b, uint32_t tile,
                                  const struct rn_ray_gradient *g, const float (&c)[2][4]) {
    float direct[2][4] = {};
    rn_set_column(direct, 0, g->opacity);
    for (int k = 0; k < 3; k++)
        rn_set_column(direct, 1 + k, g->diffuse[k]);
    for (int i = 0; i < 8; i++) {
        int r = (int)tile * RN_TILE + RN_LANE / 4 + 8 * (i / 2 % 2);
        int column = 8 * (i / 4) + 2 * (RN_LANE % 4) + i % 2;
        if (r < b->status->ray_count)
            b->ray_sums[(size_t)r * RN_GEOMETRY + column] = c[i / 4][i % 4] + direct[i / 4][i % 4];
    }
}

// A warp a tile of rays; their places in the scratch are in the rays' order.
template <int WT, bool TRAIN, bool SHARED>
__global__ void __launch_bounds__(RN_NETWORK_THREADS(SHARED, 1), 1)
    rn_shade_kernel(const __grid_constant__ rn_cuda_scene scene,
                    const __grid_constant__ rn_cuda_batch batch,
                    const __grid_constant__ rn_cuda_march march, int staged) {
    uint4 *room = (uint4 *)rn_shared_memory();
    const struct rn_cuda_network *n = &scene.head;
    const uint4 *forward = rn_stage(SHARED || staged > 0, room,
                                    scene.forward + scene.base.packed_count, n->packed_count);
    const uint4 *backward = rn_stage(TRAIN && (SHARED || staged > 1), room + n->packed_count,
                                     scene.backward + scene.base.packed_count, n->packed_count);
    rn_stage_finish();
    bool bad = false;
    for (uint32_t tile = rn_first_tile(); tile < rn_cuda_tiles((uint32_t)batch.status->ray_count);
         tile += rn_tile_stride()) {
        uint32_t in[1][2][4];
        float out[1][2][4] = {}, colour[3];
        int own = (int)tile * RN_TILE + RN_LANE % RN_TILE;
        rn_ray_inputs(&scene, &batch, &march, tile, in[0]);
        if (scene.view_dependence) rn_forward<2, WT>(n, forward, in, out);
        for (int c = 0; c < 3; c++)
            colour[c] = rn_column(out[0], c);
        if constexpr (!TRAIN) {
            rn_shade_pixel(&batch, &march, own, colour);
        } else {
            struct rn_ray_gradient g = rn_ray_gradient(&batch, &march, own, colour);
            float sums_grad[1][2][4] = {};
            if (scene.view_dependence) {
                struct rn_cuda_scratch scratch = rn_scratch(n, batch.scratch, batch.tile_capacity);
                uint32_t grad[1][1][4], x[1][WT][4];
                rn_keep_rows(in[0], rn_ballot(g.takes_part));
                rn_colour_fragment(g.colour, grad[0]);
                bad |=
                    rn_backward<2, WT, false>(n, forward, backward, &scratch, tile, 1, in, grad, x);
                rn_last_layer<WT>(x, backward + WT * RN_LANES, sums_grad);
            }
            __syncwarp(); // all lanes have read their sums
            rn_store_sums_grad(&batch, tile, &g, sums_grad[0]);
        }
    }
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

// ---- samples --------------------------------------------------------------------------------

// dL/d(outputs of the density network) of a tile, from dL/d(sums), of which a lane has its columns.
// g_i = dL/d(sums) . (1, colour_i, features_i); `behind` as in rn_attenuate_backward.
template <int DISTORTS>
RN_DEVICE void rn_sums_backward(const struct rn_cuda_batch *b, int slot,
                                const float (&sums_grad)[2][2], struct rn_distortion *distortion,
                                double *behind, float (&ret)[2][4]) {
    size_t at = (size_t)slot * RN_TILE + RN_LANE % RN_TILE;
    uint32_t kept[4];
    for (int i = 0; i < 2; i++)
        rn_load_row(b->geometry + (size_t)slot * RN_BLOCK, (uint32_t)(RN_LANE / 4 + 8 * i), i,
                    kept);
    float slopes[2] = {0, 0}, weight = b->weight[at];
    for (int i = 0; i < 8; i++) {
        float value = i % 2 ? rn_high(kept[i / 2]) : rn_low(kept[i / 2]);
        float grad = sums_grad[i / 4][i % 2];
        bool activated = i < 4 && RN_LANE % 4 < 2; // by a sigmoid; column 0 is put below
        slopes[i / 2 % 2] += grad * value;
        ret[i / 4][i % 4] = activated ? grad * value * (1 - value) : grad;
    }
    for (int i = 0; i < 2; i++) {
        float of_row = rn_shuffle(weight, RN_LANE / 4 + 8 * i);
        for (int k = 0; k < 4; k++)
            ret[k / 2][2 * i + k % 2] *= of_row;
        for (int mask = 1; mask < 4; mask *= 2)
            slopes[i] += rn_shuffle_xor(slopes[i], mask);
    }
    float slope = rn_of_row(slopes);
    if (DISTORTS) slope += rn_distort<DISTORTS>(b, at, distortion);
    rn_set_column(ret, 0, rn_attenuate_backward(b, at, weight > 0 ? slope : 0, behind));
}

// Euclidean sizes of the rows of a C fragment, lane i (mod 16) row i's.
RN_DEVICE float rn_row_size(const float (&c)[2][4]) {
    float squares[2];
    for (int i = 0; i < 2; i++) {
        squares[i] = 0;
        for (int k = 0; k < 4; k++)
            squares[i] += c[k / 2][2 * i + k % 2] * c[k / 2][2 * i + k % 2];
        for (int mask = 1; mask < 4; mask *= 2)
            squares[i] += rn_shuffle_xor(squares[i], mask);
    }
    return sqrtf(rn_of_row(squares));
}

// Gradients of the samples of a ray, from its last tile to its first, those that the roulette
// takes. True on overflow.
template <int DISTORTS>
RN_DEVICE bool rn_return_ray(const struct rn_cuda_batch *b, const struct rn_cuda_march *march,
                             int r, struct rn_cuda_return *ret) {
    const float *from = b->ray_sums + (size_t)r * RN_GEOMETRY + 2 * (RN_LANE % 4);
    const float sums_grad[2][2] = {{from[0], from[1]}, {from[8], from[9]}};
    struct rn_roulette roulette = rn_roulette_start(b, r);
    struct rn_distortion distortion = rn_distortion_start<DISTORTS>(b, march, r);
    double behind = 0;
    bool bad = false;
    for (int slot = b->ray_last[r]; slot >= 0; slot = b->tile_previous[slot]) {
        float c[2][4], factor;
        uint32_t samples[2];
        rn_sums_backward<DISTORTS>(b, slot, sums_grad, &distortion, &behind, c);
        float size = rn_row_size(c);
        bool has = RN_LANE < RN_TILE && size != 0;
        rn_return_tile(b, slot, rn_roulette_draw(&roulette, size, &factor), &ret->count);
        ret->size += rn_tile_sum(size);
        ret->gradients += rn_popcount(rn_ballot(has));
        for (int i = 0; i < 2; i++) {
            float of_row = rn_shuffle(factor, RN_LANE / 4 + 8 * i);
            samples[i] = (uint32_t)(slot * RN_TILE + RN_LANE / 4 + 8 * i);
            for (int k = 0; k < 4; k++)
                c[k / 2][2 * i + k % 2] *= of_row;
        }
        bad |= rn_store_geometry_grad(b, samples, c);
    }
    return bad;
}

// A warp a ray.
template <int DISTORTS>
__global__ void __launch_bounds__(256)
    rn_sums_backward_kernel(const __grid_constant__ rn_cuda_batch batch,
                            const __grid_constant__ rn_cuda_march march) {
    bool bad = false;
    for (int r = (int)rn_first_tile(); r < batch.status->ray_count; r += (int)rn_tile_stride()) {
        struct rn_cuda_return returned = {0, 0, 0, 0};
        if (batch.ray_samples[r] > 0) bad |= rn_return_ray<DISTORTS>(&batch, &march, r, &returned);
        if (RN_LANE == 0) batch.ray_return[r] = returned;
    }
    if (rn_ballot(bad) && RN_LANE == 0) batch.status->rejected = 1;
}

#endif
