// A ray's backward, and the loss of pixels.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/loss.h"
#include "server/engine/field/sh.h"
#include "server/engine/field/volume.h"
#include "server/engine/reference/tape.h"

// Adds to dL/d(appearance) of a ray's photograph what the colour network's inputs ask for.
static void add_appearance(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                           const double *inputs_grad) {
    for (int i = 0; i < RN_APPEARANCE && ref->config.appearances > 0 && ray->appearance_grad; i++)
        ray->appearance_grad[i] += inputs_grad[RN_APPEARANCE_AT + i];
}

// dL/d(weight of sample s) and dL/d(geometry) with sample shading.
static double backward_sample_shade(struct rn_reference *ref, const struct rn_reference_ray *ray,
                                    struct rn_tape *tape, int s, const double rgb_grad[3],
                                    double *geometry_grad) {
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
    add_appearance(ref, ray, tape->head_grad[0]);
    return g;
}

// dL/d(sums) and dL/d(opacity) with ray shading.
static double backward_ray_head(struct rn_reference *ref, const struct rn_reference_ray *ray,
                                struct rn_tape *tape, const double rgb_grad[3],
                                double sums_grad[RN_GEOMETRY]) {
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
    add_appearance(ref, ray, inputs_grad);
    return opacity_grad + inputs_grad[31];
}

static double backward_ray_shade(const struct rn_reference *ref, const struct rn_tape *tape, int s,
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
static double distort(const struct rn_reference_ray *ray, const struct rn_tape *tape, double factor,
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
                               struct rn_tape *tape, const double grad[4], double distortion,
                               double *ret_distortion) {
    int layers = ref->base_shape.layers, n = ray->count;
    double *g = calloc((size_t)n * (1 + RN_GEOMETRY) + 1, sizeof *g);
    if (!g) return RN_ERROR_NO_MEMORY;
    double *geometry = g + n, sums_grad[RN_GEOMETRY], opacity_grad = 0;
    bool per_ray = ref->config.shading == RN_SHADING_RAY;
    if (per_ray) opacity_grad = backward_ray_head(ref, ray, tape, grad, sums_grad);
    for (int s = 0; s < n; s++) {
        double *out = geometry + (size_t)s * RN_GEOMETRY;
        g[s] = grad[3];
        g[s] += per_ray ? backward_ray_shade(ref, tape, s, sums_grad, opacity_grad, out)
                        : backward_sample_shade(ref, ray, tape, s, grad, out);
    }
    *ret_distortion = distort(ray, tape, distortion, g);
    rn_composite_backward(n, tape->weights, tape->after, g, g);
    for (int s = 0; s < n; s++) {
        double **base = tape->base + s * (layers + 1);
        double *out = tape->base_grad[layers];
        memcpy(out, geometry + (size_t)s * RN_GEOMETRY, RN_GEOMETRY * sizeof(double));
        out[0] = g[s] * tape->interval[s] * rn_density_slope(base[layers][0]);
        rn_mlp_backward(&ref->base_shape, ref->base, base, tape->base_grad, ref->base_grad);
        rn_reference_encode_backward(ref, ray, ray->mid[s], tape->base_grad[0]);
    }
    free(g);
    return RN_OK;
}

RN_LOSS_FUNCTION(loss_of, struct rn_reference_ray, double, double)

// Loss of one pixel, the mean of `n` rays that are not all empty, and its gradients.
static enum rn_status pixel_loss(struct rn_reference *ref, const struct rn_reference_ray *rays,
                                 int n, double total_weight, struct rn_tape *tapes, double *loss) {
    double rgb[3] = {0, 0, 0}, opacity = 0, grad[4];
    enum rn_status status = RN_OK;
    for (int r = 0; r < n && status == RN_OK; r++) {
        status = rn_tape_init(ref, rays[r].count, &tapes[r]);
        if (status == RN_OK && rays[r].count > 0) rn_reference_forward(ref, &rays[r], &tapes[r]);
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
    struct rn_tape *tapes = calloc((size_t)n, sizeof *tapes);
    enum rn_status status = tapes ? RN_OK : RN_ERROR_NO_MEMORY;
    for (size_t r = 0; r < count && total_weight > 0 && status == RN_OK; r += (size_t)n) {
        if (!any_samples(rays + r, n)) continue;
        status = pixel_loss(ref, rays + r, n, total_weight, tapes, &loss);
        for (int i = 0; i < n; i++)
            rn_tape_finish(&tapes[i]);
        memset(tapes, 0, (size_t)n * sizeof *tapes);
    }
    free(tapes);
    if (status != RN_OK) return status;
    rn_reference_pull_down(ref);
    *ret_loss = total_weight > 0 ? loss / total_weight : 0;
    return RN_OK;
}
