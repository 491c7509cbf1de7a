// What the candidates of the comparison with libraries have in common (libraries.c).
#ifndef RN_TESTS_BENCH_LIBRARIES_H
#define RN_TESTS_BENCH_LIBRARIES_H

#include <stdbool.h>
#include <stdint.h>

#include "server/engine/field/mlp.h"

// One network and rows for it. Rows are a multiple of 64, inputs and outputs of every layer of 16.
struct problem {
    struct rn_mlp_shape shape;
    int rows;
    const float *weights;
    const float *in;       // [row][inputs]
    const float *out_grad; // [row][outputs]
};

// Of one forward and one backward.
struct outcome {
    const float *out;         // [row][outputs]
    const float *in_grad;     // [row][inputs]
    const float *weight_grad; // as the weights
};

// A way to compute the network. Everybody gets fp32 rows and gives fp32 rows; what is made of the
// weights before the first row is not timed, as they change once a step. The forward leaves what
// the backward needs; a backward adds to the weights' gradients.
// Thread-safety: one thread. Owner: the caller of create; destroy.
struct candidate {
    const char *name;
    bool bf16;         // multiplies bf16 numbers
    const void *which; // of the library's ways
    // NULL where the library or the machine cannot.
    void *(*create)(const struct candidate *candidate, const struct problem *problem);
    void (*forward)(void *work);
    void (*backward)(void *work);
    void (*look)(void *work, struct outcome *ret_outcome);
    void (*destroy)(void *work);
};

// 64-byte aligned zeros; ends the program without memory. free().
void *zeros(size_t count, size_t size);
// Each layer's weights transposed, [output][input], at the layer's offset.
void transpose_weights(const struct rn_mlp_shape *shape, const float *weights, float *ret);
// Activations and gradients between layers, over n numbers.
void relu(size_t n, float *x);
void mask(size_t n, const float *activation, float *grad);
void mask16(size_t n, const int16_t *activation, int16_t *grad); // bf16
void add(size_t n, const float *x, float *sum);

// Each ends with a candidate without a name.
extern const struct candidate openblas_candidates[], onednn_candidates[], libxsmm_candidates[];
const char *onednn_version(void);
const char *libxsmm_version(void);
const char *openblas_version(void);

#endif
