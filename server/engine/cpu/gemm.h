// Small dense products for the tiny networks: n a multiple of 16, operands in L1/L2.
#ifndef RN_ENGINE_CPU_GEMM_H
#define RN_ENGINE_CPU_GEMM_H

#include <stdbool.h>

#include "server/engine/cpu/simd.h"

// c[i][:] (+)= sum over k of a[i * a_row + k * a_k] * b[k][:]. With a_row = stride, a_k = 1 that is
// A B; with a_row = 1, a_k = stride it is A^T B.
struct rn_gemm {
    const float *a;
    int a_row, a_k;
    const float *b;
    int b_stride;
    float *c;
    int c_stride;
    const float *mask; // NULL, or [row][n] like c: results are kept where mask > 0
    int mask_stride;
    bool accumulate, relu;
};

// ROWS x (VECTORS * RN_VL) of the result in registers.
RN_INLINE void gemm_tile(const struct rn_gemm *g, int row, int column, int k_count, const int ROWS,
                         const int VECTORS) {
    vf sum[12][4];
    const float *a = g->a + (size_t)row * g->a_row, *b = g->b + column;
    const int a_row = g->a_row, a_k = g->a_k, b_stride = g->b_stride;
    float *c = g->c + (size_t)row * g->c_stride + column;
#pragma GCC unroll 12
    for (int i = 0; i < ROWS; i++)
#pragma GCC unroll 4
        for (int j = 0; j < VECTORS; j++)
            sum[i][j] =
                g->accumulate ? vf_load(c + (size_t)i * g->c_stride + j * RN_VL) : vf_set(0);
    for (int k = 0; k < k_count; k++) {
        vf bk[4];
#pragma GCC unroll 4
        for (int j = 0; j < VECTORS; j++)
            bk[j] = vf_load(b + j * RN_VL);
#pragma GCC unroll 12
        for (int i = 0; i < ROWS; i++) {
            vf ai = vf_set(a[(size_t)i * a_row]);
#pragma GCC unroll 4
            for (int j = 0; j < VECTORS; j++)
                sum[i][j] += ai * bk[j];
        }
        a += a_k;
        b += b_stride;
    }
#pragma GCC unroll 12
    for (int i = 0; i < ROWS; i++)
#pragma GCC unroll 4
        for (int j = 0; j < VECTORS; j++) {
            vf value = sum[i][j];
            if (g->relu) value = vf_max(vf_set(0), value); // NaN stays NaN
            if (g->mask) {
                vf m = vf_load(g->mask + (size_t)(row + i) * g->mask_stride + column + j * RN_VL);
                value = vf_bits(vi_bits(value) & (m > 0.0f));
            }
            vf_store(c + (size_t)i * g->c_stride + j * RN_VL, value);
        }
}

#define RN_GEMM_ROWS(ROWS, VECTORS)                                                                \
    for (; row + ROWS <= rows; row += ROWS)                                                        \
    gemm_tile(g, row, column, k_count, ROWS, VECTORS)

// Registers: ROWS * VECTORS sums, VECTORS of b, one broadcast; 32 of them on AVX-512, else 16.
#if RN_VL == 16
#define RN_GEMM_ROWS_1 12
#define RN_GEMM_ROWS_2 12
#define RN_GEMM_ROWS_4 6
#else
#define RN_GEMM_ROWS_1 8
#define RN_GEMM_ROWS_2 6
#define RN_GEMM_ROWS_4 3
#endif

static void gemm(const struct rn_gemm *g, int rows, int k_count, int n) {
    int column = 0;
    while (column < n) {
        int left = (n - column) / RN_VL, row = 0;
        if (left >= 4 && RN_VL != 8) { // 3 x 4 AVX2 registers would leave loads the bottleneck
            RN_GEMM_ROWS(RN_GEMM_ROWS_4, 4);
            RN_GEMM_ROWS(2, 4);
            RN_GEMM_ROWS(1, 4);
            column += 4 * RN_VL;
        } else if (left >= 2) {
            RN_GEMM_ROWS(RN_GEMM_ROWS_2, 2);
            RN_GEMM_ROWS(4, 2);
            RN_GEMM_ROWS(1, 2);
            column += 2 * RN_VL;
        } else {
            RN_GEMM_ROWS(RN_GEMM_ROWS_1, 1);
            RN_GEMM_ROWS(4, 1);
            RN_GEMM_ROWS(1, 1);
            column += RN_VL;
        }
    }
}

#endif
