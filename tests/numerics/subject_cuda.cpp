// The GPU's kernels as a subject: their own functions, compiled for the emulator of tests/ops, in
// which the machine's approximate functions are as far off as they may be.
#include "server/engine/cuda/loss.cuh"
#include "server/engine/cuda/optimise.cuh"
#include "server/engine/cuda/step.cuh"

extern "C" {
#include "tests/numerics/subject.h"
#include "tests/numerics/subject_cuda.h"
}

// ---- numbers --------------------------------------------------------------------------------

static double nearest(double x) {
    return (double)(float)x;
}

static void moments(double mid, double width, double radius, double ret[3]) {
    struct rn_march_ray ray = {};
    ray.direction[0] = 1;
    ray.radius = (float)radius;
    struct rn_sample s = rn_place<RN_WORLD_BALL>(&ray, NULL, (float)mid, (float)width);
    ret[0] = (double)s.x;
    ret[1] = (double)s.axial;
    ret[2] = (double)s.radial;
}

static double variance(const double axis[3], const double d[3], double axial, double radial) {
    float axes[6], direction[3];
    for (int i = 0; i < 3; i++) {
        axes[i] = axes[3 + i] = (float)axis[i];
        direction[i] = (float)d[i];
    }
    struct rn_footprint_factors f = rn_factors(axes, direction);
    return (double)((float)axial * f.axial_v + (float)radial * f.radial_v);
}

// A sample whose footprint on both axes is what is asked for.
static double level_of(const struct rn_sample *sample, enum rn_footprint footprint, int size,
                       int levels) {
    static struct rn_cuda_planes planes;
    struct rn_footprint_factors f = {1, 0, 1, 0};
    struct rn_march_ray ray = {};
    float lx, ly;
    ray.radius = 1;
    planes.footprint = footprint;
    planes.footprint_base = size;
    planes.levels = levels;
    planes.by_axis = footprint == RN_FOOTPRINT_RIP;
    rn_levels<RN_WORLD_BALL>(&planes, 0, &f, sample, &ray, &lx, &ly);
    return lx == ly ? (double)lx : NAN;
}

static double level(double v, int size, int levels) {
    struct rn_sample sample = {0, 0, 0, 0, (float)v, 0, 0};
    return level_of(&sample, RN_FOOTPRINT_RIP, size, levels);
}

static double ball_level(double ball, int size, int levels) {
    struct rn_sample sample = {0, 0, 0, (float)ball, 0, 0, 0};
    return level_of(&sample, RN_FOOTPRINT_MIP, size, levels);
}

static void lerp(double p, int size, int *ret_low, int *ret_high, double *ret_fraction) {
    struct rn_texel t = rn_find_texel((float)p, size);
    *ret_low = t.low;
    *ret_high = t.low + (size > 1);
    *ret_fraction = (double)t.fraction;
}

static void contraction(double r, double ret[3]) {
    struct rn_contraction_lane c = rn_contraction_at_lane((float)r);
    ret[0] = (double)c.scale;
    ret[1] = (double)c.across;
    ret[2] = (double)c.along;
}

static double distance_of_place(double place) {
    return (double)rn_distance_of_place_lane((float)place);
}

static double density(double logit) {
    return (double)rn_density_float((float)logit);
}

static double alpha(double x) {
    return (double)rn_alpha_float((float)x);
}

// ---- compositing ----------------------------------------------------------------------------

// One ray by one warp, sixteen samples a tile.
#define ROOM (SUBJECT_MAX_SAMPLES + RN_TILE)
static float x_of[ROOM], weight_of[ROOM], after_of[ROOM], slope_of[ROOM], ones[ROOM];

static void narrow(int n, const double *from, float *to) {
    for (int i = 0; i < ROOM; i++)
        to[i] = i < n ? (float)from[i] : 0;
}
static void widen(int n, const float *from, double *to) {
    for (int i = 0; i < n; i++)
        to[i] = (double)from[i];
}

static double attenuate(int n, const double *x, float stop_depth) {
    double depth = 0;
    narrow(n, x, x_of);
    emu::launch("a ray", 1, RN_LANES, 0, [&] {
        double own = 0;
        for (int first = 0; first < n; first += RN_TILE) {
            int i = first + RN_LANE % RN_TILE;
            struct rn_shaded s = {x_of[i], 0, 0, 0};
            rn_attenuate(stop_depth, &own, &s);
            if (RN_LANE >= RN_TILE) continue;
            weight_of[i] = s.weight;
            after_of[i] = s.after;
        }
        if (RN_LANE == 0) depth = own;
    });
    return (double)(float)depth;
}

static double composite(int n, const double *x, double *weights, double *after) {
    double depth = attenuate(n, x, INFINITY);
    widen(n, weight_of, weights);
    widen(n, after_of, after);
    return depth;
}

static void composite_stopped(int n, const double *x, double stop_depth, double *weights) {
    attenuate(n, x, (float)stop_depth);
    widen(n, weight_of, weights);
}

static void composite_backward(int n, const double *weights, const double *after, const double *g,
                               double *grad) {
    struct rn_cuda_batch batch = {};
    narrow(n, weights, weight_of);
    narrow(n, after, after_of);
    narrow(n, g, slope_of);
    std::fill(ones, ones + ROOM, 1.0f); // the depth, by which the kernel goes on to the logit
    batch.weight = weight_of;
    batch.after = after_of;
    batch.depth = ones;
    emu::launch("a ray", 1, RN_LANES, 0, [&] {
        double behind = 0;
        for (int first = (n - 1) / RN_TILE * RN_TILE; first >= 0; first -= RN_TILE) {
            size_t i = (size_t)(first + RN_LANE % RN_TILE);
            float slope = slope_of[i];
            float own = rn_attenuate_backward(&batch, i, slope, &behind);
            if (RN_LANE < RN_TILE) slope_of[i] = own;
        }
    });
    widen(n, slope_of, grad);
}

// ---- the optimiser --------------------------------------------------------------------------

static bool adamw(const struct rn_adamw *o, size_t n, float *parameter, float *grad, float *m,
                  float *v) {
    struct rn_adam a = {(float)((double)o->rate / (double)o->correction1),
                        o->rate * o->decay,
                        (float)(1 / sqrt((double)o->correction2)),
                        o->eps,
                        o->keep,
                        o->fresh};
    bool finite = true;
    for (size_t i = 0; i < n; i++) {
        finite &= rn_adamw(&a, grad[i] * o->scale, parameter + i, m + i, v + i);
        grad[i] = 0;
    }
    return finite;
}

// ---- a plane --------------------------------------------------------------------------------

struct cuda_plane {
    struct rn_cuda_scene scene;
    struct rn_cuda_gradients gradients;
    std::vector<uint16_t> maps;
    std::vector<uint2> half;
    std::vector<unsigned long long> fixed;
    std::vector<uint8_t> touched;
    std::vector<float4> parameters;
};

struct cuda_plane *cuda_plane_create(const struct rn_field_config *config, const float *texels) {
    struct cuda_plane *p = new cuda_plane();
    struct rn_cuda_planes *planes = &p->scene.planes;
    static const struct rn_solid solid = {};
    rn_cuda_planes_init(planes, config, &solid, config->levels);
    size_t numbers = (size_t)planes->plane_texels * (size_t)planes->channels;
    size_t first = (size_t)planes->base * (size_t)planes->base * (size_t)planes->channels;
    p->maps.resize(numbers);
    p->half.resize(numbers / 4);
    p->fixed.resize(numbers);
    p->touched.resize((size_t)(planes->update_side * planes->update_side));
    p->parameters.resize(first / 4);
    memcpy(p->parameters.data(), texels, first * sizeof *texels);
    p->scene.texels = p->maps.data();
    p->scene.parameters = (float *)p->parameters.data();
    p->gradients.half = p->half.data();
    p->gradients.fixed = p->fixed.data();
    p->gradients.touched = p->touched.data();
    struct rn_cuda_gradients none = {};
    const struct rn_cuda_scene scene = p->scene;
    unsigned blocks = (unsigned)(planes->update_side * planes->update_side);
    emu::launch("maps", blocks, (unsigned)(RN_UPDATE * RN_UPDATE * planes->channels / 4), 0,
                [&] { rn_build_kernel(scene); });
    emu::launch("coarse maps", 2, 256, 0, [&] { rn_coarse_kernel<false>(scene, none); });
    return p;
}

void cuda_plane_destroy(struct cuda_plane **plane) {
    delete *plane;
    *plane = NULL;
}

int cuda_plane_levels(const struct cuda_plane *plane) {
    return plane->scene.planes.levels;
}

bool cuda_plane_has(const struct cuda_plane *plane, int lx, int ly) {
    return rn_cuda_map_exists(plane->scene.planes.footprint, lx, ly);
}

static size_t place_of(const struct cuda_plane *plane, int lx, int ly, int x, int y, int channel) {
    const struct rn_cuda_planes *p = &plane->scene.planes;
    size_t texel = p->map[ly][lx] + (size_t)(y * (p->base >> lx) + x);
    return texel * (size_t)p->channels + (size_t)channel;
}

double cuda_plane_texel(const struct cuda_plane *plane, int lx, int ly, int x, int y, int channel) {
    return (double)rn_low(plane->maps[place_of(plane, lx, ly, x, y, channel)]);
}

// On a plane that spans x and y.
static struct rn_query query_of(const struct cuda_query *q) {
    struct rn_cuda_planes planes = {};
    struct rn_sample s = {q->u, q->v, 0, 0, 0, 0, 0};
    planes.axis[0][0] = planes.axis[0][4] = 1;
    return rn_query_plane(&planes, 0, &s, q->lx, q->ly);
}

template <int C>
static void fetch(const struct cuda_plane *plane, const struct cuda_query *query, float *ret) {
    const struct rn_cuda_planes *p = &plane->scene.planes;
    const struct rn_query both[2] = {query_of(query), query_of(query)};
    for (int channel = 0; channel < p->channels; channel += C) {
        const struct rn_fetch_place place = {p, plane->maps.data(), 0, channel};
        float sum[2][C] = {};
        for (int corner = 0; corner < 4; corner++) {
            float weight = rn_corner_weight(&both[0], p->footprint, corner);
            const float of_map[2] = {weight, weight};
            rn_fetch_corner<C>(&place, both, corner, of_map, sum);
        }
        memcpy(ret + channel, sum[1], sizeof sum[1]);
    }
}

void cuda_plane_fetch(const struct cuda_plane *plane, const struct cuda_query *query, float *ret) {
    (plane->scene.planes.channels % 8 == 0 ? fetch<8> : fetch<4>)(plane, query, ret);
}

template <bool FIXED>
static void scatter(struct cuda_plane *plane, int n, const struct cuda_query *queries,
                    const float *grad) {
    const struct rn_cuda_planes *p = &plane->scene.planes;
    int parts = p->channels / 4;
    for (int part = 0; part < 4 * parts; part++) {
        const struct rn_scatter_place place = {p, &plane->gradients, 0, part % parts * 4};
        struct rn_nest nest = rn_nest_start();
        for (int i = 0; i <= n; i++) {
            struct rn_query q = query_of(&queries[i < n ? i : n - 1]);
            float own[4];
            memcpy(own, grad + (size_t)(i < n ? i : 0) * (size_t)p->channels + place.channel,
                   sizeof own);
            rn_spread<FIXED>(&place, &q, part / parts, own, i == n, &nest);
        }
    }
}

void cuda_plane_scatter(struct cuda_plane *plane, int n, const struct cuda_query *queries,
                        const float *grad, bool fixed) {
    (fixed ? scatter<true> : scatter<false>)(plane, n, queries, grad);
}

double cuda_plane_gradient(const struct cuda_plane *plane, int lx, int ly, int x, int y,
                           int channel, bool fixed) {
    size_t at = place_of(plane, lx, ly, x, y, channel);
    float found[4] = {};
    if (fixed)
        rn_load_gradient<true>(&plane->gradients, at / 4 * 4, found);
    else
        rn_load_gradient<false>(&plane->gradients, at / 4 * 4, found);
    return (double)found[at % 4];
}

bool cuda_plane_is_touched(const struct cuda_plane *plane, int x, int y) {
    int side = plane->scene.planes.update_side;
    return plane->touched[(size_t)(y / RN_UPDATE * side + x / RN_UPDATE)] != 0;
}

double cuda_feature(float sum) {
    return (double)rn_low(rn_pack(sum, 0));
}

float cuda_number_of_half(uint32_t half) {
    return rn_from_half(half);
}

// ---- tables ---------------------------------------------------------------------------------

static struct subject make_subject() {
    struct subject s = {};
    s.name = "cuda";
    s.digits = 24;
    s.fast = s.device = true;
    s.nearest = nearest;
    s.moments = moments;
    s.variance = variance;
    s.level = level;
    s.ball_level = ball_level;
    s.lerp = lerp;
    s.density = density;
    s.alpha = alpha;
    s.composite = composite;
    s.composite_backward = composite_backward;
    s.composite_stopped = composite_stopped;
    s.contraction = contraction;
    s.distance_of_place = distance_of_place;
    return s;
}

static struct rn_kernels make_kernels() {
    struct rn_kernels k = {};
    k.name = "cuda";
    k.adamw = adamw;
    return k;
}

extern "C" {
extern const struct subject subject_cuda;
extern const struct rn_kernels subject_cuda_kernels;
const struct subject subject_cuda = make_subject();
const struct rn_kernels subject_cuda_kernels = make_kernels();
}
