#include "server/engine/scene/scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "common/math/rng.h"
#include "common/math/vector.h"
#include "server/engine/field/footprint.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/ripmap.h"
#include "server/engine/field/space.h"
#include "server/engine/field/voxels.h"
#include "server/engine/kernels/ray.h"
#include "server/engine/scene/device.h"
#include "server/engine/scene/occupancy.h"

#define PAGE 4096
#define HUGE_PAGE (2u << 20)

// What is in front of a block is the address to free. calloc leaves large ones untouched: the
// kernel gives zeros when they are first used.
void *rn_block_create(size_t bytes) {
    size_t page = bytes > HUGE_PAGE ? HUGE_PAGE : PAGE, rounded = (bytes + PAGE - 1) / PAGE * PAGE;
    char *whole = calloc(1, rounded + page + sizeof whole);
    if (!whole) return NULL;
    char *block = whole + sizeof whole;
    block += (page - (uintptr_t)block % page) % page;
    memcpy(block - sizeof whole, &whole, sizeof whole);
    // Whole ones alone, so that what lies behind the block takes no memory. A hint: may be refused.
    if (page == HUGE_PAGE) madvise(block, bytes / HUGE_PAGE * HUGE_PAGE, MADV_HUGEPAGE);
    return block;
}

void rn_block_touch(void *block, size_t bytes) {
    volatile char *at = block;
    for (size_t i = 0; i < bytes; i += PAGE)
        at[i] = at[i];
}

void rn_block_destroy(void *block) {
    char *whole = NULL;
    if (block) memcpy(&whole, (char *)block - sizeof whole, sizeof whole);
    free(whole);
}

static size_t round16(size_t n) {
    return (n + 15) / 16 * 16;
}

// ---- pyramid --------------------------------------------------------------------------------

static size_t map_count(const struct rn_field_config *c, int x, int y) {
    return (size_t)rn_rip_size(c->base, x) * (size_t)rn_rip_size(c->base, y) * (size_t)c->channels +
           (size_t)c->channels * 2; // a fetch may read one texel behind the last
}

size_t rn_pyramid_count(const struct rn_field_config *c, int levels) {
    size_t count = 0;
    bool mip = c->footprint == RN_FOOTPRINT_MIP;
    for (int y = 0; y < levels; y++)
        for (int x = 0; x < levels; x++)
            if (x + y > 0 && rn_map_exists(mip, x, y)) count += map_count(c, x, y);
    return count;
}

void rn_pyramid_lay_out(const struct rn_field_config *c, int levels, float *base, float *block,
                        struct rn_map maps[RN_MAX_PLANES][RN_MAX_LEVELS][RN_MAX_LEVELS]) {
    bool mip = c->footprint == RN_FOOTPRINT_MIP;
    for (int p = 0; p < c->planes; p++)
        for (int y = 0; y < levels; y++)
            for (int x = 0; x < levels; x++) {
                if (!rn_map_exists(mip, x, y)) continue;
                struct rn_map *map = &maps[p][y][x];
                map->width = rn_rip_size(c->base, x);
                map->height = rn_rip_size(c->base, y);
                if (x + y == 0) {
                    map->texels = base + (size_t)p * c->base * c->base * c->channels;
                    continue;
                }
                map->texels = block;
                block += map_count(c, x, y);
            }
    if (c->voxels)
        maps[c->planes][0][0] =
            (struct rn_map){base + (size_t)c->planes * rn_grid_numbers(c), c->base, c->base};
}

enum rn_status rn_field_need_levels(struct rn_field *field, int levels, struct rn_error *err) {
    const struct rn_field_config *c = &field->config.field;
    if (levels > c->levels) levels = c->levels;
    if (c->footprint == RN_FOOTPRINT_POINT) levels = 1;
    if (levels <= field->pyramid_levels) {
        field->cpu.built_levels = field->pyramid_levels;
        return RN_OK;
    }
    size_t count = rn_pyramid_count(c, levels) * (size_t)c->planes;
    float *block = rn_block_create(count * sizeof *block);
    if (!block)
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "pyramid",
                            "cannot allocate %zu MiB for %d ripmap levels", count >> 18, levels);
    rn_block_destroy(field->pyramid);
    field->pyramid = block;
    field->pyramid_levels = field->cpu.built_levels = levels;
    rn_pyramid_lay_out(c, levels, field->parameters.values, block, field->cpu.maps);
    field->fresh_levels = 1;
    return RN_OK;
}

// ---- field ----------------------------------------------------------------------------------

static void set_shapes(struct rn_cpu_field *cpu, const struct rn_field_config *c) {
    cpu->config = c;
    cpu->features = rn_feature_count(c);
    cpu->feature_stride = (cpu->features + 15) / 16 * 16;
    cpu->base_shape = rn_mlp_shape(cpu->features, c->width, c->base_layers, RN_GEOMETRY);
    cpu->head_shape = rn_mlp_shape(RN_HEAD_INPUTS, c->width, c->head_layers, RN_HEAD_OUTPUTS);
    cpu->built_levels = 1;
}

static void set_parameter_counts(struct rn_parameters *p, const struct rn_cpu_field *cpu) {
    const struct rn_field_config *c = cpu->config;
    p->plane_count = (size_t)rn_grid_count(c) * rn_grid_numbers(c);
    p->base_count = cpu->base_shape.count;
    p->head_count = cpu->head_shape.count;
    p->appearance_count = rn_appearance_numbers(c);
    p->count = p->plane_count + p->base_count + p->head_count + p->appearance_count;
}

size_t rn_field_bytes(const struct rn_train_config *config, int levels) {
    struct rn_cpu_field cpu;
    struct rn_parameters parameters;
    set_shapes(&cpu, &config->field);
    set_parameter_counts(&parameters, &cpu);
    size_t cells = (size_t)config->field.occupancy;
    return (parameters.count + rn_pyramid_count(&config->field, levels) * config->field.planes) *
               sizeof(float) +
           cells * cells * cells * (sizeof(float) + 1 + 1) + // measured, hull, 8 finer bits
           cells * cells * cells / 8;
}

static enum rn_status allocate(struct rn_field *field) {
    size_t cells = (size_t)field->config.field.occupancy, n = cells * cells * cells;
    struct rn_cpu_field *cpu = &field->cpu;
    field->parameters.values = rn_block_create((field->parameters.count + 64) * sizeof(float));
    field->packed = rn_block_create(
        (rn_mlp_packed_count(&cpu->base_shape) + rn_mlp_packed_count(&cpu->head_shape)) *
        sizeof(float));
    field->occupancy = rn_block_create(n * sizeof(float));
    field->hull = rn_block_create(n);
    bool all = field->parameters.values && field->packed && field->occupancy && field->hull;
    return all ? rn_occupancy_bits_create((int)cells, field->config.field.space, &field->coarse)
               : RN_ERROR_NO_MEMORY;
}

// Every cell that meets the box of a forward-facing space may hold matter.
static void fill_box(struct rn_field *field) {
    int cells = field->config.field.occupancy;
    const double *half = field->cpu.disparity.half;
    field->hull_cells = 0;
    for (int x = 0; x < cells; x++)
        for (int y = 0; y < cells; y++)
            for (int z = 0; z < cells; z++) {
                int at[3] = {x, y, z};
                bool inside = true;
                for (int i = 0; i < 3; i++)
                    inside &= fabs((2 * at[i] + 1.0) / cells - 1) < half[i] + 1.0 / cells;
                field->hull[rn_cell_index(x, y, z, cells)] = inside;
                field->hull_cells += inside;
            }
}

// Every cell that meets the ball.
static enum rn_status fill_ball(struct rn_field *field) {
    int cells = field->config.field.occupancy;
    double *nearest = malloc((size_t)cells * sizeof *nearest); // squared, of a cell along one axis
    if (!nearest) return RN_ERROR_NO_MEMORY;
    for (int i = 0; i < cells; i++) {
        double low = 2.0 * i / cells - 1, high = low + 2.0 / cells;
        double d = low > 0 ? low : high < 0 ? high : 0;
        nearest[i] = d * d;
    }
    field->hull_cells = 0;
    for (int x = 0; x < cells; x++)
        for (int y = 0; y < cells; y++) {
            uint8_t *hull = field->hull + rn_cell_index(x, y, 0, cells);
            for (int z = 0; z < cells; z++) {
                hull[z] = nearest[x] + nearest[y] + nearest[z] <= 1;
                field->hull_cells += hull[z];
            }
        }
    free(nearest);
    return RN_OK;
}

enum rn_status rn_field_fill(struct rn_field *field) {
    if (!field->cpu.disparity.on) return fill_ball(field);
    fill_box(field);
    return RN_OK;
}

static void point_at_parameters(struct rn_field *field) {
    float *values = field->parameters.values;
    rn_pyramid_lay_out(&field->config.field, field->pyramid_levels, values, field->pyramid,
                       field->cpu.maps);
    field->cpu.base_weights = values + field->parameters.plane_count;
    field->cpu.head_weights = field->cpu.base_weights + field->parameters.base_count;
}

void rn_field_exchange(struct rn_field *field, float **values, float **pyramid, int *levels) {
    float *own_values = field->parameters.values, *own_pyramid = field->pyramid;
    int own_levels = field->pyramid_levels;
    field->parameters.values = *values;
    field->pyramid = *pyramid;
    field->pyramid_levels = *levels;
    point_at_parameters(field);
    *values = own_values;
    *pyramid = own_pyramid;
    *levels = own_levels;
}

enum rn_status rn_field_create(const struct rn_train_config *config, const struct rn_bounds *bounds,
                               struct rn_field **ret_field, struct rn_error *err) {
    struct rn_field *field = calloc(1, sizeof *field);
    if (!field) return rn_error_set(err, RN_ERROR_NO_MEMORY, "field", "out of memory");
    field->config = *config;
    field->bounds = *bounds;
    field->psnr = NAN;
    set_shapes(&field->cpu, &field->config.field);
    set_parameter_counts(&field->parameters, &field->cpu);
    field->pyramid_levels = field->fresh_levels = 1;
    enum rn_status status = rn_solid_init(config->field.planes, config->field.orientation,
                                          config->seed, &field->cpu.solid, err);
    if (status == RN_OK) {
        status = allocate(field);
        if (status == RN_OK) status = rn_field_fill(field);
        if (status != RN_OK)
            rn_error_set(err, status, "field", "cannot allocate %zu MiB for this configuration",
                         rn_field_bytes(config, 1) >> 20);
    }
    if (status != RN_OK) {
        rn_field_destroy(&field);
        return status;
    }
    point_at_parameters(field);
    field->cpu.base_packed = field->packed;
    field->cpu.head_packed = field->packed + rn_mlp_packed_count(&field->cpu.base_shape);
    rn_field_refresh_occupancy(field);
    *ret_field = field;
    return RN_OK;
}

void rn_field_destroy(struct rn_field **field) {
    struct rn_field *f = *field;
    if (!f) return;
    rn_field_withdraw(f);
    rn_block_destroy(f->parameters.values);
    rn_block_destroy(f->packed);
    rn_block_destroy(f->pyramid);
    rn_block_destroy(f->occupancy);
    rn_block_destroy(f->hull);
    rn_occupancy_bits_destroy(&f->coarse);
    rn_occupancy_bits_destroy(&f->fine);
    rn_occupancy_bits_destroy(&f->firm);
    free(f);
    *field = NULL;
}

static float uniform(uint64_t seed, uint64_t stream, size_t i, float bound) {
    struct rn_rng4 draw = rn_rng_draw(seed, stream, i / 4);
    return (2 * rn_rng_unit(draw.v[i % 4]) - 1) * bound;
}

static void randomise_network(const struct rn_mlp_shape *shape, uint64_t seed, uint64_t stream,
                              int used_outputs, float *weights) {
    for (int l = 0; l < shape->layers; l++) {
        size_t in = round16((size_t)shape->in[l]), out = (size_t)shape->out[l];
        float bound = sqrtf(6.0f / (float)(in + out));
        for (size_t i = 0; i < (size_t)shape->in[l] * out; i++) {
            bool unused = l + 1 == shape->layers && (int)(i % out) >= used_outputs;
            weights[shape->offset[l] + i] =
                unused ? 0 : uniform(seed, stream + (uint64_t)l, i, bound);
        }
    }
}

void rn_field_randomise(struct rn_field *field, uint64_t seed) {
    struct rn_parameters *p = &field->parameters;
    const struct rn_field_config *c = &field->config.field;
    size_t used = (size_t)c->planes * rn_grid_numbers(c), side = (size_t)rn_voxel_side(c);
    if (c->voxels) used += side * side * side * RN_VOXEL_CHANNELS;
    for (size_t i = 0; i < used; i++)
        p->values[i] = uniform(seed, 100, i, 0.01f);
    memset(p->values + used, 0, (p->plane_count - used) * sizeof *p->values);
    randomise_network(&field->cpu.base_shape, seed, 200, RN_GEOMETRY, p->values + p->plane_count);
    randomise_network(&field->cpu.head_shape, seed, 300, 3,
                      p->values + p->plane_count + p->base_count);
}

// ---- refresh --------------------------------------------------------------------------------

struct build {
    struct rn_field *field;
    const struct rn_kernels *kernels;
};
static void build_plane(void *context, int plane, int thread) {
    (void)thread;
    const struct build *build = context;
    struct rn_cpu_field *cpu = &build->field->cpu;
    build->kernels->build(cpu->maps[plane], cpu->built_levels,
                          cpu->config->footprint == RN_FOOTPRINT_MIP, cpu->config->channels);
}

void rn_field_pack(struct rn_field *field, struct rn_engine *engine) {
    struct rn_cpu_field *cpu = &field->cpu;
    engine->kernels->pack(&cpu->base_shape, cpu->base_weights, field->packed);
    engine->kernels->pack(&cpu->head_shape, cpu->head_weights,
                          field->packed + rn_mlp_packed_count(&cpu->base_shape));
    field->packed_for = engine->kernels;
}

void rn_field_refresh(struct rn_field *field, struct rn_engine *engine) {
    struct rn_cpu_field *cpu = &field->cpu;
    rn_field_pack(field, engine);
    if (cpu->built_levels > 1) {
        struct build build = {field, engine->kernels};
        rn_pool_run(engine->pool, cpu->config->planes, build_plane, &build);
    }
    field->fresh_levels = cpu->built_levels;
}

// ---- workspaces and rays ---------------------------------------------------------------------

#define PICTURE_STEP 0.5 // of the trained step, in places

double rn_picture_step(const struct rn_field *field) {
    return field->config.step * (rn_is_place(&field->cpu) ? PICTURE_STEP : 1);
}

enum rn_status rn_engine_prepare(struct rn_engine *engine, const struct rn_field *field,
                                 struct rn_error *err) {
    const struct rn_field_config *config = &field->config.field;
    double step = rn_picture_step(field);
    if (engine->workspaces && engine->laid_out_step == step &&
        memcmp(&engine->laid_out, config, sizeof *config) == 0)
        return RN_OK;
    size_t bytes = (rn_workspace_size(&field->cpu, step) + 4095) / 4096 * 4096;
    if (bytes > engine->workspace_bytes) {
        rn_block_destroy(engine->workspaces);
        engine->workspace_bytes = 0;
        engine->workspaces = rn_block_create(bytes * (size_t)rn_pool_threads(engine->pool));
        if (!engine->workspaces)
            return rn_error_set(err, RN_ERROR_NO_MEMORY, "workspaces", "cannot allocate %zu MiB",
                                bytes * (size_t)rn_pool_threads(engine->pool) >> 20);
        engine->workspace_bytes = bytes;
    }
    for (int t = 0; t < rn_pool_threads(engine->pool); t++)
        rn_workspace_init(&field->cpu, step, rn_engine_workspace(engine, t));
    engine->laid_out = *config;
    engine->laid_out_step = step;
    return RN_OK;
}

enum rn_status rn_field_make_ready(struct rn_field *field, struct rn_engine *engine, int levels,
                                   struct rn_error *err) {
    enum rn_status status = rn_field_need_levels(field, levels, err);
    if (status == RN_OK) status = rn_engine_prepare(engine, field, err);
    bool fresh =
        field->fresh_levels >= field->cpu.built_levels && field->packed_for == engine->kernels;
    if (status == RN_OK && !fresh) rn_field_refresh(field, engine);
    return status;
}

struct rn_workspace *rn_engine_workspace(const struct rn_engine *engine, int thread) {
    return (struct rn_workspace *)((char *)engine->workspaces +
                                   (size_t)thread * engine->workspace_bytes);
}

bool rn_field_cube_of(const struct rn_field *field, const double point[3], double ret[3]) {
    const struct rn_disparity *box = &field->cpu.disparity;
    double seen[3], squares = 0;
    if (box->on) {
        rn_disparity_seen(box, point, seen);
        rn_disparity_map(box, seen, ret);
        return seen[2] >= box->near && seen[2] <= box->far && fabs(ret[0]) <= box->half[0] &&
               fabs(ret[1]) <= box->half[1];
    }
    for (int i = 0; i < 3; i++) {
        ret[i] = (point[i] - field->bounds.centre[i]) / field->bounds.radius;
        squares += ret[i] * ret[i];
    }
    if (field->config.field.space != RN_SPACE_UNBOUNDED) return squares <= 1;
    double scale = (double)rn_contraction_at((rn_real)sqrt(squares)).scale;
    for (int i = 0; i < 3; i++)
        ret[i] *= scale;
    return true;
}

void rn_field_place_of(const struct rn_field *field, const double cube[3], double ret[3]) {
    const struct rn_disparity *box = &field->cpu.disparity;
    double seen[3], size = sqrt(rn_dot(cube, cube)), scale = 1;
    if (box->on) {
        rn_disparity_unmap(box, cube, seen);
        for (int i = 0; i < 3; i++)
            ret[i] = box->origin[i] + box->unit * rn_dot(box->axes[i], seen);
        return;
    }
    if (field->config.field.space == RN_SPACE_UNBOUNDED && size > 0)
        scale = (double)rn_uncontracted((rn_real)size) / size;
    for (int i = 0; i < 3; i++)
        ret[i] = field->bounds.centre[i] + field->bounds.radius * scale * cube[i];
}

struct rn_march_ray rn_march_ray_from(const struct rn_field *field, const struct rn_ray *ray,
                                      double step, double jitter) {
    const struct rn_disparity *space = &field->cpu.disparity;
    if (space->on) {
        struct rn_ray seen = *ray;
        rn_disparity_seen(space, ray->origin, seen.origin);
        rn_disparity_turn(space, ray->direction, seen.direction);
        return rn_ray_cut_forward(space, &seen, step, jitter);
    }
    if (field->config.field.space == RN_SPACE_UNBOUNDED)
        return rn_ray_cut_unbounded(field->bounds.centre, field->bounds.radius, ray, step, jitter);
    return rn_ray_cut(field->bounds.centre, field->bounds.radius, field->config.cone_step, ray,
                      step, jitter);
}

struct rn_camera rn_field_camera(const struct rn_field *field, const struct rn_frame *frame) {
    const struct rn_effect_record *lenses = &field->effects[RN_EFFECT_DISTORTION];
    return lenses->decided && !lenses->on ? rn_camera_without_lens(&frame->camera) : frame->camera;
}

struct rn_view rn_field_view(const struct rn_field *field, const struct rn_camera *camera) {
    const struct rn_disparity *space = &field->cpu.disparity;
    if (space->on) return rn_view_forward(space, camera);
    return rn_view_init(field->config.field.space, field->bounds.centre, field->bounds.radius,
                        camera);
}

double rn_cone_at_centre(const struct rn_field *field, const struct rn_camera *camera) {
    const struct rn_bounds *bounds = &field->bounds;
    if (field->config.field.space == RN_SPACE_UNBOUNDED)
        return rn_camera_cone(camera) * bounds->radius;
    return rn_camera_cone(camera) * rn_camera_distance(camera, bounds->centre);
}

// In the disparity box a cone is widest at one of its ends, as its width is linear in 1 / z, and of
// a camera's one through a corner of the picture, or through its middle.
static double forward_level(const struct rn_field *field, const struct rn_camera *camera,
                            double step) {
    const struct rn_field_config *c = &field->config.field;
    const struct rn_disparity *space = &field->cpu.disparity;
    double ends[2] = {space->near, space->far}, width = 0;
    for (int corner = 0; corner < 5; corner++) {
        double eye[3], d[3], x = corner & 1 ? camera->width : 0;
        double y = corner & 2 ? camera->height : 0;
        struct rn_ray ray = corner < 4 ? rn_camera_ray(camera, x, y)
                                       : rn_camera_ray(camera, camera->cx, camera->cy);
        rn_disparity_seen(space, ray.origin, eye);
        rn_disparity_turn(space, ray.direction, d);
        for (int i = 0; i < 2 && d[2] > RN_FORWARD_LEAST; i++)
            width = fmax(width, ray.radius / d[2] * space->scale[0] * (1 - eye[2] / ends[i]));
    }
    if (rn_levels_by_axis(c))
        return rn_level_from_variance(fmax(step * step / 12, width * width / 4),
                                      rn_footprint_base(c), c->levels);
    return rn_level_from_ball(width * rn_footprint_base(c), c->levels);
}

double rn_top_level(const struct rn_field *field, const struct rn_camera *camera, double step) {
    const struct rn_field_config *c = &field->config.field;
    if (c->footprint == RN_FOOTPRINT_POINT || c->levels == 1) return 0;
    double far = 0;
    if (field->cpu.disparity.on) return forward_level(field, camera, step);
    for (int i = 0; i < 3; i++) {
        double d =
            (camera->world_from_camera[i][3] - field->bounds.centre[i]) / field->bounds.radius;
        far += d * d;
    }
    double cone = rn_camera_widest_cone(camera);
    far = (sqrt(far) + 1) * cone; // cone radius at the far side of the ball
    if (c->space == RN_SPACE_UNBOUNDED) {
        far = (far + cone) * 0.5; // as it is drawn to at most (cpu/encode.h)
        step *= 2 * 1.5;
    }
    double level = rn_level_from_ball(far * rn_footprint_base(c), c->levels);
    if (rn_levels_by_axis(c)) {
        double variance = fmax(step * step / 12, far * far * 0.26 + step * step * 0.05);
        level = rn_level_from_variance(variance, rn_footprint_base(c), c->levels);
    }
    return level;
}

int rn_levels_for_camera(const struct rn_field *field, const struct rn_camera *camera,
                         double step) {
    return (int)ceil(rn_top_level(field, camera, step) - 1e-4) + 1;
}
