#include "server/engine/reference/exact.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/field/ripmap.h"
#include "server/engine/field/sh.h"
#include "server/engine/field/volume.h"
#include "server/engine/kernels/ray.h"
#include "server/engine/reference/reference.h"
#include "server/engine/reference/voxels.h"

// ---- features -------------------------------------------------------------------------------

static int levels_of(const struct rn_cpu_field *f) {
    return f->built_levels < f->config->levels ? f->built_levels : f->config->levels;
}

void rn_exact_fetch(const struct rn_cpu_field *f, int plane, const double uv[2], const double l[2],
                    double *ret) {
    int levels = levels_of(f), channels = f->config->channels;
    bool mip = f->config->footprint == RN_FOOTPRINT_MIP;
    struct rn_lerp x = rn_rip_level(l[0], levels), y = rn_rip_level(l[1], levels);
    memset(ret, 0, (size_t)channels * sizeof *ret);
    for (int i = 0; i < 4; i++) {
        double weight = rn_rip_map_weight(&x, &y, mip, i);
        if (!(weight > 0)) continue;
        const struct rn_map *map = &f->maps[plane][i & 2 ? y.high : y.low][i & 1 ? x.high : x.low];
        struct rn_lerp a = rn_rip_lerp(uv[0], map->width), b = rn_rip_lerp(uv[1], map->height);
        for (int j = 0; j < 4; j++) {
            size_t texel = (size_t)(j & 2 ? b.high : b.low) * (size_t)map->width +
                           (size_t)(j & 1 ? a.high : a.low);
            double corner = weight * (j & 1 ? a.fraction : 1 - a.fraction) *
                            (j & 2 ? b.fraction : 1 - b.fraction);
            for (int c = 0; c < channels; c++)
                ret[c] += corner * (double)map->texels[texel * (size_t)channels + (size_t)c];
        }
    }
}

void rn_exact_voxels(const struct rn_cpu_field *f, const double x[3], double *ret) {
    struct rn_voxel_corner corners[8];
    const float *voxels = f->maps[f->config->planes][0][0].texels;
    rn_voxel_corners(f->config, x, corners);
    memset(ret, 0, RN_VOXEL_CHANNELS * sizeof *ret);
    for (int k = 0; k < 8; k++)
        for (int c = 0; c < RN_VOXEL_CHANNELS; c++)
            ret[c] += corners[k].weight * (double)voxels[corners[k].offset + (size_t)c];
}

static double along(const double axis[3], const double x[3]) {
    return axis[0] * x[0] + axis[1] * x[1] + axis[2] * x[2];
}

static bool is_unbounded(const struct rn_cpu_field *f) {
    return f->config->space == RN_SPACE_UNBOUNDED;
}

// The sample's mean position, in the planes' frame.
static void place(const struct rn_cpu_field *f, const struct rn_march_ray *ray, double width,
                  double s, double ret[3]) {
    double mid = (double)ray->near + s, shift = 0, scale = 1;
    if (!is_unbounded(f) && !f->disparity.on)
        shift = rn_frustum_moments(mid, width, (double)ray->radius).mean - mid;
    for (int i = 0; i < 3; i++)
        ret[i] = (double)ray->origin[i] + (double)ray->direction[i] * (s + shift);
    if (is_unbounded(f)) scale = rn_contraction_at(sqrt(along(ret, ret))).scale;
    for (int i = 0; i < 3; i++)
        ret[i] *= scale;
}

// What a sample's density counts for, and where it lies from the ray's origin.
static double interval(const struct rn_cpu_field *f, const struct rn_march_ray *ray, double width,
                       double k, double *ret_s) {
    double x[3];
    *ret_s = is_unbounded(f) ? rn_distance_of_place(2 - (double)ray->length + (2 * k + 1) * width)
                             : (k + 0.5) * width;
    if (is_unbounded(f) || f->disparity.on) return width;
    place(f, ray, width, *ret_s, x);
    return along(x, x) <= 1 ? width : 0;
}

// Levels in a forward-facing space, from how wide the cone is in the cube.
static void forward_levels(const struct rn_cpu_field *f, const struct rn_march_ray *ray,
                           double width, double s, int plane, double ret[2]) {
    const struct rn_disparity *space = &f->disparity;
    int size = rn_footprint_base(f->config), levels = levels_of(f);
    struct rn_forward_ray was = rn_forward_ray(space, ray);
    double z = (double)ray->origin[2] + (double)ray->direction[2] * s;
    double disparity = (z - space->shift[2]) / space->scale[2], d[3];
    double wide = (double)ray->radius * was.slant * space->scale[0] * (1 - was.eye * disparity);
    const double *axes[2] = {f->solid.axis_u[plane], f->solid.axis_v[plane]};
    for (int i = 0; i < 3; i++)
        d[i] = (double)ray->direction[i];
    for (int i = 0; i < 2; i++) {
        double variance = rn_projected_variance(axes[i], d, width * width / 12, wide * wide / 4);
        if (f->config->footprint == RN_FOOTPRINT_MIP)
            ret[i] = rn_level_from_ball(wide * size, levels);
        if (rn_levels_by_axis(f->config)) ret[i] = rn_level_from_variance(variance, size, levels);
    }
    if (f->config->mean_level && f->config->footprint == RN_FOOTPRINT_MIP)
        ret[0] = ret[1] = (ret[0] + ret[1]) / 2;
}

void rn_exact_features(const struct rn_cpu_field *f, const struct rn_march_ray *ray, double width,
                       double s, double *ret_features, double *ret_level) {
    struct rn_reference ref = {.config = *f->config, .solid = f->solid};
    ref.config.levels = levels_of(f);
    struct rn_reference_ray r = {.radius = (double)ray->radius, .width = width};
    double x[3], level = 0;
    place(f, ray, width, s, x);
    for (int i = 0; i < 3; i++) {
        r.direction[i] = (double)ray->direction[i];
        r.origin[i] = (double)ray->origin[i] - r.direction[i] * (double)ray->near;
    }
    for (int p = 0; p < f->config->planes; p++) {
        double l[2] = {0, 0};
        double uv[2] = {along(f->solid.axis_u[p], x), along(f->solid.axis_v[p], x)};
        if (f->disparity.on)
            forward_levels(f, ray, width, s, p, l);
        else
            rn_reference_levels(&ref, &r, p, (double)ray->near + s, &l[0], &l[1]);
        level = fmax(level, fmax(l[0], l[1]));
        rn_exact_fetch(f, p, uv, l, ret_features + p * f->config->channels);
    }
    if (f->config->voxels)
        rn_exact_voxels(f, x, ret_features + f->config->planes * f->config->channels);
    if (ret_level) *ret_level = level;
}

// ---- rays -----------------------------------------------------------------------------------

struct rn_exact {
    const struct rn_cpu_field *field;
    double *block, *base, *head; // networks
    double *activation[RN_MLP_MAX_LAYERS + 1];
};

enum rn_status rn_exact_create(const struct rn_cpu_field *field, struct rn_exact **ret_exact,
                               struct rn_error *err) {
    const struct rn_mlp_shape *base = &field->base_shape, *head = &field->head_shape;
    size_t widest = (size_t)(base->widest > head->widest ? base->widest : head->widest);
    size_t numbers = base->count + head->count + (RN_MLP_MAX_LAYERS + 1) * widest;
    struct rn_exact *exact = calloc(1, sizeof *exact);
    if (exact) exact->block = calloc(numbers, sizeof(double));
    if (!exact || !exact->block) {
        free(exact);
        return rn_error_set(err, RN_ERROR_NO_MEMORY, "reference", "out of memory");
    }
    exact->field = field;
    exact->base = exact->block;
    exact->head = exact->base + base->count;
    for (int l = 0; l <= RN_MLP_MAX_LAYERS; l++)
        exact->activation[l] = exact->head + head->count + (size_t)l * widest;
    for (size_t i = 0; i < base->count; i++)
        exact->base[i] = (double)field->base_weights[i];
    for (size_t i = 0; i < head->count; i++)
        exact->head[i] = (double)field->head_weights[i];
    *ret_exact = exact;
    return RN_OK;
}

void rn_exact_destroy(struct rn_exact **exact) {
    if (!*exact) return;
    free((*exact)->block);
    free(*exact);
    *exact = NULL;
}

static double sigmoid(double x) {
    return 1 / (1 + exp(-x));
}

// SH of the ray's direction, and its photograph's appearance, into the colour network's inputs.
static void set_direction(const struct rn_cpu_field *f, const struct rn_march_options *options,
                          const struct rn_march_ray *ray, double *inputs) {
    double d[3];
    bool forward = f->disparity.on;
    struct rn_forward_ray was = {{0}, 0, 0};
    if (forward) was = rn_forward_ray(&f->disparity, ray);
    for (int i = 0; i < 3; i++)
        d[i] = forward ? was.view[i] : (double)ray->direction[i];
    if (f->config->view_dependence)
        rn_sh_encode(d, inputs);
    else
        memset(inputs, 0, RN_SH_COUNT * sizeof *inputs);
    for (int i = 0; i < RN_APPEARANCE && f->config->appearances > 0; i++)
        inputs[RN_APPEARANCE_AT + i] =
            options->appearances ? (double)options->appearances[rn_appearance_at(options, ray) + i]
                                 : 0;
}

// Colours of one sample, from the density network's outputs.
static void shade_sample(struct rn_exact *exact, const struct rn_march_options *options,
                         const struct rn_march_ray *ray, const double *geometry, double rgb[3]) {
    double outputs[RN_GEOMETRY];
    memcpy(outputs, geometry, sizeof outputs); // the networks share their room
    set_direction(exact->field, options, ray, exact->activation[0]);
    memcpy(exact->activation[0] + RN_SH_COUNT, outputs + 1, 15 * sizeof(double));
    exact->activation[0][31] = 1;
    rn_mlp_forward(&exact->field->head_shape, exact->head, exact->activation);
    for (int c = 0; c < 3; c++)
        rgb[c] = sigmoid(exact->activation[exact->field->head_shape.layers][c]);
}

// Ray shading: the colour of a ray's sums.
static void shade_ray(struct rn_exact *exact, const struct rn_march_options *options,
                      const struct rn_march_ray *ray, const double sums[RN_GEOMETRY],
                      double opacity, double rgb[3]) {
    memcpy(rgb, sums + 1, 3 * sizeof *rgb);
    if (!exact->field->config->view_dependence) return;
    set_direction(exact->field, options, ray, exact->activation[0]);
    memcpy(exact->activation[0] + 16, sums + 4, 12 * sizeof(double));
    memcpy(exact->activation[0] + 28, sums + 1, 3 * sizeof(double));
    exact->activation[0][31] = opacity;
    rn_mlp_forward(&exact->field->head_shape, exact->head, exact->activation);
    for (int c = 0; c < 3; c++)
        rgb[c] += opacity * exact->activation[exact->field->head_shape.layers][c];
}

void rn_exact_render(struct rn_exact *exact, const struct rn_march_options *options,
                     const struct rn_march_ray *ray, const uint16_t *k, int n,
                     struct rn_exact_pixel *ret_pixel) {
    const struct rn_cpu_field *f = exact->field;
    bool per_ray = f->config->shading == RN_SHADING_RAY;
    double width = (double)options->step * ray->stride, depth = 0, sums[RN_GEOMETRY] = {0};
    double rgb[3] = {0}, level;
    *ret_pixel = (struct rn_exact_pixel){.level = 0};
    for (int j = 0; j < n; j++) {
        double s, colour[3], share = interval(f, ray, width, k[j], &s);
        if (!(share > 0)) continue;
        rn_exact_features(f, ray, width, s, exact->activation[0], &level);
        rn_mlp_forward(&f->base_shape, exact->base, exact->activation);
        const double *out = exact->activation[f->base_shape.layers];
        double thickness = rn_density(out[0]) * share * RN_DENSITY_UNIT;
        if (j == n - 1 && rn_ends_opaque(f)) thickness = INFINITY;
        double weight = exp(-depth) * rn_alpha(thickness);
        depth += thickness;
        ret_pixel->level = fmax(ret_pixel->level, level);
        for (int i = 1; i < RN_GEOMETRY && per_ray; i++)
            sums[i] += weight * (i < 4 ? sigmoid(out[i]) : out[i]);
        if (!per_ray) shade_sample(exact, options, ray, out, colour);
        for (int c = 0; c < 3 && !per_ray; c++)
            rgb[c] += weight * colour[c];
    }
    ret_pixel->alpha = rn_alpha(depth);
    if (per_ray) shade_ray(exact, options, ray, sums, ret_pixel->alpha, rgb);
    rn_colour_seen(&options->colour, ret_pixel->alpha, rgb);
    memcpy(ret_pixel->rgb, rgb, sizeof rgb);
}
