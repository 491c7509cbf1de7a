#include "server/engine/bench/count.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "server/engine/field/ripmap.h"
#include "server/engine/reference/voxels.h"
#include "server/engine/train/schedule.h"

#define LINE 64
#define MEMORY_SECONDS 0.03 // for one figure

// Lane operations; a multiply-add, a comparison, a conversion is one each.
enum {
    OPS_EXP = 17,       // clamp 2, round 3, reduce 2, polynomial 7, scale 3
    OPS_RAY = 90,       // random numbers 20, pixel to direction 20, ball 12, cube 30, colour 8
    OPS_MARCH = 28,     // position 3, cell 9, brick and bit 12, gather, test, list 4
    OPS_PLACE = 18,     // distance 3, mean 8, position 3, inside the ball 4
    OPS_PROJECT = 18,   // a plane: u, v 6; texel and fraction 2 x 6
    OPS_LEVELS = 30,    // a plane, where levels are needed: 2 x (variance 2, clamp 3, log2 10)
    OPS_CORNERS = 4,    // a map and channel: one multiply-add a corner
    OPS_VOXELS = 46,    // texel and fraction 3 x 6, seven interpolations of four channels
    OPS_ADAMW = 15,     // scale 1, moments 5, root and division 4, step 3, decay 1, clear 1
    OPS_COMPOSITE = 20, // depth 2, weight, both transmittances 6, opacity, distance, sums 12
};

static double product_peak(enum rn_product_unit unit, const struct rn_bench_machine *m) {
    switch (unit) {
    case RN_PRODUCT_AMX:
        return m->amx_bf16_l1;
    case RN_PRODUCT_BF16_DOT:
        return m->bf16_dot;
    default:
        return m->fma;
    }
}

double rn_bench_ceiling(const struct rn_bench_count *c, enum rn_product_unit unit,
                        const struct rn_bench_machine *m, const char **ret_limit) {
    static const char *const units[] = {
        [RN_PRODUCT_FMA] = "fma", [RN_PRODUCT_BF16_DOT] = "bf16 dot", [RN_PRODUCT_AMX] = "amx"};
    double products = c->products / product_peak(unit, m);
    double ns = (c->operations - c->products) / m->fma + products;
    *ret_limit = products > 0.5 * ns ? units[unit] : "fma";
    double visits = c->memory == RN_BENCH_LINES ? c->lines : c->bytes;
    if (visits > 0) {
        double each = rn_bench_memory_ns(c->memory, c->set_bytes, MEMORY_SECONDS);
        if (!isnan(each) && visits * each > ns) {
            ns = visits * each;
            *ret_limit = "memory";
        }
    }
    return 1e3 / ns;
}

static double samples_of(const struct rn_bench_recording *rec) {
    double samples = 0;
    for (int k = 0; k < rec->packet_count; k++)
        samples += rec->packets[k].workspace->count;
    return samples;
}

// Numbers of all maps of all planes.
static double map_numbers(const struct rn_cpu_field *f) {
    bool mip = f->config->footprint == RN_FOOTPRINT_MIP;
    double numbers = 0;
    for (int y = 0; y < f->built_levels; y++)
        for (int x = 0; x < f->built_levels; x++)
            if (rn_map_exists(mip, x, y))
                numbers += (double)f->maps[0][y][x].width * f->maps[0][y][x].height;
    return numbers * f->config->channels * f->config->planes;
}

// ---- texels ---------------------------------------------------------------------------------

// Distinct lines, by open addressing; stays a fraction full or stops counting.
struct lines {
    uintptr_t *slots;
    size_t capacity, count;
};

static void lines_add(struct lines *set, uintptr_t address) {
    uintptr_t line = address / LINE;
    size_t at = (size_t)(line * 0x9e3779b97f4a7c15u) & (set->capacity - 1);
    while (set->slots[at] && set->slots[at] != line)
        at = (at + 1) & (set->capacity - 1);
    if (set->slots[at] || set->count > set->capacity / 2) return;
    set->slots[at] = line;
    set->count++;
}

struct fetches {
    struct lines lines;
    double maps; // visited, over all samples and planes
};

// What fetching one sample from one plane touches.
static void visit(const struct rn_cpu_field *f, int plane, const double uv[2], const double l[2],
                  struct fetches *fetches) {
    int levels = f->built_levels < f->config->levels ? f->built_levels : f->config->levels;
    size_t texel = (size_t)f->config->channels * sizeof(float);
    bool mip = f->config->footprint == RN_FOOTPRINT_MIP;
    struct rn_lerp x = rn_rip_level(l[0], levels), y = rn_rip_level(l[1], levels);
    for (int i = 0; i < 4; i++) {
        bool upper_x = i & 1, upper_y = i & 2;
        if ((upper_x && !(x.fraction > 0)) || (upper_y && !(y.fraction > 0))) continue;
        if (mip && upper_x != upper_y) continue;
        const struct rn_map *map =
            &f->maps[plane][upper_y ? y.high : y.low][upper_x ? x.high : x.low];
        struct rn_lerp a = rn_rip_lerp(uv[0], map->width), b = rn_rip_lerp(uv[1], map->height);
        fetches->maps++;
        for (int row = b.low; row <= b.high; row++) {
            uintptr_t first =
                (uintptr_t)map->texels + ((size_t)row * (size_t)map->width + (size_t)a.low) * texel;
            for (uintptr_t at = first; at < first + 2 * texel; at += LINE)
                lines_add(&fetches->lines, at);
            lines_add(&fetches->lines, first + 2 * texel - 1);
        }
    }
}

// And from the voxels, two of which lie together.
static void visit_voxels(const struct rn_cpu_field *f, float *const place[3], int i,
                         struct fetches *fetches) {
    struct rn_voxel_corner corners[8];
    if (!f->config->voxels) return;
    rn_voxel_corners(f->config, (const double[3]){place[0][i], place[1][i], place[2][i]}, corners);
    for (int k = 0; k < 8; k += 2) {
        const float *first = f->maps[f->config->planes][0][0].texels + corners[k].offset;
        lines_add(&fetches->lines, (uintptr_t)first);
        lines_add(&fetches->lines, (uintptr_t)(first + 2 * RN_VOXEL_CHANNELS) - 1);
    }
}

static struct fetches fetches_begin(void) {
    struct fetches fetches = {.lines.capacity = (size_t)1 << 21};
    fetches.lines.slots = calloc(fetches.lines.capacity, sizeof *fetches.lines.slots);
    return fetches;
}

// Maps a sample and plane, and distinct lines a sample, of the samples that the packets evaluated.
static void count_encode(const struct rn_bench_recording *rec, double *ret_maps,
                         double *ret_lines) {
    const struct rn_cpu_field *f = rec->field;
    double maps = 0, lines = 0, samples = 0;
    for (int k = 0; k < rec->packet_count && k < 4; k++) {
        const struct rn_workspace *w = rec->packets[k].workspace;
        struct fetches fetches = fetches_begin();
        for (int i = 0; fetches.lines.slots && i < w->count; i++) {
            for (int p = 0; p < f->config->planes; p++)
                visit(f, p, (const double[2]){w->u[p][i], w->v[p][i]},
                      (const double[2]){w->lx[p][i], w->ly[p][i]}, &fetches);
            visit_voxels(f, w->voxel, i, &fetches);
        }
        maps += fetches.maps;
        lines += (double)fetches.lines.count;
        samples += w->count;
        free(fetches.lines.slots);
    }
    *ret_maps = maps / (samples * f->config->planes);
    *ret_lines = lines / samples;
}

// The same of the slabs' samples, which meet in the gradient maps.
static void count_scatter(const struct rn_bench_recording *rec, double *ret_maps,
                          double *ret_lines) {
    const struct rn_cpu_field *f = rec->field;
    bool leveled = f->built_levels > 1 && f->config->footprint != RN_FOOTPRINT_POINT;
    struct fetches fetches = fetches_begin();
    double samples = 0;
    for (int k = 0; k < rec->packet_count && fetches.lines.slots; k++) {
        const struct rn_slab *slab = &rec->packets[k].group->slab;
        samples += slab->count;
        for (int p = 0; p < f->config->planes; p++)
            for (int i = 0; i < slab->count; i++)
                visit(f, p, (const double[2]){slab->u[p][i], slab->v[p][i]},
                      (const double[2]){leveled ? slab->lx[p][i] : 0, leveled ? slab->ly[p][i] : 0},
                      &fetches);
        for (int i = 0; i < slab->count; i++)
            visit_voxels(f, slab->voxel, i, &fetches);
    }
    *ret_maps = fetches.maps / (samples * f->config->planes);
    *ret_lines = (double)fetches.lines.count / samples;
    free(fetches.lines.slots);
}

// Multiply-adds of fetching a sample, positions included.
static double encode_operations(const struct rn_cpu_field *f, double maps) {
    double plane =
        OPS_PROJECT + (maps > 1 ? OPS_LEVELS : 0) + maps * OPS_CORNERS * f->config->channels;
    return OPS_PLACE + f->config->planes * plane + (f->config->voxels ? OPS_VOXELS : 0);
}

// ---- stages ---------------------------------------------------------------------------------

struct rn_bench_count rn_bench_count_rays(const struct rn_bench_recording *rec, int rays) {
    return (struct rn_bench_count){.amount = rays,
                                   .operations = OPS_RAY,
                                   .bytes = LINE + sizeof(struct rn_march_ray),
                                   .lines = 1,
                                   .set_bytes = (double)rec->trainer->train.pixel_count * 4};
}

struct rn_bench_count rn_bench_count_march(const struct rn_bench_recording *rec) {
    double found = 0, rays = 0, cells = rec->field->occupancy.cells;
    for (int k = 0; k < rec->packet_count; k++) {
        const struct rn_bench_packet *packet = &rec->packets[k];
        rays += packet->ray_count;
        found += packet->found;
    }
    return (struct rn_bench_count){.amount = found,
                                   .operations = OPS_MARCH,
                                   .bytes = rays * sizeof(struct rn_march_ray) / found,
                                   .memory = RN_BENCH_STREAM,
                                   .set_bytes = cells * cells * cells / 8};
}

struct rn_bench_count rn_bench_count_encode(const struct rn_bench_recording *rec) {
    double maps, lines;
    count_encode(rec, &maps, &lines);
    return (struct rn_bench_count){.amount = samples_of(rec),
                                   .operations = encode_operations(rec->field, maps),
                                   .bytes = lines * LINE,
                                   .lines = lines,
                                   .set_bytes = map_numbers(rec->field) * sizeof(float)};
}

struct rn_bench_count rn_bench_count_forward(const struct rn_bench_recording *rec) {
    const struct rn_bench_packet *packet = &rec->packets[0];
    double samples = packet->workspace->count;
    double products = (double)rec->field->base_shape.count +
                      packet->heads / samples * (double)rec->field->head_shape.count;
    return (struct rn_bench_count){.amount = samples, .operations = products, .products = products};
}

struct rn_bench_count rn_bench_count_composite(const struct rn_bench_recording *rec) {
    bool per_ray = rec->field->config->shading == RN_SHADING_RAY;
    int exponentials = per_ray ? 1 + 3 + 2 : 1 + 2; // density, diffuse colour; two transmittances
    return (struct rn_bench_count){.amount = rec->packets[0].workspace->count,
                                   .operations = OPS_COMPOSITE + exponentials * OPS_EXP};
}

struct rn_bench_count rn_bench_count_backward(const struct rn_bench_recording *rec) {
    const struct rn_bench_packet *packet = &rec->packets[0];
    double rows = packet->returned;
    double products = 2 * ((double)rec->field->base_shape.count +
                           packet->heads / rows * (double)rec->field->head_shape.count);
    return (struct rn_bench_count){.amount = rows, .operations = products, .products = products};
}

struct rn_bench_count rn_bench_count_scatter(const struct rn_bench_recording *rec) {
    double maps, lines, samples = 0;
    const struct rn_field_config *c = rec->field->config;
    count_scatter(rec, &maps, &lines);
    for (int k = 0; k < rec->packet_count; k++)
        samples += rec->packets[k].group->slab.count;
    double numbers = c->planes * (c->channels + (maps > 1 ? 4 : 2));
    if (c->voxels) numbers += 3 + RN_VOXEL_CHANNELS;
    return (struct rn_bench_count){.amount = samples,
                                   .operations =
                                       c->planes * (12 + maps * OPS_CORNERS * c->channels) +
                                       (c->voxels ? OPS_VOXELS : 0),
                                   .bytes = 2 * lines * LINE + numbers * sizeof(float),
                                   .lines = lines,
                                   .set_bytes = map_numbers(rec->field) * sizeof(float)};
}

struct rn_bench_count rn_bench_count_optimiser(const struct rn_bench_recording *rec) {
    double numbers = (double)rn_bench_touched(rec);
    return (struct rn_bench_count){
        .amount = numbers,
        .operations = OPS_ADAMW,
        .bytes = 8 * sizeof(float), // parameter, gradient and both moments, read and written
        .memory = RN_BENCH_UPDATE,
        .set_bytes = 4 * sizeof(float) * numbers};
}

// A unit is a number of the base maps; `more` numbers of other maps hang on it. Building reads and
// writes every number once; pulling down reads, adds and clears every other one.
struct rn_bench_count rn_bench_count_pyramid(const struct rn_bench_recording *rec) {
    double base = (double)rec->trainer->field->parameters.plane_count;
    double more = map_numbers(rec->field) / base - 1;
    return (struct rn_bench_count){.amount = base,
                                   .operations = 4 * more,
                                   .bytes = (3 + 3 * more) * sizeof(float),
                                   .memory = RN_BENCH_UPDATE,
                                   .set_bytes = 2 * (1 + more) * base * sizeof(float)};
}

struct rn_bench_count rn_bench_count_occupancy(const struct rn_bench_recording *rec) {
    const struct rn_trainer *t = rec->trainer;
    const struct rn_cpu_field *f = rec->field;
    double cells = (double)t->hull.count;
    if (t->field->config.carve || t->progress.step >= RN_OCCUPANCY_WARM_UP) cells /= 4;
    return (struct rn_bench_count){.amount = cells / t->engine->info.threads,
                                   .operations = encode_operations(f, 1) + OPS_EXP +
                                                 (double)f->base_shape.count,
                                   .products = (double)f->base_shape.count,
                                   .bytes = 2 * sizeof(float),
                                   .memory = RN_BENCH_UPDATE,
                                   .set_bytes = cells * sizeof(float)};
}
