#include "server/engine/kernels/kernels.h"

#include <string.h>

// Samples of one ray at most.
static int longest_ray(double step) {
    return (int)(2.0 * 1.7320508 / step) + 2 * RN_ROUND;
}

// A packet's samples: 4,096, or fewer with wide networks so that a packet stays near the L2
// cache, but never less than one ray can have; a multiple of 32.
static int full_packet(const struct rn_cpu_field *field, double step) {
    int longest = longest_ray(step);
    size_t per_sample = (size_t)field->feature_stride + RN_GEOMETRY * 2 +
                        (size_t)field->config->width * (size_t)(field->config->base_layers + 2);
    if (field->config->shading == RN_SHADING_SAMPLE)
        per_sample += (size_t)field->config->width * (size_t)field->config->head_layers + 64;
    int capacity = RN_PACKET_SAMPLES;
    while (capacity > 512 && (size_t)capacity * per_sample * sizeof(float) > (3u << 20))
        capacity /= 2;
    return capacity > longest ? capacity : (longest + 31) / 32 * 32;
}

// As many, or more where a pixel's rays can have more: each is at most as long as the ball is wide.
int rn_workspace_capacity(const struct rn_cpu_field *field, double step) {
    int full = full_packet(field, step), longest = RN_PIXEL_RAYS * ((int)(2 / step) + 2);
    return full > longest ? full : (longest + 31) / 32 * 32;
}

// Hands out parts of one block; with memory == NULL only counts.
struct carver {
    char *memory;
    size_t used;
};

static void *carve(struct carver *c, size_t count, size_t size) {
    void *at = c->memory ? c->memory + c->used : NULL;
    c->used += ((count + RN_PACKET_SLACK) * size + 63) / 64 * 64;
    return at;
}

static size_t lay_out(const struct rn_cpu_field *field, double step, struct carver *c) {
    struct rn_workspace scratch, *w = carve(c, 1, sizeof *w);
    if (!w) w = &scratch;
    size_t n = (size_t)rn_workspace_capacity(field, step), f = sizeof(float);
    size_t width = (size_t)field->config->width, planes = (size_t)field->config->planes;
    size_t rays = RN_PACKET_RAYS;
    size_t heads = field->config->shading == RN_SHADING_RAY ? rays : n;
    size_t widest = (size_t)field->base_shape.widest;
    if ((size_t)field->head_shape.widest > widest) widest = (size_t)field->head_shape.widest;
    widest = (widest + 15) / 16 * 16;
    w->capacity = (int)n;
    w->full = full_packet(field, step);
    w->room = longest_ray(step) + RN_PACKET_SLACK;
    w->candidate = carve(c, RN_PACKET_RAYS * (size_t)w->room, sizeof *w->candidate);
    w->segment_start = carve(c, n, sizeof *w->segment_start);
    w->segment_size = carve(c, n, sizeof *w->segment_size);
    w->segment_next = carve(c, n, sizeof *w->segment_next);
    w->ray = carve(c, n, 1);
    w->s = carve(c, n, f);
    w->marched = carve(c, n, f);
    w->interval = carve(c, n, f);
    for (size_t p = 0; p < planes; p++) {
        w->u[p] = carve(c, n, f);
        w->v[p] = carve(c, n, f);
        w->lx[p] = carve(c, n, f);
        w->ly[p] = carve(c, n, f);
    }
    for (int k = 0; k < 3; k++)
        w->voxel[k] = field->config->voxels ? carve(c, n, f) : NULL;
    w->features = carve(c, (n + 32) * (size_t)field->feature_stride, f); // products read 32 rows
    for (int l = 0; l < field->config->base_layers; l++)
        w->hidden[l] = carve(c, n * width, f);
    w->geometry = carve(c, n * RN_GEOMETRY, f);
    w->x = carve(c, n, f);
    w->before = carve(c, n, f);
    w->weight = carve(c, n, f);
    w->after = carve(c, n, f);
    w->head_in = carve(c, heads * RN_HEAD_INPUTS, f);
    for (int l = 0; l < field->config->head_layers; l++)
        w->head_hidden[l] = carve(c, heads * width, f);
    w->head_out = carve(c, heads * RN_HEAD_OUTPUTS, f);
    w->slope = carve(c, n, f);
    w->size = carve(c, n, f);
    w->chance = carve(c, n, sizeof *w->chance);
    w->geometry_grad = carve(c, n * RN_GEOMETRY, f);
    w->grad_a = carve(c, n * widest, f);
    w->grad_b = carve(c, n * widest, f);
    size_t base = rn_mlp_packed_count(&field->base_shape);
    size_t head = rn_mlp_packed_count(&field->head_shape);
    w->weight_sums = carve(c, base > head ? base : head, f);
    w->kept = carve(c, n, sizeof *w->kept);
    return c->used;
}

size_t rn_workspace_size(const struct rn_cpu_field *field, double step) {
    struct carver counter = {0};
    return lay_out(field, step, &counter);
}

struct rn_workspace *rn_workspace_init(const struct rn_cpu_field *field, double step,
                                       void *memory) {
    struct carver carver = {.memory = memory};
    memset(memory, 0, rn_workspace_size(field, step));
    lay_out(field, step, &carver);
    return memory;
}
