// The backend's table: devices, fields, training, rendering (backend.h says what each promises).
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/cuda/field.cuh"

// ---- shapes ---------------------------------------------------------------------------------

#define RN_BOTH(KERNEL, ...)                                                                       \
    { KERNEL<__VA_ARGS__, false>, KERNEL<__VA_ARGS__, true> }
#define RN_IN(KERNEL, WORLD, ...)                                                                  \
    { KERNEL<__VA_ARGS__, false, WORLD>, KERNEL<__VA_ARGS__, true, WORLD> }
#define RN_SHAPE(KT, WT, WORLD, ...)                                                               \
    {                                                                                              \
        WORLD, KT, WT, RN_IN(rn_forward_kernel, WORLD, KT, WT, true),                              \
            RN_IN(rn_forward_kernel, WORLD, KT, WT, false), RN_BOTH(rn_shade_kernel, WT, true),    \
            RN_BOTH(rn_shade_kernel, WT, false),                                                   \
            {rn_head_backward_kernel<WT, false, 1>, rn_head_backward_kernel<WT, true, 1>,          \
             rn_head_backward_kernel<WT, true, 2>},                                                \
            {rn_base_backward_kernel<KT, WT, false, false, 1>,                                     \
             rn_base_backward_kernel<KT, WT, true, false, 1>,                                      \
             rn_base_backward_kernel<KT, WT, true, false, 2>},                                     \
            rn_base_backward_kernel<KT, WT, true, true, 1>, __VA_ARGS__                            \
    }
// A ball's cells are measured, those of a place told by what they showed.
#define RN_BALL(KT, WT, WORLD) RN_SHAPE(KT, WT, WORLD, RN_IN(rn_measure_kernel, WORLD, KT, WT))
#define RN_PLACE(KT, WT, WORLD) RN_SHAPE(KT, WT, WORLD, {})

// From small to large; a field takes the first that holds it, padded with zeros.
static const struct rn_kernel_shape shapes[] = {
    RN_BALL(4, 2, RN_WORLD_BALL),        RN_BALL(10, 2, RN_WORLD_BALL),
    RN_BALL(4, 4, RN_WORLD_BALL),        RN_BALL(4, 8, RN_WORLD_BALL),
    RN_BALL(10, 8, RN_WORLD_BALL),       RN_BALL(4, 4, RN_WORLD_VOXELS),
    RN_BALL(10, 8, RN_WORLD_VOXELS),     RN_PLACE(4, 4, RN_WORLD_UNBOUNDED),
    RN_PLACE(10, 8, RN_WORLD_UNBOUNDED), RN_PLACE(4, 4, RN_WORLD_FORWARD),
    RN_PLACE(10, 8, RN_WORLD_FORWARD)};

static const struct rn_kernel_shape *find_shape(enum rn_world world,
                                                const struct rn_field_config *c) {
    int features = rn_feature_count(c);
    for (const struct rn_kernel_shape &s : shapes)
        if (s.world == world && features <= 16 * s.inputs16 && c->width <= 16 * s.width16)
            return &s;
    return NULL;
}

static enum rn_world world_of(const struct rn_device_scene *s) {
    if (s->disparity.on) return RN_WORLD_FORWARD;
    if (s->config.field.space == RN_SPACE_UNBOUNDED) return RN_WORLD_UNBOUNDED;
    return s->config.field.voxels ? RN_WORLD_VOXELS : RN_WORLD_BALL;
}

// ---- devices --------------------------------------------------------------------------------

static void device_close(struct rn_backend_device **device) {
    if (!*device) return;
    for (int i = 0; i < 2; i++) {
        if ((*device)->rendered[i]) (void)cudaEventDestroy((*device)->rendered[i]);
        if ((*device)->arrived[i]) (void)cudaEventDestroy((*device)->arrived[i]);
        (void)cudaFreeHost((*device)->staged[i]);
        (void)cudaFreeHost((*device)->places[i]);
    }
    if ((*device)->copies) (void)cudaStreamDestroy((*device)->copies);
    if ((*device)->stream) (void)cudaStreamDestroy((*device)->stream);
    free(*device);
    *device = NULL;
}

static enum rn_status device_open(int ordinal, struct rn_backend_device **ret_device,
                                  struct rn_device_about *ret_about, struct rn_error *err) {
    int count = 0;
    cudaDeviceProp p;
    cudaError_t outcome = cudaGetDeviceCount(&count);
    if (outcome != cudaSuccess || ordinal >= count)
        return rn_error_set(
            err, RN_ERROR_UNSUPPORTED, "device", "there is no cuda:%d (%s); use --device cpu",
            ordinal, outcome == cudaSuccess ? "too few devices" : cudaGetErrorString(outcome));
    enum rn_status status = rn_cuda_check(cudaSetDevice(ordinal), "choosing the device", err);
    if (status == RN_OK)
        status = rn_cuda_check(cudaGetDeviceProperties(&p, ordinal), "asking the device", err);
    if (status != RN_OK) return status;
    if (p.major < 8)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "device",
                            "%s has compute capability %d.%d; 8.0 is needed", p.name, p.major,
                            p.minor);
    struct rn_backend_device *d = (struct rn_backend_device *)calloc(1, sizeof *d);
    if (!d) return rn_error_set(err, RN_ERROR_NO_MEMORY, "device", "out of memory");
    d->ordinal = ordinal;
    d->processors = p.multiProcessorCount;
    d->shared_bytes = p.sharedMemPerBlockOptin;
    cudaError_t e = cudaStreamCreateWithFlags(&d->stream, cudaStreamNonBlocking);
    if (!e) e = cudaStreamCreateWithFlags(&d->copies, cudaStreamNonBlocking);
    if (e) {
        device_close(&d);
        return rn_cuda_check(e, "making a stream", err);
    }
    memset(ret_about, 0, sizeof *ret_about);
    snprintf(ret_about->name, sizeof ret_about->name, "%.100s", p.name);
    snprintf(ret_about->kernels, sizeof ret_about->kernels, "sm_%d%d", p.major, p.minor);
    ret_about->memory_bytes = p.totalGlobalMem;
    *ret_device = d;
    return RN_OK;
}

static size_t used_bytes(const struct rn_backend_device *device) {
    return device->used_bytes;
}

static size_t free_bytes(const struct rn_backend_device *) {
    size_t free, total;
    return cudaMemGetInfo(&free, &total) == cudaSuccess ? free : 0;
}

// ---- memory ---------------------------------------------------------------------------------

static enum rn_status take(struct rn_backend_device *d, size_t bytes, void **ret,
                           struct rn_error *err) {
    cudaError_t outcome = cudaMalloc(ret, bytes);
    if (outcome == cudaErrorMemoryAllocation) {
        (void)cudaGetLastError(); // this error is over once it has been read
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "device",
                            "%zu MiB are needed and the device does not have them: other programs "
                            "use its memory; end them, or use a smaller base or --device cpu",
                            (bytes >> 20) + 1);
    }
    if (outcome == cudaSuccess) d->used_bytes += bytes;
    return rn_cuda_check(outcome, "taking device memory", err);
}

static void give_back(struct rn_backend_device *d, void **memory, size_t bytes) {
    if (!*memory) return;
    (void)cudaFree(*memory);
    d->used_bytes -= bytes;
    *memory = NULL;
}

static cudaError_t copy_in(const struct rn_backend_device *d, void *to, const void *from,
                           size_t bytes) {
    return cudaMemcpyAsync(to, from, bytes, cudaMemcpyHostToDevice, d->stream);
}
static cudaError_t copy_out(const struct rn_backend_device *d, void *to, const void *from,
                            size_t bytes) {
    return to ? cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToHost, d->stream) : cudaSuccess;
}

// ---- fields ---------------------------------------------------------------------------------

static enum rn_status check_config(const struct rn_device_scene *s, struct rn_error *err) {
    const struct rn_field_config *c = &s->config.field;
    if (!find_shape(world_of(s), c))
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "width",
                            "the CUDA kernels hold up to 160 features (planes x channels, voxels "
                            "4) and widths up to 128; use --device cpu or a smaller field");
    if (s->levels > 1 && c->base >> (s->levels - 1) == 0)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "levels",
                            "the CUDA kernels hold maps of one texel at least: %d levels need a "
                            "base of %d; use --device cpu or fewer levels",
                            s->levels, 1 << (s->levels - 1));
    return RN_OK;
}

static void describe_scene(struct rn_device_field *f, const struct rn_device_scene *s) {
    const struct rn_field_config *c = &s->config.field;
    f->config = s->config;
    memcpy(f->cut.centre, s->centre, sizeof f->cut.centre);
    f->cut.radius = s->radius;
    f->cut.cone_step = s->config.cone_step;
    f->cut.disparity = s->disparity;
    f->world = world_of(s);
    f->shape = find_shape(f->world, c);
    f->parameter_count = s->parameter_count;
    f->solid = s->solid;
    rn_cuda_planes_init(&f->scene.planes, c, &s->solid, s->levels);
    rn_cuda_network_init(&f->scene.base, &s->base_shape, f->shape->inputs16, f->shape->width16);
    rn_cuda_network_init(&f->scene.head, &s->head_shape, 2, f->shape->width16);
    f->scene.plane_count = s->parameter_count - s->base_shape.count - s->head_shape.count;
    f->scene.voxels.side = c->voxels ? rn_voxel_side(c) : 0;
    f->scene.occupancy.by_sight = f->world == RN_WORLD_UNBOUNDED || s->disparity.on;
    f->scene.occupancy.forward = s->disparity.on;
    f->scene.per_ray = c->shading == RN_SHADING_RAY;
    f->scene.view_dependence = c->view_dependence;
    f->scene.occupancy.cells = c->occupancy;
    f->scene.occupancy.limit =
        s->config.occupancy_limit > 0 ? s->config.occupancy_limit : RN_OCCUPANCY_LIMIT;
    for (int i = 0; i < RN_DEVICE_FINER; i++)
        f->finer[i].cells = s->finer[i] ? s->finer[i]->cells : 0;
}

// Tiles for a quarter more samples than aimed at, and for a part-filled one a ray; no fewer than
// tiles of rays, which take the same scratch.
static void choose_capacities(struct rn_device_field *f) {
    int target = f->config.target_samples, rays = 4 * target;
    f->batch.ray_capacity = rays < RN_DEVICE_MAX_RAYS ? rays : RN_DEVICE_MAX_RAYS;
    uint32_t of_rays = f->scene.per_ray ? rn_cuda_tiles((uint32_t)f->batch.ray_capacity) : 0;
    uint32_t tiles = (uint32_t)(target / RN_TILE + target / RN_TILE / 4 + 4096);
    f->batch.tile_capacity = tiles > of_rays ? tiles : of_rays;
}

// Bytes of a field whose planes have `base` texels a side, with its training where there are
// pixels.
static size_t bytes_at(const struct rn_device_field *f, const struct rn_device_pixels *pixels,
                       int base) {
    struct rn_device_field other = *f;
    struct rn_field_config *c = &other.config.field;
    struct rn_arena arena = {NULL, 0};
    int levels = f->scene.planes.levels, side = c->base;
    size_t texels = (size_t)base * (size_t)base - (size_t)c->base * (size_t)c->base;
    for (; side < base && levels > 1 && levels < c->levels; side *= 2)
        levels++; // finer texels, higher levels
    while (levels > 1 && base >> (levels - 1) == 0)
        levels--;
    other.parameter_count += (size_t)rn_grid_count(c) * (size_t)c->channels * texels;
    c->base = base;
    other.scene.voxels.side = c->voxels ? rn_voxel_side(c) : 0;
    rn_cuda_planes_init(&other.scene.planes, c, &f->solid, levels);
    rn_field_lay_out(&other, &arena);
    if (pixels) rn_train_lay_out(&other, pixels, &arena);
    return arena.used;
}

static enum rn_status needs(const struct rn_device_scene *scene,
                            const struct rn_device_pixels *pixels,
                            const struct rn_device_training *training, size_t budget_bytes,
                            size_t *ret_bytes, struct rn_error *err) {
    int base = scene->config.field.base, most = base;
    char remedy[64] = "not even the smallest base";
    enum rn_status status = check_config(scene, err);
    if (status != RN_OK) return status;
    struct rn_device_field f = {};
    describe_scene(&f, scene);
    if (pixels) {
        f.deterministic = training->deterministic;
        choose_capacities(&f);
        if (scene->config.grow_to > base) most = scene->config.grow_to;
    }
    size_t need = bytes_at(&f, pixels, most);
    if (need <= budget_bytes) {
        *ret_bytes = need;
        return RN_OK;
    }
    for (int smaller = most / 2; smaller >= RN_UPDATE; smaller /= 2)
        if (bytes_at(&f, pixels, smaller) <= budget_bytes) {
            snprintf(remedy, sizeof remedy, "a base of %d texels", smaller);
            break;
        }
    return rn_error_set(err, RN_ERROR_LIMIT, "base",
                        "%s planes of %d texels a side needs %zu MiB of the device's memory, of "
                        "which %zu MiB may be used: %s would fit",
                        pixels ? "training" : "a field with", most, (need >> 20) + 1,
                        budget_bytes >> 20, remedy);
}

// Bits that the host made; `ret_box` is read until the stream has come so far.
static cudaError_t upload_bits(const struct rn_backend_device *d, const struct rn_cuda_occupancy *o,
                               const struct rn_occupancy_bits *bits, int ret_box[6]) {
    size_t bricks = rn_cuda_bricks(o->cells);
    for (int i = 0; i < 3; i++) { // in cells; none: beyond the last
        ret_box[i] = (int)lroundf((bits->low[i] + 1) * 0.5f * (float)o->cells);
        ret_box[3 + i] = (int)lroundf((bits->high[i] + 1) * 0.5f * (float)o->cells) - 1;
    }
    cudaError_t e = copy_in(d, o->words, bits->words, bricks * 16 * sizeof *bits->words);
    if (!e) e = copy_in(d, o->distance, bits->distance, bricks);
    return e ? e : copy_in(d, o->box, ret_box, 6 * sizeof *ret_box);
}

// Uploads, and builds what the kernels read. The lists are the host's only until it returns.
static enum rn_status upload(struct rn_device_field *f, const struct rn_device_scene *s,
                             struct rn_error *err) {
    struct rn_backend_device *d = f->device;
    struct rn_cuda_occupancy *o = &f->scene.occupancy;
    size_t cells = (size_t)o->cells, n = cells * cells * cells;
    size_t fragments = f->scene.base.packed_count + f->scene.head.packed_count;
    uint32_t *list = (uint32_t *)malloc(n * sizeof *list);
    if (!list) return rn_error_set(err, RN_ERROR_NO_MEMORY, "cuda", "out of memory");
    o->count = 0;
    for (size_t i = 0; i < n; i++)
        if (s->hull[i]) list[o->count++] = (uint32_t)i;
    cudaError_t e = copy_in(d, f->scene.parameters, s->parameters, f->parameter_count * 4);
    if (!e) e = copy_in(d, o->values, s->occupancy, n * 4);
    if (!e) e = copy_in(d, o->hull, s->hull, n);
    if (!e) e = copy_in(d, o->list, list, o->count * sizeof *list);
    struct rn_cuda_planes *p = &f->scene.planes;
    size_t taps = p->shares ? (size_t)p->levels * (size_t)p->base : 0;
    struct rn_cuda_share *shares = (struct rn_cuda_share *)malloc((taps + 1) * sizeof *shares);
    if (!shares) e = cudaErrorMemoryAllocation;
    if (shares && taps) rn_cuda_shares_init(p->base, p->levels, shares);
    if (!e && taps) e = copy_in(d, (void *)p->shares, shares, taps * sizeof *shares);
    if (!e) e = cudaMemsetAsync(f->scene.forward, 0, fragments * sizeof(uint4), d->stream);
    if (!e) e = cudaMemsetAsync(f->scene.backward, 0, fragments * sizeof(uint4), d->stream);
    if (!e) e = rn_queue_refresh(f);
    if (!e) e = rn_queue_occupancy(f);
    int box[RN_DEVICE_FINER][6];
    for (int i = 0; i < RN_DEVICE_FINER && !e; i++)
        if (s->finer[i]) e = upload_bits(d, &f->finer[i], s->finer[i], box[i]);
    cudaError_t waited = cudaStreamSynchronize(d->stream);
    free(list);
    free(shares);
    return rn_cuda_check(e ? e : waited, "loading a field", err);
}

static void field_destroy(struct rn_device_field **field) {
    struct rn_device_field *f = *field;
    if (!f) return;
    if (f->graph) (void)cudaGraphExecDestroy(f->graph);
    give_back(f->device, &f->train_memory, f->train_bytes);
    give_back(f->device, &f->memory, f->memory_bytes);
    free(f);
    *field = NULL;
}

static enum rn_status field_create(struct rn_backend_device *device,
                                   const struct rn_device_scene *scene,
                                   struct rn_device_field **ret_field, struct rn_error *err) {
    enum rn_status status = check_config(scene, err);
    if (status != RN_OK) return status;
    struct rn_device_field *f = (struct rn_device_field *)calloc(1, sizeof *f);
    if (!f) return rn_error_set(err, RN_ERROR_NO_MEMORY, "cuda", "out of memory");
    struct rn_arena arena = {NULL, 0};
    f->device = device;
    describe_scene(f, scene);
    rn_field_lay_out(f, &arena);
    status = take(device, arena.used, &f->memory, err);
    if (status == RN_OK) {
        f->memory_bytes = arena.used;
        arena = rn_arena{(char *)f->memory, 0};
        rn_field_lay_out(f, &arena);
        status = upload(f, scene, err);
    }
    if (status != RN_OK)
        field_destroy(&f);
    else
        *ret_field = f;
    return status;
}

// ---- training -------------------------------------------------------------------------------

// As many rays as fit even if every sample of each is seen.
static int first_rays(const struct rn_device_field *f, int asked) {
    double longest = f->world == RN_WORLD_FORWARD ? 3.5 : 2.8; // a cube's diagonal; a ball's chord
    int tiles = (int)(longest / f->source.cut.step) / RN_TILE + 2;
    int most = (int)(f->batch.tile_capacity / (uint32_t)tiles);
    return asked < most ? asked : most;
}

static void describe_training(struct rn_device_field *f, const struct rn_device_pixels *pixels,
                              const struct rn_device_training *t) {
    const struct rn_train_config *c = &f->config;
    struct rn_cuda_source *s = &f->source;
    s->pixels = *pixels;
    s->cut = f->cut;
    s->cut.step = t->march_step;
    s->colour = f->march.colour = t->colour;
    s->seed = c->seed;
    s->favour_finest = c->favour_finest;
    s->split = f->march.split = t->split;
    f->batch.pixel_rays = t->split ? RN_PIXEL_RAYS : 1;
    f->batch.seed = c->seed;
    f->batch.roulette = (float)c->roulette;
    f->march.step = (float)t->march_step;
    f->march.stop_depth = (float)-log(c->stop);
    choose_capacities(f);
}

static cudaError_t upload_shares(struct rn_device_field *f, const struct rn_shares *shares) {
    const struct rn_backend_device *d = f->device;
    const struct rn_shares *to = &f->source.pixels.shares;
    size_t blocks = (size_t)f->source.pixels.live_count,
           places = rn_share_place(f->source.pixels.scale_count, blocks) + 1;
    cudaError_t e = copy_in(d, (void *)to->share, shares->share, blocks * sizeof *shares->share);
    if (!e) e = copy_in(d, (void *)to->sum, shares->sum, places * sizeof *shares->sum);
    return e ? e : copy_in(d, (void *)to->guide, shares->guide, places * sizeof *shares->guide);
}

static cudaError_t upload_training(struct rn_device_field *f, const struct rn_device_pixels *p,
                                   const struct rn_device_training *t) {
    struct rn_backend_device *d = f->device;
    struct rn_cuda_status status = {};
    status.ray_count = t->step == 0 ? first_rays(f, t->next_rays) : t->next_rays;
    status.ray_count -= status.ray_count % f->batch.pixel_rays;
    if (status.ray_count == 0) status.ray_count = f->batch.pixel_rays;
    status.target_samples = f->config.target_samples;
    status.steps = (uint64_t)t->step;
    status.updates = (uint64_t)t->updates;
    status.gradient_scale = t->gradient_scale > 0 ? t->gradient_scale : RN_SCALE_FIRST;
    status.good_steps = t->good_steps;
    status.gradient_size = t->gradient_size;
    status.rays = t->rays;
    cudaError_t e = cudaMemsetAsync(f->train_memory, 0, f->train_bytes, d->stream);
    if (!e) e = copy_in(d, f->batch.status, &status, sizeof status);
    if (!e)
        e = copy_in(d, (void *)f->source.pixels.frames, p->frames,
                    (size_t)p->frame_count * sizeof *p->frames);
    if (!e) e = copy_in(d, (void *)f->source.pixels.rgba, p->rgba, 4 * p->pixel_count);
    if (!e && p->used)
        e = copy_in(d, (void *)f->source.pixels.used, p->used,
                    rn_device_used_words(p->pixel_count) * sizeof *p->used);
    if (!e) e = copy_in(d, (void *)f->source.pixels.live, p->live, p->live_count * sizeof *p->live);
    if (!e && p->shares.share) e = upload_shares(f, &p->shares);
    if (!e && p->shares.share)
        e = copy_in(d, f->batch.block_error, p->block_error,
                    (size_t)p->live_count * sizeof *p->block_error);
    if (!e && t->m) e = copy_in(d, f->optimiser.m, t->m, f->parameter_count * 4);
    if (!e && t->v) e = copy_in(d, f->optimiser.v, t->v, f->parameter_count * 4);
    size_t cells = (size_t)f->scene.occupancy.cells;
    if (!e && t->seen && f->batch.seen)
        e = copy_in(d, f->batch.seen, t->seen, cells * cells * cells * sizeof *t->seen);
    cudaError_t waited = cudaStreamSynchronize(d->stream);
    return e ? e : waited;
}

static cudaError_t capture_step(struct rn_device_field *f) {
    cudaGraph_t graph;
    cudaError_t e = cudaStreamBeginCapture(f->device->stream, cudaStreamCaptureModeRelaxed);
    if (e) return e;
    cudaError_t queued = rn_queue_step(f);
    e = cudaStreamEndCapture(f->device->stream, &graph);
    if (queued || e) return queued ? queued : e;
    e = cudaGraphInstantiate(&f->graph, graph, 0);
    (void)cudaGraphDestroy(graph);
    return e;
}

static enum rn_status train_begin(struct rn_device_field *f, const struct rn_device_pixels *pixels,
                                  const struct rn_device_training *training, struct rn_error *err) {
    if (f->train_memory)
        return rn_error_set(err, RN_ERROR_CONFLICT, "cuda", "this field is being trained already");
    struct rn_arena arena = {NULL, 0};
    f->deterministic = training->deterministic;
    f->last_on_chip = training->last_on_chip;
    f->two_tiles = training->two_tiles;
    describe_training(f, pixels, training);
    rn_train_lay_out(f, pixels, &arena);
    enum rn_status status = take(f->device, arena.used, &f->train_memory, err);
    if (status != RN_OK) return status;
    f->train_bytes = arena.used;
    arena = rn_arena{(char *)f->train_memory, 0};
    rn_train_lay_out(f, pixels, &arena);
    f->steps = (uint64_t)training->step;
    cudaError_t e = upload_training(f, pixels, training);
    if (!e) e = capture_step(f);
    return rn_cuda_check(e, "preparing to train", err);
}

// What comes before the kernels of a step.
static cudaError_t prepare_step(struct rn_device_field *f, const struct rn_device_step *step) {
    const struct rn_train_config *c = &f->config;
    struct rn_cuda_rates rates = {step->network_rate,
                                  step->plane_rate,
                                  (float)c->weight_decay,
                                  c->sparse ? 0 : (float)c->weight_decay,
                                  (float)c->adam_eps,
                                  c->beta2,
                                  c->sparse && !f->scene.planes.shares,
                                  step->distortion};
    cudaError_t e = step->measure ? rn_queue_measurement(f, step) : cudaSuccess;
    if (!e)
        e = RN_LAUNCH(rn_rates_kernel, 1, 32, 0, f->device->stream, rates, f->optimiser.update,
                      f->batch.status);
    f->steps++;
    return e;
}

static enum rn_status train_step(struct rn_device_field *f, const struct rn_device_step *step,
                                 struct rn_error *err) {
    cudaError_t e = prepare_step(f, step);
    if (!e) e = cudaGraphLaunch(f->graph, f->device->stream);
    if (!e && step->smoothing > 0) e = rn_queue_smoothing(f, step->smoothing);
    return rn_cuda_check(e, "a training step", err);
}

static cudaError_t read_timer(const struct rn_timer *t, struct rn_device_stage *ret_stages) {
    cudaError_t e = cudaSuccess;
    for (int i = 0; i < t->count && !e; i++) {
        ret_stages[i].name = t->names[i];
        e = cudaEventElapsedTime(&ret_stages[i].ms, t->events[i], t->events[i + 1]);
    }
    return e;
}

static enum rn_status train_timed(struct rn_device_field *f, const struct rn_device_step *step,
                                  struct rn_device_stage *ret_stages, int *ret_count,
                                  struct rn_error *err) {
    struct rn_timer timer = {};
    cudaError_t e = cudaSuccess, queued = cudaSuccess;
    for (int i = 0; i <= RN_DEVICE_STAGES && !e; i++)
        e = cudaEventCreate(&timer.events[i]);
    if (!e) e = prepare_step(f, step);
    if (!e) e = cudaEventRecord(timer.events[0], f->device->stream);
    f->timer = &timer;
    if (!e) queued = rn_queue_step(f);
    f->timer = NULL;
    if (!e && !queued && step->smoothing > 0) queued = rn_queue_smoothing(f, step->smoothing);
    cudaError_t waited = cudaStreamSynchronize(f->device->stream);
    if (!e) e = queued ? queued : waited;
    if (!e) e = read_timer(&timer, ret_stages);
    for (int i = 0; i <= RN_DEVICE_STAGES; i++)
        if (timer.events[i]) (void)cudaEventDestroy(timer.events[i]);
    *ret_count = timer.count;
    return rn_cuda_check(e, "a timed step", err);
}

static enum rn_status train_finish(struct rn_device_field *f,
                                   struct rn_device_progress *ret_progress, struct rn_error *err) {
    struct rn_cuda_status s;
    cudaError_t e = copy_out(f->device, &s, f->batch.status, sizeof s);
    cudaError_t waited = cudaStreamSynchronize(f->device->stream);
    if (e || waited) return rn_cuda_check(e ? e : waited, "training", err);
    struct rn_device_progress p = {};
    p.steps = (int64_t)s.steps;
    p.updates = (int64_t)s.updates;
    p.steps_rejected = s.steps_rejected;
    p.nonfinite_rays = s.nonfinite_rays;
    p.nonfinite_numbers = s.nonfinite_numbers;
    p.samples = s.samples;
    p.samples_returned = s.samples_returned;
    p.rays = s.rays;
    memcpy(p.level_samples, s.level_samples, sizeof p.level_samples);
    p.loss = s.weight > 0 ? s.loss / s.weight : 0;
    p.next_rays = s.next_rays;
    p.rejected_in_a_row = s.rejected_in_a_row;
    p.gradient_scale = s.gradient_scale;
    p.good_steps = s.good_steps;
    p.gradient_size = s.gradient_size;
    *ret_progress = p;
    return RN_OK;
}

static enum rn_status train_share(struct rn_device_field *f, const struct rn_shares *shares,
                                  struct rn_error *err) {
    cudaError_t e = upload_shares(f, shares);
    cudaError_t waited = cudaStreamSynchronize(f->device->stream);
    return rn_cuda_check(e ? e : waited, "sharing rays out", err);
}

static enum rn_status download(struct rn_device_field *f, const struct rn_device_numbers *to,
                               struct rn_error *err) {
    struct rn_backend_device *d = f->device;
    size_t cells = (size_t)f->scene.occupancy.cells, bytes = f->parameter_count * sizeof(float);
    if ((to->m || to->v || to->seen || to->block_error) && !f->train_memory)
        return rn_error_set(err, RN_ERROR_CONFLICT, "cuda", "this field is not being trained");
    cudaError_t e = copy_out(d, to->parameters, f->scene.parameters, bytes);
    if (!e) e = copy_out(d, to->m, f->optimiser.m, bytes);
    if (!e) e = copy_out(d, to->v, f->optimiser.v, bytes);
    if (!e) e = copy_out(d, to->occupancy, f->scene.occupancy.values, cells * cells * cells * 4);
    if (!e && f->batch.seen)
        e = copy_out(d, to->seen, f->batch.seen, cells * cells * cells * sizeof *to->seen);
    if (!e && f->batch.block_error)
        e = copy_out(d, to->block_error, f->batch.block_error,
                     (size_t)f->source.pixels.live_count * sizeof *to->block_error);
    cudaError_t waited = cudaStreamSynchronize(d->stream);
    return rn_cuda_check(e ? e : waited, "reading a field", err);
}

// ---- rendering ------------------------------------------------------------------------------

static struct rn_cuda_march march_of(const struct rn_march_options *o) {
    struct rn_cuda_march m = {};
    m.step = o->step;
    m.stop_depth = o->stop_depth;
    m.colour = o->colour;
    m.turned = o->look != NULL;
    if (o->look) memcpy(m.look, o->look, sizeof m.look);
    return m;
}

static cudaError_t make_stage(struct rn_backend_device *d) {
    cudaError_t e = cudaSuccess;
    for (int i = 0; i < 2 && !e; i++) {
        if (!d->staged[i])
            e = cudaHostAlloc(&d->staged[i], RN_RENDER_PIXELS * sizeof(struct rn_pixel),
                              cudaHostAllocDefault);
        if (!e && !d->places[i])
            e = cudaHostAlloc((void **)&d->places[i], RN_RENDER_PIXELS * sizeof *d->places[i],
                              cudaHostAllocDefault);
        if (!e && !d->rendered[i]) e = cudaEventCreate(&d->rendered[i]);
        if (!e && !d->arrived[i]) e = cudaEventCreate(&d->arrived[i]);
    }
    return e;
}

// A picture on its way: its view, and how many of its pixels were asked for.
struct picture {
    struct rn_cuda_view view;
    struct rn_cuda_march march;
    const struct rn_device_places *places;
    size_t asked;
};

// The next pixels as part number `part`; *ret_count of them. Parts take turns with two places, so
// that one is copied while the next is rendered.
static cudaError_t queue_part(struct rn_device_field *f, struct picture *p, int part,
                              size_t *ret_count) {
    struct rn_backend_device *d = f->device;
    int stage = part % 2, rays = p->view.cones * p->view.cones;
    size_t left = p->places->count - p->asked, most = (size_t)(RN_RENDER_PIXELS / rays);
    size_t count = left < most ? left : most;
    size_t bytes = count * (p->view.halves ? sizeof(rn_cuda_halves) : sizeof(rn_pixel));
    cudaError_t e = cudaSuccess;
    *ret_count = count;
    if (count == 0) return e;
    p->view.first = p->places->first + (uint32_t)p->asked;
    p->view.count = (int)count * rays;
    p->view.counts_anew = part == 0;
    if (p->places->numbers) {
        memcpy(d->places[stage], p->places->numbers + p->asked, count * sizeof *d->places[stage]);
        e = copy_in(d, f->places, d->places[stage], count * sizeof *f->places);
    }
    if (!e) e = rn_queue_view(f, &p->view, &p->march, f->parts[stage]);
    if (!e) e = cudaEventRecord(d->rendered[stage], d->stream);
    if (!e) e = cudaStreamWaitEvent(d->copies, d->rendered[stage], 0);
    if (!e)
        e = cudaMemcpyAsync(d->staged[stage], f->parts[stage], bytes, cudaMemcpyDeviceToHost,
                            d->copies);
    p->asked += count;
    return e ? e : cudaEventRecord(d->arrived[stage], d->copies);
}

// While the device has one part of the pixels, the host takes the part before; so the place of the
// one after is free.
static cudaError_t render_parts(struct rn_device_field *f, struct picture *p,
                                struct rn_pixel *ret_pixels) {
    struct rn_backend_device *d = f->device;
    cudaError_t e = cudaSuccess;
    size_t before = 0, count = 1;
    for (int part = 0; (count > 0 || before > 0) && !e; part++) {
        e = queue_part(f, p, part, &count);
        if (before > 0 && !e) e = cudaEventSynchronize(d->arrived[(part + 1) % 2]);
        if (before > 0 && !e)
            rn_take_pixels(d->staged[(part + 1) % 2], before, p->view.halves, ret_pixels);
        ret_pixels += before;
        before = count;
    }
    return e;
}

// The view's cameras, as their cones have them.
static cudaError_t upload_cameras(struct rn_device_field *f, const struct rn_device_view *v) {
    struct rn_camera cameras[RN_DEVICE_CAMERAS];
    for (int i = 0; i < v->camera_count; i++)
        cameras[i] = rn_camera_resized(&v->cameras[i], v->cameras[i].width * v->cones,
                                       v->cameras[i].height * v->cones);
    return copy_in(f->device, f->cameras, cameras, (size_t)v->camera_count * sizeof *cameras);
}

static struct rn_cuda_view view_of(const struct rn_device_field *f, const struct rn_device_view *v,
                                   const struct rn_march_options *options,
                                   const struct rn_device_places *places) {
    struct rn_cuda_view view = {};
    view.cameras = f->cameras;
    view.places = places->numbers ? f->places : NULL;
    view.width = v->cameras->width;
    view.height = v->cameras->height;
    view.cones = v->cones;
    view.cut = f->cut;
    view.cut.step = (double)options->step;
    view.straight = options->straight;
    view.halves = v->halves;
    view.ended = rn_ended_opacity(options->stop_depth, f->config.stop);
    return view;
}

static enum rn_status render(struct rn_device_field *f, const struct rn_device_view *view,
                             const struct rn_march_options *options,
                             const struct rn_device_places *places, struct rn_pixel *ret_pixels,
                             uint64_t *ret_samples, struct rn_error *err) {
    struct picture picture = {view_of(f, view, options, places), march_of(options), places, 0};
    struct rn_cuda_status status = {};
    f->seen = f->scene;
    if (view->cells != RN_CELLS_OF_TRAINING && f->finer[view->cells].cells > 0)
        f->seen.occupancy = f->finer[view->cells];
    cudaError_t e = make_stage(f->device);
    if (!e) e = upload_cameras(f, view);
    if (!e) e = render_parts(f, &picture, ret_pixels);
    if (!e && places->count > 0) e = copy_out(f->device, &status, f->view.status, sizeof status);
    cudaError_t waited = cudaStreamSynchronize(f->device->stream);
    cudaError_t copied = cudaStreamSynchronize(f->device->copies);
    *ret_samples = status.evaluated;
    return rn_cuda_check(e ? e : waited ? waited : copied, "rendering", err);
}

extern "C" {
extern const struct rn_backend rn_backend_table;
const struct rn_backend rn_backend_table = {
    RN_BACKEND_VERSION, "cuda",      device_open, device_close,
    used_bytes,         free_bytes,  needs,       field_create,
    field_destroy,      train_begin, train_step,  train_finish,
    train_timed,        train_share, download,    render,
};
}
