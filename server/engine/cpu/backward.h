// The backward of one packet: from the pixels' errors to the slab that the scatter reads.
#ifndef RN_ENGINE_CPU_BACKWARD_H
#define RN_ENGINE_CPU_BACKWARD_H

#include <math.h>

#include "server/engine/cpu/crisp.h"
#include "server/engine/cpu/loss.h"

RN_INLINE float sum16(row16 x) {
    typedef float half8 __attribute__((vector_size(32)));
    typedef float half4 __attribute__((vector_size(16)));
    half8 a = __builtin_shufflevector(x, x, 0, 1, 2, 3, 4, 5, 6, 7) +
              __builtin_shufflevector(x, x, 8, 9, 10, 11, 12, 13, 14, 15);
    half4 b = __builtin_shufflevector(a, a, 0, 1, 2, 3) + __builtin_shufflevector(a, a, 4, 5, 6, 7);
    return (b[0] + b[2]) + (b[1] + b[3]);
}

// Composite backward along one ray, in place: w->slope holds dL/dw_i and becomes dL/dx_i, within
// 1e-5 of |T_{i+1} g_i| + sum of |w_j g_j|.
static void composite_backward(int r, struct rn_workspace *w) {
    int16_t segments[RN_PACKET_SAMPLES / RN_ROUND + 1];
    int n = 0;
    for (int s = w->ray_first[r]; s >= 0; s = w->segment_next[s])
        segments[n++] = (int16_t)s;
    double behind = 0; // sum of w_j g_j of the samples behind
    while (n-- > 0) {
        int start = w->segment_start[segments[n]], size = w->segment_size[segments[n]];
        for (int i = (size - 1) / RN_VD * RN_VD; i >= 0; i -= RN_VD) {
            vd g = vd_load(w->slope + start + i), share = g * vd_load(w->weight + start + i);
            vl mine = vd_first_lanes(size - i);
            vd sums = vd_suffix_sums((vd)((vl)share & mine));
            vd slope = vd_load(w->after + start + i) * g - (VD_DOWN(sums, 1) + behind);
            vd_store(w->slope + start + i, vd_select(mine, slope, g));
            behind += sums[0];
        }
    }
}

// The sums of four rows of 16, with RN_VL lanes of each at a time.
#if RN_VL == 16
#define IN_FOURS(A, B, I, J, K, L)                                                                 \
    __builtin_shufflevector(A, B, I, J, K, L, I + 4, J + 4, K + 4, L + 4, I + 8, J + 8, K + 8,     \
                            L + 8, I + 12, J + 12, K + 12, L + 12)
#elif RN_VL == 8
#define IN_FOURS(A, B, I, J, K, L)                                                                 \
    __builtin_shufflevector(A, B, I, J, K, L, I + 4, J + 4, K + 4, L + 4)
#else
#define IN_FOURS(A, B, I, J, K, L) __builtin_shufflevector(A, B, I, J, K, L)
#endif
RN_INLINE vf fold_row(row16 x) {
    vf part[16 / RN_VL], sum = vf_set(0);
    memcpy(part, &x, sizeof x);
    for (int i = 0; i < 16 / RN_VL; i++)
        sum += part[i];
    return sum;
}
RN_INLINE vf pair_sums(vf a, vf b) {
    return IN_FOURS(a, b, 0, RN_VL, 1, RN_VL + 1) + IN_FOURS(a, b, 2, RN_VL + 2, 3, RN_VL + 3);
}
RN_INLINE v4 sum_rows(row16 a, row16 b, row16 c, row16 d) {
    vf ab = pair_sums(fold_row(a), fold_row(b)), cd = pair_sums(fold_row(c), fold_row(d));
    vf all =
        IN_FOURS(ab, cd, 0, 1, RN_VL, RN_VL + 1) + IN_FOURS(ab, cd, 2, 3, RN_VL + 2, RN_VL + 3);
    v4 part[RN_VL / 4], sum = {0};
    memcpy(part, &all, sizeof all);
    for (int i = 0; i < RN_VL / 4; i++)
        sum += part[i];
    return sum;
}

// The first n lanes, at most 4.
RN_INLINE void store_some(float *to, v4 x, int n) {
    if (n >= 4)
        *(v4 *)to = x;
    else
        for (int i = 0; i < n; i++)
            to[i] = x[i];
}

static const row16 activated = {0, 1, 1, 1}; // lanes of the geometry that went through the sigmoid
static const row16 linear = {0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};

// Adds what the colour network's inputs ask of the appearance of a ray's photograph.
static void append_appearance(const struct rn_cpu_field *field,
                              const struct rn_march_options *options,
                              const struct rn_march_ray *ray, const float *in_grad,
                              struct rn_group *group) {
    if (field->config->appearances == 0) return;
    float *to = group->appearance_grad + rn_appearance_at(options, ray);
    for (int i = 0; i < RN_APPEARANCE; i++)
        to[i] += in_grad[RN_APPEARANCE_AT + i];
}

// Ray shading: dL/d(sums) of every ray through the head, then of its samples dL/dw and the size of
// dL/d(geometry).
static void backward_rays(const struct rn_cpu_field *field, const struct rn_march_options *options,
                          const struct rn_march_ray *rays, int hits, const int16_t *hit,
                          const struct ray_sums *sums, float (*ray_slope)[4],
                          struct rn_workspace *w, struct rn_group *group, row16 *ret_ray_grad) {
    for (int j = 0; j < hits; j++) {
        const float *g = ray_slope[hit[j]];
        row16 d = {g[3], g[0], g[1], g[2]};
        if (field->config->view_dependence) {
            float *out = w->head_out + (size_t)j * RN_HEAD_OUTPUTS;
            for (int c = 0; c < 3; c++) {
                d[0] += g[c] * out[c];
                out[c] = g[c] * sums[hit[j]].opacity;
            }
            memset(out + 3, 0, (RN_HEAD_OUTPUTS - 3) * sizeof *out);
        }
        ret_ray_grad[hit[j]] = d;
    }
    if (field->config->view_dependence) {
        struct mlp head = head_network(field, w);
        const float *in_grad = mlp_backward(&head, w->head_out, hits, w, group->head_grad);
        for (int j = 0; j < hits; j++, in_grad += RN_HEAD_INPUTS) {
            row16 *d = &ret_ray_grad[hit[j]];
            for (int i = 0; i < 12; i++)
                (*d)[4 + i] += in_grad[16 + i];
            for (int c = 0; c < 3; c++)
                (*d)[1 + c] += in_grad[28 + c];
            (*d)[0] += in_grad[31];
            append_appearance(field, options, &rays[hit[j]], in_grad, group);
        }
    }
    for (int s = 0; s < w->segment_count; s++) {
        int start = w->segment_start[s], end = start + w->segment_size[s];
        row16 d = ret_ray_grad[w->ray[start]], some = d * (linear + 0.25f * activated);
        float size = sqrtf(sum16(some * some)); // of dL/d(geometry) over the weight, at most
        for (int i = start; i < end; i += 4) {
            const row16 *row = (const row16 *)(w->geometry + (size_t)i * RN_GEOMETRY);
            store_some(w->slope + i, sum_rows(d * row[0], d * row[1], d * row[2], d * row[3]),
                       end - i);
            store_some(w->size + i, size * *(const v4 *)(w->weight + i), end - i);
        }
    }
}

// dL/d(geometry) of a sample but for the density, from its ray's.
RN_INLINE row16 geometry_slope(row16 ray_grad, int i, const struct rn_workspace *w) {
    row16 value = *(const row16 *)(w->geometry + (size_t)i * RN_GEOMETRY);
    return ray_grad * (activated * value * (1.0f - value) + linear) * w->weight[i];
}

// Sample shading: the same, through a head per sample; `kept` rows of the head.
static void backward_samples(const struct rn_cpu_field *field,
                             const struct rn_march_options *options,
                             const struct rn_march_ray *rays, int kept, float (*ray_slope)[4],
                             struct rn_workspace *w, struct rn_group *group) {
    memset(w->geometry_grad, 0, (size_t)w->count * RN_GEOMETRY * sizeof(float));
    for (int i = 0; i < w->count; i++)
        w->slope[i] = ray_slope[w->ray[i]][3];
    for (int j = 0; j < kept; j++) {
        int i = w->kept[j];
        const float *g = ray_slope[w->ray[i]];
        float *out = w->head_out + (size_t)j * RN_HEAD_OUTPUTS;
        for (int c = 0; c < 3; c++) {
            float colour = out[c];
            w->slope[i] += g[c] * colour;
            out[c] = g[c] * w->weight[i] * colour * (1 - colour);
        }
        memset(out + 3, 0, (RN_HEAD_OUTPUTS - 3) * sizeof *out);
    }
    struct mlp head = head_network(field, w);
    const float *in_grad = mlp_backward(&head, w->head_out, kept, w, group->head_grad);
    memset(w->size, 0, (size_t)w->count * sizeof *w->size);
    for (int j = 0; j < kept; j++) {
        const float *grad = in_grad + (size_t)j * RN_HEAD_INPUTS + RN_SH_COUNT;
        append_appearance(field, options, &rays[w->ray[w->kept[j]]], grad - RN_SH_COUNT, group);
        row16 row = *(const row16 *)grad;
        row[15] = 0; // of an input that is always 1
        w->size[w->kept[j]] = sqrtf(sum16(row * row));
        memcpy(w->geometry_grad + (size_t)w->kept[j] * RN_GEOMETRY + 1, grad, 15 * sizeof *grad);
    }
}

// n a multiple of 16.
RN_INLINE void copy_row(float *to, const float *from, size_t n) {
    for (size_t i = 0; i < n; i += 16)
        *(row16 *)(to + i) = *(const row16 *)(from + i);
}

// Chances in units of 2^-24.
#define CERTAIN (1 << 24)

// Writes to w->chance with what probability each sample is backpropagated: with roulette, in
// proportion to the gradient's size where that is below `roulette` times the packet's mean, else
// certainly, and so what is not finite, which is to be seen. 0 where the early stop or the loss
// left no gradient.
static void backward_chances(const struct rn_march_options *options, struct rn_workspace *w) {
    vf sum = vf_set(0), number = vf_set(0);
    memset(w->weight + w->count, 0, RN_VL * sizeof *w->weight);
    for (int i = 0; i < w->count; i += RN_VL) {
        vf size = vf_load(w->size + i) + vf_abs(vf_load(w->slope + i) * vf_load(w->x + i));
        vi some = (vf_load(w->weight + i) > 0.0f) & (size != 0.0f);
        size = vf_bits(vi_bits(size) & some);
        vf_store(w->size + i, size);
        sum += size;
        number += vf_bits(vi_bits(vf_set(1)) & some);
    }
    float threshold = options->roulette * vf_sum(sum) / vf_sum(number);
    bool plays = threshold > 0 && isfinite(threshold);
    for (int i = 0; i < w->count; i += RN_VL) {
        vf size = vf_load(w->size + i), chance = vf_set(CERTAIN);
        if (plays) chance = vf_min(size * ((float)CERTAIN / threshold) + 1.0f, chance);
        vi_store(w->chance + i, vi_from_float(chance) & (size != 0.0f));
    }
}

// Chooses the samples that are backpropagated through the density network, a gradient of chance p
// scaled by 1 / p (unbiased; the standard deviation of a step's gradient is below 2 % of it at the
// presets' threshold). One random number a packet: a sample is taken where the sum of the chances
// passes another whole number (systematic sampling), so that of neighbours on a ray, whose
// gradients are alike, about as many are taken as should be. Their rows move to the front. Returns
// their count.
static int backward_select(const struct rn_cpu_field *field, const struct rn_march_options *options,
                           const struct rn_march_ray *rays, const row16 *ray_grad,
                           struct rn_workspace *w) {
    int n = 0;
    uint32_t sum = rn_rng_draw(options->seed, options->counter, (uint64_t)rays->id << 20).v[0];
    backward_chances(options, w);
    for (int i = 0; i < w->count; i++) {
        uint32_t next = sum + (uint32_t)w->chance[i];
        w->kept[n] = i;
        n += next / CERTAIN != sum / CERTAIN;
        sum = next;
    }
    for (int j = 0; j < n; j++) {
        int i = w->kept[j];
        row16 row = ray_grad ? geometry_slope(ray_grad[w->ray[i]], i, w)
                             : *(const row16 *)(w->geometry_grad + (size_t)i * RN_GEOMETRY);
        row[0] = w->slope[i] * w->x[i]; // density' = density
        *(row16 *)(w->geometry_grad + (size_t)j * RN_GEOMETRY) =
            row * ((float)CERTAIN / (float)w->chance[i]);
    }
    const struct rn_mlp_shape *shape = &field->base_shape;
    size_t hidden = hidden_stride(field->config->width);
    size_t features = features_a_row(field) * sizeof(feature) / sizeof(float);
    for (int j = 0; j < n; j++) {
        if (w->kept[j] == j) continue;
        copy_row((float *)feature_row(field, w, j), (float *)feature_row(field, w, w->kept[j]),
                 features);
        for (int l = 0; l + 1 < shape->layers; l++)
            copy_row(w->hidden[l] + j * hidden, w->hidden[l] + w->kept[j] * hidden, hidden);
    }
    return n;
}

// Counts the samples that enter the loss, by the larger level of any axis.
static void count_samples(const struct rn_cpu_field *field, bool leveled,
                          const struct rn_workspace *w, struct rn_group *group) {
    for (int i = 0; i < w->count; i += RN_VL) {
        unsigned some = vi_mask_bits(vf_load(w->weight + i) > 0.0f);
        if (w->count - i < RN_VL) some &= (1u << (w->count - i)) - 1;
        group->samples += (unsigned)__builtin_popcount(some);
        if (!leveled) {
            group->level_samples[0] += (unsigned)__builtin_popcount(some);
            continue;
        }
        vf most = vf_set(0);
        for (int p = 0; p < field->config->planes; p++)
            most = vf_max(most, vf_max(vf_load(w->lx[p] + i), vf_load(w->ly[p] + i)));
        vi level = vi_from_float(most);
        for (; some; some &= some - 1)
            group->level_samples[level[__builtin_ctz(some)]]++;
    }
    group->evaluated += (uint64_t)w->count;
}

// to[j] = from[at[j]]; writes up to a vector beyond, reads at[] as far.
RN_INLINE void gather(const float *from, const int32_t *at, int n, float *to) {
    for (int j = 0; j < n; j += RN_VL)
        vi_store((int32_t *)(to + j), vi_gather((const int32_t *)from, vi_load(at + j)));
}

RN_INLINE void append_voxels(const struct rn_cpu_field *field, int n, const float *feature_grad,
                             const struct rn_workspace *w, struct rn_slab *slab) {
    const float *from = feature_grad + field->config->planes * field->config->channels;
    float *grad = slab->voxel_grad + (size_t)slab->count * RN_VOXEL_CHANNELS;
    for (int k = 0; k < 3; k++)
        gather(w->voxel[k], w->kept, n, slab->voxel[k] + slab->count);
    for (int j = 0; j < n; j++)
        *(v4 *)(grad + (size_t)j * RN_VOXEL_CHANNELS) =
            *(const v4 *)(from + (size_t)j * (size_t)field->feature_stride);
}

// Appends the kept samples' plane coordinates and feature gradients.
static void slab_append(const struct rn_cpu_field *field, bool leveled, int n,
                        const float *feature_grad, const struct rn_workspace *w,
                        struct rn_slab *slab) {
    int channels = field->config->channels, stride = field->feature_stride, at = slab->count;
    bool levels = field->built_levels > 1 && field->config->footprint != RN_FOOTPRINT_POINT;
    for (int p = 0; p < field->config->planes; p++) {
        gather(w->u[p], w->kept, n, slab->u[p] + at);
        gather(w->v[p], w->kept, n, slab->v[p] + at);
        if (levels && leveled) {
            gather(w->lx[p], w->kept, n, slab->lx[p] + at);
            gather(w->ly[p], w->kept, n, slab->ly[p] + at);
        } else if (levels) {
            memset(slab->lx[p] + at, 0, (size_t)n * sizeof(float));
            memset(slab->ly[p] + at, 0, (size_t)n * sizeof(float));
        }
        float *grad = slab->grad[p] + (size_t)at * (size_t)channels;
        const float *from = feature_grad + p * channels;
        for (int j = 0; j < n; j++)
            memcpy(grad + (size_t)j * (size_t)channels, from + (size_t)j * (size_t)stride,
                   (size_t)channels * sizeof *grad);
    }
    if (field->config->voxels) append_voxels(field, n, feature_grad, w, slab);
    slab->count += n;
}

static void packet_backward(const struct rn_cpu_field *field,
                            const struct rn_march_options *options, const struct rn_march_ray *rays,
                            int ray_count, bool leveled, const row16 *ray_grad,
                            struct rn_workspace *w, struct rn_group *group) {
    distort_packet(field, options, rays, ray_count, w);
    for (int r = 0; r < ray_count; r++)
        composite_backward(r, w);
    if (group->seen) note_seen(field, rays, w, group->seen);
    int n = backward_select(field, options, rays, ray_grad, w);
    struct mlp base = base_network(field, w);
    const float *feature_grad = mlp_backward(&base, w->geometry_grad, n, w, group->base_grad);
    count_samples(field, leveled, w, group);
    slab_append(field, leveled, n, feature_grad, w, &group->slab);
    group->returned += (uint64_t)n;
}

// The samples of the next rays that have room together; returns how many rays, whole pixels.
static int next_packet(const struct rn_cpu_field *field, const struct rn_march_options *options,
                       const struct rn_march_ray *rays, struct rn_workspace *w,
                       struct rn_group *group, bool *ret_leveled) {
    int pixel = rn_pixel_rays(options), left = group->end - group->cursor;
    if (group->packet <= 0 || group->packet > RN_PACKET_RAYS) group->packet = RN_PACKET_RAYS;
    for (;;) {
        int n = group->packet / pixel * pixel;
        n = n > left ? left : n > pixel ? n : pixel;
        if (packet_density(field, options, rays + group->cursor, n, w, ret_leveled)) return n;
        group->packet = n / 2;
    }
}

static void train(const struct rn_cpu_field *field, const struct rn_march_options *options,
                  const struct rn_march_ray *rays, struct rn_workspace *w, struct rn_group *group) {
    bool per_ray = field->config->shading == RN_SHADING_RAY, leveled;
    int pixel = rn_pixel_rays(options), hits = 0, kept = 0;
    const struct rn_march_ray *packet = rays + group->cursor;
    int n = next_packet(field, options, rays, w, group, &leveled);
    group->cursor += n;
    if (w->count == 0) return;
    struct ray_sums sums[RN_PACKET_RAYS];
    float rgb[RN_PACKET_RAYS][3], ray_slope[RN_PACKET_RAYS][4] = {{0}};
    int16_t hit[RN_PACKET_RAYS];
    bool seen[RN_PACKET_RAYS];
    row16 ray_grad[RN_PACKET_RAYS]; // with ray shading
    if (per_ray) {
        hits = shade_rays(field, options, packet, n, w, sums, rgb, hit);
    } else {
        kept = keep_samples(0, w);
        shade_packet_by_samples(field, options, packet, n, kept, w, sums, rgb);
    }
    for (int r = 0; r < n; r++)
        seen[r] = w->ray_first[r] >= 0 && !(sums[r].opacity <= 0);
    for (int r = 0; r < n; r += pixel)
        rays_loss(options, packet + r, pixel, seen + r, sums + r, rgb + r, ray_slope + r, group);
    if (per_ray)
        backward_rays(field, options, packet, hits, hit, sums, ray_slope, w, group, ray_grad);
    else
        backward_samples(field, options, packet, kept, ray_slope, w, group);
    packet_backward(field, options, packet, n, leveled, per_ray ? ray_grad : NULL, w, group);
}

#endif
