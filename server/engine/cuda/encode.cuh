// Samples to features in registers: positions, footprints, and the ripmap fetch from fp16 pyramids
// (cpu/encode.h has the same mathematics by vectors; paper, section 3.3).
#ifndef RN_ENGINE_CUDA_ENCODE_CUH
#define RN_ENGINE_CUDA_ENCODE_CUH

#include "server/engine/cuda/space.cuh"
#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/field/ripmap.h"
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
    struct rn_footprint_factors f;
    rn_variance_factors(u, d, &f.axial_u, &f.radial_u);
    rn_variance_factors(v, d, &f.axial_v, &f.radial_v);
    return f;
}

// The cone's radius at its widest along a ray: at an end.
template <int WORLD>
RN_DEVICE float rn_widest(const struct rn_march_ray *ray, const struct rn_forward_line *line) {
    float distance, begin, end;
    if (WORLD != RN_WORLD_FORWARD) return (ray->near + ray->length) * ray->radius;
    rn_forward_lane(line, 0, &distance, &begin);
    rn_forward_lane(line, ray->length, &distance, &end);
    return fmaxf(begin, end);
}

// Whether a footprint along the ray exceeds a texel of level 0 on this plane.
template <int WORLD>
RN_DEVICE bool rn_ray_leveled(const struct rn_cuda_planes *p, const struct rn_march_ray *ray,
                              const struct rn_forward_line *line,
                              const struct rn_footprint_factors *f, float step) {
    float size = (float)p->footprint_base;
    if (p->levels < 2) return false;
    if (WORLD == RN_WORLD_UNBOUNDED)
        return rn_contracted_leveled(ray->origin, ray->near, ray->radius, step, p->footprint_base,
                                     p->by_axis);
    float far = rn_widest<WORLD>(ray, line);
    if (!p->by_axis) return far * size > 1;
    float axial, radial, limit = 1 / ((float)RN_FOOTPRINT_SCALE * size);
    rn_variance_bounds(far, step, &axial, &radial);
    return f->axial_u * axial + f->radial_u * radial > limit * limit ||
           f->axial_v * axial + f->radial_v * radial > limit * limit;
}

RN_FRUSTUM_FUNCTION(rn_frustum_lane, float, float)

// A sample: mean of its Gaussian, distance from the camera, variances along and across the ray; in
// unbounded space the mean is contracted, the variances are not.
struct rn_sample {
    float x, y, z, t, axial, radial;
    float wide; // forward: the cone's radius in the cube
};

// In unbounded space: a cylinder as long as its step is there.
RN_DEVICE struct rn_sample rn_place_unbounded(const struct rn_march_ray *ray, float s, float step) {
    struct rn_sample out;
    float scale = rn_lengths_at(ray, s).scale, width = fmaxf(s * s, 1) * (2 * step), across;
    out.t = s + ray->near;
    across = out.t * ray->radius;
    out.axial = width * width * (1.0f / 12);
    out.radial = across * across * 0.25f;
    out.x = (ray->direction[0] * s + ray->origin[0]) * scale;
    out.y = (ray->direction[1] * s + ray->origin[1]) * scale;
    out.z = (ray->direction[2] * s + ray->origin[2]) * scale;
    out.wide = across;
    return out;
}

// In a disparity box: a cylinder, as cpu/encode.h has it.
RN_DEVICE struct rn_sample rn_place_forward(const struct rn_march_ray *ray,
                                            const struct rn_forward_line *line, float s,
                                            float step) {
    struct rn_sample out;
    rn_forward_lane(line, s, &out.t, &out.wide);
    out.axial = step * step * (1.0f / 12);
    out.radial = 0.25f * out.wide * out.wide;
    out.x = ray->direction[0] * s + ray->origin[0];
    out.y = ray->direction[1] * s + ray->origin[1];
    out.z = ray->direction[2] * s + ray->origin[2];
    return out;
}

// The sample whose middle lies `s` behind the ray's origin. `line`: of a forward-facing space.
template <int WORLD>
RN_DEVICE struct rn_sample rn_place(const struct rn_march_ray *ray,
                                    const struct rn_forward_line *line, float s, float step) {
    struct rn_sample out;
    if (WORLD == RN_WORLD_UNBOUNDED) return rn_place_unbounded(ray, s, step);
    if (WORLD == RN_WORLD_FORWARD) return rn_place_forward(ray, line, s, step);
    float t = s + ray->near, half = 0.5f * step, shift;
    rn_frustum_lane(t, half / fmaxf(t, 1e-30f), half, ray->radius, &shift, &out.axial, &out.radial);
    float mean = s + shift;
    out.x = ray->direction[0] * mean + ray->origin[0];
    out.y = ray->direction[1] * mean + ray->origin[1];
    out.z = ray->direction[2] * mean + ray->origin[2];
    out.t = t;
    out.wide = 0;
    return out;
}

// Whether it lies in the scene.
template <int WORLD> RN_DEVICE bool rn_is_inside(const struct rn_sample *s) {
    if (WORLD == RN_WORLD_UNBOUNDED || WORLD == RN_WORLD_FORWARD) return true;
    return s->x * s->x + s->y * s->y + s->z * s->z <= 1;
}

RN_LEVEL_FUNCTIONS(RN_DEVICE, rn_level_lane, rn_ball_level_lane, float, float, rn_clamp_lane,
                   rn_log2)

// Never outside the maps, whatever the last bit of the logarithm is.
RN_DEVICE float rn_valid_level(const struct rn_cuda_planes *p, float level) {
    return rn_clamp_lane(level, 0, (float)(p->levels - 1));
}

// Levels from the variances along a plane's axes; of a mip their mean.
RN_DEVICE void rn_levels_of_axes(const struct rn_cuda_planes *p, float u, float v, float *ret_lx,
                                 float *ret_ly) {
    float lx = rn_level_lane(u, p->footprint_base, p->levels);
    float ly = rn_level_lane(v, p->footprint_base, p->levels);
    if (p->footprint == RN_FOOTPRINT_MIP) lx = ly = 0.5f * (lx + ly);
    *ret_lx = rn_valid_level(p, lx);
    *ret_ly = rn_valid_level(p, ly);
}

// In unbounded space: what the contraction does to lengths follows from where it drew the sample.
RN_DEVICE void rn_levels_unbounded(const struct rn_cuda_planes *p, int plane,
                                   const struct rn_sample *sample, const float direction[3],
                                   float *ret_lx, float *ret_ly) {
    float y = rn_root(sample->x * sample->x + sample->y * sample->y + sample->z * sample->z);
    float inverse = 1 / fmaxf(y, 1e-30f), size = 2 * y, limit = 2 - 1e-6f;
    float r = size <= 1 ? size : 1 / (2 - fminf(size, limit)); // rn_uncontracted
    float towards[3] = {sample->x * inverse, sample->y * inverse, sample->z * inverse};
    struct rn_contraction_lane lengths = rn_contraction_at_lane(r);
    if (!p->by_axis) {
        float level =
            rn_contracted_level_lane(&lengths, sample->wide, p->footprint_base, p->levels);
        *ret_lx = *ret_ly = rn_valid_level(p, level);
        return;
    }
    const float *axes = p->axis[plane];
    float u = rn_contracted_variance_lane(&lengths, towards, sample->axial, sample->radial, axes,
                                          direction);
    float v = rn_contracted_variance_lane(&lengths, towards, sample->axial, sample->radial,
                                          axes + 3, direction);
    rn_levels_of_axes(p, u, v, ret_lx, ret_ly);
}

// Levels of a sample on the axes of a plane. `f`: but in unbounded space.
template <int WORLD>
RN_DEVICE void rn_levels(const struct rn_cuda_planes *p, int plane,
                         const struct rn_footprint_factors *f, const struct rn_sample *sample,
                         const struct rn_march_ray *ray, float *ret_lx, float *ret_ly) {
    if (WORLD == RN_WORLD_UNBOUNDED) {
        rn_levels_unbounded(p, plane, sample, ray->direction, ret_lx, ret_ly);
        return;
    }
    if (!p->by_axis) {
        float ball = WORLD == RN_WORLD_FORWARD
                         ? sample->wide * (float)p->footprint_base
                         : sample->t * (ray->radius * (float)p->footprint_base);
        *ret_lx = *ret_ly = rn_valid_level(p, rn_ball_level_lane(ball, p->levels));
        return;
    }
    float u = sample->axial * f->axial_u + sample->radial * f->radial_u;
    float v = sample->axial * f->axial_v + sample->radial * f->radial_v;
    rn_levels_of_axes(p, u, v, ret_lx, ret_ly);
}

// ---- maps -----------------------------------------------------------------------------------

// Where a coordinate falls in a map of `size` texels a side: the texel before it, and the weight of
// the next.
struct rn_texel {
    int low;
    float fraction;
};
RN_TEXEL_FUNCTION(rn_texel_lane, float, (float), fminf, fmaxf, truncf)
RN_DEVICE struct rn_texel rn_find_texel(float p, int size) {
    struct rn_texel t;
    float low;
    rn_texel_lane(p, (float)size, &low, &t.fraction);
    t.low = (int)low;
    return t;
}

// Where a query looks on one axis: coordinate, level, weight of the next level.
struct rn_axis_query {
    float p, upper;
    int level;
};
struct rn_query {
    struct rn_axis_query x, y;
};
RN_DEVICE struct rn_query rn_query_at(float x, float y, float lx, float ly) {
    struct rn_query q = {{x, lx - (float)(int)lx, (int)lx}, {y, ly - (float)(int)ly, (int)ly}};
    return q;
}
RN_DEVICE struct rn_query rn_query_plane(const struct rn_cuda_planes *p, int plane,
                                         const struct rn_sample *s, float lx, float ly) {
    const float *a = p->axis[plane];
    return rn_query_at(a[0] * s->x + a[1] * s->y + a[2] * s->z,
                       a[3] * s->x + a[4] * s->y + a[5] * s->z, lx, ly);
}

// The maps of a query: bit 0 of a corner steps up along x, bit 1 along y. Their weight; 0 for
// corners that take no part.
RN_DEVICE float rn_corner_weight(const struct rn_query *q, int footprint, int corner) {
    float wx = corner & 1 ? q->x.upper : 1 - q->x.upper;
    float wy = corner & 2 ? q->y.upper : 1 - q->y.upper;
    if (footprint != RN_FOOTPRINT_MIP) return wx * wy;
    return corner == 0 || corner == 3 ? wx : 0;
}

// The texels of a corner that takes part.
struct rn_corner {
    int lx, ly, width; // of the map
    struct rn_texel x, y;
};
RN_DEVICE struct rn_corner rn_find_corner(const struct rn_cuda_planes *p, const struct rn_query *q,
                                          int corner) {
    struct rn_corner c;
    c.lx = q->x.level + (corner & 1);
    c.ly = q->y.level + (corner >> 1);
    c.width = p->base >> c.lx;
    c.x = rn_find_texel(q->x.p, c.width);
    c.y = rn_find_texel(q->y.p, p->base >> c.ly);
    return c;
}

// Adds weight times four channels of a texel.
RN_DEVICE void rn_add_texel(uint2 texel, float weight, float sum[4]) {
    sum[0] += weight * rn_low(texel.x);
    sum[1] += weight * rn_high(texel.x);
    sum[2] += weight * rn_low(texel.y);
    sum[3] += weight * rn_high(texel.y);
}

// C channels of a texel, in one load.
template <int C> struct rn_channels;
template <> struct rn_channels<4> { uint2 first; };
template <> struct alignas(16) rn_channels<8> { uint2 first, second; };
RN_DEVICE void rn_add_channels(const struct rn_channels<4> *texel, float weight, float (&sum)[4]) {
    rn_add_texel(texel->first, weight, sum);
}
RN_DEVICE void rn_add_channels(const struct rn_channels<8> *texel, float weight, float (&sum)[8]) {
    rn_add_texel(texel->first, weight, sum);
    rn_add_texel(texel->second, weight, sum + 4);
}

// log2 of how many channels a texel has, which are 4, 8 or 16.
RN_DEVICE int rn_channels_shift(const struct rn_cuda_planes *p) {
    return p->channels == 16 ? 4 : p->channels == 8 ? 3 : 2;
}

// Where one plane is read, by one thread.
struct rn_fetch_place {
    const struct rn_cuda_planes *planes;
    const uint16_t *texels; // of all planes
    int plane, channel;
};

// Adds C channels of one corner of two queries, whose maps have these weights. Every texel is asked
// for before one is used: what takes time here is the wait. Of a map of weight 0 the query's first
// is read, which is there.
template <int C>
RN_DEVICE void rn_fetch_corner(const struct rn_fetch_place *at, const struct rn_query (&q)[2],
                               int corner, const float (&of_map)[2], float (&sum)[2][C]) {
    const struct rn_cuda_planes *p = at->planes;
    struct rn_channels<C> found[2][4];
    float weights[2][4];
    RN_UNROLL
    for (int i = 0; i < 2; i++) {
        struct rn_corner c = rn_find_corner(p, &q[i], of_map[i] > 0 ? corner : 0);
        uint32_t map = (uint32_t)at->plane * p->plane_texels + p->map[c.ly][c.lx];
        uint32_t texel = map + (uint32_t)(c.y.low * c.width + c.x.low);
        uint32_t across = c.width > 1 ? (uint32_t)p->channels : 0;
        uint32_t down = p->base >> c.ly > 1 ? (uint32_t)(c.width * p->channels) : 0;
        const uint16_t *from = at->texels + texel * (size_t)p->channels + (size_t)at->channel;
        float low = of_map[i] * (1 - c.y.fraction), high = of_map[i] * c.y.fraction;
        RN_UNROLL
        for (int k = 0; k < 4; k++) {
            float fx = k & 1 ? c.x.fraction : 1 - c.x.fraction;
            weights[i][k] = (k & 2 ? high : low) * fx;
            found[i][k] =
                *(const struct rn_channels<C> *)(from + (k & 1 ? across : 0) + (k & 2 ? down : 0));
        }
    }
    RN_UNROLL
    for (int i = 0; i < 8; i++)
        rn_add_channels(&found[i / 4][i % 4], weights[i / 4][i % 4], sum[i / 4]);
}

// ---- voxels ---------------------------------------------------------------------------------

// The eight voxels of a sample: the first of them, and the weights of the next along x, y and z.
struct rn_voxel_query {
    int first;
    float x, y, z;
};
RN_DEVICE struct rn_voxel_query rn_query_voxels(int side, const struct rn_sample *s) {
    struct rn_texel x = rn_find_texel(s->x, side), y = rn_find_texel(s->y, side),
                    z = rn_find_texel(s->z, side);
    struct rn_voxel_query q = {(z.low * side + y.low) * side + x.low, x.fraction, y.fraction,
                               z.fraction};
    return q;
}
// Voxel `corner` of them, whose bits 0, 1 and 2 step along x, y and z, and its weight.
RN_DEVICE int rn_voxel_corner(int side, const struct rn_voxel_query *q, int corner,
                              float *ret_weight) {
    *ret_weight = (corner & 1 ? q->x : 1 - q->x) * (corner & 2 ? q->y : 1 - q->y) *
                  (corner & 4 ? q->z : 1 - q->z);
    return q->first + (corner & 1) + (corner & 2 ? side : 0) + (corner & 4 ? side * side : 0);
}

// Their features of two samples. Those of weight 0 are not read.
template <int C>
RN_DEVICE void rn_fetch_voxels(const struct rn_cuda_voxels *v, const struct rn_sample (&s)[2],
                               float (&sum)[2][C]) {
    RN_UNROLL
    for (int i = 0; i < 2; i++) {
        struct rn_voxel_query q = rn_query_voxels(v->side, &s[i]);
        RN_UNROLL
        for (int corner = 0; corner < 8; corner++) {
            float weight;
            int at = rn_voxel_corner(v->side, &q, corner, &weight);
            float4 voxel = float4{0, 0, 0, 0};
            if (weight > 0) voxel = v->first[at];
            sum[i][0] += weight * voxel.x;
            sum[i][1] += weight * voxel.y;
            sum[i][2] += weight * voxel.z;
            sum[i][3] += weight * voxel.w;
        }
    }
}

// ---- a tile ---------------------------------------------------------------------------------

// A ray as a warp encodes its samples: lane p holds the factors of plane p.
struct rn_encoder {
    struct rn_footprint_factors factors;
    uint32_t leveled;  // planes, one bit each, of which a sample may lie above level 0
    float step;        // of one sample
    float fixed_level; // in place of the footprints', where >= 0
};

template <int WORLD>
RN_DEVICE struct rn_encoder rn_encoder_start(const struct rn_cuda_planes *p,
                                             const struct rn_march_ray *ray,
                                             const struct rn_forward_line *line, float step) {
    struct rn_encoder e;
    e.step = step * (float)ray->stride;
    e.fixed_level = -1;
    int plane = RN_LANE < p->planes ? RN_LANE : 0;
    if (WORLD == RN_WORLD_UNBOUNDED)
        e.factors = rn_footprint_factors{0, 0, 0, 0};
    else
        e.factors = rn_factors(p->axis[plane], ray->direction);
    e.leveled = rn_ballot(rn_ray_leveled<WORLD>(p, ray, line, &e.factors, e.step));
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

// C features of two samples, `feature` on: channels of a plane, voxels behind the last, or none.
// top[i]: raised to sample i's level on any axis. Corners that no lane has are left out.
template <int C, int WORLD>
RN_DEVICE void rn_encode_features(const struct rn_cuda_scene *scene, const struct rn_encoder *e,
                                  const struct rn_march_ray *ray, const struct rn_sample (&s)[2],
                                  int feature, float (&sum)[2][C], float (&top)[2]) {
    const struct rn_cuda_planes *p = &scene->planes;
    int plane = feature >> rn_channels_shift(p);
    bool present = plane < p->planes;
    if (!present) plane = 0;
    struct rn_fetch_place at = {p, scene->texels, plane, feature & (p->channels - 1)};
    struct rn_footprint_factors f = rn_factors_of(e, plane);
    bool leveled = e->leveled >> plane & 1;
    struct rn_query q[2];
    RN_UNROLL
    for (int i = 0; i < 2; i++) {
        float lx = fmaxf(e->fixed_level, 0), ly = lx;
        if (leveled && e->fixed_level < 0) rn_levels<WORLD>(p, plane, &f, &s[i], ray, &lx, &ly);
        q[i] = rn_query_plane(p, plane, &s[i], lx, ly);
        if (present) top[i] = fmaxf(top[i], fmaxf(lx, ly));
    }
    RN_ROLLED
    for (int corner = 0; corner < 4; corner++) {
        float of_map[2];
        for (int i = 0; i < 2; i++)
            of_map[i] = present ? rn_corner_weight(&q[i], p->footprint, corner) : 0;
        if (rn_ballot(of_map[0] > 0 || of_map[1] > 0))
            rn_fetch_corner<C>(&at, q, corner, of_map, sum);
    }
    if constexpr (WORLD != RN_WORLD_BALL)
        if (feature == p->planes * p->channels && scene->voxels.side > 0)
            rn_fetch_voxels<C>(&scene->voxels, s, sum);
}

// Eight features, likewise; where texels have four channels, of two planes.
template <int WORLD>
RN_DEVICE void rn_encode_eight(const struct rn_cuda_scene *scene, const struct rn_encoder *e,
                               const struct rn_march_ray *ray, const struct rn_sample (&s)[2],
                               int feature, float (&sum)[2][8], float (&top)[2]) {
    if (scene->planes.channels >= 8) {
        rn_encode_features<8, WORLD>(scene, e, ray, s, feature, sum, top);
        return;
    }
    RN_ROLLED
    for (int part = 0; part < 2; part++) {
        float four[2][4] = {};
        rn_encode_features<4, WORLD>(scene, e, ray, s, feature + 4 * part, four, top);
        RN_UNROLL
        for (int i = 0; i < 8; i++)
            sum[i / 4][i % 4] = part == 0 ? four[i / 4][i % 4] : sum[i / 4][i % 4];
        RN_UNROLL
        for (int i = 0; i < 8; i++)
            sum[i / 4][4 + i % 4] = four[i / 4][i % 4];
    }
}

// Features of the warp's two samples of rows g and g + 8 as A fragments. *ret_top[i]: the largest
// level of sample i on any axis. Two fragments a turn, of which a lane has eight features
// (rn_cuda_feature): with a copy of the code for each, kernels outgrow the instruction cache.
// Registers have no index, so every turn goes over all of them.
template <int KT, int WORLD>
RN_DEVICE void rn_encode(const struct rn_cuda_scene *scene, const struct rn_encoder *e,
                         const struct rn_march_ray *ray, const struct rn_sample (&s)[2],
                         uint32_t (&a)[KT][4], float (&ret_top)[2]) {
    ret_top[0] = ret_top[1] = 0;
    RN_UNROLL
    for (int i = 0; i < 4 * KT; i++)
        a[i / 4][i % 4] = 0;
    RN_ROLLED
    for (int turn = 0; turn < KT / 2; turn++) {
        float sum[2][8] = {};
        uint32_t own[2][4];
        rn_encode_eight<WORLD>(scene, e, ray, s, 32 * turn + 8 * (RN_LANE % 4), sum, ret_top);
        RN_UNROLL
        for (int i = 0; i < 8; i++)
            own[i / 4][i % 4] = rn_pack(sum[i % 2][i / 4 * 4 + i % 4 / 2 * 2],
                                        sum[i % 2][i / 4 * 4 + i % 4 / 2 * 2 + 1]);
        RN_UNROLL
        for (int k = 0; k < KT; k++)
            RN_UNROLL
        for (int i = 0; i < 4; i++)
            a[k][i] = k / 2 == turn ? own[k % 2][i] : a[k][i];
    }
}

#endif
