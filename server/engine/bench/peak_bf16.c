// bf16 dot products of AVX-512: 32 multiply-adds an instruction.
#include "server/engine/bench/peak.h"

#include <immintrin.h>

#define CHAINS 12

double rn_peak_bf16(size_t rounds, float *sink) {
    __m512 sum[CHAINS], start = _mm512_set1_ps(*sink);
    __m512bh a = _mm512_cvtne2ps_pbh(start, start), b = a;
#pragma GCC unroll 12
    for (int i = 0; i < CHAINS; i++)
        sum[i] = _mm512_set1_ps((float)i);
    for (size_t k = 0; k < rounds; k++) {
#pragma GCC unroll 12
        for (int i = 0; i < CHAINS; i++)
            sum[i] = _mm512_dpbf16_ps(sum[i], a, b);
    }
    float total = 0;
    for (int i = 0; i < CHAINS; i++)
        total += _mm512_reduce_add_ps(sum[i]);
    *sink = total * 1e-30f;
    return (double)rounds * CHAINS * 32;
}
