// One kernel set's fp32 vector code as a subject: the whole of kernel_set.c is compiled here once
// more, with the set's flags, so that its inner functions can be called. RN_KERNEL_SET names the
// copy's table, SUBJECT the set.
#include "server/engine/cpu/kernel_set.c"

#include "common/math/camera.h"
#include "tests/numerics/subject.h"

static float lane0(vf x) {
    return x[0];
}

static double nearest(double x) {
    return (double)(float)x;
}

static void moments(double mid, double width, double radius, double ret[3]) {
    vf t = vf_set((float)mid), shift, axial, radial;
    float half = 0.5f * (float)width;
    frustum_lanes(t, frustum_ratio(t, half), half, (float)radius, &shift, &axial, &radial);
    ret[0] = (double)lane0(vf_set((float)mid) + shift);
    ret[1] = (double)lane0(axial);
    ret[2] = (double)lane0(radial);
}

static double variance(const double axis[3], const double d[3], double axial, double radial) {
    float direction[3] = {(float)d[0], (float)d[1], (float)d[2]}, along, across;
    footprint_factors(axis, direction, &along, &across);
    return (double)lane0(vf_set((float)axial) * along + vf_set((float)radial) * across);
}

static double level(double v, int size, int levels) {
    return (double)lane0(level_from_variance(vf_set((float)v), size, levels));
}

static int taps(int size, int i, int *ret_first, double weight[3]) {
    float own[3];
    int count = taps_of(size, i, ret_first, own);
    for (int t = 0; t < 3; t++)
        weight[t] = (double)own[t];
    return count;
}

static void lerp(double p, int size, int *ret_low, int *ret_high, double *ret_fraction) {
    vi low;
    vf fraction;
    lerp_vector(vf_set((float)p), size, &low, &fraction);
    *ret_low = low[0];
    *ret_high = low[0] + (size > 1);
    *ret_fraction = (double)fraction[0];
    struct axis_lookup same; // the pyramid's own at level 0
    look_up_axis(vf_set((float)p), vf_set(0), size, &same);
    if (same.low[0][0] != low[0] || same.fraction[0][0] != fraction[0]) *ret_low = -1;
}

// One ray of up to SUBJECT_MAX_SAMPLES samples in a workspace of its own.
#define ROOM (SUBJECT_MAX_SAMPLES + RN_PACKET_SLACK)
static uint8_t ray_of[ROOM];
static float x_of[ROOM], before_of[ROOM], weight_of[ROOM], after_of[ROOM], slope_of[ROOM];
static float interval_of[ROOM], geometry_of[ROOM * RN_GEOMETRY];
static int32_t start_of[ROOM];
static int16_t size_of[ROOM], next_of[ROOM];

static void one_ray(int n, struct rn_workspace *w) {
    memset(w, 0, sizeof *w);
    w->segment_start = start_of;
    w->segment_size = size_of;
    w->segment_next = next_of;
    w->ray = ray_of;
    w->x = x_of;
    w->before = before_of;
    w->weight = weight_of;
    w->after = after_of;
    w->slope = slope_of;
    w->interval = interval_of;
    w->geometry = geometry_of;
    w->count = n;
    for (int start = 0; start < n; start += RN_ROUND) {
        int s = w->segment_count++;
        start_of[s] = start;
        size_of[s] = (int16_t)(n - start < RN_ROUND ? n - start : RN_ROUND);
        next_of[s] = (int16_t)(start + RN_ROUND < n ? s + 1 : -1);
    }
}

static double density_of(double logit) {
    struct rn_workspace w;
    struct rn_field_config config = {.shading = RN_SHADING_SAMPLE};
    struct rn_cpu_field field = {.config = &config};
    one_ray(1, &w);
    interval_of[0] = 1;
    geometry_of[0] = (float)logit;
    activate(&field, 0, 1, &w);
    return (double)x_of[0];
}

static double alpha(double x) {
    return (double)lane0(vf_one_minus_exp(vf_set((float)x)));
}

static double composite(int n, const double *x, double *weights, double *after) {
    struct rn_workspace w;
    struct rn_march_options options = {.stop_depth = INFINITY};
    one_ray(n, &w);
    for (int i = 0; i < n; i++)
        x_of[i] = (float)x[i];
    round_attenuate(0, &w);
    finish_weights(&options, &w);
    for (int i = 0; i < n; i++) {
        weights[i] = (double)weight_of[i];
        after[i] = (double)after_of[i];
    }
    return (double)(float)w.ray_depth[0];
}

static void composite_stopped(int n, const double *x, double stop_depth, double *weights) {
    struct rn_workspace w;
    struct rn_march_options options = {.stop_depth = (float)stop_depth};
    one_ray(n, &w);
    for (int i = 0; i < n; i++)
        x_of[i] = (float)x[i];
    round_attenuate(0, &w);
    finish_weights(&options, &w);
    for (int i = 0; i < n; i++)
        weights[i] = (double)weight_of[i];
}

static void composite_back(int n, const double *weights, const double *after, const double *g,
                           double *grad) {
    struct rn_workspace w;
    one_ray(n, &w);
    for (int i = 0; i < n; i++) {
        weight_of[i] = (float)weights[i];
        after_of[i] = (float)after[i];
        slope_of[i] = (float)g[i];
    }
    composite_backward(0, &w);
    for (int i = 0; i < n; i++)
        grad[i] = (double)slope_of[i];
}

// In the last of a vector's rows and one more.
static void contraction(double r, double ret[3]) {
    struct contraction_lanes c = contraction_at(vf_set((float)r));
    ret[0] = (double)lane0(c.scale);
    ret[1] = (double)lane0(c.across);
    ret[2] = (double)lane0(c.along);
}

static double distance_at(double place) {
    return (double)lane0(distance_of_place(vf_set((float)place)));
}

static void harmonics(const double d[3], double ret[16]) {
    static float rows[RN_VL + 1][RN_HEAD_INPUTS];
    for (int i = 0; i < 3; i++)
        rows[RN_VL][i] = (float)d[i];
    encode_directions(RN_VL + 1, RN_SH_COUNT, rows[0]);
    for (int i = 0; i < RN_SH_COUNT; i++)
        ret[i] = (double)rows[RN_VL][i];
}

static void query(const struct rn_cpu_field *field, int n, const float *u, const float *v,
                  const float *lx, const float *ly, float *ret_features) {
    static float features[(SUBJECT_QUERIES + 16) * 16];
    struct rn_workspace w = {.features = features};
    w.u[0] = (float *)u;
    w.v[0] = (float *)v;
    w.lx[0] = (float *)lx;
    w.ly[0] = (float *)ly;
    encode(field, true, 0, n, &w);
    for (int i = 0; i < n; i++)
        get_features(field, i, &w, ret_features + i * field->config->channels);
}

static void voxels_at(const struct rn_cpu_field *field, int n, float *const place[3],
                      float *ret_features) {
    struct voxels grid = voxels_of(field->config, &field->maps[field->config->planes][0][0]);
    encode_voxels(&grid, place, 0, n, ret_features, RN_VOXEL_CHANNELS);
}

// In the last lane; the others look elsewhere.
static void cut(const struct rn_ray *ray, double step, struct rn_march_ray *ret) {
    enum { LAST = RN_VD - 1 };
    vd o[3], d[3];
    struct cut_lanes got;
    for (int i = 0; i < 3; i++) {
        o[i] = vd_set(0.25);
        d[i] = vd_set(i == 1);
        o[i][LAST] = ray->origin[i];
        d[i][LAST] = ray->direction[i];
    }
    cut_rays(o, d, vd_set(ray->radius), step, false, vd_set(0), &got);
    ret->near = (float)got.near[LAST];
    ret->length = (float)got.length[LAST];
    for (int i = 0; i < 3; i++) {
        ret->origin[i] = (float)got.origin[i][LAST];
        ret->direction[i] = (float)d[i][LAST];
    }
}

static void cut_to_box(const struct rn_disparity *box, const struct rn_ray *ray, double step,
                       struct rn_march_ray *ret) {
    enum { LAST = RN_VD - 1 };
    vd o[3], d[3];
    struct cut_lanes got;
    for (int i = 0; i < 3; i++) {
        o[i] = vd_set(0);
        d[i] = vd_set(i == 2);
        o[i][LAST] = ray->origin[i];
        d[i][LAST] = ray->direction[i];
    }
    cut_forward(box, o, d, step, vd_set(0), &got);
    *ret = (struct rn_march_ray){.near = (float)got.near[LAST],
                                 .length = (float)got.length[LAST],
                                 .radius = (float)ray->radius,
                                 .stride = 1};
    for (int i = 0; i < 3; i++) {
        ret->origin[i] = (float)got.origin[i][LAST];
        ret->direction[i] = (float)d[i][LAST];
    }
}

static void distortion(int n, const double *weights, const double *places, double width,
                       double factor, double *grad) {
    static float marched[ROOM];
    static const struct rn_cpu_field field = {.disparity = {.on = true}};
    struct rn_workspace w;
    one_ray(n, &w);
    w.marched = marched;
    for (int i = 0; i < n; i++) {
        weight_of[i] = (float)weights[i];
        marched[i] = (float)places[i];
        slope_of[i] = 0;
    }
    distort(&field, 0, factor, width, &w);
    for (int i = 0; i < n; i++)
        grad[i] = (double)slope_of[i];
}

// A ray's samples, `ahead` at a time, from a place of its own among rays that have none.
static int march_ahead(const struct rn_occupancy_bits *grid, const struct rn_march_ray *ray,
                       float step, int ahead, uint16_t *ret_k) {
    static struct marches m;
    int place = ray->stride * 13;
    struct rn_march_ray rays[RN_VL];
    struct rn_workspace w = {.candidate = ret_k}; // one row
    memset(&m, 0, sizeof m);
    memset(rays, 0, sizeof rays);
    rays[place % RN_VL] = *ray;
    m.ray[place] = ray;
    m.last[place] = -1;
    march_start(grid, rays, RN_VL, step, &m.lanes[place / RN_VL]);
    for (;;) {
        march_round(grid, step, ahead, &m, &w);
        if (w.ray_next[place] == w.candidate_count[place]) return w.ray_next[place];
        w.ray_next[place] = w.candidate_count[place];
    }
}

// All of a ray's samples; room + 1 where listing them in rounds finds others.
static int march(const struct rn_occupancy_bits *grid, const struct rn_march_ray *ray, float step,
                 uint16_t *ret_k, int room) {
    static uint16_t found[65536 + RN_CHUNK], again[65536 + RN_CHUNK];
    int n = march_ahead(grid, ray, step, 65536, found);
    int same = march_ahead(grid, ray, step, RN_ROUND, again);
    if (n != same || memcmp(found, again, (size_t)n * sizeof *found) != 0) return room + 1;
    if (n > room) n = room;
    memcpy(ret_k, found, (size_t)n * sizeof *ret_k);
    return n;
}

static int cell(const struct rn_cpu_field *field, const struct rn_march_ray *ray, double s) {
    return cells_at(field, ray, vf_set((float)s))[RN_VL - 1];
}

extern const struct subject SUBJECT;
const struct subject SUBJECT = {.name = SUBJECT_NAME,
                                .digits = 24,
                                .fast = true,
                                .nearest = nearest,
                                .moments = moments,
                                .variance = variance,
                                .level = level,
                                .taps = taps,
                                .lerp = lerp,
                                .density = density_of,
                                .alpha = alpha,
                                .composite = composite,
                                .composite_backward = composite_back,
                                .contraction = contraction,
                                .distance_of_place = distance_at,
                                .harmonics = harmonics,
                                .composite_stopped = composite_stopped,
                                .query = query,
                                .voxels = voxels_at,
                                .cut = cut,
                                .cut_forward = cut_to_box,
                                .distortion = distortion,
                                .march = march,
                                .cell = cell};
