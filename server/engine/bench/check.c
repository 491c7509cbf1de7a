#include "server/engine/bench/check.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "common/math/rng.h"
#include "server/engine/field/occupancy.h"
#include "server/engine/field/volume.h"
#include "server/engine/field/voxels.h"
#include "server/engine/reference/exact.h"
#include "server/engine/reference/reference.h"

#define SAMPLES 512 // looked at a stage, evenly spaced

struct worst {
    double difference, magnitude;
    double squares, all_squares; // of all differences, of the reference
    bool bad;
};

static void compare(struct worst *w, double fast, double exact) {
    if (!isfinite(fast) || !isfinite(exact)) w->bad = true;
    w->difference = fmax(w->difference, fabs(fast - exact));
    w->magnitude = fmax(w->magnitude, fabs(exact));
    w->squares += (fast - exact) * (fast - exact);
    w->all_squares += exact * exact;
}

static double result(const struct worst *w) {
    return w->bad || !(w->magnitude > 0) ? INFINITY : w->difference / w->magnitude;
}

// The same of the norms.
static double result_of_norms(const struct worst *w) {
    return w->bad || !(w->all_squares > 0) ? INFINITY : sqrt(w->squares / w->all_squares);
}

static int stride(int count) {
    return count > SAMPLES ? count / SAMPLES : 1;
}

// ---- rays and march -------------------------------------------------------------------------

double rn_bench_check_rays(const struct rn_bench_recording *rec) {
    const struct rn_trainer *t = rec->trainer;
    struct worst worst = {0};
    for (int f = 0; f < t->train.frame_count; f++) {
        const struct rn_pixel_frame *frame = &t->train.frames[f];
        const struct rn_camera *camera = &frame->camera;
        for (int y = 0; y < camera->height; y += 37) {
            int x = y * 7919 % camera->width;
            struct rn_march_ray ray =
                rn_trainer_ray(t, &t->train, frame, x, y, t->field->config.step, 0.01);
            double point[3], p[3], at[2] = {NAN, NAN};
            if (!(ray.length > 0)) continue;
            for (int i = 0; i < 3; i++)
                point[i] = t->field->bounds.centre[i] +
                           t->field->bounds.radius * (double)(ray.origin[i] + ray.direction[i]);
            rn_camera_axes(camera, point, p);
            (void)rn_camera_project(camera, p, at);
            compare(&worst, at[0], x + 0.5);
            compare(&worst, at[1], y + 0.5);
        }
    }
    return result(&worst);
}

static bool occupied(const struct rn_occupancy_bits *o, const struct rn_march_ray *ray, double s) {
    int cell[3];
    for (int i = 0; i < 3; i++)
        cell[i] = rn_cell_of((double)ray->origin[i] + (double)ray->direction[i] * s, o->cells);
    return o->words[rn_brick_word(cell[0], cell[1], cell[2], o->cells)] &
           rn_brick_bit(cell[0], cell[1]);
}

double rn_bench_check_march(const struct rn_bench_recording *rec) {
    double wrong = 0, all = 0;
    for (int p = 0; p < rec->packet_count; p++) {
        const struct rn_bench_packet *packet = &rec->packets[p];
        const struct rn_workspace *w = packet->workspace;
        double step = (double)rec->trainer->step.march.step;
        rn_bench_stage_run(rec, packet, RN_STAGE_MARCH, NULL);
        for (int r = 0; r < packet->ray_count; r++) {
            const struct rn_march_ray *ray = &packet->rays[r];
            int at = r * w->room, end = at + w->candidate_count[r];
            for (int k = 0; (k + 0.5) * step < (double)ray->length; k++) {
                bool expected = occupied(&rec->field->occupancy, ray, (k + 0.5) * step);
                bool found = at < end && w->candidate[at] == k;
                at += found;
                wrong += found != expected;
                all += expected;
            }
        }
    }
    return all > 0 ? wrong / all : INFINITY;
}

// ---- encode ---------------------------------------------------------------------------------

// Of what rounds to the bf16 number `fast`, the nearest to `exact`: a bf16 number has 8 bits.
static double before_bf16(double fast, double exact) {
    if (!isfinite(fast)) return fast;
    double half = ldexp(1, ilogb(fast) - 8);
    return fmin(fmax(exact, fast - half), fast + half);
}

double rn_bench_check_encode(const struct rn_bench_recording *rec,
                             const struct rn_bench_packet *packet) {
    struct worst worst = {0};
    const struct rn_workspace *w = packet->workspace;
    double exact[RN_MAX_PLANES * 16];
    float features[RN_MAX_PLANES * 16];
    rn_bench_stage_run(rec, packet, RN_STAGE_ENCODE, NULL);
    for (int i = 0; i < w->count; i += stride(w->count)) {
        rn_exact_features(rec->field, &packet->rays[w->ray[i]],
                          (double)rec->trainer->step.march.step, (double)w->s[i], exact, NULL);
        rec->kernels->parts->get_features(rec->field, i, w, features);
        for (int k = 0; k < rec->field->features; k++) {
            double fast = (double)features[k];
            if (rn_kernels_bf16(rec->kernels)) fast = before_bf16(fast, exact[k]);
            compare(&worst, fast, exact[k]);
        }
    }
    return result(&worst);
}

// ---- networks -------------------------------------------------------------------------------

// One network in float64: parameters, their gradient and one sample's activations and gradients.
struct network {
    const struct rn_mlp_shape *shape;
    double *block, *weights, *weight_grad;
    double *activation[RN_MLP_MAX_LAYERS + 1], *grad[RN_MLP_MAX_LAYERS + 1];
};

static bool network_init(const struct rn_mlp_shape *shape, const float *weights,
                         struct network *net) {
    size_t rows = 2 * (RN_MLP_MAX_LAYERS + 1);
    *net = (struct network){.shape = shape};
    net->block = calloc(2 * shape->count + rows * (size_t)shape->widest, sizeof(double));
    if (!net->block) return false;
    net->weights = net->block;
    net->weight_grad = net->block + shape->count;
    double *at = net->weight_grad + shape->count;
    for (int l = 0; l <= RN_MLP_MAX_LAYERS; l++, at += 2 * shape->widest) {
        net->activation[l] = at;
        net->grad[l] = at + shape->widest;
    }
    for (size_t i = 0; i < shape->count; i++)
        net->weights[i] = (double)weights[i];
    return true;
}

static double to_bf16(double x) {
    float rounded = (float)x;
    uint32_t bits;
    memcpy(&bits, &rounded, sizeof bits);
    bits = (bits + 0x7fff + (bits >> 16 & 1)) & 0xffff0000u;
    memcpy(&rounded, &bits, sizeof bits);
    return (double)rounded;
}

// `bf16`: the inputs are rounded as the kernels round them.
static const double *network_forward(struct network *net, const float *in, bool bf16) {
    for (int i = 0; i < net->shape->in[0]; i++)
        net->activation[0][i] = bf16 ? to_bf16((double)in[i]) : (double)in[i];
    rn_mlp_forward(net->shape, net->weights, net->activation);
    return net->activation[net->shape->layers];
}

// A network's rows as the kernels hold them.
struct rows {
    const struct rn_bench_recording *rec;
    const struct rn_workspace *w;
    const struct rn_mlp_shape *shape;
    const float *weights, *out;
    int count;
};

static struct rows base_rows(const struct rn_bench_recording *rec, const struct rn_workspace *w,
                             const float *out, int count) {
    const struct rn_cpu_field *f = rec->field;
    return (struct rows){rec, w, &f->base_shape, f->base_weights, out, count};
}

static struct rows head_rows(const struct rn_bench_recording *rec,
                             const struct rn_bench_packet *packet) {
    const struct rn_workspace *w = packet->workspace;
    const struct rn_cpu_field *f = rec->field;
    return (struct rows){rec, w, &f->head_shape, f->head_weights, w->head_out, packet->heads};
}

static const double *row_forward(struct network *net, const struct rows *rows, int i, bool bf16) {
    float features[RN_MAX_PLANES * 16];
    const float *in = rows->w->head_in + (size_t)i * RN_HEAD_INPUTS;
    if (rows->shape == &rows->rec->field->base_shape) {
        rows->rec->kernels->parts->get_features(rows->rec->field, i, rows->w, features);
        in = features;
    }
    return network_forward(net, in, bf16);
}

// `out` against the outputs in float64.
static double check_outputs(const struct rows *rows, int outputs) {
    struct worst worst = {.bad = rows->count == 0};
    struct network net;
    if (!network_init(rows->shape, rows->weights, &net)) return INFINITY;
    for (int i = 0; i < rows->count; i += stride(rows->count)) {
        const double *out = row_forward(&net, rows, i, false);
        for (int k = 0; k < outputs; k++)
            compare(&worst, (double)rows->out[(size_t)i * RN_GEOMETRY + (size_t)k], out[k]);
    }
    free(net.block);
    return result(&worst);
}

// One row's gradients, added to net->weight_grad and, as magnitudes, to `magnitude`.
static void network_backward(struct network *net, double *before, double *magnitude) {
    memcpy(before, net->weight_grad, net->shape->count * sizeof *before);
    rn_mlp_backward(net->shape, net->weights, net->activation, net->grad, net->weight_grad);
    for (size_t i = 0; i < net->shape->count; i++)
        magnitude[i] += fabs(net->weight_grad[i] - before[i]);
}

// Gradients of the weights, summed over all rows, and of the inputs (NULL: not looked at), where
// `out` is the outputs' gradient. With bf16 weights and inputs are rounded here too, or an
// activation next to zero would be cut on one side only, and norms count: of the weights against
// the norm of the sums of magnitudes, for what cancels over the rows is no measure of rounding.
static double check_gradients(const struct rows *rows, bool bf16, const float *weight_grad,
                              const float *in_grad, int inputs) {
    double (*const of)(const struct worst *) = bf16 ? result_of_norms : result;
    struct worst weights = {0}, in = {0};
    const struct rn_mlp_shape *shape = rows->shape;
    struct network net;
    double *magnitude = calloc(2 * shape->count, sizeof *magnitude);
    if (!magnitude || !network_init(shape, rows->weights, &net)) {
        free(magnitude);
        return INFINITY;
    }
    for (size_t i = 0; i < shape->count && bf16; i++)
        net.weights[i] = to_bf16(net.weights[i]);
    for (int i = 0; i < rows->count; i++) {
        row_forward(&net, rows, i, bf16);
        for (int k = 0; k < RN_GEOMETRY; k++)
            net.grad[shape->layers][k] = (double)rows->out[(size_t)i * RN_GEOMETRY + (size_t)k];
        network_backward(&net, magnitude + shape->count, magnitude);
        for (int k = 0; k < inputs && in_grad; k++)
            compare(&in, (double)in_grad[(size_t)(i * rows->rec->field->feature_stride + k)],
                    net.grad[0][k]);
    }
    for (size_t i = 0; i < shape->count; i++)
        compare(&weights, (double)weight_grad[i], net.weight_grad[i]);
    weights.all_squares = 0;
    for (size_t i = 0; i < shape->count; i++)
        weights.all_squares += magnitude[i] * magnitude[i];
    free(net.block);
    free(magnitude);
    return in_grad ? fmax(of(&weights), of(&in)) : of(&weights);
}

double rn_bench_check_forward(const struct rn_bench_recording *rec,
                              const struct rn_bench_packet *packet) {
    const struct rn_workspace *w = packet->workspace;
    rn_bench_stage_run(rec, packet, RN_STAGE_MLP_FORWARD, NULL);
    struct rows base = base_rows(rec, w, w->geometry, w->count);
    struct rows head = head_rows(rec, packet);
    double error = check_outputs(&base, RN_GEOMETRY);
    return packet->heads > 0 ? fmax(error, check_outputs(&head, 3)) : error;
}

double rn_bench_check_backward(const struct rn_bench_recording *rec,
                               const struct rn_bench_packet *packet) {
    const struct rn_cpu_field *f = rec->field;
    const struct rn_workspace *w = packet->workspace;
    struct rn_group *group = packet->group;
    const float *grad = NULL;
    memset(group->base_grad, 0, f->base_shape.count * sizeof(float));
    memset(group->head_grad, 0, f->head_shape.count * sizeof(float));
    rn_bench_stage_run(rec, packet, RN_STAGE_MLP_BACKWARD, &grad);
    struct rows base = base_rows(rec, w, w->geometry_grad, packet->returned);
    struct rows head = head_rows(rec, packet);
    double error =
        check_gradients(&base, rn_kernels_bf16(rec->kernels), group->base_grad, grad, f->features);
    if (packet->heads == 0) return error;
    return fmax(error,
                check_gradients(&head, rn_kernels_bf16(rec->kernels), group->head_grad, NULL, 0));
}

// ---- composite ------------------------------------------------------------------------------

static void composite_ray(const struct rn_bench_packet *packet, int r, const double *logits,
                          double stop_depth, struct worst *worst) {
    const struct rn_workspace *w = packet->workspace;
    double depth = 0;
    for (int segment = w->ray_first[r]; segment >= 0; segment = w->segment_next[segment])
        for (int j = 0; j < w->segment_size[segment]; j++) {
            int i = w->segment_start[segment] + j;
            double x = rn_density(logits[i]) * (double)w->interval[i];
            double weight = depth <= stop_depth ? exp(-depth) * rn_alpha(x) : 0;
            // Where the stop falls is decided in float32.
            if (fabs(depth - stop_depth) > 1e-4) compare(worst, (double)w->weight[i], weight);
            depth += x;
        }
}

double rn_bench_check_composite(const struct rn_bench_recording *rec,
                                const struct rn_bench_packet *packet) {
    struct worst worst = {0};
    const struct rn_workspace *w = packet->workspace;
    double *logits = malloc(((size_t)w->count + 1) * sizeof *logits);
    if (!logits) return INFINITY;
    for (int i = 0; i < w->count; i++)
        logits[i] = (double)w->geometry[(size_t)i * RN_GEOMETRY];
    rn_bench_stage_run(rec, packet, RN_STAGE_COMPOSITE, NULL);
    for (int r = 0; r < packet->ray_count; r++)
        composite_ray(packet, r, logits, (double)rec->trainer->step.march.stop_depth, &worst);
    free(logits);
    return result(&worst);
}

// ---- scatter, optimiser, occupancy ----------------------------------------------------------

static void add_products(const struct rn_map *map, const struct rn_map *grad, int channels,
                         double *sum, double *magnitude) {
    size_t n = (size_t)map->width * (size_t)map->height * (size_t)channels;
    for (size_t i = 0; i < n; i++) {
        double one = (double)map->texels[i] * (double)grad->texels[i];
        *sum += one;
        *magnitude += fabs(one);
    }
}

// Sums of parameter times gradient over all maps, or the base maps alone; and of their magnitudes.
static double product(const struct rn_bench_recording *rec, int levels, double *ret_magnitude) {
    const struct rn_cpu_field *f = rec->field;
    struct rn_map(*grads)[RN_MAX_LEVELS][RN_MAX_LEVELS] = rec->trainer->optimiser.grad_maps;
    int planes = f->config->planes, channels = f->config->channels;
    double sum = 0, magnitude = 0;
    for (int p = 0; p < planes; p++)
        for (int y = 0; y < levels; y++)
            for (int x = 0; x < levels; x++) {
                if (!rn_map_exists(f->config->footprint == RN_FOOTPRINT_MIP, x, y)) continue;
                add_products(&f->maps[p][y][x], &grads[p][y][x], channels, &sum, &magnitude);
            }
    if (f->config->voxels)
        add_products(&f->maps[planes][0][0], &grads[planes][0][0], channels, &sum, &magnitude);
    *ret_magnitude = magnitude;
    return sum;
}

double rn_bench_check_pyramid(const struct rn_bench_recording *rec) {
    const struct rn_cpu_field *f = rec->field;
    double magnitude, after_magnitude;
    rn_bench_pyramid(rec); // the optimiser changed the base maps: builds them anew
    for (int p = 0; p < f->config->planes; p++)
        for (int y = 0; y < f->built_levels; y++)
            for (int x = 0; x < f->built_levels; x++) {
                const struct rn_map *grad = &rec->trainer->optimiser.grad_maps[p][y][x];
                if (!rn_map_exists(f->config->footprint == RN_FOOTPRINT_MIP, x, y)) continue;
                size_t n = (size_t)grad->width * (size_t)grad->height * (size_t)f->config->channels;
                for (size_t i = 0; i < n; i++)
                    grad->texels[i] = (float)(i * 2654435761u % 1024) / 512 - 1;
            }
    double all = product(rec, f->built_levels, &magnitude);
    rn_bench_pyramid(rec);
    double base = product(rec, 1, &after_magnitude);
    return magnitude > 0 && isfinite(base) ? fabs(all - base) / magnitude : INFINITY;
}

double rn_bench_check_scatter(const struct rn_bench_recording *rec) {
    const struct rn_cpu_field *f = rec->field;
    int channels = f->config->channels, levels = f->built_levels;
    double samples = 0, magnitude = 0, unused;
    rn_bench_scatter(rec);
    for (int k = 0; k < rec->packet_count; k++) {
        const struct rn_slab *slab = &rec->packets[k].group->slab;
        for (int p = 0; p < f->config->planes; p++)
            for (int i = 0; i < slab->count; i++) {
                double value[16], uv[2] = {slab->u[p][i], slab->v[p][i]}, l[2] = {0, 0};
                if (levels > 1 && f->config->footprint != RN_FOOTPRINT_POINT) {
                    l[0] = slab->lx[p][i];
                    l[1] = slab->ly[p][i];
                }
                rn_exact_fetch(f, p, uv, l, value);
                for (int c = 0; c < channels; c++) {
                    double product = (double)slab->grad[p][(size_t)i * channels + c] * value[c];
                    samples += product;
                    magnitude += fabs(product);
                }
            }
        for (int i = 0; f->config->voxels && i < slab->count; i++) {
            double value[RN_VOXEL_CHANNELS];
            rn_exact_voxels(
                f, (const double[3]){slab->voxel[0][i], slab->voxel[1][i], slab->voxel[2][i]},
                value);
            for (int c = 0; c < RN_VOXEL_CHANNELS; c++) {
                double product =
                    (double)slab->voxel_grad[(size_t)i * RN_VOXEL_CHANNELS + (size_t)c] * value[c];
                samples += product;
                magnitude += fabs(product);
            }
        }
    }
    double texels = product(rec, levels, &unused);
    return magnitude > 0 && isfinite(texels) ? fabs(samples - texels) / magnitude : INFINITY;
}

// One number that an update may have changed. Sparse updates leave alone what has no gradient.
static void compare_updated(struct worst *worst, const struct rn_adamw *o, int step,
                            const float before[4], float after) {
    double p = (double)before[0], grad = (double)before[1], m = (double)before[2],
           v = (double)before[3];
    if (before[1] == 0 && after == before[0]) return;
    rn_reference_adamw(1, &p, &grad, &m, &v, (double)o->rate, (double)o->decay, (double)o->eps,
                       step);
    compare(worst, (double)after, p);
}

double rn_bench_check_optimiser(const struct rn_bench_recording *rec) {
    enum { STEP = 50 };
    struct rn_trainer *t = rec->trainer;
    const struct rn_field_config *c = rec->field->config;
    bool mip = c->footprint == RN_FOOTPRINT_MIP;
    size_t n = (size_t)c->base * (size_t)c->base * (size_t)c->channels, met = 0;
    struct rn_adamw o = {.scale = 1,
                         .rate = 0.01f,
                         .eps = 1e-15f,
                         .keep = 0.999f,
                         .fresh = 0.001f,
                         .correction1 = (float)(1 - pow(0.9, STEP)),
                         .correction2 = (float)(1 - pow(0.999, STEP))};
    float *memory = malloc(4 * n * sizeof *memory);
    struct worst worst = {0};
    if (!memory) return INFINITY;
    if (t->optimiser.levels > 1)
        rec->kernels->pull_down(t->optimiser.grad_maps[0], t->optimiser.levels, mip, c->channels);
    float *now[4] = {t->field->parameters.values, t->optimiser.grad_maps[0][0][0].texels,
                     t->optimiser.m, t->optimiser.v};
    for (int k = 0; k < 4; k++)
        memcpy(memory + (size_t)k * n, now[k], n * sizeof *memory);
    rn_bench_update(rec, 0, &o);
    for (size_t i = 0; i < n; i++) {
        const float before[4] = {memory[i], memory[n + i], memory[2 * n + i], memory[3 * n + i]};
        met += before[1] != 0;
        compare_updated(&worst, &o, STEP, before, now[0][i]);
    }
    for (int k = 0; k < 4; k++)
        memcpy(now[k], memory + (size_t)k * n, n * sizeof *memory);
    if (t->optimiser.levels > 1)
        rec->kernels->build(t->field->cpu.maps[0], rec->field->built_levels, mip, c->channels);
    free(memory);
    return met > 0 ? result(&worst) : INFINITY;
}

double rn_bench_check_occupancy(const struct rn_bench_recording *rec) {
    enum { N = 128 };
    const struct rn_cpu_field *f = rec->field;
    float points[N][3], density[N], features[RN_MAX_PLANES * 16];
    double exact[RN_MAX_PLANES * 16];
    struct worst worst = {0};
    struct network base;
    if (!network_init(&f->base_shape, f->base_weights, &base)) return INFINITY;
    for (int i = 0; i < N; i++)
        for (int k = 0; k < 3; k++)
            points[i][k] = rn_rng_unit(rn_rng_draw(5, 6, (uint64_t)i).v[k]) - 0.5f;
    rec->kernels->density(f, points, N, 0, rec->packets[0].workspace, density);
    for (int i = 0; i < N; i++) {
        struct rn_march_ray at = {.direction = {0, 0, 1}};
        memcpy(at.origin, points[i], sizeof at.origin);
        rn_exact_features(f, &at, 0, 0, exact, NULL);
        for (int k = 0; k < f->features; k++)
            features[k] = (float)exact[k];
        compare(&worst, (double)density[i], rn_density(network_forward(&base, features, false)[0]));
    }
    free(base.block);
    return result(&worst);
}
