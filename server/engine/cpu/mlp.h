// The tiny networks: a packet's rows through them, forward and backward.
#ifndef RN_ENGINE_CPU_MLP_H
#define RN_ENGINE_CPU_MLP_H

#include "server/engine/cpu/kernels.h"
#include "server/engine/cpu/simd.h"

// A network and the rows of a workspace that go through it.
struct mlp {
    const struct rn_mlp_shape *shape;
    const float *weights, *packed;
    const float *in; // [row][in_stride]; columns behind the inputs are zero
    int in_stride;
    float *const *hidden; // [layer][row], rows of hidden_stride(width) in the set's own form
    float *out;           // [row][outputs]
};

static inline struct mlp base_network(const struct rn_cpu_field *field,
                                      const struct rn_workspace *w) {
    return (struct mlp){.shape = &field->base_shape,
                        .weights = field->base_weights,
                        .packed = field->base_packed,
                        .in = w->features,
                        .in_stride = field->feature_stride,
                        .hidden = w->hidden,
                        .out = w->geometry};
}

static inline struct mlp head_network(const struct rn_cpu_field *field,
                                      const struct rn_workspace *w) {
    return (struct mlp){.shape = &field->head_shape,
                        .weights = field->head_weights,
                        .packed = field->head_packed,
                        .in = w->head_in,
                        .in_stride = RN_HEAD_INPUTS,
                        .hidden = w->head_hidden,
                        .out = w->head_out};
}

RN_INLINE int round16(int n) {
    return (n + 15) & ~15;
}

// Each has mlp_pack, mlp_forward, mlp_backward, hidden_stride and gemm_public.
#ifdef __AVX512BF16__
#include "server/engine/cpu/mlp_bf16.h"
#ifdef __AMX_BF16__
#define PRODUCT_UNIT RN_PRODUCT_AMX
#else
#define PRODUCT_UNIT RN_PRODUCT_BF16_DOT
#endif
#else
#define PRODUCT_UNIT RN_PRODUCT_FMA
#include "server/engine/cpu/mlp_fp32.h"
#endif

#endif
