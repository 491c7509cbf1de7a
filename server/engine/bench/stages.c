#include "server/engine/bench/stages.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/bench/check.h"
#include "server/engine/bench/count.h"
#include "server/engine/bench/machine.h"
#include "server/engine/field/voxels.h"
#include "server/engine/train/schedule.h"

// ---- recording ------------------------------------------------------------------------------

static int head_rows(const struct rn_cpu_field *field, const struct rn_bench_packet *packet) {
    const struct rn_workspace *w = packet->workspace;
    int rows = 0;
    if (field->config->shading == RN_SHADING_RAY) {
        for (int r = 0; r < packet->ray_count && field->config->view_dependence; r++)
            rows += w->ray_first[r] >= 0;
        return rows;
    }
    for (int i = 0; i < w->count; i++)
        rows += w->weight[i] > 0;
    return rows;
}

static int candidates(const struct rn_workspace *w) {
    int sum = 0;
    for (int r = 0; r < w->ray_count; r++)
        sum += w->candidate_count[r];
    return sum;
}

// The first packet with samples among rays [begin, end) of the trainer's last step.
static bool record_packet(struct rn_bench_recording *rec, int begin, int end,
                          struct rn_bench_packet *packet) {
    struct rn_trainer *t = rec->trainer;
    struct rn_workspace *w = packet->workspace;
    struct rn_group *group = packet->group;
    while (begin < end) {
        group->slab.count = 0;
        group->cursor = begin;
        group->end = end;
        rec->kernels->train(rec->field, &t->step.march, t->step.rays, w, group);
        packet->rays = t->step.rays + begin;
        packet->ray_count = w->ray_count;
        packet->returned = group->slab.count;
        if (packet->returned > 0) {
            packet->heads = head_rows(rec->field, packet);
            packet->looked_at = candidates(w);
            rec->kernels->parts->stage(rec->field, &t->step.march, packet->rays, packet->ray_count,
                                       RN_STAGE_MARCH, w, group, NULL);
            packet->found = candidates(w);
            return true;
        }
        begin = group->cursor;
    }
    group->slab.count = 0;
    return false;
}

enum rn_status rn_bench_record(struct rn_trainer *trainer, struct rn_bench_recording *ret,
                               struct rn_error *err) {
    struct rn_bench_recording rec = {
        .trainer = trainer, .field = &trainer->field->cpu, .kernels = trainer->engine->kernels};
    size_t bytes = rn_workspace_size(rec.field, rn_picture_step(trainer->field));
    bytes = (bytes + 4095) / 4096 * 4096;
    rec.memory = aligned_alloc(4096, bytes * RN_GROUPS);
    rec.marks = malloc(trainer->optimiser.tiles * (size_t)rn_grid_count(rec.field->config));
    if (!rec.memory || !rec.marks) {
        rn_bench_recording_finish(&rec);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "bench", "out of memory");
    }
    int rays = trainer->step.ray_count;
    rn_trainer_begin_step(trainer); // clears the groups
    for (int g = 0; g < RN_GROUPS; g++) {
        struct rn_bench_packet *packet = &rec.packets[rec.packet_count];
        packet->workspace = rn_workspace_init(rec.field, rn_picture_step(trainer->field),
                                              rec.memory + (size_t)rec.packet_count * bytes);
        packet->group = &trainer->step.groups[g];
        rec.packet_count += record_packet(&rec, (int)((int64_t)rays * g / RN_GROUPS),
                                          (int)((int64_t)rays * (g + 1) / RN_GROUPS), packet);
    }
    if (rec.packet_count == 0) {
        rn_bench_recording_finish(&rec);
        return rn_error_set(err, RN_ERROR_INVALID, "bench", "no ray meets the scene");
    }
    *ret = rec;
    return RN_OK;
}

void rn_bench_recording_finish(struct rn_bench_recording *rec) {
    free(rec->memory);
    free(rec->marks);
    rec->memory = NULL;
    rec->marks = NULL;
}

// ---- running --------------------------------------------------------------------------------

void rn_bench_stage_run(const struct rn_bench_recording *rec, const struct rn_bench_packet *packet,
                        enum rn_stage stage, const float **ret_grad) {
    rec->kernels->parts->stage(rec->field, &rec->trainer->step.march, packet->rays,
                               packet->ray_count, stage, packet->workspace, packet->group,
                               ret_grad);
}

void rn_bench_scatter(const struct rn_bench_recording *rec) {
    struct rn_trainer *t = rec->trainer;
    for (int plane = 0; plane < rn_grid_count(rec->field->config); plane++)
        for (int band = 0; band < t->optimiser.bands; band++)
            for (int k = 0; k < rec->packet_count; k++)
                rec->kernels->scatter(rec->field, &rec->packets[k].group->slab, plane,
                                      t->optimiser.levels, rn_trainer_band(t, band),
                                      rn_trainer_band(t, band + 1), t->optimiser.grad_maps[plane],
                                      t->optimiser.touched + (size_t)plane * t->optimiser.tiles);
}

// The update clears its marks: it gets a copy.
void rn_bench_update(const struct rn_bench_recording *rec, int plane,
                     const struct rn_adamw *options) {
    struct rn_trainer *t = rec->trainer;
    const struct rn_field_config *c = rec->field->config;
    size_t size = (size_t)c->base * (size_t)c->base * (size_t)c->channels, p = (size_t)plane;
    uint8_t *marks = rec->marks + p * t->optimiser.tiles;
    bool sparse = t->field->config.sparse && t->optimiser.tiled;
    struct rn_plane_update update = {
        .options = options,
        .maps = t->field->cpu.maps[p],
        .grad_maps = t->optimiser.grad_maps[p],
        .m = t->optimiser.m + p * size,
        .v = t->optimiser.v + p * size,
        .touched = sparse ? marks : NULL,
        .levels = t->optimiser.tiled && plane < c->planes ? t->optimiser.levels : 1,
        .channels = c->channels,
        .mip = c->footprint == RN_FOOTPRINT_MIP};
    memcpy(marks, t->optimiser.touched + p * t->optimiser.tiles, t->optimiser.tiles);
    rec->kernels->update(&update, 0, c->base);
}

void rn_bench_optimise(const struct rn_bench_recording *rec) {
    static const struct rn_adamw options = {.scale = 1,
                                            .rate = 1e-6f,
                                            .eps = 1e-15f,
                                            .keep = 0.999f,
                                            .fresh = 0.001f,
                                            .correction1 = 0.9f,
                                            .correction2 = 0.9f};
    for (int plane = 0; plane < rn_grid_count(rec->field->config); plane++)
        rn_bench_update(rec, plane, &options);
}

size_t rn_bench_touched(const struct rn_bench_recording *rec) {
    const struct rn_trainer *t = rec->trainer;
    const struct rn_field_config *c = rec->field->config;
    struct rn_tiling tiling = rn_tiling(c->base, c->channels, t->optimiser.levels);
    struct rn_tiling voxels = rn_tiling(c->base, c->channels, 1);
    size_t tiles[2] = {0, 0}, of_planes = t->optimiser.tiles * (size_t)c->planes;
    if (!t->field->config.sparse || !t->optimiser.tiled) return t->field->parameters.plane_count;
    for (size_t i = 0; i < t->optimiser.tiles * (size_t)rn_grid_count(c); i++)
        tiles[i >= of_planes] += t->optimiser.touched[i];
    return ((tiles[0] * (size_t)c->channels) << (tiling.shift_x + tiling.shift_y)) +
           ((tiles[1] * (size_t)c->channels) << voxels.shift_x);
}

void rn_bench_pyramid(const struct rn_bench_recording *rec) {
    struct rn_trainer *t = rec->trainer;
    const struct rn_field_config *c = rec->field->config;
    bool mip = c->footprint == RN_FOOTPRINT_MIP;
    for (int p = 0; p < c->planes; p++) {
        rec->kernels->pull_down(t->optimiser.grad_maps[p], t->optimiser.levels, mip, c->channels);
        rec->kernels->build(t->field->cpu.maps[p], rec->field->built_levels, mip, c->channels);
    }
}

// A stage over all packets. The features, activations and gradients of all of them lie in the
// first one's memory, warm in the cache as in training; positions and candidates are their own.
struct sweep {
    const struct rn_bench_recording *rec;
    enum rn_stage stage;
};

static void run_sweep(void *context) {
    const struct sweep *sweep = context;
    for (int k = 0; k < sweep->rec->packet_count; k++)
        rn_bench_stage_run(sweep->rec, &sweep->rec->packets[k], sweep->stage, NULL);
}

static void run_first(void *context) {
    const struct sweep *sweep = context;
    rn_bench_stage_run(sweep->rec, &sweep->rec->packets[0], sweep->stage, NULL);
}

static void run_scatter(void *context) {
    rn_bench_scatter(context);
}
static void run_optimise(void *context) {
    rn_bench_optimise(context);
}
static void run_pyramid(void *context) {
    rn_bench_pyramid(context);
}
static void run_occupancy(void *context) {
    const struct rn_bench_recording *rec = context;
    rn_trainer_update_occupancy(rec->trainer);
}

#define RAYS_A_CALL 4096

static void run_rays(void *context) {
    const struct rn_bench_recording *rec = context;
    struct rn_trainer *t = rec->trainer;
    struct rn_trainer_place places[RN_TRAINER_RAYS];
    for (uint32_t i = 0; i < RAYS_A_CALL; i += RN_TRAINER_RAYS) {
        for (uint32_t j = 0; j < RN_TRAINER_RAYS; j++) {
            struct rn_rng4 draw = rn_rng_draw(1, 2, i + j);
            const struct rn_pixel_frame *frame =
                &t->train.frames[draw.v[0] % (uint32_t)t->train.frame_count];
            uint32_t width = (uint32_t)frame->camera.width;
            uint32_t height = (uint32_t)frame->camera.height;
            places[j] = (struct rn_trainer_place){
                .frame = frame, .x = (int)(draw.v[1] % width), .y = (int)(draw.v[2] % height)};
            __builtin_prefetch(rn_pixel_at(&t->train, frame, places[j].x, places[j].y));
        }
        rn_trainer_rays(t, &t->train, places, RN_TRAINER_RAYS, t->field->config.step,
                        t->step.rays + i);
    }
}

// ---- all stages -----------------------------------------------------------------------------

struct bench {
    struct rn_bench_recording *rec;
    const struct rn_bench_machine *machine;
    struct rn_bench_result *result;
    double seconds; // a stage
};

// The stages in the order of a step, and the bound on the error of each: where the networks'
// operands are fp32, and where they are rounded to bf16.
enum place {
    RAYS,
    MARCH,
    ENCODE,
    FORWARD,
    COMPOSITE,
    BACKWARD,
    SCATTER,
    OPTIMISER,
    PYRAMID,
    OCCUPANCY,
    ALL
};
_Static_assert(ALL <= RN_BENCH_STAGES, "stages of a result");
static const struct {
    const char *name, *unit;
    double bound, bf16_bound;
} places[ALL] = {
    {"rays", "Mrays/s", 1e-5, 1e-5},          {"march", "Msamples/s", 5e-3, 5e-3},
    {"encode", "Msamples/s", 1e-3, 1e-3},     {"mlp forward", "Msamples/s", 1e-4, 2e-2},
    {"composite", "Msamples/s", 1e-4, 1e-4},  {"mlp backward", "Msamples/s", 1e-4, 0.05},
    {"scatter", "Msamples/s", 1e-5, 1e-5},    {"optimiser", "Mparameters/s", 1e-5, 1e-5},
    {"pyramid", "Mparameters/s", 1e-5, 1e-5}, {"occupancy", "Mcells/s", 1e-3, 0.1},
};

static void time_stage(struct bench *b, enum place place, double error, struct rn_bench_count count,
                       void (*work)(void *context), void *context) {
    struct rn_bench_stage *s = &b->result->stages[place];
    bool bf16 = rn_kernels_bf16(b->rec->kernels);
    double bound = bf16 ? places[place].bf16_bound : places[place].bound;
    const char *limit;
    double ceiling = rn_bench_ceiling(&count, b->rec->kernels->unit, b->machine, &limit);
    *s = (struct rn_bench_stage){.name = places[place].name,
                                 .unit = places[place].unit,
                                 .operations = count.operations,
                                 .bytes = count.bytes,
                                 .ceiling = ceiling,
                                 .limit = limit,
                                 .measured = NAN,
                                 .ratio = NAN,
                                 .error = error,
                                 .passed = error <= bound};
    if (!s->passed) return;
    s->measured = count.amount / rn_bench_least(b->seconds, work, context) * 1e-6;
    s->ratio = s->measured / s->ceiling;
}

// All packets work in the first one's rows.
static void share_rows(struct rn_bench_recording *rec) {
    const struct rn_workspace *first = rec->packets[0].workspace;
    for (int k = 1; k < rec->packet_count; k++) {
        struct rn_workspace *w = rec->packets[k].workspace;
        w->features = first->features;
        w->padded = (struct rn_padding){0};
        memcpy(w->hidden, first->hidden, sizeof w->hidden);
        w->geometry = first->geometry;
        w->grad_a = first->grad_a;
        w->grad_b = first->grad_b;
    }
}

// In the order that leaves each its inputs.
static void time_packets(struct bench *b) {
    struct rn_bench_recording *rec = b->rec;
    const struct rn_bench_packet *first = &rec->packets[0];
    struct sweep march = {rec, RN_STAGE_MARCH}, encode = {rec, RN_STAGE_ENCODE};
    struct sweep forward = {rec, RN_STAGE_MLP_FORWARD}, composite = {rec, RN_STAGE_COMPOSITE};
    struct sweep backward = {rec, RN_STAGE_MLP_BACKWARD};
    time_stage(b, BACKWARD, rn_bench_check_backward(rec, first), rn_bench_count_backward(rec),
               run_first, &backward);
    time_stage(b, MARCH, rn_bench_check_march(rec), rn_bench_count_march(rec), run_sweep, &march);
    share_rows(rec);
    time_stage(b, ENCODE, rn_bench_check_encode(rec, first), rn_bench_count_encode(rec), run_sweep,
               &encode);
    rn_bench_stage_run(rec, first, RN_STAGE_ENCODE, NULL);
    time_stage(b, FORWARD, rn_bench_check_forward(rec, first), rn_bench_count_forward(rec),
               run_first, &forward);
    rn_bench_stage_run(rec, first, RN_STAGE_MLP_FORWARD, NULL);
    time_stage(b, COMPOSITE, rn_bench_check_composite(rec, first), rn_bench_count_composite(rec),
               run_first, &composite);
}

static void time_update(struct bench *b) {
    struct rn_bench_recording *rec = b->rec;
    time_stage(b, SCATTER, rn_bench_check_scatter(rec), rn_bench_count_scatter(rec), run_scatter,
               rec);
    time_stage(b, OPTIMISER, rn_bench_check_optimiser(rec), rn_bench_count_optimiser(rec),
               run_optimise, rec);
    if (rec->trainer->optimiser.levels > 1)
        time_stage(b, PYRAMID, rn_bench_check_pyramid(rec), rn_bench_count_pyramid(rec),
                   run_pyramid, rec);
    time_stage(b, OCCUPANCY, rn_bench_check_occupancy(rec), rn_bench_count_occupancy(rec),
               run_occupancy, rec);
}

// What a mean step takes when every stage runs at its ceiling: the recording's amounts, scaled to
// the step's samples.
static double step_ceiling_ms(const struct bench *b) {
    const struct rn_bench_recording *rec = b->rec;
    const struct rn_bench_stage *s = b->result->stages;
    double entered = 0, found = 0, evaluated = 0, returned = 0;
    for (int k = 0; k < rec->packet_count; k++) {
        const struct rn_bench_packet *packet = &rec->packets[k];
        entered += (double)packet->group->samples;
        found += packet->looked_at;
        evaluated += packet->workspace->count;
        returned += packet->returned;
    }
    double scale = entered > 0 ? b->result->step.samples / entered : 1;
    double numbers = (double)rn_bench_touched(rec);
    double cells = (double)rec->trainer->hull.count / 4 / RN_OCCUPANCY_EVERY;
    double us = b->result->step.rays / s[RAYS].ceiling + numbers / s[OPTIMISER].ceiling +
                cells / s[OCCUPANCY].ceiling;
    us += scale * (found / s[MARCH].ceiling + returned / s[BACKWARD].ceiling +
                   returned / s[SCATTER].ceiling);
    us += scale * evaluated *
          (1 / s[ENCODE].ceiling + 1 / s[FORWARD].ceiling + 1 / s[COMPOSITE].ceiling);
    if (s[PYRAMID].name)
        us += (double)rec->trainer->field->parameters.plane_count / s[PYRAMID].ceiling;
    return us * 1e-3 / b->result->threads;
}

void rn_bench_stages(struct rn_bench_recording *rec, const struct rn_bench_machine *machine,
                     double seconds, struct rn_bench_result *result) {
    struct bench b = {rec, machine, result, seconds / ALL};
    time_packets(&b);
    time_update(&b);
    time_stage(&b, RAYS, rn_bench_check_rays(rec), rn_bench_count_rays(rec, RAYS_A_CALL), run_rays,
               rec);
    result->step.ceiling_ms = step_ceiling_ms(&b);
    result->step.ratio = result->step.ceiling_ms / result->step.ms;
    for (int i = 0; i < ALL; i++) // a field without levels has no pyramid
        if (result->stages[i].name) result->stages[result->stage_count++] = result->stages[i];
}
