// The CPU kernels' data and their table. One source (kernel_set.c) is compiled once a kernel set;
// which set runs is chosen at start by a short timing and recorded with the scene.
//
// All positions are in the normalised frame: the scene's ball is the unit ball, or the field's cube
// (field/disparity.h).
#ifndef RN_ENGINE_KERNELS_KERNELS_H
#define RN_ENGINE_KERNELS_KERNELS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/settings/train.h"
#include "server/engine/field/colour.h"
#include "server/engine/field/mlp.h"
#include "server/engine/field/solid.h"
#include "server/engine/field/disparity.h"
#include "server/engine/field/space.h"

#define RN_PACKET_RAYS 128     // rays marched together
#define RN_PACKET_SAMPLES 4096 // candidate samples evaluated together; bounds a ray's samples too
#define RN_PIXEL_RAYS 4        // of a pixel that is split 2 x 2: its colour is their mean
#define RN_PACKET_SLACK 64     // numbers a vector store may overrun an array by
#define RN_ROUND 8             // samples of a ray evaluated before its transmittance is looked at
#define RN_MAX_RAYS (1 << 17)  // of a training step
#define RN_GROUPS 16           // fixed partition of a step's rays: the unit of ordered accumulation
#define RN_OFFENDERS 4         // non-finite rays of a group that are remembered
#define RN_BRICK 8             // occupancy cells a side of a brick

// One map of one plane: [v][u][channel], rows of width * channels numbers and room for one texel
// more after the last.
struct rn_map {
    float *texels;
    int width, height;
};

// Whether map (x, y) of a pyramid is built: all of a ripmap, the zigzag diagonal of a mipmap.
static inline bool rn_map_exists(bool mip, int x, int y) {
    return !mip || x == y || x == y + 1;
}

// The occupancy grid as the march reads it. Cell (x, y, z) covers [-1 + 2x/n, -1 + 2(x+1)/n] ...
// Bricks of 8^3 cells, 16 words each: bit (y & 3) * 8 + x of word 2 z + (y >> 2).
struct rn_occupancy_bits {
    int cells;         // n a side, RN_BRICK times a power of two
    uint32_t *words;   // (n/8)^3 * 16
    uint8_t *distance; // (n/8)^3 + 3: bricks to the nearest occupied one (Chebyshev), 0 = occupied
    float low[3], high[3]; // box around all occupied cells; low > high when none
    enum rn_space space;   // that the cells divide
};

// A field as the kernels read it. Plain pointers, owned by struct rn_field (scene.h).
struct rn_cpu_field {
    const struct rn_field_config *config; // of the struct rn_field that this belongs to
    struct rn_solid solid;
    struct rn_disparity disparity; // that the planes cover; measured (effects/forward_facing.c)
    struct rn_mlp_shape base_shape, head_shape;
    int features;                             // rn_feature_count
    int feature_stride;                       // features rounded up to 16
    const float *base_weights, *head_weights; // [in][out] as the shapes say
    const float *base_packed, *head_packed;   // what the kernel set's `pack` made of them
    struct rn_map maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS]; // [plane][ly][lx]; behind the
                                                                     // planes the voxels' [0][0]
    int built_levels; // maps with lx, ly < built_levels exist
    struct rn_occupancy_bits occupancy;
};

static inline size_t rn_appearance_numbers(const struct rn_field_config *config) {
    return (size_t)config->appearances * RN_APPEARANCE;
}

// Room for what a kernel set packs of a network, in numbers.
static inline size_t rn_mlp_packed_count(const struct rn_mlp_shape *shape) {
    size_t count = 0;
    for (int l = 0; l < shape->layers; l++)
        count += (size_t)((shape->in[l] + 31) / 32 * 32) * (size_t)((shape->out[l] + 31) / 32 * 32);
    return count;
}

// A cone to march. `origin` lies on the ray where it enters the scene's box, `near` from the
// camera, so that far cameras lose no digits: position = origin + direction * s,
// distance = near + s, s = (k + 1/2) step stride.
//
// In unbounded space `origin` is the point of the ray nearest to the centre, so that s may be
// negative, and s = rn_distance_of_place(2 - length + (2k + 1) step).
struct rn_march_ray {
    float origin[3], direction[3];
    float near;      // distance of `origin` from the camera
    float length;    // of the ray's part inside box and ball, from origin; <= 0: misses.
                     // Unbounded: of its part behind the camera's near end, in places (space.h)
    float radius;    // of the cone, per unit of distance
    int stride;      // steps of the march that one sample spans: 1, 2, 4 or 8
    float target[3]; // training: the pixel over the background
    float alpha;     // training: the pixel's own
    float weight;    // training: area weight; <= 0 means absent
    uint32_t id;     // for the counter-based random numbers
};

// What the rays of one camera share: the camera in the frame of the scene's ball. rn_view_init
// (kernels/ray.h).
struct rn_view {
    double origin[3], axes[3][3]; // axes: of world_from_camera
    double cx, cy, inverse_fx, inverse_fy;
    double radius;                 // of the cones, per unit of distance
    const struct rn_camera *lens;  // the camera where it has one, NULL where it is a pinhole
    enum rn_space space;           // of the field
    struct rn_disparity disparity; // forward: origin and axes are in its reference camera's frame
};

// A pixel to look through; (0, 0) is the first. `view` NULL: absent.
struct rn_ray_place {
    const struct rn_view *view;
    int x, y;
    float jitter; // of a sample's interval, [0, 1)
};

struct rn_march_options {
    float step;       // normalised
    float stop_depth; // -ln of the early-stop transmittance
    struct rn_colouring colour;
    float distortion_loss;  // training: weight of the distortion loss; 0: there is none
    bool split;             // training: RN_PIXEL_RAYS rays in turn are one pixel
    bool straight;          // pictures: a pixel's cones are averaged as render/cones.h has it
    float roulette;         // times a packet's mean gradient, below which a sample's backward is
                            // by roulette; 0 = off
    uint64_t seed, counter; // of the roulette
    uint16_t *samples;      // pictures: NULL, or of each ray: its samples are added
    bool whole_levels;      // pictures: of the nearest level alone, not between two
    // Of a field with appearances: [photograph][RN_APPEARANCE], NULL: 0 in all; and of a ray's id
    // whose of them it has, NULL: the first.
    const float *appearances;
    const uint32_t *photographs;
    const float *look; // NULL, or a direction for the colour network instead of the ray's
};

// Whether the field holds a place, which reaches as far as its cameras see, and not what lies in a
// ball.
static inline bool rn_is_place(const struct rn_cpu_field *field) {
    return field->disparity.on || field->config->space == RN_SPACE_UNBOUNDED;
}

// Whether the last sample of a ray takes what shines through the others: there is a place behind
// everything, and colours are summed up along the ray.
static inline bool rn_ends_opaque(const struct rn_cpu_field *field) {
    return rn_is_place(field) && field->config->shading == RN_SHADING_RAY;
}

// Where among a field's appearances that of a ray begins.
static inline size_t rn_appearance_at(const struct rn_march_options *options,
                                      const struct rn_march_ray *ray) {
    return options->photographs ? (size_t)options->photographs[ray->id] * RN_APPEARANCE : 0;
}

static inline int rn_pixel_rays(const struct rn_march_options *options) {
    return options->split ? RN_PIXEL_RAYS : 1;
}

// What one group of rays leaves for the scatter: samples with gradients, in order.
struct rn_slab {
    int count, capacity;
    float *u[RN_MAX_PLANES], *v[RN_MAX_PLANES];   // plane coordinates, [-1, 1]
    float *lx[RN_MAX_PLANES], *ly[RN_MAX_PLANES]; // levels; unused when every sample is at level 0
    float *grad[RN_MAX_PLANES];                   // [sample][channel]
    float *voxel[3], *voxel_grad; // place in the planes' frame; [sample][RN_VOXEL_CHANNELS]
};

// Sums over the rays of one group, in order. Cleared at the start of a step.
struct rn_group {
    struct rn_slab slab;
    int cursor, end; // rays of the batch still to do: [cursor, end)
    int packet;      // how many a packet begins with; halved where they have no room. 0: the most
    float *base_grad, *head_grad, *appearance_grad; // one behind the other
    uint32_t *seen;  // NULL, or of a cell: the largest weight it showed (cpu/crisp.h)
    float *ray_loss; // NULL, or of a ray's id: its loss without the weight
    double loss, weight;
    uint64_t evaluated; // samples whose density was computed
    uint64_t samples;   // of these, the ones that enter the loss
    uint64_t returned;  // of these, the ones that were backpropagated (roulette)
    uint64_t rays_hit, nonfinite_rays;
    uint32_t offender[RN_OFFENDERS]; // ids of the first non-finite rays
    uint64_t level_samples[RN_MAX_LEVELS];
};

// Rows of features that have zeros behind them: so many features of so many bytes each.
struct rn_padding {
    int features, bytes, rows;
};

// Thread-local scratch of one packet. Arrays lie in one block behind the structure.
struct rn_workspace {
    int capacity;        // samples
    int full;            // of these, how many a packet is filled to; a pixel's may be more
    int ray_count;       // of the packet
    int room;            // for a ray's candidates
    uint16_t *candidate; // [RN_PACKET_RAYS][room]: march indices k in occupied cells, in order
    int candidate_count[RN_PACKET_RAYS]; // found so far
    // Segments of at most RN_ROUND samples of one ray, in the order of evaluation.
    int segment_count;
    int32_t *segment_start;               // [capacity]: first sample
    int16_t *segment_size, *segment_next; // [capacity]; next segment of the ray or -1
    int16_t ray_first[RN_PACKET_RAYS], ray_last[RN_PACKET_RAYS];
    int ray_next[RN_PACKET_RAYS];     // candidate to evaluate next
    double ray_depth[RN_PACKET_RAYS]; // optical depth so far
    // Samples, in the order of evaluation.
    int count;
    uint8_t *ray;   // of each sample
    float *s;       // distance behind ray.origin of the frustum's middle
    float *marched; // the same as marched: its distance in the cube; written where space is forward
    float *interval; // in density units; 0 outside the ball
    float *u[RN_MAX_PLANES], *v[RN_MAX_PLANES], *lx[RN_MAX_PLANES], *ly[RN_MAX_PLANES];
    float *voxel[3];                  // where a sample looks in the voxel grid; where there is one
    void *features;                   // [capacity]: rows in the kernel set's own form
    struct rn_padding padded;         // of these
    float *hidden[RN_MLP_MAX_LAYERS]; // [capacity][width], in the kernel set's own form
    float *geometry;                  // [capacity][16]: outputs, then activated in place
    float *x, *before, *weight, *after; // optical depth; depth before; weight; T behind
    float *head_in, *head_hidden[RN_MLP_MAX_LAYERS], *head_out; // rows: samples or rays
    float *slope;                           // [capacity]: dL/d(weight), then dL/d(optical depth)
    float *size;                            // [capacity]: of a sample's dL/d(geometry), about
    int32_t *chance;                        // [capacity]: of being backpropagated
    float *geometry_grad, *grad_a, *grad_b; // [capacity][16], [capacity][widest] twice
    float *weight_sums;                     // a network's weight gradients of one packet
    int32_t *kept;                          // [capacity]
};
// Bytes of a workspace for a field, and its layout in `memory` (64-byte aligned).
size_t rn_workspace_size(const struct rn_cpu_field *field, double step);
int rn_workspace_capacity(const struct rn_cpu_field *field, double step); // its `capacity`
struct rn_workspace *rn_workspace_init(const struct rn_cpu_field *field, double step, void *memory);

struct rn_pixel {
    float rgb[3], alpha, depth; // depth: sum of weight * distance over alpha, normalised; 0 if none
};

// One contiguous part of the planes' optimiser state.
struct rn_adamw {
    float scale; // of the gradients, before anything else
    float rate, decay, eps;
    float keep, fresh;              // of the second moment: beta2 and 1 - beta2; the first's 0.9
    float correction1, correction2; // 1 - 0.9^t, 1 - beta2^t
};

// The tiles of a plane that the optimiser visits as a whole or not at all: as large as a texel of
// the coarsest map, at least 16 numbers along u. Shifts from texels of level 0; tiles a row and a
// column, with room for one more.
struct rn_tiling {
    int shift_x, shift_y, columns, rows;
};

static inline struct rn_tiling rn_tiling(int base, int channels, int levels) {
    int least = channels >= 16 ? 0 : channels >= 8 ? 1 : 2;
    struct rn_tiling t = {.shift_x = levels - 1 > least ? levels - 1 : least,
                          .shift_y = levels - 1};
    t.columns = (base >> t.shift_x) + 2;
    t.rows = (base >> t.shift_y) + 2;
    return t;
}

// One plane's update. A base that is not a multiple of 2^(levels - 1) texels has no such tiles:
// pull_down, the update of level 0 alone, build.
struct rn_plane_update {
    const struct rn_adamw *options;
    struct rn_map (*maps)[RN_MAX_LEVELS], (*grad_maps)[RN_MAX_LEVELS];
    struct rn_map (*to)[RN_MAX_LEVELS]; // where the new texels go, laid out as `maps`; NULL: there
    float *m, *v;                       // as maps[0][0]
    uint8_t *touched;                   // marks of rn_tiling, cleared; NULL: every tile
    int levels, channels;
    bool mip;
};

// Whether a group has rays to do and room for what a packet of them leaves.
static inline bool rn_group_is_open(const struct rn_group *group, const struct rn_workspace *w) {
    return group->cursor < group->end && group->slab.capacity - group->slab.count >= w->capacity;
}

// The parts of a packet's work that can be run by themselves, for benchmarks.
enum rn_stage {
    RN_STAGE_MARCH,        // finds all candidates of every ray
    RN_STAGE_ENCODE,       // positions, levels and features of every sample
    RN_STAGE_MLP_FORWARD,  // both networks
    RN_STAGE_COMPOSITE,    // densities, weights and sums along the rays
    RN_STAGE_MLP_BACKWARD, // both networks, for the samples in the group's slab
};

// What the networks' products are made with.
enum rn_product_unit { RN_PRODUCT_FMA, RN_PRODUCT_BF16_DOT, RN_PRODUCT_AMX };

// What kernels are made of, for those who check, time or choose them; training and pictures call
// none of it.
struct rn_kernel_parts {
    // One product as the networks make them: c[rows][n] = a[rows][k] b[k][n], n a
    // multiple of 16.
    void (*gemm)(int rows, int k, int n, const float *a, int a_stride, const float *b, int b_stride,
                 float *c, int c_stride);
    // Vector functions: y[i] = f(x[i]), n a multiple of 16.
    void (*exp)(size_t n, const float *x, float *y);
    void (*one_minus_exp)(size_t n, const float *x, float *y);
    void (*log2)(size_t n, const float *x, float *y);
    // Moments and footprint of one ray's samples as the encoder computes them: for
    // distance t[i] and a width and radius; mean shift (mean - t), axial and radial variance.
    void (*moments)(size_t n, const float *t, float width, float radius, float *shift, float *axial,
                    float *radial);
    // One part of a packet's work again, over what `train` left in the workspace for exactly these
    // rays (march: any, up to RN_PACKET_RAYS). Returns the rows of the density network (march: 0).
    // The weights' gradients of the backward are added to the group's; the features' are returned
    // in *ret_grad ([row][feature_stride], in the workspace), which may be NULL.
    int (*stage)(const struct rn_cpu_field *field, const struct rn_march_options *options,
                 const struct rn_march_ray *rays, int count, enum rn_stage stage,
                 struct rn_workspace *workspace, struct rn_group *group, const float **ret_grad);
    // The features of a sample of the workspace. A set that rounds the networks' operands to bf16
    // keeps them so.
    void (*put_features)(const struct rn_cpu_field *field, int sample, const float *features,
                         struct rn_workspace *workspace);
    void (*get_features)(const struct rn_cpu_field *field, int sample,
                         const struct rn_workspace *workspace, float *ret_features);
};

struct rn_kernels {
    const char *name;
    enum rn_product_unit unit;
    // After a change of a network's weights: writes `packed`, rn_mlp_packed_count numbers, from
    // which this set's products read.
    void (*pack)(const struct rn_mlp_shape *shape, const float *weights, float *ret_packed);
    // The rays of `count` places as rn_camera_ray and rn_ray_cut give them, in float64 and rounded
    // to fp32 last: a direction is within 8 ULP of float64 before that, start and end are as far
    // off as rn_march_ray_from says; a stride differs only where two are equally good within 16
    // ULP. Of an absent place or a cone that misses the length is 0. Weight 1, no target, id 0.
    void (*rays)(const struct rn_ray_place *places, int count, double step, bool cone_step,
                 struct rn_march_ray *ret_rays);
    // Forward and backward of a packet, the next of rays[group->cursor .. group->end), whose slab
    // has room for it: rn_group_is_open. Gradients are of the sum over rays of weight * smooth-L1:
    // the division by the sum of weights is the optimiser's (rn_adamw.scale).
    void (*train)(const struct rn_cpu_field *field, const struct rn_march_options *options,
                  const struct rn_march_ray *rays, struct rn_workspace *workspace,
                  struct rn_group *group);
    // Forward of `count` rays. Returns the number of samples evaluated.
    uint64_t (*render)(const struct rn_cpu_field *field, const struct rn_march_options *options,
                       const struct rn_march_ray *rays, int count, struct rn_workspace *workspace,
                       struct rn_pixel *ret_pixels);
    // Densities at `count` points [x, y, z], all at one level of every plane.
    void (*density)(const struct rn_cpu_field *field, float (*points)[3], int count, float level,
                    struct rn_workspace *workspace, float *ret_density);
    // Adds a slab's gradients of one plane, or of the voxels behind the last one, to `grad_maps`
    // (indexed as field->maps), rows of level 0 in [row_begin, row_end) and the rows of coarser
    // maps they pool into; marks the touched tiles of rn_tiling in `touched`. Of `levels` maps a
    // side gradients are kept; 1: the slab has no levels.
    void (*scatter)(const struct rn_cpu_field *field, const struct rn_slab *slab, int plane,
                    int levels, int row_begin, int row_end,
                    struct rn_map (*grad_maps)[RN_MAX_LEVELS], uint8_t *touched);
    // AdamW on the tiles of the plane's rows [row_begin, row_end), whole tiles. Their part of all
    // maps is up to date afterwards, and of all gradients zero. Returns whether all new parameters
    // are finite.
    bool (*update)(const struct rn_plane_update *update, int row_begin, int row_end);
    // Pools a plane's maps of any size from maps[0][0] up to `levels` a side (mip: the diagonal
    // chain only); and the adjoint, which leaves all gradient in maps[0][0] and clears the others.
    void (*build)(struct rn_map (*maps)[RN_MAX_LEVELS], int levels, bool mip, int channels);
    void (*pull_down)(struct rn_map (*grad_maps)[RN_MAX_LEVELS], int levels, bool mip,
                      int channels);
    // Draws every texel of a plane of side^2 towards its four neighbours: x + share (their sum - 4
    // x), texels whose u + v is even first; beyond the border a texel is its own neighbour. share
    // in [0, 1/4]: no texel leaves the range of the five. Error: 8 ULP of the largest of them.
    void (*smooth)(float *texels, int side, int channels, float share);
    // The same of one slice of a grid of side^3 voxels: those whose x + y + z is even, or `odd`,
    // are drawn towards their six neighbours, share in [0, 1/6]; all slices of one, then of the
    // other. Error: 8 ULP of the largest of them.
    void (*smooth_voxels)(float *voxels, int side, int z, bool odd, float share);
    // AdamW over n numbers (Loshchilov & Hutter 2019); clears grad. Returns whether all parameters
    // are finite.
    bool (*adamw)(const struct rn_adamw *options, size_t n, float *parameter, float *grad, float *m,
                  float *v);
    const struct rn_kernel_parts *parts;
};

// Whether the networks' operands are rounded to bf16.
static inline bool rn_kernels_bf16(const struct rn_kernels *kernels) {
    return kernels->unit != RN_PRODUCT_FMA;
}

// NULL when this build or machine does not have the set.
const struct rn_kernels *rn_kernels_find(const char *name);
// The i-th set that this machine can run, from plain to wide; NULL past the end.
const struct rn_kernels *rn_kernels_available(int i);

#endif
