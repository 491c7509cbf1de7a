// Where things lie on the device: the pyramid's maps, the networks' fragments, a batch. Host and
// device; tested on the host.
#ifndef RN_ENGINE_CUDA_LAYOUT_H
#define RN_ENGINE_CUDA_LAYOUT_H

#include <stddef.h>
#include <stdint.h>

#include "server/engine/field/ripmap.h"
#include "server/engine/kernels/kernels.h"

#define RN_TILE 16       // samples of one ray that are evaluated together: rows of a fragment
#define RN_UPDATE 8      // texels a side of the blocks that the optimiser works on
#define RN_FINE_LEVELS 4 // levels a side that such a block pools by itself
#define RN_CHUNKS 128    // most parts that a layer's gradients are summed in, in a fixed order

// ---- planes ---------------------------------------------------------------------------------

// What a texel of the base gives to the texels of a level along one axis, the first and the next.
struct rn_cuda_share {
    int first;
    float weight[2];
};

// The pyramids of all planes in one block of texels, plane after plane; within a plane the maps
// with both levels below RN_FINE_LEVELS first. Plain value; kernels take it as a parameter.
struct rn_cuda_planes {
    int planes, channels, base, levels, footprint;
    bool by_axis;                       // levels are (rn_levels_by_axis)
    int footprint_base;                 // side of the grid whose texels footprints are measured in
    int update_side;                    // blocks of RN_UPDATE texels a side
    const struct rn_cuda_share *shares; // [level][base]; NULL: levels halve evenly
    uint32_t plane_texels;              // of one plane, all its maps
    uint32_t fine_texels;               // of these, the maps that update blocks pool
    uint32_t map[RN_MAX_LEVELS][RN_MAX_LEVELS]; // [ly][lx]: first texel, where the map exists
    float axis[RN_MAX_PLANES][6];               // axis_u, axis_v
};

// Whether blocks of texels are pooled by themselves: the base is a multiple of 8, and all levels
// are coarsened by whole factors of two.
RN_HD bool rn_cuda_halves_evenly(const struct rn_cuda_planes *p) {
    return p->base % (1 << (p->levels > RN_FINE_LEVELS ? p->levels - 1 : RN_FINE_LEVELS - 1)) == 0;
}

// The shares of all levels, [level][base] of them.
static inline void rn_cuda_shares_init(int base, int levels, struct rn_cuda_share *ret) {
    for (int x = 0; x < base; x++)
        ret[x] = (struct rn_cuda_share){x, {1, 0}};
    for (int i = base; i < levels * base; i++) {
        const struct rn_cuda_share *finer = &ret[i - base];
        int size = rn_rip_size(base, i / base - 1), coarse = rn_rip_size(base, i / base);
        struct rn_cuda_share share = {-1, {0, 0}};
        for (int k = 0; k < 2; k++) {
            int fine = finer->first + k, last = fine / 2 < coarse ? fine / 2 : coarse - 1;
            for (int of = last > 0 ? last - 1 : 0; of <= last && finer->weight[k] > 0; of++) {
                rn_real weight[3];
                int first, taps = rn_rip_taps(size, of, &first, weight);
                if (fine < first || fine >= first + taps) continue;
                if (share.first < 0) share.first = of;
                share.weight[of - share.first] += finer->weight[k] * (float)weight[fine - first];
            }
        }
        ret[i] = share;
    }
}

// Of a mipmap only the diagonal is stored.
RN_HD bool rn_cuda_map_exists(int footprint, int lx, int ly) {
    return footprint == RN_FOOTPRINT_RIP || lx == ly;
}

static inline void rn_cuda_planes_init(struct rn_cuda_planes *p, const struct rn_field_config *c,
                                       const struct rn_solid *solid, int levels) {
    p->planes = c->planes;
    p->channels = c->channels;
    p->base = c->base;
    p->footprint_base = rn_footprint_base(c);
    p->levels = c->footprint == RN_FOOTPRINT_POINT ? 1 : levels;
    p->footprint = c->footprint;
    p->by_axis = rn_levels_by_axis(c);
    p->update_side = (c->base + RN_UPDATE - 1) / RN_UPDATE;
    p->shares = NULL;
    p->plane_texels = p->fine_texels = 0;
    for (int coarse = 0; coarse < 2; coarse++) {
        for (int ly = 0; ly < p->levels; ly++)
            for (int lx = 0; lx < p->levels; lx++) {
                bool fine = lx < RN_FINE_LEVELS && ly < RN_FINE_LEVELS;
                if (fine == (coarse == 1) || !rn_cuda_map_exists(p->footprint, lx, ly)) continue;
                p->map[ly][lx] = p->plane_texels;
                p->plane_texels += (uint32_t)(c->base >> lx) * (uint32_t)(c->base >> ly);
            }
        if (!coarse) p->fine_texels = p->plane_texels;
    }
    for (int i = 0; i < c->planes; i++)
        for (int k = 0; k < 3; k++) {
            p->axis[i][k] = (float)solid->axis_u[i][k];
            p->axis[i][3 + k] = (float)solid->axis_v[i][k];
        }
}

// ---- networks -------------------------------------------------------------------------------

// A network padded to fragments: inputs, width and outputs in units of 16, hidden layers as many as
// it has. Weights of a layer lie as [n16][k16][lane] fragments of B, once for the forward (k =
// inputs, n = outputs) and once for the backward (k = outputs, n = inputs).
struct rn_cuda_network {
    int inputs16, width16, hidden;
    int inputs, width, outputs;         // as stored in the parameters
    uint32_t source[RN_MLP_MAX_LAYERS]; // of each layer's weights, numbers from the network's first
    uint32_t packed[RN_MLP_MAX_LAYERS]; // fragments (uint4 a lane) from the network's first
    uint32_t packed_count;
};

RN_HD int rn_cuda_layer_k16(const struct rn_cuda_network *n, int layer) {
    return layer == 0 ? n->inputs16 : n->width16;
}
RN_HD int rn_cuda_layer_n16(const struct rn_cuda_network *n, int layer) {
    return layer == n->hidden ? 1 : n->width16;
}

static inline void rn_cuda_network_init(struct rn_cuda_network *n, const struct rn_mlp_shape *shape,
                                        int inputs16, int width16) {
    n->inputs16 = inputs16;
    n->width16 = width16;
    n->hidden = shape->layers - 1;
    n->inputs = shape->in[0];
    n->width = shape->out[0];
    n->outputs = shape->out[n->hidden];
    n->packed_count = 0;
    for (int l = 0; l < shape->layers; l++) {
        n->source[l] = (uint32_t)shape->offset[l];
        n->packed[l] = n->packed_count;
        n->packed_count += (uint32_t)(rn_cuda_layer_k16(n, l) * rn_cuda_layer_n16(n, l)) * 32;
    }
}

// The parts that layers' gradients are summed in: blocks of a launch, `first[l]` on for layer l.
struct rn_cuda_chunks {
    int first[RN_MLP_MAX_LAYERS + 1];
};
// Of at most `blocks`: as many as the layers' tiles have bytes. `on_chip` > 0: so many blocks have
// summed the last layer already, which takes none of these.
static inline struct rn_cuda_chunks rn_cuda_chunks_of(const struct rn_cuda_network *n, int blocks,
                                                      int on_chip) {
    struct rn_cuda_chunks chunks = {{0}};
    int all = 0, layers = n->hidden + (on_chip == 0);
    for (int l = 0; l < layers; l++)
        all += rn_cuda_layer_k16(n, l) + rn_cuda_layer_n16(n, l);
    for (int l = 0; l < layers; l++) {
        int own = blocks * (rn_cuda_layer_k16(n, l) + rn_cuda_layer_n16(n, l)) / all;
        own = own < 1 ? 1 : own < RN_CHUNKS ? own : RN_CHUNKS;
        chunks.first[l + 1] = chunks.first[l] + own;
    }
    if (on_chip) chunks.first[n->hidden + 1] = chunks.first[n->hidden] + on_chip;
    return chunks;
}

// A lane fetches eight neighbouring channels and they become columns 2t, 2t + 1, 2t + 8 and 2t + 9
// of two neighbouring fragments: which feature stands in column `k` of the density network's input.
RN_HD int rn_cuda_feature(int k) {
    int q = k % 16, high = q / 8, t = q % 8 / 2;
    return k / 32 * 32 + 8 * t + 4 * (k / 16 % 2) + 2 * high + q % 2;
}
// Where four features from `feature` on, a multiple of four, stand: fragment, and part of four.
struct rn_cuda_feature_place {
    int fragment, part;
};
RN_HD struct rn_cuda_feature_place rn_cuda_place_of_features(int feature) {
    struct rn_cuda_feature_place place = {feature / 32 * 2 + feature / 4 % 2, feature / 8 % 4};
    return place;
}

// The density network's outputs are the colour network's inputs without moving: which input stands
// in column k. Sample shading [SH, 1 in the logit's place, geometry]; ray shading [SH, sums].
RN_HD int rn_cuda_head_input(int k, bool per_ray) {
    int q = k - 16;
    if (k < 16) return k;
    if (q == 0) return 31;
    if (!per_ray) return k - 1;
    return q < 4 ? 27 + q : 12 + q;
}

// Row of the stored weights that input column k of a layer multiplies; -1 where it is padding.
RN_HD int rn_cuda_weight_row(const struct rn_cuda_network *n, bool head, bool per_ray, int layer,
                             int k) {
    if (layer > 0) return k < n->width ? k : -1;
    int row = head ? rn_cuda_head_input(k, per_ray) : rn_cuda_feature(k);
    return row < n->inputs ? row : -1;
}

// Index of weight (input column k, output column n) of a layer in the stored parameters; -1 where
// it is padding.
RN_HD int rn_cuda_weight_index(const struct rn_cuda_network *net, bool head, bool per_ray,
                               int layer, int k, int n) {
    int row = rn_cuda_weight_row(net, head, per_ray, layer, k);
    int columns = layer == net->hidden ? net->outputs : net->width;
    if (row < 0 || n >= columns) return -1;
    return (int)net->source[layer] + row * columns + n;
}

// Place of element (k, n) among the fp16 numbers of a layer's B fragments, `k16` of them along k.
RN_HD size_t rn_cuda_fragment_place(int k, int n, int k16) {
    int lane = n % 8 * 4 + k % 8 / 2, word = k % 16 / 8 + 2 * (n % 16 / 8);
    size_t fragment = (size_t)(n / 16) * (size_t)k16 + (size_t)(k / 16);
    return ((fragment * 32 + (size_t)lane) * 4 + (size_t)word) * 2 + (size_t)(k % 2);
}

// Row and column of number i of a layer's gradient, which lies as C fragments: [m16][n16][half of
// 8 columns][lane][4].
RN_HD void rn_cuda_gradient_element(size_t i, int n16, int *ret_k, int *ret_n) {
    int e = (int)(i % 4), lane = (int)(i / 4 % 32), half = (int)(i / 128 % 2);
    int block = (int)(i / 256);
    *ret_k = block / n16 * 16 + lane / 4 + 8 * (e / 2);
    *ret_n = block % n16 * 16 + 8 * half + lane % 4 * 2 + e % 2;
}

#endif
