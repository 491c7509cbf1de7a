// The tiny networks: fully connected, no biases, ReLU between layers (paper, section 3.4).
//
// Density network: planes * channels -> width (base_layers times) -> 16: the density's logit and 15
// geometry features. Colour network: 32 inputs -> width (head_layers times) -> 3, padded to 16.
//   sample shading: inputs [SH(16), geometry(15), 1]; rgb = sigmoid(outputs).
//   ray shading: the density network's outputs are [logit, diffuse logits(3), features(12)];
//     D, F, O = sums of weights times sigmoid(diffuse), features, 1; inputs [SH(16), F, D, O];
//     rgb = D + O * outputs.
// Where photographs have appearances of their own, the last RN_APPEARANCE of the SH, those of third
// degree, give their inputs to the code of the photograph that the ray is of (Martin-Brualla et al.
// 2021, "NeRF in the Wild", section 4.1), which is 0 in pictures.
#ifndef RN_ENGINE_FIELD_MLP_H
#define RN_ENGINE_FIELD_MLP_H

#include <stddef.h>

#include "server/engine/field/real.h"

#define RN_MLP_MAX_LAYERS 6
#define RN_GEOMETRY 16 // outputs of the density network
#define RN_HEAD_INPUTS 32
#define RN_HEAD_OUTPUTS 16 // 3 used
#define RN_APPEARANCE_AT 9 // of the inputs: a photograph's code begins there

// Weights are row-major [input][output], layer after layer. Plain value.
struct rn_mlp_shape {
    int layers;
    int in[RN_MLP_MAX_LAYERS], out[RN_MLP_MAX_LAYERS];
    size_t offset[RN_MLP_MAX_LAYERS]; // of each layer's weights, in numbers
    size_t count;                     // of all weights
    int widest;                       // of all inputs and outputs
};

RN_HD struct rn_mlp_shape rn_mlp_shape(int inputs, int width, int hidden, int outputs) {
    struct rn_mlp_shape shape;
    shape.layers = hidden + 1;
    shape.count = 0;
    shape.widest = inputs > outputs ? inputs : outputs;
    if (width > shape.widest) shape.widest = width;
    for (int l = 0; l < shape.layers; l++) {
        shape.in[l] = l == 0 ? inputs : width;
        shape.out[l] = l == hidden ? outputs : width;
        shape.offset[l] = shape.count;
        shape.count += (size_t)shape.in[l] * (size_t)shape.out[l];
    }
    return shape;
}

// Forward of one sample. activation[0] = inputs; writes activation[1..layers], each an array of
// at least out[l] numbers; hidden ones after ReLU.
RN_HD void rn_mlp_forward(const struct rn_mlp_shape *shape, const rn_real *weights,
                          rn_real *const *activation) {
    for (int l = 0; l < shape->layers; l++) {
        const rn_real *w = weights + shape->offset[l];
        for (int o = 0; o < shape->out[l]; o++) {
            rn_real sum = 0;
            for (int i = 0; i < shape->in[l]; i++)
                sum += activation[l][i] * w[i * shape->out[l] + o];
            activation[l + 1][o] = l + 1 < shape->layers && sum < 0 ? 0 : sum;
        }
    }
}

// Backward: `grad` holds dL/d(outputs) in grad[layers]; writes grad[0..layers-1] and adds to
// weight_grad.
RN_HD void rn_mlp_backward(const struct rn_mlp_shape *shape, const rn_real *weights,
                           rn_real *const *activation, rn_real *const *grad, rn_real *weight_grad) {
    for (int l = shape->layers - 1; l >= 0; l--) {
        const rn_real *w = weights + shape->offset[l];
        rn_real *dw = weight_grad + shape->offset[l];
        int outs = shape->out[l];
        for (int i = 0; i < shape->in[l]; i++) {
            rn_real sum = 0;
            for (int o = 0; o < outs; o++) {
                sum += grad[l + 1][o] * w[i * outs + o];
                dw[i * outs + o] += activation[l][i] * grad[l + 1][o];
            }
            grad[l][i] = l > 0 && !(activation[l][i] > 0) ? 0 : sum;
        }
    }
}

#endif
