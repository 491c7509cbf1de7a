// The parts of a packet's work by themselves: what benchmarks time.
#ifndef RN_ENGINE_CPU_STAGE_H
#define RN_ENGINE_CPU_STAGE_H

#include "server/engine/cpu/packet.h"

static void stage_encode(const struct rn_cpu_field *field, const struct rn_march_options *options,
                         const struct rn_march_ray *rays, int count, struct rn_workspace *w) {
    struct ray_footprint footprints[RN_PACKET_RAYS];
    int next[RN_PACKET_RAYS];
    bool leveled = false;
    for (int r = 0; r < count; r++) {
        next[r] = 0;
        if (w->ray_first[r] < 0) continue;
        ray_footprint_init(field, &rays[r], options->step, &footprints[r]);
        leveled |= footprints[r].leveled;
    }
    for (int segment = 0; segment < w->segment_count; segment++) {
        int start = w->segment_start[segment], n = w->segment_size[segment], r = w->ray[start];
        place_segment(field, options, &rays[r], &footprints[r], leveled,
                      w->candidate + r * w->room + next[r], n, start, w);
        next[r] += n;
    }
    encode(field, leveled, 0, w->count, w);
}

// Rows of the colour network: rays with samples, or samples with a weight.
static int stage_heads(const struct rn_cpu_field *field, int count, const struct rn_workspace *w) {
    int rows = 0;
    if (field->config->shading == RN_SHADING_RAY) {
        for (int r = 0; r < count && field->config->view_dependence; r++)
            rows += w->ray_first[r] >= 0;
        return rows;
    }
    for (int i = 0; i < w->count; i++)
        rows += w->weight[i] > 0;
    return rows;
}

static void stage_composite(const struct rn_cpu_field *field,
                            const struct rn_march_options *options, const struct rn_march_ray *rays,
                            int count, struct rn_workspace *w) {
    activate(field, 0, w->count, w);
    memset(w->ray_depth, 0, (size_t)count * sizeof *w->ray_depth);
    round_attenuate(0, w);
    finish_weights(options, w);
    for (int r = 0; r < count; r++)
        if (w->ray_first[r] >= 0)
            w->slope[r] = sum_ray(r, field->config->shading == RN_SHADING_RAY, w).opacity;
}

static int stage(const struct rn_cpu_field *field, const struct rn_march_options *options,
                 const struct rn_march_ray *rays, int count, enum rn_stage what,
                 struct rn_workspace *w, struct rn_group *group, const float **ret_grad) {
    int heads = what == RN_STAGE_MARCH ? 0 : stage_heads(field, count, w);
    struct mlp base = base_network(field, w), head = head_network(field, w);
    const float *grad;
    switch (what) {
    case RN_STAGE_MARCH:
        packet_march(field, options, rays, count, w);
        return 0;
    case RN_STAGE_ENCODE:
        stage_encode(field, options, rays, count, w);
        break;
    case RN_STAGE_MLP_FORWARD:
        mlp_forward(&base, 0, w->count);
        mlp_forward(&head, 0, heads);
        break;
    case RN_STAGE_COMPOSITE:
        stage_composite(field, options, rays, count, w);
        break;
    case RN_STAGE_MLP_BACKWARD:
        mlp_backward(&head, w->head_out, heads, w, group->head_grad);
        grad = mlp_backward(&base, w->geometry_grad, group->slab.count, w, group->base_grad);
        if (ret_grad) *ret_grad = grad;
        return group->slab.count;
    }
    return w->count;
}

#endif
