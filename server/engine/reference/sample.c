// Where a sample lies and how large it is, what the planes and voxels have there, and the adjoint.
#include <math.h>

#include "server/engine/field/footprint.h"
#include "server/engine/field/frustum.h"
#include "server/engine/field/ripmap.h"
#include "server/engine/field/space.h"
#include "server/engine/field/volume.h"
#include "server/engine/reference/tape.h"
#include "server/engine/reference/voxels.h"

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

void rn_reference_extent(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                         double mid, double *ret_interval, double *ret_reach) {
    struct placed p = place(ref, ray, mid);
    *ret_interval = p.interval * RN_DENSITY_UNIT;
    *ret_reach = p.reach;
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

void rn_reference_encode_backward(struct rn_reference *ref, const struct rn_reference_ray *ray,
                                  double mid, const double *feature_grad) {
    for (int k = 0; k < ref->config.planes; k++) {
        struct footing f = sample_footing(ref, ray, k, mid);
        rn_reference_query_backward(ref, k, f.u, f.v, f.lx, f.ly,
                                    feature_grad + k * ref->config.channels);
    }
    if (!ref->config.voxels) return;
    struct placed p = place(ref, ray, mid);
    rn_voxels_fetch_backward(&ref->config, voxels_of(ref, ref->plane_grad), p.x,
                             feature_grad + ref->config.planes * ref->config.channels);
}
