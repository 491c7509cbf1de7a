// Samples to features in registers: positions, footprints, and the ripmap fetch from fp16 pyramids
// (cpu/encode.h has the same mathematics by vectors; paper, section 3.3).
#ifndef RN_ENGINE_CUDA_ENCODE_CUH
#define RN_ENGINE_CUDA_ENCODE_CUH

#include "server/engine/cuda/scene.cuh"
#include "server/engine/field/footprint.h"
#include "server/engine/field/volume.h"

// ---- samples --------------------------------------------------------------------------------

// The part of the projected variances that is the same along a ray, on one plane: (x.d)^2 and
// |x cross d|^2 of both axes. Level 0 throughout where not `leveled`.
struct rn_footprint_factors {
    float axial_u, radial_u, axial_v, radial_v;
};

RN_DEVICE struct rn_footprint_factors rn_factors(const float axis[6], const float direction[3]) {
    double u[3], v[3], d[3];
    for (int i = 0; i < 3; i++) {
        u[i] = (double)axis[i];
        v[i] = (double)axis[3 + i];
        d[i] = (double)direction[i];
    }
    struct rn_footprint_factors f = {(float)rn_projected_variance(u, d, 1, 0),
                                     (float)rn_projected_variance(u, d, 0, 1),
                                     (float)rn_projected_variance(v, d, 1, 0),
                                     (float)rn_projected_variance(v, d, 0, 1)};
    return f;
}

// Whether a footprint at the ray's far end exceeds a texel of level 0 on this plane.
RN_DEVICE bool rn_ray_leveled(const struct rn_cuda_planes *p, const struct rn_march_ray *ray,
                              const struct rn_footprint_factors *f, float step) {
    float far = ray->near + ray->length, size = (float)p->footprint_base;
    if (p->levels < 2) return false;
    if (p->footprint == RN_FOOTPRINT_MIP) return far * ray->radius * size > 1;
    float radial = far * ray->radius, limit = 1 / ((float)RN_FOOTPRINT_SCALE * size);
    radial = radial * radial * 0.26f + step * step * 0.05f; // a bound on 3/20 .. 1/4 of r^2 t^2
    float axial = step * step / 12 * 1.01f;
    return f->axial_u * axial + f->radial_u * radial > limit * limit ||
           f->axial_v * axial + f->radial_v * radial > limit * limit;
}

// A sample: mean of its Gaussian, variances along and across the ray (field/frustum.h, in fp32).
struct rn_sample {
    float x, y, z, t, axial, radial;
};

RN_DEVICE struct rn_sample rn_place(const struct rn_march_ray *ray, float s, float step) {
    struct rn_sample out;
    float t = s + ray->near, half = 0.5f * step, ratio = half / fmaxf(t, 1e-30f);
    float q = ratio * ratio, w = 1 / (q + 3), hw = half * w, rt = ray->radius * t;
    float mean = s + t * (2 * q * w);
    out.axial = (0.6f * hw) * hw * (q * (q - 2) + 5);
    out.radial = rt * rt * (0.15f * w) * (q * (q + 10) + 5);
    out.x = ray->direction[0] * mean + ray->origin[0];
    out.y = ray->direction[1] * mean + ray->origin[1];
    out.z = ray->direction[2] * mean + ray->origin[2];
    out.t = t;
    return out;
}

RN_DEVICE float rn_level(const struct rn_cuda_planes *p, float variance) {
    float unit = (float)RN_FOOTPRINT_SCALE * (float)p->footprint_base;
    float top = (float)(1u << (2 * (p->levels - 1)));
    return 0.5f * log2f(fminf(fmaxf(variance * (unit * unit), 1), top));
}

// Levels of a sample on the axes of a plane.
RN_DEVICE void rn_levels(const struct rn_cuda_planes *p, const struct rn_footprint_factors *f,
                         const struct rn_sample *sample, float radius, float *ret_lx,
                         float *ret_ly) {
    if (p->footprint == RN_FOOTPRINT_MIP) {
        float ball = sample->t * (radius * (float)p->footprint_base);
        float top = (float)(1u << (p->levels - 1));
        *ret_lx = *ret_ly = log2f(fminf(fmaxf(ball, 1), top));
        return;
    }
    *ret_lx = rn_level(p, sample->axial * f->axial_u + sample->radial * f->radial_u);
    *ret_ly = rn_level(p, sample->axial * f->axial_v + sample->radial * f->radial_v);
}

// ---- maps -----------------------------------------------------------------------------------

// Where a query looks on one axis: level, weight of the next level, and at both levels the texel
// and the weight of its neighbour.
struct rn_axis_lookup {
    int level, low[2];
    float upper, fraction[2];
};

RN_DEVICE struct rn_axis_lookup rn_look_up(float p, float level, int base) {
    struct rn_axis_lookup a;
    a.level = (int)level;
    a.upper = level - (float)a.level;
    for (int i = 0; i < 2; i++) {
        float size = (float)(base >> (a.level + i)), half = 0.5f * size;
        float x = fminf(fmaxf(p * half + (half - 0.5f), 0), size - 1);
        float low = fminf((float)(int)x, fmaxf(size - 2, 0));
        a.low[i] = (int)low;
        a.fraction[i] = x - low;
    }
    return a;
}

// The maps of a query: bit 0 of a corner steps up along x, bit 1 along y. Their weight; 0 for
// corners that take no part.
RN_DEVICE float rn_corner_weight(const struct rn_axis_lookup *x, const struct rn_axis_lookup *y,
                                 int footprint, int corner) {
    float wx = corner & 1 ? x->upper : 1 - x->upper, wy = corner & 2 ? y->upper : 1 - y->upper;
    if (footprint != RN_FOOTPRINT_MIP) return wx * wy;
    return corner == 0 || corner == 3 ? wx : 0;
}

// Both axes of a sample on a plane.
struct rn_query {
    struct rn_axis_lookup x, y;
};
RN_DEVICE struct rn_query rn_query_plane(const struct rn_cuda_planes *p, int plane,
                                         const struct rn_sample *s, float lx, float ly) {
    const float *a = p->axis[plane];
    struct rn_query q;
    q.x = rn_look_up(a[0] * s->x + a[1] * s->y + a[2] * s->z, lx, p->base);
    q.y = rn_look_up(a[3] * s->x + a[4] * s->y + a[5] * s->z, ly, p->base);
    return q;
}

// Texel 0 of a corner's map and the map's width.
RN_DEVICE uint32_t rn_corner_map(const struct rn_cuda_planes *p, int plane,
                                 const struct rn_query *q, int corner, int *ret_width) {
    int lx = q->x.level + (corner & 1), ly = q->y.level + (corner >> 1);
    *ret_width = p->base >> lx;
    return (uint32_t)plane * p->plane_texels + p->map[ly][lx];
}

// Adds weight times four channels of a texel.
RN_DEVICE void rn_add_texel(const uint16_t *texels, size_t at, float weight, float sum[4]) {
    if (!(weight > 0)) return;
    uint2 v = *(const uint2 *)(texels + at);
    sum[0] += weight * rn_low(v.x);
    sum[1] += weight * rn_high(v.x);
    sum[2] += weight * rn_low(v.y);
    sum[3] += weight * rn_high(v.y);
}

// Four channels, `channel` on, of a query.
RN_DEVICE void rn_fetch(const struct rn_cuda_planes *p, const uint16_t *texels, int plane,
                        int channel, const struct rn_query *q, float sum[4]) {
    for (int corner = 0; corner < 4; corner++) {
        float weight = rn_corner_weight(&q->x, &q->y, p->footprint, corner);
        if (!(weight > 0)) continue;
        int width, i = corner & 1, j = corner >> 1;
        uint32_t map = rn_corner_map(p, plane, q, corner, &width);
        float fx = q->x.fraction[i], fy = q->y.fraction[j];
        size_t c = (size_t)p->channels;
        size_t at = (map + (uint32_t)(q->y.low[j] * width + q->x.low[i])) * c + (size_t)channel;
        size_t row = (size_t)width * c;
        rn_add_texel(texels, at, weight * (1 - fy) * (1 - fx), sum);
        rn_add_texel(texels, at + c, weight * (1 - fy) * fx, sum);
        rn_add_texel(texels, at + row, weight * fy * (1 - fx), sum);
        rn_add_texel(texels, at + row + c, weight * fy * fx, sum);
    }
}

// ---- a tile ---------------------------------------------------------------------------------

// A ray as a warp encodes its samples: lane p holds the factors of plane p.
struct rn_encoder {
    struct rn_footprint_factors factors;
    bool leveled;
    float step; // of one sample
};

RN_DEVICE struct rn_encoder rn_encoder_start(const struct rn_cuda_planes *p,
                                             const struct rn_march_ray *ray, float step) {
    struct rn_encoder e;
    e.step = step * (float)ray->stride;
    int plane = RN_LANE < p->planes ? RN_LANE : 0;
    e.factors = rn_factors(p->axis[plane], ray->direction);
    e.leveled = rn_ballot(rn_ray_leveled(p, ray, &e.factors, e.step)) != 0;
    return e;
}

RN_DEVICE struct rn_footprint_factors rn_factors_of(const struct rn_encoder *e, int plane) {
    struct rn_footprint_factors f;
    f.axial_u = rn_shuffle(e->factors.axial_u, plane);
    f.radial_u = rn_shuffle(e->factors.radial_u, plane);
    f.axial_v = rn_shuffle(e->factors.axial_v, plane);
    f.radial_v = rn_shuffle(e->factors.radial_v, plane);
    return f;
}

// Features of the warp's two samples of rows g and g + 8 as A fragments; `fixed_level` >= 0
// replaces the footprint's. *ret_top[i]: the largest level of sample i on any axis.
template <int KT>
RN_DEVICE void rn_encode(const struct rn_cuda_planes *p, const uint16_t *texels,
                         const struct rn_encoder *e, float radius, const struct rn_sample (&s)[2],
                         float fixed_level, uint32_t (&a)[KT][4], float (&ret_top)[2]) {
    ret_top[0] = ret_top[1] = 0;
    RN_UNROLL
    for (int k = 0; k < KT; k++) {
        int feature = 16 * k + 4 * (RN_LANE % 4), plane = feature / p->channels;
        bool present = plane < p->planes;
        if (!present) plane = 0;
        struct rn_footprint_factors f = rn_factors_of(e, plane);
        RN_UNROLL
        for (int i = 0; i < 2; i++) {
            float lx = fmaxf(fixed_level, 0), ly = lx, sum[4] = {0, 0, 0, 0};
            if (fixed_level < 0 && e->leveled) rn_levels(p, &f, &s[i], radius, &lx, &ly);
            if (present) {
                struct rn_query q = rn_query_plane(p, plane, &s[i], lx, ly);
                rn_fetch(p, texels, plane, feature % p->channels, &q, sum);
                ret_top[i] = fmaxf(ret_top[i], fmaxf(lx, ly));
            }
            a[k][i] = rn_pack(sum[0], sum[1]);
            a[k][2 + i] = rn_pack(sum[2], sum[3]);
        }
    }
}

#endif
