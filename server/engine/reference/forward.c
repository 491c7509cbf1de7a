// A ray's forward: networks, volume rendering and the colour, as the tape keeps them.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "server/engine/field/sh.h"
#include "server/engine/field/volume.h"
#include "server/engine/reference/tape.h"

static void network_forward(const struct rn_reference *ref, const struct rn_mlp_shape *shape,
                            const double *weights, double *const *activation) {
    if (!ref->half) {
        rn_mlp_forward(shape, weights, activation);
        return;
    }
    for (int l = 0; l < shape->layers; l++) {
        struct rn_mlp_shape one = {1, {shape->in[l]}, {shape->out[l]}, {shape->offset[l]}, 0, 0};
        for (int i = 0; i < shape->in[l]; i++)
            activation[l][i] =
                l > 0 && activation[l][i] < 0 ? 0 : rn_reference_half(activation[l][i]);
        rn_mlp_forward(&one, weights, activation + l);
    }
}

void rn_tape_finish(struct rn_tape *tape) {
    free(tape->storage);
    free(tape->base);
    free(tape->interval);
}

enum rn_status rn_tape_init(const struct rn_reference *ref, int n, struct rn_tape *tape) {
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
        rn_tape_finish(tape);
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
    for (int i = 0; i < RN_APPEARANCE && ref->config.appearances > 0; i++)
        inputs[RN_APPEARANCE_AT + i] = ray->appearance ? ray->appearance[i] : 0;
}

static void shade_samples(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                          struct rn_tape *tape) {
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
                      struct rn_tape *tape) {
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

void rn_reference_forward(const struct rn_reference *ref, const struct rn_reference_ray *ray,
                          struct rn_tape *tape) {
    int layers = ref->base_shape.layers;
    for (int s = 0; s < ray->count; s++) {
        double **base = tape->base + s * (layers + 1);
        rn_reference_extent(ref, ray, ray->mid[s], &tape->interval[s], &tape->reach[s]);
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
    struct rn_tape tape;
    enum rn_status status = rn_tape_init(ref, ray->count, &tape);
    if (status != RN_OK) return status;
    rn_reference_forward(ref, ray, &tape);
    memcpy(ret_rgb, tape.rgb, sizeof tape.rgb);
    *ret_opacity = tape.opacity;
    *ret_depth = tape.depth;
    rn_tape_finish(&tape);
    return RN_OK;
}
