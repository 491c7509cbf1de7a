// One packet of rays: march, evaluate in rounds front to back, composite, shade.
#ifndef RN_ENGINE_CPU_PACKET_H
#define RN_ENGINE_CPU_PACKET_H

#include "common/math/rng.h"
#include "server/engine/cpu/encode.h"
#include "server/engine/cpu/march.h"
#include "server/engine/cpu/mlp.h"
#include "server/engine/field/sh.h"

// Puts a packet's rays at their starts.
static void packet_start(const struct rn_cpu_field *field, const struct rn_march_options *options,
                         const struct rn_march_ray *rays, int n, struct marches *m,
                         struct rn_workspace *w) {
    w->ray_count = n;
    memset(m->ray, 0, sizeof m->ray);
    for (int g = 0; g < n; g += RN_VL) {
        struct march_lanes *l = &m->lanes[g / RN_VL];
        march_start(&field->occupancy, rays + g, n - g < RN_VL ? n - g : RN_VL, options->step, l);
        vi most = l->k + (w->room - RN_CHUNK);
        l->end = vi_select(most < l->end, most, l->end);
    }
    for (int r = 0; r < n; r++) {
        m->ray[r] = &rays[r];
        m->last[r] = -1;
        w->candidate_count[r] = w->ray_next[r] = 0;
    }
}

// All candidates of up to RN_PACKET_RAYS rays.
static void packet_march(const struct rn_cpu_field *field, const struct rn_march_options *options,
                         const struct rn_march_ray *rays, int n, struct rn_workspace *w) {
    struct marches m;
    packet_start(field, options, rays, n, &m, w);
    march_round(&field->occupancy, options->step, w->room, &m, w);
}

// ---- forward --------------------------------------------------------------------------------

// The first four outputs of RN_VL / 4 rows in one vector, and back.
RN_INLINE vf gather_heads(const float *row) {
    const v4 *r = (const v4 *)row;
    (void)r;
#if RN_VL == 16
    v8 low = __builtin_shufflevector(r[0], r[4], 0, 1, 2, 3, 4, 5, 6, 7);
    v8 high = __builtin_shufflevector(r[8], r[12], 0, 1, 2, 3, 4, 5, 6, 7);
    return (vf)__builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14,
                                       15);
#elif RN_VL == 8
    return (vf)__builtin_shufflevector(r[0], r[4], 0, 1, 2, 3, 4, 5, 6, 7);
#else
    return (vf)r[0];
#endif
}
// Their first outputs alone, times as many numbers.
RN_INLINE void store_firsts(vf x, const float *factor, float *to) {
#if RN_VL == 16
    *(v4 *)to = __builtin_shufflevector(x, x, 0, 4, 8, 12) * *(const v4 *)factor;
#else
    for (int j = 0; j < RN_VL / 4; j++)
        to[j] = x[4 * j] * factor[j];
#endif
}
RN_INLINE void spread_heads(float *row, vf x) {
    v4 *r = (v4 *)row;
#if RN_VL == 16
    r[0] = __builtin_shufflevector(x, x, 0, 1, 2, 3);
    r[4] = __builtin_shufflevector(x, x, 4, 5, 6, 7);
    r[8] = __builtin_shufflevector(x, x, 8, 9, 10, 11);
    r[12] = __builtin_shufflevector(x, x, 12, 13, 14, 15);
#elif RN_VL == 8
    r[0] = __builtin_shufflevector(x, x, 0, 1, 2, 3);
    r[4] = __builtin_shufflevector(x, x, 4, 5, 6, 7);
#else
    r[0] = (v4)x;
#endif
}

// Logits to densities and optical depths; with ray shading also activates the outputs in place:
// row = [1, sigmoid(diffuse), features]. Only the first four outputs of a row go through an
// exponential: RN_VL / 4 rows share a vector, and some behind `end` may be written. Density as
// rn_density: 1 + |logit - 1| ULP.
static void activate(const struct rn_cpu_field *field, int begin, int end, struct rn_workspace *w) {
    enum { ROWS = RN_VL / 4 };
    bool per_ray = field->config->shading == RN_SHADING_RAY;
    vi first;
    for (int i = 0; i < RN_VL; i++)
        first[i] = i % 4 == 0 ? -1 : 0;
    for (int i = begin; i < end; i += ROWS) {
        float *row = w->geometry + (size_t)i * RN_GEOMETRY;
        vf y = gather_heads(row);
        vf logit = vf_clamp(y - (float)RN_DENSITY_SHIFT, -(float)RN_DENSITY_CLAMP,
                            (float)RN_DENSITY_CLAMP);
        vf e = vf_exp(vf_select(first, logit, -y));
        if (per_ray) spread_heads(row, vf_select(first, vf_set(1), 1.0f / (1.0f + e)));
        store_firsts(e, w->interval + i, w->x + i);
    }
}

// Appends the next samples of every ray still alive; returns how many, or -1 where there is no room
// for them among `most`.
static int round_place(const struct rn_cpu_field *field, const struct rn_march_options *options,
                       const struct ray_footprint *footprints, bool leveled, int most,
                       struct marches *m, struct rn_workspace *w) {
    int begin = w->count;
    for (int r = 0; r < w->ray_count; r++) {
        int left = w->candidate_count[r] - w->ray_next[r];
        if (w->ray_depth[r] > options->stop_depth || left == 0) m->ray[r] = NULL;
        if (!m->ray[r]) continue;
        int n = left < RN_ROUND ? left : RN_ROUND, segment = w->segment_count++;
        if (w->count + n > most) return -1;
        place_segment(field, options, m->ray[r], &footprints[r], leveled,
                      w->candidate + r * w->room + w->ray_next[r], n, w->count, w);
        memset(w->ray + w->count, r, (size_t)n);
        w->segment_start[segment] = w->count;
        w->segment_size[segment] = (int16_t)n;
        w->segment_next[segment] = -1;
        if (w->ray_first[r] < 0)
            w->ray_first[r] = (int16_t)segment;
        else
            w->segment_next[w->ray_last[r]] = (int16_t)segment;
        w->ray_last[r] = (int16_t)segment;
        w->ray_next[r] += n;
        w->count += n;
    }
    return w->count - begin;
}

// Transmittance behind the samples of the segments from `first` on.
static void round_attenuate(int first, struct rn_workspace *w) {
    for (int segment = first; segment < w->segment_count; segment++) {
        int start = w->segment_start[segment], r = w->ray[start];
        double depth = w->ray_depth[r];
        for (int i = 0; i < w->segment_size[segment]; i += RN_VD) {
            vl mine = vd_first_lanes(w->segment_size[segment] - i);
            vd sums = vd_prefix_sums((vd)((vl)vd_load(w->x + start + i) & mine));
            vd_store(w->before + start + i, VD_UP(sums, 1) + depth);
            depth += sums[RN_VD - 1];
        }
        w->ray_depth[r] = depth;
    }
}

// weight and transmittance behind every sample; samples behind the early stop weigh nothing, which
// moves a colour by at most the stop's transmittance. With S the optical depth in front, a weight
// is within 3 (1 + S) ULP down to exp(-87.3); weights and the rest sum to 1 within 4 ULP of 1.
static void finish_weights(const struct rn_march_options *options, struct rn_workspace *w) {
    for (int i = 0; i < w->count; i += RN_VL) {
        vf x = vf_load(w->x + i), before = vf_load(w->before + i);
        vi alive = before <= options->stop_depth;
        vf t = vf_bits(vi_bits(vf_exp(-before)) & alive);
        vf_store(w->weight + i, t * vf_one_minus_exp(x));
        vf_store(w->after + i, t * vf_exp(-x));
    }
}

// Where space ends, its end is opaque: the last sample of each of `n` rays takes what shines
// through the others.
static void close_ends(const struct rn_march_options *options, int n, struct rn_workspace *w) {
    for (int r = 0; r < n; r++) {
        int last = w->ray_last[r];
        if (w->ray_first[r] >= 0 && w->ray_depth[r] <= (double)options->stop_depth)
            w->x[w->segment_start[last] + w->segment_size[last] - 1] = RN_OPAQUE;
    }
}

// Density and geometry of all samples of `n` rays that can be seen, in rounds along the rays. False
// where they have no room: then of fewer rays.
static bool packet_density(const struct rn_cpu_field *field, const struct rn_march_options *options,
                           const struct rn_march_ray *rays, int n, struct rn_workspace *w,
                           bool *ret_leveled) {
    struct ray_footprint footprints[RN_PACKET_RAYS];
    struct marches m;
    struct mlp base = base_network(field, w);
    int most = n > rn_pixel_rays(options) ? w->full : w->capacity;
    bool leveled = false;
    w->count = w->segment_count = 0;
    packet_start(field, options, rays, n, &m, w);
    march_round(&field->occupancy, options->step, RN_ROUND, &m, w);
    for (int r = 0; r < n; r++) {
        w->ray_first[r] = w->ray_last[r] = -1;
        w->ray_depth[r] = 0;
        if (w->candidate_count[r] == 0) continue;
        ray_footprint_init(field, &rays[r], options->step * (float)rays[r].stride, &footprints[r]);
        leveled |= footprints[r].leveled;
    }
    for (;;) {
        int begin = w->count, first = w->segment_count;
        int some = round_place(field, options, footprints, leveled, most, &m, w);
        if (some < 0) return false;
        if (some == 0) break;
        encode(field, leveled, begin, w->count, w);
        mlp_forward(&base, begin, some);
        activate(field, begin, w->count, w);
        round_attenuate(first, w);
        march_round(&field->occupancy, options->step, RN_ROUND, &m, w);
    }
    if (rn_ends_opaque(field)) close_ends(options, n, w);
    finish_weights(options, w);
    *ret_leveled = leveled;
    return true;
}

// What the colour network sees of a ray's direction.
RN_INLINE const float *view_of(const struct rn_cpu_field *field, const struct rn_march_ray *ray,
                               float room[3]) {
    if (!field->disparity.on) return ray->direction;
    struct rn_forward_ray forward = rn_forward_ray(&field->disparity, ray);
    for (int i = 0; i < 3; i++)
        room[i] = (float)forward.view[i];
    return room;
}

static void directions(const struct rn_cpu_field *field, const float d[3], float *out) {
    double sh[RN_SH_COUNT] = {0};
    if (field->config->view_dependence) rn_sh_encode((const double[3]){d[0], d[1], d[2]}, sh);
    for (int i = 0; i < RN_SH_COUNT; i++)
        out[i] = (float)sh[i];
}

typedef float row16 __attribute__((vector_size(64), aligned(4), may_alias));

// Sums over a ray: [opacity, D, F] with ray shading; opacity and depth.
struct ray_sums {
    row16 sum;
    float opacity, depth;
};

// The same of the samples so far; of opacity and depth, what each lane has added up.
struct running_sums {
    row16 sum;
    vd opacity, depth;
};

// Adds the samples of one segment; their depths, from `near` on, where `depths` says so.
RN_INLINE void sum_segment(int segment, bool per_ray, bool depths, float near,
                           const struct rn_workspace *w, struct running_sums *sums) {
    int start = w->segment_start[segment], size = w->segment_size[segment];
    for (int i = 0; i < size; i += RN_VD) {
        vl mine = vd_first_lanes(size - i);
        vd weight = (vd)((vl)vd_load(w->weight + start + i) & mine);
        sums->opacity += weight;
        if (depths) sums->depth += weight * (vd_load(w->s + start + i) + (double)near);
    }
    for (int i = start; per_ray && i < start + size; i++)
        sums->sum += w->weight[i] * *(const row16 *)(w->geometry + (size_t)i * RN_GEOMETRY);
}

// Without the depth.
static struct ray_sums sum_ray(int r, bool per_ray, const struct rn_workspace *w) {
    struct running_sums sums = {0};
    for (int s = w->ray_first[r]; s >= 0; s = w->segment_next[s])
        sum_segment(s, per_ray, false, 0, w, &sums);
    return (struct ray_sums){.sum = sums.sum, .opacity = (float)vd_sum(sums.opacity)};
}

RN_SH_FUNCTION(sh_lanes, vf, float)

_Static_assert(RN_APPEARANCE_AT + RN_APPEARANCE == RN_SH_COUNT, "the last harmonics make room");

// Spherical harmonics that the colour network sees.
static int sh_seen(const struct rn_cpu_field *field) {
    return field->config->appearances > 0 ? RN_APPEARANCE_AT : RN_SH_COUNT;
}

// A photograph's appearance, where the field has such, among the colour network's inputs.
static void put_appearance(const struct rn_cpu_field *field, const struct rn_march_options *options,
                           const struct rn_march_ray *ray, float *in) {
    size_t bytes = RN_APPEARANCE * sizeof *in;
    if (field->config->appearances == 0) return;
    if (options->appearances)
        memcpy(in + RN_APPEARANCE_AT, options->appearances + rn_appearance_at(options, ray), bytes);
    else
        memset(in + RN_APPEARANCE_AT, 0, bytes);
}

// Of `n` rows of the colour network's inputs, the directions that they begin with become spherical
// harmonics, the first `terms` of them: within 4 ULP of 1.
static void encode_directions(int n, int terms, float *in) {
    for (int j = 0; j < n; j += RN_VL, in += RN_VL * RN_HEAD_INPUTS) {
        int rows = n - j < RN_VL ? n - j : RN_VL;
        float numbers[RN_SH_COUNT][RN_VL] = {{0}};
        vf d[3], sh[RN_SH_COUNT];
        for (int k = 0; k < rows; k++)
            for (int c = 0; c < 3; c++)
                numbers[c][k] = in[k * RN_HEAD_INPUTS + c];
        memcpy(d, numbers, sizeof d);
        sh_lanes(d, sh);
        memcpy(numbers, sh, sizeof sh);
        for (int k = 0; k < rows; k++)
            for (int i = 0; i < terms; i++)
                in[k * RN_HEAD_INPUTS + i] = numbers[i][k];
    }
}

// What the colour network gets of a ray with ray shading, the direction as it is.
static void head_inputs(const struct rn_cpu_field *field, const struct rn_march_options *options,
                        const struct rn_march_ray *ray, const struct ray_sums *sums, float *in) {
    float view[3];
    if (!field->config->view_dependence) return;
    memcpy(in, options->look ? options->look : view_of(field, ray, view), sizeof view);
    put_appearance(field, options, ray, in);
    for (int i = 0; i < 12; i++)
        in[16 + i] = sums->sum[4 + i];
    for (int c = 0; c < 3; c++)
        in[28 + c] = sums->sum[1 + c];
    in[31] = sums->opacity;
}

RN_COLOUR_FUNCTIONS(colour_seen, colour_back, float)

// The colours of `n` rays with those inputs; the j-th's sums and colour are number at[j].
static void head_colours(const struct rn_cpu_field *field, const struct rn_march_options *options,
                         int n, const int16_t *at, const struct ray_sums *sums,
                         struct rn_workspace *w, float (*rgb)[3]) {
    struct mlp head = head_network(field, w);
    if (field->config->view_dependence) {
        encode_directions(n, sh_seen(field), w->head_in);
        mlp_forward(&head, 0, n);
    }
    for (int j = 0; j < n; j++) {
        const struct ray_sums *s = &sums[at[j]];
        for (int c = 0; c < 3; c++) {
            float specular =
                field->config->view_dependence ? w->head_out[(size_t)j * RN_HEAD_OUTPUTS + c] : 0;
            rgb[at[j]][c] = s->sum[1 + c] + s->opacity * specular;
        }
        colour_seen(&options->colour, s->opacity, rgb[at[j]]);
    }
}

// Ray shading: colour of every ray of the packet that hit something. head row j = hit[j].
static int shade_rays(const struct rn_cpu_field *field, const struct rn_march_options *options,
                      const struct rn_march_ray *rays, int ray_count, struct rn_workspace *w,
                      struct ray_sums *sums, float (*rgb)[3], int16_t *hit) {
    int hits = 0;
    for (int r = 0; r < ray_count; r++) {
        if (w->ray_first[r] < 0) continue;
        sums[r] = sum_ray(r, true, w);
        hit[hits] = (int16_t)r;
        head_inputs(field, options, &rays[r], &sums[r],
                    w->head_in + (size_t)hits++ * RN_HEAD_INPUTS);
    }
    head_colours(field, options, hits, hit, sums, w, rgb);
    return hits;
}

// Sample shading: colours of the samples of rays[w->ray] listed in `kept`, head row j = kept[j],
// sigmoid in place.
static void shade_samples(const struct rn_cpu_field *field, const struct rn_march_options *options,
                          const struct rn_march_ray *const *rays, int kept,
                          struct rn_workspace *w) {
    float sh[RN_SH_COUNT], view[3];
    int last = -1;
    for (int j = 0; j < kept; j++) {
        int i = w->kept[j];
        float *in = w->head_in + (size_t)j * RN_HEAD_INPUTS;
        if (w->ray[i] != last)
            directions(field, options->look ? options->look : view_of(field, rays[w->ray[i]], view),
                       sh);
        last = w->ray[i];
        memcpy(in, sh, sizeof sh);
        put_appearance(field, options, rays[w->ray[i]], in);
        memcpy(in + RN_SH_COUNT, w->geometry + (size_t)i * RN_GEOMETRY + 1, 15 * sizeof(float));
        in[31] = 1;
    }
    struct mlp head = head_network(field, w);
    mlp_forward(&head, 0, kept);
    for (int j = 0; j < kept; j++) {
        float *out = w->head_out + (size_t)j * RN_HEAD_OUTPUTS;
        vf_store(out, 1.0f / (1.0f + vf_exp(-vf_load(out)))); // the first RN_VL >= 4
    }
}

// Lists the samples whose weight exceeds `threshold`; returns their count.
static int keep_samples(float threshold, struct rn_workspace *w) {
    int kept = 0;
    for (int i = 0; i < w->count; i++)
        if (w->weight[i] > threshold) w->kept[kept++] = i;
    return kept;
}

static void shade_packet_by_samples(const struct rn_cpu_field *field,
                                    const struct rn_march_options *options,
                                    const struct rn_march_ray *rays, int ray_count, int kept,
                                    struct rn_workspace *w, struct ray_sums *sums,
                                    float (*rgb)[3]) {
    const struct rn_march_ray *each[RN_PACKET_RAYS];
    for (int r = 0; r < ray_count; r++)
        each[r] = &rays[r];
    shade_samples(field, options, each, kept, w);
    for (int r = 0; r < ray_count; r++) {
        if (w->ray_first[r] < 0) continue;
        sums[r] = sum_ray(r, false, w);
        memset(rgb[r], 0, sizeof rgb[r]);
    }
    for (int j = 0; j < kept; j++) {
        int i = w->kept[j];
        for (int c = 0; c < 3; c++)
            rgb[w->ray[i]][c] += w->weight[i] * w->head_out[(size_t)j * RN_HEAD_OUTPUTS + c];
    }
    for (int r = 0; r < ray_count; r++)
        if (w->ray_first[r] >= 0) colour_seen(&options->colour, sums[r].opacity, rgb[r]);
}

#endif
