// A tiny network and the rows of a workspace that go through it.
#ifndef RN_ENGINE_CPU_NETWORK_H
#define RN_ENGINE_CPU_NETWORK_H

#include "server/engine/cpu/features.h"

struct mlp {
    const struct rn_mlp_shape *shape;
    const float *weights, *packed;
    const void *in;       // [row]; columns behind the inputs are zero
    int in_stride;        // numbers
    bool ready;           // inputs are rounded to bf16 already (features.h)
    float *const *hidden; // [layer][row], rows of hidden_stride(width) in the set's own form
    float *out;           // [row][outputs]
    void *scratch;        // 2 KiB for each of the widest layer's numbers
};

static inline struct mlp base_network(const struct rn_cpu_field *field,
                                      const struct rn_workspace *w) {
    return (struct mlp){.shape = &field->base_shape,
                        .weights = field->base_weights,
                        .packed = field->base_packed,
                        .in = w->features,
                        .in_stride = (int)features_a_row(field),
                        .ready = FEATURES_READY,
                        .hidden = w->hidden,
                        .out = w->geometry,
                        .scratch = w->grad_b};
}

static inline struct mlp head_network(const struct rn_cpu_field *field,
                                      const struct rn_workspace *w) {
    return (struct mlp){.shape = &field->head_shape,
                        .weights = field->head_weights,
                        .packed = field->head_packed,
                        .in = w->head_in,
                        .in_stride = RN_HEAD_INPUTS,
                        .hidden = w->head_hidden,
                        .out = w->head_out,
                        .scratch = w->grad_b};
}

RN_INLINE int round16(int n) {
    return (n + 15) & ~15;
}

#endif
