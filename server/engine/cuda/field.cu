// Memory of fields, and the queues of kernels.
#include "server/engine/cuda/field.cuh"

#include <stdio.h>

#define RN_BLOCKS(count) (unsigned)(((count) + 255) / 256)

// ---- memory ---------------------------------------------------------------------------------

// What a march reads.
static void lay_out_bits(struct rn_cuda_occupancy *o, struct rn_arena *a) {
    size_t bricks = rn_cuda_bricks(o->cells);
    rn_part(a, &o->words, bricks * 16);
    rn_part(a, &o->distance, bricks);
    rn_part(a, &o->box, 6);
}

static void lay_out_occupancy(struct rn_device_field *f, struct rn_arena *a) {
    struct rn_cuda_occupancy *o = &f->scene.occupancy;
    size_t n = (size_t)o->cells * (size_t)o->cells * (size_t)o->cells;
    lay_out_bits(o, a);
    for (int i = 0; i < RN_DEVICE_FINER; i++)
        if (f->finer[i].cells > 0) lay_out_bits(&f->finer[i], a);
    rn_part(a, &f->spare_distance, rn_cuda_bricks(o->cells));
    rn_part(a, &o->values, n);
    rn_part(a, &o->hull, n);
    rn_part(a, &o->list, n);
    if (f->config.sample_cells) rn_part(a, &o->drawn, n);
    rn_part(a, &o->cells_now, 1);
    rn_part(a, &o->partial, RN_OCCUPANCY_PARTS);
}

// The directions that the colour network is told of a batch's rays.
static void lay_out_looks(const struct rn_device_field *f, struct rn_cuda_batch *b,
                          struct rn_arena *a) {
    bool forward = f->world == RN_WORLD_FORWARD;
    if (forward) rn_part(a, &b->forward, (size_t)b->ray_capacity);
    if (!a->base) return;
    b->looks = forward ? b->forward->view : b->rays->direction;
    b->look_stride = (int)((forward ? sizeof *b->forward : sizeof *b->rays) / sizeof *b->looks);
}

void rn_field_lay_out(struct rn_device_field *f, struct rn_arena *a) {
    struct rn_cuda_scene *s = &f->scene;
    size_t fragments = s->base.packed_count + s->head.packed_count;
    rn_part(a, &s->parameters, f->parameter_count);
    if (!rn_cuda_halves_evenly(&s->planes))
        rn_part(a, (struct rn_cuda_share **)&s->planes.shares,
                (size_t)s->planes.levels * (size_t)s->planes.base);
    rn_part(a, &s->texels,
            (size_t)s->planes.planes * s->planes.plane_texels * (size_t)s->planes.channels);
    rn_part(a, &s->forward, fragments);
    rn_part(a, &s->backward, fragments);
    lay_out_occupancy(f, a);
    rn_part(a, &f->view.status, 1);
    f->view.ray_capacity = RN_RENDER_PIXELS;
    rn_part(a, &f->view.rays, RN_RENDER_PIXELS);
    rn_part(a, &f->view.queue, RN_LENGTHS * RN_RENDER_PIXELS);
    rn_part(a, &f->view.pixels, RN_RENDER_PIXELS);
    rn_part(a, &f->cameras, RN_DEVICE_CAMERAS);
    rn_part(a, &f->places, RN_RENDER_PIXELS);
    for (int i = 0; i < 2; i++)
        rn_part(a, &f->parts[i], RN_RENDER_PIXELS);
    s->voxels.first =
        (const float4 *)s->parameters + rn_grid_numbers(&f->config.field) / 4 * s->planes.planes;
    lay_out_looks(f, &f->view, a);
    if (s->per_ray) rn_part(a, &f->view.ray_sums, RN_RENDER_PIXELS * RN_GEOMETRY);
}

static void lay_out_tiles(struct rn_device_field *f, struct rn_arena *a) {
    struct rn_cuda_batch *b = &f->batch;
    size_t tiles = b->tile_capacity, samples = tiles * RN_TILE, k = (size_t)f->scene.base.inputs16;
    size_t base = rn_cuda_scratch_fragments(&f->scene.base);
    size_t head = rn_cuda_scratch_fragments(&f->scene.head);
    rn_part(a, &b->tile_ray, tiles);
    rn_part(a, &b->tile_previous, tiles);
    rn_part(a, &b->tile_rows, tiles);
    rn_part(a, &b->tile_behind, tiles);
    rn_part(a, &b->features, tiles * k * RN_BLOCK);
    rn_part(a, &b->geometry, tiles * RN_BLOCK);
    rn_part(a, &b->mid, samples);
    rn_part(a, &b->depth, samples);
    rn_part(a, &b->weight, samples);
    rn_part(a, &b->after, samples);
    if (!f->scene.per_ray) {
        rn_part(a, &b->colour, 3 * samples);
        rn_part(a, &b->colour_grad, 3 * samples);
        rn_part(a, &b->logit_grad, samples);
    }
    rn_part(a, &b->geometry_grad, tiles * RN_BLOCK);
    rn_part(a, &b->returned, samples);
    rn_part(a, &b->returned_mid, samples);
    rn_part(a, &b->queries, samples * (size_t)f->scene.planes.planes);
    rn_part(a, &b->feature_grad, tiles * k * RN_BLOCK);
    rn_part(a, &b->scratch, tiles * (base > head ? base : head) * RN_LANES);
}

static void lay_out_pixels(struct rn_device_field *f, const struct rn_device_pixels *p,
                           struct rn_arena *a) {
    rn_part(a, (struct rn_device_frame **)&f->source.pixels.frames, (size_t)p->frame_count);
    rn_part(a, (uint8_t **)&f->source.pixels.rgba, 4 * (size_t)p->pixel_count);
    if (p->used)
        rn_part(a, (uint32_t **)&f->source.pixels.used, rn_device_used_words(p->pixel_count));
    rn_part(a, (struct rn_device_block **)&f->source.pixels.live, (size_t)p->live_count);
    if (!p->shares.share) return;
    size_t blocks = (size_t)p->live_count, rays = (size_t)f->batch.ray_capacity;
    rn_part(a, (float **)&f->source.pixels.shares.share, blocks);
    size_t places = rn_share_place(p->scale_count, blocks) + 1;
    rn_part(a, (double **)&f->source.pixels.shares.sum, places);
    rn_part(a, (uint32_t **)&f->source.pixels.shares.guide, places);
    rn_part(a, &f->batch.block_error, blocks);
    rn_part(a, &f->batch.block_ray, blocks);
    rn_part(a, &f->batch.ray_error, rays);
    rn_part(a, &f->batch.ray_before, rays);
    rn_part(a, &f->batch.ray_block, rays);
}

static int voxel_count(const struct rn_device_field *f) {
    int side = f->scene.voxels.side;
    return side * side * side;
}

void rn_train_lay_out(struct rn_device_field *f, const struct rn_device_pixels *pixels,
                      struct rn_arena *a) {
    struct rn_cuda_batch *b = &f->batch;
    struct rn_cuda_optimiser *o = &f->optimiser;
    const struct rn_cuda_planes *p = &f->scene.planes;
    size_t rays = (size_t)b->ray_capacity, cells = (size_t)f->scene.occupancy.cells;
    size_t numbers = (size_t)p->planes * p->plane_texels * (size_t)p->channels;
    rn_part(a, &b->status, 1);
    rn_part(a, &b->rays, rays);
    lay_out_looks(f, b, a);
    if (f->scene.occupancy.by_sight) rn_part(a, &b->seen, cells * cells * cells);
    rn_part(a, &b->queue, RN_LENGTHS * rays);
    rn_part(a, &b->ray_loss, rays);
    rn_part(a, &b->ray_weight, rays);
    rn_part(a, &b->ray_samples, rays);
    rn_part(a, &b->ray_last, rays);
    rn_part(a, &b->ray_return, rays);
    rn_part(a, &b->pieces, rays + (size_t)b->tile_capacity * RN_TILE / RN_PIECE);
    rn_part(a, &b->ray_sums, rays * RN_GEOMETRY);
    lay_out_tiles(f, a);
    lay_out_pixels(f, pixels, a);
    rn_part(a, &o->update, 1);
    rn_part(a, &o->m, f->parameter_count);
    rn_part(a, &o->v, f->parameter_count);
    rn_part(a, &o->base_sums, RN_CHUNKS * rn_cuda_gradient_count(&f->scene.base) / 4);
    rn_part(a, &o->head_sums, RN_CHUNKS * rn_cuda_gradient_count(&f->scene.head) / 4);
    if (f->deterministic)
        rn_part(a, &o->gradients.fixed, numbers);
    else
        rn_part(a, &o->gradients.half, numbers / 4);
    rn_part(a, &o->gradients.touched,
            (size_t)p->planes * (size_t)p->update_side * (size_t)p->update_side);
    size_t voxels = (size_t)voxel_count(f);
    if (voxels == 0) return;
    if (f->deterministic)
        rn_part(a, &o->gradients.voxels_fixed, voxels * RN_VOXEL_CHANNELS);
    else
        rn_part(a, &o->gradients.voxels, voxels * RN_VOXEL_CHANNELS);
    rn_part(a, &o->gradients.voxels_touched, voxels / RN_VOXELS_A_MARK + 1);
}

enum rn_status rn_cuda_check(cudaError_t outcome, const char *doing, struct rn_error *err) {
    if (outcome == cudaSuccess) return RN_OK;
    (void)cudaGetLastError(); // else the next launch would say it again
    enum rn_status status =
        outcome == cudaErrorMemoryAllocation ? RN_ERROR_NO_MEMORY : RN_ERROR_UNAVAILABLE;
    return rn_error_set(err, status, "cuda", "%s failed: %s", doing, cudaGetErrorString(outcome));
}

// ---- launches -------------------------------------------------------------------------------

struct rn_staging rn_staging_for(const struct rn_backend_device *device, size_t first,
                                 size_t second, int tiles) {
    size_t one = first * sizeof(uint4), both = (first + second) * sizeof(uint4);
    int fewer = RN_NETWORK_THREADS(false, 1);
    if (both <= device->shared_bytes)
        return rn_staging{2, both, true, tiles, RN_NETWORK_THREADS(true, tiles)};
    if (one <= device->shared_bytes) return rn_staging{1, one, false, 1, fewer};
    return rn_staging{0, 0, false, 1, fewer};
}

// Of kernels that declare none themselves: always all, since a graph of another field may launch
// the same kernel with more.
template <typename K> static cudaError_t allow_shared(const struct rn_backend_device *d, K kernel) {
    return cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                (int)d->shared_bytes);
}

#define RN_TRY(call)                                                                               \
    do {                                                                                           \
        cudaError_t outcome = (call);                                                              \
        if (outcome != cudaSuccess) return outcome;                                                \
    } while (0)

// A stage of a step has been queued.
static cudaError_t mark(struct rn_device_field *f, const char *stage) {
    struct rn_timer *t = f->timer;
    if (!t) return cudaSuccess;
    t->names[t->count++] = stage;
    return cudaEventRecord(t->events[t->count], f->device->stream);
}

// Lets a kernel have as much shared memory as there is. How many of its blocks the device holds at
// once, for a kernel that takes its work from a list.
template <typename K>
static cudaError_t fill(const struct rn_backend_device *d, K kernel, int threads, size_t shared,
                        unsigned *ret_blocks) {
    int each = 0;
    RN_TRY(allow_shared(d, kernel));
    RN_TRY(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&each, kernel, threads, shared));
    *ret_blocks = (unsigned)(d->processors * (each > 1 ? each : 1));
    return cudaSuccess;
}

cudaError_t rn_queue_occupancy(struct rn_device_field *f) {
    struct rn_cuda_occupancy *o = &f->scene.occupancy;
    uint8_t *spare = f->spare_distance;
    cudaStream_t stream = f->device->stream;
    int bricks = o->cells / RN_BRICK;
    size_t count = (size_t)bricks * (size_t)bricks * (size_t)bricks;
    RN_TRY(cudaMemsetAsync(o->box, 0x7f, 3 * sizeof(int), stream));
    RN_TRY(cudaMemsetAsync(o->box + 3, 0xff, 3 * sizeof(int), stream));
    RN_TRY(cudaMemsetAsync(spare, 255, count, stream));
    RN_TRY(cudaMemsetAsync(o->cells_now, 0, sizeof *o->cells_now, stream));
    RN_TRY(RN_LAUNCH(rn_occupancy_sum_kernel, RN_OCCUPANCY_PARTS, 256, 0, stream, *o));
    RN_TRY(RN_LAUNCH(rn_occupancy_bits_kernel, RN_BLOCKS(count * 16), 256, 0, stream, *o, spare));
    RN_TRY(RN_LAUNCH(rn_distance_kernel, RN_BLOCKS(count), 256, 0, stream, bricks, 0, spare,
                     o->distance));
    RN_TRY(RN_LAUNCH(rn_distance_kernel, RN_BLOCKS(count), 256, 0, stream, bricks, 1, o->distance,
                     spare));
    return RN_LAUNCH(rn_distance_kernel, RN_BLOCKS(count), 256, 0, stream, bricks, 2, spare,
                     o->distance);
}

// The round over what the cells of a place showed.
static cudaError_t queue_seen(struct rn_device_field *f, const struct rn_device_step *step) {
    const struct rn_cuda_occupancy *o = &f->scene.occupancy;
    size_t cells = (size_t)o->cells, n = cells * cells * cells;
    if (!step->seen_counts)
        return cudaMemsetAsync(f->batch.seen, 0, n * sizeof *f->batch.seen, f->device->stream);
    RN_TRY(RN_LAUNCH(rn_seen_kernel, RN_BLOCKS(n), 256, 0, f->device->stream, *o, f->batch.seen,
                     step->all_looked));
    return rn_queue_occupancy(f);
}

cudaError_t rn_queue_measurement(struct rn_device_field *f, const struct rn_device_step *step) {
    if (f->scene.occupancy.by_sight) return queue_seen(f, step);
    const struct rn_field_config *c = &f->config.field;
    float level = log2f((float)c->base / (float)c->occupancy),
          top = (float)(f->scene.planes.levels - 1);
    uint32_t first = step->measure_drawn ? 0 : step->measure_first;
    struct rn_cuda_measurement m = {step->measure_drawn,         first,
                                    step->measure_stride,        0,
                                    fminf(fmaxf(level, 0), top), step->measure_decay,
                                    (float)f->config.step,       f->config.seed,
                                    0x6f63637570000000u,         f->steps};
    uint32_t listed = f->scene.occupancy.count;
    if (listed <= m.first) return cudaSuccess;
    m.count = m.drawn ? listed : (listed - m.first + m.stride - 1) / m.stride;
    if (m.drawn)
        RN_TRY(RN_LAUNCH(rn_draw_cells_kernel, RN_BLOCKS(listed), 256, 0, f->device->stream,
                         f->scene.occupancy, m));
    struct rn_staging s = rn_staging_for(f->device, f->scene.base.packed_count, 0, 1);
    struct rn_device_field *own = f;
    unsigned blocks;
    RN_TRY(fill(f->device, f->shape->measure[s.all], s.threads, s.bytes, &blocks));
    RN_TRY(RN_LAUNCH(own->shape->measure[s.all], blocks, s.threads, s.bytes, own->device->stream,
                     own->scene, m, s.networks));
    return rn_queue_occupancy(f);
}

static cudaError_t queue_coarse(struct rn_device_field *f) {
    unsigned processors = (unsigned)f->device->processors;
    if (f->scene.planes.levels <= RN_FINE_LEVELS || f->scene.planes.shares) return cudaSuccess;
    if (f->deterministic)
        return RN_LAUNCH(rn_coarse_kernel<true>, 4 * processors, 256, 0, f->device->stream,
                         f->scene, f->optimiser.gradients);
    return RN_LAUNCH(rn_coarse_kernel<false>, 4 * processors, 256, 0, f->device->stream, f->scene,
                     f->optimiser.gradients);
}

// Maps of planes that do not halve evenly; `o`, `status` NULL: of no step.
static cudaError_t queue_maps_uneven(struct rn_device_field *f, const struct rn_cuda_optimiser *o,
                                     const struct rn_cuda_status *status) {
    const struct rn_cuda_planes *p = &f->scene.planes;
    struct rn_cuda_gradients gradients = o ? o->gradients : rn_cuda_gradients{};
    auto kernel = f->deterministic ? rn_maps_uneven_kernel<true> : rn_maps_uneven_kernel<false>;
    for (int map = 0; map < p->levels * p->levels; map++) {
        int lx = map % p->levels, ly = map / p->levels;
        int count = p->planes * (p->base >> lx) * (p->base >> ly) * p->channels / 4;
        if (rn_cuda_map_exists(p->footprint, lx, ly))
            RN_TRY(RN_LAUNCH(kernel, RN_BLOCKS(count), 256, 0, f->device->stream, f->scene,
                             gradients, status, lx, ly));
    }
    return cudaSuccess;
}

static cudaError_t queue_uneven(struct rn_device_field *f) {
    const struct rn_cuda_planes *p = &f->scene.planes;
    int count = p->planes * p->base * p->base * p->channels / 4;
    auto kernel = f->deterministic ? rn_update_uneven_kernel<true> : rn_update_uneven_kernel<false>;
    RN_TRY(RN_LAUNCH(kernel, RN_BLOCKS(count), 256, 0, f->device->stream, f->scene, f->optimiser,
                     f->batch.status));
    return queue_maps_uneven(f, &f->optimiser, f->batch.status);
}

static unsigned update_blocks(const struct rn_cuda_planes *p) {
    return (unsigned)(p->planes * p->update_side * p->update_side);
}
static unsigned update_threads(const struct rn_cuda_planes *p) {
    return (unsigned)(RN_UPDATE * RN_UPDATE * p->channels / 4);
}

static cudaError_t queue_networks(struct rn_device_field *f, const struct rn_cuda_optimiser *o,
                                  struct rn_cuda_status *status) {
    struct rn_cuda_optimiser optimiser = *o;
    for (int head = 0; head < 2; head++) {
        const struct rn_cuda_network *n = head ? &f->scene.head : &f->scene.base;
        RN_TRY(RN_LAUNCH(rn_update_network_kernel, RN_BLOCKS(rn_cuda_gradient_count(n)), 256, 0,
                         f->device->stream, f->scene, optimiser, status, head != 0));
    }
    return cudaSuccess;
}

// The maps of planes whose parameters are others.
static cudaError_t queue_maps(struct rn_device_field *f) {
    if (f->scene.planes.shares) return queue_maps_uneven(f, NULL, NULL);
    RN_TRY(RN_LAUNCH(rn_build_kernel, update_blocks(&f->scene.planes),
                     update_threads(&f->scene.planes), 0, f->device->stream, f->scene));
    return queue_coarse(f);
}

cudaError_t rn_queue_refresh(struct rn_device_field *f) {
    struct rn_cuda_optimiser none = {};
    RN_TRY(queue_maps(f));
    return queue_networks(f, &none, NULL);
}

cudaError_t rn_queue_smoothing(struct rn_device_field *f, float share) {
    const struct rn_cuda_planes *p = &f->scene.planes;
    size_t side = (size_t)p->base, quads = (size_t)p->channels / 4;
    size_t threads = (size_t)p->planes * side * ((side + 1) / 2) * quads;
    for (int odd = 0; odd < 2; odd++)
        RN_TRY(RN_LAUNCH(rn_smooth_kernel, RN_BLOCKS(threads), 256, 0, f->device->stream, f->scene,
                         share, odd));
    int voxels = voxel_count(f);
    for (int odd = 0; odd < 2 && voxels > 0; odd++) // they have six neighbours, not four
        RN_TRY(RN_LAUNCH(rn_smooth_voxels_kernel, RN_BLOCKS(voxels), 256, 0, f->device->stream,
                         (float4 *)f->scene.voxels.first, f->scene.voxels.side, share * (4.0f / 6),
                         odd));
    return queue_maps(f);
}

// One of a kernel's forms for the loss of distortion.
#define RN_DISTORTING(KERNEL)                                                                      \
    (f->config.distortion_loss <= 0   ? KERNEL<RN_DISTORTS_NOT>                                    \
     : f->world == RN_WORLD_UNBOUNDED ? KERNEL<RN_DISTORTS_PLACES>                                 \
                                      : KERNEL<RN_DISTORTS_ALONG>)
// For a world, the voxels not regarded.
#define RN_IN_WORLD(KERNEL)                                                                        \
    (f->world == RN_WORLD_UNBOUNDED ? KERNEL<RN_WORLD_UNBOUNDED>                                   \
     : f->world == RN_WORLD_FORWARD ? KERNEL<RN_WORLD_FORWARD>                                     \
                                    : KERNEL<RN_WORLD_BALL>)

// Colour and loss of rays that are shaded as a whole, and the gradients of their samples.
static cudaError_t queue_shading(struct rn_device_field *f) {
    struct rn_staging s =
        rn_staging_for(f->device, f->scene.head.packed_count, f->scene.head.packed_count, 1);
    unsigned shade, back;
    RN_TRY(fill(f->device, f->shape->shade_train[s.all], s.threads, s.bytes, &shade));
    RN_TRY(RN_LAUNCH(f->shape->shade_train[s.all], shade, s.threads, s.bytes, f->device->stream,
                     f->scene, f->batch, f->march, s.networks));
    RN_TRY(mark(f, "shade rays"));
    auto sums_backward = RN_DISTORTING(rn_sums_backward_kernel);
    RN_TRY(fill(f->device, sums_backward, 256, 0, &back));
    RN_TRY(RN_LAUNCH(sums_backward, back, 256, 0, f->device->stream, f->batch, f->march));
    return mark(f, "sums backward");
}

// Loss of rays that are composited, and the gradients of their samples.
static cudaError_t queue_loss(struct rn_device_field *f) {
    unsigned blocks;
    auto loss = RN_DISTORTING(rn_loss_kernel);
    RN_TRY(fill(f->device, loss, 256, 0, &blocks));
    RN_TRY(RN_LAUNCH(loss, blocks, 256, 0, f->device->stream, f->batch, f->march));
    return mark(f, "loss");
}

// Forward, loss, and the list of samples that are backpropagated.
static cudaError_t queue_forward(struct rn_device_field *f) {
    const struct rn_cuda_scene *s = &f->scene;
    cudaStream_t stream = f->device->stream;
    struct rn_staging staging =
        rn_staging_for(f->device, s->base.packed_count, s->head.packed_count, 1);
    unsigned blocks;
    RN_TRY(
        fill(f->device, f->shape->train[staging.all], RN_FORWARD_THREADS, staging.bytes, &blocks));
    RN_TRY(RN_LAUNCH(RN_IN_WORLD(rn_rays_kernel), RN_BLOCKS(f->batch.ray_capacity), 256, 0, stream,
                     f->source, f->scene, f->batch));
    RN_TRY(mark(f, "rays"));
    RN_TRY(RN_LAUNCH(f->shape->train[staging.all], blocks, RN_FORWARD_THREADS, staging.bytes,
                     stream, f->scene, f->batch, f->march, staging.networks));
    RN_TRY(mark(f, "forward"));
    RN_TRY(s->per_ray ? queue_shading(f) : queue_loss(f));
    RN_TRY(RN_LAUNCH(rn_order_kernel, 1, RN_ORDER_THREADS, 0, stream, f->batch));
    if (f->batch.block_error)
        RN_TRY(RN_LAUNCH(rn_errors_kernel, RN_BLOCKS(f->batch.ray_capacity), 256, 0, stream,
                         f->batch));
    RN_TRY(RN_LAUNCH(rn_place_kernel, RN_BLOCKS(f->batch.tile_capacity * RN_TILE), 256, 0, stream,
                     f->batch));
    return mark(f, "order");
}

// `on_chip`: parts of the last layer that lie in `sums` already.
static cudaError_t queue_gradient(struct rn_device_field *f, const struct rn_cuda_network *n,
                                  int on_chip, float4 *sums) {
    struct rn_cuda_network network = *n;
    bool of_rays = f->scene.per_ray && n == &f->scene.head;
    size_t bytes = RN_GRADIENT_STAGES * rn_cuda_gradient_stage(n) * sizeof(uint4);
    unsigned blocks;
    RN_TRY(fill(f->device, rn_gradient_kernel, 256, bytes, &blocks));
    struct rn_cuda_chunks chunks = rn_cuda_chunks_of(n, (int)blocks, on_chip);
    RN_TRY(RN_LAUNCH(rn_gradient_kernel, (unsigned)chunks.first[n->hidden + (on_chip == 0)], 256,
                     bytes, f->device->stream, network, chunks, f->batch.status, f->batch.scratch,
                     f->batch.tile_capacity, of_rays, sums));
    return RN_LAUNCH(rn_reduce_kernel, RN_BLOCKS(rn_cuda_gradient_count(n)), 256, 0,
                     f->device->stream, network, chunks, (float *)sums, f->batch.status);
}

// Which of a backward's kernels goes with that.
static int form_of(const struct rn_staging *s) {
    return s->all ? s->tiles : 0;
}

// Gradients of the colour network's weights, and before where samples are shaded, of its inputs.
static cudaError_t queue_head_backward(struct rn_device_field *f) {
    const struct rn_cuda_scene *s = &f->scene;
    struct rn_staging head =
        rn_staging_for(f->device, s->head.packed_count, s->head.packed_count, f->two_tiles ? 2 : 1);
    if (!s->per_ray) {
        auto head_backward = f->shape->head_backward[form_of(&head)];
        unsigned blocks;
        RN_TRY(fill(f->device, head_backward, head.threads, head.bytes, &blocks));
        RN_TRY(RN_LAUNCH(head_backward, blocks, head.threads, head.bytes, f->device->stream,
                         f->scene, f->batch, head.networks));
        RN_TRY(mark(f, "head backward"));
    }
    if (!s->per_ray || s->view_dependence) // else it takes no part
        RN_TRY(queue_gradient(f, &s->head, 0, f->optimiser.head_sums));
    return mark(f, "head gradient");
}

// With the last layer's gradient summed on the chip where that is asked for and there is room in
// shared memory, a warp a tile then; *ret_on_chip is how many blocks did.
static cudaError_t queue_base_backward(struct rn_device_field *f, int *ret_on_chip) {
    const struct rn_cuda_network *n = &f->scene.base;
    struct rn_staging one = rn_staging_for(f->device, n->packed_count, n->packed_count, 1);
    size_t all = one.bytes + rn_cuda_on_chip_fragments(n, one.threads) * sizeof(uint4);
    bool on_chip = f->last_on_chip && one.all && all <= f->device->shared_bytes;
    int tiles = f->two_tiles && !on_chip ? 2 : 1;
    struct rn_staging base = rn_staging_for(f->device, n->packed_count, n->packed_count, tiles);
    size_t bytes = on_chip ? all : base.bytes;
    auto base_backward = on_chip ? f->shape->base_on_chip : f->shape->base_backward[form_of(&base)];
    unsigned blocks;
    RN_TRY(fill(f->device, base_backward, base.threads, bytes, &blocks));
    if (on_chip && blocks > RN_CHUNKS) blocks = RN_CHUNKS;
    *ret_on_chip = on_chip ? (int)blocks : 0;
    RN_TRY(RN_LAUNCH(base_backward, blocks, base.threads, bytes, f->device->stream, f->scene,
                     f->batch, base.networks, f->optimiser.base_sums));
    return mark(f, "base backward");
}

static cudaError_t queue_backward(struct rn_device_field *f) {
    int on_chip;
    RN_TRY(queue_head_backward(f));
    RN_TRY(queue_base_backward(f, &on_chip));
    RN_TRY(queue_gradient(f, &f->scene.base, on_chip, f->optimiser.base_sums));
    return mark(f, "base gradient");
}

template <bool FIXED, int WORLD> static cudaError_t queue_scatter(struct rn_device_field *f) {
    float step = f->march.step;
    unsigned blocks = 64 * (unsigned)f->device->processors; // more than fit: rays differ in length
    int queries = (int)f->batch.tile_capacity * RN_TILE * f->scene.planes.planes;
    RN_TRY(RN_LAUNCH(rn_queries_kernel<WORLD>, RN_BLOCKS(queries), 256, 0, f->device->stream,
                     f->scene, f->batch, step));
    RN_TRY(RN_LAUNCH(rn_scatter_kernel<FIXED>, blocks, 128, 0, f->device->stream, f->scene,
                     f->batch, f->optimiser.gradients));
    if (f->scene.voxels.side == 0) return cudaSuccess;
    return RN_LAUNCH((rn_scatter_voxels_kernel<FIXED, WORLD>), blocks, 128, 0, f->device->stream,
                     f->scene, f->batch, f->optimiser.gradients, step);
}

template <bool FIXED> static cudaError_t queue_voxels(struct rn_device_field *f) {
    int count = voxel_count(f);
    size_t first = rn_grid_numbers(&f->config.field) * (size_t)f->scene.planes.planes;
    if (count == 0) return cudaSuccess;
    return RN_LAUNCH(rn_update_voxels_kernel<FIXED>, RN_BLOCKS(count), 256, 0, f->device->stream,
                     f->scene, f->optimiser, f->batch.status, first, count);
}

template <bool FIXED> static cudaError_t queue_planes(struct rn_device_field *f) {
    cudaStream_t stream = f->device->stream;
    RN_TRY((f->world == RN_WORLD_UNBOUNDED ? queue_scatter<FIXED, RN_WORLD_UNBOUNDED>
            : f->world == RN_WORLD_FORWARD ? queue_scatter<FIXED, RN_WORLD_FORWARD>
                                           : queue_scatter<FIXED, RN_WORLD_BALL>)(f));
    RN_TRY(mark(f, "scatter"));
    RN_TRY(queue_voxels<FIXED>(f));
    if (f->scene.planes.shares) return queue_uneven(f);
    return RN_LAUNCH(rn_update_planes_kernel<FIXED>, update_blocks(&f->scene.planes),
                     update_threads(&f->scene.planes), 0, stream, f->scene, f->optimiser,
                     f->batch.status);
}

cudaError_t rn_queue_step(struct rn_device_field *f) {
    RN_TRY(queue_forward(f));
    RN_TRY(queue_backward(f));
    RN_TRY(f->deterministic ? queue_planes<true>(f) : queue_planes<false>(f));
    RN_TRY(queue_coarse(f));
    RN_TRY(mark(f, "update planes"));
    RN_TRY(queue_networks(f, &f->optimiser, f->batch.status));
    RN_TRY(mark(f, "update networks"));
    RN_TRY(RN_LAUNCH(rn_finish_kernel, 1, 32, 0, f->device->stream, f->batch.status));
    return mark(f, "finish");
}

cudaError_t rn_queue_view(struct rn_device_field *f, const struct rn_cuda_view *view,
                          const struct rn_cuda_march *march, void *to) {
    const struct rn_cuda_scene *s = &f->scene;
    cudaStream_t stream = f->device->stream;
    struct rn_cuda_view v = *view;
    struct rn_cuda_march m = *march;
    struct rn_staging both =
        rn_staging_for(f->device, s->base.packed_count, s->head.packed_count, 1);
    struct rn_staging head = rn_staging_for(f->device, s->head.packed_count, 0, 1);
    unsigned blocks;
    RN_TRY(fill(f->device, f->shape->render[both.all], RN_FORWARD_THREADS, both.bytes, &blocks));
    RN_TRY(cudaMemsetAsync(f->view.status->queued, 0, sizeof f->view.status->queued, stream));
    RN_TRY(RN_LAUNCH(RN_IN_WORLD(rn_view_kernel), RN_BLOCKS(v.count), 256, 0, stream, v, f->seen,
                     f->view, m));
    RN_TRY(RN_LAUNCH(f->shape->render[both.all], blocks, RN_FORWARD_THREADS, both.bytes, stream,
                     f->seen, f->view, m, both.networks));
    if (s->per_ray && s->view_dependence) {
        RN_TRY(
            fill(f->device, f->shape->shade_render[head.all], head.threads, head.bytes, &blocks));
        RN_TRY(RN_LAUNCH(f->shape->shade_render[head.all], blocks, head.threads, head.bytes, stream,
                         f->scene, f->view, m, head.networks));
    }
    return RN_LAUNCH(rn_develop_kernel, RN_BLOCKS(v.count / (v.cones * v.cones)), 256, 0, stream, v,
                     m, f->view.pixels, to);
}
