// A field and its training on the device: host structures, memory, and which kernels serve a shape.
#ifndef RN_ENGINE_CUDA_FIELD_CUH
#define RN_ENGINE_CUDA_FIELD_CUH

#include "server/engine/cuda/occupancy.cuh"
#include "server/engine/cuda/optimise.cuh"
#include "server/engine/cuda/shade.cuh"
#include "server/engine/cuda/step.cuh"
#include "server/engine/cuda/uneven.cuh"

#define RN_DEVICE_MAX_RAYS (1 << 17)
#define RN_RENDER_PIXELS (1 << 17) // of one launch: the host takes one part while the next comes

struct rn_backend_device {
    int ordinal, processors;
    size_t shared_bytes; // of one block
    size_t used_bytes;
    cudaStream_t stream, copies; // kernels; pixels on their way to the host
    // Those pixels, in pinned memory; when a part was rendered, and when it arrived. Made with the
    // first picture.
    void *staged[2];
    uint32_t *places[2]; // on their way to the device, likewise
    cudaEvent_t rendered[2], arrived[2];
};

// The kernels of one padded shape; of each the second where all that it stages fits shared memory.
struct rn_kernel_shape {
    enum rn_world world;
    int inputs16, width16;
    void (*train[2])(struct rn_cuda_scene, struct rn_cuda_batch, struct rn_cuda_march, int);
    void (*render[2])(struct rn_cuda_scene, struct rn_cuda_batch, struct rn_cuda_march, int);
    void (*shade_train[2])(struct rn_cuda_scene, struct rn_cuda_batch, struct rn_cuda_march, int);
    void (*shade_render[2])(struct rn_cuda_scene, struct rn_cuda_batch, struct rn_cuda_march, int);
    // The third: two tiles a warp.
    void (*head_backward[3])(struct rn_cuda_scene, struct rn_cuda_batch, int);
    void (*base_backward[3])(struct rn_cuda_scene, struct rn_cuda_batch, int, float4 *);
    void (*base_on_chip)(struct rn_cuda_scene, struct rn_cuda_batch, int, float4 *);
    void (*measure[2])(struct rn_cuda_scene, struct rn_cuda_measurement, int); // of a ball
};

// Events between the kernels of a step that is timed.
struct rn_timer {
    int count; // of stages that have ended
    const char *names[RN_DEVICE_STAGES];
    cudaEvent_t events[RN_DEVICE_STAGES + 1]; // the first: the beginning
};

struct rn_device_field {
    struct rn_backend_device *device;
    struct rn_train_config config;
    struct rn_cuda_cut cut; // but for the step
    enum rn_world world;
    struct rn_solid solid;
    const struct rn_kernel_shape *shape;
    struct rn_cuda_scene scene;
    struct rn_cuda_occupancy finer[RN_DEVICE_FINER]; // of pictures; no cells: there are none
    struct rn_cuda_scene seen;                       // what a picture's rays march through
    uint8_t *spare_distance;
    size_t parameter_count;
    struct rn_cuda_batch view; // for rendering
    struct rn_camera *cameras; // of the picture under way
    uint32_t *places;          // of its part under way
    struct rn_pixel *parts[2]; // the pixels of a picture's parts in turn
    void *memory, *train_memory;
    size_t memory_bytes, train_bytes;
    // training
    bool deterministic, last_on_chip, two_tiles;
    struct rn_cuda_batch batch;
    struct rn_cuda_optimiser optimiser;
    struct rn_cuda_source source;
    struct rn_cuda_march march;
    cudaGraphExec_t graph;
    struct rn_timer *timer; // NULL but for a step that is timed
    uint64_t steps;         // queued
};

// Hands out parts of one block, 256-byte aligned; with `base` NULL it only counts.
struct rn_arena {
    char *base;
    size_t used;
};
template <typename T> static void rn_part(struct rn_arena *a, T **ret, size_t count) {
    *ret = a->base ? (T *)(void *)(a->base + a->used) : NULL;
    a->used += (count * sizeof(T) + 255) / 256 * 256;
}

// Parts of the field's block; of the training's block.
void rn_field_lay_out(struct rn_device_field *field, struct rn_arena *arena);
void rn_train_lay_out(struct rn_device_field *field, const struct rn_device_pixels *pixels,
                      struct rn_arena *arena);

// Turns an outcome of the runtime into a status: NO_MEMORY, or UNAVAILABLE for what the device does
// not recover from.
enum rn_status rn_cuda_check(cudaError_t outcome, const char *doing, struct rn_error *err);

// Shared memory and the number of networks staged in it (forward.cuh): as many of the two as fit;
// whether that is all, and threads a block of the backward's kernels then, whose warps take one
// tile or two at a time: two only where it is all.
struct rn_staging {
    int networks;
    size_t bytes;
    bool all;
    int tiles, threads;
};
struct rn_staging rn_staging_for(const struct rn_backend_device *device, size_t first,
                                 size_t second, int tiles);

// Queues the refresh of the march's bits; the measurement of cells before it.
cudaError_t rn_queue_occupancy(struct rn_device_field *field);
cudaError_t rn_queue_measurement(struct rn_device_field *field, const struct rn_device_step *step);
// Queues what new parameters entail: pyramids and fragments.
cudaError_t rn_queue_refresh(struct rn_device_field *field);
// Queues the smoothing of planes and voxels, and the maps.
cudaError_t rn_queue_smoothing(struct rn_device_field *field, float share);
// Queues the kernels of one step.
cudaError_t rn_queue_step(struct rn_device_field *field);
// Queues the pixels of a view, to `to` as rn_develop_kernel has them.
cudaError_t rn_queue_view(struct rn_device_field *field, const struct rn_cuda_view *view,
                          const struct rn_cuda_march *march, void *to);

#endif
