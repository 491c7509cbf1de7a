// Samples to features: positions, footprints, and the ripmap fetch (paper, section 3.3).
#ifndef RN_ENGINE_CPU_ENCODE_H
#define RN_ENGINE_CPU_ENCODE_H

#include <stdbool.h>

#include "server/engine/cpu/kernels.h"
#include "server/engine/cpu/simd.h"
#include "server/engine/field/footprint.h"
#include "server/engine/field/volume.h"

typedef float v4 __attribute__((vector_size(16), aligned(4), may_alias));
typedef float v8 __attribute__((vector_size(32), aligned(4), may_alias));
typedef float v16 __attribute__((vector_size(64), aligned(4), may_alias));

// Frustum moments (field/frustum.h) in fp32: mean - t, axial and radial variance.
RN_INLINE void frustum_moments(vf t, float half, float radius, vf *ret_shift, vf *ret_axial,
                               vf *ret_radial) {
    vf ratio = vf_set(half) / vf_max(t, vf_set(1e-30f)), q = ratio * ratio;
    vf s = 1.0f / (q + 3.0f), hs = half * s, rt = radius * t;
    *ret_shift = t * (2.0f * q * s);
    *ret_axial = (0.6f * hs) * hs * (q * (q - 2.0f) + 5.0f);
    *ret_radial = rt * rt * (0.15f * s) * (q * (q + 10.0f) + 5.0f);
}

// The part of the projected variances that is the same along a ray: (x.d)^2 and |x cross d|^2.
struct ray_footprint {
    float axial_u[RN_MAX_PLANES], radial_u[RN_MAX_PLANES];
    float axial_v[RN_MAX_PLANES], radial_v[RN_MAX_PLANES];
    bool leveled; // some sample of the ray may lie above level 0
};

static void footprint_factors(const double axis[3], const float d[3], float *ret_axial,
                              float *ret_radial) {
    double direction[3] = {d[0], d[1], d[2]};
    *ret_axial = (float)rn_projected_variance(axis, direction, 1, 0);
    *ret_radial = (float)rn_projected_variance(axis, direction, 0, 1);
}

// Whether the footprint at the ray's far end exceeds a texel of level 0 anywhere.
static void ray_footprint_init(const struct rn_cpu_field *field, const struct rn_march_ray *ray,
                               float step, struct ray_footprint *ret) {
    int levels =
        field->built_levels < field->config.levels ? field->built_levels : field->config.levels;
    ret->leveled = false;
    if (levels < 2 || field->config.footprint == RN_FOOTPRINT_POINT) return;
    float far = ray->near + ray->length, size = (float)rn_footprint_base(&field->config);
    if (field->config.footprint == RN_FOOTPRINT_MIP) {
        ret->leveled = far * ray->radius * size > 1;
        return;
    }
    float radial = far * ray->radius, limit = 1 / ((float)RN_FOOTPRINT_SCALE * size);
    radial = radial * radial * 0.26f + step * step * 0.05f; // a bound on 3/20 .. 1/4 of r^2 t^2
    float axial = step * step / 12 * 1.01f;
    for (int p = 0; p < field->config.planes; p++) {
        footprint_factors(field->solid.axis_u[p], ray->direction, &ret->axial_u[p],
                          &ret->radial_u[p]);
        footprint_factors(field->solid.axis_v[p], ray->direction, &ret->axial_v[p],
                          &ret->radial_v[p]);
        float u = ret->axial_u[p] * axial + ret->radial_u[p] * radial;
        float v = ret->axial_v[p] * axial + ret->radial_v[p] * radial;
        if (u > limit * limit || v > limit * limit) ret->leveled = true;
    }
}

RN_INLINE vf level_from_variance(vf variance, int size, int levels) {
    float unit = (float)RN_FOOTPRINT_SCALE * (float)size, top = (float)(1u << (2 * (levels - 1)));
    return 0.5f * vf_log2(vf_clamp(variance * (unit * unit), 1.0f, top));
}

// Positions, plane coordinates and levels of one segment: `n` samples of `ray` at march indices
// k[0..n), written to sample slots [slot, slot + n) (and up to a vector beyond).
static void place_segment(const struct rn_cpu_field *field, const struct rn_march_options *options,
                          const struct rn_march_ray *ray, const struct ray_footprint *footprint,
                          bool leveled, const uint16_t *k, int n, int slot,
                          struct rn_workspace *w) {
    int levels = field->built_levels, base = rn_footprint_base(&field->config);
    if (levels > field->config.levels) levels = field->config.levels;
    float step = options->step * (float)ray->stride, half = step * 0.5f;
    for (int j = 0; j < n; j += RN_VL) {
        vf index;
        for (int i = 0; i < RN_VL; i++)
            index[i] = (float)k[j + i];
        vf s = (index + 0.5f) * step, t = s + ray->near;
        vf shift, axial, radial;
        frustum_moments(t, half, ray->radius, &shift, &axial, &radial);
        vf m = s + shift;
        vf x = ray->direction[0] * m + ray->origin[0], y = ray->direction[1] * m + ray->origin[1];
        vf z = ray->direction[2] * m + ray->origin[2];
        vi inside = x * x + y * y + z * z <= 1.0f;
        int at = slot + j;
        vf_store(w->s + at, s);
        vf_store(w->interval + at,
                 vf_bits(inside & vi_bits(vf_set(step * (float)RN_DENSITY_UNIT))));
        vf ball = vf_set(0);
        if (leveled && field->config.footprint == RN_FOOTPRINT_MIP)
            ball = vf_log2(
                vf_clamp(t * (ray->radius * (float)base), 1.0f, (float)(1u << (levels - 1))));
        for (int p = 0; p < field->config.planes; p++) {
            const double *au = field->solid.axis_u[p], *av = field->solid.axis_v[p];
            vf_store(w->u[p] + at, (float)au[0] * x + (float)au[1] * y + (float)au[2] * z);
            vf_store(w->v[p] + at, (float)av[0] * x + (float)av[1] * y + (float)av[2] * z);
            if (!leveled) continue;
            vf lx = ball, ly = ball;
            if (field->config.footprint == RN_FOOTPRINT_RIP) {
                lx = level_from_variance(
                    axial * footprint->axial_u[p] + radial * footprint->radial_u[p], base, levels);
                ly = level_from_variance(
                    axial * footprint->axial_v[p] + radial * footprint->radial_v[p], base, levels);
            }
            vf_store(w->lx[p] + at, lx);
            vf_store(w->ly[p] + at, ly);
        }
    }
}

// Texel coordinate of p in [-1, 1] on `size` texels: *ret_low and the weight of low + 1.
RN_INLINE void lerp_vector(vf p, int size, vi *ret_low, vf *ret_fraction) {
    float half = 0.5f * (float)size;
    vf x = vf_clamp(p * half + (half - 0.5f), 0.0f, (float)(size - 1));
    vf low = vf_from_int(vi_from_float(x));
    low = vf_min(low, vf_set((float)(size > 1 ? size - 2 : 0)));
    *ret_low = vi_from_float(low);
    *ret_fraction = x - low;
}

// Where RN_VL samples look on one axis of a pyramid: level, weight of the next level, and at both
// levels the texel and the weight of its neighbour.
struct axis_lookup {
    int32_t level[RN_VL], low[2][RN_VL];
    float upper[RN_VL], fraction[2][RN_VL];
};

RN_INLINE void look_up_axis(vf p, vf level, int base, struct axis_lookup *ret) {
    vi whole = vi_from_float(level);
    vi_store(ret->level, whole);
    vf_store(ret->upper, level - vf_from_int(whole));
    for (int i = 0; i < 2; i++) {
        vi size = base >> (whole + i);
        vf texels = vf_max(vf_from_int(size), vf_set(1)), half = 0.5f * texels;
        vf x = vf_min(vf_max(p * half + (half - 0.5f), vf_set(0)), texels - 1.0f);
        vf low = vf_min(vf_from_int(vi_from_float(x)), vf_max(texels - 2.0f, vf_set(0)));
        vi_store(ret->low[i], vi_from_float(low));
        vf_store(ret->fraction[i], x - low);
    }
}

// The maps of a query: bit 0 of a corner steps up along x, bit 1 along y. Returns the weight of
// corner c of lane j; 0 for corners that do not take part.
RN_INLINE float corner_weight(const struct axis_lookup *x, const struct axis_lookup *y, bool mip,
                              int j, int c) {
    float wx = c & 1 ? x->upper[j] : 1 - x->upper[j], wy = c & 2 ? y->upper[j] : 1 - y->upper[j];
    if (!mip) return wx * wy;
    return c == 0 || c == 3 ? wx : 0;
}

// A vector of CHANNELS numbers; the compiler splits it where the machine's are narrower.
#define RN_FETCH(NAME, TYPE, CHANNELS)                                                             \
    RN_INLINE TYPE fetch_##NAME(const float *texel, size_t row, float fx, float fy) {              \
        TYPE a = *(const TYPE *)texel, b = *(const TYPE *)(texel + CHANNELS);                      \
        TYPE c = *(const TYPE *)(texel + row), d = *(const TYPE *)(texel + row + CHANNELS);        \
        TYPE top = a + fx * (b - a), bottom = c + fx * (d - c);                                    \
        return top + fy * (bottom - top);                                                          \
    }                                                                                              \
    RN_INLINE void spread_##NAME(float *texel, size_t row, float fx, float fy, float weight,       \
                                 bool upper, bool lower, TYPE g) {                                 \
        TYPE low = g * (weight * (1 - fy)), high = g * (weight * fy);                              \
        if (upper) {                                                                               \
            *(TYPE *)texel += low * (1 - fx);                                                      \
            *(TYPE *)(texel + CHANNELS) += low * fx;                                               \
        }                                                                                          \
        if (lower) {                                                                               \
            *(TYPE *)(texel + row) += high * (1 - fx);                                             \
            *(TYPE *)(texel + row + CHANNELS) += high * fx;                                        \
        }                                                                                          \
    }                                                                                              \
    static void encode_flat_##NAME(const struct rn_map *map, const float *u, const float *v,       \
                                   int begin, int end, float *out, int stride) {                   \
        size_t row = (size_t)map->width * CHANNELS;                                                \
        for (int i = begin; i < end; i += RN_VL) {                                                 \
            vi column, line;                                                                       \
            vf fx, fy;                                                                             \
            lerp_vector(vf_load(u + i), map->width, &column, &fx);                                 \
            lerp_vector(vf_load(v + i), map->height, &line, &fy);                                  \
            vi offset = (line * map->width + column) * CHANNELS;                                   \
            int n = end - i < RN_VL ? end - i : RN_VL;                                             \
            for (int j = 0; j < n; j++)                                                            \
                *(TYPE *)(out + (size_t)(i + j) * stride) =                                        \
                    fetch_##NAME(map->texels + offset[j], row, fx[j], fy[j]);                      \
        }                                                                                          \
    }                                                                                              \
    static void encode_leveled_##NAME(                                                             \
        const struct rn_map(*maps)[RN_MAX_LEVELS], bool mip, const float *u, const float *v,       \
        const float *lx, const float *ly, int begin, int end, float *out, int stride) {            \
        struct axis_lookup x, y;                                                                   \
        int base = maps[0][0].width;                                                               \
        for (int i = begin; i < end; i += RN_VL) {                                                 \
            look_up_axis(vf_load(u + i), vf_load(lx + i), base, &x);                               \
            look_up_axis(vf_load(v + i), vf_load(ly + i), base, &y);                               \
            int n = end - i < RN_VL ? end - i : RN_VL;                                             \
            for (int j = 0; j < n; j++) {                                                          \
                TYPE value = {0};                                                                  \
                for (int c = 0; c < 4; c++) {                                                      \
                    float weight = corner_weight(&x, &y, mip, j, c);                               \
                    if (!(weight > 0)) continue;                                                   \
                    int up_x = c & 1, up_y = c >> 1;                                               \
                    const struct rn_map *map = &maps[y.level[j] + up_y][x.level[j] + up_x];        \
                    size_t row = (size_t)map->width * CHANNELS;                                    \
                    const float *texel =                                                           \
                        map->texels + y.low[up_y][j] * row + (size_t)x.low[up_x][j] * CHANNELS;    \
                    value += weight * fetch_##NAME(texel, map->height > 1 ? row : 0,               \
                                                   x.fraction[up_x][j], y.fraction[up_y][j]);      \
                }                                                                                  \
                *(TYPE *)(out + (size_t)(i + j) * stride) = value;                                 \
            }                                                                                      \
        }                                                                                          \
    }

RN_FETCH(4, v4, 4)
RN_FETCH(8, v8, 8)
RN_FETCH(16, v16, 16)

// Features of samples [begin, end) of the workspace.
static void encode(const struct rn_cpu_field *field, bool leveled, int begin, int end,
                   struct rn_workspace *w) {
    int channels = field->config.channels, stride = field->feature_stride;
    bool mip = field->config.footprint == RN_FOOTPRINT_MIP;
    for (int p = 0; p < field->config.planes; p++) {
        float *out = w->features + p * channels;
        const struct rn_map(*maps)[RN_MAX_LEVELS] = field->maps[p];
#define RN_ENCODE(C)                                                                               \
    if (leveled)                                                                                   \
        encode_leveled_##C(maps, mip, w->u[p], w->v[p], w->lx[p], w->ly[p], begin, end, out,       \
                           stride);                                                                \
    else                                                                                           \
        encode_flat_##C(&maps[0][0], w->u[p], w->v[p], begin, end, out, stride)
        if (channels == 4) {
            RN_ENCODE(4);
        } else if (channels == 8) {
            RN_ENCODE(8);
        } else {
            RN_ENCODE(16);
        }
#undef RN_ENCODE
    }
}

#endif
