#include "server/engine/reference/reference.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/field/loss.h"
#include "server/engine/field/ripmap.h"
#include "server/engine/field/sh.h"
#include "server/engine/field/space.h"
#include "server/engine/field/volume.h"
#include "server/engine/reference/voxels.h"

enum rn_status rn_reference_create(const struct rn_field_config *config, uint64_t seed,
                                   struct rn_reference **ret_reference, struct rn_error *err) {
    struct rn_reference *ref = calloc(1, sizeof *ref);
    if (!ref) return rn_error_set(err, RN_ERROR_NO_MEMORY, "reference", "out of memory");
    ref->config = *config;
    ref->pixel_rays = 1;
    enum rn_status status =
        rn_solid_init(config->planes, config->orientation, seed, &ref->solid, err);
    if (status != RN_OK) goto fail;
    ref->base_shape =
        rn_mlp_shape(rn_feature_count(config), config->width, config->base_layers, RN_GEOMETRY);
    ref->head_shape =
        rn_mlp_shape(RN_HEAD_INPUTS, config->width, config->head_layers, RN_HEAD_OUTPUTS);
    ref->plane_count = (size_t)rn_grid_count(config) * rn_grid_numbers(config);
    ref->map_count = rn_reference_map_offset(ref, config->planes, 0, 0);
    size_t total =
        2 * (ref->plane_count + ref->map_count + ref->base_shape.count + ref->head_shape.count);
    double *block = calloc(total, sizeof *block);
    if (!block) {
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, "reference", "out of memory");
        goto fail;
    }
    ref->planes = block;
    ref->plane_grad = ref->planes + ref->plane_count;
    ref->maps = ref->plane_grad + ref->plane_count;
    ref->map_grad = ref->maps + ref->map_count;
    ref->base = ref->map_grad + ref->map_count;
    ref->base_grad = ref->base + ref->base_shape.count;
    ref->head = ref->base_grad + ref->base_shape.count;
    ref->head_grad = ref->head + ref->head_shape.count;
    *ret_reference = ref;
    return RN_OK;
fail:
    rn_reference_destroy(&ref);
    return status;
}

void rn_reference_destroy(struct rn_reference **reference) {
    if (!*reference) return;
    free((*reference)->planes);
    free(*reference);
    *reference = NULL;
}

// x rounded to the nearest fp16 number.
static double half_of(double x) {
    int exponent;
    frexp(x, &exponent);
    int shift = 11 - (exponent > -13 ? exponent : -13); // digits behind the point
    return ldexp(nearbyint(ldexp(x, shift)), -shift);
}

static void network_forward(const struct rn_reference *ref, const struct rn_mlp_shape *shape,
                            const double *weights, double *const *activation) {
    if (!ref->half) {
        rn_mlp_forward(shape, weights, activation);
        return;
    }
    for (int l = 0; l < shape->layers; l++) {
        struct rn_mlp_shape one = {1, {shape->in[l]}, {shape->out[l]}, {shape->offset[l]}, 0, 0};
        for (int i = 0; i < shape->in[l]; i++)
            activation[l][i] = l > 0 && activation[l][i] < 0 ? 0 : half_of(activation[l][i]);
        rn_mlp_forward(&one, weights, activation + l);
    }
}

static size_t map_size(const struct rn_reference *ref, int lx, int ly) {
    return (size_t)rn_rip_size(ref->config.base, lx) * rn_rip_size(ref->config.base, ly) *
           ref->config.channels;
}

size_t rn_reference_map_offset(const struct rn_reference *ref, int plane, int lx, int ly) {
    int levels = ref->config.levels;
    size_t per_plane = 0, before = 0;
    for (int y = 0; y < levels; y++)
        for (int x = 0; x < levels; x++) {
            if (y == ly && x == lx) before = per_plane;
            per_plane += map_size(ref, x, y);
        }
    return (size_t)plane * per_plane + before;
}

// One pooling along a line of texels whose neighbours are `stride` numbers apart; adjoint adds
// the coarse gradient to the fine one.
static void pool_line(int size, int out_size, int channels, size_t stride, const double *fine,
                      double *coarse, size_t coarse_stride) {
    for (int i = 0; i < out_size; i++) {
        double weight[3];
        int first, taps = rn_rip_taps(size, i, &first, weight);
        for (int c = 0; c < channels; c++) {
            double sum = 0;
            for (int t = 0; t < taps; t++)
                sum += weight[t] * fine[(first + t) * stride + c];
            coarse[i * coarse_stride + c] = sum;
        }
    }
}

static void unpool_line(int size, int out_size, int channels, size_t stride, double *fine,
                        const double *coarse, size_t coarse_stride) {
    for (int i = 0; i < out_size; i++) {
        double weight[3];
        int first, taps = rn_rip_taps(size, i, &first, weight);
        for (int c = 0; c < channels; c++)
            for (int t = 0; t < taps; t++)
                fine[(first + t) * stride + c] += weight[t] * coarse[i * coarse_stride + c];
    }
}

typedef void (*line_fn)(int, int, int, size_t, double *, double *, size_t);
static void pool_adapter(int size, int out, int channels, size_t s, double *f, double *c,
                         size_t cs) {
    pool_line(size, out, channels, s, f, c, cs);
}
static void unpool_adapter(int size, int out, int channels, size_t s, double *f, double *c,
                           size_t cs) {
    unpool_line(size, out, channels, s, f, c, cs);
}

// Applies `line` between map (lx, ly) and the one pooled once more along x or y.
static void between(struct rn_reference *ref, double *maps, int plane, int lx, int ly, bool along_x,
                    line_fn line) {
    int channels = ref->config.channels, base = ref->config.base;
    int w = rn_rip_size(base, lx), h = rn_rip_size(base, ly);
    double *fine = maps + rn_reference_map_offset(ref, plane, lx, ly);
    double *coarse = maps + rn_reference_map_offset(ref, plane, lx + along_x, ly + !along_x);
    size_t row = (size_t)w * channels;
    if (along_x) {
        int out = rn_rip_size(base, lx + 1);
        for (int y = 0; y < h; y++)
            line(w, out, channels, channels, fine + y * row, coarse + (size_t)y * out * channels,
                 channels);
    } else {
        for (int x = 0; x < w; x++)
            line(h, rn_rip_size(base, ly + 1), channels, row, fine + (size_t)x * channels,
                 coarse + (size_t)x * channels, row);
    }
}

void rn_reference_build(struct rn_reference *ref) {
    int levels = ref->config.levels;
    size_t plane_size = map_size(ref, 0, 0);
    for (int k = 0; k < ref->config.planes; k++) {
        memcpy(ref->maps + rn_reference_map_offset(ref, k, 0, 0), ref->planes + k * plane_size,
               plane_size * sizeof(double));
        for (int x = 0; x + 1 < levels; x++)
            between(ref, ref->maps, k, x, 0, true, pool_adapter);
        for (int y = 0; y + 1 < levels; y++)
            for (int x = 0; x < levels; x++)
                between(ref, ref->maps, k, x, y, false, pool_adapter);
    }
    for (size_t i = 0; ref->half && i < ref->map_count; i++)
        ref->maps[i] = half_of(ref->maps[i]);
}

static double smoothed(const double *texel, int channels, int size, int u, int v, double share) {
    double left = texel[u > 0 ? -channels : 0], right = texel[u + 1 < size ? channels : 0];
    double above = texel[v > 0 ? -size * channels : 0];
    double below = texel[v + 1 < size ? size * channels : 0];
    return *texel + share * (left + right + above + below - 4 * *texel);
}

void rn_reference_smooth(struct rn_reference *ref, double share) {
    int size = ref->config.base, channels = ref->config.channels;
    for (int odd = 0; odd < 2; odd++)
        for (int k = 0; k < ref->config.planes; k++)
            for (int v = 0; v < size; v++)
                for (int u = (v + odd) % 2; u < size; u += 2)
                    for (int c = 0; c < channels; c++) {
                        double *at = ref->planes + k * map_size(ref, 0, 0);
                        at += (size_t)(v * size + u) * (size_t)channels + (size_t)c;
                        *at = smoothed(at, channels, size, u, v, share);
                    }
}

void rn_reference_pull_down(struct rn_reference *ref) {
    int levels = ref->config.levels;
    size_t plane_size = map_size(ref, 0, 0);
    for (int k = 0; k < ref->config.planes; k++) {
        for (int y = levels - 2; y >= 0; y--)
            for (int x = 0; x < levels; x++)
                between(ref, ref->map_grad, k, x, y, false, unpool_adapter);
        for (int x = levels - 2; x >= 0; x--)
            between(ref, ref->map_grad, k, x, 0, true, unpool_adapter);
        const double *grad = ref->map_grad + rn_reference_map_offset(ref, k, 0, 0);
        for (size_t i = 0; i < plane_size; i++)
            ref->plane_grad[k * plane_size + i] += grad[i];
    }
    memset(ref->map_grad, 0, ref->map_count * sizeof(double));
}

// A sample as the planes see it: the Gaussian, and how its space is drawn there.
struct placed {
    double x[3]; // its mean, in the planes' frame
    struct rn_moments moments;
    bool contracted;
    double towards[3]; // from the centre to it
    struct rn_contraction lengths;
    double interval; // of optical depth, before RN_DENSITY_UNIT
    double reach;    // along the ray, in the planes' frame
};

static double dot3(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// In unbounded space a sample lies in the middle of its step, and its Gaussian is that of a uniform
// cylinder as long as the step is there.
static void place_unbounded(const struct rn_reference_ray *ray, double mid, struct placed *p) {
    double s = mid + dot3(ray->origin, ray->direction), stretch = rn_stretch_at(s);
    double width = 2 * ray->width * stretch, across = ray->radius * mid;
    for (int i = 0; i < 3; i++)
        p->x[i] = ray->origin[i] + ray->direction[i] * mid;
    double r = sqrt(dot3(p->x, p->x));
    p->lengths = rn_contraction_at(r);
    for (int i = 0; i < 3; i++) {
        p->towards[i] = r > 0 ? p->x[i] / r : 0;
        p->x[i] *= p->lengths.scale;
    }
    p->moments = (struct rn_moments){mid, width * width / 12, across * across / 4};
    p->interval = ray->width;
    p->reach = 0.5 * rn_place_of_distance(s);
    p->contracted = true;
}

static struct placed place(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                           double mid) {
    struct placed p = {.contracted = false};
    if (ref->config.space == RN_SPACE_UNBOUNDED) {
        place_unbounded(ray, mid, &p);
        return p;
    }
    p.moments = rn_frustum_moments(mid, ray->width, ray->radius);
    for (int i = 0; i < 3; i++)
        p.x[i] = ray->origin[i] + ray->direction[i] * p.moments.mean;
    p.interval = dot3(p.x, p.x) <= 1 ? ray->width : 0;
    p.reach = mid;
    return p;
}

// Variance along a plane's axis: of a contracted Gaussian along the Jacobian times the axis.
static double variance_along(const struct placed *p, const double axis[3], const double d[3]) {
    double y[3];
    if (!p->contracted) return rn_projected_variance(axis, d, p->moments.axial, p->moments.radial);
    rn_contracted_axis(&p->lengths, p->towards, axis, y);
    return rn_projected_variance(y, d, p->moments.axial, p->moments.radial);
}

void rn_reference_levels(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                         int plane, double mid, double *ret_lx, double *ret_ly) {
    const struct rn_field_config *config = &ref->config;
    int base = rn_footprint_base(config);
    *ret_lx = *ret_ly = 0;
    struct placed p = place(ref, ray, mid);
    double drawn = p.contracted ? cbrt(p.lengths.across * p.lengths.across * p.lengths.along) : 1;
    bool mip = config->footprint == RN_FOOTPRINT_MIP;
    if (mip)
        *ret_lx = *ret_ly = rn_level_from_ball(mid * ray->radius * drawn * base, config->levels);
    if (!rn_levels_by_axis(config)) return;
    double vu = variance_along(&p, ref->solid.axis_u[plane], ray->direction);
    double vv = variance_along(&p, ref->solid.axis_v[plane], ray->direction);
    *ret_lx = rn_level_from_variance(vu, base, config->levels);
    *ret_ly = rn_level_from_variance(vv, base, config->levels);
    if (mip) *ret_lx = *ret_ly = (*ret_lx + *ret_ly) / 2;
}

// Visits the up to 16 texels of a query: calls for each with its offset and weight.
struct corner {
    size_t offset;
    double weight;
};
static int query_corners(const struct rn_reference *ref, int plane, double u, double v, double lx,
                         double ly, struct corner corners[16]) {
    int n = 0, levels = ref->config.levels, channels = ref->config.channels;
    bool mip = ref->config.footprint == RN_FOOTPRINT_MIP;
    struct rn_lerp x = rn_rip_level(lx, levels), y = rn_rip_level(ly, levels);
    for (int i = 0; i < 4; i++) {
        int map_x = i & 1 ? x.high : x.low, map_y = i & 2 ? y.high : y.low;
        if (mip && (i == 1 || i == 2)) continue; // square maps only
        double weight = rn_rip_map_weight(&x, &y, mip, i);
        int w = rn_rip_size(ref->config.base, map_x), h = rn_rip_size(ref->config.base, map_y);
        struct rn_lerp a = rn_rip_lerp(u, w), b = rn_rip_lerp(v, h);
        size_t map = rn_reference_map_offset(ref, plane, map_x, map_y);
        for (int j = 0; j < 4; j++) {
            int column = j & 1 ? a.high : a.low, row = j & 2 ? b.high : b.low;
            corners[n].offset = map + ((size_t)row * w + column) * channels;
            corners[n].weight = weight * (j & 1 ? a.fraction : 1 - a.fraction) *
                                (j & 2 ? b.fraction : 1 - b.fraction);
            n++;
        }
    }
    return n;
}

void rn_reference_query(const struct rn_reference *ref, int plane, double u, double v, double lx,
                        double ly, double *ret_features) {
    struct corner corners[16];
    int n = query_corners(ref, plane, u, v, lx, ly, corners);
    for (int c = 0; c < ref->config.channels; c++) {
        double sum = 0;
        for (int i = 0; i < n; i++)
            sum += corners[i].weight * ref->maps[corners[i].offset + c];
        ret_features[c] = sum;
    }
}

void rn_reference_query_backward(struct rn_reference *ref, int plane, double u, double v, double lx,
                                 double ly, const double *feature_grad) {
    struct corner corners[16];
    int n = query_corners(ref, plane, u, v, lx, ly, corners);
    for (int i = 0; i < n; i++)
        for (int c = 0; c < ref->config.channels; c++)
            ref->map_grad[corners[i].offset + c] += corners[i].weight * feature_grad[c];
}

// Where a sample looks on a plane.
struct footing {
    double u, v, lx, ly;
};
static struct footing sample_footing(const struct rn_reference *ref,
                                     const struct rn_reference_ray *ray, int plane, double mid) {
    struct placed p = place(ref, ray, mid);
    struct footing f = {dot3(ref->solid.axis_u[plane], p.x), dot3(ref->solid.axis_v[plane], p.x), 0,
                        0};
    rn_reference_levels(ref, ray, plane, mid, &f.lx, &f.ly);
    return f;
}

// Of all grid's parameters, or of their gradients, the voxels'.
static double *voxels_of(const struct rn_reference *ref, double *planes) {
    return planes + (size_t)ref->config.planes * rn_grid_numbers(&ref->config);
}

void rn_reference_encode(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                         double mid, double *ret_features) {
    for (int k = 0; k < ref->config.planes; k++) {
        struct footing f = sample_footing(ref, ray, k, mid);
        rn_reference_query(ref, k, f.u, f.v, f.lx, f.ly, ret_features + k * ref->config.channels);
    }
    if (!ref->config.voxels) return;
    struct placed p = place(ref, ray, mid);
    rn_voxels_fetch(&ref->config, voxels_of(ref, ref->planes), p.x,
                    ret_features + ref->config.planes * ref->config.channels);
}

// Everything one ray's forward leaves for its backward.
struct tape {
    double *storage;
    double **base;                        // [sample * (layers + 1) + layer]: activations
    double **head;                        // the same; one set only with ray shading
    double **base_grad, **head_grad;      // one set each
    double *x, *weights, *after, *colour; // per sample; colour [3]
    double *interval, *reach;             // per sample: in density units; struct placed
    double sums[RN_GEOMETRY];             // ray shading: [_, D(3), F(12)]
    double opacity, depth, rgb[3];
};

static void tape_finish(struct tape *tape) {
    free(tape->storage);
    free(tape->base);
    free(tape->interval);
}

static enum rn_status tape_init(const struct rn_reference *ref, int n, struct tape *tape) {
    memset(tape, 0, sizeof *tape);
    const struct rn_mlp_shape *bs = &ref->base_shape, *hs = &ref->head_shape;
    int heads = ref->config.shading == RN_SHADING_RAY ? 1 : n;
    size_t base_rows = (size_t)n * (bs->layers + 1), head_rows = (size_t)heads * (hs->layers + 1);
    size_t rows = base_rows + head_rows + bs->layers + 1 + hs->layers + 1;
    size_t widest = bs->widest > hs->widest ? bs->widest : hs->widest;
    tape->storage = calloc(rows * widest + 6 * (size_t)n + 1, sizeof(double));
    tape->base = calloc(rows, sizeof(double *));
    tape->interval = calloc(2 * (size_t)n + 1, sizeof(double));
    tape->reach = tape->interval + n;
    if (!tape->storage || !tape->base || !tape->interval) {
        tape_finish(tape);
        return RN_ERROR_NO_MEMORY;
    }
    for (size_t i = 0; i < rows; i++)
        tape->base[i] = tape->storage + i * widest;
    tape->head = tape->base + base_rows;
    tape->base_grad = tape->head + head_rows;
    tape->head_grad = tape->base_grad + bs->layers + 1;
    tape->x = tape->storage + rows * widest;
    tape->weights = tape->x + n;
    tape->after = tape->weights + n;
    tape->colour = tape->after + n;
    return RN_OK;
}

static double sigmoid(double x) {
    return 1 / (1 + exp(-x));
}

static void set_directions(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                           double *inputs) {
    if (ref->config.view_dependence)
        rn_sh_encode(ray->direction, inputs);
    else
        memset(inputs, 0, RN_SH_COUNT * sizeof(double));
}

static void shade_samples(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                          struct tape *tape) {
    int base_out = ref->base_shape.layers, stride = ref->head_shape.layers + 1;
    for (int s = 0; s < ray->count; s++) {
        double **head = tape->head + s * stride;
        const double *geometry = tape->base[s * (base_out + 1) + base_out];
        set_directions(ref, ray, head[0]);
        memcpy(head[0] + RN_SH_COUNT, geometry + 1, 15 * sizeof(double));
        head[0][31] = 1;
        network_forward(ref, &ref->head_shape, ref->head, head);
        for (int c = 0; c < 3; c++) {
            tape->colour[3 * s + c] = sigmoid(head[stride - 1][c]);
            tape->rgb[c] += tape->weights[s] * tape->colour[3 * s + c];
        }
    }
}

static void shade_ray(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                      struct tape *tape) {
    int base_out = ref->base_shape.layers;
    for (int s = 0; s < ray->count; s++) {
        const double *geometry = tape->base[s * (base_out + 1) + base_out];
        for (int i = 1; i < RN_GEOMETRY; i++) {
            double value = i < 4 ? sigmoid(geometry[i]) : geometry[i];
            if (i < 4) tape->colour[3 * s + i - 1] = value;
            tape->sums[i] += tape->weights[s] * value;
        }
    }
    for (int c = 0; c < 3; c++)
        tape->rgb[c] = tape->sums[1 + c];
    if (!ref->config.view_dependence) return;
    double *inputs = tape->head[0];
    set_directions(ref, ray, inputs);
    memcpy(inputs + 16, tape->sums + 4, 12 * sizeof(double));
    memcpy(inputs + 28, tape->sums + 1, 3 * sizeof(double));
    inputs[31] = tape->opacity;
    network_forward(ref, &ref->head_shape, ref->head, tape->head);
    for (int c = 0; c < 3; c++)
        tape->rgb[c] += tape->opacity * tape->head[ref->head_shape.layers][c];
}

// Whether the last sample of a ray takes what shines through the others.
static bool ends_opaque(const struct rn_reference *ref, const struct rn_reference_ray *ray) {
    return ref->config.space == RN_SPACE_UNBOUNDED && ref->config.shading == RN_SHADING_RAY &&
           ray->count > 0 && !ray->cut;
}

static void forward(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                    struct tape *tape) {
    int layers = ref->base_shape.layers;
    for (int s = 0; s < ray->count; s++) {
        double **base = tape->base + s * (layers + 1);
        struct placed p = place(ref, ray, ray->mid[s]);
        tape->interval[s] = p.interval * RN_DENSITY_UNIT;
        tape->reach[s] = p.reach;
        rn_reference_encode(ref, ray, ray->mid[s], base[0]);
        network_forward(ref, &ref->base_shape, ref->base, base);
        tape->x[s] = rn_density(base[layers][0]) * tape->interval[s];
    }
    if (ends_opaque(ref, ray)) tape->x[ray->count - 1] = RN_OPAQUE;
    double depth = rn_composite(ray->count, tape->x, tape->weights, tape->after);
    tape->opacity = -expm1(-depth);
    for (int s = 0; s < ray->count; s++)
        tape->depth += tape->weights[s] * ray->mid[s];
    if (ref->config.shading == RN_SHADING_RAY)
        shade_ray(ref, ray, tape);
    else
        shade_samples(ref, ray, tape);
    rn_colour_seen(&ray->colour, tape->opacity, tape->rgb);
}

enum rn_status rn_reference_render(const struct rn_reference *ref,
                                   const struct rn_reference_ray *ray, double ret_rgb[3],
                                   double *ret_opacity, double *ret_depth) {
    struct tape tape;
    enum rn_status status = tape_init(ref, ray->count, &tape);
    if (status != RN_OK) return status;
    forward(ref, ray, &tape);
    memcpy(ret_rgb, tape.rgb, sizeof tape.rgb);
    *ret_opacity = tape.opacity;
    *ret_depth = tape.depth;
    tape_finish(&tape);
    return RN_OK;
}

// dL/d(weight of sample s) and dL/d(geometry) with sample shading.
static double backward_sample_shade(struct rn_reference *ref, struct tape *tape, int s,
                                    const double rgb_grad[3], double *geometry_grad) {
    int layers = ref->head_shape.layers;
    double g = 0;
    memset(tape->head_grad[layers], 0, RN_HEAD_OUTPUTS * sizeof(double));
    for (int c = 0; c < 3; c++) {
        double colour = tape->colour[3 * s + c];
        g += rgb_grad[c] * colour;
        tape->head_grad[layers][c] = rgb_grad[c] * tape->weights[s] * colour * (1 - colour);
    }
    rn_mlp_backward(&ref->head_shape, ref->head, tape->head + s * (layers + 1), tape->head_grad,
                    ref->head_grad);
    memcpy(geometry_grad + 1, tape->head_grad[0] + RN_SH_COUNT, 15 * sizeof(double));
    return g;
}

// dL/d(sums) and dL/d(opacity) with ray shading.
static double backward_ray_head(struct rn_reference *ref, struct tape *tape,
                                const double rgb_grad[3], double sums_grad[RN_GEOMETRY]) {
    memset(sums_grad, 0, RN_GEOMETRY * sizeof(double));
    for (int c = 0; c < 3; c++)
        sums_grad[1 + c] = rgb_grad[c];
    if (!ref->config.view_dependence) return 0;
    int layers = ref->head_shape.layers;
    double opacity_grad = 0;
    memset(tape->head_grad[layers], 0, RN_HEAD_OUTPUTS * sizeof(double));
    for (int c = 0; c < 3; c++) {
        tape->head_grad[layers][c] = rgb_grad[c] * tape->opacity;
        opacity_grad += rgb_grad[c] * tape->head[layers][c];
    }
    rn_mlp_backward(&ref->head_shape, ref->head, tape->head, tape->head_grad, ref->head_grad);
    const double *inputs_grad = tape->head_grad[0];
    for (int i = 0; i < 12; i++)
        sums_grad[4 + i] += inputs_grad[16 + i];
    for (int c = 0; c < 3; c++)
        sums_grad[1 + c] += inputs_grad[28 + c];
    return opacity_grad + inputs_grad[31];
}

static double backward_ray_shade(const struct rn_reference *ref, const struct tape *tape, int s,
                                 const double *sums_grad, double opacity_grad,
                                 double *geometry_grad) {
    const double *geometry = tape->base[s * (ref->base_shape.layers + 1) + ref->base_shape.layers];
    double g = opacity_grad;
    for (int i = 1; i < RN_GEOMETRY; i++) {
        double value = i < 4 ? tape->colour[3 * s + i - 1] : geometry[i];
        double slope = i < 4 ? value * (1 - value) : 1;
        g += sums_grad[i] * value;
        geometry_grad[i] = sums_grad[i] * tape->weights[s] * slope;
    }
    return g;
}

// The distortion loss over all pairs (Barron et al. 2022, equation 15), times `factor`; its
// dL/dw is added to g.
static double distort(const struct rn_reference_ray *ray, const struct tape *tape, double factor,
                      double *g) {
    double loss = 0;
    for (int i = 0; i < ray->count; i++) {
        double slope = 2.0 / 3 * tape->weights[i] * ray->width;
        loss += tape->weights[i] * tape->weights[i] * ray->width / 3;
        for (int j = 0; j < ray->count; j++) {
            double apart = fabs(tape->reach[i] - tape->reach[j]);
            loss += tape->weights[i] * tape->weights[j] * apart;
            slope += 2 * tape->weights[j] * apart;
        }
        g[i] += factor * slope;
    }
    return factor * loss;
}

// `grad`: dL/d(composited colour), and dL/d(opacity) but for what comes through the colour network.
static enum rn_status backward(struct rn_reference *ref, const struct rn_reference_ray *ray,
                               struct tape *tape, const double grad[4], double distortion,
                               double *ret_distortion) {
    int layers = ref->base_shape.layers, n = ray->count;
    double *g = calloc((size_t)n * (1 + RN_GEOMETRY) + 1, sizeof *g);
    if (!g) return RN_ERROR_NO_MEMORY;
    double *geometry = g + n, sums_grad[RN_GEOMETRY], opacity_grad = 0;
    bool per_ray = ref->config.shading == RN_SHADING_RAY;
    if (per_ray) opacity_grad = backward_ray_head(ref, tape, grad, sums_grad);
    for (int s = 0; s < n; s++) {
        double *out = geometry + (size_t)s * RN_GEOMETRY;
        g[s] = grad[3];
        g[s] += per_ray ? backward_ray_shade(ref, tape, s, sums_grad, opacity_grad, out)
                        : backward_sample_shade(ref, tape, s, grad, out);
    }
    *ret_distortion = distort(ray, tape, distortion, g);
    rn_composite_backward(n, tape->weights, tape->after, g, g);
    for (int s = 0; s < n; s++) {
        double **base = tape->base + s * (layers + 1);
        double *out = tape->base_grad[layers];
        memcpy(out, geometry + (size_t)s * RN_GEOMETRY, RN_GEOMETRY * sizeof(double));
        out[0] = g[s] * tape->interval[s] * rn_density_slope(base[layers][0]);
        rn_mlp_backward(&ref->base_shape, ref->base, base, tape->base_grad, ref->base_grad);
        for (int k = 0; k < ref->config.planes; k++) {
            struct footing f = sample_footing(ref, ray, k, ray->mid[s]);
            rn_reference_query_backward(ref, k, f.u, f.v, f.lx, f.ly,
                                        tape->base_grad[0] + k * ref->config.channels);
        }
        if (!ref->config.voxels) continue;
        struct placed p = place(ref, ray, ray->mid[s]);
        rn_voxels_fetch_backward(&ref->config, voxels_of(ref, ref->plane_grad), p.x,
                                 tape->base_grad[0] + ref->config.planes * ref->config.channels);
    }
    free(g);
    return RN_OK;
}

RN_LOSS_FUNCTION(loss_of, struct rn_reference_ray, double, double)

// Loss of one pixel, the mean of `n` rays that are not all empty, and its gradients.
static enum rn_status pixel_loss(struct rn_reference *ref, const struct rn_reference_ray *rays,
                                 int n, double total_weight, struct tape *tapes, double *loss) {
    double rgb[3] = {0, 0, 0}, opacity = 0, grad[4];
    enum rn_status status = RN_OK;
    for (int r = 0; r < n && status == RN_OK; r++) {
        status = tape_init(ref, rays[r].count, &tapes[r]);
        if (status == RN_OK && rays[r].count > 0) forward(ref, &rays[r], &tapes[r]);
        opacity += tapes[r].opacity / n;
        for (int c = 0; c < 3; c++)
            rgb[c] +=
                (rays[r].count > 0 ? tapes[r].rgb[c] : (double)rays[r].colour.background[c]) / n;
    }
    *loss += rays->weight * loss_of(&rays->colour, rays, rgb, opacity, grad);
    for (int c = 0; c < 4; c++)
        grad[c] /= total_weight * n;
    for (int r = 0; r < n && status == RN_OK; r++) {
        double distortion = ref->distortion_loss * rays->weight / total_weight / n, own = 0;
        double of_ray[4];
        memcpy(of_ray, grad, sizeof of_ray);
        rn_colour_back(&rays[r].colour, of_ray);
        if (rays[r].count > 0)
            status = backward(ref, &rays[r], &tapes[r], of_ray, distortion, &own);
        *loss += own * total_weight;
    }
    return status;
}

static bool any_samples(const struct rn_reference_ray *rays, int n) {
    bool any = false;
    for (int r = 0; r < n; r++)
        any |= rays[r].count > 0;
    return any;
}

enum rn_status rn_reference_loss(struct rn_reference *ref, const struct rn_reference_ray *rays,
                                 size_t count, double *ret_loss) {
    double total_weight = 0, loss = 0;
    int n = ref->pixel_rays;
    for (size_t r = 0; r < count; r += (size_t)n)
        if (any_samples(rays + r, n)) total_weight += rays[r].weight;
    struct tape *tapes = calloc((size_t)n, sizeof *tapes);
    enum rn_status status = tapes ? RN_OK : RN_ERROR_NO_MEMORY;
    for (size_t r = 0; r < count && total_weight > 0 && status == RN_OK; r += (size_t)n) {
        if (!any_samples(rays + r, n)) continue;
        status = pixel_loss(ref, rays + r, n, total_weight, tapes, &loss);
        for (int i = 0; i < n; i++)
            tape_finish(&tapes[i]);
        memset(tapes, 0, (size_t)n * sizeof *tapes);
    }
    free(tapes);
    if (status != RN_OK) return status;
    rn_reference_pull_down(ref);
    *ret_loss = total_weight > 0 ? loss / total_weight : 0;
    return RN_OK;
}

void rn_reference_adamw(size_t n, double *parameter, const double *grad, double *m, double *v,
                        double rate, double decay, double eps, int64_t step) {
    // log1p: 1 - 0.999 as float64 has it is 4 ULP from 0.001.
    double c1 = -expm1((double)step * log1p(-0.1)), c2 = -expm1((double)step * log1p(-0.001));
    for (size_t i = 0; i < n; i++) {
        m[i] = 0.9 * m[i] + 0.1 * grad[i];
        v[i] = 0.999 * v[i] + 0.001 * grad[i] * grad[i];
        parameter[i] -= rate * (decay * parameter[i] + (m[i] / c1) / (sqrt(v[i] / c2) + eps));
    }
}
