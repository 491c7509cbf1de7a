// What makes places crisp where no alpha says what is empty: a distortion loss that draws a ray's
// weights together, an end that nothing shines through, and a note of what each cell showed.
#ifndef RN_ENGINE_CPU_CRISP_H
#define RN_ENGINE_CPU_CRISP_H

#include "server/engine/cpu/packet.h"
#include "server/engine/field/occupancy.h"

// ---- distortion -----------------------------------------------------------------------------

// Where sample i lies, in the frame of the planes along the ray: what distortion is measured in.
RN_INLINE double reach_of(const struct rn_cpu_field *field, const struct rn_workspace *w, int i) {
    if (field->disparity.on) return (double)w->marched[i];
    double s = (double)w->s[i];
    return field->config->space == RN_SPACE_BALL ? s : 0.5 * rn_place_of_distance(s);
}

// Adds to w->slope, dL/dw of ray r's samples, the gradient of `factor` times its distortion (Barron
// et al. 2022, eq. 15): sum over i, j of w_i w_j |m_i - m_j| + width / 3 sum of w_i^2, m what
// reach_of says, samples `width` long. O(n) by running sums (Sun et al. 2022): samples lie in
// order. Within 1e-6 of factor * length.
static void distort(const struct rn_cpu_field *field, int r, double factor, double width,
                    struct rn_workspace *w) {
    double total = 0, moment = 0, front = 0, front_moment = 0;
    for (int s = w->ray_first[r]; s >= 0; s = w->segment_next[s])
        for (int i = w->segment_start[s]; i < w->segment_start[s] + w->segment_size[s]; i++) {
            total += (double)w->weight[i];
            moment += (double)w->weight[i] * reach_of(field, w, i);
        }
    for (int s = w->ray_first[r]; s >= 0; s = w->segment_next[s])
        for (int i = w->segment_start[s]; i < w->segment_start[s] + w->segment_size[s]; i++) {
            double weight = (double)w->weight[i], m = reach_of(field, w, i);
            front += weight;
            front_moment += weight * m;
            double apart = m * (2 * front - total) - (2 * front_moment - moment);
            w->slope[i] += (float)(factor * (2 * apart + weight * width * (2.0 / 3)));
        }
}

// The rays of a split pixel share its weight.
static void distort_packet(const struct rn_cpu_field *field, const struct rn_march_options *options,
                           const struct rn_march_ray *rays, int ray_count, struct rn_workspace *w) {
    int pixel = rn_pixel_rays(options);
    for (int r = 0; r < ray_count && options->distortion_loss > 0; r++)
        if (w->ray_first[r] >= 0)
            distort(field, r,
                    (double)(options->distortion_loss * rays[r / pixel * pixel].weight) / pixel,
                    (double)options->step * rays[r].stride, w);
}

// ---- what cells showed ----------------------------------------------------------------------

// The largest of what a cell showed and `weight`; in any order the same.
RN_INLINE void note_weight(uint32_t *cell, float weight) {
    uint32_t bits, old = __atomic_load_n(cell, __ATOMIC_RELAXED);
    weight = weight > RN_SEEN_LEAST ? weight : RN_SEEN_LEAST;
    memcpy(&bits, &weight, sizeof bits); // of numbers that are not negative, ordered as they are
    while (bits > old && !__atomic_compare_exchange_n(cell, &old, bits, true, __ATOMIC_RELAXED,
                                                      __ATOMIC_RELAXED)) {
    }
}

// The cells in which samples lie, `s` behind the ray's origin as marched.
RN_INLINE vi cells_at(const struct rn_cpu_field *field, const struct rn_march_ray *ray, vf s) {
    int n = field->occupancy.cells;
    float half = 0.5f * (float)n, top = (float)(n - 1);
    vf scale = vf_set(half);
    vi cell = vi_set(0);
    if (field->config->space == RN_SPACE_UNBOUNDED)
        scale *= contraction_at(distance_from_centre(ray, s)).scale;
    for (int k = 0; k < 3; k++) {
        vf p = (ray->direction[k] * s + ray->origin[k]) * scale + half;
        cell = cell * n + vi_from_float(vf_clamp(p, 0.0f, top));
    }
    return cell;
}

// Notes what the cells of the packet's samples showed; what is hidden showed nothing.
static void note_seen(const struct rn_cpu_field *field, const struct rn_march_ray *rays,
                      const struct rn_workspace *w, uint32_t *seen) {
    const float *marched = field->disparity.on ? w->marched : w->s;
    for (int segment = 0; segment < w->segment_count; segment++) {
        int start = w->segment_start[segment], size = w->segment_size[segment];
        const struct rn_march_ray *ray = &rays[w->ray[start]];
        for (int i = start; i < start + size; i += RN_VL) {
            int lanes = start + size - i < RN_VL ? start + size - i : RN_VL;
            vi cell = cells_at(field, ray, vf_load(marched + i));
            for (int j = 0; j < lanes; j++)
                if (w->before[i + j] <= RN_HIDDEN_DEPTH)
                    note_weight(seen + cell[j], w->weight[i + j]);
        }
    }
}

#endif
