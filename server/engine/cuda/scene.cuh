// The kernels' view of a field and of a batch of rays: pointers into device memory, all of one
// allocation each (backend.cu).
#ifndef RN_ENGINE_CUDA_SCENE_CUH
#define RN_ENGINE_CUDA_SCENE_CUH

#include "server/engine/cuda/device.cuh"

#define RN_REAL double
#define RN_WIDE double // devices have no wider type
extern "C" {
#include "server/engine/cuda/layout.h"
#include "server/engine/field/voxels.h"
#include "server/engine/kernels/backend.h"
#include "server/engine/kernels/pixel.h"
#include "server/engine/kernels/ray.h"
}

// What samples lie in: a parameter of the kernels that look at them, so that what a field has none
// of costs it nothing. The ball without voxels; with; all of space, and a disparity box, either.
enum rn_world { RN_WORLD_BALL, RN_WORLD_VOXELS, RN_WORLD_UNBOUNDED, RN_WORLD_FORWARD };

// How many cells there are of a kind.
struct rn_cuda_cells {
    uint32_t occupied, drawn;
};

// Bricks of a grid of so many cells a side.
static inline size_t rn_cuda_bricks(int cells) {
    size_t side = (size_t)cells / RN_BRICK;
    return side * side * side;
}

// The occupancy grid as the march reads it (struct rn_occupancy_bits), and what it is made from.
struct rn_cuda_occupancy {
    int cells;
    double limit; // of a step's optical depth, above which a cell is occupied
    uint32_t *words;
    uint8_t *distance;
    int *box;        // low x y z, high x y z in cells; low > high when none
    float *values;   // cells^3
    uint8_t *hull;   // cells^3
    uint32_t *list;  // cells that may hold matter
    uint32_t count;  // of `list`
    uint32_t *drawn; // of these, those that are measured next; NULL where cells are not drawn
    struct rn_cuda_cells *cells_now;
    double *partial; // sums of the values, one a block
    bool by_sight;   // of a place: values are what cells showed (train/seen.c)
    bool forward;    // a disparity box
};

// The grid of voxels beside the planes, as the parameters have it.
struct rn_cuda_voxels {
    const float4 *first;
    int side; // 0: there is none
};

struct rn_cuda_scene {
    struct rn_cuda_planes planes;
    struct rn_cuda_voxels voxels;
    struct rn_cuda_network base, head;
    struct rn_cuda_occupancy occupancy;
    bool per_ray, view_dependence;
    uint16_t *texels;  // fp16 pyramids, [texel][channel]
    uint4 *forward;    // the networks' fragments: base, then head
    uint4 *backward;   // likewise
    float *parameters; // planes [plane][v][u][channel], voxels, base, head, as the CPU has them
    size_t plane_count;
};

// How a camera's cones become rays.
struct rn_cuda_cut {
    double centre[3], radius, step;
    bool cone_step;
    struct rn_disparity disparity;
};

// What a ray of a forward-facing space was: the direction that the colour network is told.
struct rn_cuda_forward {
    float view[3];
    struct rn_forward_line line;
};

// What a march needs besides the scene.
struct rn_cuda_march {
    float step, stop_depth;
    struct rn_colouring colour;
    bool split;  // rn_march_options
    bool turned; // `look` replaces the rays' direction for the colour network
    float look[3];
};

// Rays are taken by how many tiles they may have, the long ones first: 16 and more, 8, 4, fewer. A
// ray that comes last then holds nobody up.
#define RN_LENGTHS 4

// Counters and sums of one step; the host reads a copy now and then.
struct rn_cuda_status {
    int ray_count, next_rays;    // of this step, of the next one
    int target_samples;          // that the number of rays aims at
    uint32_t queue;              // next ray of the forward
    uint32_t queued[RN_LENGTHS]; // rays that may see something, by their length
    uint32_t tiles;              // slots taken
    uint32_t returned;           // samples that are backpropagated
    uint32_t pieces;             // of rays that have some
    int rejected;                // this step overflowed: nothing is updated
    int crowded;                 // the tiles did not suffice
    int overflowed;              // a texel's gradient overflowed: it alone was left out
    int rejected_in_a_row;
    uint64_t updates, steps, steps_rejected, nonfinite_rays, nonfinite_numbers;
    uint64_t nonfinite_before;                // rays, in the steps before this one
    uint64_t samples, rays, samples_returned; // totals of training
    uint64_t level_samples[RN_MAX_LEVELS];
    unsigned long long evaluated; // samples of the last render or step
    double loss, weight;          // of this step: sums over rays
    float distortion;             // weight of that loss in this step
    float gradient_size;          // of a sample, unscaled: mean of the step before; 0: none
    float gradient_scale;         // of everything in fp16 that is a gradient
    int good_steps;               // since the scale was last changed
};

// Whether the step under way updates nothing.
RN_HD bool rn_cuda_step_skipped(const struct rn_cuda_status *s) {
    return s->rejected || !(s->weight > 0);
}

// Tiles that `rows` rows fill.
RN_HD uint32_t rn_cuda_tiles(uint32_t rows) {
    return (rows + RN_TILE - 1) / RN_TILE;
}

// Samples of a ray that are backpropagated.
struct rn_cuda_return {
    int count;
    int first;     // its first place in `returned`
    float size;    // sum of the gradients' sizes before the roulette, where there is one
    int gradients; // samples that have one
};

// A part of a ray's backpropagated samples, at most RN_PIECE from its `begin`-th on. The longest
// ray is several, so that none decides when a kernel ends.
#define RN_PIECE 64
struct rn_cuda_piece {
    int ray, begin;
};
RN_HD int rn_cuda_pieces(int samples) {
    return (samples + RN_PIECE - 1) / RN_PIECE;
}

// A batch: rays, and tiles of samples that the forward leaves for the backward. A sample is known
// by slot * RN_TILE + row.
struct rn_cuda_batch {
    struct rn_cuda_status *status;
    int ray_capacity;
    int pixel_rays; // training: rays in turn that are one pixel
    uint32_t tile_capacity;
    uint64_t seed;  // of the roulette
    float roulette; // rn_march_options
    struct rn_march_ray *rays;
    struct rn_cuda_forward *forward; // of rays, in a forward-facing space
    const float *looks;              // the first ray's direction for the colour network,
    int look_stride;                 // numbers to the next one's
    uint32_t *seen;                  // training of a place: of a cell (rn_group)
    int *queue; // [RN_LENGTHS][ray_capacity]: rays that the forward takes, of each length
    struct rn_pixel *pixels; // rendering only: of rays
    // of each ray
    float *ray_loss, *ray_weight;
    // Drawing by error: of each block its error, and 1 + the ray of it that came last; of each ray
    // 1 + the one before, its block or -1, and its pixel's loss.
    float *block_error, *ray_error;
    int *block_ray, *ray_before, *ray_block;
    int *ray_samples, *ray_last; // samples seen, the last tile
    struct rn_cuda_return *ray_return;
    struct rn_cuda_piece *pieces; // of all rays, one after the other
    // [ray][RN_GEOMETRY]: sums of a ray that is shaded as a whole, in training then dL/d(sums),
    // scaled; else in training opacity and colour
    float *ray_sums;
    // of each tile slot
    int *tile_ray, *tile_previous;
    uint32_t *tile_rows;   // that are backpropagated, one bit each
    int *tile_behind;      // backpropagated samples of its ray, from this tile on
    uint2 *features;       // [slot][inputs16][row][4 lanes]
    uint2 *geometry;       // [slot][row][4]: columns 16..31 of rn_cuda_head_input
    float *mid;            // [sample]: distance behind ray.origin
    float *depth;          // optical depth of each sample
    float *weight, *after; // and transmittance behind it
    // sample shading; the gradients are scaled
    float *colour;        // [slot][3][16]
    float *colour_grad;   // [slot][3][16]: of the colour network's outputs
    float *logit_grad;    // [sample]
    uint2 *geometry_grad; // [sample][4]: of the density network's outputs
    // backpropagated samples, ray after ray, front to back
    uint32_t *returned;
    float *returned_mid;
    float4 *queries;     // [backpropagated sample][plane]: rn_queries_kernel
    uint2 *feature_grad; // [tile of 16 of them][inputs16][row][4]
    uint4 *scratch;      // activations and gradients of one network's layers
};

#endif
