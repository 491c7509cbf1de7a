// Rendering: rays go through RN_PACKET_RAYS places, in rounds of up to RN_ROUND samples each, or
// half as many of rays that end early: their samples behind the last one seen are more. A ray that
// has ended leaves its place to the next one, so that the rounds stay full; nothing is kept of a
// sample but its share of the ray's sums.
#ifndef RN_ENGINE_CPU_RENDER_H
#define RN_ENGINE_CPU_RENDER_H

#include "server/engine/cpu/packet.h"

#define RN_EARLY 3 // optical depth: a transmittance of 0.05

// A ray's last sample so far, where that is to be opaque.
struct last_sample {
    row16 geometry;
    float distance;
    bool is_there;
};

struct stream {
    const struct rn_cpu_field *field;
    const struct rn_march_options *options;
    const struct rn_march_ray *rays;
    int ray_count, next; // rays not looked at yet: [next, ray_count)
    int round;           // samples
    struct rn_workspace *w;
    struct rn_pixel *pixels;
    struct marches marches;
    struct ray_footprint footprints[RN_PACKET_RAYS];
    struct running_sums sums[RN_PACKET_RAYS];
    struct last_sample last[RN_PACKET_RAYS];
    float rgb[RN_PACKET_RAYS][3]; // sample shading: the sum so far
    int16_t free[RN_PACKET_RAYS];
    int free_count;
    // Rays that have ended, until their colours are computed together.
    int ended_count, ended_pixel[RN_PACKET_RAYS];
    int16_t ended_at[RN_PACKET_RAYS];
    struct ray_sums ended[RN_PACKET_RAYS];
};

static void stream_init(const struct rn_cpu_field *field, const struct rn_march_options *options,
                        const struct rn_march_ray *rays, int count, struct rn_workspace *w,
                        struct rn_pixel *pixels, struct stream *s) {
    int places = w->full / RN_ROUND < RN_PACKET_RAYS ? w->full / RN_ROUND : RN_PACKET_RAYS;
    s->field = field;
    s->options = options;
    s->rays = rays;
    s->ray_count = count;
    s->next = s->ended_count = 0;
    s->round = options->stop_depth < RN_EARLY ? RN_ROUND / 2 : RN_ROUND;
    s->w = w;
    s->pixels = pixels;
    memset(&s->marches.ray, 0, sizeof s->marches.ray);
    memset(&s->marches.lanes, 0, sizeof s->marches.lanes);
    memset(w->ray_next, 0, sizeof w->ray_next);
    s->free_count = places;
    for (int i = 0; i < places; i++)
        s->free[i] = (int16_t)(places - 1 - i);
}

// Gives a ray the place that became free last. Lane `j` of `from` is where its march stands.
static void stream_place(struct stream *s, const struct rn_march_ray *ray,
                         const struct march_lanes *from, int j) {
    int r = s->free[--s->free_count], i = r % RN_VL;
    struct marches *m = &s->marches;
    struct march_lanes *to = &m->lanes[r / RN_VL];
    for (int k = 0; k < 3; k++) {
        to->at[k][i] = from->at[k][j];
        to->along[k][i] = from->along[k][j];
        to->inverse[k][i] = from->inverse[k][j];
    }
    to->k[i] = from->k[j];
    to->end[i] = from->end[j];
    m->ray[r] = ray;
    m->last[r] = -1;
    s->w->candidate_count[r] = 0;
    s->sums[r] = (struct running_sums){0};
    s->last[r].is_there = false;
    memset(s->rgb[r], 0, sizeof s->rgb[r]);
    s->w->ray_depth[r] = 0;
    ray_footprint_init(s->field, ray, s->options->step * (float)ray->stride, &s->footprints[r]);
}

// Looks at the next rays while there is room: the ones that meet an occupied brick get a place, the
// others the background.
static void stream_fill(struct stream *s) {
    const float *background = s->options->colour.background;
    const struct rn_occupancy_bits *o = &s->field->occupancy;
    while (s->next < s->ray_count && s->free_count >= RN_VL) {
        const struct rn_march_ray *rays = s->rays + s->next;
        int n = s->ray_count - s->next < RN_VL ? s->ray_count - s->next : RN_VL;
        struct march_lanes lanes;
        march_start(o, rays, n, s->options->step, &lanes);
        unsigned hit = vi_mask_bits(march_land(o, s->options->step, vi_set(-1), &lanes));
        for (int j = 0; j < n; j++)
            s->pixels[s->next + j] =
                (struct rn_pixel){{background[0], background[1], background[2]}, 0, 0};
        for (; hit; hit &= hit - 1)
            stream_place(s, rays + __builtin_ctz(hit), &lanes, __builtin_ctz(hit));
        s->next += n;
    }
}

// The colours of the rays that have ended.
static void stream_shade(struct stream *s) {
    float rgb[RN_PACKET_RAYS][3];
    head_colours(s->field, s->options, s->ended_count, s->ended_at, s->ended, s->w, rgb);
    for (int j = 0; j < s->ended_count; j++)
        memcpy(s->pixels[s->ended_pixel[j]].rgb, rgb[j], sizeof rgb[j]);
    s->ended_count = 0;
}

// As close_ends: what shines through a ray's samples falls to the last one.
static void stream_close(struct stream *s, int r) {
    const struct last_sample *last = &s->last[r];
    double depth = s->w->ray_depth[r];
    if (!last->is_there || depth > (double)s->options->stop_depth) return;
    double rest = exp(-depth);
    s->sums[r].sum += (float)rest * last->geometry;
    s->sums[r].opacity[0] += rest;
    s->sums[r].depth[0] += rest * (double)last->distance;
}

// Notes the last sample of a segment.
RN_INLINE void stream_note(struct stream *s, int segment, int r) {
    const struct rn_workspace *w = s->w;
    int i = w->segment_start[segment] + w->segment_size[segment] - 1;
    s->last[r] = (struct last_sample){*(const row16 *)(w->geometry + (size_t)i * RN_GEOMETRY),
                                      w->s[i] + s->marches.ray[r]->near, true};
}

// A ray has ended: its pixel, but for the colour where that is computed for many rays together.
static void stream_end(struct stream *s, int r) {
    const struct rn_march_ray *ray = s->marches.ray[r];
    const struct running_sums *sums = &s->sums[r];
    if (rn_ends_opaque(s->field)) stream_close(s, r);
    struct ray_sums total = {sums->sum, (float)vd_sum(sums->opacity), (float)vd_sum(sums->depth)};
    struct rn_pixel *pixel = &s->pixels[ray - s->rays];
    s->marches.ray[r] = NULL;
    s->free[s->free_count++] = (int16_t)r;
    pixel->alpha = total.opacity < 1 ? total.opacity : 1;
    pixel->depth = total.opacity > 0 ? total.depth / total.opacity : 0;
    if (s->field->config->shading == RN_SHADING_SAMPLE) {
        memcpy(pixel->rgb, s->rgb[r], sizeof pixel->rgb);
        colour_seen(&s->options->colour, total.opacity, pixel->rgb);
        return;
    }
    int j = s->ended_count++;
    s->ended[j] = total;
    s->ended_at[j] = (int16_t)j;
    s->ended_pixel[j] = (int)(ray - s->rays);
    head_inputs(s->field, s->options, ray, &total, s->w->head_in + (size_t)j * RN_HEAD_INPUTS);
    if (s->ended_count == RN_PACKET_RAYS) stream_shade(s);
}

// Takes `n` of a ray's samples off.
RN_INLINE void take(int r, int n, struct rn_workspace *w) {
    uint16_t *found = w->candidate + r * w->room;
    w->candidate_count[r] -= n;
    memmove(found, found + n, (RN_ROUND + RN_CHUNK) * sizeof *found);
}

// Places the next samples of every ray, one segment each; a ray without any has ended. Returns
// whether a sample may lie above level 0.
static bool stream_round(struct stream *s) {
    struct rn_workspace *w = s->w;
    struct marches *m = &s->marches;
    bool leveled = false;
    w->count = w->segment_count = 0;
    for (int r = 0; r < RN_PACKET_RAYS; r++)
        if (m->ray[r] && w->candidate_count[r] > 0) leveled |= s->footprints[r].leveled;
    for (int r = 0; r < RN_PACKET_RAYS; r++) {
        if (!m->ray[r]) continue;
        int n = w->candidate_count[r] < s->round ? w->candidate_count[r] : s->round;
        if (n == 0) {
            stream_end(s, r);
            continue;
        }
        place_segment(s->field, s->options, m->ray[r], &s->footprints[r], leveled,
                      w->candidate + r * w->room, n, w->count, w);
        take(r, n, w);
        memset(w->ray + w->count, r, (size_t)n);
        if (s->options->samples) s->options->samples[m->ray[r] - s->rays] += (uint16_t)n;
        w->segment_start[w->segment_count] = w->count;
        w->segment_size[w->segment_count++] = (int16_t)n;
        w->count += n;
    }
    return leveled;
}

// Of a sample's levels the nearest: one map of a plane's pyramid is read instead of four.
static void round_levels(struct stream *s) {
    struct rn_workspace *w = s->w;
    for (int p = 0; p < s->field->config->planes; p++)
        for (int i = 0; i < w->count; i += RN_VL) {
            vf_store(w->lx[p] + i, vf_whole(vf_load(w->lx[p] + i) + 0.5f));
            vf_store(w->ly[p] + i, vf_whole(vf_load(w->ly[p] + i) + 0.5f));
        }
}

// Colours of the round's samples, times their weights, onto their rays' sums.
static void stream_shade_samples(struct stream *s) {
    struct rn_workspace *w = s->w;
    int kept = keep_samples(0, w);
    shade_samples(s->field, s->options, s->marches.ray, kept, w);
    for (int j = 0; j < kept; j++) {
        int i = w->kept[j];
        for (int c = 0; c < 3; c++)
            s->rgb[w->ray[i]][c] += w->weight[i] * w->head_out[(size_t)j * RN_HEAD_OUTPUTS + c];
    }
}

// The round's samples onto their rays' sums. Rays that nothing shines through any more end.
static void stream_composite(struct stream *s) {
    struct rn_workspace *w = s->w;
    bool per_ray = s->field->config->shading == RN_SHADING_RAY;
    bool ends_opaque = rn_ends_opaque(s->field);
    round_attenuate(0, w);
    finish_weights(s->options, w);
    if (!per_ray) stream_shade_samples(s);
    for (int k = 0; k < w->segment_count; k++) {
        int r = w->ray[w->segment_start[k]];
        sum_segment(k, per_ray, true, s->marches.ray[r]->near, w, &s->sums[r]);
        if (ends_opaque) stream_note(s, k, r);
        if (w->ray_depth[r] > s->options->stop_depth) stream_end(s, r);
    }
}

static uint64_t render(const struct rn_cpu_field *field, const struct rn_march_options *options,
                       const struct rn_march_ray *rays, int count, struct rn_workspace *w,
                       struct rn_pixel *ret_pixels) {
    struct stream s;
    struct mlp base = base_network(field, w);
    uint64_t samples = 0;
    stream_init(field, options, rays, count, w, ret_pixels, &s);
    for (;;) {
        stream_fill(&s);
        march_round(&field->occupancy, options->step, s.round, &s.marches, w);
        bool leveled = stream_round(&s);
        if (w->count == 0 && s.next == count) break;
        if (leveled && options->whole_levels) round_levels(&s);
        encode(field, leveled, 0, w->count, w);
        mlp_forward(&base, 0, w->count);
        activate(field, 0, w->count, w);
        stream_composite(&s);
        samples += (uint64_t)w->count;
    }
    if (s.ended_count > 0) stream_shade(&s);
    return samples;
}

#endif
