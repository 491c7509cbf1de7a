// One kernel set: this file is compiled once for each, with RN_KERNEL_SET naming it.
#include "server/engine/cpu/backward.h"
#include "server/engine/cpu/kernels.h"
#include "server/engine/cpu/pyramid.h"
#include "server/engine/cpu/stage.h"

static uint64_t render(const struct rn_cpu_field *field, const struct rn_march_options *options,
                       const struct rn_march_ray *rays, int count, struct rn_workspace *w,
                       struct rn_pixel *ret_pixels) {
    uint64_t samples = 0;
    bool per_ray = field->config.shading == RN_SHADING_RAY;
    for (int begin = 0; begin < count;) {
        const struct rn_march_ray *packet = rays + begin;
        struct ray_sums sums[RN_PACKET_RAYS];
        float rgb[RN_PACKET_RAYS][3];
        int16_t hit[RN_PACKET_RAYS];
        int n = packet_march(field, options, packet, count - begin, w);
        packet_density(field, options, packet, n, w);
        if (per_ray)
            shade_rays(field, options, packet, n, w, sums, rgb, hit);
        else
            shade_packet_by_samples(field, options, packet, n, keep_samples(0, w), w, sums, rgb);
        for (int r = 0; r < n; r++) {
            struct rn_pixel pixel = {
                {options->background[0], options->background[1], options->background[2]}, 0, 0};
            if (w->ray_first[r] >= 0) {
                memcpy(pixel.rgb, rgb[r], sizeof pixel.rgb);
                pixel.alpha = sums[r].opacity < 1 ? sums[r].opacity : 1;
                pixel.depth = sums[r].opacity > 0 ? sums[r].depth / sums[r].opacity : 0;
            }
            ret_pixels[begin + r] = pixel;
        }
        samples += (uint64_t)w->count;
        begin += n;
    }
    return samples;
}

static void density(const struct rn_cpu_field *field, float (*points)[3], int count, float level,
                    struct rn_workspace *w, float *ret_density) {
    int levels =
        field->built_levels < field->config.levels ? field->built_levels : field->config.levels;
    bool leveled = level > 0 && levels > 1 && field->config.footprint != RN_FOOTPRINT_POINT;
    struct mlp base = base_network(field, w);
    if (level > (float)(levels - 1)) level = (float)(levels - 1);
    for (int begin = 0; begin < count; begin += w->capacity) {
        int n = count - begin < w->capacity ? count - begin : w->capacity;
        for (int i = 0; i < n; i++) {
            const float *x = points[begin + i];
            for (int p = 0; p < field->config.planes; p++) {
                const double *au = field->solid.axis_u[p], *av = field->solid.axis_v[p];
                w->u[p][i] = (float)au[0] * x[0] + (float)au[1] * x[1] + (float)au[2] * x[2];
                w->v[p][i] = (float)av[0] * x[0] + (float)av[1] * x[1] + (float)av[2] * x[2];
                w->lx[p][i] = w->ly[p][i] = level;
            }
            float inside = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
            w->interval[i] = inside <= 1 ? 1 : 0;
        }
        encode(field, leveled, 0, n, w);
        mlp_forward(&base, 0, n);
        activate(field, 0, n, w);
        memcpy(ret_density + begin, w->x, (size_t)n * sizeof(float));
    }
}

#define RN_SCATTER(NAME, TYPE, CHANNELS)                                                           \
    static void scatter_flat_##NAME(const struct rn_slab *slab, int plane, int row_begin,          \
                                    int row_end, struct rn_map *map, uint8_t *touched) {           \
        const float *u = slab->u[plane], *v = slab->v[plane];                                      \
        size_t row = (size_t)map->width * CHANNELS, blocks = (size_t)map->width / RN_BLOCK + 1;    \
        for (int i = 0; i < slab->count; i += RN_VL) {                                             \
            vi column, line;                                                                       \
            vf fx, fy;                                                                             \
            lerp_vector(vf_load(v + i), map->height, &line, &fy);                                  \
            unsigned bits = vi_mask_bits((line >= row_begin - 1) & (line < row_end));              \
            if (slab->count - i < RN_VL) bits &= (1u << (slab->count - i)) - 1;                    \
            if (!bits) continue;                                                                   \
            lerp_vector(vf_load(u + i), map->width, &column, &fx);                                 \
            for (; bits; bits &= bits - 1) {                                                       \
                int j = __builtin_ctz(bits);                                                       \
                bool upper = line[j] >= row_begin, lower = line[j] + 1 < row_end;                  \
                uint8_t *mark = touched + (size_t)line[j] * blocks;                                \
                int first = column[j] / RN_BLOCK, last = (column[j] + 1) / RN_BLOCK;               \
                if (upper) mark[first] = mark[last] = 1;                                           \
                if (lower) mark[blocks + first] = mark[blocks + last] = 1;                         \
                TYPE g = *(const TYPE *)(slab->grad[plane] + (size_t)(i + j) * CHANNELS);          \
                spread_##NAME(map->texels + ((size_t)line[j] * map->width + column[j]) * CHANNELS, \
                              row, fx[j], fy[j], 1, upper, lower, g);                              \
            }                                                                                      \
        }                                                                                          \
    }                                                                                              \
    static void scatter_leveled_##NAME(const struct rn_slab *slab, int plane, bool mip,            \
                                       int row_begin, int row_end,                                 \
                                       struct rn_map(*maps)[RN_MAX_LEVELS]) {                      \
        struct axis_lookup x, y;                                                                   \
        int base = maps[0][0].width;                                                               \
        for (int i = 0; i < slab->count; i += RN_VL) {                                             \
            look_up_axis(vf_load(slab->u[plane] + i), vf_load(slab->lx[plane] + i), base, &x);     \
            look_up_axis(vf_load(slab->v[plane] + i), vf_load(slab->ly[plane] + i), base, &y);     \
            int n = slab->count - i < RN_VL ? slab->count - i : RN_VL;                             \
            for (int j = 0; j < n; j++) {                                                          \
                TYPE g = *(const TYPE *)(slab->grad[plane] + (size_t)(i + j) * CHANNELS);          \
                for (int c = 0; c < 4; c++) {                                                      \
                    float weight = corner_weight(&x, &y, mip, j, c);                               \
                    if (!(weight > 0)) continue;                                                   \
                    int up_x = c & 1, up_y = c >> 1, level = y.level[j] + up_y;                    \
                    int line = y.low[up_y][j], begin = row_begin >> level, end = row_end >> level; \
                    struct rn_map *map = &maps[level][x.level[j] + up_x];                          \
                    if (row_end == base) end = map->height;                                        \
                    bool upper = line >= begin && line < end;                                      \
                    bool lower = map->height > 1 && line + 1 >= begin && line + 1 < end;           \
                    size_t row = (size_t)map->width * CHANNELS;                                    \
                    float *texel = map->texels + line * row + (size_t)x.low[up_x][j] * CHANNELS;   \
                    spread_##NAME(texel, row, x.fraction[up_x][j], y.fraction[up_y][j], weight,    \
                                  upper, lower, g);                                                \
                }                                                                                  \
            }                                                                                      \
        }                                                                                          \
    }

RN_SCATTER(4, v4, 4)
RN_SCATTER(8, v8, 8)
RN_SCATTER(16, v16, 16)

static void scatter(const struct rn_cpu_field *field, const struct rn_slab *slab, int plane,
                    bool leveled, int row_begin, int row_end,
                    struct rn_map (*grad_maps)[RN_MAX_LEVELS], uint8_t *touched) {
    bool mip = field->config.footprint == RN_FOOTPRINT_MIP;
#define RN_SCATTER_CALL(C)                                                                         \
    if (leveled)                                                                                   \
        scatter_leveled_##C(slab, plane, mip, row_begin, row_end, grad_maps);                      \
    else                                                                                           \
        scatter_flat_##C(slab, plane, row_begin, row_end, &grad_maps[0][0], touched)
    if (field->config.channels == 4) {
        RN_SCATTER_CALL(4);
    } else if (field->config.channels == 8) {
        RN_SCATTER_CALL(8);
    } else {
        RN_SCATTER_CALL(16);
    }
}

// Gradients beyond 1.8e19, whose squares fp32 does not hold, count as 1.8e19; NaN stays NaN. The
// decay is part of the change: 1 - rate * decay, in fp32, would be 1 for the networks. Error of the
// change, beyond the parameter's own rounding: 8 ULP, for gradients of 1e-30 to 1e30.
// Returns a mask of the new parameters that are not finite.
RN_INLINE vi adamw_vector(const struct rn_adamw *o, float *parameter, float *grad, float *m,
                          float *v) {
    float rate = o->rate / o->correction1, fade = o->rate * o->decay;
    float root = 1 / __builtin_sqrtf(o->correction2);
    vf g = vf_min(vf_set(1.8e19f), vf_max(vf_set(-1.8e19f), vf_load(grad) * o->scale));
    vf first = vf_load(m) * 0.9f + g * 0.1f, second = vf_load(v) * o->keep + g * g * o->fresh;
    vf_store(m, first);
    vf_store(v, second);
    vf p = vf_load(parameter), change = p * fade + rate * first / (vf_sqrt(second) * root + o->eps);
    p = p - change;
    vf_store(parameter, p);
    vf_store(grad, vf_set(0));
    return (vi_bits(p) & 0x7f800000) == 0x7f800000;
}

static bool adamw(const struct rn_adamw *o, size_t n, float *parameter, float *grad, float *m,
                  float *v) {
    size_t i = 0;
    vi wild = vi_set(0);
    for (; i + RN_VL <= n; i += RN_VL)
        wild |= adamw_vector(o, parameter + i, grad + i, m + i, v + i);
    if (i == n) return !vi_mask_bits(wild);
    float tail[4][RN_VL] = {{0}}, *all[4] = {parameter + i, grad + i, m + i, v + i};
    for (int k = 0; k < 4; k++)
        memcpy(tail[k], all[k], (n - i) * sizeof(float));
    wild |= adamw_vector(o, tail[0], tail[1], tail[2], tail[3]);
    for (int k = 0; k < 4; k++)
        memcpy(all[k], tail[k], (n - i) * sizeof(float));
    return !vi_mask_bits(wild);
}

#define RN_MAP_FUNCTION(NAME, CALL)                                                                \
    static void NAME(size_t n, const float *x, float *y) {                                         \
        for (size_t i = 0; i < n; i += RN_VL)                                                      \
            vf_store(y + i, CALL(vf_load(x + i)));                                                 \
    }
RN_MAP_FUNCTION(exp_public, vf_exp)
RN_MAP_FUNCTION(one_minus_exp_public, vf_one_minus_exp)
RN_MAP_FUNCTION(log2_public, vf_log2)

static void moments_public(size_t n, const float *t, float width, float radius, float *shift,
                           float *axial, float *radial) {
    for (size_t i = 0; i < n; i += RN_VL) {
        vf s, a, r;
        frustum_moments(vf_load(t + i), 0.5f * width, radius, &s, &a, &r);
        vf_store(shift + i, s);
        vf_store(axial + i, a);
        vf_store(radial + i, r);
    }
}

#define RN_PASTE2(a, b) a##b
#define RN_PASTE(a, b) RN_PASTE2(a, b)
#define RN_STRING2(a) #a
#define RN_STRING(a) RN_STRING2(a)

extern const struct rn_kernels RN_PASTE(rn_kernels_, RN_KERNEL_SET);
const struct rn_kernels RN_PASTE(rn_kernels_, RN_KERNEL_SET) = {
    .name = RN_STRING(RN_KERNEL_SET),
    .unit = PRODUCT_UNIT,
    .train = train,
    .render = render,
    .density = density,
    .pack = mlp_pack,
    .scatter = scatter,
    .build = build_plane,
    .pull_down = pull_down_plane,
    .adamw = adamw,
    .stage = stage,
    .gemm = gemm_public,
    .exp = exp_public,
    .one_minus_exp = one_minus_exp_public,
    .log2 = log2_public,
    .moments = moments_public,
};
