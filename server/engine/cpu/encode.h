// Where samples lie: positions, plane coordinates, and levels from their footprints; and their
// features there.
#ifndef RN_ENGINE_CPU_ENCODE_H
#define RN_ENGINE_CPU_ENCODE_H

#include <stdbool.h>

#include "server/engine/cpu/fetch.h"
#include "server/engine/cpu/forward.h"
#include "server/engine/cpu/space.h"
#include "server/engine/cpu/voxels.h"
#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/field/volume.h"

RN_FRUSTUM_FUNCTION(frustum_lanes, vf, float)

// half / t; t = 0 is no place to divide by.
RN_INLINE vf frustum_ratio(vf t, float half) {
    return vf_set(half) / vf_max(t, vf_set(1e-30f));
}

// A vector of one ray's samples: distance from the camera, mean and variances of their Gaussians,
// whether they lie in the scene.
struct samples {
    vf t, x, y, z, axial, radial;
    vf wide; // forward: the cone's radius in the cube
    vi inside;
};

// The samples whose frustums' middles lie `s` behind the ray's origin: inside the unit ball.
RN_INLINE struct samples place_samples(const struct rn_march_ray *ray, vf s, float half) {
    struct samples out = {.t = s + ray->near};
    vf shift;
    frustum_lanes(out.t, frustum_ratio(out.t, half), half, ray->radius, &shift, &out.axial,
                  &out.radial);
    vf m = s + shift;
    out.x = ray->direction[0] * m + ray->origin[0];
    out.y = ray->direction[1] * m + ray->origin[1];
    out.z = ray->direction[2] * m + ray->origin[2];
    out.inside = out.x * out.x + out.y * out.y + out.z * out.z <= 1.0f;
    return out;
}

// The same in a disparity box, `s` marched: a piece of a cone is short there beside its distance
// from the apex, and its Gaussian a cylinder's.
RN_INLINE struct samples place_forward(const struct rn_march_ray *ray,
                                       const struct rn_forward_line *line, vf s, float step) {
    struct samples out = {.inside = vi_set(-1), .axial = vf_set(step * step / 12)};
    forward_sample(line, s, &out.t, &out.wide);
    out.radial = 0.25f * out.wide * out.wide;
    out.x = ray->direction[0] * s + ray->origin[0];
    out.y = ray->direction[1] * s + ray->origin[1];
    out.z = ray->direction[2] * s + ray->origin[2];
    return out;
}

// The part of the projected variances that is the same along a ray: (x.d)^2 and |x cross d|^2.
struct ray_footprint {
    float axial_u[RN_MAX_PLANES], radial_u[RN_MAX_PLANES];
    float axial_v[RN_MAX_PLANES], radial_v[RN_MAX_PLANES];
    struct rn_forward_line forward; // in a forward-facing space
    bool leveled;                   // some sample of the ray may lie above level 0
};

static void footprint_factors(const double axis[3], const float d[3], float *ret_axial,
                              float *ret_radial) {
    double direction[3] = {d[0], d[1], d[2]};
    rn_variance_factors(axis, direction, ret_axial, ret_radial);
}

// Whether the footprint at the ray's far end exceeds a texel of level 0 anywhere.
static void ray_footprint_init(const struct rn_cpu_field *field, const struct rn_march_ray *ray,
                               float step, struct ray_footprint *ret) {
    int levels =
        field->built_levels < field->config->levels ? field->built_levels : field->config->levels;
    const struct rn_disparity *space = &field->disparity;
    bool forward = space->on;
    if (forward) {
        struct rn_forward_ray was = rn_forward_ray(space, ray);
        ret->forward = rn_forward_line(space, ray, &was);
    }
    ret->leveled = false;
    if (levels < 2 || field->config->footprint == RN_FOOTPRINT_POINT) return;
    if (field->config->space == RN_SPACE_UNBOUNDED) {
        ret->leveled = rn_contracted_leveled(ray->origin, ray->near, ray->radius, step,
                                             rn_footprint_base(field->config),
                                             rn_levels_by_axis(field->config));
        return;
    }
    float far = (ray->near + ray->length) * ray->radius;
    float size = (float)rn_footprint_base(field->config);
    if (forward) far = widest_forward(&ret->forward, ray->length);
    if (!rn_levels_by_axis(field->config)) {
        ret->leveled = far * size > 1;
        return;
    }
    float axial, radial, limit = 1 / ((float)RN_FOOTPRINT_SCALE * size);
    rn_variance_bounds(far, step, &axial, &radial);
    for (int p = 0; p < field->config->planes; p++) {
        footprint_factors(field->solid.axis_u[p], ray->direction, &ret->axial_u[p],
                          &ret->radial_u[p]);
        footprint_factors(field->solid.axis_v[p], ray->direction, &ret->axial_v[p],
                          &ret->radial_v[p]);
        float u = ret->axial_u[p] * axial + ret->radial_u[p] * radial;
        float v = ret->axial_v[p] * axial + ret->radial_v[p] * radial;
        if (u > limit * limit || v > limit * limit) ret->leveled = true;
    }
}

RN_LEVEL_FUNCTIONS(RN_HD, level_from_variance, level_from_ball, vf, float, vf_clamp, vf_log2)

// Of a mip whose level is the mean of both axes'.
RN_INLINE void mean_levels(const struct rn_field_config *config, vf *lx, vf *ly) {
    if (config->footprint == RN_FOOTPRINT_MIP) *lx = *ly = 0.5f * (*lx + *ly);
}

// Samples in unbounded space: where they lie in the frame of the planes, and the Gaussian of each
// as it is drawn there by the contraction's Jacobian at its middle.
struct unbounded_lanes {
    vf x[3], towards[3]; // position; direction from the centre
    struct contraction_lanes lengths;
    vf axial, radial; // variances along the ray and across it, before the contraction
};

RN_INLINE vf unbounded_variance(const struct unbounded_lanes *at, const double axis[3],
                                const float d[3]) {
    const float narrow[3] = {(float)axis[0], (float)axis[1], (float)axis[2]};
    return contracted_variance(&at->lengths, at->towards, at->axial, at->radial, narrow, d);
}

RN_INLINE void put_voxel_place(const struct rn_cpu_field *field, vf x, vf y, vf z, int slot,
                               struct rn_workspace *w) {
    if (!field->config->voxels) return;
    vf_store(w->voxel[0] + slot, x);
    vf_store(w->voxel[1] + slot, y);
    vf_store(w->voxel[2] + slot, z);
}

// place_segment in unbounded space.
static void place_unbounded(const struct rn_cpu_field *field,
                            const struct rn_march_options *options, const struct rn_march_ray *ray,
                            bool leveled, const uint16_t *k, int n, int slot,
                            struct rn_workspace *w) {
    int levels = field->built_levels, base = rn_footprint_base(field->config);
    if (levels > field->config->levels) levels = field->config->levels;
    for (int j = 0; j < n; j += RN_VL) {
        int slots = slot + j;
        vf index;
        for (int i = 0; i < RN_VL; i++)
            index[i] = (float)k[j + i];
        vf s = unbounded_distance(ray, index, options->step), t = s + ray->near;
        vf r = distance_from_centre(ray, s), stretch = vf_max(s * s, vf_set(1));
        vf inverse = 1.0f / vf_max(r, vf_set(1e-30f));
        struct unbounded_lanes at = {.lengths = contraction_at(r)};
        for (int i = 0; i < 3; i++) {
            vf p = ray->direction[i] * s + ray->origin[i];
            at.x[i] = p * at.lengths.scale;
            at.towards[i] = p * inverse;
        }
        vf width = stretch * (2 * options->step), across = t * ray->radius;
        at.axial = width * width * (1.0f / 12);
        at.radial = across * across * 0.25f;
        vf_store(w->s + slots, s);
        vf_store(w->interval + slots, vf_set(options->step * (float)RN_DENSITY_UNIT));
        put_voxel_place(field, at.x[0], at.x[1], at.x[2], slots, w);
        vf ball = vf_set(0);
        if (leveled && !rn_levels_by_axis(field->config))
            ball = contracted_ball_level(&at.lengths, across, base, levels);
        for (int p = 0; p < field->config->planes; p++) {
            const double *au = field->solid.axis_u[p], *av = field->solid.axis_v[p];
            vf_store(w->u[p] + slots,
                     (float)au[0] * at.x[0] + (float)au[1] * at.x[1] + (float)au[2] * at.x[2]);
            vf_store(w->v[p] + slots,
                     (float)av[0] * at.x[0] + (float)av[1] * at.x[1] + (float)av[2] * at.x[2]);
            if (!leveled) continue;
            vf lx = ball, ly = ball;
            if (rn_levels_by_axis(field->config)) {
                const float *d = ray->direction;
                lx = level_from_variance(unbounded_variance(&at, au, d), base, levels);
                ly = level_from_variance(unbounded_variance(&at, av, d), base, levels);
                mean_levels(field->config, &lx, &ly);
            }
            vf_store(w->lx[p] + slots, lx);
            vf_store(w->ly[p] + slots, ly);
        }
    }
}

// Positions, plane coordinates and levels of one segment: `n` samples of `ray` at march indices
// k[0..n), written to sample slots [slot, slot + n) (and up to a vector beyond).
static void place_segment(const struct rn_cpu_field *field, const struct rn_march_options *options,
                          const struct rn_march_ray *ray, const struct ray_footprint *footprint,
                          bool leveled, const uint16_t *k, int n, int slot,
                          struct rn_workspace *w) {
    if (field->config->space == RN_SPACE_UNBOUNDED) {
        place_unbounded(field, options, ray, leveled, k, n, slot, w);
        return;
    }
    int levels = field->built_levels, base = rn_footprint_base(field->config);
    if (levels > field->config->levels) levels = field->config->levels;
    float step = options->step * (float)ray->stride, half = step * 0.5f;
    bool forward = field->disparity.on;
    for (int j = 0; j < n; j += RN_VL) {
        vf index;
        for (int i = 0; i < RN_VL; i++)
            index[i] = (float)k[j + i];
        vf s = (index + 0.5f) * step, ball = vf_set(0);
        struct samples is = forward ? place_forward(ray, &footprint->forward, s, step)
                                    : place_samples(ray, s, half);
        int at = slot + j;
        vf_store(w->s + at, forward ? is.t - ray->near : s);
        if (forward) vf_store(w->marched + at, s);
        vf_store(w->interval + at,
                 vf_bits(is.inside & vi_bits(vf_set(step * (float)RN_DENSITY_UNIT))));
        put_voxel_place(field, is.x, is.y, is.z, at, w);
        if (leveled && !rn_levels_by_axis(field->config))
            ball = level_from_ball(
                forward ? is.wide * (float)base : is.t * (ray->radius * (float)base), levels);
        for (int p = 0; p < field->config->planes; p++) {
            const double *au = field->solid.axis_u[p], *av = field->solid.axis_v[p];
            vf_store(w->u[p] + at, (float)au[0] * is.x + (float)au[1] * is.y + (float)au[2] * is.z);
            vf_store(w->v[p] + at, (float)av[0] * is.x + (float)av[1] * is.y + (float)av[2] * is.z);
            if (!leveled) continue;
            vf lx = ball, ly = ball;
            if (rn_levels_by_axis(field->config)) {
                lx = level_from_variance(is.axial * footprint->axial_u[p] +
                                             is.radial * footprint->radial_u[p],
                                         base, levels);
                ly = level_from_variance(is.axial * footprint->axial_v[p] +
                                             is.radial * footprint->radial_v[p],
                                         base, levels);
                mean_levels(field->config, &lx, &ly);
            }
            vf_store(w->lx[p] + at, lx);
            vf_store(w->ly[p] + at, ly);
        }
    }
}

RN_INLINE void encode_plane(const struct rn_cpu_field *field, int plane, bool leveled, int begin,
                            int end, const struct rn_workspace *w, const int channels) {
    const struct rn_map(*maps)[RN_MAX_LEVELS] = field->maps[plane];
    const float *u = w->u[plane], *v = w->v[plane];
    feature *out = feature_row(field, w, 0) + plane * channels;
    size_t stride = features_a_row(field);
    if (leveled)
        encode_leveled(maps, field->config->footprint == RN_FOOTPRINT_MIP, u, v, w->lx[plane],
                       w->ly[plane], begin, end, out, stride, channels);
    else
        encode_flat(&maps[0][0], u, v, begin, end, out, stride, channels);
}

// Features of samples [begin, end) of the workspace.
static void encode(const struct rn_cpu_field *field, bool leveled, int begin, int end,
                   struct rn_workspace *w) {
    int channels = field->config->channels;
    for (int p = 0; p < field->config->planes; p++) {
        if (channels == 4)
            encode_plane(field, p, leveled, begin, end, w, 4);
        else if (channels == 8)
            encode_plane(field, p, leveled, begin, end, w, 8);
        else
            encode_plane(field, p, leveled, begin, end, w, 16);
    }
    if (field->config->voxels) {
        struct voxels voxels = voxels_of(field->config, &field->maps[field->config->planes][0][0]);
        encode_voxels(&voxels, w->voxel, begin, end,
                      feature_row(field, w, 0) + field->config->planes * channels,
                      features_a_row(field));
    }
    clear_padding(field, end, w);
}

#endif
